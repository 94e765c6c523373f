"""Loads: reactions, section forces and energies of parts balance what moves the arm."""

from dataclasses import replace

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.model.instant import tip_jacobian

from oracles.refusals import refusal

STRIP = fm.Link.strip(0.5, 0.04, 0.003)
Z, Y = (0.0, 0.0, 1.0), (0.0, -1.0, 0.0)
INERTIA = ((3e-3, 2e-4, -1e-4), (2e-4, 2e-3, 1e-4), (-1e-4, 1e-4, 4e-3))
BODIES = [fm.LumpedMass(0.2, 0.21, INERTIA, (0.01, 0.04, -0.03)), fm.LumpedMass(0.1, 0.5)]
TURNED = ((0.0, 0.0, -1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0))
ARM = fm.Arm(
    [replace(STRIP, masses=BODIES), fm.Link.tube(0.4, 0.02, 0.001), replace(STRIP, orientation=TURNED)],
    [fm.Joint(Z, 0.02, 60.0, 0.01), fm.Joint(Y, 0.01, viscous_friction=0.01), fm.Joint(Y, 0.01, 30.0, 0.02)],
    fm.Payload(0.3), gravity=(1.0, -2.0, -9.0), modal_damping_ratio=0.01,
)  # fmt: skip
PUSH = [fm.Signal(1.0, 2.0, 3.0), fm.Signal(-3.0), fm.Signal(0.0, 4.0, 2.0)]
SWAY = [fm.Signal(0.0, 1.0, 2.0), fm.Signal(0.5), fm.Signal(0.0, 3.0, 1.0)]


def moved(arm=ARM, duration=0.1, **choice):
    """A trajectory of the arm under torques, a push on its tip and a base that sways."""
    n = arm.n_joints
    start = fm.Initial([0.2, 0.5, -0.7][:n], [1.0, -2.0, 1.5][:n])
    scene = fm.Scene(
        arm, fm.ModelChoice(True, 2, **choice), fm.ConstantTorque([0.5, 2.0, -1.0][:n]), start, duration, duration / 5,
        tip_force=PUSH, base_acceleration=SWAY,
    )  # fmt: skip
    return fm.simulate(scene, method="midpoint_3_sweeps", step=duration / 20)


CHOICES = [{}, {"stiffening": True}, {"rotary_inertia": False}, {"spinning_rotors": True, "modes": 3}]


@pytest.mark.parametrize("choice", CHOICES)
def test_energies_of_the_parts_are_the_energy_of_the_arm(choice):
    run = moved(**choice)
    parts = run.energies()
    total = sum(values.sum(axis=1) for values in parts.values())
    sizes = sum(np.abs(values).sum(axis=1) for values in parts.values())
    assert (np.abs(total - run.energy) <= 1e-12 * sizes).all()
    assert {name: values.shape for name, values in parts.items()}["link_kinetic"] == (6, 3)


@pytest.mark.parametrize("choice", CHOICES)
def test_joints_carry_what_their_equations_say(choice):
    """About its axis: spring and damper of a flexible joint; of a rigid one the torque less friction and rotor."""
    run = moved(**choice)
    d, constants, torques = run.model.n_dof, run.model.constants, (0.5, 2.0, -1.0)
    about = np.einsum("tni,ni->tn", run.joint_reactions[:, :, 3:], constants.axis)
    rates, speeds = run.accelerations, run.states[:, d:]
    for i, joint in enumerate(ARM.joints):
        m = run.model.motor_columns[i]
        if joint.stiffness:
            expected = joint.stiffness * (run.states[:, m] - run.states[:, i])
            expected += joint.damping * (speeds[:, m] - speeds[:, i])
        elif choice.get("spinning_rotors"):
            continue  # the rotor turns with the link before, too
        else:
            expected = torques[i] - joint.viscous_friction * speeds[:, i] - joint.rotor_inertia * rates[:, i]
        assert about[:, i] == pytest.approx(expected, rel=1e-10, abs=1e-10 * np.abs(run.joint_reactions[..., 3:]).max())


@pytest.mark.parametrize("choice", [{}, {"stiffening": True}, {"rotary_inertia": False}])
def test_the_end_of_a_link_carries_what_comes_next(choice):
    """At a tip: the reaction of the next joint, turned into another frame; at the last the payload and the push."""
    run = moved(**choice)
    size = np.abs(run.joint_reactions).max()
    end = run.section_forces(1, [ARM.links[1].length])[:, 0]  # of link 0 the lumped mass at the tip is outboard
    for part in (slice(0, 3), slice(3, 6)):
        lengths = np.linalg.norm(end[:, part], axis=1), np.linalg.norm(run.joint_reactions[:, 2, part], axis=1)
        assert lengths[0] == pytest.approx(lengths[1], rel=1e-10, abs=1e-10 * size)
    end = run.section_forces(2, [0.5])[:, 0]
    for row, time in enumerate(run.time):
        push, sway = (np.array([signal_at(each, time) for each in signals]) for signals in (PUSH, SWAY))
        relative = run_tip_acceleration(run, row)
        force = 0.3 * (relative + sway - ARM.gravity) - push
        assert np.linalg.norm(end[row, :3]) == pytest.approx(np.linalg.norm(force), rel=1e-9)
    assert np.abs(end[:, 3:]).max() < 1e-10 * size


def signal_at(signal, time):
    """Value of a sine with an offset."""
    return signal.offset + signal.amplitude * np.sin(2.0 * np.pi * signal.frequency_hz * time + signal.phase)


def run_tip_acceleration(run, row):
    """The acceleration of the tip relative to the base, J a + J' v by a difference along the motion."""
    d, model, state, rate = run.model.n_dof, run.model, run.states[row], run.accelerations[row]

    def velocity(t):
        x, v = state[:d] + t * state[d:] + t * t / 2.0 * rate, state[d:] + t * rate
        return tip_jacobian(model, x) @ v

    h = 1e-4
    return sum(w * (velocity(k * h) - velocity(-k * h)) / (2.0 * k * h) for k, w in ((1, 1.5), (2, -0.6), (3, 0.1)))


def test_a_rigid_rod_that_spins_is_pulled_and_bent_by_its_own_mass():
    """N = rho A w^2 (L^2 - s^2) / 2; under its weight Q = rho A g (L - s), M = rho A g (L - s)^2 / 2."""
    rate, line, places = 5.0, STRIP.density * STRIP.area, np.array([0.0, 0.1, 0.27, 0.5])
    arm = fm.Arm([STRIP], [fm.Joint(Z)], gravity=(0.0, 0.0, -9.81))
    scene = fm.Scene(arm, fm.ModelChoice(False, 2, rotary_inertia=False), fm.ConstantTorque([0.0]),
                     fm.Initial([0.3], [rate]), 0.1, 0.1)  # fmt: skip
    loads, left = fm.simulate(scene).section_forces(0, places)[-1], 0.5 - places
    assert loads[:, 0] == pytest.approx(line * rate**2 * (0.25 - places**2) / 2.0, rel=1e-10, abs=1e-12)
    assert loads[:, 2] == pytest.approx(-line * 9.81 * left, rel=1e-10, abs=1e-12)
    assert loads[:, 4] == pytest.approx(line * 9.81 * left**2 / 2.0, rel=1e-10, abs=1e-12)
    assert np.abs(loads[:, [1, 3, 5]]).max() < 1e-10


def test_bending_moments_are_those_of_the_curvature():
    """Of a light strip with a heavy tip at rest: E I v'' about z and -E I w'' about y."""
    light = replace(STRIP, density=1e-3)
    arm = fm.Arm([light], [fm.Joint(Z)], fm.Payload(0.05), gravity=(0.0, -0.6, -5.0))
    model = fm.build_model(arm)
    state = fm.rest_state(model, [0.0])
    scene = fm.Scene(arm, model.choice, fm.ConstantTorque([0.0]), fm.Initial([0.0], [0.0], state), 0.01, 0.01,
                     prescribed=[fm.Signal()])  # fmt: skip
    run = fm.simulate(scene)
    places = [0.0, 0.12, 0.4]
    loads = run.section_forces(0, places)[0]
    for load, place in zip(loads, places, strict=True):
        _, about_y, about_z = fm.curvature(model, state, 0, place)
        bent = [
            light.youngs_modulus * light.second_moment_y * about_y,
            light.youngs_modulus * light.second_moment_z * about_z,
        ]
        assert load[4:] == pytest.approx(bent, rel=2e-3)


def test_foreshortening_is_in_the_sections_too():
    """Halfway the inboard and the outboard part of a bent link agree as well as its stations integrate."""
    run = moved(stiffening=True)
    flat = run.section_forces(1, [0.0, 1e-9, 0.2, 0.4])
    assert -flat[:, 0] == pytest.approx(run.joint_reactions[:, 1], rel=1e-9, abs=1e-9)
    assert flat[:, 1] == pytest.approx(flat[:, 0], abs=1e-5 * np.abs(flat).max())


def test_what_is_not_known_is_refused():
    run = moved()
    assert refusal(lambda: run.section_forces(3, [0.0])).startswith("link: 3 is not allowed; give a whole number")
    assert refusal(lambda: run.section_forces(0, [0.6])).startswith(
        "positions[0]: 0.6 is not allowed; give a number from"
    )
    lines = repr(run).splitlines()
    assert len(lines) <= 5 and lines[0].startswith("<Trajectory: ok, 0.1 s, 6 outputs, 3 joints")
