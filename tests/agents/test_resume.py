"""Resume: a run that was interrupted and goes on is the run that was not, in every bit."""

import csv
import json
import os
import random
import signal
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")
from tensorboard.backend.event_processing import event_accumulator

from flexman_agents.callbacks import STEPS_COLUMN, Interrupted, open_logger
from flexman_agents.training import resume, train
from flexman_agents.vector import SB3VecEnv
from flexman_gym.common.run_folder import BEST, NEWEST, SETTINGS, read_npz, write_npz
from flexman_gym.evaluation.agents import find_agent
from studies.faults import same

from oracles.assertions import refusal
from oracles.runs import RUNS


@pytest.fixture(autouse=True)
def few_episodes(monkeypatch):
    monkeypatch.setattr("flexman_agents.callbacks.SELECTION_SEEDS", range(5000, 5002))


@pytest.fixture
def interrupt(monkeypatch):
    """Lets Ctrl-C arrive during the step of that number."""
    step_wait = SB3VecEnv.step_wait

    def at(number):
        steps = iter(range(10**6))

        def step(self):
            if next(steps) == number:
                os.kill(os.getpid(), signal.SIGINT)
            random.random()  # Python's generator has a state to restore
            return step_wait(self)

        monkeypatch.setattr(SB3VecEnv, "step_wait", step)

    return at


@pytest.mark.slow
@pytest.mark.parametrize("algo", RUNS)
def test_a_run_that_was_interrupted_twice_is_the_run_that_was_not(algo, tmp_path, interrupt, capsys):
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    interrupt(-1)
    train(RUNS[algo], whole, progress=False)
    interrupt(19)
    with pytest.raises(Interrupted, match=r"stopped after \d+ steps; the run is saved"):
        train(RUNS[algo], parts, progress=False)
    assert "Stopping after this rollout; press Ctrl-C again" in capsys.readouterr().err
    done = read_npz(parts / NEWEST)["training"]["counts"]["num_timesteps"]
    assert 57 <= done <= 75
    np.random.seed(99)  # noqa: NPY002, what happens in between does not matter
    random.seed(99)
    interrupt(11)
    with pytest.raises(Interrupted):
        resume(parts, progress=False)
    interrupt(-1)
    resume(parts, progress=False)
    assert same(whole, parts)
    assert read_npz(whole / NEWEST)["training"]["counts"]["num_timesteps"] >= RUNS[algo].steps
    assert (whole / BEST).read_bytes() != b"" and sorted(read_npz(whole / BEST)) == sorted(read_npz(parts / BEST))
    seen = np.linspace(-1.0, 1.0, 3 * 32).reshape(3, 32).astype(np.float32)
    one, other = (find_agent(folder).law(seen) for folder in (whole, parts))
    assert np.array_equal(one, other)


@pytest.mark.slow
def test_a_memory_that_is_full_is_drawn_from_whole_after_a_resumption(tmp_path, interrupt):
    """It holds eight rows of three arms; the run stops in the fourteenth of twenty."""
    chosen = {"learning_starts": 12, "batch_size": 8, "buffer_size": 24, "net_arch": [8]}
    settings = replace(RUNS["sac"], steps=60, hyperparameters=chosen, eval_every=0)
    interrupt(-1)
    train(settings, tmp_path / "whole", progress=False)
    interrupt(13)
    with pytest.raises(Interrupted):
        train(settings, tmp_path / "run", progress=False)
    assert read_npz(tmp_path / "run" / NEWEST)["training"]["replay"]["full"]
    interrupt(-1)
    resume(tmp_path / "run", progress=False)
    assert same(tmp_path / "whole", tmp_path / "run")


@pytest.mark.slow
def test_a_run_that_was_interrupted_before_its_first_rollout_goes_on(tmp_path, monkeypatch):
    train(RUNS["ppo"], tmp_path / "whole", progress=False)
    with monkeypatch.context() as patch:
        patch.setattr(
            "flexman_agents.training.open_logger",
            lambda *where: (os.kill(os.getpid(), signal.SIGINT), open_logger(*where))[1],
        )
        with pytest.raises(Interrupted, match="stopped after 0 steps"):
            train(RUNS["ppo"], tmp_path / "run", progress=False)
    resume(tmp_path / "run", progress=False)
    assert same(tmp_path / "whole", tmp_path / "run")


@pytest.mark.slow
def test_a_run_whose_last_steps_were_lost_repeats_them(tmp_path):
    """Saved on the way and then gone on with twice: the second time finds the same."""
    train(RUNS["ppo"], tmp_path / "whole", progress=False)
    saved = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "flexman_agents.training.write_npz",
            lambda path, data: saved.append(path) or write_npz(path, data) if len(saved) < 2 else None,
        )
        train(RUNS["ppo"], tmp_path / "run", checkpoint_every=24, progress=False)
    assert read_npz(tmp_path / "run" / NEWEST)["training"]["counts"]["num_timesteps"] < 160
    resume(tmp_path / "run", progress=False)
    assert same(tmp_path / "whole", tmp_path / "run")


@pytest.mark.slow
def test_a_run_that_was_killed_before_it_kept_anything_begins_again(tmp_path, capsys):
    train(RUNS["ppo"], tmp_path / "whole", progress=False)
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / SETTINGS).write_bytes((tmp_path / "whole" / SETTINGS).read_bytes())
    resume(tmp_path / "run", progress=False)
    assert "Nothing was saved" in capsys.readouterr().err
    assert same(tmp_path / "whole", tmp_path / "run")


def test_pressed_twice_it_stops_at_once_and_what_was_saved_stays(tmp_path, interrupt, monkeypatch):
    interrupt(13)
    step, before = SB3VecEnv.step_wait, signal.getsignal(signal.SIGINT)
    monkeypatch.setattr(SB3VecEnv, "step_wait", lambda self: (step(self), os.kill(os.getpid(), signal.SIGINT))[0])
    with pytest.raises(KeyboardInterrupt):
        train(RUNS["ppo"], tmp_path / "run", checkpoint_every=24, progress=False)
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.slow
def test_steps_belong_to_a_finished_run_only(tmp_path, interrupt):
    interrupt(10)
    with pytest.raises(Interrupted):
        train(RUNS["ppo"], tmp_path / "run", progress=False)
    line = refusal(resume, tmp_path / "run", 100)
    assert line.startswith("steps: 100 is not allowed; give no steps: the run in") and "has 48 of its 160 steps" in line
    interrupt(-1)
    resume(tmp_path / "run", progress=False)
    assert "that in" in refusal(resume, tmp_path / "run") and "is finished" in refusal(resume, tmp_path / "run")


def steps_of(path):
    """The steps of each row of a file of curves."""
    with path.open(newline="") as file:
        return [int(row[STEPS_COLUMN]) for row in csv.DictReader(file) if row[STEPS_COLUMN]]


@pytest.mark.slow
def test_curves_of_a_run_whose_last_steps_were_lost_do_not_overlap(tmp_path, monkeypatch):
    """Saved after 72 steps, killed after 160, resumed: each number of steps is in one row of one file."""
    saved, run = [], tmp_path / "run"
    with monkeypatch.context() as patch:
        patch.setattr(
            "flexman_agents.training.write_npz",
            lambda path, data: saved.append(path) or write_npz(path, data) if len(saved) < 3 else None,
        )
        train(RUNS["ppo"], run, checkpoint_every=24, progress=False)
    done = read_npz(run / NEWEST)["training"]["counts"]["num_timesteps"]
    assert max(steps_of(run / "progress.csv")) > done > 0
    resume(run, progress=False)
    first, second = steps_of(run / "progress.csv"), steps_of(run / f"progress-{done}.csv")
    assert max(first) <= done < min(second) and max(second) >= 160
    train(RUNS["ppo"], tmp_path / "whole", progress=False)
    assert sorted({*first, *second}) == sorted({*steps_of(tmp_path / "whole" / "progress.csv")})
    events = event_accumulator.EventAccumulator(str(run)).Reload()
    shown = [event.step for event in events.Scalars("train/loss")]
    assert shown == sorted({*shown}), "TensorBoard hides what was lost"


@pytest.mark.slow
def test_curves_of_another_run_in_the_folder_stay_apart(tmp_path):
    train(RUNS["ppo"], tmp_path, progress=False)
    before = (tmp_path / "progress.csv").read_bytes()
    for count in (1, 2):
        resume(tmp_path, 48, progress=False)
        assert len(list(tmp_path.glob("progress*.csv"))) == len([*tmp_path.glob("after-*")]) + 1 == count + 1
    assert (tmp_path / "progress.csv").read_bytes() == before


@pytest.mark.slow
def test_versions_that_changed_are_said_and_kept(tmp_path, interrupt, monkeypatch, capsys):
    interrupt(10)
    with pytest.raises(Interrupted):
        train(RUNS["ppo"], tmp_path, progress=False)
    before = json.loads((tmp_path / SETTINGS).read_text())
    assert {"numpy", "scipy", "numba", "torch", "python"} <= before["versions"].keys()
    interrupt(-1)
    monkeypatch.setattr("flexman_agents.settings.version", lambda name: "9.9" if name == "scipy" else "1.0")
    resume(tmp_path, progress=False)
    said, after = capsys.readouterr().err, json.loads((tmp_path / SETTINGS).read_text())
    assert f"scipy 9.9 instead of {before['versions']['scipy']}" in said and "python" not in said
    assert after["versions"]["scipy"] == "9.9"
    assert after["earlier_versions"] == [before["versions"] | {"until_step": 48}]
    capsys.readouterr()
    resume(tmp_path, 24, progress=False)
    assert "instead of" not in capsys.readouterr().err
    assert json.loads((tmp_path / SETTINGS).read_text())["earlier_versions"] == after["earlier_versions"]


def test_versions_of_every_part_of_a_run_are_kept(tmp_path, monkeypatch):
    """Three parts, each with other versions."""
    for part in range(3):
        monkeypatch.setattr("flexman_agents.settings.version", lambda name, part=part: f"{part}.0")
        run = replace(RUNS["ppo"], steps=24, eval_every=0)
        resume(tmp_path, 24, progress=False) if part else train(run, tmp_path, progress=False)
    record = json.loads((tmp_path / SETTINGS).read_text())
    assert [each["numpy"] for each in [*record["earlier_versions"], record["versions"]]] == ["0.0", "1.0", "2.0"]


def test_a_file_whose_name_has_no_steps_is_left_alone(tmp_path):
    for name in ("progress-\N{SUPERSCRIPT TWO}.csv", f"progress-{'9' * 200}.csv", "progress-x.csv"):
        (tmp_path / name).write_text(f"{STEPS_COLUMN}\n900\n")
    open_logger(tmp_path, 0, 100).close()
    assert all(
        path.read_text() == f"{STEPS_COLUMN}\n900\n"
        for path in tmp_path.glob("progress-?*.csv")
        if "100" not in path.name
    )
