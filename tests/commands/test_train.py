"""Command lines: train, evaluate and tune do what they say, and say what is wrong in one line."""

import json

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from flexman_agents.settings import Settings
from flexman_gym.__main__ import main as flexman
from flexman_gym.common import files
from flexman_gym.common.run_folder import SETTINGS
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.toolbox.controllers import tuning as optimisation
from flexman_gym.toolbox.controllers.margins import has_margins

SMALL = ["--steps", "256", "--envs", "2", "--quiet"]


@pytest.fixture
def run(monkeypatch, capsys):
    """Calls a command with arguments; gives its exit code, what it printed and what it complained."""

    def call(script, *arguments):
        code = flexman([script, *map(str, arguments)])
        said = capsys.readouterr()
        return code, said.out, said.err

    return call


@pytest.mark.slow
def test_an_environment_file_and_changes_reach_the_run_and_its_evaluation(run, tmp_path):
    """Train on a file with a change, evaluate beside baselines; another change on the command line goes further."""
    files.write_data(tmp_path / "own.yaml", {"id": "FlexOne-v0", "horizon": 1.5, "base": "pd", "action_repeat": 5})
    folder = tmp_path / "run"
    code, out, _ = run("train", "--env", tmp_path / "own.yaml", "--set", "arm.payload.mass=0.2", "--seed", 4, *SMALL,
                       "--folder", folder)  # fmt: skip
    settings = Settings.load(folder)
    setup = settings.environment
    assert code == 0 and f"The run is in {folder}" in out
    assert (settings.seed, settings.steps, settings.envs, settings.algo) == (4, 256, 2, "ppo")
    assert (setup.arm.payload.mass, setup.base, setup.action_repeat, setup.id) == (0.2, "pd", 5, "FlexOne-v0")
    code, out, err = run("evaluate", folder, "pd", "zero", "--episodes", 2)
    assert code == 0 and err == ""
    assert out.startswith("2 episodes of FlexOne-v0 (arm, gains, horizon), the same for all")
    first, *others = [line.split()[0] for line in out.splitlines()[2:-1]]
    assert str(folder).endswith(first.removeprefix("...")) and others == ["pd", "zero"]
    other = run("evaluate", folder, "pd", "--episodes", 2, "--set", "horizon=1.2")[1]
    assert other.splitlines()[2:] != out.splitlines()[2:]


@pytest.mark.slow
def test_an_environment_without_what_its_recipe_learned_with_is_told(run, tmp_path):
    """A base that the file lacks is named; what the file or a change has is not."""
    files.write_data(tmp_path / "own.yaml", {"id": "FlexOne-v0", "action_repeat": 5})
    recipe = "train", "planar_ppo_on_pd", "--env", tmp_path / "own.yaml", "--set", "sensors=full", *SMALL
    _, _, said = run(*recipe, "--folder", tmp_path / "bare")
    assert said.startswith(f"{tmp_path / 'own.yaml'} lacks settings of the recipe: base: pd\n")
    _, _, said = run(*recipe, "--set", "base=pd", "--folder", tmp_path / "whole")
    assert "learned with" not in said


def test_several_seeds_are_several_runs_with_a_table_of_their_test_episodes(run, tmp_path):
    """A row for each seed, as `flexman evaluate` prints it, and one for all; others are refused before a run."""
    train = "train", "--env", "FlexOne-v0", "--set", "horizon=1.0", "--seed", 5, *SMALL, "--folder", tmp_path
    code, out, _ = run(*train, "--seeds", 2)
    assert code == 0
    assert [json.loads((tmp_path / f"seed-{i}" / SETTINGS).read_text())["seed"] for i in (5, 6)] == [5, 6]
    *known, everything, caption, last = out.splitlines()
    evaluated = run("evaluate", tmp_path / "seed-5", tmp_path / "seed-6")[1]
    assert [line.split() for line in [*known, caption]] == [line.split() for line in evaluated.splitlines()]
    assert known[0].startswith("100 episodes of FlexOne-v0")
    assert everything.startswith("all seeds ") and last.startswith("all seeds: intervals")
    times = {path: path.stat().st_mtime_ns for path in tmp_path.glob("*/newest.npz")}
    assert run(*train, "--seeds", 2)[:2] == (0, out), "runs that are done are evaluated again"
    (tmp_path / "seed-5" / SETTINGS).unlink()
    code, out, err = run(*train, "--seeds", 2, "--steps", 512, "--set", "horizon=1.5")
    assert (code, out) == (2, "") and not (tmp_path / "seed-5" / SETTINGS).exists()
    line = "is not allowed; give a new one: the run in it has different environment, steps"
    assert err.startswith("folder: ") and err.endswith(f" {line}\n")
    assert times == {path: path.stat().st_mtime_ns for path in tmp_path.glob("*/newest.npz")}


def test_a_recipe_is_a_start_and_options_go_before_it(run, tmp_path):
    files.write_data(
        tmp_path / "own.json", {"environment": {"id": "FlexOne-v0", "horizon": 1.0}, "steps": 10**6, "seed": 8}
    )
    run("train", tmp_path / "own.json", *SMALL, "--folder", tmp_path / "run")
    settings = Settings.load(tmp_path / "run")
    assert (settings.steps, settings.seed, settings.environment.horizon) == (256, 8, 1.0)


@pytest.mark.parametrize(
    ("script", "arguments", "line"),
    [
        ("evaluate", ["no_such_run"], "agent: no_such_run does not exist; give the folder of a training run"),
        ("evaluate", ["pd", "--env", "nowhere.yaml"], "environment: nowhere.yaml does not exist; give the path"),
        ("evaluate", ["pd", "--set", "horizon"], "--set: 'horizon' is not allowed; give name=value, such as"),
        ("evaluate", ["pd", "--set", "horizont=3"], "horizont: 3 is not allowed; give a setting: the nearest is"),
        (
            "evaluate",
            ["pd", "--set", "base=lqr"],
            "--set: 'base=lqr' is not allowed; give a setting of the environment",
        ),
        ("train", ["--steps", "0"], "steps: 0 is not allowed; give a whole number from 1"),
        ("train", ["no_recipe"], "recipe: no_recipe does not exist; give the path of a file, or one of "),
        ("train", ["--set", "action_repeat=0"], "action_repeat: 0 is not allowed; give a whole number from 1 to 1000"),
        ("train", ["--set", "base=pid"], "base: 'pid' is not allowed; give one of pd, pd-torque, lqr, lqr-tracking"),
        ("train", ["--device", "gpu"], "device: 'gpu' is not allowed; give a device that PyTorch finds"),
        ("train", ["--checkpoint-every", "-1"], "checkpoint_every: -1 is not allowed; give a whole number from 0"),
        ("train", ["--folder", "/dev/null/run"], "[Errno 20] Not a directory: '/dev/null/run"),
        ("train", ["--folder", 300 * "x"], "[Errno 36] File name too long"),
        ("train", ["--resume", "--envs", "3"], "envs: 3 is not allowed; give no value with --resume: a run keeps its"),
        ("train", ["--seeds", "0"], "seeds: 0 is not allowed; give a whole number from 1 to 1000"),
        ("train", ["--resume", "--seeds", "2"], "seeds: 2 is not allowed; give 1 with --resume; without it, killed"),
        ("train", ["--resume"], "no_folder/settings.json: no such file; give a folder that a training run has written"),
    ],
)
def test_what_is_wrong_is_one_line_and_leaves_no_folder(run, tmp_path, monkeypatch, script, arguments, line):
    monkeypatch.chdir(tmp_path)
    if script == "train" and "--folder" not in arguments:
        arguments = [*arguments, "--folder", "no_folder"]
    code, out, err = run(script, *arguments)
    assert (code, out) == (2, "") and err.startswith(line) and len(err.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_tuning_finds_gains_that_beat_most_and_finds_them_again(monkeypatch):
    """The best of a few: among the candidates, within their ranges, and the same every time."""
    seen, rewards = [], optimisation._gain_returns

    def watched(name, gains, episodes, workers):
        result = rewards(name, gains, episodes)
        seen.append((gains, result))
        return result

    monkeypatch.setattr(optimisation, "_gain_returns", watched)
    first, again = (optimisation.tune(Configuration("FlexOne-v0"), around=2, episodes=2, seed=1) for _ in range(2))
    assert first == again
    half = len(seen) // 2
    gains, result = (np.concatenate([part[i] for part in seen[:half]]) for i in (0, 1))
    assert first.reward == result.max() and np.array_equal(gains[result.argmax()], [*first.stiffness, *first.damping])


def test_tune_prints_the_line_for_a_file(run, monkeypatch):
    found = optimisation.TunedGains((31.26, 0.123), (7.0, 2.0), 9.0, optimisation.MIN_MARGINS)
    monkeypatch.setattr(optimisation, "tune", lambda *_, **__: found)
    _, out, _ = run("optimise", "gains", "FlexPlanar-v0")
    (line,) = (line for line in out.splitlines() if "file" in line)
    own = Configuration("FlexPlanar-v0", files.parse_yaml(line.partition(": ")[2]))
    assert own.pd_gains == {"stiffness": (31.3, 0.123), "damping": (7.0, 2.0)}


@pytest.mark.slow
def test_the_gains_in_the_catalog_are_better_than_gains_nearby_at_random():
    """Mean reward of 8 episodes, of all candidates with margins at once, as the search measures it."""
    pd, environment = NAMED_ENVIRONMENTS["FlexOne-v0"].pd, Configuration("FlexOne-v0")
    own = np.array([[*pd["stiffness"], *pd["damping"]]])
    others = own * np.random.default_rng(0).uniform(0.4, 1.6, (24, 2))
    loops = optimisation.PDDesign(environment).loops
    others = [each for each in others if has_margins(loops, each[:1], each[1:], optimisation.MIN_MARGINS)]
    result = optimisation._gain_returns(environment, np.vstack([own, *others]), 8)
    assert len(others) > 6 and (result.argmax() == 0 or result[0] > 0.99 * result.max())
