"""Peers charts: error of the tip over cost of our runs beside those of other codes."""

from collections.abc import Iterable, Sequence
from itertools import cycle
from pathlib import Path

from flexman_gym.draw.style import BLUE, GREEN, MIDDLE, ORANGE, RED, SKY
from studies.looks import BLACK, PINE, PINK, PURPLE
from studies.precision.axes import (
    TOTAL_ERROR,
    TRUTHS,
    draw_floor,
    draw_front,
    draw_runs,
    finish,
    new_panels,
)
from studies.precision.measure import Row

COLOURS = (ORANGE, RED, PURPLE, GREEN, SKY, BLACK, MIDDLE, PINK, PINE)  # of the models of other codes; ours are blue
MARKERS = "ov^D<PX>"  # of their methods; ours are squares


def peers_chart(rows: Sequence[Row], peers: Sequence[Row], floor: float, title: str, path: Path) -> None:
    """Total error over cost of our runs and of those of other codes: a colour for each model, a marker for a method."""
    figure, (axes,) = new_panels(1, title, 6.4)
    draw_runs(axes, rows, "total_error", "flexman_gym", {"color": BLUE, "marker": "s", "linestyle": ""})
    colours = _in_turn((row.model for row in peers), COLOURS)
    markers = _in_turn((row.method for row in peers), MARKERS)
    for model, method in dict.fromkeys((row.model, row.method) for row in peers):
        result = [row for row in peers if (row.model, row.method) == (model, method)]
        look = {"color": colours[model], "marker": markers[method], "markersize": 7.0}
        draw_runs(axes, result, "total_error", f"{model}, {method}", look)
    draw_front(axes, [*rows, *peers], "total_error", floor)
    draw_floor(axes, floor, TRUTHS)
    axes.set_ylabel(TOTAL_ERROR)
    finish(figure, [axes], path)


def _in_turn(names: Iterable[str], values: Sequence[str]) -> dict[str, str]:
    """A value for each name, in turn and from the start again when there are more names."""
    return dict(zip(dict.fromkeys(names), cycle(values), strict=False))
