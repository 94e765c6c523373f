"""A control period of a single arm in one call of a kernel has the results of the general way, bit for bit."""

import pickle

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.agent.action_modes import TorqueMode
from flexman_gym.agent.pd import PD
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.envs.sensors import FullState
from flexman_gym.envs.vector_env import FlexManVectorEnv
from flexman_gym.simulation.batch_integrators import SequentialIntegrator
from flexman_gym.simulation.integrator import Integrator

from oracles.assertions import refusal

COMPILED = {"FlexRRR-v0", "FlexRRR-Gravity-v0", "FlexPlanar-v0", "FlexOne-v0"}
PLANAR = {"name": "FlexPlanar-v0", "horizon": 0.12}


class _OwnTask(fm.Slew):
    def reward_terms(self, view):
        return {"own": -view.tip_error - view.tip_velocity[..., 0]}


class _OwnSensor(FullState):
    def read(self, view, out):
        super().read(view, out)
        out[:] *= 0.5


class _OwnMode(TorqueMode):
    def act(self, actions, readings, applied, active):
        return -actions


# settings with which nothing in Python takes part in a control period
FAST = {
    "distance": {},
    "bells": {"task": "slew"},
    "exponential": {"task": fm.Slew(reward="exponential")},
    "weights": {"reward": {"distance": 2.0, "failure": -0.5}},
    "own reward": {"reward": lambda view: -view.tip_error * view.effort},
    "own terms": {"task": _OwnTask()},
    "hold without disturbances": {
        "task": "hold", "randomisation": {"tip_impulse": None, "tip_load": None, "base_sway": None},
    },
    "parameters": {"condition": "payload"},
    "start": {"randomisation": {"initial_vibration": (0.0, 0.01)}},
    "info": {"info_keys": ["motor_angles", "tip_acceleration", "action"], "energy_alarm": 1e-9},
    "limits": {"limits": {"rate": 2.0}},
    "method": {"method": "ros2", "step": 0.005},
    "explicit method": {"method": "rk4", "step": 0.01 / 64, "modes": (1, 1), "elements": 1},
    "fine": {"step": 0.01 / 64},
    "stiffening": {"stiffening": True},
}  # fmt: skip
# one setting each with which the general way is taken
SLOW = {
    "base": {"base": "pd"},
    "base object": {"base": PD((39.0, 5.56), (9.35, 1.33), (1.0, 1.0))},
    "action mode": {"actions": "position"},
    "own mode": {"actions": _OwnMode(2)},
    "strength": {"actions": TorqueMode(2, strength=np.array([0.5, 0.25]))},
    "repeat": {"action_repeat": 2},
    "history": {"history": 2},
    "averages": {"history": (0.05,)},
    "sensor": {"sensors": "lab"},
    "two sensors": {"sensors": ["full", "fine"]},
    "no sensor": {"sensors": []},
    "flaws": {"sensors": {"kind": "full", "noise": 0.01}},
    "own sensor": {"sensors": _OwnSensor()},
    "lag": {"drive_bandwidth": 20.0},
    "delay": {"randomisation": {"delay": (1, 1)}},
    "noise": {"randomisation": {"sensor_noise": (0.01, 0.01)}},
    "load": {"randomisation": {"tip_load": (1.0, 2.0)}},
    "sway": {"randomisation": {"base_sway": (1.0, 2.0)}},
    "moving goal": {"task": "track"},
    "preview": {"task": {"kind": "track", "preview": [0.05]}},
    "hold": {"task": "hold"},
    "implicit method": {"method": "generalised_alpha"},
}


def both(**settings):
    """Return two equal environments, the second without the compiled control period."""
    envs = [FlexManEnv(**PLANAR | settings) for _ in range(2)]
    envs[1].episodes._compiled = None
    return envs


def bits(value):
    """Return nested data with arrays and numbers as bytes."""
    if isinstance(value, dict):
        return {name: bits(each) for name, each in value.items()}
    if isinstance(value, tuple | list):
        return [bits(each) for each in value]
    return value if isinstance(value, str | int | None) else (np.asarray(value).dtype.kind, np.asarray(value).tobytes())


def actions(env, count=30):
    """Return actions with which some episodes are truncated and some fail."""
    random, size = np.random.default_rng(0), env.action_space.shape
    scale = np.where(np.arange(count) < count // 2, 0.05, 1.0)
    return (scale[:, None] * random.uniform(-1.0, 1.0, (count, *size))).astype(np.float32)


def run(env, given):
    """Yield the results of resets and steps over several episodes."""
    yield env.reset(seed=5)
    for action in given:
        outcome = env.step(action)
        yield outcome
        if outcome[2] or outcome[3]:
            yield env.reset()


@pytest.mark.feature
@pytest.mark.parametrize("name", [*FAST, *SLOW])
def test_results_equal_those_of_the_general_way(name):
    envs = both(**(FAST | SLOW)[name])
    for ours, general in zip(*(run(env, actions(env)) for env in envs), strict=True):
        assert bits(ours) == bits(general)
    assert bits(envs[0].get_state()) == bits(envs[1].get_state())
    assert (envs[0].episodes._compiled is not None) == (name in FAST)


@pytest.mark.parametrize("id", NAMED_ENVIRONMENTS)
def test_named_environments(id):
    """Those with a goal at rest, the full state and no disturbances are compiled; all have the results of a vector."""
    env, vector = FlexManEnv(name=id, horizon=0.1), FlexManVectorEnv(1, name=id, horizon=0.1)
    assert (env.episodes._compiled is not None) == (id in COMPILED)
    assert np.array_equal(env.reset(seed=3)[0], vector.reset(seed=3)[0][0])
    for action in actions(env, 5):
        (seen, reward, failed, ended, _), many = env.step(action), vector.step(action[None])
        assert np.array_equal(seen, many[0][0])
        assert (reward, failed, ended) == (many[1][0], many[2][0], many[3][0])


def test_a_failure_and_a_truncation_in_the_same_period():
    for env in both(limits={"rate": 0.02}, horizon=0.01):
        env.reset(seed=0)
        outcome = env.step(np.ones(2, dtype=np.float32))
        assert outcome[2] and outcome[3] and outcome[4]["failure"].startswith("motor_rates")
        assert outcome[4]["reward_terms"]["failure"] == -10.0
        with pytest.raises(RuntimeError, match="the episode is over"):
            env.step(np.zeros(2))


def test_a_divergence_ends_the_episode():
    results = []
    for env in both(limits={"rate": 1e9, "deflection": 1e9, "deflection_rate": 1e9, "tip_speed": 1e9, "twist": 1e9,
                            "angle": 1e9}, torque_limit=1e7, horizon=1.0):  # fmt: skip
        outcomes = []
        for outcome in run(env, np.ones((8, 2))):
            outcomes.append(bits(outcome))
        results.append(outcomes)
        assert any(each[-1]["status"] != "ok" for each in outcomes)
    assert results[0] == results[1]


def test_a_state_passes_from_one_way_to_the_other():
    """In the middle of an episode, by `set_state` and by pickle."""
    ours, general = both(horizon=1.0)
    given = actions(ours)
    outcomes = []
    for first, second in ((ours, general), (general, ours), (general, general)):
        first.reset(seed=2)
        for action in given[:7]:
            first.step(action)
        second.set_state(first.get_state())
        copied = pickle.loads(pickle.dumps(second))
        outcomes.append([bits(second.step(action)) for action in given[7:14]])
        outcomes.append([bits(copied.step(action)) for action in given[7:14]])
    assert all(each == outcomes[0] for each in outcomes)


@pytest.mark.parametrize("wrong", [[2.0, 0.0], [np.nan, 0.0], [0.0, 1.00001], [0.0], np.zeros((1, 2)), "ab", None])
def test_a_refused_action_changes_nothing(wrong):
    env = FlexManEnv(**PLANAR)
    env.reset(seed=0)
    env.step(np.full(2, 0.1))
    before = bits(env.get_state())
    for kind in (np.float32, np.float64, None):
        given = wrong if kind is None or isinstance(wrong, str | None) else np.array(wrong, dtype=kind)
        assert refusal(lambda: env.step(given)).startswith("action: ")  # noqa: B023
        assert bits(env.get_state()) == before


@pytest.mark.parametrize("action", [[0.25, -1], np.array([1, 0]), np.array([1.0000001, -0.5]), (0.5, 0.5),
                                    np.array([0.5, -1.0], dtype=">f4"), np.arange(4.0)[::2] / 4.0])  # fmt: skip
def test_actions_of_other_kinds(action):
    results = []
    for env in both():
        env.reset(seed=0)
        results.append([bits(env.step(action)) for _ in range(2)] + [bits(env.get_state())])
    assert results[0] == results[1]


def test_a_watched_episode_is_watched():
    env = FlexManEnv(**PLANAR)
    env.reset(seed=0)
    seen = []
    env.episodes.callback = lambda: seen.append(env.episodes.view.action.copy())
    env.step(np.full(2, 0.1))
    assert len(seen) == 1


def test_another_integrator_takes_over():
    """The constants of the arm are those of the new integrator, not of the bound one."""
    results = []
    for env in both():
        batch = env.simulator.batch
        heavy = Integrator(batch.model, batch.method, None, [])
        heavy.constants = heavy.constants._replace(payload_mass=np.array([0.5]))
        batch.replace_integrator(lambda _: SequentialIntegrator([heavy], (0.01, 4)))  # noqa: B023
        results.append([bits(each) for each in run(env, actions(env, 6))])
    assert results[0] == results[1]


def test_quantities_computed_on_demand_are_those_of_the_present_state():
    ours, general = both()
    for env in (ours, general):
        env.reset(seed=0)
    for action in actions(ours, 4):
        for env in (ours, general):
            env.step(action)
        for name in ("tip_acceleration", "specific_force", "root_strains", "time"):
            assert bits(getattr(ours.episodes.view, name)) == bits(getattr(general.episodes.view, name))
        assert bits(ours.episodes.rewards()) == bits(general.episodes.rewards())
        assert bits(ours.episodes.agent.command) == bits(general.episodes.agent.command)
