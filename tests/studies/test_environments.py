"""Environments: the pages say what the docstrings and the environments say."""

import re

import pytest

from flexman_gym.envs import NAMED
from flexman_gym.envs.tasks import TASKS
from studies.environments.accuracy import accuracy
from studies.environments.episode import BASES, draw, run
from studies.environments.page import SECTIONS, STEP, docstring_sections, page

from oracles.files import ROOT

PAGES = ROOT / "docs" / "environments"


def without_figures(text):
    """A page without what its baselines reached, which takes minutes to work out, and without times."""
    return re.sub(rf"\| (no torque|PD|tracking LQR|{STEP}) \|[^\n]*", r"| \1 |", text)


@pytest.mark.parametrize("task", TASKS.values(), ids=TASKS)
def test_a_task_has_the_sections_of_gymnasium_in_their_order(task):
    lines = task.__doc__.splitlines()
    titles = [line.strip() for line in lines if line.strip() in SECTIONS and line.startswith("    ") and line[4] != " "]
    assert tuple(titles) == SECTIONS
    assert all(docstring_sections(task).values()), "none is empty"


@pytest.fixture(scope="module")
def hold():
    """Short episodes of each baseline."""
    return {base: run("FlexPlanar-Hold-v0", base) for base in BASES}


@pytest.mark.parametrize("name", NAMED)
def test_a_page_is_made_of_what_there_is_now(name, hold):
    result = (PAGES / f"{name}.md").read_text(encoding="utf-8")
    assert without_figures(result) == without_figures(page(name, hold)), (
        "python scripts/environments.py --folder docs/environments"
    )
    for suffix, least in (("png", 10_000), ("gif", 20_000)):
        assert least < (PAGES / f"{name}.{suffix}").stat().st_size < 180_000 and f"{name}.{suffix}" in result


def test_runs_are_what_the_table_says(hold, tmp_path):
    text = page("FlexPlanar-Hold-v0", hold)
    for base, each in hold.items():
        assert f"| {BASES[base]} | {1e3 * each.rms_error:.3g} mm | {each.failed:.0%} |" in text
    assert hold["lqr-tracking"].rms_error < hold["pd"].rms_error < hold[None].rms_error
    draw(hold, tmp_path / "episode.png")
    assert (tmp_path / "episode.png").read_bytes()[:4] == b"\x89PNG"
    assert (tmp_path / "episode.gif").read_bytes()[:6] == b"GIF89a"


def test_the_default_is_judged_by_finer_steps_and_a_finer_model():
    """Half the step of the default is a quarter of its error, as its method has order 2."""
    default, half = accuracy("FlexPlanar-v0"), accuracy("FlexPlanar-v0", step=0.00125)
    assert half.steps == pytest.approx(default.steps / 4.0, rel=0.5)
    assert (default.model > default.steps).all() and default.model.max() < 0.01 and default.cost > 1.0
