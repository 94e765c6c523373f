"""Guard: the result of a run is the base controller if the policy settles less often."""

from dataclasses import replace

import pytest

import flexman_gym as fm
from flexman_agents import guard as module
from flexman_agents.guard import guard
from flexman_agents.sb3 import make_model
from flexman_agents.settings import ACTIONS_PER_SLEW, Settings, action_time, find_recipe
from flexman_agents.training import resume, train
from flexman_gym.common.run_folder import RESULT
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.agents import find_agent

from oracles.assertions import refusal

pytest.importorskip("stable_baselines3")

BASED = {"id": "FlexOne-v0", "base": "pd", "action_repeat": 5, "sensors": ["full", "fine"], "horizon": 4.0}
SHORT = Settings(
    environment=BASED, steps=64, envs=2, hyperparameters={"net_arch": [8], "n_steps": 32, "batch_size": 64}
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return the folder of a run that has learned nothing."""
    result = tmp_path_factory.mktemp("runs") / "ppo"
    train(SHORT, result, progress=False)
    return result


@pytest.fixture
def shares(monkeypatch):
    """Return a function that sets the shares of settled episodes of policy and base."""

    def set_shares(policy, base):
        monkeypatch.setattr(module, "_settled", lambda agent, _: base if agent.name == "base" else policy)

    return set_shares


@pytest.mark.slow
@pytest.mark.parametrize(("policy", "base", "taken"), [(0.2, 0.9, "base"), (0.9, 0.9, "policy"), (1.0, 0.9, "policy")])
def test_the_agent_of_a_run_is_the_better_one(folder, shares, policy, base, taken):
    shares(policy, base)
    report = guard(folder)
    found = find_agent(str(folder))
    assert f"{policy:.0%}" in report and f"{base:.0%}" in report
    assert (found.law is None) == (taken == "base") == (folder / RESULT).is_file()
    assert ("its base" in found.name) == (taken == "base")


@pytest.mark.slow
def test_a_worse_policy_is_kept_on_request_and_a_resumed_run_is_compared_anew(folder, shares):
    shares(0.1, 0.9)
    assert "kept" in guard(folder, keep_worse=True) and find_agent(str(folder)).law is not None
    guard(folder)
    assert find_agent(str(folder)).law is None
    resume(folder, steps=64, progress=False)
    assert find_agent(str(folder)).law is not None


@pytest.mark.slow
def test_an_untrained_policy_with_loud_actions_settles_less_than_its_base(folder):
    """Measured, not given: the episodes of the selection."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "SELECTION_SEEDS", range(5000, 5004))
        report = guard(folder)
    assert "its base pd 100%" in report


@pytest.mark.slow
def test_a_damaged_result_is_told_in_one_line(folder):
    (folder / RESULT).write_text("{}")
    assert RESULT in refusal(lambda: find_agent(str(folder)))
    (folder / RESULT).unlink()


def test_an_action_of_a_recipe_lasts_a_share_of_the_slews_of_the_arm():
    recipe = find_recipe("ppo_on_pd_minute")
    arm = recipe.environment.arm
    weak = replace(arm, joints=[replace(each, torque_limit=0.01 * each.torque_limit) for each in arm.joints])
    own = recipe.for_arm(weak).environment
    assert own.base == "pd" and own.derived and own.sensors == recipe.environment.sensors
    assert own.action_repeat * own.control_period == pytest.approx(action_time(own), abs=own.control_period / 2)
    assert ACTIONS_PER_SLEW * action_time(own) > 5.0 * ACTIONS_PER_SLEW * action_time(recipe.environment) / 2.0


def test_an_episode_of_the_training_lasts_eight_median_slews_and_an_evaluation_the_horizon(tmp_path):
    recipe = find_recipe("ppo_on_pd_minute")
    settings = recipe.for_arm(Configuration("FlexPlanar-v0").arm)
    slew = ACTIONS_PER_SLEW * action_time(settings.environment)
    assert settings.training_horizon == pytest.approx(8.0 * slew, rel=1e-2)
    assert settings.training_environment.horizon == settings.training_horizon < settings.environment.horizon
    assert recipe.training_horizon is None and recipe.training_environment is recipe.environment
    arms = make_model(replace(settings, envs=2), "cpu").env
    assert arms.get_attr("configuration")[0] == settings.training_environment
    for each in (settings, recipe):
        each.write(tmp_path, 0)
        assert Settings.load(tmp_path) == each
        assert ("training_horizon" in (tmp_path / "settings.json").read_text()) == (each is settings)
    text = "training_horizon: 3.0 is not allowed; give None for dagger"
    assert refusal(lambda: replace(find_recipe("lab_student"), training_horizon=3.0)) == text


def test_given_settings_of_a_recipe_for_an_arm_stay_and_the_others_follow_from_the_arm():
    recipe = find_recipe("lab_student")
    arm = recipe.environment.arm
    weak = replace(arm, joints=[replace(each, torque_limit=0.01 * each.torque_limit) for each in arm.joints])
    changes = ["horizon=3.0", "action_repeat=7", "history=[0.5, 2.0]", "randomisation.payload_mass=[0.0, 1.5]"]
    own = recipe.for_arm(weak, changes).environment
    assert (own.horizon, own.action_repeat, own.history) == (3.0, 7, (0.5, 2.0))
    assert own.randomised_ranges == recipe.environment.randomised_ranges | {"payload_mass": [0.0, 1.5]}
    assert own.derived.keys() == {"control_period", "limits", "slew_time"}
    bare = replace(arm, joints=[replace(each, torque_limit=None) for each in arm.joints])
    assert recipe.for_arm(bare, ["torque_limit=30.0"]).environment.torque_limit == (30.0,) * 3


def test_settings_of_the_file_of_an_environment_precede_those_of_a_recipe_but_for_the_agent(tmp_path):
    recipe, path = find_recipe("lab_student"), str(tmp_path / "own.yaml")
    given = {"control_period": 0.004, "sensors": "full", "base": "pd-torque", "randomisation": {"delay": (0, 1)}}
    Configuration("FlexPlanar-v0", {"arm": fm.catalog.vertical_2r(), "torque_limit": 20.0, **given}).save(path)
    own = recipe.for_arm(path).environment
    assert (own.id, own.control_period, own.torque_limit) == ("FlexPlanar-v0", 0.004, (20.0, 20.0))
    assert own.randomised_ranges == {"delay": [0, 1]}
    assert (own.base, own.sensors) == (recipe.environment.base, recipe.environment.sensors)


def test_times_and_payloads_of_a_laboratory_recipe_scale_with_the_arm():
    recipe = find_recipe("lab_student")
    arm = recipe.environment.arm
    own = recipe.for_arm(replace(arm, payload=replace(arm.payload, mass=1.0), links=[
        replace(each, area=1.01 * each.area) for each in arm.links])).environment  # fmt: skip
    assert own.randomised_ranges["payload_mass"] == pytest.approx([0.0, 2.0])
    assert len(own.history) == 3 and own.history[1] / own.history[0] == pytest.approx(4.0, rel=0.02)
