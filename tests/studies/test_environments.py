"""Tests of the environment pages against docstrings and environments."""

import inspect
import re

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.envs import NAMED_ENVIRONMENTS
from flexman_gym.envs.tasks import TASKS
from studies.environments.measure import BASES, SEEDS, accuracy, run
from studies.environments.page import SECTIONS, STEP, baselines, docstring_sections, page

from oracles.files import ROOT

PAGES = ROOT / "docs" / "environments"


def without_figures(text):
    """Return a page without the results of its baselines, which take minutes to compute, and without times."""
    return re.sub(rf"\| (no torque|PD|tracking LQR|{STEP}) \|[^\n]*", r"| \1 |", text)


@pytest.mark.parametrize("task", TASKS.values(), ids=TASKS)
def test_a_task_has_the_sections_of_gymnasium_in_their_order(task):
    lines = inspect.cleandoc(task.__doc__).splitlines()  # Python 3.13 has taken the indentation off already
    assert tuple(line for line in lines if line in SECTIONS) == SECTIONS
    assert all(docstring_sections(task).values()), "none is empty"


@pytest.fixture(scope="module")
def hold():
    """Return short episodes of each baseline."""
    return {base: run("FlexPlanar-Hold-v0", base) for base in BASES}


@pytest.mark.parametrize("name", NAMED_ENVIRONMENTS)
def test_a_page_is_made_of_what_there_is_now(name, hold):
    result = (PAGES / f"{name}.md").read_text(encoding="utf-8")
    assert without_figures(result) == without_figures(page(name, hold)), (
        "python scripts/environments.py --folder docs/environments"
    )
    for suffix, least in (("png", 10_000), ("gif", 20_000)):
        assert least < (PAGES / f"{name}.{suffix}").stat().st_size < 180_000 and f"{name}.{suffix}" in result


def cells(lines):
    """Return the cells of a table of baselines: base -> head -> text."""
    rows = [[cell.strip() for cell in line.strip("| ").split("|")] for line in lines if line.startswith("|")]
    heads, _, *bases = rows
    return {base: dict(zip(heads[-len(values) :], values, strict=True)) for base, *values in bases}


@pytest.mark.parametrize("base", ["pd", "lqr-tracking"])
def test_the_page_of_a_slew_has_what_evaluate_gives(base):
    lines = (PAGES / "FlexRRR-v0.md").read_text(encoding="utf-8").split("## Baselines")[1].splitlines()[:12]
    found = fm.evaluate(base, "FlexRRR-v0", SEEDS)
    row = cells(lines)[BASES[base]]
    assert (row["settled"], row["failed"]) == (f"{found['settled']:.0%}", f"{found['failed']:.0%}")


def test_runs_are_what_the_table_says(hold):
    told = cells(baselines("FlexPlanar-Hold-v0", hold))
    errors = {}
    for base, each in hold.items():
        errors[base] = np.quantile(np.sqrt(np.nanmean(each.errors**2, axis=1)), 0.5, method="higher")
        failed = np.mean([failure != "" for failure in each.failures])
        assert told[BASES[base]] == {"RMS error, mm": f"{1e3 * errors[base]:.3g}", "failed": f"{failed:.0%}"}
    assert errors["lqr-tracking"] < errors["pd"] < errors[None]


def test_the_default_is_judged_by_finer_steps_and_a_finer_model():
    """Halving the step of the default quarters its error, since its method has order 2."""
    default, half = accuracy("FlexPlanar-v0"), accuracy("FlexPlanar-v0", step=0.00125)
    assert half.steps == pytest.approx(default.steps / 4.0, rel=0.5)
    assert (default.model > default.steps).all() and default.model.max() < 0.01 and default.cost > 1.0
