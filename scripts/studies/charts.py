"""Axes of the charts of studies; `save_figure` writes them as SVG for pages that are white or dark."""

from typing import Any

from flexman_gym.common.plot_style import LIGHT, new_figure

DPI = 100.0  # pixels per inch of a chart in a page


def new_chart(inches: tuple[float, float], rows: int = 1, columns: int = 1) -> tuple[Any, Any]:
    """Return a figure and its axes, an array (rows, columns), with a grid and without a box.

    Args:
        inches: width and height, inches; 7.6 is the width of a page of the site.
        rows: number of rows of axes.
        columns: number of columns of axes.
    """
    figure = new_figure(inches, DPI, layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False)
    for each in axes.flat:
        each.grid(color=LIGHT, linewidth=0.6)
        each.spines[["top", "right"]].set_visible(False)
    return figure, axes
