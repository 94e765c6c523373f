"""Protocol: what an environment tells the controller that acts beside an agent, and which controllers it takes."""

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.envs.effects import SIGNALS
from flexman_gym.envs.effects.tip_load import TipLoad
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.envs.sensors import Servo
from flexman_gym.envs.vector_env import FlexManVectorEnv

from oracles.episodes import actions
from oracles.refusals import refusal


class Listener:
    """Asks for three quarters of the limits of all motors, and keeps what it is told."""

    sensors = ("servo",)

    def __init__(self):
        self.episodes, self.told = [], []

    def reset(self, arms, episode):
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
    env = FlexManVectorEnv(8, base=base, hold=4, limits=fm.Limits(rate=1.5))
    env.reset(seed=1)
    env.episodes.watch = lambda: over.append(env.episodes.over.copy())
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
    assert arms.tolist() == [0] and episode.period == env.setup.control_period
    assert episode.start == pytest.approx(env.simulator.state[None, :n], abs=1e-1) and episode.goal.shape == (1, n)
    if name == "FlexOne-v0":
        assert episode.reference is None
        return
    goals = [env.episodes.view.goal_angles[0].copy()]
    for _ in range(env.setup.longest):
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

    keep = ("told",)


class Slotted:
    """One without a dictionary of its own."""

    __slots__ = ()
    sensors = ("servo",)

    def reset(self, arms, episode):
        pass

    def act(self, readings, applied, playing):
        return np.zeros_like(readings["motor_rates"])


def test_a_controller_needs_no_dictionary():
    env = FlexManEnv(base=Slotted())
    env.reset(seed=0)
    assert env.step(np.zeros(3))[4]["status"] == "ok"


@pytest.mark.parametrize(
    ("base", "line"),
    [
        (Silent, "base.act: '(readings)' is not allowed; give (readings, applied, playing)"),
        (Forgetful, "base.keep: ('told',) is not allowed; give kept, if it is meant, or another name"),
    ],
)
def test_a_controller_that_would_not_be_heard_is_refused(base, line):
    assert refusal(lambda: FlexManEnv(base=base())) == line


class Figured(fm.Slew):
    """A task that names its figures, nearly."""

    figure = ("reward",)


class Measuring(Servo):
    """A sensor that says what it measures, nearly."""

    measure = ()


class Pushing(TipLoad):
    """An effect whose hook has a name of its own."""

    def add_tip_force(self, forces, over):
        pass


def test_misspelt_members_of_tasks_sensors_and_effects_are_refused(monkeypatch):
    said = refusal(lambda: FlexManEnv(task=Figured()))
    assert said == "task.figure: ('reward',) is not allowed; give figures, if it is meant, or another name"
    said = refusal(lambda: FlexManEnv(sensors=Measuring()))
    assert said == "sensors.measure: () is not allowed; give measures, if it is meant, or another name"
    monkeypatch.setitem(SIGNALS, "tip_load", Pushing)
    said = refusal(lambda: FlexManEnv(randomisation={"tip_load": (0.0, 1.0)}))
    assert said.startswith("tip_load.add_tip_force: <bound method") and "give add_tip_forces, if it is meant" in said
