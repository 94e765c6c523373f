"""Tests of refused methods, steps, drives, states and parameters: one line names field, value and what is allowed."""

import json
from dataclasses import replace

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.methods import IteratedGauss
from flexman_gym.simulation.physical_parameters import varied_model

from oracles.assertions import refusal
from oracles.files import REFERENCE

pytestmark = pytest.mark.filterwarnings("ignore:Link.second_moment_y:UserWarning")
ARM = fm.catalog.paper_rrr()
RIGID, BENT = fm.build_model(ARM, flexible_links=False, flexible_joints=False), fm.build_model(ARM, 1, 1)
SCENE = replace(fm.catalog.paper_scene("ff"), duration=0.1)
WOBBLE = fm.Signal(amplitude=3.0, frequency_hz=1.5)
HALF_RIGID = fm.build_model(replace(ARM, joints=[*ARM.joints[:2], replace(ARM.joints[2], stiffness=None)]), modes=1)
SIGNALS = "3 of Signal, SampledSignal, SampledAngles or None"


def simulate(**options):
    """Simulate a short scene."""
    return fm.simulate(SCENE, **options)


def simulator(**options):
    """Return a simulator of the rigid arm."""
    return fm.Simulator(**({"model": RIGID} | options))


def reset(**options):
    """Reset a simulator of the rigid arm."""
    return fm.Simulator(RIGID).reset(**options)


def scene(**changes):
    """Return the scene with changes."""
    return replace(SCENE, **changes)


def batch(**arguments):
    """Return arms of a model."""
    return Batch(BENT, **arguments)


def vary(**parameters):
    """Give an arm with a rigid third joint other parameters."""
    return Batch(HALF_RIGID).vary(np.array([0]), **parameters)


def gauss(order, iterations, stages=1, correction=0.0):
    """Return an iterated Gauss method."""
    return IteratedGauss("mine", order, "", iterations, stages, correction)


def joint(**friction):
    """Return a joint with friction."""
    return fm.Joint((0.0, 0.0, 1.0), 1.0, **friction)


REFUSED = {  # by whom: arguments, beginning of the message, and a part of what it allows
    simulate: [
        ({"method": "euler"}, "method: ", "dop853, ros2"),
        ({"method": None}, "method: ", "rk4"),
        ({"method": "rk4"}, "step: ", "has fixed steps only"),
        ({"method": "implicit_midpoint"}, "step: ", "has fixed steps only"),
        ({"method": "rk4", "step": 0.003}, "step: ", "divides"),
        ({"method": "rk4", "step": 0.015}, "step: ", "multiple"),
        ({"method": "rk4", "step": 0.03}, "step: ", "divides the duration"),
        ({"step": -0.01}, "step: ", "> 0 (s)"),
        ({"step": np.nan}, "step: ", "> 0 (s)"),
        ({"step": "1 ms"}, "step: ", "> 0 (s)"),
        ({"rtol": -1e-6}, "rtol: ", "> 0"),
        ({"rtol": 0.0}, "rtol: ", "> 0"),
        ({"atol": np.inf}, "atol: ", "> 0"),
        ({"atol": None}, "atol: ", "> 0"),
        ({"model": fm.build_model(fm.catalog.planar_2r())}, "model: ", "3 joints"),
        ({"model": ARM}, "model: ", "odel"),
    ],
    fm.simulate: [({"scene": json.loads((REFERENCE / "paper_rr.json").read_text())}, "scene: ", "a Scene")],
    simulator: [
        ({"model": ARM}, "model: ", "build_model"),
        ({"method": "auto"}, "method: ", "ros2"),
        ({"method": "rk4", "step": None}, "step: ", "has fixed steps only"),
        ({"step": 0.006}, "step: ", "divides the control period"),
        ({"step": 0.04}, "step: ", "divides the control period"),
        ({"step": 0.0}, "step: ", "> 0 (s)"),
        ({"control_period": -0.02}, "control_period: ", "> 0 (s)"),
        ({"control_period": np.nan}, "control_period: ", "> 0 (s)"),
        ({"method": "dop853", "rtol": -1e-6}, "rtol: ", "> 0"),
        ({"method": "dop853", "atol": "small"}, "atol: ", "> 0"),
        ({"prescribed": [3]}, "prescribed: 3 is not allowed", ""),
    ],
    reset: [
        ({"joint_angles": (0.0, 0.0)}, "joint_angles: ", ""),
        ({"joint_angles": (0.0, 0.0, np.nan)}, "joint_angles[2]: ", ""),
        ({"joint_rates": 0.0}, "joint_rates: ", ""),
        ({"joint_rates": (0.0, np.inf, 0.0)}, "joint_rates[1]: ", ""),
        ({"state": np.zeros(5)}, "state: ", ""),
        ({"state": [None] * 6}, "state[0]: ", ""),
        ({"state": np.zeros(6), "joint_angles": np.zeros(3)}, "state: ", ""),
    ],
    scene: [
        ({"prescribed": [WOBBLE, None, None]}, "Scene.torque of joint 0: 400.0", "0 (N m)"),
        ({"prescribed": [None]}, "Scene.prescribed: [None]", SIGNALS),
        ({"prescribed": [1.0, None, None]}, "Scene.prescribed", SIGNALS),
        ({"tip_force": [WOBBLE]}, "Scene.tip_force", "three of Signal"),
        ({"base_acceleration": 9.81}, "Scene.base_acceleration: 9.81", "three of Signal"),
    ],
    fm.Signal: [
        ({"offset": np.inf}, "Signal.offset", ""),
        ({"frequency_hz": -1.0}, "Signal.frequency_hz", ""),
        ({"start": -1.0}, "Signal.start", ""),
        ({"start": 2.0, "stop": 2.0}, "Signal.stop", ""),
    ],
    batch: [
        ({"arms": 0}, "arms: 0 is not allowed; give a whole number from 1", ""),
        ({"threads": 0}, "threads: 0 is not allowed; give a whole number from 1", ""),
        ({"step": 0.003}, "step: 0.003 is not allowed; give a number of seconds that divides the control period", ""),
        ({"prescribed": (3,)}, "prescribed: 3 is not allowed; give a whole number from 0 to 2", ""),
    ],
    vary: [
        ({"mass": [1.0]}, "parameters: 'mass' is not allowed", "give one of payload_mass, joint_stiffness"),
        ({"payload_mass": [-1.0]}, "payload_mass: [-1.0] is not allowed", "give finite numbers >= 0, of shape (1,)"),
        ({"payload_mass": [np.nan]}, "payload_mass: [nan] is not allowed", "give finite numbers >= 0, of shape (1,)"),
        ({"payload_mass": [1.0, 2.0]}, "payload_mass: [1.0, 2.0] is not allowed", ""),
        ({"link_stiffness_factor": [[1.0, 0.0, 1.0]]}, "link_stiffness_factor: [[1.0, 0.0, 1.0]] is not", "give n"),
        ({"joint_stiffness": [[1.0, 0.0, 0.0]]}, "joint_stiffness: [[1.0, 0.0, 0.0]] is not", "give numbers > 0"),
        ({"joint_stiffness": [[1.0, 1.0, 5.0]]}, "joint_stiffness: [[1.0, 1.0, 5.0]] is not", "give [0.0] for"),
        ({"joint_damping": [[1.0, 1.0, 5.0]]}, "joint_damping: [[1.0, 1.0, 5.0]] is not", "give [0.0] for"),
        ({"rotor_inertia": [[1.0, 0.0, 1.0]]}, "rotor_inertia: [[1.0, 0.0, 1.0]] is not", "give numbers > 0"),
    ],
    lambda **parameters: varied_model(BENT, **parameters): [
        ({"mass": 1.0}, "parameters: 'mass' is not allowed; give one of", ""),
        ({"payload_mass": -1.0}, "payload_mass: array([-1.]) is not allowed", ""),
    ],
    gauss: [
        ({"order": 1, "iterations": 0}, "mine.iterations: 0 is not allowed; give a whole number from 1 to 1000", ""),
        ({"order": 1, "iterations": 1, "stages": 3}, "mine.stages: 3 is not allowed", "a whole number from 1 to 2"),
        ({"order": 2, "iterations": 3, "correction": 1.7}, "mine.correction: 1.7 is not", "a number from 0 to 1.6"),
        ({"order": 1, "iterations": 1, "correction": 0.1}, "mine.correction: 0.1 is not", "give 0 with two stages"),
        ({"order": 1, "iterations": 3, "stages": 2, "correction": 0.1}, "mine.correction: 0.1", "0 with two stages"),
    ],
    fm.generalised_alpha: [({"radius": 1.5}, "generalised_alpha.radius: 1.5 is", "give a number from 0 to 1")],
    joint: [
        ({"viscous_friction": -1.0}, "Joint.viscous_friction: -1.0 is not allowed; give a finite number >= 0", ""),
        ({"coulomb_friction": -1.0}, "Joint.coulomb_friction: -1.0 is not allowed; give a finite number >= 0", ""),
        ({"coulomb_rate": 0.0}, "Joint.coulomb_rate: 0.0 is not allowed; give a finite number > 0", ""),
    ],
    lambda level: simulate(method="ros2", step=0.02).energy_alarm(level): [({"level": 0}, "level: 0 is not", "")],
}  # fmt: skip


@pytest.mark.parametrize(
    ("call", "arguments", "line", "allowed"), [(call, *row) for call, rows in REFUSED.items() for row in rows]
)
def test_bad_input_is_refused_in_one_line(call, arguments, line, allowed):
    said = refusal(lambda: call(**arguments))
    assert said.startswith(line) and " is not allowed; give " in said and allowed in said, said


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        *[((torque,), "torque") for torque in (1.0, None, (1.0, 2.0), (1.0, 2.0, np.nan), (1.0, np.inf, 0.0))],
        *[((torque,), "torque") for torque in (np.zeros((1, 3)), ("a", "b", "c"), [True] * 3)],
        (([1.0, 0.0, 0.0],), "torque[0]: 1.0"),
        (([0.0] * 3, [0.0, 1.0, 0.0]), "acceleration[1]: 1.0"),
        (([0.0] * 3, [0.0, np.nan, 0.0]), "acceleration"),
        (([0.0] * 3, None, [1.0]), "tip_force: [1.0]"),
        (([0.0] * 3, None, None, "up"), "base_acceleration: 'up'"),
    ],
)
def test_a_step_that_is_refused_leaves_the_arm_where_it_is(arguments, line):
    moved = fm.Simulator(RIGID, prescribed=[0] if len(line) > len("torque") else ())
    said = refusal(moved.step, *arguments)
    assert said.startswith(line) and " is not allowed; give " in said
    assert line != "torque" or "3 finite numbers (N m)" in said
    assert moved.time == 0.0 and moved.status == "ok" and (moved.state == 0.0).all()
    assert moved.step([0.0, 1.0, 0.0]) == "ok"
