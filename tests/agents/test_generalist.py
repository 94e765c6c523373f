"""Training over random arms: drawn arms, their environments side by side, and resumption."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from flexman_agents.drawn_arms import FREQUENCY, JOINTS, PAYLOAD, REACH, draw_arm
from flexman_agents.generalist import FIRST_ARM, SLEWS, arm_environments
from flexman_agents.own_arm import fit_to_arm
from flexman_agents.sb3 import make_model
from flexman_agents.settings import Settings, find_recipe
from flexman_agents.training import resume, train
from flexman_agents.vector import JoinedVecEnv
from flexman_gym.common.run_folder import NEWEST, read_npz
from flexman_gym.envs.config.arm_settings import SHORTEST_PERIOD, arm_facts, arm_torque_limits, wanted_period
from flexman_gym.toolbox.controllers.arm_shaping_mode import ACTIONS_PER_SLEW
from studies.generalist.measure import ARMS

from oracles.assertions import refusal

RECIPE = find_recipe("generalist")
SMALL = replace(RECIPE, arms=2, envs=4, steps=64, value_warmup=0,
                hyperparameters={**RECIPE.hyperparameters, "n_steps": 8, "batch_size": 16})  # fmt: skip


@pytest.mark.parametrize("seed", range(FIRST_ARM, FIRST_ARM + 12))
def test_a_drawn_arm_is_as_documented(seed):
    arm = draw_arm(seed)
    facts = arm_facts(arm, arm_torque_limits(arm))
    assert arm == draw_arm(seed) != draw_arm(seed + 100)
    assert JOINTS[0] <= arm.n_joints <= JOINTS[1] and REACH[0] <= facts.reach <= REACH[1]
    assert FREQUENCY[0] <= 1.01 * facts.held[0] * facts.reach**0.5 <= 1.01**2 * FREQUENCY[1]
    assert PAYLOAD[0] <= arm.payload.mass / sum(link.mass for link in arm.links) <= PAYLOAD[1]
    assert wanted_period(facts) >= SHORTEST_PERIOD and (facts.holding < 1.0).all()


def test_arms_of_training_and_test_are_different():
    assert max(FIRST_ARM + i for i in range(RECIPE.arms)) < min(ARMS)


def test_the_environments_are_in_units_of_their_arms():
    first, second = arm_environments(RECIPE.environment, 2)
    assert first.arm == draw_arm(FIRST_ARM) and second.arm == draw_arm(FIRST_ARM + 1)
    for each in (first, second):
        periods = each.horizon / each.control_period
        assert periods == pytest.approx(SLEWS * ACTIONS_PER_SLEW * each.action_repeat)
        assert "delay" not in each.randomised_ranges and "payload_mass" in each.randomised_ranges
    assert refusal(lambda: arm_environments(replace(RECIPE).environment.replace(actions="torque"), 2)).startswith(
        "actions: 'torque' is not allowed; give {kind: shaping, units: arm}"
    )


def test_joined_arms_are_the_arms_alone():
    joined, alone = (make_model(SMALL).get_env().venv.venv for _ in range(2))
    assert isinstance(joined, JoinedVecEnv) and joined.num_envs == 4
    joined.seed(5)
    for i, part in enumerate(alone.parts):
        part.seed(5 + 2 * i)
    assert np.array_equal(joined.reset(), np.concatenate([part.reset() for part in alone.parts]))
    ended = 0
    for _ in range(40):
        actions = np.full((4, 1), 0.3, dtype=np.float32)
        observations, rewards, ends, infos = joined.step(actions)
        steps = [part.step(actions[:2]) for part in alone.parts]
        assert np.array_equal(observations, np.concatenate([step[0] for step in steps]))
        assert np.array_equal(rewards, np.concatenate([step[1] for step in steps]))
        assert np.array_equal(ends, np.concatenate([step[2] for step in steps])) and len(infos) == 4
        ended += int(ends.sum())
    assert ended == 4


def test_a_resumed_run_is_the_run_without_interruption(tmp_path):
    train(SMALL, tmp_path / "whole", progress=False)
    stops = iter([False, True])
    train(SMALL, tmp_path / "stopped", progress=False, hook=lambda report: next(stops))
    resume(tmp_path / "stopped", progress=False)
    whole, stopped = (read_npz(tmp_path / name / NEWEST) for name in ("whole", "stopped"))
    for each in (whole, stopped):
        for part in each["training"]["environment"]:
            del part["action_space"], part["single_action_space"]  # random states of unused spaces
        each["training"]["episodes"] = [row[:2] for row in each["training"]["episodes"]]  # without wall-clock times
    np.testing.assert_equal(whole, stopped)


def test_a_recipe_for_all_arms_is_not_fitted_to_one():
    text = "arm: a file is not allowed; give none: this recipe is trained over random arms, and its policy acts on any"
    assert refusal(lambda: fit_to_arm(RECIPE, "arm.yaml")) == text


def test_settings_of_a_training_over_arms_are_checked(tmp_path):
    SMALL.write(tmp_path, 0)
    assert Settings.load(tmp_path) == SMALL
    for name, value, text in (
        ("envs", 5, "envs: 5 is not allowed; give a multiple of the number of arms, 2"),
        ("eval_every", 8, "eval_every: 8 is not allowed; give 0 for a training over random arms"),
        ("training_horizon", 2.0, "training_horizon: 2.0 is not allowed; give None for a training over random arms"),
    ):
        assert refusal(lambda name=name, value=value: replace(SMALL, **{name: value})) == text
