"""League chart: scores of entrants over conditions or over a number that is swept, and their performance profiles."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from flexman_gym.arrays import Array
from flexman_gym.draw.style import LIGHT, LINK_COLOURS, MIDDLE, new_figure

MARKS = "osD^vP"
SHIFT = 0.05  # of the distance of two conditions, between entrants


class Curve(NamedTuple):
    """Values at some places, (k,) each, and their intervals; nan where there is none."""

    places: Array
    middle: Array
    low: Array
    high: Array


def score_chart(
    curves: Mapping[str, Curve], what: str, path: str | Path, names: Sequence[str] = (),
    profiles: Mapping[str, tuple[Array, Array]] | None = None,
) -> None:  # fmt: skip
    """Draws the scores of entrants, and beside them their profiles where there are any.

    Args:
        curves: entrant -> its scores.
        what: the places are, the label of their axis.
        path: of the picture.
        names: of the places 0, 1 and so on; without them the places are numbers, and lines join them.
        profiles: entrant -> thresholds and parts of the episodes above them.

    Raises:
        ImportError: without Matplotlib.
    """
    figure = new_figure((11.0 if profiles else 7.5, 5.0), 120.0, layout="constrained")
    panels = figure.subplots(1, 2, width_ratios=(2.0, 1.0)) if profiles else [figure.add_subplot()]
    for number, (entrant, curve) in enumerate(curves.items()):
        look, shift = _look(number), SHIFT * (number - 0.5 * (len(curves) - 1)) if names else 0.0
        spread = [curve.middle - curve.low, curve.high - curve.middle]
        line = {"linestyle": "none"} if names else {}
        panels[0].errorbar(curve.places + shift, curve.middle, spread, label=entrant, capsize=2, **(look | line))
        if profiles and entrant in profiles:
            panels[1].plot(*profiles[entrant], **(look | {"marker": ""}))
    panels[0].set(ylabel="score: 0 no torque, 1 told all", xlabel=what)
    if names:
        panels[0].set_xticks(range(len(names)), names, rotation=30, ha="right", rotation_mode="anchor")
    if profiles:
        panels[1].set(xlabel="score", ylabel="part of the episodes above it", ylim=(0.0, 1.02))
    for axes in panels:
        axes.grid(color=LIGHT, linewidth=0.6)
        axes.spines[["top", "right"]].set_visible(False)
    for level in (0.0, 1.0):
        panels[0].axhline(level, color=MIDDLE, linewidth=0.8)
    panels[0].set_ylim(bottom=max(-1.0, panels[0].get_ylim()[0]))  # who drops the arm drops out of the picture
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=5, frameon=False)
    figure.savefig(path)


def _look(number: int) -> dict[str, Any]:
    again, colour = divmod(number, len(LINK_COLOURS))
    look = {"color": LINK_COLOURS[colour], "marker": MARKS[(colour + again) % len(MARKS)]}
    return look | {"linestyle": ("-", "--", ":")[again % 3], "linewidth": 1.4, "markersize": 5}
