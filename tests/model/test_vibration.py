"""Vibration modes against closed forms and ring-downs, and the effect of changed springs."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

import flexman_gym as fm
from flexman_gym.model.state_space import natural_modes
from flexman_gym.model.vibration import rotating_frequencies
from flexman_gym.simulation.physical_parameters import varied_model

STRIP = fm.Link.strip(0.5, 0.04, 0.003)
HUB = fm.Joint((0.0, 0.0, 1.0))
SPATIAL = fm.build_model(
    fm.Arm([STRIP, fm.Link.tube(0.4, 0.02, 0.001)],
           [fm.Joint((0.0, 0.0, 1.0), 0.02, 60.0, 0.01), fm.Joint((0.0, -1.0, 0.0), 0.01, 40.0, 0.005)],
           fm.Payload(0.1), gravity=(0.0, 0.0, -9.81), modal_damping_ratio=0.01),
    modes=4,
)  # fmt: skip


def in_plane(model, motors):
    """Modes whose tip moves in the plane of the thin side of the strip."""
    found = fm.modes(model, motors=motors)
    nodes = found.shapes[:, 1:].reshape(len(found), -1, 6)
    return found.frequencies[np.abs(nodes[:, -1, 1]) > 10.0 * np.abs(nodes[:, -1, [0, 2, 3]]).max(axis=1)]


def hertz(root):
    """Frequency of a uniform strip for a root (beta L) of its equation."""
    rigidity, line = STRIP.youngs_modulus * STRIP.second_moment_z, STRIP.density * STRIP.area
    return root**2 * np.sqrt(rigidity / line) / (2.0 * np.pi * STRIP.length**2)


@pytest.mark.slow
def test_a_clamped_strip_has_the_frequencies_of_its_closed_form():
    model = fm.build_model(fm.Arm([STRIP], [HUB]), 28, rotary_inertia=False)
    roots = [brentq(lambda z: np.cos(z) + 1.0 / np.cosh(z), low, low + 1.0) for low in (1.4, 4.2)]
    assert in_plane(model, "held")[:2] == pytest.approx([hertz(root) for root in roots], rel=1e-6)


@pytest.mark.slow
def test_a_pinned_strip_has_the_frequencies_of_its_closed_form():
    model = fm.build_model(fm.Arm([STRIP], [HUB]), 28, rotary_inertia=False)
    root = brentq(lambda z: np.tan(z) - np.tanh(z), 3.5, 4.2)
    assert in_plane(model, "free")[0] == pytest.approx(hertz(root), rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [0.3, 4.0])
def test_a_clamped_strip_with_a_tip_mass_has_the_frequencies_of_its_closed_form(ratio):
    """1 + cos cosh + ratio z (cos sinh - sin cosh) = 0 for a mass of `ratio` times that of the strip."""

    def function(z):
        return 1.0 + np.cos(z) * np.cosh(z) + ratio * z * (np.cos(z) * np.sinh(z) - np.sin(z) * np.cosh(z))

    arm = fm.Arm([STRIP], [HUB], fm.Payload(ratio * STRIP.mass))
    expected = [hertz(brentq(function, low, low + 1.0)) for low in (0.7, 3.5)]
    assert in_plane(fm.build_model(arm, 28, rotary_inertia=False), "held")[:2] == pytest.approx(expected, rel=1e-6)


def test_slow_modes_are_exact_beside_stiff_ones():
    """A soft spring and one 1e14 times as stiff: a general eigenvalue solver has two correct digits of the soft one."""
    rng = np.random.default_rng(2)
    turned = np.linalg.qr(rng.standard_normal((6, 6)))[0] * 10.0 ** rng.uniform(-1.0, 1.0, 6)
    squares, shapes = natural_modes(turned.T @ turned, turned.T @ np.diag(10.0 ** np.arange(0.0, 12.0, 2.0)) @ turned)
    assert squares == pytest.approx(10.0 ** np.arange(0.0, 12.0, 2.0), rel=1e-5)
    assert shapes.T @ turned.T @ turned @ shapes == pytest.approx(np.eye(6), abs=1e-10)


@pytest.mark.parametrize("motors", ["held", "free"])
def test_damping_ratios_are_those_of_a_ring_down(motors):
    """The arm starts in a mode of the smallest amplitude above rounding; its logarithmic decrement gives the ratio."""
    angles = np.array([0.3, 0.5])
    found, rest = fm.modes(SPATIAL, angles, motors), fm.rest_state(SPATIAL, angles)
    for i in (0, 2):
        value, shape = found.eigenvalues[i], 1e-3 * found.shapes[i]
        start = rest + np.r_[shape, value * shape].real
        periods, period = 4, 1.0 / found.frequencies[i]
        still = [fm.Signal(), fm.Signal()] if motors == "held" else None
        torques = [0.0, 0.0] if motors == "held" else fm.holding_torques(SPATIAL, angles)
        scene = fm.Scene(
            SPATIAL.arm, SPATIAL.choice, fm.ConstantTorque(torques), fm.Initial(angles, [0.0, 0.0], start),
            periods * period, period / 32, prescribed=still,
        )  # fmt: skip
        run = fm.simulate(scene, model=SPATIAL, rtol=1e-8, atol=1e-12)
        moved = (run.states[:, : SPATIAL.n_dof] - rest[: SPATIAL.n_dof]) @ np.abs(shape)
        assert run.status == "ok"
        sizes = [np.ptp(moved[k : k + 33]) for k in (0, 96)]  # of the first period and of the fourth
        decrement = np.log(sizes[0] / sizes[1]) / 3
        ratio = decrement / np.hypot(2.0 * np.pi, decrement)
        assert ratio == pytest.approx(found.damping_ratios[i], rel=0.01), (motors, i)


def test_shares_are_what_changed_springs_do():
    """A spring of share s that is 1 % stiffer raises the squared frequency by s % (Rayleigh)."""
    loose = [replace(joint, damping=0.0) for joint in SPATIAL.arm.joints]
    arm = replace(SPATIAL.arm, joints=loose, gravity=(0.0, 0.0, 0.0), modal_damping_ratio=0.0)
    bare = fm.build_model(arm, modes=4)
    found, step = fm.modes(bare, [0.3, 0.5]), 1e-4
    assert found.shares.sum(axis=1) == pytest.approx(np.ones(len(found)))
    assert found.parts == ("link 1", "link 2", "joint 1", "joint 2")
    for i, name in enumerate(found.parts):
        values = dict(link_stiffness_factor=np.ones(2), joint_stiffness=bare.constants.joint_stiffness.copy())
        key, changes = "link_stiffness_factor" if i < 2 else "joint_stiffness", []
        for sign in (1.0, -1.0):
            factors = np.ones(2)
            factors[i % 2] += sign * step
            changed = varied_model(bare, **values | {key: values[key] * factors})
            changes.append(2.0 * np.log(fm.modes(changed, [0.3, 0.5]).frequencies))
        assert (changes[0] - changes[1]) / (2 * step) == pytest.approx(found.shares[:, i], abs=1e-5), name


def test_modes_under_gravity_hang_and_swing():
    """A rigid rod that hangs swings with w^2 = m g l / 2 / I; raised it falls and has no such mode."""
    arm = fm.Arm([STRIP], [fm.Joint((0.0, 1.0, 0.0))], gravity=(0.0, 0.0, -9.81))
    model = fm.build_model(arm, flexible_links=False)
    inertia = fm.mass_matrix(model, model.initial_state([0.0]))[0, 0]
    swing = np.sqrt(STRIP.mass * 9.81 * STRIP.length / 2 / inertia) / (2.0 * np.pi)
    assert fm.modes(model, [np.pi / 2], "free").frequencies == pytest.approx([swing], rel=1e-9)
    assert len(fm.modes(model, [-np.pi / 2], "free")) == len(fm.modes(model, [0.3])) == 0
    assert (fm.modes(model, [np.pi / 2], "free").shares == 0.0).all()


def test_modes_say_the_first_in_a_few_lines():
    lines = repr(fm.modes(SPATIAL)).splitlines()
    assert len(lines) == 5 and "Hz, damping ratio" in lines[1] and "% in" in lines[1]


def test_friction_changes_no_mode_of_free_motors():
    """Friction on a sliding motor is a constant torque; the slope of the smoothed law at rest would clamp the motor."""
    rubbing = [replace(joint, coulomb_friction=2.0) for joint in SPATIAL.arm.joints]
    model = fm.build_model(replace(SPATIAL.arm, joints=rubbing), modes=4)
    for motors in ("held", "free"):
        assert np.array_equal(fm.modes(model, motors=motors).eigenvalues, fm.modes(SPATIAL, motors=motors).eigenvalues)


@pytest.mark.parametrize("ratio", [0.1, 0.7])
def test_one_inertia_on_a_damped_spring_has_its_damping_ratio_and_frequency(ratio):
    """I x'' + 2 zeta sqrt(k I) x' + k x = 0: ratio zeta, damped frequency sqrt(k / I (1 - zeta^2))."""
    inertia = fm.mass_matrix(model := fm.build_model(fm.Arm([STRIP], [HUB]), flexible_links=False), np.zeros(2))[0, 0]
    spring = replace(HUB, rotor_inertia=0.01, stiffness=60.0, damping=2.0 * ratio * np.sqrt(60.0 * inertia))
    found = fm.modes(fm.build_model(replace(model.arm, joints=[spring]), flexible_links=False))
    assert found.damping_ratios == pytest.approx([ratio], rel=1e-12)
    assert found.frequencies == pytest.approx([np.sqrt(60.0 / inertia * (1.0 - ratio**2)) / (2.0 * np.pi)], rel=1e-12)


@pytest.mark.parametrize("motors", ["held", "free"])
def test_mode_shapes_are_normalised_by_the_mass_matrix(motors):
    found, posture = fm.modes(SPATIAL, [0.3, 0.5], motors), SPATIAL.initial_state([0.3, 0.5])
    mass = fm.mass_matrix(SPATIAL, fm.rest_state(SPATIAL, posture[SPATIAL.motor_columns]))
    assert np.einsum("ka,ab,kb->k", found.shapes.conj(), mass, found.shapes) == pytest.approx(np.ones(len(found)))
    largest = np.take_along_axis(found.shapes, np.abs(found.shapes).argmax(axis=1)[:, None], axis=1)
    assert np.abs(largest.imag).max() < 1e-12 * np.abs(largest).max() and (largest.real > 0.0).all()


def test_frequencies_of_a_rotating_arm_do_not_depend_on_gravity():
    weightless = fm.build_model(replace(SPATIAL.arm, gravity=(0.0, 0.0, 0.0)), modes=4)
    rates = [0.0, 3.0]
    assert np.array_equal(rotating_frequencies(SPATIAL, rates), rotating_frequencies(weightless, rates))


def test_the_energy_of_a_rigid_rod_on_a_passive_spring_is_in_the_joint():
    arm = fm.Arm([STRIP], [fm.Joint((0.0, 0.0, 1.0), passive=True, stiffness=8.0)])
    model = fm.build_model(arm, flexible_links=False)
    found = fm.modes(model)
    inertia = fm.mass_matrix(model, np.zeros(2))[0, 0]
    assert found.frequencies == pytest.approx([np.sqrt(8.0 / inertia) / (2.0 * np.pi)], rel=1e-12)
    assert dict(zip(found.parts, found.shares[0], strict=True)) == pytest.approx({"link 1": 0.0, "joint 1": 1.0})
