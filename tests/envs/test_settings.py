"""Own arm: an arm of one's own, by whatever names it, makes the same environment again, and slips are told."""

import json
import warnings
from dataclasses import asdict

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec

import flexman_gym as fm
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.envs.registration import CONDITIONS
from flexman_gym.envs.vector_env import FlexManVectorEnv
from flexman_gym.scene.serialization import find_arm

from oracles.assertions import refusal

Z = (0.0, 0.0, 1.0)
STRIP = fm.Link.strip(0.5, 0.04, 0.003, masses=[fm.LumpedMass(0.1, 0.5, np.diag([1e-4, 1e-4, 1e-4]))])
MOTOR = fm.Motor(50.0, 0.04, 1e-5, 3.0, 400.0, 0.8, 0.003)
OWN = fm.Arm(
    [STRIP, fm.NonUniformLink([fm.Link.tube(0.2, 0.02, 0.001), fm.Link.rod(0.2, 0.01, "steel")])],
    [fm.Joint(Z, stiffness=60.0, damping=0.01, motor=MOTOR), fm.Joint(Z, rotor_inertia=0.01, torque_limit=1.0)],
    fm.Payload(0.1), modal_damping_ratio=0.01,
)  # fmt: skip


@pytest.mark.parametrize("name", NAMED_ENVIRONMENTS)
def test_the_specification_of_an_environment_with_an_own_arm_makes_it_again(name):
    env = gym.make(name, arm=OWN, modes=2, actions="torque", limits=fm.Limits(angle=2.0))
    spec = EnvSpec.from_json(env.spec.to_json())
    again = gym.make(spec)
    first, second = env.unwrapped.configuration, again.unwrapped.configuration
    assert second.arm == OWN and second.limits == first.limits == fm.Limits(angle=2.0)
    assert first.arm.links[0].outline == second.arm.links[0].outline is not None
    seen = [each.reset(seed=3)[0] for each in (env, again)]
    action = np.resize([0.3, -0.2], env.action_space.shape).astype(np.float32)  # of motors, then of the foundation
    moved = [each.step(action) for each in (env, again)]
    assert np.array_equal(*seen) and np.array_equal(moved[0][0], moved[1][0]) and moved[0][1] == moved[1][1]


def test_an_arm_may_be_named_wherever_one_is_taken(tmp_path):
    named = {"catalog": "planar_2r", "joint_stiffness": 60.0, "payload": {"mass": 0.2}}
    arm = fm.catalog.planar_2r(joint_stiffness=60.0, payload=fm.Payload(0.2))
    env = gym.make("FlexPlanar-v0", arm=named, torque_limit=1.0)
    assert env.unwrapped.configuration.arm == arm
    assert gym.make(EnvSpec.from_json(env.spec.to_json())).unwrapped.configuration.arm == arm
    assert fm.build_model(named).arm == arm and fm.build_model("planar_2r").arm == fm.catalog.planar_2r()
    scene = fm.Scene(
        named, fm.ModelChoice(True, 1), fm.ConstantTorque([0.0, 0.0]), fm.Initial([0.0, 0.0], [0.0, 0.0]), 0.1, 0.1
    )
    assert scene.arm == arm and fm.Scene.from_dict(scene.to_dict() | {"arm": named}) == scene
    scene.save(tmp_path / "scene.json")
    assert find_arm(str(tmp_path / "scene.json")) == find_arm(json.loads(json.dumps(asdict(arm)))) == arm
    for value, line in (
        (3, "arm: 3 is not allowed; give an Arm, a mapping, a file, or a name in the catalog: apkarian_1998, de"),
        ("planar", "arm: 'planar' is not allowed; give one of apkarian_1998, de_luca_siciliano"),
        ({"catalog": "one_link", "links": 2}, "arm: {'links': 2} is not allowed; give the arguments of one_link"),
    ):
        assert refusal(lambda value=value: find_arm(value)).startswith(line)
        assert refusal(lambda value=value: gym.make("FlexOne-v0", arm=value)).startswith(line)


@pytest.mark.feature
def test_gains_of_an_own_arm_are_designed_and_stored_in_its_file():
    from flexman_gym.toolbox.controllers.pd_design import design_pd

    own, named = Configuration("FlexPlanar-v0", {"arm": OWN, "base": "pd"}), Configuration("FlexPlanar-v0")
    designed = design_pd(own)
    assert own.pd_gains == own.gains == designed != named.pd_gains == NAMED_ENVIRONMENTS["FlexPlanar-v0"].pd
    assert own.to_plain()["gains"] == {name: list(values) for name, values in designed.items()}


def test_a_control_period_in_ms_is_warned_of_once():
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        gym.make("FlexOne-v0", control_period=20.0, horizon=200.0, step=20.0 / 3000, disable_env_checker=True)
    lines = [str(each.message) for each in caught if "wrong unit" in str(each.message)]
    assert lines == ["control_period: 20 (s) is unusual, expected at most 1; wrong unit (ms)?"]


@pytest.mark.feature
def test_models_trajectories_and_choices_print_few_lines():
    model = fm.build_model(OWN)
    scene = fm.Scene(
        OWN, fm.ModelChoice(False, 1), fm.ConstantTorque([0.1, 0.0]), fm.Initial([0.0] * 2, [0.0] * 2), 0.02, 0.01
    )
    choice = fm.Choice(model, "ros2", 0.01, 1e-3, ("a spring",), "a long report", {"modes": 1e-3}, 3)
    for value in (model, choice, fm.simulate(scene), fm.linearize(model), fm.modes(model), OWN.links[0]):
        lines = repr(value).splitlines()
        assert 1 <= len(lines) <= 5 and all(len(line) < 160 for line in lines), value
    assert "2 joints" in repr(model) and f"{model.n_dof} coordinates" in repr(model)
    assert choice.method in repr(choice)


def line_of(call, kind=ValueError):
    """The one line of an error."""
    with pytest.raises(kind) as caught:
        call()
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_delay_is_part_of_the_randomisation():
    env = gym.make("FlexOne-v0", randomisation={"delay": (1, 1)})
    assert env.unwrapped.configuration.max_delay == 1


@pytest.mark.parametrize("condition", CONDITIONS)
def test_an_id_with_a_condition_is_answered_with_the_keyword(condition):
    wanted = f'gym.make("FlexRRR-v0", condition="{condition}")'
    assert wanted in line_of(lambda: gym.make(f"FlexRRR-v0/{condition}"))
    assert wanted in line_of(lambda: gym.make_vec(f"FlexRRR-v0/{condition}", 2, "vector_entry_point", base="pd"))


@pytest.mark.parametrize(("horizon", "warned"), [(500, True), (1000.0, True), (20.0, False), (100.0, False)])
def test_a_horizon_in_steps_is_warned_of(horizon, warned):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        FlexManEnv(name="FlexOne-v0", horizon=horizon)
    lines = [str(each.message) for each in caught]
    assert len(lines) == warned
    assert not warned or (lines[0].startswith(f"horizon: {horizon:g} (s)") and "steps" in lines[0])


def misspelt(view):
    """A reward with a slip."""
    return -view.tip_eror


def nothing(view):
    """A reward that forgets its return."""
    view.tip_error  # noqa: B018


def words(view):
    """A reward that is no number."""
    return "far"


def too_many(view):
    """A reward of every coordinate of the tip."""
    return np.ones((3, 7))


@pytest.mark.parametrize("reward", [misspelt, nothing, words, too_many])
@pytest.mark.parametrize("made", [lambda **own: FlexManEnv(**own), lambda **own: FlexManVectorEnv(2, **own)])
def test_a_reward_function_that_fails_is_named_with_the_names_of_a_view(reward, made):
    env = made(name="FlexOne-v0", reward=reward)
    line = line_of(lambda: env.reset(seed=0))
    assert line.startswith(f"reward: {reward.__name__} ")
    assert all(name in line.replace(",", "").split() for name in ("tip_error", "target", "motor_rates", "failed"))
    assert ("tip_eror" in line) == (reward is misspelt) and ("None" in line) == (reward is nothing)
    assert not any(name in line.split() for name in ("read", "alone", "_one"))


def test_a_reward_may_be_a_constant_or_a_number_for_each_arm():
    for reward in (lambda view: 1, lambda view: np.float32(2.0), lambda view: view.failed, lambda view: view.tip_error):
        FlexManVectorEnv(2, name="FlexOne-v0", reward=reward).reset(seed=0)
        FlexManEnv(name="FlexOne-v0", reward=reward).reset(seed=0)


def test_the_cause_of_a_reward_that_fails_is_kept():
    with pytest.raises(ValueError) as caught:
        fm.rollout("pd", Configuration("FlexOne-v0", {"reward": misspelt}), 1)
    assert isinstance(caught.value.__cause__, AttributeError)
