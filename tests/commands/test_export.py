"""Export: a run becomes a policy that acts as it did, and goes to ONNX with its normalisation."""

import json
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from flexman_agents.training import train
from flexman_gym.__main__ import main
from flexman_gym.common.run_folder import SETTINGS
from flexman_gym.evaluation import policy_files
from flexman_gym.evaluation.agents import find_agent
from flexman_gym.evaluation.metrics import evaluate
from flexman_gym.evaluation.policy_files import read_policy

from oracles import shipped as made
from oracles.mutants import policy
from oracles.runs import RUNS


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The run of a policy that has not learned yet."""
    folder = tmp_path_factory.mktemp("runs") / "own"
    folder.mkdir()
    for name, content in policy().items():
        (folder / name).write_bytes(content)
    settings = json.loads((folder / SETTINGS).read_text())
    (folder / SETTINGS).write_text(json.dumps({**settings, "versions": {"numpy": "2"}}))
    return folder


@pytest.mark.slow
def test_a_run_becomes_a_policy_that_reaches_the_same(run, tmp_path, capsys):
    words = [
        "export",
        "policy",
        str(run),
        str(tmp_path / "a"),
        "--description",
        "It has not learned.",
        "--recipe",
        "none",
    ]
    assert main(words) == 0 and "holds the policy: settled " in capsys.readouterr().out
    about = read_policy(tmp_path / "a").metadata
    one, other = find_agent(str(run)), find_agent(str(tmp_path / "a"))
    assert one.environment.to_plain() == other.environment.to_plain()
    figures = evaluate(one, one.environment, range(9000, 9100))
    assert figures == evaluate(other, one.environment, range(9000, 9100))
    row = {name: each for name, each in about["league"].items() if name in figures}
    assert row == {name: each if np.isfinite(each) else None for name, each in figures.items()}
    assert about["recipe"]["settings"]["seed"] == 2 and about["words"] == "It has not learned."
    assert main(words) == 2 and "give a new one" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("algo", ["tqc", "crossq"])
def test_a_policy_of_another_algorithm_is_exported_with_dense_layers_alone(algo, tmp_path):
    settings = replace(RUNS[algo], eval_every=0)
    model = train(settings, tmp_path / "run", progress=False)
    words = [str(tmp_path / "policy"), "--description", "It has not learned.", "--recipe", "none"]
    assert main(["export", "policy", str(tmp_path / "run"), *words]) == 0
    one, other = find_agent(str(tmp_path / "run")), find_agent(str(tmp_path / "policy"))
    seen = np.random.default_rng(0).normal(size=(40, model.observation_space.shape[0])).astype(np.float32)
    assert np.array_equal(one.law(seen), other.law(seen))
    normalised = model.get_vec_normalize_env().normalize_obs(seen)
    assert one.law(seen) == pytest.approx(model.predict(normalised, deterministic=True)[0], abs=1e-5)
    widths = settings.hyperparameters["net_arch"]["pi"]
    layers = read_policy(tmp_path / "policy").network.layers
    assert [len(bias) for _, bias in layers] == [*widths, 1]


def test_it_may_be_for_another_environment_with_what_acts_as_it_was(run, tmp_path):
    (tmp_path / "heavy.yaml").write_text("id: FlexOne-v0\nhorizon: 0.4\n")
    words = [
        "export",
        "policy",
        str(run),
        str(tmp_path / "a"),
        "--description",
        "W.",
        "--env",
        str(tmp_path / "heavy.yaml"),
    ]
    assert main(words) == 0
    about = read_policy(tmp_path / "a").metadata
    assert (about["environment"]["horizon"], about["environment"]["action_repeat"]) == (0.4, 3)
    assert about["recipe"]["settings"]["environment"]["horizon"] == 0.6


def test_a_name_is_no_path(run, tmp_path, monkeypatch, capsys):
    (tmp_path / "ppo-own").mkdir()
    monkeypatch.setattr(policy_files, "FOLDER", tmp_path)
    assert main(["export", "policy", str(run), "ppo-own", "--description", "W."]) == 2
    assert f"folder: '{tmp_path / 'ppo-own'}' is not allowed" in capsys.readouterr().err
    for wrong in ("..", "", "a b", "a-", "ppo-\N{SUPERSCRIPT TWO}", "a" * 300, "a\n"):
        assert main(["export", "policy", str(run), wrong, "--description", "W."]) == 2
        assert "name: " in capsys.readouterr().err


def test_a_graph_gives_the_actions_of_numpy(tmp_path, capsys):
    pytest.importorskip("onnx")
    from onnx import load
    from onnx.reference import ReferenceEvaluator

    network = made.acting(tmp_path, made.files()).law
    assert main(["export", "onnx", str(tmp_path), str(tmp_path / "a.onnx")]) == 0
    seen = np.random.default_rng(2).normal(0.0, 5.0, (9, network.size)).astype(np.float32)
    (actions,) = ReferenceEvaluator(load(tmp_path / "a.onnx")).run(None, {"observation": seen})
    assert actions == pytest.approx(network(seen), abs=1e-5) and np.abs(actions).max() == 1.0
    assert actions.dtype == np.float32 and "actions within" in capsys.readouterr().out
    assert main(["export", "onnx", "pd", str(tmp_path / "b.onnx")]) == 2
    assert "give a policy, or the run of one" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("name", ["lab-flexrrr", "shaping-flexrrr"])
def test_a_network_that_cannot_act_alone_is_refused_with_what_to_do(name, tmp_path, capsys):
    """Its output is no torque: a controller that is made for the arm turns it into one."""
    pytest.importorskip("onnx")
    assert main(["export", "onnx", name, str(tmp_path / "a.onnx")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"agent: '{name}' is not allowed; give a policy whose network acts alone, such as ")
    assert "controller" in line and f'fm.rollout("{name}", ' in line
    assert main(["export", "onnx", line.partition("such as ")[2].split(":")[0], str(tmp_path / "b.onnx")]) == 0
