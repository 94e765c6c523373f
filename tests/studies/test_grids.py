"""Tests of parallel grids: recipes, leagues and stability maps are bitwise equal for any number of workers."""

from dataclasses import replace
from functools import partial
from importlib.util import find_spec

import pytest

pytest.importorskip("stable_baselines3")

from flexman_agents.training import train, train_or_resume
from flexman_gym.common.parallel import Workers, parallel_map
from flexman_gym.common.run_folder import NEWEST, read_npz
from flexman_gym.toolbox.league.rows import ROWS, run_league
from studies.stability import rows as stability

from oracles import cells
from oracles.assertions import refusal
from oracles.runs import RUNS

pytestmark = pytest.mark.slow

SEEDS, RECIPE = range(5), replace(RUNS["ppo"], eval_every=0)
WAYS = {
    "processes": (Workers(2), None),
    "ray": (Workers(2, ray="local"), "ray"),
    "submitit": (Workers(2, submitit="local"), "submitit"),
}  # fmt: skip
MAP = [cell for cell in stability.cells(quick=True) if cell.arguments[:1] == ("payload",)]


def seeds_of(folder):
    """Return the cells of the seeds of a recipe."""
    return [(RECIPE.with_seed(seed), str(folder / f"seed-{seed}"), {"progress": False}) for seed in SEEDS]


def policies(folder):
    """Return the bits of trained policies."""
    data = [read_npz(folder / f"seed-{seed}" / NEWEST)["policy"] for seed in SEEDS]
    return [[(name, values.tobytes()) for name, values in each.items()] for each in data]


def league(folder, workers, venues):
    """Return the rows of a league as bytes."""
    run_league(["zero", "pd", "lqr"], venues, range(9000, 9002), folder, workers, lambda said: None)
    return (folder / ROWS).read_bytes()


@pytest.fixture(scope="module")
def venues(tmp_path_factory):
    """Return three conditions of a small environment as files."""
    folder, result = tmp_path_factory.mktemp("venues"), []
    for name, changes in {
        "plain": "",
        "load": "{payload_mass: [0.05, 0.05]}",
        "noise": "{sensor_noise: [0.01, 0.01]}",
    }.items():
        (folder / f"{name}.yaml").write_text(
            f"id: FlexOne-v0\nhorizon: 0.6\n{f'randomisation: {changes}' if changes else ''}\n"
        )
        result.append(str(folder / f"{name}.yaml"))
    return result


@pytest.fixture(scope="module")
def serial(tmp_path_factory, venues):
    """Return all three computed in this process."""
    folder = tmp_path_factory.mktemp("serial")
    parallel_map(train_or_resume, seeds_of(folder))
    return policies(folder), league(folder / "league", 1, venues), parallel_map(stability.rows_of, MAP)


@pytest.mark.parametrize("way", WAYS)
def test_every_way_gives_the_bits_of_a_serial_run_although_a_worker_is_killed(
    way, serial, venues, tmp_path, monkeypatch
):
    workers, package = WAYS[way]
    if package and not find_spec(package):
        pytest.skip(f"{package} is not installed")
    monkeypatch.chdir(tmp_path)
    parallel_map(partial(cells.dying_once, str(tmp_path / "grave"), train_or_resume), seeds_of(tmp_path), workers)
    assert policies(tmp_path) == serial[0] and len({str(each) for each in serial[0]}) == 5
    if way != "processes":  # in which toolbox/league/test_rows.py plays it
        assert league(tmp_path / "league", workers, venues) == serial[1]
    assert repr(parallel_map(stability.rows_of, MAP, workers)) == repr(serial[2])
    assert (tmp_path / "grave").exists() and len(serial[2]) == len(MAP) == 2


def test_seeds_that_were_killed_go_on_and_those_that_are_done_stay(tmp_path, serial):
    for seed, stop in ((0, 1), (1, 48), (2, 999)):
        train(RECIPE.with_seed(seed), tmp_path / f"seed-{seed}", progress=False,
              hook=lambda report, stop=stop: report.steps >= stop)  # fmt: skip
    (tmp_path / "seed-0" / NEWEST).unlink()  # killed before anything was kept
    before = (tmp_path / "seed-2" / NEWEST).stat().st_mtime_ns
    assert parallel_map(train_or_resume, seeds_of(tmp_path)) == [str(tmp_path / f"seed-{seed}") for seed in SEEDS]
    assert policies(tmp_path) == serial[0]
    assert (tmp_path / "seed-2" / NEWEST).stat().st_mtime_ns == before
    other = (replace(RECIPE, envs=2), str(tmp_path / "seed-0"), {"progress": False})
    assert refusal(train_or_resume, other).startswith("folder: ")


def test_the_cells_of_the_stability_study_are_all_of_its_rows():
    """Check every value of every study in the published order."""
    whole = stability.cells()
    assert len(whole) > 50 and len({repr(cell) for cell in whole}) == len(whole)
    makers = [cell.maker for cell in whole]
    assert list(dict.fromkeys(makers)) == list(stability.MAKERS)
