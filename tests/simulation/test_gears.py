"""Friction and gears: static friction, backlash, stiffness pieces and torque ripple against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq

import flexman_gym as fm
from flexman_gym.kernels.layout import JOINT_ENERGY, OUTPUTS, make_work
from flexman_gym.kernels.outputs import compute_outputs
from flexman_gym.model.dynamics import elastic_forces
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.physical_parameters import nominal_parameters, varied_model

from oracles.chains import QUICK, laden_rrr
from oracles.random_inputs import drives, states_of

pytestmark = pytest.mark.slow

Z, INERTIA, COULOMB = (0.0, 0.0, 1.0), 0.4, 2.0
RIGID = {"flexible_links": False}
STRIP = fm.Link.strip(0.5, 0.04, 0.003)
LINK_INERTIA = fm.mass_matrix(fm.build_model(fm.Arm([STRIP], [fm.Joint(Z)]), **RIGID), [0.0, 0.0])[0, 0]


def hub(**more):
    """A model of one rigid link on a joint without gravity."""
    return fm.build_model(fm.Arm([STRIP], [fm.Joint(Z, INERTIA, **more)]), **RIGID)


def friction_torque(rate, coulomb=COULOMB, width=0.01, static=COULOMB, stribeck=0.05, viscous=0.0):
    """The law as published, with a rational decay (Armstrong-Helouvry, Dupont and Canudas de Wit 1994, Eq. 6)."""
    decay = 1.0 + (static / coulomb - 1.0) / (1.0 + (rate / stribeck) ** 2)
    return viscous * rate + coulomb * np.tanh(rate / width) * decay


def block(torque, duration, **friction):
    """Angle and rate of a block on a slope: a rotor that a constant torque pulls from rest."""
    simulator = fm.Simulator(hub(coulomb_friction=COULOMB, **friction), "radau", None, duration, rtol=1e-9, atol=1e-12)
    simulator.reset(state=[0.0, 0.0])
    assert simulator.step([torque]) == "ok"
    return simulator.state


@pytest.mark.parametrize("part", [0.5, 0.9, 1.1, 1.35])
def test_a_block_on_a_slope_holds_below_break_away(part):
    """It creeps at the rate at which smoothed friction carries the torque, below the rate of the smoothing."""
    law = {"static_friction": 1.4 * COULOMB, "stribeck_rate": 0.05, "coulomb_rate": 1e-3}
    torque = part * COULOMB
    rate = brentq(lambda v: friction_torque(v, COULOMB, 1e-3, 1.4 * COULOMB, 0.05) - torque, 0.0, 3.5e-3)
    angle, final = block(torque, 2.0, **law)
    assert final == pytest.approx(rate, rel=1e-4) and 0.0 < angle <= rate * 2.0
    if part > 1.0:  # Coulomb friction alone does not hold it
        assert block(torque, 2.0, coulomb_rate=1e-3)[1] > 0.1


def test_a_block_on_a_slope_slides_beyond_break_away():
    """Once it is quick, Coulomb friction is left: (T - c) / J; before, the power is that of T - F."""
    torque, excess, law = 1.5 * COULOMB, 0.4, {"static_friction": 1.4 * COULOMB, "coulomb_rate": 1e-3}
    (_, first), (_, last) = block(torque, 2.0, **law), block(torque, 2.1, **law)
    decay = 1.0 + excess / (1.0 + ((first + last) / 2.0 / 0.05) ** 2)
    inertia = INERTIA + LINK_INERTIA
    assert (last - first) / 0.1 == pytest.approx((torque - COULOMB * decay) / inertia, rel=1e-5)
    sharp = block(torque, 2.0, static_friction=1.4 * COULOMB, coulomb_rate=1e-3, stribeck_rate=5.0)
    assert sharp[1] < 0.8 * first, "excess friction brakes for longer at a larger Stribeck rate"


@QUICK
@given(
    st.floats(-3.0, 3.0), st.floats(-4.0, 0.0), st.floats(1.0, 2.0), st.floats(-3.0, 0.0), st.sampled_from([0.0, 0.7])
)
def test_friction_takes_power_at_every_rate(rate, width, static, stribeck, viscous):
    """The kernel has the published law; its power is never negative."""
    law = {"coulomb_rate": 10.0**width, "stribeck_rate": 10.0**stribeck}
    model = hub(coulomb_friction=COULOMB, static_friction=static * COULOMB, viscous_friction=viscous, **law)
    torque = -(INERTIA + LINK_INERTIA) * fm.acceleration(model, [0.0, rate], [0.0])[0]
    expected = friction_torque(rate, COULOMB, 10.0**width, static * COULOMB, 10.0**stribeck, viscous)
    assert torque == pytest.approx(expected, rel=1e-9, abs=1e-12) and torque * rate >= 0.0
    assert fm.inverse_dynamics(model, [0.0], [rate], [0.0])[0] == pytest.approx(expected, rel=1e-9, abs=1e-12)


PULL = {"stiffness": 30.0, "coulomb_friction": COULOMB, "static_friction": 1.5 * COULOMB}


def pulled(rate, start, duration, samples, **joint):
    """Motor rates (r,) of a rotor that a spring pulls along: the link, of huge inertia, turns at a constant rate."""
    wheel = replace(STRIP, masses=[fm.LumpedMass(0.1, 0.25, inertia=1e7 * np.eye(3))])
    model = fm.build_model(fm.Arm([wheel], [fm.Joint(Z, INERTIA, **{**PULL, **joint})]), **RIGID)
    simulator = fm.Simulator(model, "radau", None, duration / samples, rtol=1e-7, atol=1e-10)
    own = model.arm.joints[0]
    carried = friction_torque(start, COULOMB, own.coulomb_rate, own.static_friction, own.stribeck_rate)
    simulator.reset(state=[carried / own.stiffness, 0.0, rate, start])
    rates = []
    for _ in range(samples):
        assert simulator.step([0.0]) == "ok"
        rates.append(simulator.state[3])
    return np.array(rates)


@pytest.mark.filterwarnings("ignore:Arm.links.0..masses")  # a wheel that no torque slows down
def test_a_pulled_mass_slips_and_sticks_with_the_period_of_the_closed_form():
    """Where friction falls at once from s + c to c: Rabinowicz 1958, Proc. Phys. Soc. 71, 668, Eqs. 1 to 6.

    The spring, stretched by A = (F_s - c) / k beyond sliding, slips through 2 A in 2 / w (pi - atan(A w / V)); the pull
    at the rate V then takes 2 A / V to stretch it again.
    """
    rate, k = 0.02, PULL["stiffness"]
    stretch, omega = 0.5 * COULOMB / k, np.sqrt(k / INERTIA)
    rates = pulled(rate, 0.0, 17.0, 5000, coulomb_rate=4e-6, stribeck_rate=4e-4)
    slipping = rates > 0.5 * rate
    starts = 17.0 / 5000 * np.flatnonzero(slipping[1:] & ~slipping[:-1])
    period = 2.0 * stretch / rate + 2.0 / omega * (np.pi - np.arctan(stretch * omega / rate))
    assert len(starts) == 4 and np.diff(starts) == pytest.approx(period, rel=0.02)
    assert rates.max() == pytest.approx(rate + np.hypot(rate, stretch * omega), rel=0.02)
    assert (rates > -1e-3).all() and (np.abs(rates) < 1e-3).mean() > 0.5


@pytest.mark.filterwarnings("ignore:Arm.links.0..masses")  # a wheel that no torque slows down
@pytest.mark.parametrize("ratio", [0.9, 1.1])
def test_steady_sliding_is_stable_where_damping_exceeds_the_fall_of_friction(ratio):
    """Linear criterion d + F'(V) > 0 (Armstrong-Helouvry 1991) with F'(V) = -2 c s u / p / (1 + u^2)^2, u = V / p."""
    rate, stribeck, excess = 0.1, 0.05, 0.5
    slip = rate / stribeck
    fall = 2.0 * COULOMB * excess * slip / stribeck / (1.0 + slip**2) ** 2
    rates = pulled(rate, 1.02 * rate, 12.0, 1200, coulomb_rate=1e-3, stribeck_rate=stribeck, damping=ratio * fall)
    first, last = (np.ptp(rates[part]) for part in (slice(0, 150), slice(-150, None)))
    assert last < 0.2 * first if ratio > 1.0 else last > 2.0 * first


def twist_torques(model, twists):
    """Torques (r,) of the joint spring at twists (r,), by the acceleration of the rotor at rest."""
    return np.array([-INERTIA * fm.acceleration(model, [0.0, q, 0.0, 0.0], [0.0])[1] for q in twists])


def test_the_describing_function_of_play():
    """Of a dead zone of half width a: N(A) / k = 1 - 2 / pi (asin(a / A) + a / A sqrt(1 - (a / A)^2))."""
    half, k, phase = 0.01, 300.0, np.linspace(0.0, 2.0 * np.pi, 4000, endpoint=False)
    model = hub(stiffness=k, backlash=2.0 * half, knee_width=1e-4)
    for amplitude in (0.013, 0.02, 0.05, 0.2):
        torques = twist_torques(model, amplitude * np.sin(phase))
        gain = 2.0 * np.mean(torques * np.sin(phase)) / amplitude
        share = half / amplitude
        assert gain / k == pytest.approx(
            1.0 - 2.0 / np.pi * (np.arcsin(share) + share * np.sqrt(1.0 - share**2)), rel=0.01
        )
    assert (twist_torques(model, [-0.0098, 0.0, 0.0098]) == 0.0).all()


def test_a_link_swings_through_its_play_at_constant_rate():
    """Period 2 pi sqrt(J / k) + 4 a / v for the rate v in the gap; the motor stands by its huge inertia."""
    half, k, rate = 2e-3, 50.0, 0.02
    joint = fm.Joint(Z, 1e5, stiffness=k, backlash=2.0 * half, knee_width=1e-5)
    model = fm.build_model(fm.Arm([STRIP], [joint]), **RIGID)
    simulator = fm.Simulator(model, "radau", None, 1e-3, rtol=1e-9, atol=1e-13)
    simulator.reset(state=[0.0, 0.0, rate, 0.0])
    angles = []
    for _ in range(2500):
        simulator.step([0.0])
        angles.append(simulator.state[0])
    rising = np.flatnonzero((np.array(angles[1:]) >= 0.0) & (np.array(angles[:-1]) < 0.0))
    period = 2.0 * np.pi * np.sqrt(LINK_INERTIA / k) + 4.0 * half / rate
    assert len(rising) >= 3 and 1e-3 * np.diff(rising) == pytest.approx(period, rel=0.005)
    assert abs(simulator.energy_residual) < 1e-8 * simulator.energy_turnover


PIECES = ((3.0, 0.5), (9.0, 0.75))  # as a strain wave gear: T1, K1 / K3 and T2, K2 / K3


def twist_of(torque, k, backlash=0.0):
    """Twist (rad) under a torque by the pieces of a data sheet."""
    twist = 0.5 * backlash + min(torque, 3.0) / (0.5 * k) + max(min(torque, 9.0) - 3.0, 0.0) / (0.75 * k)
    return twist + max(torque - 9.0, 0.0) / k


@pytest.mark.parametrize("backlash", [None, 0.0, 4e-3])
def test_a_progressive_spring_has_the_twists_of_its_data_sheet(backlash):
    model = hub(stiffness=400.0, stiffness_pieces=PIECES, backlash=backlash)
    for torque in (1.5, 5.0, 20.0):
        twist = twist_of(torque, 400.0, backlash or 0.0)
        assert twist_torques(model, [twist, -twist]) == pytest.approx([torque, -torque], rel=1e-9)
        state = np.array([0.0, twist, 0.0, 0.0])
        slope = fm.stiffness_matrix(model, state[:2])[0, 0]
        assert slope == pytest.approx(400.0 * (0.5 if torque < 3.0 else 0.75 if torque < 9.0 else 1.0))
    assert fm.stiffness_matrix(model)[0, 0] == 400.0


@QUICK
@given(st.floats(-0.06, 0.06), st.sampled_from([0.0, 1e-5, 2e-3, 0.02]), st.floats(1e-5, 5e-3))
def test_torque_and_stiffness_are_the_derivatives_of_the_elastic_energy(twist, backlash, width):
    """By central differences, also where knees overlap; the energy at zero twist is zero."""
    model = hub(stiffness=400.0, stiffness_pieces=PIECES, backlash=backlash, knee_width=width)

    def energy(q):
        row = np.zeros(OUTPUTS)
        compute_outputs(model.constants, make_work(model.constants), np.array([0.0, q]), np.zeros(2), row)
        return row[JOINT_ENERGY]

    h = 1e-6
    (torque,), slope = twist_torques(model, [twist]), fm.stiffness_matrix(model, np.array([0.0, twist]))[0, 0]
    assert (energy(twist + h) - energy(twist - h)) / (2.0 * h) == pytest.approx(torque, rel=1e-4, abs=1e-5)
    low, high = twist_torques(model, [twist - h, twist + h])
    assert (high - low) / (2.0 * h) == pytest.approx(slope, rel=1e-4, abs=400.0 * h / width)
    assert energy(0.0) == 0.0 and torque * twist >= 0.0
    assert elastic_forces(model, np.array([0.0, twist])) == pytest.approx([-torque, torque], rel=1e-9, abs=1e-9)


def test_an_arm_sags_into_its_play_and_its_soft_springs():
    """At rest under gravity each joint has the twist of its data sheet for its torque, and nothing accelerates."""
    arm = replace(fm.catalog.vertical_2r(), joints=[fm.Joint((0.0, -1.0, 0.0), 0.1, 400.0, backlash=4e-3,
                  stiffness_pieces=((0.5, 0.5), (2.0, 0.75)))] * 2)  # fmt: skip
    model = fm.build_model(arm, 1)
    for angles in ([0.0, 0.5], [1.0, -0.3], [-2.0, 0.1]):
        state, torques = fm.rest_state(model, angles), fm.holding_torques(model, angles)
        twists = state[model.motor_columns] - state[:2]
        for twist, torque in zip(twists, torques, strict=True):
            size = abs(torque)
            expected = (
                2e-3 + min(size, 0.5) / 200.0 + max(min(size, 2.0) - 0.5, 0.0) / 300.0 + max(size - 2.0, 0.0) / 400.0
            )
            assert twist == pytest.approx(np.copysign(expected, torque), rel=1e-6)
        accelerations = fm.acceleration(model, state, torques)
        assert np.abs(fm.mass_matrix(model, state) @ accelerations).max() < 1e-9
    level = replace(arm, gravity=(0.0, 9.81, 0.0))  # along the axes: no torque, so in the middle of the gap
    assert fm.rest_state(fm.build_model(level, **RIGID), [0.0, 0.5])[:2] == pytest.approx([0.0, 0.5], abs=1e-9)


GEAR = fm.Motor(100.0, 0.05, 1e-3, efficiency=0.9, torque_ripple=0.02, ripple_cycles=2.0, ripple_phase=0.3)


def test_torque_ripple_is_a_sine_of_the_motor_angle_before_the_gear():
    """A conservative torque of the amplitude 0.02 * 100 * 0.9 N m at the joint, with 200 cycles per turn of it."""
    model = fm.build_model(fm.Arm([STRIP], [fm.Joint(Z, motor=GEAR)]), **RIGID)
    inertia, angles = GEAR.reflected_inertia + LINK_INERTIA, np.linspace(-0.1, 0.1, 41)
    torques = [inertia * fm.acceleration(model, [angle, 0.7], [0.4])[0] - 0.4 for angle in angles]
    assert torques == pytest.approx(1.8 * np.sin(200.0 * angles + 0.3))
    assert fm.holding_torques(model, [0.02]) == pytest.approx([-1.8 * np.sin(4.3)])
    simulator = fm.Simulator(model, "dop853", None, 1.0, rtol=1e-11, atol=1e-12)
    simulator.reset(state=[0.0, 0.5])
    assert simulator.step([0.0]) == "ok" and abs(simulator.energy_residual) < 1e-8 * simulator.energy_turnover
    angle, rate = simulator.state
    potential = 1.8 / 200.0 * (np.cos(0.3) - np.cos(200.0 * angle + 0.3))
    assert inertia * (rate**2 - 0.25) / 2.0 == pytest.approx(potential, rel=1e-6)
    elastic = fm.build_model(fm.Arm([STRIP], [fm.Joint(Z, stiffness=50.0, motor=GEAR)]), **RIGID)
    assert fm.acceleration(elastic, [0.1, 0.01, 0.0, 0.0], [-4.5])[1] == pytest.approx(1.8 * np.sin(2.3) / 10.0)


WORN = laden_rrr()
WORN = replace(
    WORN, modal_damping_ratio=0.01, gravity=(0.0, 0.0, -9.81),
    joints=[replace(joint, viscous_friction=2.0, coulomb_friction=20.0, static_friction=26.0, stribeck_rate=0.03,
                    backlash=2e-3, stiffness_pieces=((40.0, 0.6), (400.0, 0.8)), rotor_inertia=0.0,
                    motor=fm.Motor(100.0, 0.05, joint.rotor_inertia / 1e4, torque_ripple=0.05, ripple_cycles=1.0))
            for joint in WORN.joints],
)  # fmt: skip
OWN = {
    "static_excess": [0.0, 0.5, 0.2], "stribeck_rate": [0.005, 0.05, 0.02], "coulomb_rate": [0.003, 0.01, 0.03],
    "backlash": [0.0, 1e-3, 4e-3], "soft_stiffness": [1.0, 0.5, 0.8], "ripple_torque": [0.0, 2.0, 9.0],
    "joint_stiffness": [4e3, 6e3, 5e3],
}  # fmt: skip


@pytest.mark.parametrize("method", ["ros2", "midpoint_corrected_3", "gauss_2", "extrapolated_euler_4", "dopri5"])
@pytest.mark.parametrize("name", [None, *OWN])
def test_worn_arms_of_a_batch_have_the_bits_of_single_arms(method, name):
    """Each with its own friction, play, springs and ripple, all at once or one of them."""
    own = OWN if name is None else {name: OWN[name]}
    nominal = fm.build_model(WORN, modes=1)
    step = 1e-4 if method == "dopri5" else 1e-3
    batch, alone = Batch(nominal, method, step, arms=2), Batch(varied_model(nominal, **own), method, step)
    plain = Batch(nominal, method, step)
    batch.vary(np.array([1]), **{each: np.array([value]) for each, value in own.items()})
    states, drive = 0.1 * states_of(nominal, 2), drives(2, 3)
    batch.reset(np.arange(2), states)
    alone.reset(np.array([0]), states[1:])
    plain.reset(np.array([0]), states[:1])
    for each in drive:
        batch.step(each)
        alone.step(each[1:])
        plain.step(each[:1])
    assert np.isfinite(batch.rows).all() and np.array_equal(batch.status, [0, 0])
    assert np.array_equal(batch.rows, np.vstack([plain.rows, alone.rows]))
    assert np.array_equal(batch.outputs, np.vstack([plain.outputs, alone.outputs]))
    plain.reset(np.array([0]), states[1:])
    for each in drive:
        plain.step(each[1:])
    assert not np.array_equal(plain.rows, alone.rows), "the parameter acts"


def test_values_of_a_worn_arm_are_its_nominal_parameters():
    values = nominal_parameters(fm.build_model(WORN, modes=1))
    for name, value in {"static_excess": 0.3, "backlash": 2e-3, "soft_stiffness": 0.6, "ripple_torque": 5.0}.items():
        assert values[name] == pytest.approx(np.full(3, value)), name


METHODS = ("ros2", "implicit_midpoint", "midpoint_3", "midpoint_corrected_3", "gauss_2", "extrapolated_euler_4",
           "generalised_alpha", "radau")  # fmt: skip


def after_torques(method, step, **tolerances):
    """A simulator of the worn arm after 0.4 s of torques that change with each control period."""
    model = fm.build_model(WORN, modes=1)
    simulator = fm.Simulator(model, method, step, 0.02, **tolerances)
    simulator.reset(state=fm.rest_state(model, [0.2, 0.3, -0.4]))
    for k in range(20):
        assert simulator.step([150.0 * np.sin(0.5 * k), 60.0, -20.0]) == "ok"
    return simulator


@pytest.mark.parametrize("method", METHODS)
def test_every_method_moves_a_worn_arm_with_balanced_energy(method):
    """Tips within 0.5 mm of a tight solution after 0.4 s, and an energy residual of less than 0.2 %."""
    tips = []
    for each, step in (("dop853", None), (method, None if method == "radau" else 5e-4)):
        simulator = after_torques(each, step, **({} if step else {"rtol": 1e-12, "atol": 1e-14}))
        tips.append(simulator.tip)
        limit = 1e-8 if step is None else 2e-3
        assert abs(simulator.energy_residual) < limit * simulator.energy_turnover, each
    assert np.abs(tips[0] - tips[1]).max() < 5e-4


def test_a_joint_with_no_play_and_equal_pieces_is_a_linear_spring():
    """To rounding; and a static friction equal to Coulomb friction changes no bit."""

    def final(joint):
        simulator = fm.Simulator(fm.build_model(replace(WORN, joints=[joint] * 3), modes=1), step=1e-3)
        simulator.reset([0.1, 0.2, 0.3])
        for _ in range(10):
            simulator.step([50.0, 20.0, -30.0])
        return simulator.state

    plain = replace(laden_rrr().joints[0], coulomb_friction=20.0)
    expected = final(plain)
    bent = replace(plain, backlash=0.0, stiffness_pieces=((5.0, 1.0), (20.0, 1.0)), knee_width=1e-3)
    assert final(bent) == pytest.approx(expected, rel=1e-9, abs=1e-11)
    assert np.array_equal(final(replace(plain, static_friction=20.0, stribeck_rate=0.5)), expected)


@pytest.mark.parametrize("friction", ["sliding", "at rest"])
def test_a_linear_model_has_the_tangents_at_its_state(friction):
    """Against differences of the accelerations; sliding motors leave out all of the smoothed friction."""
    bare = replace(WORN, joints=[replace(joint, motor=None, rotor_inertia=1.0) for joint in WORN.joints])
    if friction == "sliding":
        bare = replace(bare, joints=[replace(each, coulomb_friction=0.0, static_friction=None) for each in bare.joints])
    model = fm.build_model(bare, modes=1)
    state = fm.rest_state(model, [0.2, 0.3, -0.4])
    state[model.n_dof + model.motor_columns] = [0.01, -0.03, 0.2]
    state[model.n_dof : model.n_dof + 3] = [0.01, -0.03, 0.2]
    result, h = fm.linearize(model, state=state, friction=friction).A[model.n_dof :], 1e-7
    for column in (0, *model.motor_columns, *(model.n_dof + model.motor_columns)):
        unit = h * np.eye(len(state))[column]
        low, high = (fm.acceleration(model, state + sign * unit, [0.0] * 3) for sign in (-1.0, 1.0))
        expected = (high - low) / (2.0 * h)
        assert result[:, column] == pytest.approx(expected, rel=1e-4, abs=1e-5 * np.abs(expected).max())
