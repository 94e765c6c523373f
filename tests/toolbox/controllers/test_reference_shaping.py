"""Reference shaping: changes of a reference by an agent; an action of zero is the base controller."""

import numpy as np
import pytest

from flexman_gym.agent.agent import Agent
from flexman_gym.agent.controller import EpisodeInfo
from flexman_gym.agent.network import Network
from flexman_gym.envs.config.base_and_mode import make_base_and_mode
from flexman_gym.envs.config.plant import make_plant
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.envs.vector_env import FlexManVectorEnv
from flexman_gym.model.statics import rest_state
from flexman_gym.toolbox.controllers.arm_scales import SlewBounds
from flexman_gym.toolbox.controllers.observers.observer import Estimate
from flexman_gym.toolbox.controllers.observers.oracle import DEVIATION_DECAY, Oracle
from flexman_gym.toolbox.controllers.reference_shaping import (
    OFFSET_FREQUENCY,
    TIME_SCALING_GAIN,
    ReferenceShaping,
    ShapingLimits,
)
from flexman_gym.toolbox.controllers.references.adaptive_references import SlewReferences
from flexman_gym.toolbox.controllers.shaping_mode import DEVIATION_SCALE

from oracles.assertions import refusal
from oracles.observed_arms import SMALL

HEAVY = 0.05  # kg
UNKNOWN = {"payload_mass": (0.0, HEAVY), "joint_stiffness_factor": (0.8, 1.2), "delay": (1, 1)}
ONE = {"name": "FlexOne-v0", "randomisation": UNKNOWN, "horizon": 1.0}
SHAPED = {**ONE, "sensors": (), "actions": "shaping", "action_repeat": 5}
BASES = ({"kind": "privileged-lqr", "doubt": True}, "adaptive-lqr")


def played(env, act, periods, seed=3):
    """What motors were asked for in control periods of an environment, and what was seen."""
    asked, seen = [], [env.reset(seed=seed)[0]]
    env.episodes.callback = lambda: asked.append(env.episodes.view.action.copy())
    while len(asked) < periods:
        seen.append(env.step(act(seen[-1]).astype(np.float32))[0])
    return np.array(asked), np.array(seen)


@pytest.mark.slow
@pytest.mark.parametrize("base", BASES)
def test_an_action_of_nothing_is_the_controller_to_the_bit(base):
    plain = FlexManVectorEnv(3, **ONE, base=base)
    shaped = FlexManVectorEnv(3, **SHAPED, base=base)
    expected, _ = played(plain, lambda seen: np.zeros((3, 1)), 40)
    asked, seen = played(shaped, lambda seen: np.zeros((3, 3)), 40)
    assert not plain.episodes.over.any()
    other, _ = played(shaped, lambda seen: np.full((3, 3), 0.4), 40)
    assert np.array_equal(asked, expected)
    assert np.abs(other - expected).max() > 0.1
    assert shaped.episodes.agent.mode.names == ("pace", "offset_1", "torque_1")
    assert (
        seen.shape[2]
        == sum(shaped.episodes.agent.mode.observation_sizes.values())
        == shaped.single_observation_space.shape[0]
    )


def network(size, actions=3):
    """Made-up layers of a policy."""
    random = np.random.default_rng(1)
    layers = {
        "action_net.weight": random.normal(size=(actions, size), scale=0.02),
        "action_net.bias": np.zeros(actions),
    }
    return Network("ppo", None, layers, {"mean": np.zeros(size), "var": np.ones(size)})


@pytest.mark.slow
def test_a_policy_sees_and_shapes_as_the_agent_in_its_environment():
    """The agent in its environment; the same agent as the base of a plain one, made for the arm there."""
    beside = FlexManVectorEnv(3, **SHAPED, base="adaptive-lqr")
    acting = network(beside.single_observation_space.shape[0])
    base, mode = make_base_and_mode(beside.configuration, beside.batch.model)
    learned = Agent((), 0, mode, base, action_repeat=5, law=acting)
    asked, _ = played(beside, acting, 40)
    expected, _ = played(FlexManVectorEnv(3, **ONE, base=learned), lambda seen: np.zeros((3, 1)), 40)
    assert np.array_equal(asked, expected) and np.abs(asked).max() > 0.1


def test_a_state_holds_what_was_looked_at_and_shaped():
    one, other = (FlexManEnv(**SHAPED, base="adaptive-lqr") for _ in range(2))
    one.reset(seed=1)
    for _ in range(3):
        one.step(np.full(3, 0.7, dtype=np.float32))
    other.reset(seed=2)
    assert np.array_equal(other.set_state(one.get_state())[0], one.episodes.agent.observations[0])
    both = [env.step(np.full(3, -0.3, dtype=np.float32))[0] for env in (one, other)]
    assert np.array_equal(*both)


def test_the_end_of_an_episode_is_seen_before_the_next_begins():
    """With a reset in the same step: the last observation has gone on, the first one of the next is at its start."""
    env = FlexManVectorEnv(2, **{**SHAPED, "horizon": 0.2}, base="privileged-lqr", autoreset_mode="SameStep")
    env.reset(seed=0)
    place = env.single_observation_space.shape[0] - sum(list(env.episodes.agent.mode.observation_sizes.values())[5:])
    for _ in range(2):
        seen, _, _, truncated, infos = env.step(np.zeros((2, 3), dtype=np.float32))
    assert truncated.all() and (seen[:, place] == 0.0).all()
    assert all(each[place] > 0.01 for each in infos["final_obs"])


def slew_of(way, **settings):
    """The slew of an arm over a way (n,) rad, that begins at 0 s."""
    env = FlexManEnv(**settings)
    result = SlewReferences(env.simulator.model, SlewBounds(np.array(env.torque_limit), 0.9), (0.1,))
    result.allocate(1)
    result.begin(ARM, np.zeros((1, len(way))), np.array([way]))
    result.adapt(ARM, {})
    result.plan_timing(ARM, np.zeros(1), first=True)
    return result


@pytest.fixture
def slews():
    """The slew of an arm of one joint over 1 rad."""
    return slew_of([1.0], name="FlexOne-v0")


ARM = np.array([0])
PERIOD = 0.02


def shape_of(slews, **authority):
    result = ReferenceShaping(slews, np.array([2.0]), PERIOD, ShapingLimits(**authority))
    result.reset(ARM, 1)
    return result


def test_a_clock_goes_to_its_pace_and_stays_ahead(slews):
    """The pace w + (1 - w) (1 - PURSUIT)^k, and the sum of what it is beyond 1.

    It quickens as fast as a pace that grows by its steps over two periods, for a step is nowhere but between two.
    """
    shape, wanted = shape_of(slews, pace=0.5), np.exp(0.5 * 0.6)
    shape.action[0, 0] = 0.6
    paces = []
    for _ in range(12):
        before = slews.time_scaling[0]
        shape.update_time_scaling(ARM)
        paces.append(slews.time_scaling[0])
        assert slews.pace_rate[0] == pytest.approx((paces[-1] - before) / (2.0 * PERIOD))
        shape.advance(ARM, np.zeros(1))
    assert paces == pytest.approx(wanted + (1.0 - wanted) * (1.0 - TIME_SCALING_GAIN) ** np.arange(1, 13))
    assert shape.clock_offset[0] == pytest.approx(PERIOD * (np.sum(paces) - 12.0))


def test_a_slew_at_another_pace_moves_as_its_clock_does(slews):
    """Speeds are the derivatives of coordinates, along a clock that runs 1.3 times as fast."""
    slews.time_scaling[:] = 1.3
    now, step = np.array([0.4]), 1e-5
    d = slews.model.n_dof
    before, after = (slews.motion(now + 1.3 * shift, now + 1.3 * shift, ARM)[0][0, :d] for shift in (-step, step))
    assert slews.motion(now, now, ARM)[0][0, d:] == pytest.approx((after - before) / (2.0 * step), rel=2e-3, abs=1e-4)


def test_a_slew_at_another_pace_is_one_that_was_timed_for_it():
    """Bent and driven as that of the polynomial whose k-th coefficient is 1.3^k as large."""
    slews = slew_of([1.0, -0.6], name="FlexPlanar-v0")
    slews.time_scaling[:] = 1.3
    now = np.array([0.26])
    paced = slews.motion(now, now, ARM)
    slews.time_scaling[:] = 1.0
    slews.coefficients[0] *= 1.3 ** np.arange(6)
    slews.duration /= 1.3
    timed = slews.motion(now / 1.3, now / 1.3, ARM)
    assert paced[0] == pytest.approx(timed[0], rel=1e-9) and paced[1] == pytest.approx(timed[1], rel=1e-9)


def test_offsets_are_critically_damped_and_fade_at_the_goal(slews):
    """(1 - (1 + w t) exp(-w t)) of what is wanted; nothing of it where the path ends, nor of torques."""
    shape = shape_of(slews, offset=0.1, torque=0.25)
    shape.action[0, 1:] = 0.5, -1.0
    offsets = []
    for _ in range(30):
        assert shape.advance(ARM, np.array([0.2])) == pytest.approx(-0.5)
        offsets.append(shape.offsets[0, 0, 0])
    turned = OFFSET_FREQUENCY * PERIOD * np.arange(1, 31)
    assert offsets == pytest.approx(0.05 * (1.0 - (1.0 + turned) * np.exp(-turned)), abs=0.006)
    states = shape.offset_states(ARM)
    model = slews.model
    assert states[0, [0, model.motor_columns[0]]] == pytest.approx(offsets[-1])
    assert states[0, model.n_dof + model.motor_columns[0]] == pytest.approx(shape.offsets[0, 1, 0])
    assert shape.advance(ARM, np.array([0.975])) == pytest.approx(-0.25), "half of the fading"
    for _ in range(60):
        assert shape.advance(ARM, np.ones(1)) == pytest.approx(0.0)
    assert np.abs(shape.offsets).max() < 1e-4


def test_every_arm_that_begins_is_shaped_anew_and_no_other(slews):
    slews.allocate(4)
    shape, arms = shape_of(slews), np.arange(4)
    shape.reset(arms, len(arms))
    for part in (shape.clock_offset, shape.offsets, shape.action):
        part[:] = 0.7
    shape.reset(np.array([0, 1, 3]), 4)
    for part in (shape.clock_offset, shape.offsets, shape.action):
        assert (part[[0, 1, 3]] == 0.0).all() and (part[2] == 0.7).all()


@pytest.fixture
def lifting():
    """Three arms under gravity with payloads and springs of their own, which a policy may shape."""
    unknown = {"payload_mass": (0.0, 0.2), "joint_stiffness_factor": (0.7, 1.3), "delay": (1, 1)}
    settings = {**SMALL, "name": "FlexPlanar-v0", "randomisation": unknown, "sensors": (), "actions": "shaping"}
    env = FlexManVectorEnv(3, **settings, base=BASES[0], horizon=2.0)
    env.reset(seed=0)
    env.step(np.zeros((3, 5), dtype=np.float32))
    return env


def test_an_arm_that_rests_at_the_end_of_its_slew_has_no_errors(lifting):
    """Under gravity the end is turned until the tip of the arm as it is rests where it should."""
    mode, arms = lifting.episodes.agent.mode, np.arange(3)
    law, d = mode._law, mode._plant.model.n_dof
    law._ages[:] = 3000
    springs = np.array([[0.7, 1.2], [1.0, 0.9], [1.3, 1.1]]) * mode._plant.model.constants.joint_stiffness
    law.slews.adapt(arms, {"payload_mass": np.array([0.0, 0.05, 0.2]), "joint_stiffness": springs})
    zero = np.zeros(3, dtype=np.int64)
    here = Estimate(np.zeros((3, 2 * d)), zero, {})
    shown = mode._parts(here._replace(states=law.reference(here, arms)), np.zeros((3, 2)), arms)
    for name in ("angle_errors", "departures", "way"):
        assert np.abs(shown[name]).max() < 1e-12, name
    assert (shown["clock"][:, [0, 3]] == [1.0, 0.0]).all() and np.abs(law.slews.shift).max(axis=1).min() > 1e-4


def test_what_is_shown_of_an_arm_on_its_way(lifting):
    """Of arms that are off their reference by known angles and rates, under what is estimated of them."""
    mode, arms, zero = lifting.episodes.agent.mode, np.arange(3), np.zeros(3, dtype=np.int64)
    law, model = mode._law, mode._plant.model
    law._ages[:] = 20
    factors = np.array([[0.7, 1.2], [1.0, 0.9], [1.3, 1.1]])
    springs = factors * model.constants.joint_stiffness
    known = {"payload_mass": np.array([0.0, 0.1, 0.2]), "joint_stiffness": springs}
    off = 0.01 * np.random.default_rng(0).standard_normal((3, 2 * model.n_dof))
    here = Estimate(np.zeros((3, 2 * model.n_dof)), zero, known)
    reference, now = law.reference(here, arms), law.clock(here, arms)
    shown = mode._parts(here._replace(states=reference + off), np.zeros((3, 2)), arms)
    ranges = np.concatenate([each[0] for each in (mode._plant.measured()[name] for name in mode._quantities.columns)])
    assert np.sinh(shown["departures"]) * DEVIATION_SCALE * ranges == pytest.approx(mode._read(off), abs=1e-12)
    assert shown["estimate"] == pytest.approx(mode._read(reference + off))
    motors, h = model.motor_columns, 1e-4
    ahead, behind = (law._reference(now + shift, arms)[0][:, motors] for shift in (h, -h))
    rates = (ahead - behind) / (2.0 * h)
    assert shown["reference"] == pytest.approx(np.hstack([reference[:, motors], rates]), rel=0.01, abs=1e-3)
    assert np.abs(rates).max() > 0.1
    places = [law.slews.at(now + shown["clock"][:, 3] - early, arms)[0] for early in (0.0, 0.02)]
    assert (places[0] > 1.0 - 1e-9).all() and (places[1] < 1.0 - 1e-9).all()
    expected = np.column_stack([known["payload_mass"], factors, np.ones((3, 2))])
    assert shown["parameters"] == pytest.approx(expected)


def test_deviations_are_parts_of_what_is_usual(lifting):
    """At first those of even draws from the ranges; links are known."""
    lifting.reset(seed=1)
    shown = lifting.episodes.agent.mode._deviations(np.arange(3))
    assert shown == pytest.approx(np.tile(np.array([0.2, 0.6, 0.6, 0.0, 0.0]) / np.sqrt(12.0), (3, 1)), rel=0.01)


def test_torques_beside_a_slew_at_another_pace_are_those_of_the_middle_of_a_period(lifting):
    """As of a slew that was timed for the pace, over the period that begins."""
    law, arms = lifting.episodes.agent.mode._law, np.arange(3)
    slews, now = law.slews, np.full(3, 0.26)
    slews.time_scaling[:] = 1.4
    paced = law._reference(now, arms)
    slews.time_scaling[:] = 1.0
    slews.coefficients *= 1.4 ** np.arange(6)
    for part in (slews.duration, slews.start_time):
        part /= 1.4
    timed = law._reference(now / 1.4, arms)
    assert paced[0] == pytest.approx(timed[0], rel=1e-9) and paced[1] == pytest.approx(timed[1], rel=1e-9)
    assert np.abs(slews.motion(now / 1.4, now / 1.4, arms)[1] - timed[1]).max() > 1e-3


def test_torques_that_do_not_fade_stay_at_the_goal(slews):
    shape = shape_of(slews, torque=0.25, fading=0.0)
    shape.action[0, 2] = 0.5
    for place in (0.0, 0.999, 1.0):
        assert shape.advance(ARM, np.array([place])) == pytest.approx(0.25)


def test_only_parts_with_authority_are_asked_for():
    env = FlexManEnv(**{**SHAPED, "actions": {"kind": "shaping", "offset": 0.0, "torque": 0.0}}, base="privileged-lqr")
    assert env.episodes.agent.mode.names == ("pace",) and env.action_space.shape == (1,)


@pytest.mark.parametrize(
    ("settings", "line"),
    [
        ({"base": "pd"}, "actions: 'shaping' is not allowed; give torque, or shaping with a base that estimates"),
        ({"base": "adaptive-planned"}, "actions: 'shaping' is not allowed; give torque, or shaping with a base that"),
        ({"actions": {"kind": "shaping", "fading": -0.1}}, "actions.fading: -0.1 is not allowed"),
        ({"actions": {"kind": "shaping", "torque": -0.1}}, "actions.torque: -0.1 is not allowed"),
        ({"base": {"kind": "privileged-lqr", "doubt": 2}}, "base.doubt: 2 is not allowed"),
    ],
)
def test_what_cannot_be_shaped_is_refused_in_one_line(settings, line):
    assert refusal(lambda: FlexManEnv(**{**SHAPED, "base": "privileged-lqr", **settings})).startswith(line)


def test_doubt_is_that_of_an_observer():
    """The mean of what is possible at first; later the truth, with errors of the deviations that are told."""
    env = FlexManVectorEnv(40, **ONE)
    env.reset(seed=0)
    plant, drawn = make_plant(env.configuration, env.batch.model), env.episodes.effects.drawn
    truth, arms, on = Oracle(plant, doubt=True), np.arange(40), np.ones(40, dtype=bool)
    goal = np.zeros((40, 1))
    truth.reset(arms, EpisodeInfo(goal, goal, PERIOD, None, drawn), len(arms))
    readings = {"state": rest_state(plant.model, goal)}
    ratios = []
    for period in range(60):
        spread = truth.estimates["payload_mass_deviation"]
        told = truth.estimate(readings, goal, on)
        assert isinstance(told, Estimate)
        error = told.parameters["payload_mass"] - drawn["payload_mass"]
        if period == 0:
            assert told.parameters["payload_mass"] == pytest.approx(0.5 * HEAVY)
            assert spread == pytest.approx(HEAVY / np.sqrt(12.0))
        if period == 10:
            scale, power = DEVIATION_DECAY["payload_mass"]
            assert spread == pytest.approx(HEAVY / np.sqrt(12.0) / (1.0 + (10 * PERIOD / scale) ** power))
        if period >= 20:
            ratios.append(error / spread)
    assert 0.7 < np.std(ratios[-1]) < 1.3, "four deviations of the deviation of 40"
    assert np.abs(error).max() < 0.05 * HEAVY
