"""Style of plots: colours of all plots and pictures, and Matplotlib figures without a window."""

from pathlib import Path
from typing import Any

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.files import write_file

# Colours that people with red-green colour blindness can distinguish (Okabe and Ito, 2008).
BLUE, ORANGE, GREEN, SKY, YELLOW, RED = "#0072B2", "#E69F00", "#009E73", "#56B4E9", "#F0E442", "#D55E00"
VIOLET = "#6d28d9"  # path of the tip and true tip in frames
PURPLE, BROWN, SLATE = "#c0619b", "#8a6d3b", "#767b84"
GRID_OPACITY = 0.25  # opacity, 0 to 1, of grid lines in an SVG
# Colours of lines: their contrast is at least 3 on a white page and on the dark page of the documentation.
LINK_COLOURS = (BLUE, RED, GREEN, PURPLE, BROWN, SLATE)
DARK, MIDDLE, LIGHT = "#222222", "#8a8f98", "#d5d8dd"


def rgb(colour: str) -> Array:
    """Return red, green and blue (3,) between 0 and 255 of a colour such as "#0072b2"."""
    return np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)], dtype=float)


def round_up(value: float) -> float:
    """Return the smallest of 1, 2, 5, 10 times a power of ten that is at least a value > 0."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(power * step for step in (1, 2, 5, 10) if power * step >= value))


def new_figure(inches: tuple[float, float], dpi: float, window: bool = False, **options: Any) -> Any:
    """Return a Matplotlib figure on its own canvas, without a window and without the global state of pyplot.

    Args:
        inches: width and height, inches.
        dpi: pixels per inch.
        window: True to return a figure of pyplot instead, for `pyplot.show`.
        **options: keyword arguments of Matplotlib's Figure.

    Raises:
        ImportError: without Matplotlib.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        if window:
            from matplotlib import pyplot

            return pyplot.figure(figsize=inches, dpi=dpi, **options)
    except ImportError as error:
        raise ImportError("pictures need Matplotlib: pip install 'flexman_gym[render]'") from error
    figure = Figure(figsize=inches, dpi=dpi, **options)
    FigureCanvasAgg(figure)
    return figure


def save_figure(figure: Any, path: Path) -> Path:
    """Write a Matplotlib figure and return its path; an SVG is legible on a white and on a dark page.

    The background of an SVG is transparent, and its texts and axes are grey. Equal figures give equal files: ids in an
    SVG do not depend on chance, and it has no date.

    Args:
        figure: the figure.
        path: path of the file; its folder is created if it does not exist.
    """
    kind = path.suffix[1:] or "png"
    if kind != "svg":
        write_file(path, lambda file: figure.savefig(file, format=kind))
        return path
    import matplotlib
    from matplotlib.colors import to_hex

    legends = [*figure.legends, *(axes.get_legend() for axes in figure.axes if axes.get_legend())]
    for axes in figure.axes:
        axes.set_facecolor("none")
        axes.tick_params(which="both", color=SLATE, labelcolor=SLATE)
        for spine in axes.spines.values():
            spine.set_edgecolor(SLATE)
        for line in (*axes.get_xgridlines(), *axes.get_ygridlines()):
            line.set(color=SLATE, alpha=GRID_OPACITY)
        for part in (*axes.texts, *axes.lines):  # what would vanish on a dark page
            if to_hex(part.get_color()) in (DARK, "#000000"):
                part.set_color(SLATE)
    titles = [text for axes in figure.axes for text in (axes.xaxis.label, axes.yaxis.label, axes.title)]
    entries = [text for legend in legends for text in (*legend.get_texts(), legend.get_title())]
    for legend in legends:
        legend.set_frame_on(False)
    for text in (*titles, *entries, *figure.texts):
        text.set_color(SLATE)
    with matplotlib.rc_context({"svg.hashsalt": path.stem}):
        write_file(path, lambda file: figure.savefig(file, format=kind, transparent=True, metadata={"Date": None}))
    return path
