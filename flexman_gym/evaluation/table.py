"""Table: what entrants reached on the same episodes, a row for each."""

from collections.abc import Mapping, Sequence

import numpy as np

from flexman_gym.envs.description import Description
from flexman_gym.evaluation.figures import MEDIAN, SHARE, Figure, figures_of
from flexman_gym.evaluation.rollout import Record

LONGEST_NAME = 100  # letters in a line of the table
CAPTION = "medians with 95 % bootstrap intervals; shares, reward, roughness and effort are means"


def table(results: Mapping[str, Sequence[Record]], environment: Description) -> str:
    """Gives a table with a row for each entrant; its head says on which environment all of them were run.

    Args:
        results: name -> what happened in its episodes.
        environment: on which they were run.
    """
    setup = environment.setup()
    columns = figures_of(setup.task)
    first = next(iter(results.values()))
    changes = ", ".join(sorted(environment.settings or {})) or "as it is"
    title = f"{len(first)} episodes of {environment.id} ({changes}), the same for all"
    heads = ["entrant", *(_head(figure, first[0].band) for figure in columns)]
    rows = [[_short(name), *(_cell(figure, records) for figure in columns)] for name, records in results.items()]
    widths = [max(map(len, column)) for column in zip(heads, *rows, strict=True)]
    return "\n".join([title, *(_line(row, widths) for row in (heads, *rows)), CAPTION])


def _head(figure: Figure, band: float) -> str:
    return f"in {1e3 * band:.3g} mm" if figure.name == "settled" else figure.head


def _cell(figure: Figure, records: Sequence[Record]) -> str:
    if figure.many == MEDIAN:
        middle, low, high = (
            f"{figure.scale * value:.3g}" if np.isfinite(value) else "-" for value in figure.interval(records)
        )
        return f"{middle} ({low} to {high})"
    result = figure.sum_up(records)
    if figure.many == SHARE:
        return f"{result:.0%}"
    return f"{result:.1f}" if abs(result) >= 10.0 else f"{result:.3f}"


def _short(name: str) -> str:
    return name if len(name) <= LONGEST_NAME else f"...{name[3 - LONGEST_NAME :]}"


def _line(cells: Sequence[str], widths: Sequence[int]) -> str:
    """Cells side by side, the first to the left."""
    others = [f"{cell:>{width}}" for cell, width in zip(cells[1:], widths[1:], strict=True)]
    return "  ".join([f"{cells[0]:<{widths[0]}}", *others]).rstrip()
