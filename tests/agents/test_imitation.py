"""Imitation: a student of a law that it can say learns that law, and a teacher who leads is the teacher alone."""

import os
import signal
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

import flexman_gym as fm
from flexman_agents.callbacks import Interrupted
from flexman_agents.imitation import ACTION_SCALE, EMA_DECAY, DAgger
from flexman_agents.settings import DEFAULT_HYPERPARAMETERS, Settings
from flexman_agents.training import resume, train, train_or_resume
from flexman_gym.__main__ import main
from flexman_gym.common.run_folder import NEWEST, read_npz
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.agents import find_agent
from flexman_gym.evaluation.rollouts import rollout, training_seed
from flexman_gym.toolbox.interchange.policy_export import export_policy

from oracles.assertions import refusal
from oracles.runs import bits

STIFFNESS, DAMPING = 0.05, 0.02  # N m/rad, N m s/rad, soft enough for torques within the limit
TEACHER = {"kind": "pd", "stiffness": [STIFFNESS], "damping": [DAMPING]}
ENVIRONMENT = {"id": "FlexOne-v0", "sensors": ["servo"], "horizon": 0.8}
SHORT = Settings(
    "dagger", ENVIRONMENT, 3 * 4 * 40, seed=3, envs=4,
    hyperparameters={"teacher": TEACHER, "net_arch": [6], "updates": 5, "batch_size": 32},
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("base", [None, {"kind": "pd", "stiffness": [0.5 * STIFFNESS], "damping": [0.5 * DAMPING]}])
def test_a_student_without_hidden_layers_learns_the_gains_of_a_pd(base):
    """Torques are linear in what it sees, so that the best layer is the law, less what the base does already."""
    settings = replace(
        SHORT, environment={**ENVIRONMENT, "base": base}, steps=8 * 16 * 40, envs=16,
        hyperparameters={"teacher": TEACHER, "net_arch": [], "updates": 250, "batch_size": 64},
        schedules={"learning_rate": {"start": 0.05, "end": 0.0}},
    )  # fmt: skip
    imitation = DAgger(settings)
    assert imitation.learn(lambda steps, figures: False)
    policy = imitation.policy()
    spread = np.sqrt(policy["statistics"]["var"] + 1e-8)
    setup = settings.environment
    learned = (policy["policy"]["action_net.weight"][0] / spread)[:2] * setup.torque_limit[0]
    wanted = np.array([STIFFNESS, -DAMPING]) * (0.5 if base else 1.0)
    assert learned == pytest.approx(wanted, rel=0.01)


@pytest.mark.slow
def test_arms_that_the_teacher_leads_move_as_under_the_teacher_alone_and_their_notes_say_its_actions():
    settings = replace(
        SHORT, environment={**ENVIRONMENT, "base": {**TEACHER, "stiffness": [0.5 * STIFFNESS]}, "action_repeat": 2}
    )
    imitation = DAgger(settings)
    setup, student = settings.environment, imitation._student
    student.teacher_acts = np.ones(3, dtype=bool)
    led = rollout(imitation._agent(), Configuration("FlexOne-v0", {"horizon": 0.8}), range(3))
    alone = rollout(TEACHER, Configuration("FlexOne-v0", {"horizon": 0.8}), range(3))
    for name in ("tips", "actions", "torques"):
        assert getattr(led, name).tobytes() == getattr(alone, name).tobytes()
    notes = student.samples
    assert len(notes) == 20 and len(led.torques[0]) == 40  # actions last for two periods
    missing = 0.5 * STIFFNESS / setup.torque_limit[0] * np.array([seen[:, 0] for seen, _, _ in notes])
    wanted = np.array([better[:, 0] for _, better, _ in notes])
    assert wanted == pytest.approx(missing, abs=1e-6) and np.abs(wanted).max() > 0.01
    assert all(due.all() for _, _, due in notes)


@pytest.mark.parametrize("kept", [1, 2, 3])
def test_the_last_rounds_are_kept_and_every_second_instant_of_each(kept):
    """Of rounds that are even the first instant, the third and so on, of odd ones the others."""
    imitation, played = DAgger(replace(SHORT, hyperparameters={**SHORT.hyperparameters, "iterations_kept": kept})), []
    for number in range(4):
        imitation._collect(number)
        due = [(seen[begun], ACTION_SCALE * wanted[begun]) for seen, wanted, begun in imitation._student.samples]
        played.append([np.concatenate(part) for part in zip(*due[number % 2 :: 2], strict=True)])
        assert [len(seen) for seen, _, _ in imitation._iterations] == [len(seen) for seen, _ in played[-kept:]]
        for (seen, wanted, _), expected in zip(imitation._iterations, played[-kept:], strict=True):
            assert np.allclose(seen, expected[0], rtol=1e-6) and np.allclose(wanted, expected[1], rtol=1e-6)


def test_rounds_have_episodes_of_their_own(monkeypatch):
    seeds = []

    def heard(entrant, environment, those):
        seeds.extend(those)
        return rollout(entrant, environment, those)

    monkeypatch.setattr("flexman_agents.imitation.rollout", heard)
    assert DAgger(SHORT).learn(lambda steps, figures: False)
    first = training_seed(SHORT.seed)
    assert seeds == list(range(first, first + 3 * SHORT.envs))


def test_what_acts_is_a_mean_of_the_weights_in_which_older_ones_fade(monkeypatch):
    """Those before the last step count AVERAGED times as much as it left them, and those of the last one the rest."""
    weights, learned = [], DAgger._update

    def heard(imitation):
        loss = learned(imitation)
        weights.append(imitation._layers[-1].weight.detach().numpy().copy())
        return loss

    monkeypatch.setattr(DAgger, "_update", heard)
    imitation = DAgger(SHORT)
    assert imitation.learn(lambda steps, figures: False) and len(weights) == 3 * 5
    expected = weights[0]
    for each in weights[1:]:
        expected = EMA_DECAY * expected + (1.0 - EMA_DECAY) * each
    acts = ACTION_SCALE * imitation.policy()["policy"]["action_net.weight"]
    assert acts == pytest.approx(expected, rel=1e-5) and np.abs(acts - weights[-1]).max() > 1e-4


@pytest.mark.slow
def test_the_same_seed_has_the_same_bits_and_another_has_not(tmp_path):
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        train(SHORT.with_seed(seed), tmp_path / name, progress=False)
    assert bits(tmp_path / "a") == bits(tmp_path / "b") != bits(tmp_path / "c")


@pytest.mark.slow
def test_what_was_learned_acts_as_a_run_and_as_a_policy_that_is_shipped(tmp_path):
    train(SHORT, tmp_path / "run", progress=False)
    export_policy(tmp_path / "run", tmp_path / "policy", "A student of a PD.", "own")
    played = [rollout(str(tmp_path / name), SHORT.environment, range(2)).tips for name in ("run", "policy")]
    assert played[0].tobytes() == played[1].tobytes()
    moments = read_npz(tmp_path / "run" / NEWEST)["statistics"]
    assert np.ptp(moments["var"]) > 0.0 and find_agent(str(tmp_path / "run")).interface


def test_one_that_was_stopped_begins_again_and_one_that_is_finished_stays(tmp_path, capsys):
    train(SHORT, tmp_path / "whole", progress=False)
    train(SHORT, tmp_path / "part", progress=False, hook=lambda report: report.steps >= 160)
    assert not (tmp_path / "part" / NEWEST).exists()
    train_or_resume((SHORT, str(tmp_path / "part"), {"progress": False}))
    assert "starts from scratch" in capsys.readouterr().err and bits(tmp_path / "part") == bits(tmp_path / "whole")
    assert "is finished" in refusal(resume, tmp_path / "whole")
    assert refusal(resume, tmp_path / "whole", 480).startswith("steps: ")


def test_ctrl_c_stops_it_and_says_that_nothing_is_kept(tmp_path, monkeypatch):
    played = DAgger._collect

    def interrupted(self, number):
        if number == 0:
            os.kill(os.getpid(), signal.SIGINT)
        return played(self, number)

    monkeypatch.setattr(DAgger, "_collect", interrupted)
    with pytest.raises(Interrupted, match="stopped after 160 steps; an imitation saves nothing before its end"):
        train(SHORT, tmp_path, progress=False)
    assert not (tmp_path / NEWEST).exists()


@pytest.mark.slow
def test_the_command_line_imitates_a_controller(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(DEFAULT_HYPERPARAMETERS["dagger"], "updates", 5)
    told = ["imitate", "{kind: pd, stiffness: [0.05], damping: [0.02]}", "--env", "FlexOne-v0", "--set", "horizon=0.4"]
    assert main([*told, "--steps", "150", "--envs", "4", "--folder", str(tmp_path / "run")]) == 0
    captured = capsys.readouterr()
    assert "flexman evaluate" in captured.out and "160 of 160 steps: ep_rew_mean" in captured.err
    assert main(["evaluate", str(tmp_path / "run"), "--episodes", "2"]) == 0
    assert main([*told, "--algo", "ppo", "--folder", str(tmp_path / "other")]) == 2
    assert capsys.readouterr().err.startswith("algo: 'ppo' is not allowed")


def test_a_mode_of_torques_says_how_much_an_action_adds():
    """A current whose limit gives less than the torque limit adds less, or a student would learn a part of it."""
    motor = fm.Motor(50.0, 0.02, 1e-6, 0.7)
    arm = fm.catalog.one_link(rotor_inertia=motor.reflected_inertia)
    arm = replace(arm, joints=[replace(joint, motor=motor) for joint in arm.joints])
    for environment in (ENVIRONMENT, {**ENVIRONMENT, "arm": arm, "torque_limit": 2.0, "actions": "current"}):
        student = DAgger(replace(SHORT, environment=environment))._student
        mode = student._mode
        added = mode.act(np.full((1, 1), 0.5), {}, None, None) - mode.act(np.zeros((1, 1)), {}, None, None)
        assert added == pytest.approx(0.5 * np.broadcast_to(student._strength, (1, 1)))


def test_what_cannot_be_imitated_is_refused():
    base = {"kind": "privileged-lqr"}
    shaping = {**ENVIRONMENT, "id": "FlexRRR-v0", "base": base, "actions": "shaping"}
    assert refusal(DAgger, replace(SHORT, environment=shaping)).startswith("actions: ")
    travel = ENVIRONMENT | {"foundation": {"kind": "travel"}}
    assert refusal(DAgger, replace(SHORT, environment=travel)).startswith("foundation: 'travel'")
    assert "iterations_kept" in refusal(DAgger, replace(SHORT, hyperparameters={"gamma": 0.9}))
    for name, value in (("teacher", "nobody"), ("updates", 0), ("net_arch", "wide")):
        said = refusal(lambda name=name, value=value: replace(SHORT, hyperparameters={name: value}))
        assert said.startswith("base: " if name == "teacher" else f"hyperparameters.{name}: ")
    assert refusal(lambda: replace(SHORT, eval_every=10)).startswith("eval_every: ")
    quiet = {**ENVIRONMENT, "id": "FlexRRR-v0", "base": base, "sensors": [],
             "actions": {"kind": "shaping", "pace": 0.0, "offset": 0.0, "torque": 0.5, "fading": 0.0}}  # fmt: skip
    student = replace(SHORT, environment=quiet, hyperparameters={"teacher": base})
    assert DAgger(student)._student._strength == 0.5
