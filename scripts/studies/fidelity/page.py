"""Page of the fidelity study: numbers of choices that meet their tolerance."""

from collections.abc import Mapping, Sequence

from flexman_gym.common.markdown import markdown_table
from studies.fidelity.measure import FidelityRow
from studies.screen import screen

NEAR = 5.0  # an error estimate within this factor of the error counts as correct
CHEAP = 2.0  # cost relative to the cheapest grid run up to which a choice counts as cheap
QUESTION = "Does `choose_model` return a model, a method and a step that meet the tolerance, at a low cost?"
ANSWER = """**{met} of {count} choices meet their tolerance.** Their error is the largest distance of the tip from
that of the finest model of the scene. The tolerances are {tolerances} m; the {scenes} scenes are those of the paper
and random arms of 1 to 3 hollow links on elastic joints."""
BODY = """{table}

The cost is relative to the cheapest run of a grid that meets the tolerance. The grid has 2 to 9 modes per link or
all of them, with and without foreshortening; with an open mesh 1 to 3 elements per link. The finest model is
integrated by `dop853`, with an open mesh by Richardson extrapolation of the midpoint rule."""
HEADS = (
    "mesh", "choices", "within tolerance", f"estimate within a factor of {NEAR:g}", f"cost at most {CHEAP:g} times",
)  # fmt: skip


def page(rows: Sequence[FidelityRow], opened: Sequence[FidelityRow], files: Mapping[str, str]) -> str:
    """Return the page as Markdown.

    Args:
        rows: choices with a given mesh.
        opened: choices that include the number of elements.
        files: files of both with their comments.
    """
    both = [*rows, *opened]
    answer = ANSWER.format(
        met=sum(row.error <= row.tolerance for row in both), count=len(both), scenes=len({row.scene for row in rows}),
        tolerances=", ".join(f"{each:g}" for each in sorted({row.tolerance for row in both}, reverse=True)),
    )  # fmt: skip
    table = "\n".join(markdown_table(HEADS, (_cells("given", rows), _cells("chosen too", opened))))
    return screen("Choices of `choose_model`", QUESTION, answer, BODY.format(table=table), files, "fidelity")


def _cells(name: str, rows: Sequence[FidelityRow]) -> tuple[object, ...]:
    met = sum(row.error <= row.tolerance for row in rows)
    near = sum(1.0 / NEAR <= row.ratio <= NEAR for row in rows)
    return name, len(rows), met, near, sum(row.dearer <= CHEAP for row in rows)
