"""Rotary inertia: Rayleigh beams with it, classic Euler-Bernoulli beams without it, and equal torsion."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import eigh

import flexman_gym as fm
from flexman_gym.kernels import layout
from flexman_gym.model.beam import build_beam
from flexman_gym.model.model import scene_model
from flexman_gym.model.outboard_inertia import outboard_inertias
from flexman_gym.scene.link import IDENTITY

from oracles.chains import QUICK, observed, random_link, samples
from oracles.dense import Chain
from oracles.ritz import beam_eigenvalues


class SpinningChain(Chain):
    """The oracle with its mass points moved to the centreline, and sections that turn about the beam axis alone.

    Their angular momentum is h = (sum j (w_x + phi')) e_x: it enters the moment with h' + w x h, and the elastic
    coordinates with the twist times j (w_x + phi')'.
    """

    def __init__(self, sample):
        super().__init__(sample.arm, sample.elements, sample.flexible_links, sample.flexible_joints)
        self.spinning = []
        for i, (link, beam) in enumerate(zip(sample.arm.links, self.beams, strict=True)):
            count = len(beam.masses) // 4  # of sections, four points each
            r0, S, masses = (part.reshape(count, 4, *part.shape[1:]) for part in (beam.r0, beam.S, beam.masses))
            twist = (S[:, 0, 2] - S[:, 1, 2]) / (2.0 * r0[:, 0, 1, None])
            polar = masses.sum(axis=1) * (link.second_moment_y + link.second_moment_z) / link.area
            self.spinning.append((polar, twist))
            lines = {"r0": r0.mean(axis=1), "masses": masses.sum(axis=1), "S": S.mean(axis=1), "G": beam.G[:count]}
            self.bodies[i] = self.beams[i] = replace(beam, **lines)

    def _link_equation(self, i, motion, gravity):
        M, force = super()._link_equation(i, motion, gravity)
        if i == self.n:
            return M, force
        polar, twist = self.spinning[i]
        rows = np.hstack([np.zeros((len(polar), 3)), np.tile(motion.A[:, 0], (len(polar), 1)), twist])
        M += (rows.T * polar) @ rows
        force[3:6] -= np.cross(motion.rates[3:6], polar @ rows @ motion.rates * motion.A[:, 0])
        return M, force


def without(sample, stiffening=False):
    """The model of a sample without rotary inertia."""
    choice = (sample.elements, sample.modes, sample.flexible_links, sample.flexible_joints, stiffening)
    return fm.build_model(sample.arm, *choice, rotary_inertia=False)


def kinetic_energy(model, x, v):
    """Energies of coordinates and speeds in the outputs, J."""
    return observed(model, x, v)[layout.KINETIC]


def stocky(side, length=1.0):
    """A square bar."""
    moment = side**4 / 12
    return fm.Link(length, side**2, moment, moment, 1.69 * moment, 70e9, 26e9, 2700.0)


@pytest.mark.slow
@settings(QUICK)
@given(samples(most_links=4, reduced=False))
def test_accelerations_are_those_of_sections_that_spin_about_the_beam_axis(sample):
    sample = replace(
        sample, arm=replace(sample.arm, modal_damping_ratio=0.0)
    )  # which the oracle would have to be given
    model, chain, (x, v), torque = without(sample), SpinningChain(sample), sample.state(), sample.torque()
    expected, matrix = chain.acceleration(x, v, torque), chain.mass_matrix(x)
    scale = np.sqrt(np.diag(matrix))
    result = fm.mass_matrix(model, np.r_[x, v])
    assert np.allclose(result / np.outer(scale, scale), matrix / np.outer(scale, scale), rtol=0.0, atol=1e-9)
    error = scale * (fm.acceleration(model, np.r_[x, v], torque) - expected)
    assert np.abs(error).max() <= 1e-6 * np.abs(scale * expected).max()


@pytest.mark.slow
@settings(QUICK)
@given(samples(most_links=4), st.booleans())
def test_kinetic_energy_is_half_v_m_v(sample, stiffening):
    model, (x, v) = without(sample, stiffening), sample.state()
    expected = v @ fm.mass_matrix(model, np.r_[x, v]) @ v / 2
    assert kinetic_energy(model, x, v) == pytest.approx(expected, rel=1e-9)


@pytest.mark.slow
@settings(QUICK)
@given(samples(most_links=3, flexible_links=False))
def test_a_rigid_arm_loses_the_energy_of_its_tilting_sections(sample):
    """rho (I_y w_y^2 + I_z w_z^2) / 2 per length of each link, w its angular velocity in its beam frame."""
    with_it, model, (x, v), lost = sample.model, without(sample), sample.state(), 0.0
    for motion, link in zip(sample.chain._motion(x, v)[:-1], sample.arm.links, strict=True):
        tilt = motion.A.T @ motion.rates[3:6]
        moments = link.density * link.length * np.array([0.0, link.second_moment_y, link.second_moment_z])
        lost += moments @ tilt**2 / 2
    assert kinetic_energy(with_it, x, v) - kinetic_energy(model, x, v) == pytest.approx(lost, rel=1e-6)


@pytest.mark.slow
def test_a_spinning_twisting_bending_chain_keeps_its_energy():
    rng = np.random.default_rng(3)
    links = [replace(random_link(rng), length=0.5, youngs_modulus=2e8, shear_modulus=5e7) for _ in range(3)]
    joints = [fm.Joint((0.6, 0.0, 0.8)), fm.Joint((1.0, 0.0, 0.0), 0.1, 500.0), fm.Joint((0.0, 0.8, 0.6))]
    arm = fm.Arm(links, joints, fm.Payload(0.3))
    rates = fm.Initial([0.1, -0.4, 0.7], [5.0, -8.0, 6.0])
    tips = []
    for rotary_inertia in (False, True):
        choice = fm.ModelChoice(True, 2, rotary_inertia=rotary_inertia)
        scene = fm.Scene(arm, choice, fm.ConstantTorque([0.0] * 3), rates, 0.3, 0.01)
        result = fm.simulate(scene, rtol=1e-9, atol=1e-12)
        assert result.status == "ok"
        assert np.abs(result.energy_residual).max() < 1e-7 * result.energy[0]
        tips.append(result.tip[-1])
        model = scene_model(scene)
        starts = model.constants.elastic_start
        shapes = [model.constants.tip_rotation[first:last] for first, last in pairwise(starts)]
        bent = [result.states[-1][model.elastic_columns(i)] @ shape for i, shape in enumerate(shapes)]
        assert np.abs(bent).max(axis=0).min() > 1e-4  # twisted and bent in both planes
    assert np.linalg.norm(tips[1] - tips[0]) > 1e-5


@pytest.mark.slow
@pytest.mark.parametrize("gyration", [1e-4, 1e-3])
def test_a_stocky_beam_is_eulers_without_and_rayleighs_with_it(gyration):
    """A square bar of side a has I / (A L^2) = a^2 / (12 L^2)."""
    link = stocky(np.sqrt(12 * gyration))
    scale = np.sqrt(link.youngs_modulus * link.second_moment_z / (link.density * link.area))
    bend = np.sort(np.r_[1:192:6, 5:192:6])
    for rotary_inertia, expected in (
        (False, beam_eigenvalues(3)),
        (True, beam_eigenvalues(3, gyration_ratio=gyration)),
    ):
        beam = build_beam(link, 32, rotary_inertia=rotary_inertia)
        stiffness, mass = (matrix[np.ix_(bend, bend)] for matrix in (beam.stiffness, beam.mass_matrix))
        result = np.sqrt(eigh(stiffness, mass, eigvals_only=True)[:3]) / scale
        assert result == pytest.approx(expected, rel=1e-5)


@settings(QUICK)
@given(st.integers(0, 10**6), st.integers(1, 4))
def test_twist_and_stretch_have_the_same_frequencies(seed, elements):
    link = random_link(np.random.default_rng(seed))
    with_it, model = build_beam(link, elements), build_beam(link, elements, rotary_inertia=False)
    polar = link.second_moment_y + link.second_moment_z
    speeds = {0: link.youngs_modulus, 3: link.shear_modulus * link.torsion_constant / polar}
    for column, modulus in speeds.items():
        block = np.ix_(*[np.arange(column, 6 * elements, 6)] * 2)
        assert np.allclose(model.mass_matrix[block], with_it.mass_matrix[block], rtol=1e-12, atol=0.0)
        result = np.sqrt(eigh(model.stiffness[block], model.mass_matrix[block], eigvals_only=True))
        # linear elements with consistent mass; a is the phase from one node to the next
        a = (np.arange(elements) + 0.5) * np.pi / elements
        expected = elements * np.sqrt(6.0 * (1.0 - np.cos(a)) / (2.0 + np.cos(a)))
        expected = expected * np.sqrt(modulus / link.density) / link.length
        assert result == pytest.approx(expected, rel=1e-9)


@settings(QUICK)
@given(st.integers(0, 10**6), st.booleans())
def test_what_a_tip_carries_has_the_inertia_of_a_rod_and_its_polar_moment(seed, rotary_inertia):
    """diag(rho L I_p, m L^2 / 3, m L^2 / 3), and rho L I about the transverse axes with rotary inertia."""
    link = replace(random_link(np.random.default_rng(seed)), orientation=IDENTITY)
    arm = fm.Arm([link] * 2, [fm.Joint((0.0, 0.0, 1.0))] * 2)
    beams = tuple(build_beam(each, 2, rotary_inertia=rotary_inertia) for each in arm.links)
    y, z = link.density * link.length * np.array([link.second_moment_y, link.second_moment_z])
    rod = link.mass * link.length**2 / 3
    expected = np.diag([y + z, rod + y * rotary_inertia, rod + z * rotary_inertia])
    assert outboard_inertias(arm, beams)[0][3:, 3:] == pytest.approx(expected, rel=1e-9, abs=1e-9 * rod)


def test_a_scene_turns_it_off():
    scene = fm.catalog.paper_scene("rr")
    off = replace(scene, model=replace(scene.model, rotary_inertia=False))
    assert scene_model(off).choice == off.model
    result = fm.mass_matrix(scene_model(off), np.zeros(6)) - fm.mass_matrix(scene_model(scene), np.zeros(6))
    assert (np.diag(result) < 0.0).all()
