"""Settings of a recipe for an arm of the user."""

import math
from dataclasses import replace

import pytest

import flexman_gym as fm
from flexman_agents.own_arm import ACTIONS_PER_SLEW, action_time, fit_to_arm
from flexman_agents.sb3 import make_model
from flexman_agents.settings import Settings, find_recipe
from flexman_gym.envs.config.arm_settings import arm_facts
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.agent_spec import split_interface
from flexman_gym.evaluation.metrics import evaluate
from flexman_gym.evaluation.rollouts import SELECTION_SEEDS

from oracles.assertions import refusal

pytest.importorskip("stable_baselines3")


def test_an_action_of_a_recipe_lasts_a_share_of_the_slews_of_the_arm():
    recipe = find_recipe("ppo_on_pd_minute")
    arm = recipe.environment.arm
    weak = replace(arm, joints=[replace(each, torque_limit=0.01 * each.torque_limit) for each in arm.joints])
    own = fit_to_arm(recipe, weak).environment
    assert own.base == "pd" and own.derived and own.sensors == recipe.environment.sensors
    assert own.action_repeat * own.control_period == pytest.approx(action_time(own), abs=own.control_period / 2)
    assert ACTIONS_PER_SLEW * action_time(own) > 5.0 * ACTIONS_PER_SLEW * action_time(recipe.environment) / 2.0


def test_an_episode_of_the_training_lasts_twice_the_settling_time_of_the_base_and_an_evaluation_the_horizon(tmp_path):
    recipe = find_recipe("ppo_on_pd_minute")
    settings = fit_to_arm(recipe, Configuration("FlexPlanar-v0").arm)
    own = settings.environment
    bare, _ = split_interface(own)
    time = evaluate("pd", bare, seeds=SELECTION_SEEDS[:20])["settling_time"]
    assert settings.training_horizon == pytest.approx(max(2.0 * time, 48.0 * action_time(own)), rel=1e-2)
    assert settings.training_environment.horizon == settings.training_horizon < own.horizon
    assert recipe.training_horizon is None and recipe.training_environment is recipe.environment
    arms = make_model(replace(settings, envs=2), "cpu").env
    assert arms.get_attr("configuration")[0] == settings.training_environment
    for each in (settings, recipe):
        each.write(tmp_path, 0)
        assert Settings.load(tmp_path) == each
        assert ("training_horizon" in (tmp_path / "settings.json").read_text()) == (each is settings)
    text = "training_horizon: 3.0 is not allowed; give None for dagger"
    assert refusal(lambda: replace(find_recipe("lab_student"), training_horizon=3.0)) == text


@pytest.mark.parametrize("changes", [["base=null"], ["task=hold"]])
def test_an_episode_of_the_training_without_settling_time_of_a_base_lasts_eight_median_slews(changes):
    settings = fit_to_arm(find_recipe("ppo_on_pd_minute"), Configuration("FlexPlanar-v0").arm, changes)
    slew = ACTIONS_PER_SLEW * action_time(settings.environment)
    assert settings.training_horizon == pytest.approx(8.0 * slew, rel=1e-2)


@pytest.mark.parametrize("recipe", ["ppo_on_pd_minute", "planar_ppo_on_pd"])
def test_random_actions_are_in_proportion_to_the_torques_of_a_slew(recipe):
    recipe = find_recipe(recipe)
    arm = Configuration("FlexPlanar-v0").arm
    strong = replace(arm, joints=[replace(each, torque_limit=100.0 * each.torque_limit) for each in arm.joints])
    found = fit_to_arm(recipe, strong)
    share = arm_facts(strong, found.environment.torque_limit, found.environment.slew_span).torque_share
    assert share < 0.1
    for name in ("start", "end"):
        if schedule := recipe.schedules.get("log_std"):
            assert found.schedules["log_std"][name] == pytest.approx(schedule[name] + math.log(share), abs=0.01)
    if value := recipe.hyperparameters.get("log_std_init"):
        assert found.hyperparameters["log_std_init"] == pytest.approx(value + math.log(share), abs=0.01)
        assert found.hyperparameters["ent_coef"] > 0.0


def test_given_settings_of_a_recipe_for_an_arm_stay_and_the_others_follow_from_the_arm():
    recipe = find_recipe("lab_student")
    arm = recipe.environment.arm
    weak = replace(arm, joints=[replace(each, torque_limit=0.01 * each.torque_limit) for each in arm.joints])
    changes = ["horizon=3.0", "action_repeat=7", "history=[0.5, 2.0]", "randomisation.payload_mass=[0.0, 1.5]"]
    own = fit_to_arm(recipe, weak, changes).environment
    assert (own.horizon, own.action_repeat, own.history) == (3.0, 7, (0.5, 2.0))
    assert own.randomised_ranges == recipe.environment.randomised_ranges | {"payload_mass": [0.0, 1.5]}
    assert own.derived.keys() == {"control_period", "limits", "slew_time"}
    bare = replace(arm, joints=[replace(each, torque_limit=None) for each in arm.joints])
    assert fit_to_arm(recipe, bare, ["torque_limit=30.0"]).environment.torque_limit == (30.0,) * 3


def test_settings_of_the_file_of_an_environment_precede_those_of_a_recipe_but_for_the_agent(tmp_path):
    recipe, path = find_recipe("lab_student"), str(tmp_path / "own.yaml")
    given = {"control_period": 0.004, "sensors": "full", "base": "pd-torque", "randomisation": {"delay": (0, 1)}}
    Configuration("FlexPlanar-v0", {"arm": fm.catalog.vertical_2r(), "torque_limit": 20.0, **given}).save(path)
    own = fit_to_arm(recipe, path).environment
    assert (own.id, own.control_period, own.torque_limit) == ("FlexPlanar-v0", 0.004, (20.0, 20.0))
    assert own.randomised_ranges == {"delay": [0, 1]}
    assert (own.base, own.sensors) == (recipe.environment.base, recipe.environment.sensors)


def test_gains_in_the_file_of_an_environment_are_those_of_the_training(tmp_path):
    path, gains = str(tmp_path / "own.yaml"), {"stiffness": (7.0, 3.0), "damping": (2.0, 1.0)}
    Configuration("FlexPlanar-v0", {"arm": fm.catalog.vertical_2r(), "torque_limit": 20.0, "gains": gains}).save(path)
    own = fit_to_arm(find_recipe("ppo_on_pd_minute"), path).environment
    assert own.pd_gains == gains and own.base == "pd"


def test_times_and_payloads_of_a_laboratory_recipe_scale_with_the_arm():
    recipe = find_recipe("lab_student")
    arm = recipe.environment.arm
    own = fit_to_arm(recipe, replace(arm, payload=replace(arm.payload, mass=1.0), links=[
        replace(each, area=1.01 * each.area) for each in arm.links])).environment  # fmt: skip
    assert own.randomised_ranges["payload_mass"] == pytest.approx([0.0, 2.0])
    assert len(own.history) == 3 and own.history[1] / own.history[0] == pytest.approx(4.0, rel=0.02)
