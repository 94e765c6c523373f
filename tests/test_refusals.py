"""Tests of error messages: public functions accept valid arguments, or name field, value and allowed values."""

import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import flexman_gym as fm
from flexman_gym.agent.pd import PD
from flexman_gym.common import errors
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.envs.vector_env import FlexManVectorEnv
from flexman_gym.kernels.layout import LARGEST_STATE
from flexman_gym.model.assembled_modes import assembled_modes
from flexman_gym.model.model import scene_model
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.integrator import MAX_STEPS
from flexman_gym.toolbox.controllers.excited_modes import excited_modes
from flexman_gym.toolbox.controllers.input_shaping.shaped_controller import InputShapedController
from flexman_gym.toolbox.controllers.input_shaping.shapers import design_shaper
from flexman_gym.toolbox.controllers.lqr import LQR, TrackingLQR

from oracles import odd_values
from oracles.assertions import offenders
from oracles.odd_values import Rude

ARM = fm.catalog.planar_2r(joint_stiffness=20.0)
LINK, JOINT = ARM.links[0], ARM.joints[0]
CHOICE = fm.ModelChoice(True, 1)
SCENE = fm.Scene(ARM, CHOICE, fm.ConstantTorque([0.0, 0.0]), fm.Initial([0.0] * 2, [0.0] * 2), 0.02, 0.01)
MODEL, RIGID = fm.build_model(ARM, 1), fm.build_model(ARM, 1, flexible_links=False, flexible_joints=False)
STATE, TWO = np.zeros(2 * MODEL.n_dof), [0.0, 0.0]
SIMULATOR = fm.Simulator(MODEL)
ONE, MANY = (
    FlexManEnv(name="FlexOne-v0"),
    FlexManVectorEnv(2, name="FlexOne-v0", randomisation={"payload_mass": (0, 1)}),
)


BAD = [*odd_values.BAD, ARM, MODEL, SCENE]


def reset(env, **given):
    """Reset an environment with one option."""
    return env.reset(seed=0, options=given)


def given_parameters(env, name, value):
    """Reset an environment with one physical parameter."""
    return env.reset(seed=0, options={"parameters": {name: value}})


CALLS = {
    **{f"Link.{name}": lambda value, name=name: replace(LINK, **{name: value}) for name in vars(LINK)},
    **{f"Joint.{name}": lambda value, name=name: replace(JOINT, **{name: value}) for name in vars(JOINT)},
    **{f"Arm.{name}": lambda value, name=name: replace(ARM, **{name: value}) for name in vars(ARM)},
    **{f"Scene.{name}": lambda value, name=name: replace(SCENE, **{name: value}) for name in vars(SCENE)},
    **{f"Limits.{name}": lambda value, name=name: fm.Limits(**{name: value}) for name in vars(fm.Limits())},
    **{f"ModelChoice.{name}": lambda value, name=name: replace(CHOICE, **{name: value}) for name in vars(CHOICE)},
    "Payload.mass": fm.Payload,
    "Payload.inertia": lambda value: fm.Payload(1.0, value),
    "Payload.offset": lambda value: fm.Payload(1.0, None, value),
    "NonUniformLink": fm.NonUniformLink,
    "Scene.from_dict": fm.Scene.from_dict,
    "SineTorque": lambda value: fm.SineTorque(value, TWO, TWO),
    "ConstantTorque": fm.ConstantTorque,
    "build_model.arm": fm.build_model,
    "build_model.elements": lambda value: fm.build_model(ARM, value),
    "build_model.modes": lambda value: fm.build_model(ARM, 1, value),
    "scene_model": scene_model,
    "assembled_modes": assembled_modes,
    "frequencies.model": fm.frequencies,
    "frequencies.joint_angles": lambda value: fm.frequencies(MODEL, value),
    "frequencies.lock_joints": lambda value: fm.frequencies(MODEL, None, value),
    "linearize.model": fm.linearize,
    "linearize.state": lambda value: fm.linearize(MODEL, state=value),
    "linearize.torque": lambda value: fm.linearize(MODEL, torque=value),
    "mass_matrix.model": lambda value: fm.mass_matrix(value, STATE),
    "mass_matrix.state": lambda value: fm.mass_matrix(MODEL, value),
    "acceleration.model": lambda value: fm.acceleration(value, STATE, TWO),
    "acceleration.state": lambda value: fm.acceleration(MODEL, value, TWO),
    "acceleration.torque": lambda value: fm.acceleration(MODEL, STATE, value),
    "tip_acceleration.model": lambda value: fm.tip_acceleration(value, STATE, TWO),
    "tip_acceleration.torque": lambda value: fm.tip_acceleration(MODEL, STATE, value),
    "rest_state.model": lambda value: fm.rest_state(value, TWO),
    "rest_state.motor_angles": lambda value: fm.rest_state(MODEL, value),
    "holding_torques.model": lambda value: fm.holding_torques(value, TWO),
    "inverse_dynamics.model": lambda value: fm.inverse_dynamics(value, TWO, TWO, TWO),
    "inverse_dynamics.rates": lambda value: fm.inverse_dynamics(RIGID, TWO, value, TWO),
    "inverse_dynamics.accelerations": lambda value: fm.inverse_dynamics(RIGID, TWO, TWO, value),
    "curvature.model": lambda value: fm.curvature(value, STATE, 0, 0.0),
    "curvature.position": lambda value: fm.curvature(MODEL, STATE, 0, value),
    "strain.model": lambda value: fm.strain(value, STATE, 0, 0.0),
    "strain.link": lambda value: fm.strain(MODEL, STATE, value, 0.0),
    "strain.y": lambda value: fm.strain(MODEL, STATE, 0, 0.0, value),
    "choose_model.scene": lambda value: fm.choose_model(value, 0.01) if value is not SCENE else None,
    "simulate.scene": fm.simulate,
    "simulate.model": lambda value: fm.simulate(SCENE, value),
    "simulate.method": lambda value: fm.simulate(SCENE, method=value, step=1e-3),
    "simulate.step": lambda value: fm.simulate(SCENE, method="ros2", step=value),
    "Simulator.model": fm.Simulator,
    "Simulator.step": lambda value: fm.Simulator(MODEL, step=value),
    "Simulator.control_period": lambda value: fm.Simulator(MODEL, step=None, control_period=value),
    "Simulator.prescribed": lambda value: fm.Simulator(MODEL, prescribed=value),
    "Simulator.reset.state": lambda value: SIMULATOR.reset(state=value),
    "Simulator.reset.joint_rates": lambda value: SIMULATOR.reset(joint_rates=value),
    "Simulator.step.torque": lambda value: fresh().step(value),
    "Simulator.step.tip_force": lambda value: fresh().step(TWO, tip_force=value),
    "Batch.arms": lambda value: Batch(MODEL, arms=value),
    "generalised_alpha": fm.generalised_alpha,
    "PD": lambda value: PD(value, TWO, 1.0),
    "PD.gravity_model": lambda value: PD(TWO, TWO, 1.0, value),
    "LQR": lambda value: LQR(value, 1.0, 0.01),
    "TrackingLQR": lambda value: TrackingLQR(value, 1.0, 0.01),
    **{
        f"InputShapedController.{name}": (
            lambda value, name=name: InputShapedController(PD(TWO, TWO, 1.0), MODEL, **{name: value})
        )
        for name in ("shaper", "modes", "places", "duration", "tolerance")
    },
    "InputShapedController.inner": lambda value: InputShapedController(value, MODEL),
    "InputShapedController.model": lambda value: InputShapedController(PD(TWO, TWO, 1.0), value),
    "design.shaper": lambda value: design_shaper(value, 1.0),
    "design.frequency": lambda value: design_shaper("ei", value),
    "design.ratio": lambda value: design_shaper("ei", 1.0, value),
    "ringing_modes.posture": lambda value: excited_modes(MODEL, value),
    "Slew.start": lambda value: fm.Slew(start=value),
    "Randomisation.payload_mass": lambda value: fm.Randomisation(payload_mass=value),
    "Randomisation.delay": lambda value: fm.Randomisation(delay=value),
    "FlexManEnv.control_period": lambda value: FlexManEnv(name="FlexOne-v0", control_period=value),
    "FlexManEnv.step": lambda value: FlexManEnv(name="FlexOne-v0", step=value),
    "FlexManEnv.torque_limit": lambda value: FlexManEnv(name="FlexOne-v0", torque_limit=value),
    "FlexManEnv.options": lambda value: ONE.reset(seed=0, options=value),
    "FlexManEnv.start": lambda value: reset(ONE, start=value),
    "FlexManEnv.parameters": lambda value: given_parameters(ONE, "joint_damping", value),
    "FlexManVectorEnv.num_envs": lambda value: FlexManVectorEnv(value, name="FlexOne-v0"),
    "FlexManVectorEnv.autoreset_mode": lambda value: FlexManVectorEnv(2, name="FlexOne-v0", autoreset_mode=value),
    "FlexManVectorEnv.seed": lambda value: MANY.reset(seed=value),
    "FlexManVectorEnv.parameters": lambda value: given_parameters(MANY, "payload_mass", value),
    "FlexManVectorEnv.action": lambda value: started().step(value),
}  # fmt: skip


def fresh():
    """Return a simulator in its initial state."""
    SIMULATOR.reset()
    return SIMULATOR


def started():
    """Return the vector environment in a running episode."""
    MANY.reset(seed=0)
    return MANY


def taken_or_said(line):
    """Return whether a value is accepted, or rejected with a proper message."""
    return line == "" or odd_values.fits(line)


def line_of(call, value):
    """Return the error message of a call for a value; "" if accepted."""
    try:
        call(value)
    except ValueError as error:
        return str(error)
    return ""


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("owner", sorted({name.partition(".")[0] for name in CALLS}))
def test_a_bad_value_is_refused_in_one_line(owner):
    wrong = []
    for name in (name for name in CALLS if name.partition(".")[0] == owner):
        many = name == "FlexManVectorEnv.num_envs"
        values = [value for value in BAD if not (many and isinstance(value, int) and value > 100)]
        wrong += [f"{name}: {each}" for each in offenders(CALLS[name], values, taken_or_said)]
    assert not wrong, "\n".join(["neither taken nor refused in one line:", *wrong])


@pytest.mark.slow
@settings(deadline=None, derandomize=True, max_examples=60)
@given(st.sampled_from(sorted(set(CALLS) - {"FlexManVectorEnv.num_envs", "Batch.arms"})), st.data())
def test_what_hypothesis_makes_up_is_refused_in_one_line(name, data):
    numbers = st.floats() | st.integers() | st.booleans() | st.none() | st.text(max_size=5)
    nested = st.recursive(numbers, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner))
    line = line_of(CALLS[name], data.draw(nested))
    assert taken_or_said(line), line


@pytest.mark.parametrize("value", [1e300, np.nextafter(LARGEST_STATE, np.inf), -2e6])
@pytest.mark.parametrize("method", ["rk4", "ros2", "midpoint_3"])
def test_a_simulator_starts_nowhere_beyond_its_bounds(value, method):
    simulator = fm.Simulator(MODEL, method, 1e-3, 0.01)
    simulator.reset((0.1, 0.2), (1.0, 0.0))
    state, outputs = simulator.state.copy(), simulator.outputs.copy()
    for field, given_state in (
        ("state", {"state": [value, *STATE[1:]]}),
        ("joint_rates", {"joint_rates": [value, 0.0]}),
    ):
        line = line_of(lambda given: simulator.reset(**given), given_state)
        assert line.startswith(f"{field}[0]: ") and "give a number from -1e+06 to 1e+06" in line
    assert np.array_equal(simulator.state, state) and np.array_equal(simulator.outputs, outputs)
    simulator.reset(state=np.full(len(STATE), np.copysign(1e-3, value)))
    assert np.isfinite(simulator.energy)


@pytest.mark.parametrize("made", [fm.Simulator, Batch], ids=["Simulator", "Batch"])
def test_a_control_period_has_a_bounded_number_of_steps(made):
    assert made(MODEL, "ros2", 1e-6, MAX_STEPS * 1e-6).substeps == MAX_STEPS
    for step, period in ((1e-6, (MAX_STEPS + 1) * 1e-6), (1e-300, 0.02), (0.005, 1e6), (0.005, 1e9), (5e-324, 1e308)):
        line = line_of(lambda step, period=period: made(MODEL, "ros2", step, period), step)
        assert line.startswith(f"step: {step} is not allowed; give at least ") and str(MAX_STEPS) in line


def test_a_refused_reset_leaves_nothing_behind():
    """Check that parameters and random numbers of the next episode are unaffected."""
    bad = [
        {"payload_mass": {}},
        {"payload_mass": -1.0},
        {"joint_stiffness": [[0.0], [1.0]]},
        {"payload_mass": [[1], [1, 2]]},
    ]
    envs = [FlexManVectorEnv(2, name="FlexOne-v0", randomisation={"payload_mass": (0.0, 1.0)}) for _ in range(2)]
    for env in envs:
        env.reset(seed=3)
    for parameters in bad:
        with pytest.raises(ValueError, match=r"^options\['parameters'\]\['\w+'\]: .* is not allowed; give "):
            envs[0].reset(seed=8, options={"parameters": parameters})
    result, expected = (env.reset() for env in envs)
    assert np.array_equal(result[0], expected[0])
    assert np.array_equal(result[1]["drawn"]["payload_mass"], expected[1]["drawn"]["payload_mass"])


def test_seeds_are_whole_numbers():
    for seed in ("12", [1.9, 2.9], [True, False], [1, -1], -1, b"12", [1], np.array([1.0, 2.0])):
        assert re.match(
            r"seed(\[\d\])?: .* is not allowed; give a whole number", line_of(CALLS["FlexManVectorEnv.seed"], seed)
        )
    assert MANY.reset(seed=np.array([1, 2]))


def test_a_zero_has_no_sign():
    for made in (lambda: fm.Slew(start=-0.0).start, lambda: fm.Randomisation(payload_mass=(0.0, -0.0)).payload_mass[1]):
        assert not np.signbit(made())
    env = FlexManEnv(name="FlexOne-v0", task=fm.Slew(start=-0.0), randomisation={"payload_mass": (0.0, -0.0)})
    assert env.reset(seed=0)[1]["drawn"]["payload_mass"] == 0.0


def test_a_value_is_shown_on_one_short_line_whatever_it_is():
    deep = []
    deep.append(deep)
    for value in (Rude(), [Rude()], list(range(10**6)), "x" * 10**6, "a\nb", 10**5000, deep, {1: Rude()}):
        text = errors.short_repr(value)
        assert len(text) <= 80 and "\n" not in text
    assert errors.short_repr([1.0, 2.0]) == "[1.0, 2.0]" and errors.short_repr(Rude()) == "this Rude"


def test_arms_of_extreme_sizes_are_refused_or_have_finite_numbers():
    models = []
    for size in (1e-30, 1e-9, 1e9, 1e30):
        for field in ("length", "density", "area", "youngs_modulus"):
            arm = replace(ARM, links=[replace(LINK, **{field: size}), LINK])
            line = line_of(lambda arm: models.append(fm.build_model(arm, 1)), arm)
            assert line.startswith("arm: ") or np.isfinite(models.pop().constants.stiffness).all()
    line = line_of(fm.build_model, replace(ARM, payload=fm.Payload(1e30)))
    assert line == "" or line.startswith("arm: ")


def test_offenders_are_what_is_taken_what_is_said_otherwise_and_other_errors():
    """Check that the rule can detect offenders."""
    said = {2: ValueError("no"), 3: KeyError("no"), 4: ValueError("right"), 5: ValueError()}

    def call(value):
        if value in said:
            raise said[value]

    listed = offenders(call, range(1, 6), lambda line: line == "right")
    assert listed == ["1 is taken", "2 is refused with no", "3 gives KeyError: 'no'", "5 is refused with ValueError()"]
    assert len(offenders(call, [1, 4, 5], lambda line: line in ("", "right"))) == 1


@pytest.mark.slow
def test_numba_without_its_compiler_is_refused_in_one_line():
    script = "import os; os.environ['NUMBA_DISABLE_JIT'] = '1'; import flexman_gym; flexman_gym.simulate"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.stderr.strip().splitlines()[-1].startswith("ImportError: NUMBA_DISABLE_JIT: 1 is not allowed; give 0")
