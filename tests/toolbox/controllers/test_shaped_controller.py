"""Controller behind an input shaper."""

import gymnasium as gym
import numpy as np
import pytest

from flexman_gym.agent.controller import Controller
from flexman_gym.agent.pd import PD
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.evaluation.metrics import evaluate
from flexman_gym.evaluation.rollouts import rollout
from flexman_gym.model.model import build_model
from flexman_gym.model.statics import rest_tips
from flexman_gym.scene import catalog
from flexman_gym.toolbox.controllers.excited_modes import excited_modes
from flexman_gym.toolbox.controllers.input_shaping.shaped_controller import InputShapedController
from flexman_gym.toolbox.controllers.input_shaping.shapers import design_shaper, shaper_residual
from flexman_gym.toolbox.controllers.lqr import LQR

from oracles.assertions import refusal

ONE = Configuration.from_keywords({"name": "FlexOne-v0"})
MODEL = resolve_fidelity(ONE).model
PLANAR = resolve_fidelity(Configuration.from_keywords({"name": "FlexPlanar-v0"})).model
SOFT = {"stiffness": (0.4,), "damping": (0.2,)}


class Listener:
    """Does nothing and keeps what it is told."""

    def __init__(self, *sensors):
        self.sensors, self.episodes, self.heard = sensors, [], []

    def reset(self, arms, episode, count):
        self.episodes.append(episode)

    def act(self, readings, applied, active):
        self.heard.append({name: values.copy() for name, values in readings.items()})
        return np.zeros_like(applied)


def heard(name, periods, sensors, **shaping):
    """What a Listener behind a shaper hears in an environment, and the environment."""
    listener = Listener(*sensors)
    model = resolve_fidelity(Configuration.from_keywords({"name": name})).model
    env = FlexManEnv(name=name, base=InputShapedController(listener, model, **shaping))
    env.reset(seed=3)
    truth = []
    for _ in range(periods):
        view = env.episodes.view
        truth.append([each[0].copy() for each in (view.goal_angles, view.goal_rates, view.motor_angles, view.target)])
        env.step(np.zeros(model.n_joints, dtype=np.float32))
    told = {each: np.array([row[each][0] for row in listener.heard]) for each in listener.heard[0]}
    return listener.episodes[0], told, [np.array(rows) for rows in zip(*truth, strict=True)]


def test_a_shaped_step_reaches_the_goal_by_its_impulses():
    """All that tells the goal tells the same command, which is also the path of the episode."""
    sensors = ("servo", "command", "motor_encoders")
    episode, told, (goals, _, motors, targets) = heard("FlexPlanar-v0", 90, sensors, shaper="zv")
    start, goal = episode.start[0], episode.goal[0]
    frequency, ratio, _ = excited_modes(PLANAR, goal)[0]
    parts = np.cumsum(design_shaper("zv", frequency, ratio).sample(0.01))
    wanted = start + np.append(parts, np.ones(90))[:90, None] * (goal - start)
    assert told["angle_command"] == pytest.approx(wanted, abs=1e-12) and 0.3 < parts[0] < 0.7
    assert told["angle_errors"] + motors == pytest.approx(wanted, abs=1e-12)
    assert episode.reference[0] == pytest.approx(wanted[: len(episode.reference[0])], abs=1e-12)
    assert (episode.reference[0][-1], goals[0]) == (pytest.approx(goal), pytest.approx(goal))
    assert not told["goal_rates"].any() and not told["rate_command"].any(), "a step has no rate that a drive follows"
    assert told["tip_command"] == pytest.approx(rest_tips(PLANAR, wanted), abs=1e-9)
    assert told["tip_command"][-1] == pytest.approx(targets[0], abs=1e-9) and len(parts) < 80


def test_a_command_with_a_duration_is_a_smooth_motion_with_its_rates():
    _, told, _ = heard("FlexOne-v0", 150, ("servo", "command"), shaper="zvd", duration=0.5)
    angles, rates = told["angle_command"], told["rate_command"]
    assert rates[1:] == pytest.approx(np.diff(angles, axis=0) / 0.02, abs=1e-9) and rates[0] == 0.0
    assert np.abs(np.diff(rates, axis=0)).max() < 0.3 * np.abs(rates).max() and rates[-1] == pytest.approx(0.0)
    assert told["goal_rates"] == pytest.approx(rates)
    speeds = np.diff(told["tip_command"], axis=0) / 0.02
    assert told["tip_velocity_command"][1:] == pytest.approx(speeds, abs=1e-9) and np.abs(speeds).max() > 0.1


def test_of_a_path_it_tells_what_the_path_was():
    """Each impulse is late by its time; the arm has rested at the start of the path before."""
    modes = [(1.3, 0.0), (4.0, 0.01)]
    episode, told, (goals, rates, _, _) = heard("FlexPlanar-Track-v0", 200, ("servo", "command"), modes=modes)
    late = np.convolve(*(design_shaper("zvd", *mode).sample(0.01) for mode in modes))
    before = np.vstack([np.repeat(goals[:1], len(late), axis=0), goals])
    still = np.vstack([np.zeros((len(late), 2)), rates])
    for seen, past in (("angle_command", before), ("rate_command", still), ("goal_rates", still)):
        wanted = np.array([np.convolve(column, late)[len(late) : len(late) + 200] for column in past.T]).T
        assert told[seen] == pytest.approx(wanted, abs=2e-3), seen
    assert episode.reference[0][:200] == pytest.approx(told["angle_command"], abs=1e-12)
    assert episode.goal[0] == pytest.approx(goals[0])


def controllers():
    """A PD and an LQR that stay within their torques on a small slew."""
    weights = LQR(MODEL, ONE.torque_limit, ONE.control_period).weights
    return PD(**SOFT, torque_limit=ONE.torque_limit), LQR(MODEL, ONE.torque_limit, ONE.control_period, weights)


@pytest.mark.parametrize("which", [0, 1])
def test_on_a_small_slew_the_arm_answers_as_to_its_impulses_one_by_one(which):
    """Superposition: a linear loop behind a shaper moves as the sum of what it does without one, late by each impulse.

    The arm is linear but for the square of 0.005 rad.
    """

    def motion(base):
        env = FlexManEnv(name="FlexOne-v0", base=base, horizon=4.0)
        env.reset(seed=0, options={"start": [0.0], "goal_angles": [0.005]})
        rows = [env.episodes.view.state[0].copy()]
        for _ in range(150):
            env.step(np.zeros(1, dtype=np.float32))
            rows.append(env.episodes.view.state[0].copy())
            assert np.abs(env.episodes.view.action).max() < 0.9
        return np.array(rows)

    plain, shaped = (
        motion(base) for base in (controllers()[which], InputShapedController(controllers()[which], MODEL, "mzv"))
    )
    parts = design_shaper("mzv", *excited_modes(MODEL, [0.005])[0, :2]).sample(0.02)
    wanted = np.array([np.convolve(column, parts)[: len(plain)] for column in plain.T]).T
    scale = np.abs(plain).max(axis=0)
    assert np.abs((shaped - wanted) / np.where(scale > 1e-6, scale, np.inf)).max() < 2e-3
    assert np.abs(shaped - plain)[:, 0].max() > 0.1 * scale[0]


def test_modes_are_those_of_the_places_that_are_asked_for():
    goal, start = np.array([0.3, 1.9]), np.array([0.2, 0.0])
    inner = PD((1.0, 1.0), (1.0, 1.0), 12.0)
    for places, postures in (((1.0,), [goal]), ((0.0, 1.0), [start, goal]), ((0.5,), [0.5 * (start + goal)])):
        mode = np.mean([excited_modes(PLANAR, posture)[0, :2] for posture in postures], axis=0)
        way = start + np.array(places)[:, None] * (goal - start)
        combined = InputShapedController(inner, PLANAR, "zv", places=places).combined(way)
        assert combined.times == pytest.approx(design_shaper("zv", *mode).times)
    two = InputShapedController(inner, PLANAR, "zvd", modes=2).combined(goal[None])
    left = [shaper_residual(two, frequency, ratio) for frequency, ratio, _ in excited_modes(PLANAR, goal)[:2]]
    assert left == pytest.approx([0.0, 0.0], abs=1e-9)


def test_stiff_motors_behind_a_shaper_leave_little_of_the_vibration():
    """A rotor that is heavy and held stiffly: the tip vibrates a tenth as far as without a shaper."""
    gains = {"stiffness": [300.0], "damping": [60.0]}
    settings = {"arm": {"catalog": "one_joint"}, "torque_limit": 500.0, "horizon": 5.0, "control_period": 0.005}
    heavy = Configuration("FlexOne-v0", settings).changed(
        ["arm.joints=[{axis: [0, 0, 1], rotor_inertia: 3.0, stiffness: 20.0, damping: 0.005}]"]
    )
    seen = [
        evaluate({"kind": kind, **gains, **more}, heavy, [0, 1, 2])["vibration"]
        for kind, more in (("pd", {}), ("pd-shaped", {}))
    ]
    assert seen[1] < 0.1 * seen[0], seen


def test_arms_side_by_side_are_shaped_as_each_alone():
    many = rollout("pd-shaped", Configuration("FlexPlanar-v0", {"horizon": 1.5}), [4, 5, 6])
    for row, seed in enumerate([4, 5, 6]):
        one = rollout("pd-shaped", Configuration("FlexPlanar-v0", {"horizon": 1.5}), [seed])
        assert np.array_equal(many.actions[row], one.actions[0]) and np.array_equal(many.tips[row], one.tips[0])


@pytest.mark.slow
def test_a_tracking_lqr_follows_a_shaped_motion():
    settled = evaluate(
        InputShapedController(gym_lqr(), PLANAR, "zv", duration=0.6), Configuration("FlexPlanar-v0"), [0, 1, 2]
    )
    assert settled["settled"] == 1.0 and settled["vibration"] < 1e-4


def gym_lqr():
    """The tracking LQR of the planar environment."""
    env = gym.make("FlexPlanar-v0", base="lqr-tracking").unwrapped
    return env.episodes.base


def test_it_is_a_controller_and_refuses_what_it_cannot_shape():
    inner = PD((1.0,), (1.0,), 1.0)
    shaped = InputShapedController(inner, MODEL)
    assert isinstance(shaped, Controller) and shaped.sensors == ("servo",)
    assert refusal(lambda: InputShapedController(3, MODEL)).startswith("InputShapedController.inner: 3 ")
    assert refusal(lambda: InputShapedController(inner, MODEL, modes=3)).startswith("InputShapedController.modes: 3 ")
    assert refusal(lambda: InputShapedController(inner, MODEL, modes=[(1.0, 0.0)] * 3)).startswith(
        "InputShapedController.modes: "
    )
    assert refusal(lambda: InputShapedController(inner, MODEL, modes=[(0.0, 0.0)])).startswith("frequency: 0.0 ")
    assert refusal(lambda: InputShapedController(inner, MODEL, places=(1.1,))).startswith(
        "InputShapedController.places: (1.1,) "
    )
    said = refusal(lambda: heard("FlexOne-v0", 1, ("full",)))
    assert said.startswith(
        "InputShapedController.inner: 'a controller that reads target_nearness' is not allowed; give one that reads"
    )
    rigid = build_model(catalog.one_joint(), 1, flexible_links=False, flexible_joints=False)
    assert refusal(lambda: InputShapedController(inner, rigid).combined(np.zeros((1, 1)))).startswith(
        "InputShapedController.modes: 1 is not allowed"
    )
