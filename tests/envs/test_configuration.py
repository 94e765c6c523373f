"""Configuration: an environment as plain data, from files, mappings and changes, and the same episode everywhere."""

import json

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import flexman_gym as fm
from flexman_gym.agent.pd import PD
from flexman_gym.common import files
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.envs.config.settings import SETTINGS
from flexman_gym.scene.serialization import find_arm, to_plain

from oracles.assertions import refusal
from oracles.chains import QUICK

OWN = {
    "id": "FlexPlanar-v0", "arm": {"catalog": "vertical_2r", "payload": {"mass": 0.25}}, "horizon": 0.3,
    "action_repeat": 2, "base": "pd", "sensors": ["full", "fine"],
    "task": {"kind": "slew", "reward": "distance", "start": 0.4},
    "limits": {"rate": 15.0}, "randomisation": {"delay": [0, 2], "sensor_noise": [0.0, 0.01]}, "modes": [2, 1],
}  # fmt: skip
ranges = st.tuples(st.floats(0.1, 1.0), st.floats(1.0, 2.0)).map(list)
PARTS = {
    "task": st.just("slew") | st.fixed_dictionaries(
        {"kind": st.just("slew")},
        optional={"start": st.floats(0.0, 1.0), "reward": st.sampled_from(["bells", "distance"])},
    ),
    "sensors": st.sampled_from(["full", "fine", ["full", "fine"], ["state"]]),
    "limits": st.fixed_dictionaries({}, optional={"rate": st.floats(1.0, 20.0), "twist": st.floats(0.1, 1.0)}),
    "torque_limit": st.floats(0.1, 100.0),
    "control_period": st.sampled_from([0.01, 0.02, 0.05]),
    "horizon": st.floats(0.1, 20.0),
    "base": st.sampled_from(["pd", "lqr", "lqr-tracking"]),
    "action_repeat": st.integers(1, 9),
    "elements": st.integers(1, 3),
    "modes": st.integers(0, 3) | st.none() | st.just("assembled"),
    "method": st.sampled_from(["ros2", "rk4"]),
    "stiffening": st.booleans(),
    "randomisation": st.fixed_dictionaries(
        {}, optional={"payload_mass": ranges, "delay": st.just([0, 3]), "impulse_gap": st.just(1.0)}
    ),
}  # fmt: skip


def like(setup):
    """What two setups have in common where they mean the same: sensors by their kind, all else by its value."""
    hidden = ("sensors", "modes", "elements", "_given")
    values = {name: value for name, value in vars(setup).items() if name not in hidden}
    return values, [type(sensor) for sensor in setup.sensors]


# There and back


@pytest.mark.feature
@pytest.mark.slow
@settings(QUICK, max_examples=60)
@given(st.sampled_from(sorted(NAMED_ENVIRONMENTS)), st.fixed_dictionaries({}, optional=PARTS))
def test_the_whole_of_a_description_describes_the_same_environment(name, parts):
    """Through JSON, too; and so does the mapping that is made from the setup itself."""
    first = Configuration.from_plain({"id": name, **parts})
    setup = first
    for whole in (first.to_plain(), gym.make(name, **first.keywords()).unwrapped.configuration.to_plain()):
        again = Configuration.from_plain(json.loads(json.dumps(whole)))
        assert like(again) == like(setup)
        assert again.modes == setup.modes and again.elements == setup.elements
        assert again.to_plain() == Configuration.from_plain(again.to_plain()).to_plain()
    assert first.to_plain()["arm"] == to_plain(setup.arm)


@pytest.mark.parametrize("suffix", [".yaml", ".json"])
def test_a_file_is_a_mapping_and_its_whole_needs_no_other_file(tmp_path, suffix):
    arm = fm.catalog.vertical_2r(fm.Payload(0.33))
    files.write_data(tmp_path / "arm.yaml", to_plain(arm))
    files.write_data(tmp_path / f"own{suffix}", OWN | {"arm": "arm.yaml"})
    result = Configuration.load(tmp_path / f"own{suffix}")
    assert result.arm == arm and result.id == "FlexPlanar-v0"
    whole = result.to_plain()
    (tmp_path / "arm.yaml").unlink()
    assert like(Configuration.from_plain(whole)) == like(Configuration.from_plain(OWN | {"arm": to_plain(arm)}))


def test_an_arm_is_a_name_a_mapping_a_file_of_an_arm_or_of_a_scene(tmp_path):
    arm = fm.catalog.paper_rrr()
    files.write_data(tmp_path / "arm.yaml", to_plain(arm))
    fm.catalog.paper_scene("ff").save(tmp_path / "scene.json")
    for value in ("paper_rrr", {"catalog": "paper_rrr"}, to_plain(arm), "arm.yaml", "scene.json"):
        assert find_arm(value, tmp_path) == arm, value
    heavy = {"catalog": "paper_rrr", "payload": {"mass": 3.0}, "rotor_inertia": 10.0}
    assert find_arm(heavy) == fm.catalog.paper_rrr(payload=fm.Payload(3.0), rotor_inertia=10.0)


# Changes


def test_changes_lead_into_mappings_and_into_the_arm_and_change_nothing_else():
    kept = json.dumps(OWN)
    before = Configuration.from_plain(OWN)
    after = before.changed(
        ["control_period=0.02", "arm.payload.mass=0.5", "task.start=0.1", "randomisation.delay=[1, 1]"]
    )
    one, other = before, after
    assert (other.control_period, other.arm.payload.mass, other.task.start) == (0.02, 0.5, 0.1)
    assert other.randomisation.delay == (1, 1) and other.randomisation.sensor_noise == (0.0, 0.01)
    assert other.arm.links == one.arm.links and other.task.reward == "distance" and other.limits == one.limits
    assert before.given == {name: value for name, value in OWN.items() if name != "id"}, "the first one stays"
    assert json.dumps(OWN) == kept, "and so do the mappings that it was made from"
    assert like(before.changed([])) == like(one)


@pytest.mark.parametrize(
    ("change", "read", "value"),
    [
        ("step=1e-3", lambda setup: setup.step, 0.001),
        ("step=0.004", lambda setup: setup.step, 0.004),
        ("stiffening=true", lambda setup: setup.stiffening, True),
        ("method=rk4", lambda setup: setup.method, "rk4"),
        ("modes=[1, 2]", lambda setup: setup.modes, (1, 2)),
        ("modes=[[0, 2], 1]", lambda setup: setup.modes, ((0, 2), 1)),
        ("modes=null", lambda setup: setup.modes, None),
        ("id=FlexOne-v0", lambda setup: setup.id, "FlexOne-v0"),
        ("arm.gravity=[0, 0, -1.62]", lambda setup: setup.arm.gravity, (0.0, 0.0, -1.62)),
        ("arm.payload=null", lambda setup: setup.arm.payload, None),
        ("task.reward=bells", lambda setup: setup.task, fm.Slew(reward="bells")),
        ("limits.angle=3", lambda setup: setup.limits, fm.Limits(3.0, 20.0, 0.5, 0.25, 20.0, 20.0)),
    ],
)
def test_values_are_those_of_a_file_and_what_the_named_environment_has_stays(change, read, value):
    assert read(Configuration("FlexPlanar-v0").changed([change])) == value


def test_changes_may_be_whole_only_together():
    """An arm without torque limits, a part of it, and limits."""
    setup = Configuration().changed(["arm=planar_2r", "arm.payload={mass: 0.1}", "torque_limit=3"])
    assert (setup.arm.payload, setup.torque_limit) == (fm.Payload(0.1), (3.0, 3.0))
    other = Configuration().changed(["id=FlexOne-v0", "arm.payload.mass=0.2", "limits.angle=3"])
    assert other.arm == fm.catalog.one_joint(fm.Payload(0.2)) and other.limits.twist == 0.5


# What is wrong


@pytest.mark.parametrize("change", ["horizon", "=3", "a.=3", "a b=3", "arm.links.0.length=3", "step={", "step=&a 3"])
def test_a_change_that_is_none_is_shown(change):
    assert refusal(Configuration().changed, [change]).startswith(f"--set: {change!r} is not allowed; give ")


def test_objects_of_ones_own_cannot_be_described():
    class Nothing:
        sensors, moves = (), False
        draw = goal = reward_terms = info = lambda *arguments: {}

    assert refusal(Configuration(settings={"task": Nothing()}).to_plain).startswith("task: <")
    assert refusal(Configuration(settings={"base": PD([1.0] * 3, [1.0] * 3, 400.0)}).to_plain).startswith(
        "base: <flexman_gym.agent.pd.PD"
    )


# Parsed once


@pytest.fixture
def parsed(monkeypatch):
    """The configurations that were parsed."""
    result, parse = [], Configuration.__init__
    monkeypatch.setattr(Configuration, "__init__", lambda self, *given: (result.append(given), parse(self, *given))[1])
    return result


def test_an_environment_parses_its_configuration_once_and_takes_one_as_it_is(parsed):
    env = gym.make("FlexOne-v0", base="pd").unwrapped
    assert len(parsed) == 1
    other = gym.make_vec("FlexOne-v0", 2, "vector_entry_point", **env.configuration.keywords()).unwrapped
    assert len(parsed) == 1 and other.configuration is env.configuration
    changed = gym.make("FlexOne-v0", **env.configuration.keywords(), horizon=1.0).unwrapped.configuration
    assert len(parsed) == 2 and (changed.base, changed.horizon, env.configuration.horizon) == ("pd", 1.0, 10.0)
    line = refusal(lambda: gym.make("FlexPlanar-v0", **env.configuration.keywords()))
    assert line == "configuration: 'FlexOne-v0' is not allowed; give one of FlexPlanar-v0"
    assert refusal(lambda: gym.make("FlexOne-v0", configuration={})).startswith("configuration: {} is not allowed")


@pytest.mark.feature
@pytest.mark.slow
@pytest.mark.parametrize(("options", "count"), [([], 1), (["--env", "own.yaml", "--set", "arm.payload.mass=0.2"], 2)])
def test_a_training_parses_its_recipe_and_an_environment_in_its_place(parsed, tmp_path, monkeypatch, options, count):
    pytest.importorskip("stable_baselines3")
    from flexman_gym.__main__ import main

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("flexman_agents.guard.guard", lambda *_: "")  # it reads the finished run
    files.write_data(tmp_path / "own.yaml", {"id": "FlexPlanar-v0", "base": "pd", "horizon": 0.5})
    small = ["--steps", "256", "--envs", "2", "--folder", "run", "--quiet", "--eval-every", "0"]
    assert main(["train", "planar_ppo_on_pd", *small, *options]) == 0
    assert len(parsed) == count


def test_a_configuration_is_not_changed():
    with pytest.raises(AttributeError, match=r"^horizon: "):
        Configuration().horizon = 3.0


@pytest.mark.parametrize("name", SETTINGS)
def test_a_setting_has_help_and_a_plain_form(name):
    """The plain form of the default of a named environment makes an equal value again."""
    setting, own = SETTINGS[name], Configuration("FlexPlanar-v0", {"randomisation": {"delay": (0, 2)}})
    value = getattr(own, name)
    assert setting.help.endswith(".") and f"{name}: {setting.help}" in Configuration.__doc__
    plain = setting.plain(value) if setting.plain else value
    again = Configuration("FlexPlanar-v0", {name: json.loads(json.dumps(plain))})
    assert getattr(again, name) == value or name == "sensors"


# The same episode everywhere


@pytest.mark.feature
def test_the_same_file_and_seed_give_the_same_episode_everywhere(tmp_path):
    """From gym.make, gym.make_vec and an evaluation, whose records are period by period."""
    pytest.importorskip("stable_baselines3")
    from flexman_gym.evaluation.agent_spec import AgentSpec
    from flexman_gym.evaluation.agents import common_environment, find_agent
    from flexman_gym.evaluation.rollouts import rollout

    files.write_data(tmp_path / "own.yaml", OWN)
    result, seed = Configuration.load(tmp_path / "own.yaml"), 9003
    single = gym.make(result.id, **result.keywords())
    many = gym.make_vec(result.id, 2, "vector_entry_point", **result.keywords())
    seen, info = single.reset(seed=seed)
    others, infos = many.reset(seed=[7, seed])
    errors, posture = [info["tip_error"]], info["goal_angles"]
    assert np.array_equal(seen, others[1]) and np.array_equal(posture, infos["goal_angles"][1])
    for _ in range(15):
        seen, _, _, ended, info = single.step(np.zeros(2))
        others, *_, infos = many.step(np.zeros((2, 2)))
        errors.append(info["tip_error"])
        assert np.array_equal(seen, others[1]) and infos["tip_error"][1] == errors[-1]
    assert ended
    policy = AgentSpec("pd", find_agent("zero").law, {key: OWN[key] for key in ("base", "action_repeat", "sensors")})
    (_, record) = rollout(policy, common_environment([policy], result), [7, seed]).records
    assert np.array_equal(record.errors[::2], errors)


@pytest.mark.feature
def test_a_training_starts_with_the_episode_that_its_environment_gives():
    """The arms of a training are those of gym.make_vec with the training's seed."""
    pytest.importorskip("stable_baselines3")
    from flexman_agents.sb3 import make_model
    from flexman_agents.settings import Settings
    from flexman_gym.evaluation.rollouts import training_seed

    arms = make_model(Settings(environment=OWN, seed=2, envs=3)).get_vec_normalize_env()
    result = Configuration.from_plain(OWN)
    alone = gym.make(result.id, **result.keywords())
    assert np.array_equal(arms.venv.reset()[1], alone.reset(seed=training_seed(2) + 1)[0])


def test_the_limit_of_deflection_is_a_part_of_each_links_length():
    env = gym.make("FlexRRR-v0", limits=fm.Limits(deflection=0.2)).unwrapped
    view = env.episodes.view
    bounds = env.configuration.limits.bounds(view)["link_deflections"]
    assert bounds == pytest.approx(0.2 * np.repeat([link.length for link in env.configuration.arm.links], 2))
