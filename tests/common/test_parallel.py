"""Grid: the same results whoever works its cells off, dead workers and killed grids included."""

import ast
import os
import pickle
import signal
import subprocess
import sys
import time
from importlib.util import find_spec

import pytest

from flexman_gym.common import parallel, progress
from flexman_gym.common.parallel import Workers, parallel_map, parallel_map_unordered

from oracles import cells
from oracles.assertions import refusal

pytestmark = pytest.mark.slow

RAY = pytest.param(
    Workers(2, ray="local"),
    id="ray",
    marks=pytest.mark.skipif(not find_spec("ray"), reason="ray is not installed"),
)
SUBMITIT = pytest.param(
    Workers(2, submitit="local"),
    id="submitit",
    marks=pytest.mark.skipif(not find_spec("submitit"), reason="submitit is not installed"),
)
WAYS = [pytest.param(Workers(1), id="alone"), pytest.param(Workers(2), id="processes"), RAY, SUBMITIT]
CELLS = [(seed, 3 + seed % 4) for seed in range(9)]


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    """Logs of submitit are written where the process is."""
    monkeypatch.chdir(tmp_path)


def bits(results):
    """Results as bytes, the same for the same bits."""
    return [pickle.dumps([(name, getattr(value, "tobytes", lambda value=value: repr(value))())
                          for name, value in result.items()]) for result in results]  # fmt: skip


@pytest.mark.parametrize("workers", WAYS)
def test_all_ways_give_the_bits_of_the_loop_in_the_order_of_the_cells(workers, tmp_path):
    expected = bits(map(cells.waves, CELLS))
    assert bits(parallel_map(cells.waves, CELLS, workers, tmp_path / "kept")) == expected
    assert bits(parallel_map(cells.waves, CELLS, workers, tmp_path / "kept")) == expected, "from the folder"
    assert len([*(tmp_path / "kept").iterdir()]) == 9


@pytest.mark.parametrize("workers", WAYS[1:])
def test_a_cell_whose_worker_dies_is_tried_again(workers, tmp_path, capsys):
    own = [(str(tmp_path), seed) for seed in range(4)]
    result = parallel_map(cells.mortal, own, workers)
    assert (tmp_path / "2").exists() and bits(result) == bits(cells.waves((seed, 5)) for seed in range(4))
    assert parallel_map(cells.mortal, [], workers) == []


@pytest.mark.parametrize("workers", WAYS)
def test_workers_are_prepared_before_their_cells(workers, tmp_path):
    times = {Workers(1): 0, Workers(2): 1}.get(workers, len(CELLS))
    assert bits(parallel_map(cells.waves, CELLS, workers, prepare=cells.waking)) == bits(map(cells.waves, CELLS))
    known = (tmp_path / "prepared").read_text().split() if times else []
    assert len(known) == times and (times != 1 or known == [str(os.getpid())])


@pytest.mark.parametrize("workers", WAYS)
def test_the_error_of_a_cell_is_raised_as_it_is(workers):
    with pytest.raises(ValueError, match=r"^cell: 3 is not allowed; give another$"):
        parallel_map(cells.refusing, [3], workers)


def test_workers_that_die_again_and_again_end_the_grid(capfd):
    with pytest.raises(RuntimeError, match="workers died 3 times in a row"):
        parallel_map(cells.deadly, [1, 2], 2)
    assert capfd.readouterr().err.count("a worker died: its cells are run again") == 2


def test_a_killed_grid_leaves_no_process_and_goes_on_where_it_was(tmp_path):
    """Cells 0 to 3 are done at once, 4 and 5 take long; then the grid and its workers are killed."""
    call = "from pathlib import Path; from oracles import cells; from flexman_gym.common.parallel import parallel_map\n"
    call += f"if __name__ == '__main__': parallel_map(cells.counted, {{own}}, 2, Path({str(tmp_path / 'kept')!r}))"
    own = [(str(tmp_path), seed, seed >= 4) for seed in range(6)]
    (tmp_path / "study.py").write_text(call.format(own=own))
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    process = subprocess.Popen([sys.executable, "study.py"], env=environment, start_new_session=True)
    done = tmp_path / "done"
    while not done.exists() or len(done.read_text().split()) < 6 or len([*(tmp_path / "kept").glob("[!.]*")]) < 4:
        assert process.poll() is None
        time.sleep(0.05)
    process.send_signal(signal.SIGKILL)
    process.wait()
    for _ in range(100):
        if not subprocess.run(["pgrep", "-s", str(process.pid)], capture_output=True).stdout:
            break
        time.sleep(0.1)
    assert not subprocess.run(["pgrep", "-s", str(process.pid)], capture_output=True).stdout
    done.unlink()
    results = parallel_map(
        cells.counted, [(*each[:2], False) if each[2] else each for each in own], 1, tmp_path / "kept"
    )
    assert done.read_text().split() == ["4", "5"]
    assert bits(results) == bits(cells.waves((seed, 5)) for seed in range(6))


WORKERS = """import os
from oracles import cells
from flexman_gym.common.parallel import parallel_map
if __name__ == "__main__":
    before = dict(os.environ)
    print((parallel_map(cells.threads, [1, 2], 2), dict(os.environ) == before))"""


@pytest.mark.parametrize("given", [None, "2"])
def test_each_worker_has_one_thread_of_linear_algebra_unless_the_environment_gives_a_number(given, tmp_path):
    (tmp_path / "study.py").write_text(WORKERS)
    own = {name: value for name, value in os.environ.items() if name not in {"OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"}}
    own |= {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))} | ({"OMP_NUM_THREADS": given} if given else {})
    run = subprocess.run([sys.executable, "study.py"], env=own, capture_output=True, text=True, check=True)
    workers, unchanged = ast.literal_eval(run.stdout)
    assert {number for number, _ in workers} == {given or "1"} and unchanged
    assert given or {others for _, others in workers} == {0}, "threads beyond those of Python"


def test_what_other_sources_gave_is_not_kept(tmp_path, monkeypatch):
    [*parallel_map_unordered(cells.counted, [(str(tmp_path), 1, False)], 1, tmp_path / "kept")]
    monkeypatch.setattr(parallel, "computer_text", lambda: "another machine")
    [*parallel_map_unordered(cells.counted, [(str(tmp_path), 1, False)], 1, tmp_path / "kept")]
    assert (tmp_path / "done").read_text().split() == ["1", "1"]


def test_a_long_grid_says_what_is_left(monkeypatch, capsys):
    moments = iter([0.0, 5.0, 12.0, 13.0, 30.0])
    monkeypatch.setattr(progress, "monotonic", lambda: next(moments))
    parallel_map(cells.waves, CELLS[:4])
    assert capsys.readouterr().err == "2 of 4 cells, about 0.2 min left\n"


def test_workers_that_do_not_exist_are_refused():
    assert refusal(Workers, 0).startswith("jobs: 0 is not allowed; give a whole number from 1")
    assert refusal(Workers, 1, None, "pbs").startswith("submitit: 'pbs' is not allowed; give one of slurm, local")
    assert refusal(Workers, 1, "auto", "slurm").startswith(
        "ray: 'auto' is not allowed; give no Ray cluster together with submitit"
    )
