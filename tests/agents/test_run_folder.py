"""Folder: files are whole or not there, one process trains, what is broken is one line, and nothing runs."""

import json
import os
import subprocess
import sys
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from flexman_agents.sb3 import make_model
from flexman_agents.settings import Settings
from flexman_agents.training import resume, train
from flexman_gym.common.run_folder import LOCK, NEWEST, SETTINGS, lock_folder, read_npz, write_npz
from flexman_gym.evaluation.agents import find_agent

from oracles.assertions import refusal
from oracles.runs import RUNS


@pytest.mark.slow
def test_a_folder_is_trained_in_by_one_process(tmp_path, capsys):
    train(replace(RUNS["ppo"], eval_every=0), tmp_path, progress=False)
    held = "import sys; from pathlib import Path; from flexman_gym.common.run_folder import lock_folder\n" \
           f"with lock_folder(Path({str(tmp_path)!r})): print('held', flush=True); sys.stdin.read()"  # fmt: skip
    with subprocess.Popen([sys.executable, "-c", held], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout.readline() == b"held\n"
        assert refusal(resume, tmp_path, 10) == f"folder: {tmp_path} is not allowed; process {other.pid} trains in it"
        other.kill()
        other.wait()
    with lock_folder(tmp_path):
        assert (
            f"Process {other.pid}, which trained in {tmp_path}, has ended; this process takes over the folder."
            in capsys.readouterr().err
        )
    with lock_folder(tmp_path):
        assert capsys.readouterr().err == ""
    assert (tmp_path / LOCK).read_text() == ""


@pytest.mark.parametrize("name", [LOCK, ".newest.npz.part", ".settings.json.part", "progress.csv"])
def test_what_a_link_in_a_run_folder_points_to_stays(tmp_path, name):
    precious, folder = tmp_path / "precious", tmp_path / "run"
    precious.write_text("mine")
    folder.mkdir()
    (folder / name).symlink_to(precious)
    run = replace(RUNS["ppo"], eval_every=0, steps=24)
    if name == LOCK:
        assert "whose file lock is not a link" in refusal(lambda: train(run, folder, progress=False))
    else:
        train(run, folder, progress=False)
        assert read_npz(folder / NEWEST)
    assert precious.read_text() == "mine"


def test_of_two_trainings_for_one_new_folder_the_later_is_refused(tmp_path, monkeypatch):
    """The other one begins and ends while this one makes its model."""
    run, make = replace(RUNS["ppo"], eval_every=0, steps=24), make_model

    def slow(settings, device):
        monkeypatch.undo()
        train(run.with_seed(5), tmp_path, progress=False)
        return make(settings, device)

    monkeypatch.setattr("flexman_agents.training.make_model", slow)
    assert "give a new one, or resume the run" in refusal(lambda: train(run, tmp_path, progress=False))
    assert Settings.load(tmp_path).seed == 5


def test_arrays_that_are_packed_are_refused_before_they_take_memory(tmp_path):
    """A file that unpacks to a thousand times its size."""
    np.savez_compressed(tmp_path / "run.npz", **{"data.json": np.zeros(50_000_000, dtype=np.uint8)})
    assert (tmp_path / "run.npz").stat().st_size < 100_000
    tracemalloc.start()
    assert "its arrays are packed" in refusal(read_npz, tmp_path / "run.npz")
    assert tracemalloc.get_traced_memory()[1] < 1_000_000
    tracemalloc.stop()


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "run"
    train(replace(RUNS["ppo"], eval_every=0), folder, progress=False)
    return folder


class Bomb:
    """Says so when it is unpickled."""

    def __reduce__(self):
        return exec, ("import os; os.environ['FLEXMAN_BOMB'] = '1'",)


def test_nothing_that_is_read_runs(run, tmp_path):
    """A pickle among the arrays, and a pickle in place of them."""
    for name in (SETTINGS, NEWEST):
        (tmp_path / name).write_bytes((run / name).read_bytes())
    np.savez(tmp_path / "bomb.npz", **{"data.json": np.array([Bomb()], dtype=object)})
    np.array([Bomb()], dtype=object).dump(tmp_path / "bomb.pkl")
    for bomb in ("bomb.npz", "bomb.pkl"):
        (tmp_path / NEWEST).write_bytes((tmp_path / bomb).read_bytes())
        line = refusal(find_agent, str(tmp_path))
        assert "this is no file of a training run" in line and "FLEXMAN_BOMB" not in os.environ


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("/policy/action_net.bias", np.nan, "policy.action_net.bias: "),
        ("/statistics/var", -1.0, "statistics.var: "),
        ("/statistics/mean", np.inf, "statistics.mean: "),
    ],
)
def test_a_policy_of_no_numbers_is_refused(run, tmp_path, name, value, said):
    (tmp_path / SETTINGS).write_bytes((run / SETTINGS).read_bytes())
    with np.load(run / NEWEST) as result:
        arrays = {each: result[each] for each in result.files}
    arrays[name].flat[0] = value
    np.savez(tmp_path / NEWEST, **arrays)
    line = refusal(find_agent, str(tmp_path))
    assert line.startswith(f"{tmp_path / NEWEST}: {said}") and "give finite numbers" in line


def test_settings_that_are_arrays_are_other_ones(run, tmp_path):
    (tmp_path / SETTINGS).write_bytes((run / SETTINGS).read_bytes())
    data = read_npz(run / NEWEST)
    write_npz(tmp_path / NEWEST, data | {"settings": data["settings"] | {"seed": np.zeros(2)}})
    assert "different now are seed" in refusal(find_agent, str(tmp_path))


def test_a_folder_with_a_pickled_policy_alone_is_refused(run, tmp_path):
    """Its policy is the pickle model.zip; nothing reads it."""
    (tmp_path / SETTINGS).write_bytes((run / SETTINGS).read_bytes())
    (tmp_path / "model.zip").write_bytes(b"noise")
    with pytest.raises(FileNotFoundError, match="no such file; give a folder that a training run has written"):
        find_agent(str(tmp_path))


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("environment", lambda record: record["environment"].__setitem__("base", None)),
        ("envs", lambda record: record.__setitem__("envs", 7)),
        ("algo", lambda record: record.__setitem__("algo", "sac")),
        ("environment", lambda record: record["environment"]["arm"]["links"][0].__setitem__("length", 0.7)),
        ("seed", lambda record: record.__setitem__("seed", 8)),
    ],
)
def test_settings_that_were_changed_give_one_line(run, tmp_path, name, change):
    record = json.loads((run / SETTINGS).read_text())
    change(record)
    if name == "algo":
        record |= {"schedules": {}, "hyperparameters": {}}
    (tmp_path / SETTINGS).write_text(json.dumps(record))
    (tmp_path / NEWEST).write_bytes((run / NEWEST).read_bytes())
    for call in (lambda: find_agent(str(tmp_path)), lambda: resume(tmp_path, 20)):
        line = refusal(call)
        assert line.startswith(f"{tmp_path / SETTINGS}: this was changed") and name in line


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", "null", "[" * 100_000, '{"algo": "ppo"}', "\0", "\udcff"])
def test_broken_settings_give_one_line(run, tmp_path, text):
    (tmp_path / SETTINGS).write_bytes(text.encode("utf-8", errors="surrogateescape"))
    (tmp_path / NEWEST).write_bytes((run / NEWEST).read_bytes())
    assert "settings of a training run" in refusal(find_agent, str(tmp_path))


@pytest.mark.parametrize("seed", range(25))
def test_mutated_runs_give_one_line_or_act_as_they_did(run, tmp_path, seed):
    """Bytes that change, vanish or appear anywhere in a folder."""
    chance = np.random.default_rng(seed)
    for name in (SETTINGS, NEWEST):
        content = bytearray((run / name).read_bytes())
        for _ in range(chance.integers(0, 4)):
            place, kind = chance.integers(len(content)), chance.integers(3)
            if kind == 0:
                content[place] ^= 1 << int(chance.integers(8))
            elif kind == 1:
                del content[place : place + int(chance.integers(1, 40))]
            else:
                content[place:place] = chance.bytes(int(chance.integers(1, 40)))
        (tmp_path / name).write_bytes(content)
    seen = np.linspace(-1.0, 1.0, 3 * 32).reshape(3, 32).astype(np.float32)
    try:
        network = find_agent(str(tmp_path)).law
    except (ValueError, FileNotFoundError) as error:
        assert "\n" not in str(error) and str(tmp_path) in str(error)
    else:
        assert np.array_equal(network(seen), find_agent(str(run)).law(seen))


def test_broken_files_give_one_line(run, tmp_path):
    """Cut off, empty, noise, other networks, other names."""
    (tmp_path / SETTINGS).write_bytes((run / SETTINGS).read_bytes())
    whole, data = (run / NEWEST).read_bytes(), read_npz(run / NEWEST)
    noise = np.random.default_rng(0).bytes(500)
    for content in (b"", whole[: len(whole) // 2], noise, whole[:200] + noise + whole[700:]):
        (tmp_path / NEWEST).write_bytes(content)
        assert NEWEST in refusal(find_agent, str(tmp_path))
    first = "action_net.weight"
    for broken in (
        {**data, "policy": {**data["policy"], first: np.zeros(3, dtype=np.float32)}},
        {**data, "policy": {}},
        {**data, "statistics": {}},
        {"training": data["training"]},
        {**data, "settings": None},
    ):
        write_npz(tmp_path / NEWEST, broken)
        assert NEWEST in refusal(find_agent, str(tmp_path))
    for name in ("environment", "random", "optimizers", "last", "counts"):
        write_npz(tmp_path / NEWEST, {**data, "training": {**data["training"], name: {}}})
        assert NEWEST in refusal(resume, tmp_path, 20, 0, False), name
