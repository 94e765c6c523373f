"""Safety filter: limits hold for every agent, torques far from them pass, changes are minimal, and stops are brakes."""

import copy
import sys
import warnings

import gymnasium as gym
import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.agent.controller import EpisodeInfo
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.envs.config.plant import make_plant
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.envs.limits import Limits
from flexman_gym.envs.vector_env import FlexManVectorEnv
from flexman_gym.evaluation.metrics import METRICS
from flexman_gym.model.statics import rest_state
from flexman_gym.simulation.batch import Batch
from flexman_gym.toolbox.controllers.observers.observer import UncertainStates
from flexman_gym.toolbox.controllers.observers.uncertain_states import TrueState
from flexman_gym.toolbox.deployment.c_code import begin_agent
from flexman_gym.toolbox.safety import safety_filter as safety_module
from flexman_gym.toolbox.safety.braking import BRAKE, DECAY, METHOD, NEAR_PERIODS
from flexman_gym.toolbox.safety.safety_filter import CHANGED, PASSED, REMAINDER, STOPPED, TOLERANCE, SafetyFilter

from oracles.assertions import refusal, same_alone_and_among_others

ONE = {"strain": 2e-4, "spring_torque": 3.0, "rate": 4.0, "on_violation": "record"}
WALL = [{"half_space": [[0.0, 1.0, 0.0], 0.4]}]
PLANAR = {"strain": [3e-4, 1.3e-4], "spring_torque": [6.0, 2.5], "rate": 6.0, "on_violation": "record"}
UNKNOWN = {"payload_mass": (0.0, 0.1), "joint_stiffness_factor": (0.8, 1.2), "delay": (0, 2)}
LIMITS = {"FlexOne-v0": ONE, "FlexPlanar-v0": PLANAR}


def plant_of(name="FlexOne-v0", **settings):
    """Return the plant of a named environment."""
    configuration = Configuration.from_keywords({"name": name, **settings})
    return make_plant(configuration, resolve_fidelity(configuration).model)


def filter_of(plant, limits, source=None):
    """Return a filter of one arm at the start of an episode."""
    result = SafetyFilter(plant, Limits(**limits).predicted(plant.model), source or TrueState(plant))
    start = np.zeros((1, plant.model.n_joints))
    result.reset(np.array([0]), EpisodeInfo(start, start, plant.period), 1)
    return result


def filtered(safety, action, state, applied=0.0):
    """Return the torques (n,) of a filter for an action (n,) in a state (2 d,)."""
    n = len(safety.torque_limits)
    given = {"state": np.array([state])}, np.full((1, n), applied), np.ones(1, dtype=bool)
    return safety(np.array([action], dtype=float), *given)[0]


def braked(plant, states, actions, limits, periods, delay=0, slow=False):
    """Return the signed shares (b, T, m) of limits for actions (b, n) in one period, then the brake; stepwise.

    The brake: a damper, the weight, and if it is slow the torques that the damper leaves of the actions, which decay.
    """
    b, n, d = len(states), plant.model.n_joints, plant.model.n_dof
    batch = Batch(plant.model, METHOD, plant.integration[1], plant.period, arms=b)
    hold = fm.holding_torques(plant.model, states[0, plant.model.motor_columns])
    batch.reset(np.arange(b), states)
    damping, largest = BRAKE * np.array(plant.gains()["damping"]), np.array(plant.torque_limit)
    commands, result = [np.zeros((b, n))] * delay + [actions * largest], []
    decaying = slow * (actions * largest - hold + damping * states[:, d:][:, plant.model.motor_columns])
    stiffness = np.repeat(plant.model.constants.joint_stiffness[None], b, axis=0)
    for t in range(periods):
        if t:
            rates = batch.state[:, d:][:, plant.model.motor_columns]
            less = np.exp(-t * plant.period / DECAY) * decaying
            commands.append(np.clip(hold + less - damping * rates, -largest, largest))
        batch.step(np.hstack([commands[t], np.zeros((b, 6))]))
        shares = Limits(**limits).predicted(plant.model)
        result.append(shares.shares(batch.state[:, None], batch.outputs[:, None], stiffness)[:, 0])
    return np.array(result).swapaxes(0, 1)


@pytest.mark.parametrize("slow", [False, True])
@pytest.mark.parametrize("delay", [0, 1, 2])
def test_the_prediction_is_a_loop_of_steps(delay, slow):
    """Torques of the agent act after the delay, those commanded before until then, and then the sampled brake."""
    plant = plant_of(randomisation={"delay": (delay, delay)} if delay else None)
    safety, state, shares = filter_of(plant, ONE), np.zeros(2 * plant.model.n_dof), []
    state[plant.model.n_dof :] = 0.1
    for action in (0.7, 0.0):
        commands = np.zeros((1, 1 + delay, 1))
        commands[:, 0] = action * plant.torque_limit[0]
        decaying = slow * (commands[:, 0] + BRAKE * np.array(plant.gains()["damping"]) * 0.1)
        given = state[None], commands, np.array([delay]), np.zeros((1, 1)), decaying, {}
        shares.append(next(safety._parts(1))[1](*given)[0][0])
        expected = braked(plant, state[None], np.array([[action]]), ONE, NEAR_PERIODS + 1, delay, slow)[0]
        assert shares[-1][: len(expected)] == pytest.approx(expected, rel=1e-9, abs=1e-9)
    differences = np.abs(shares[0] - shares[1]).max(axis=1)
    assert (differences[:delay] == 0.0).all() and differences[delay : delay + 3].max() > 0.1, "the torque matters"


class Rates:
    """Agent with the largest torques in the direction of the motor rates."""

    def __init__(self, env):
        self._view = env.episodes.view

    def __call__(self):
        return np.where(self._view.motor_rates < 0.0, -1.0, 1.0)


class Random:
    """Agent with random torques, each held for 10 periods."""

    def __init__(self, env):
        self._shape, self._random, self._age = env.action_space.shape, np.random.default_rng(1), 0

    def __call__(self):
        if self._age % 10 == 0:
            self._action = self._random.choice([-1.0, 1.0], self._shape)
        self._age += 1
        return self._action


def largest_excess(name, agent, periods=120, **settings):
    """Return the largest excess over the limits of three arms, and the number of periods with each status."""
    env = FlexManVectorEnv(3, name=name, horizon=100.0, **settings)
    env.reset(seed=3)
    act, largest, status = agent(env), -1.0, []
    for _ in range(periods):
        *_, info = env.step(act())
        largest = max(largest, env.episodes.excess.max())
        status += list(info.get("safety_status", ()))
    return largest, {each: status.count(each) for each in status}


@pytest.mark.parametrize("agent", [Rates, Random])
@pytest.mark.parametrize("randomisation", [None, UNKNOWN])
@pytest.mark.parametrize("name", LIMITS)
def test_no_agent_exceeds_the_limits(name, randomisation, agent):
    settings = {"limits": LIMITS[name], "randomisation": randomisation}
    assert largest_excess(name, agent, **settings)[0] > 0.3, "without the filter"
    excess, status = largest_excess(name, agent, safety=True, **settings)
    assert excess < 0.02 and status["changed"] > 20


@pytest.mark.parametrize("randomisation", [None, UNKNOWN])
def test_a_period_without_a_prediction_would_have_passed(randomisation):
    """Small random torques lead near to the limits; the predictions that are left out are made here."""
    env = FlexManVectorEnv(3, name="FlexOne-v0", horizon=100.0, safety=True, limits=ONE, randomisation=randomisation)
    env.reset(seed=3)
    safety, act, largest, checked = env.episodes.safety, Random(env), [], []
    covered, check = safety._covered, safety._check

    def predict(arms, actions):
        flags = covered(arms, actions)
        if flags.any():
            shares, radius, _ = safety._predict_models(safety._cases(arms[flags]), actions[flags])
            largest.append((np.abs(shares) + radius - safety._levels[arms[flags]][:, None]).max())
        return flags

    safety._covered = predict
    safety._check = lambda arms, *given: (checked.extend(arms), check(arms, *given))
    for _ in range(100):
        env.step(0.3 * act())
    assert len(checked) < 200 and -0.3 < max(largest) < TOLERANCE


@pytest.mark.parametrize("delay", [0, 2])
def test_a_wall_is_not_passed(delay):
    limits = {"workspace": WALL, "on_violation": "record"}
    settings = {"limits": limits, "randomisation": {"delay": (delay, delay)}}
    env = FlexManEnv(name="FlexOne-v0", safety=True, **settings)
    env.reset(seed=0, options={"start": [0.0], "goal_angles": [0.1]})
    nearest = 1.0
    for _ in range(100):
        *_, info = env.step(np.ones(1))
        nearest = min(nearest, info["limits"]["workspace"][0])
    assert -0.002 < nearest < 0.04, "of a reach of 0.8 m"


@pytest.mark.parametrize("share", [0.5, 0.99, 0.999])
def test_a_start_near_a_wall_may_be_left(share):
    """Beyond the remainder for errors of the prediction, too; a wall far away is no limit."""
    far = {"half_space": [[0.0, 0.0, 1.0], 50.0]}
    env = FlexManEnv(
        name="FlexOne-v0", base="pd", safety=True, limits={"workspace": [*WALL, far], "on_violation": "end"}
    )
    start = np.arcsin((0.4 - 0.8 * (1.0 - share)) / 0.8)
    env.reset(seed=0, options={"start": [start], "goal_angles": [start - 0.3]})
    for _ in range(150):
        *_, terminated, _, info = env.step(np.zeros(1))
        assert not terminated
    assert info["tip_error"] < 0.01


def test_an_action_far_from_the_limits_passes_with_equal_bits():
    given = {"limits": {"strain": 1.0, "on_violation": "record"}, "randomisation": {"delay": (1, 1)}}
    plain, safe = (FlexManVectorEnv(2, name="FlexOne-v0", **given, **own) for own in ({}, {"safety": True}))
    plain.reset(seed=0), safe.reset(seed=0)
    for action in 0.1 * np.random.default_rng(0).uniform(-1.0, 1.0, (40, 2, 1)):
        (*first, _), (*second, info) = plain.step(action), safe.step(action)
        assert all(np.array_equal(a, b) for a, b in zip(first, second, strict=True))
        assert list(info["safety_status"]) == ["passed"] * 2 and not info["safety_change"].any()


def test_the_change_is_the_smallest_one():
    """Of a grid of actions, none nearer to that of the agent keeps the limits; all are simulated by steps."""
    plant = plant_of("FlexPlanar-v0")
    state = rest_state(plant.model, np.array([-0.6, -0.9]))
    state[plant.model.n_dof :][plant.model.motor_columns] = state[plant.model.n_dof :][:2] = [0.4, -0.2]
    wanted, grid = np.array([0.9, 0.6]), np.linspace(-1.0, 1.0, 81)
    limits = {"strain": [1.35e-4, 2.4e-5], "spring_torque": [2.7, 0.45]}
    safety = filter_of(plant, limits)
    safe = filtered(safety, wanted, state)
    assert safety.status[0] == CHANGED and np.array_equal(safety.change[0], safe - wanted)
    actions = np.array([safe, *np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)])
    shares = np.abs(
        braked(plant, np.repeat(state[None], len(actions), axis=0), actions, limits, 80, slow=safety._slow[0])
    ).max(axis=(1, 2))
    lengths = np.linalg.norm(actions - wanted, axis=1)
    assert shares[0] < REMAINDER + 0.005
    inside, wide = (lengths[1:][shares[1:] <= level].min() for level in (REMAINDER, REMAINDER + 0.005))
    step = grid[1] - grid[0]
    assert inside > 0.1 and wide - step < lengths[0] < inside + step


def test_without_safe_torques_the_brake_acts():
    """A state beyond its limits, from which no torques come back."""
    plant = plant_of()
    safety, d, motors = filter_of(plant, {"rate": 1.0}), plant.model.n_dof, plant.model.motor_columns
    at_rest, state = np.zeros(2 * d), np.zeros(2 * d)
    assert filtered(safety, [0.0], at_rest) == 0.0 and safety.status[0] == PASSED
    for _ in range(12):
        state[:d] += plant.period * state[d:]
        state[d:][motors], state[d:][0] = 1.6, 1.6
        torque = filtered(safety, [1.0], state)
    assert safety.status[0] == STOPPED
    assert torque == np.clip(-BRAKE * plant.gains()["damping"][0] * 1.6 / plant.torque_limit[0], -1.0, 1.0)
    assert safety.change[0] == torque - 1.0


def test_a_limit_of_rates_that_only_the_slow_brake_keeps():
    """A step of the torque twists the joint faster than allowed; then the brake takes the torque back slowly."""
    plant, limits, wanted = plant_of("FlexRRR-v0"), {"rate": 0.5}, np.array([0.6, 0.0, 0.0])
    safety, d, motors = filter_of(plant, limits), plant.model.n_dof, plant.model.motor_columns
    damping, largest = BRAKE * np.array(plant.gains()["damping"]), np.array(plant.torque_limit)
    batch = Batch(plant.model, METHOD, plant.integration[1], plant.period, arms=2)
    batch.reset(np.arange(2), np.zeros((2, 2 * d)))
    for _ in range(10):
        state = batch.state[0].copy()
        torque = filtered(safety, wanted, state)
        batch.step(np.hstack([np.tile(torque * largest, (2, 1)), np.zeros((2, 6))]))
    assert safety.status[0] == PASSED
    fast, slow = (np.abs(braked(plant, state[None], torque[None], limits, 60, slow=each)).max() for each in (0, 1))
    assert slow < REMAINDER and fast > 1.5
    decaying = torque * largest + damping * state[d:][motors]
    state[d:][motors] = state[d:][:3] = 0.6  # beyond the limit: the brake goes on
    torque = filtered(safety, wanted, state)
    assert safety.status[0] == STOPPED
    expected = np.exp(-plant.period / DECAY) * decaying - damping * 0.6
    assert torque == pytest.approx(np.clip(expected / largest, -1.0, 1.0), rel=1e-9)


def test_the_brake_holds_the_weight_of_the_stop_that_was_predicted():
    """Not that of the present posture: the arm would move differently in each period."""
    plant = plant_of("FlexPlanar-v0")
    safety, n, d = filter_of(plant, {"rate": 1.0}), plant.model.n_joints, plant.model.n_dof
    postures, limits = np.array([[0.3, 0.2], [0.8, -0.4]]), np.array(plant.torque_limit)
    hold = fm.holding_torques(plant.model, postures[0])
    filtered(safety, hold / limits, rest_state(plant.model, postures[0]))
    assert safety.status[0] == PASSED
    state = rest_state(plant.model, postures[1])
    state[d:][:n], state[d:][plant.model.motor_columns] = 1.6, 1.6
    for _ in range(13):
        torques = filtered(safety, np.ones(n), state)
    assert safety.status[0] == STOPPED
    damping = BRAKE * np.array(plant.gains()["damping"])
    assert torques == pytest.approx(np.clip((hold - 1.6 * damping) / limits, -1.0, 1.0), rel=1e-12)


class TwoPayloads:
    """Source of the true state, with a heavier payload that is as possible."""

    sensors = ("state",)

    def __init__(self, plant, heavy):
        self._true, self._masses = TrueState(plant), np.array([[plant.model.constants.payload_mass[0], heavy]])
        self.reset, self.update = self._true.reset, self._true.update

    def read(self, arms):
        states, _, delays, _ = self._true.read(arms)
        return UncertainStates(np.repeat(states, 2, 1), {"payload_mass": self._masses}, np.repeat(delays, 2, 1), 1)


def test_a_change_keeps_the_limits_of_all_possible_models():
    """With the heavier payload the arm exceeds its limits under torques that are safe for the most probable one."""
    plant, worst = plant_of(), []
    state = np.zeros(2 * plant.model.n_dof)
    heavy = 5.0 * plant.model.constants.payload_mass[0]
    for source in (TrueState(plant), TwoPayloads(plant, heavy)):
        safety = filter_of(plant, ONE, source)
        batch = Batch(plant.model, *plant.integration, plant.period, arms=2)
        batch.vary(np.arange(2), payload_mass=np.full(2, heavy))
        batch.reset(np.arange(2), np.zeros((2, len(state))))
        shares, applied = Limits(**ONE).predicted(plant.model), np.zeros(1)
        largest, stiffness = 0.0, np.repeat(plant.model.constants.joint_stiffness[None], 2, axis=0)
        for _ in range(25):
            applied = filtered(safety, [1.0], batch.state[0], applied)
            batch.step(np.tile(np.hstack([applied * plant.torque_limit, np.zeros(6)]), (2, 1)))
            now = shares.shares(batch.state[:, None], batch.outputs[:, None], stiffness)
            largest = max(largest, np.abs(now[0]).max())
        worst.append(largest)
    assert worst[0] > 1.03 and worst[1] < 1.0, worst


def test_torques_beyond_the_limits_of_a_possible_model_are_not_confirmed():
    """Those confirmed keep the limits of both payloads; some keep those of the lighter one only."""
    plant, arm, confirmed, largest = plant_of(), np.array([0]), [], []
    safety = filter_of(plant, ONE, TwoPayloads(plant, 5.0 * plant.model.constants.payload_mass[0]))
    d, motors, state = plant.model.n_dof, plant.model.motor_columns, np.zeros(2 * plant.model.n_dof)
    state[d:][0] = state[d:][motors] = 2.3
    filtered(safety, [0.0], state)
    for action in np.linspace(0.0, 1.0, 21)[:, None]:
        cases = safety._cases(arm)
        confirmed.append(safety._confirm(arm, cases, action[None])[0][0])
        largest.append(np.abs(safety._predict(cases, action[None, None])[0][0]).max(axis=(1, 2)))
    light, heavy = np.array(largest).T < REMAINDER + TOLERANCE
    assert heavy[confirmed].all() and any(confirmed) and (light & ~heavy).any()


def test_the_predicted_brake_damps_the_rates_of_all_torques_before():
    """Those of the agent in periods without a prediction, too: its damper is that of a simulation with them."""
    plant = plant_of()
    safety = filter_of(plant, {"strain": 1.0})
    batch = Batch(plant.model, METHOD, plant.integration[1], plant.period, arms=1)
    batch.reset(np.array([0]), np.zeros((1, 2 * plant.model.n_dof)))
    agent, rates, applied = [0.2, 0.5, -0.3, 0.4], [], np.zeros(1)
    for action in agent:
        applied = filtered(safety, [action], batch.state[0], applied)
        assert applied == action and safety.status[0] == PASSED
        batch.step(np.hstack([applied * plant.torque_limit, np.zeros(6)])[None])
        rates.append(batch.state[0, plant.model.n_dof :][plant.model.motor_columns][0])
    assert safety._check_ages[0] == 0, "one prediction, in the first period"
    scale = -BRAKE * plant.gains()["damping"][0] / plant.torque_limit[0]
    assert safety._backup[0, 0, 0] == pytest.approx(scale * rates[-1], rel=0.02)
    assert abs(scale * rates[-1]) > 0.01


def test_torques_between_the_brake_and_those_of_the_agent(monkeypatch):
    """Where models differ too much after the torques of the agent, some about those of the brake are found."""
    plant, stops = plant_of(), []
    heavy = 20.0 * plant.model.constants.payload_mass[0]
    for fractions in (safety_module.FRACTIONS, ()):
        monkeypatch.setattr(safety_module, "FRACTIONS", fractions)
        safety, applied, status = filter_of(plant, ONE, TwoPayloads(plant, heavy)), np.zeros(1), []
        batch = Batch(plant.model, *plant.integration, plant.period, arms=2)
        batch.reset(np.arange(2), np.zeros((2, 2 * plant.model.n_dof)))
        for period in range(40):
            applied = filtered(safety, [1.0 if period // 5 % 2 == 0 else -1.0], batch.state[0], applied)
            status.append(safety.status[0])
            batch.step(np.tile(np.hstack([applied * plant.torque_limit, np.zeros(6)]), (2, 1)))
        stops.append(status.count(STOPPED))
    assert 2 * stops[0] < stops[1]


def test_an_agent_settles_within_a_limit_of_rates():
    """A quintic slew that exceeds the limit without the filter; with the fast brake alone it does not settle."""
    limits = fm.Limits(on_violation="record", margin={"rate": fm.Limits.rate - 0.5342})
    environment = Configuration.find("FlexRRR-v0").replace(limits=limits)
    agent = {"kind": "lqr-tracking", "timing": "quintic"}
    free, safe = (fm.rollout(agent, environment, range(9000, 9008), safety=each) for each in (False, True))
    largest = [max(np.max(each.excess) for each in run.records) for run in (free, safe)]
    assert largest[0] > 0.0 >= largest[1]
    assert METRICS["settling_time"].evaluate(safe.records) < 1.1 * METRICS["settling_time"].evaluate(free.records)


UNLIKE = [
    ("FlexOne-v0", {"limits": ONE}),
    ("FlexOne-v0", {"limits": ONE, "randomisation": UNKNOWN, "action_repeat": 3, "horizon": 0.4}),
    ("FlexPlanar-v0", {"limits": PLANAR, "randomisation": UNKNOWN, "base": "adaptive-lqr"}),
    ("FlexOne-v0", {"limits": ONE, "actions": "velocity"}),
    ("FlexRotary-v0", {"limits": {"strain": 2e-4, "on_violation": "record"}, "actions": "voltage"}),
]


@pytest.mark.parametrize(("name", "settings"), UNLIKE)
def test_an_arm_among_others_has_the_bits_of_a_single_one(name, settings):
    same_alone_and_among_others(name, 45, safety=True, **settings)


@pytest.mark.parametrize(("name", "settings"), UNLIKE)
def test_a_state_or_a_copy_continues_to_the_bit(name, settings):
    """In an environment that was only reset, in one that acted, and in a copy."""
    envs = [FlexManVectorEnv(3, name=name, safety=True, **settings) for _ in range(3)]
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (40, 3, envs[0].single_action_space.shape[0]))
    for env, seed, periods in zip(envs, (4, 5, 6), (20, 0, 10), strict=True):
        env.reset(seed=seed)
        for action in actions[:periods]:
            env.step(action)
    state = envs[0].get_state()
    envs.append(copy.deepcopy(envs[0]))
    for env in envs[1:3]:
        env.set_state(state)
    for action in actions[20:]:
        first, *others = [env.step(action) for env in envs]
        for other in others:
            assert np.array_equal(first[0], other[0])
            for key in ("safety_status", "safety_change"):
                assert np.array_equal(first[-1][key], other[-1][key])


@pytest.mark.filterwarnings("ignore:safety. the filter keeps:UserWarning")
def test_the_filter_has_its_own_estimator_of_uncertain_arms():
    """One with the settings of the estimator of the base controller, which is not changed by it."""
    unknown = {"safety": True, "randomisation": UNKNOWN}
    episodes = FlexManEnv(name="FlexOne-v0", base={"kind": "adaptive-lqr", "biased": True}, **unknown).episodes
    own, given = episodes.safety.source._estimator, episodes.base.observer
    assert own is not given and own.sensors == episodes.safety.sensors
    assert own._models.size == given._models.size > FlexManEnv(
        name="FlexOne-v0", base="lqr", **unknown).episodes.safety.source._estimator._models.size  # fmt: skip
    assert isinstance(FlexManEnv(name="FlexOne-v0", safety=True).episodes.safety.source, TrueState)


def test_metrics_contain_the_change_and_an_agent_has_one_filter():
    limits = {"limits": {"strain": 1e-4, "on_violation": "record"}}
    environment = Configuration("FlexOne-v0", limits)
    free, safe = (fm.evaluate("lqr", environment, range(2), **own) for own in ({}, {"safety": True}))
    assert free["excess"] > 0.3 > 0.0 == safe["violations"] and safe["change"] > 0.0 and "change" not in free
    designed = fm.evaluate("lqr", environment.replace(safety=True), range(2))
    assert designed == safe


def test_the_setting_is_kept_by_files(tmp_path):
    given = Configuration("FlexOne-v0", {"safety": True})
    for suffix in ("json", "yaml"):
        given.save(tmp_path / f"own.{suffix}")
        assert Configuration.load(tmp_path / f"own.{suffix}").safety is True
    assert Configuration.find("FlexOne-v0").safety is False
    assert refusal(lambda: FlexManEnv(safety="yes")).startswith("safety: 'yes'")


def test_a_warning_names_the_limits_if_only_those_of_the_model_are_kept():
    """Limits of strain, spring torque or workspace, a tighter limit of the model and no filter need no warning."""
    with pytest.warns(UserWarning, match="^safety: ") as caught:
        gym.make("FlexOne-v0", safety=True)
    (message,) = (str(each.message) for each in caught if str(each.message).startswith("safety: "))
    assert "\n" not in message and "limits={'strain': 1e-4}" in message
    limits = NAMED_ENVIRONMENTS["FlexOne-v0"].limits
    assert f"angle {limits.angle:g} rad" in message and f"tip_speed {limits.tip_speed:g} m/s" in message
    with warnings.catch_warnings():
        warnings.filterwarnings("error", "safety: ")
        gym.make("FlexOne-v0")
        for own in ({"strain": 1e-4}, {"spring_torque": 100.0}, {"workspace": WALL}, {"rate": 2.0}):
            gym.make("FlexOne-v0", safety=True, limits=own)
    with pytest.warns(UserWarning, match="^safety: "):
        gym.make("FlexOne-v0", safety=True, limits={"on_violation": "cost"})


@pytest.mark.filterwarnings("ignore:safety. the filter keeps:UserWarning")
def test_environments_without_a_brake_or_a_prediction_are_refused():
    other = {"arm": fm.catalog.paper_rrr(), "torque_limit": 400.0, "modes": 1}
    assert refusal(lambda: FlexManEnv(name="FlexRRR-v0", safety=True, **other)).startswith("gains: ")
    lag = {"name": "FlexOne-v0", "safety": True, "drive_bandwidth": 10.0}
    assert refusal(lambda: FlexManEnv(**lag)).startswith("safety: True is not allowed; give False with drive_bandwidth")


@pytest.mark.filterwarnings("ignore:safety. the filter keeps:UserWarning")
def test_without_the_solver_one_line_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "daqp", None)
    with pytest.raises(ImportError, match=r"^the safety filter needs daqp: pip install 'flexman_gym\[mpc\]'$"):
        FlexManEnv(name="FlexOne-v0", safety=True)


def test_derivatives_and_exported_code_are_refused():
    safe = Configuration("FlexOne-v0", {"safety": True})
    calls = (
        lambda: fm.sensitivities(safe, of="return", to=("stiffness",), agent="pd"),
        lambda: begin_agent("pd", safe),
    )
    for call in calls:
        assert refusal(call).startswith("safety: True is not allowed; give False: the safety filter ")
