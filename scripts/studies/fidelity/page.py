"""Page of the fidelity study: columns, conclusions and tables."""

from collections.abc import Sequence
from dataclasses import astuple, fields

from flexman_gym.common.markdown import markdown_table
from studies.fidelity.measure import GRID_METHODS, GRID_PARTS, OPEN_METHODS, FidelityRow
from studies.markdown import bullets

NEAR = 5.0  # an error estimate within this factor of the error counts as correct
CHEAP = 2.0  # cost relative to the cheapest grid run up to which a choice counts as cheap
PAGE = """# Choices of `choose_model`

`choose_model` searches for the cheapest model, method and step whose tip error stays within a tolerance in a scene.
Here its choices are compared with the finest model of the scene.
Of {count} choices {met} meet their tolerance, and the error estimates of {near} are correct within a factor of 5.
The cost of {cheap} choices is at most twice that of the cheapest run of a grid that meets the tolerance.

`python scripts/fidelity.py` rewrites this page and its rows ([fidelity.csv](fidelity.csv)).
The finest model has all modes and foreshortening and is integrated by `dop853`.

{conclusion}

Each row of the table is one choice. Its columns are:

{columns}

The grid contains the lowest 2 to 9 modes of each link, or all of them, with and without foreshortening,
the methods {methods}, and {parts} steps from ten output steps to 1/64 of one.

{table}
"""
OPEN = """
## With an open mesh

In the same scenes `choose_model` also chooses the number of finite elements (`elements` is None; rows in
[fidelity_open.csv](fidelity_open.csv)).
The finest model then has five elements per link, all modes and foreshortening.
It is integrated by the midpoint rule with Richardson extrapolation to zero step.

{conclusion}

The grid has one, two or three elements per link and the methods {methods}.

{table}
"""
CONCLUSION = """Of {count} choices:

- **{met} meet their tolerance**
- {near} estimate their error within a factor of {factor:g}
- {cheap} cost at most {most:g} times as much as the cheapest run of the grid that meets the tolerance"""
COLUMNS = {
    "scene": "arm and motion; random arms have 1 to 3 hollow metal links on elastic joints",
    "tolerance": "tip error allowed for `choose_model`, in m",
    "error": "largest distance of the tip from that of the finest model during the motion, in m",
    "estimate": "error estimate returned with the choice, in m",
    "ratio": "estimate divided by error; 1 is a correct estimate",
    "coordinates": "number of coordinates of the chosen model",
    "method": "chosen method",
    "step": "chosen step, in s",
    "cost": "CPU time of the chosen run, best of five, in s",
    "grid": "CPU time of the cheapest run of the grid that meets the tolerance, in s",
    "dearer": "cost divided by grid; below 1 the choice is cheaper than every run of the grid that meets the tolerance",
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
