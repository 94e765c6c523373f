"""Wrappers of action modes: members, state, preparation and times equal those of the mode without a wrapper."""

import ast
from copy import deepcopy
from pathlib import Path

import numpy as np
import pytest

import flexman_gym
from flexman_gym.agent.action_modes import ACTIONS, OPTIONAL_MEMBERS, ActionMode
from flexman_gym.agent.mode_wrapper import ModeWrapper
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.evaluation.action_clock import ActionClock, TimedMode
from flexman_gym.evaluation.agent_spec import BASELINES
from flexman_gym.evaluation.agents import find_agent
from flexman_gym.evaluation.rollouts import RolloutLoop, rollout

REQUIRED = tuple(name for name in vars(ActionMode) if not name.startswith("_"))
OWN = {"safety": ("info",)}  # optional members that a wrapper has itself
MOST = ("derivatives",)  # members that the safety filter does not have
LIMITS = {"strain": 2e-4, "on_violation": "record"}


class Full:
    """Action mode with every member of the protocol, each with a value of its own."""

    joints, names, sensors, state_fields = 1, ("torque_1",), ("motor_encoders",), ("count",)
    strength, observation_sizes, gain_units = 0.5, {"clock": 1}, {"stiffness": "N m/rad"}
    commands = (0.1,)

    def __init__(self):
        self.count, self.calls = 0, []

    def __getattribute__(self, name):
        if name in ("reset", "act", "observe", "derivatives", "prepare", "skip", "info"):
            return lambda *arguments: self.calls.append((name, arguments)) or name
        return super().__getattribute__(name)


class Filter:
    """Safety filter that leaves every torque."""

    sensors, state_fields = ("strain",), ()

    def reset(self, *arguments):
        pass

    def __call__(self, actions, *arguments):
        return actions


def safe(mode):
    """Return the wrapper of the safety filter."""
    from flexman_gym.toolbox.safety.safety_filter import SafeMode

    return SafeMode(mode, Filter())


WRAPPERS = {
    "base class": (ModeWrapper, ()),
    "safety": (safe, MOST),
    "time": (lambda mode: TimedMode(mode, ActionClock()), ()),
}
NAMES = ["base class", "time", pytest.param("safety", marks=pytest.mark.feature)]


@pytest.mark.feature
@pytest.mark.slow
def test_optional_members_include_every_public_member_of_the_modes_of_the_library():
    modes = {type(FlexManEnv(name="FlexOne-v0", actions=name).episodes.agent.mode) for name in ("torque", "position")}
    modes.add(type(FlexManEnv(base="lqg", actions="shaping").episodes.agent.mode))
    members = {name for mode in modes for name in vars(mode) if not name.startswith("_")}
    assert members - {"quantity"} <= {*REQUIRED, *OPTIONAL_MEMBERS} and len(modes) == 3 and "torque" in ACTIONS


@pytest.mark.slow
def test_optional_members_include_every_member_that_the_library_reads_from_a_mode():
    """Attributes of `mode` in the source, and names given to getattr and hasattr beside it."""
    read = set()
    for path in Path(flexman_gym.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Attribute) and ast.unparse(node.value).endswith("agent.mode"):
                read.add(node.attr)
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") in ("getattr", "hasattr"):
                owner, name, *_ = node.args
                if ast.unparse(owner).split(".")[-1] in ("mode", "_mode") and isinstance(name, ast.Constant):
                    read.add(name.value)
    assert {"act", "prepare", "observation_sizes", "derivatives"} <= read | set(REQUIRED)
    assert read - {"filter", "shown"} <= {*REQUIRED, *OPTIONAL_MEMBERS}


@pytest.mark.parametrize("wrapper", NAMES)
def test_every_member_of_the_protocol_is_that_of_the_wrapped_mode(wrapper):
    (make, withheld), mode = WRAPPERS[wrapper], Full()
    wrapped = make(mode)
    assert isinstance(wrapped, ActionMode)
    for name in {*REQUIRED, *OPTIONAL_MEMBERS} - {*withheld, *OWN.get(wrapper, ()), "state_fields"}:
        value = getattr(wrapped, name)
        if callable(value):
            arguments = tuple(range({"reset": 3, "act": 4, "prepare": 2, "skip": 1, "info": 0}.get(name, 3)))
            assert value(*arguments) == (name if name != "reset" else None)
            assert mode.calls.pop() == (name, arguments)
        elif name == "sensors":
            assert value[: len(mode.sensors)] == mode.sensors
        else:
            assert value == getattr(mode, name)
    assert not any(hasattr(wrapped, name) for name in withheld)
    assert wrapped._mode is mode and "_mode" in wrapped.state_fields


@pytest.mark.parametrize("wrapper", NAMES)
def test_optional_members_of_a_wrapper_are_missing_where_the_wrapped_mode_has_none(wrapper):
    bare = type("Bare", (), {name: getattr(Full(), name) for name in REQUIRED})()
    wrapped = WRAPPERS[wrapper][0](bare)
    assert [name for name in OPTIONAL_MEMBERS if hasattr(wrapped, name)] == ["state_fields", *OWN.get(wrapper, ())]


@pytest.mark.feature
@pytest.mark.slow
@pytest.mark.parametrize("agent", [{"safety": True, "limits": LIMITS}, {"actions": "shaping"}], ids=str)
def test_kalman_filter_predicts_while_the_arm_moves(agent):
    """Under the safety filter and below reference shaping; a preparation after the estimate does nothing."""
    plain, prepared = (FlexManEnv(name="FlexOne-v0", base="lqg", **agent) for _ in range(2))
    episodes, changes = prepared.episodes, []
    move = episodes.batch.step

    def prepare():
        before = episodes.base.observer.states.copy()
        episodes.agent.prepare(episodes.view.action.copy(), ~episodes.over)
        return not np.array_equal(episodes.base.observer.states, before)

    def step(*arguments):
        move(*arguments)
        changes.append(prepare())

    episodes.batch.step = step
    action = np.full(plain.action_space.shape, 0.1, dtype=np.float32)
    for env in (plain, prepared):
        env.reset(seed=3)
    for _ in range(5):
        assert np.array_equal(prepared.step(action)[0], plain.step(action)[0])
        assert np.array_equal(episodes.view.action, plain.episodes.view.action)
        assert prepare() == ("safety" in agent and not changes[-1])
    assert all(changes)


@pytest.mark.feature
def test_input_shaping_prepares_its_inner_controller_and_has_its_estimates():
    from flexman_gym.toolbox.controllers.input_shaping.shaped_controller import InputShapedController

    loop = RolloutLoop("lqg", Configuration("FlexOne-v0"), [9000])
    inner = loop.episodes.base
    shaped = InputShapedController(inner, loop.episodes.batch.model)
    loop.step()
    before = inner.observer.states.copy()
    shaped.prepare(loop.episodes.view.action.copy(), ~loop.episodes.over)
    assert not np.array_equal(inner.observer.states, before)
    assert shaped.estimates == inner.estimates


@pytest.mark.feature
@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in BASELINES if name != "optimised"])  # it has a table of one arm
def test_a_deep_copy_of_a_designed_agent_acts_as_the_agent(name):
    """Each rollout acts with a copy, so that several may share an agent."""
    pytest.importorskip({"mpc": "daqp", "hinf": "slycot"}.get(name, "numpy"))
    environment = Configuration("FlexOne-v0", {"horizon": 0.1})
    agent = find_agent(name).designed(environment)
    first, second = (rollout(each, environment, [9000]).torques for each in (agent, deepcopy(agent)))
    assert np.array_equal(first, second, equal_nan=True)
    loop = RolloutLoop(agent, environment, [9000])
    loop.step()
    deepcopy(loop.episodes.base)  # also of one in the middle of an episode


@pytest.mark.feature
@pytest.mark.slow
def test_measured_times_do_not_change_an_agent_below_the_safety_filter():
    """The filter uses the estimator of the base controller, also where times are measured."""
    environment = Configuration(
        "FlexOne-v0", {"safety": True, "limits": LIMITS, "horizon": 0.5, "randomisation": {"payload_mass": (0.0, 0.1)}}
    )
    agent = find_agent("adaptive-lqr")
    timed, clock = agent.timed(environment)
    plain, measured = (rollout(each, environment, [9000]) for each in (agent, timed))
    assert np.array_equal(plain.torques, measured.torques, equal_nan=True)
    assert clock.action_seconds > 0.0 and clock.start_seconds > 0.0
