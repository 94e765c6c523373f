"""Page of the fidelity study: columns, conclusions and tables."""

from collections.abc import Sequence
from dataclasses import astuple, fields

from flexman_gym.common.markdown import markdown_table
from studies.fidelity.measure import GRID_METHODS, GRID_PARTS, OPEN_METHODS, FidelityRow
from studies.markdown import bullets

NEAR = 5.0  # an error estimate within this factor of the error counts as correct
CHEAP = 2.0  # cost relative to the cheapest grid run up to which a choice counts as cheap
PAGE = """# Choices of `choose_model`

`choose_model` looks for the cheapest model, method and step whose tip stays within a tolerance in a scene.
Here its choices are run again and judged by the finest model of the scene.
Of {count} choices {met} meet their tolerance, and {near} know how large their error is.
As to cost, {cheap} are at most twice as dear as the cheapest plain run that is good enough.

`python scripts/fidelity.py` writes this page and its rows ([fidelity.csv](fidelity.csv)) anew.
The finest model has all modes and foreshortening, and `dop853` integrates it.

{conclusion}

Each row of the table is one choice. Its columns are:

{columns}

The plain runs are a grid.
They keep the lowest 2 to 9 modes of each link, or all of them, with foreshortening or without.
They take {methods} with {parts} steps from ten outputs to 1/64 of one.

{table}
"""
OPEN = """
## With an open mesh

The same scenes leave the finite elements to the choice (`elements` is None; rows in
[fidelity_open.csv](fidelity_open.csv)).
The finest model then has five elements of each link, all modes and foreshortening.
The midpoint rule integrates it, extrapolated to steps of no length.

{conclusion}

The plain runs have one, two or three elements a link, and take {methods}.

{table}
"""
CONCLUSION = """Of {count} choices:

- **{met} meet their tolerance**
- {near} know their error within a factor of {factor:g}
- {cheap} cost at most {most:g} times as much as the cheapest plain run that meets the tolerance"""
COLUMNS = {
    "scene": "the arm and its motion; a random one has 1 to 3 hollow metal links on springs",
    "tolerance": "the error that `choose_model` was allowed, in m at the tip",
    "error": "the largest distance of the tip from that of the finest model during the motion, in m",
    "estimate": "the error that the choice itself names, in m",
    "ratio": "estimate over error; 1 is a choice that knows its error",
    "coordinates": "how many coordinates the chosen model has",
    "method": "the chosen method",
    "step": "the chosen step, in s",
    "cost": "CPU time of the chosen run, the best of five, in s",
    "grid": "CPU time of the cheapest plain run that meets the tolerance, in s",
    "dearer": "cost over grid; below 1 the choice is cheaper than every plain run that is good enough",
}
COLUMN = "`{name}`: {meaning}"


def page(rows: Sequence[FidelityRow], opened: Sequence[FidelityRow] = ()) -> str:
    """Return the page as Markdown from all rows, including those of open meshes."""
    names = [field.name for field in fields(FidelityRow)]
    columns = bullets(COLUMN.format(name=name, meaning=COLUMNS[name]) for name in names)
    known = {"methods": _listed(GRID_METHODS), "parts": len(GRID_PARTS), **_numbers(rows)}
    text = PAGE.format(conclusion=conclusion(rows), columns="\n".join(columns), table=_table(rows), **known)
    if opened:
        text += OPEN.format(conclusion=conclusion(opened), methods=_listed(OPEN_METHODS), table=_table(opened))
    return text


def _table(rows: Sequence[FidelityRow]) -> str:
    names = [field.name for field in fields(FidelityRow)]
    return "\n".join(markdown_table(names, ([_cell(value) for value in astuple(row)] for row in rows)))


def _listed(names: Sequence[str]) -> str:
    *some, last = names
    return f"{', '.join(some)} and {last}"


def conclusion(rows: Sequence[FidelityRow]) -> str:
    """Return the numbers of choices within tolerance, with a correct error estimate, and of low cost."""
    return CONCLUSION.format(**_numbers(rows), factor=NEAR, most=CHEAP)


def _numbers(rows: Sequence[FidelityRow]) -> dict[str, int]:
    return {
        "count": len(rows),
        "met": sum(row.error <= row.tolerance for row in rows),
        "near": sum(1.0 / NEAR <= row.ratio <= NEAR for row in rows),
        "cheap": sum(row.dearer <= CHEAP for row in rows),
    }


def _cell(value: str | float) -> str:
    return value if isinstance(value, str) else f"{value:.3g}"
