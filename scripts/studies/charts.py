"""Style of the charts of studies: transparent SVG that is legible on a white and on a dark page."""

from pathlib import Path
from typing import Any

from flexman_gym.common.plot_style import SLATE, new_figure

GRID_OPACITY = 0.25  # opacity, 0 to 1, of grid lines in the colour of the text
DPI = 100.0  # pixels per inch of a chart in a page


def new_chart(inches: tuple[float, float], rows: int = 1, columns: int = 1) -> tuple[Any, Any]:
    """Return a figure and its axes, an array (rows, columns), in the style of the site.

    Args:
        inches: width and height, inches.
        rows: number of rows of axes.
        columns: number of columns of axes.
    """
    figure = new_figure(inches, DPI, layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False)
    for each in axes.flat:
        each.grid(color=SLATE, alpha=GRID_OPACITY, linewidth=0.6)
        each.spines[["top", "right"]].set_visible(False)
    return figure, axes


def save_chart(figure: Any, path: Path) -> Path:
    """Write a figure as a transparent SVG whose texts and axes have one colour; return the path.

    Equal figures give equal files: ids do not depend on chance, and the file has no date.
    """
    import matplotlib

    legends = [*figure.legends, *(axes.get_legend() for axes in figure.axes if axes.get_legend())]
    for axes in figure.axes:
        axes.set_facecolor("none")
        axes.tick_params(which="both", color=SLATE, labelcolor=SLATE)
        for spine in axes.spines.values():
            spine.set_edgecolor(SLATE)
    for legend in legends:
        legend.set_frame_on(False)
    titles = [text for axes in figure.axes for text in (axes.xaxis.label, axes.yaxis.label, axes.title)]
    for text in [*titles, *figure.texts, *(text for legend in legends for text in legend.get_texts())]:
        text.set_color(SLATE)
    with matplotlib.rc_context({"svg.hashsalt": path.stem}):
        figure.savefig(path, transparent=True, metadata={"Date": None})
    return path
