"""Protocol: what an environment tells the controller that acts beside an agent, and which controllers it takes."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.agent.pd import PD
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.envs.effects import SIGNALS
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.envs.sensors import Instrument, ServoErrors
from flexman_gym.envs.vector_env import FlexManVectorEnv
from flexman_gym.model.assembled_modes import assembled_modes
from flexman_gym.simulation.batch import Batch

from oracles.assertions import refusal
from oracles.random_inputs import actions


class Listener:
    """Asks for three quarters of the limits of all motors, and keeps what it is told."""

    sensors = ("servo",)

    def __init__(self):
        self.episodes, self.told = [], []

    def reset(self, arms, episode, count):
        self.episodes.append((arms.copy(), episode))

    def act(self, readings, applied, playing):
        self.told.append((applied.copy(), playing.copy()))
        return np.full_like(readings["motor_rates"], 0.75)


def test_a_controller_is_told_the_sum_that_was_asked_for_cut_off_and_before_what_nobody_knows():
    """With torques that come two periods late, which does not change what was asked for."""
    base = Listener()
    env = FlexManVectorEnv(3, base=base, randomisation={"delay": (2, 2), "torque_limit_factor": (0.5, 0.9)})
    env.reset(seed=1)
    asked = [np.zeros((3, 3))]
    for action in actions(3, 30, seed=2):
        env.step(0.5 * action)
        asked.append(np.clip(0.75 + 0.5 * action.astype(float), -1.0, 1.0))
    assert np.array_equal([applied for applied, _ in base.told], asked[:-1])
    assert max(np.max(each) for each in asked) == 1.0, "the sum was cut off"


def test_a_controller_is_told_whose_episode_goes_on():
    """Also within an action that is kept: an arm that fails then plays no more."""
    base, over = Listener(), []
    env = FlexManVectorEnv(8, base=base, action_repeat=4, limits=fm.Limits(rate=1.5))
    env.reset(seed=1)
    env.episodes.callback = lambda: over.append(env.episodes.over.copy())
    for _ in range(30):
        expected, first = [~env.episodes.over], len(base.told)
        env.step(-np.linspace(0.0, 0.7, 8)[:, None] * np.ones(3))
        expected += [~each for each in over[first:-1]]
        assert np.array_equal([playing for _, playing in base.told[first:]], expected)
    assert any(playing.any() and not playing.all() for _, playing in base.told)


@pytest.mark.parametrize("name", ["FlexOne-v0", "FlexPlanar-Track-v0"])
def test_a_controller_is_told_start_goal_period_and_the_path_of_a_goal_that_moves(name):
    base = Listener()
    env = FlexManEnv(name=name, base=base, horizon=1.0)
    env.reset(seed=3)
    (arms, episode), n = base.episodes[0], env.simulator.model.n_joints
    assert arms.tolist() == [0] and episode.period == env.configuration.control_period
    assert episode.start == pytest.approx(env.simulator.state[None, :n], abs=1e-1) and episode.goal.shape == (1, n)
    if name == "FlexOne-v0":
        assert episode.reference is None
        return
    goals = [env.episodes.view.goal_angles[0].copy()]
    for _ in range(env.configuration.max_periods):
        env.step(np.full(n, -0.75))
        goals.append(env.episodes.view.goal_angles[0].copy())
    assert episode.reference[0] == pytest.approx(np.array(goals), abs=1e-6)
    assert np.ptp(goals, axis=0).max() > 0.05


class Silent(Listener):
    """One whose act is of before."""

    def act(self, readings):
        return np.zeros((1, 3))


class Forgetful(Listener):
    """One that means to say what it keeps."""

    state_field = ("told",)


class Slotted:
    """One without a dictionary of its own."""

    __slots__ = ()
    sensors = ("servo",)

    def reset(self, arms, episode, count):
        pass

    def act(self, readings, applied, playing):
        return np.zeros_like(readings["motor_rates"])


def test_a_controller_needs_no_dictionary():
    env = FlexManEnv(base=Slotted())
    env.reset(seed=0)
    assert env.step(np.zeros(3))[4]["status"] == "ok"


def test_a_controller_is_told_how_many_arms_there_are():
    """Also in a reset of some of them."""
    counts = []

    class Counting(Listener):
        def reset(self, arms, episode, count):
            counts.append((arms.tolist(), count))

    env = FlexManVectorEnv(3, base=Counting(), autoreset_mode="Disabled")
    env.reset(seed=0)
    env.reset(options={"reset_mask": np.array([True, False, False])})
    assert counts == [([0, 1, 2], 3), ([0], 3)]


@pytest.mark.parametrize(
    ("base", "line"),
    [
        (Silent, "base.act: '(readings)' is not allowed; give (readings, applied, active)"),
        (Forgetful, "base.state_field: ('told',) is not allowed; give state_fields, if it is meant, or another name"),
    ],
)
def test_a_controller_that_would_not_be_heard_is_refused(base, line):
    assert refusal(lambda: FlexManEnv(base=base())) == line


class Measured(fm.Slew):
    """A task with a misspelt name of its metrics."""

    metric = ("reward",)


class Measuring(ServoErrors):
    """A sensor that says what it measures, nearly."""

    measure = ()


class Pushing(SIGNALS["tip_load"]):
    """An effect whose hook has a name of its own."""

    def add_tip_force(self, forces, over):
        pass


def test_misspelt_members_of_tasks_sensors_and_effects_are_refused(monkeypatch):
    said = refusal(lambda: FlexManEnv(task=Measured()))
    assert said == "task.metric: ('reward',) is not allowed; give metrics, if it is meant, or another name"
    said = refusal(lambda: FlexManEnv(sensors=Measuring()))
    assert said == "sensors.measure: () is not allowed; give measures, if it is meant, or another name"
    monkeypatch.setitem(SIGNALS._own, "tip_load", Pushing)
    said = refusal(lambda: FlexManEnv(randomisation={"tip_load": (0.0, 1.0)}))
    assert said.startswith("tip_load.add_tip_force: <bound method") and "give add_tip_forces, if it is meant" in said


FLAWS = {"noise": 0.01, "bias": 0.02, "delay": 2}


def watched(sensors, own=("servo",)):
    """What an agent with some sensors and a base beside it read in 20 periods, and the rates that the base read."""

    class Watching(PD):
        def act(self, readings, applied, playing):
            read.append({name: values.copy() for name, values in readings.items()})
            return super().act(readings)

    base, read, seen = Watching((500.0,) * 3, (100.0,) * 3, 400.0), [], []
    base.sensors = own
    env = FlexManEnv(sensors=sensors, base=base)
    observation, _ = env.reset(seed=1)
    for _ in range(20):
        seen.append({name: observation[place] for name, place in env.sensors.slices.items()})
        observation, *_ = env.step(np.full(3, 0.1))
    return seen, read, np.array([each["motor_rates"] for each in read])


@pytest.mark.parametrize("kind", ["full", "lab", "motor_encoders"])
def test_flaws_of_an_agents_instruments_act_on_the_base_beside_it(kind):
    seen, read, rates = watched({"kind": kind, **FLAWS})
    goals = [base["angle_errors"][0] + agent["motor_angles"] for agent, base in zip(seen, read, strict=True)]
    assert np.ptp(goals, axis=0) == pytest.approx(0.0, abs=1e-6), "goal - angle, where the goal stays"
    assert rates[:, 0] == pytest.approx(np.array([agent["motor_rates"] for agent in seen]), abs=1e-6)
    assert np.abs(rates - watched(kind)[2]).max() > 0.05


def test_a_base_reads_the_truth_of_what_no_instrument_of_the_agent_measures():
    perfect = watched("strain")[2]
    assert np.array_equal(watched({"kind": "strain", **FLAWS})[2], perfect)
    assert (watched("full", (Instrument(ServoErrors(), noise=0.01),))[2] != perfect).any(), "but for flaws of its own"


def test_of_two_sensors_that_measure_the_same_the_base_reads_the_first():
    """A fine one measures all motion, so that it comes before encoders of the motors beside it, or after them."""
    flawed = {"kind": "motor_encoders", **FLAWS}
    perfect = watched("fine")[2]
    assert np.array_equal(watched(("fine", flawed))[2], perfect)
    assert np.array_equal(watched((flawed, "fine"))[2], watched(flawed)[2])
    assert np.abs(watched(flawed)[2] - perfect).max() > 0.05


def test_an_instrument_of_a_base_measures_in_every_period():
    """It comes two periods late to the base, and at once to the agent."""
    seen, _, rates = watched("full", (Instrument(ServoErrors(), delay=2),))
    true = np.array([each["motor_rates"] for each in seen])
    assert rates[2:, 0] == pytest.approx(true[:-2], abs=1e-6) and np.ptp(true, axis=0).min() > 0.01


def test_an_arm_of_the_same_lengths_is_not_the_named_arm():
    named = NAMED_ENVIRONMENTS["FlexRRR-v0"].arm
    light = replace(named, links=[replace(link, density=0.5 * link.density) for link in named.links])
    quick = replace(named, joints=[replace(joint, rotor_inertia=1.0) for joint in named.joints])
    soft = replace(named, joints=[replace(joint, stiffness=0.5 * joint.stiffness) for joint in named.joints])
    for arm in (light, quick, soft):
        line = refusal(lambda arm=arm: FlexManEnv(arm=arm, base="pd", settings="named"))
        assert line.startswith("gains: None is not allowed; give those of this arm")
    unlimited = replace(named, joints=[replace(joint, torque_limit=None) for joint in named.joints])
    assert refusal(lambda: FlexManEnv(arm=unlimited)).startswith("torque_limit: None is not allowed")
    gains = NAMED_ENVIRONMENTS["FlexRRR-v0"].pd
    rubbing = [replace(joint, viscous_friction=5.0, coulomb_friction=10.0) for joint in named.joints]
    for arm in (named, replace(named, payload=fm.Payload(5.0)), replace(named, joints=rubbing)):
        assert FlexManEnv(arm=arm, base="pd").configuration.gains == gains
    assert FlexManEnv(arm=light, base="pd", gains=gains).configuration.gains == gains


@pytest.mark.parametrize("period", [1e-12, 0.002, 0.005, 0.02, 0.03])
def test_there_is_one_default_wherever_steps_are_fixed(period):
    model = fm.build_model(fm.catalog.planar_2r(joint_stiffness=20.0), 1)
    default = FlexManEnv().simulator.method
    simulator, batch = fm.Simulator(model, control_period=period), Batch(model, control_period=period)
    assert simulator.method is batch.method is default
    assert simulator.control_period / simulator.substeps <= 0.005 + 1e-12
    assert simulator.step([0.0, 0.0]) == "ok"
    torque, start = fm.ConstantTorque([0.1, 0.0]), fm.Initial([0.1, -0.2], [0.0, 0.0])
    scene = fm.Scene(fm.catalog.planar_2r(joint_stiffness=20.0), fm.ModelChoice(True, 1), torque, start, 0.1, 0.01)
    assert np.array_equal(fm.simulate(scene, step=0.005).states, fm.simulate(scene, method=default, step=0.005).states)


@pytest.mark.parametrize(("name", "period"), [("FlexOne-v0", 0.02), ("FlexOne-v0", 0.005), ("FlexPlanar-v0", 0.01)])
def test_an_arm_has_the_modes_of_vibrations_below_half_the_control_frequency(name, period):
    """And not those of vibrations below all of it, which are more."""
    setup = Configuration.from_keywords({"name": name, "control_period": period})
    half, all_of_it = (assembled_modes(setup.arm, 2, part / period) for part in (0.5, 1.0))
    result, expected = resolve_fidelity(setup).model, fm.build_model(setup.arm, 2, half)
    assert half != all_of_it and result.n_dof == expected.n_dof
    assert all(np.array_equal(*bases) for bases in zip(result.bases, expected.bases, strict=True))


def test_actions_beyond_their_range_by_rounding_count_as_its_edge():
    beyond, edge = FlexManEnv(), FlexManEnv()
    beyond.reset(seed=0)
    edge.reset(seed=0)
    rounded = np.nextafter(np.float32(1.0), np.float32(2.0))
    seen, *_, info = beyond.step(np.array([rounded, -rounded, 1.0], dtype=np.float32))
    assert np.array_equal(seen, edge.step(np.array([1.0, -1.0, 1.0]))[0]) and info["status"] == "ok"
    for number in (1.0 + 2e-6, -1.0 - 2e-6, np.nan):
        assert refusal(beyond.step, np.array([number, 0.0, 0.0])).startswith("action: ")


@pytest.mark.feature
def test_pictures_and_metrics_are_there_without_an_import_of_their_own():
    assert callable(fm.draw.arm_frame) and callable(fm.metrics.peak_to_peak)


def test_environments_that_are_made_by_name_keep_their_spec_in_copies():
    import copy
    import pickle

    env = gym.make("FlexOne-v0", action_repeat=2)
    env.reset(seed=0)
    for other in (copy.deepcopy(env), pickle.loads(pickle.dumps(env))):
        assert other.unwrapped.spec == env.unwrapped.spec and other.unwrapped.spec.id == "FlexOne-v0"
