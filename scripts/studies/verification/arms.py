"""Verification cases at rest beyond the closed forms of the package: published arms, the paper's arm, identities."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.optimize import brentq

from flexman_gym.common.arrays import Array, IntArray
from flexman_gym.kernels import inverse, layout
from flexman_gym.model.beam import build_beam
from flexman_gym.model.dynamics import acceleration, frequencies, mass_matrix, stiffness_matrix
from flexman_gym.model.model import Model, build_model
from flexman_gym.scene import catalog
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.joint import Joint
from flexman_gym.scene.link import Link
from flexman_gym.simulation.scene_simulation import simulate
from flexman_gym.simulation.simulator import Simulator
from flexman_gym.toolbox.verification.cases import (
    AXIAL,
    BENDING_Y,
    BENDING_Z,
    TWIST,
    bar_frequency_scale,
    link_frequencies,
    slender_link,
)
from flexman_gym.toolbox.verification.closed_forms import bar_frequencies, cantilever_frequencies
from flexman_gym.toolbox.verification.papers import catalog_rows
from flexman_gym.toolbox.verification.table import VerificationRow

HERMITE = "known of cubic elements with consistent mass"
WRIGHT = "Wright et al., J. Applied Mechanics 49 (1982)"
SPONG = "closed form: Spong, J. Dynamic Systems 109 (1987)"
THREE_CODES = "three independent codes"
TABLE_1 = "closed form with the paper's Table 1"
IDENTITY = "identity"
FLAP = {1.0: 3.6816, 2.0: 4.1373, 4.0: 5.5850, 6.0: 7.3604}  # eta: lambda_1, hub radius 0


def rayleigh_frequencies(count: int, gyration_ratio: float) -> Array:
    """Return the first dimensionless natural frequencies lambda (count,) of a Rayleigh cantilever.

    w'''' + lambda^2 s w'' - lambda^2 w = 0 with w = w' = 0 at the base, w'' = 0 and w''' + lambda^2 s w' = 0 at the
    tip, and gyration_ratio s = I / (A L^2). The solution combines cos a x - cosh c x and sin a x / a - sinh c x / c,
    with a^2, c^2 = sqrt(lambda^4 s^2 / 4 + lambda^2) +- lambda^2 s / 2. For small s lambda each root is slightly below
    that of `cantilever_frequencies`.
    """

    def characteristic(frequency: float) -> float:
        half = frequency**2 * gyration_ratio / 2.0
        root = np.hypot(half, frequency)
        a, c = np.sqrt(root + half), np.sqrt(root - half)
        moment = -(a**2) * np.cos(a) - c**2 * np.cosh(c), -a * np.sin(a) - c * np.sinh(c)
        first = a**3 * np.sin(a) - c**3 * np.sinh(c) + 2.0 * half * moment[1]
        second = moment[0] + 2.0 * half * (np.cos(a) - np.cosh(c))
        return float(moment[0] * second - moment[1] * first)

    slender = cantilever_frequencies(count)
    return np.array([brentq(characteristic, 0.8 * each, 1.001 * each, xtol=1e-13) for each in slender])


def _convergence_rows() -> Iterator[VerificationRow]:
    """Yield the error of f_1 with Hermite elements and consistent mass, and its order of convergence."""
    exact, counts = cantilever_frequencies(1)[0], (1, 2, 4, 8)
    errors = [2.0 * np.pi * link_frequencies(slender_link(), n, BENDING_Y)[0] / exact - 1.0 for n in counts]
    for count, text, error in zip(counts, ("0.475", "0.0483", "0.0033", "0.0002"), errors, strict=True):
        yield VerificationRow.printed(
            f"cantilever f_1, elements: {count}, error in percent", HERMITE, text, 100.0 * error
        )
    slope = np.log2(errors[-2] / errors[-1])
    yield VerificationRow("cantilever f_1, order of convergence, 4 to 8 elements", HERMITE, 4.0, slope, 0.02)


def _spring_rows() -> Iterator[VerificationRow]:
    """Yield the frequencies (Hz) of two masses and a spring, and the limit of stiff springs."""
    stiffness, rotor, link = 100.0, 1.0, slender_link(0.7, 4.0)
    inertia = link.mass * link.length**2 / 3.0
    model = build_model(Arm([link], [Joint((0.0, 0.0, 1.0), rotor, stiffness)]), flexible_links=False)
    free = np.sqrt(stiffness * (1.0 / rotor + 1.0 / inertia)) / (2.0 * np.pi)
    locked = np.sqrt(stiffness / inertia) / (2.0 * np.pi)
    yield VerificationRow("two masses and a spring, free, Hz", SPONG, free, frequencies(model)[1], 1e-6)
    yield VerificationRow(
        "two masses and a spring, motor locked, Hz", SPONG, locked, frequencies(model, lock_joints=True)[0], 1e-6
    )
    rigid = build_model(model.arm, flexible_links=False, flexible_joints=False)
    result = mass_matrix(rigid, np.zeros(2))[0, 0]
    yield VerificationRow("spring of infinite stiffness, J_m + J_l, kg m^2", SPONG, rotor + inertia, result, 1e-6)
    arms = [catalog.paper_rrr(joint_stiffness=each) for each in (1e8, 1e9, None)]
    first, second, limit = (frequencies(build_model(arm), (0.0, 0.3, -0.5))[3:8] for arm in arms)
    ratio = np.abs(first / limit - 1.0).max() / np.abs(second / limit - 1.0).max()
    yield VerificationRow(
        "paper's arm, distance to rigid joints, K 1e8 / K 1e9", "first order in 1/K: 10", 10.0, ratio, 0.1
    )


def _rotating_beam_rows() -> Iterator[VerificationRow]:
    """Yield lambda_1 of a beam with foreshortening that rotates at eta = Omega sqrt(rho A L^4 / EI), 8 elements.

    A heavy hub keeps the rate constant. Axial coordinates balance the centrifugal force; the accelerations are
    linearised in the bending coordinates there. In the plane of rotation lambda^2 is smaller by eta^2.
    """
    arm = Arm([slender_link(rigidity_ratio=1.0)], [Joint((0.0, 0.0, 1.0), 1e9)])
    model = build_model(arm, 8, stiffening=True)
    nodes = np.arange(model.n_dof)[model.elastic_columns(0)].reshape(8, 6)
    for eta, flap in FLAP.items():
        state = model.initial_state([0.0], [eta])
        axial = nodes[:, AXIAL].ravel()
        state[axial] -= np.linalg.solve(_jacobian(model, state, axial), acceleration(model, state, [0.0])[axial])
        chord = np.sqrt(flap**2 - eta**2)
        for name, columns, expected in (("flap", BENDING_Z, flap), ("chord", BENDING_Y, chord)):
            squares = -np.linalg.eigvals(_jacobian(model, state, nodes[:, columns].ravel())).real
            result = np.sqrt(squares.min()) if squares.min() > 0.0 else np.nan
            yield VerificationRow(f"rotating beam, eta {eta:g}, {name} lambda_1", WRIGHT, expected, result, 1e-3)


def _paper_arm_rows() -> Iterator[VerificationRow]:
    """Yield values of the paper's links as cantilevers and of the paper's arm at its straight posture."""
    corrected, (one, two, three) = _paper_links("corrected")[0], _paper_links()
    known = (
        ("link 1 (area as printed)", one, "231.1"),
        ("link 1 (area 0.0028 m^2)", corrected, "23.1"),
        ("link 2", two, "66.02"),
        ("link 3", three, "23.11"),
    )
    for name, link, mass in known:
        yield VerificationRow.printed(f"paper's {name}, mass, kg", TABLE_1, mass, build_beam(link, 2).masses.sum())
        rigidity, density = link.youngs_modulus * link.second_moment_z, link.density * link.area
        scale = np.sqrt(rigidity / density) / (2.0 * np.pi * link.length**2)
        expected = scale * rayleigh_frequencies(2, link.second_moment_z / (link.area * link.length**2))
        result = link_frequencies(link, 16, BENDING_Y)[:2]
        yield from VerificationRow.series(f"paper's {name}, bending f_{{}}, Hz", TABLE_1, expected, result, 1e-5)
        for kind, columns in (("axial", AXIAL), ("torsional", TWIST)):
            scale = bar_frequency_scale(link, columns)
            first, highest = link_frequencies(link, 24, columns)[0], link_frequencies(link, 2, columns)[-1]
            yield VerificationRow(
                f"paper's {name}, {kind} f_1, Hz", TABLE_1, scale * bar_frequencies(1)[0], first, 1e-3
            )
            case = f"paper's {name}, highest {kind} f of 2 elements, Hz"
            yield VerificationRow(case, TABLE_1, scale * bar_frequencies(2, 2)[-1], highest, 1e-9)
    light = frequencies(build_model(catalog.paper_rrr(rotor_inertia=0.0, joint_stiffness=None)))
    for i, text in enumerate(("4.5", "9.5")):
        case = f"paper's arm, straight, motors free and weightless, f_{i + 1}, Hz"
        yield VerificationRow.printed(case, "independent modal analysis", text, light[3 + i])


def _rigid_paper_rows() -> Iterator[VerificationRow]:
    """Yield the tip of the paper's rigid arm without rotors at 2 s, m, including rotary inertia of the sections."""
    arm = catalog.paper_rrr(rotor_inertia=0.0, joint_stiffness=None)
    result = simulate(replace(catalog.paper_scene("rr"), arm=arm), rtol=1e-9).tip[-1]
    for axis, expected, value in zip("xyz", (1.041793, 2.982679, -0.804536), result, strict=True):
        yield VerificationRow(f"paper RR without rotors, tip {axis} at 2 s, m", THREE_CODES, expected, value, 2e-6)


def _identity_rows() -> Iterator[VerificationRow]:
    """Yield identities of the paper's flexible arm at ten random deflected and moving states."""
    rng, model = np.random.default_rng(0), build_model(catalog.paper_rrr())
    simulator, d, kinetic, inertial = Simulator(model), model.n_dof, [0.0], [0.0]
    stiffness, work = stiffness_matrix(model), layout.make_work(model.constants)
    for _ in range(10):
        state, torque = rng.normal(0.0, 0.01, 2 * d), rng.uniform(-400.0, 400.0, 3)
        state[:3] = state[model.motor_columns] = rng.uniform(-np.pi, np.pi, 3)
        x, v = state[:d], state[d:]
        simulator.reset(state=state)
        matrix = mass_matrix(model, state)
        energy = simulator.outputs[layout.KINETIC]
        kinetic.append(abs(v @ matrix @ v / 2.0 - energy) / energy)
        forward, demanded, applied = acceleration(model, state, torque), np.zeros(d), -stiffness @ x
        applied[model.motor_columns] += torque
        inverse.inertial_forces(model.constants, work, x, v, forward, demanded)
        scale = np.sqrt(np.diag(matrix))
        inertial.append(np.abs((demanded - applied) / scale).max() / np.abs(scale * forward).max())
    yield VerificationRow("half v M v against kinetic energy, largest relative gap", IDENTITY, 0.0, max(kinetic), 1e-9)
    yield VerificationRow("inverse of forward dynamics, largest relative gap", IDENTITY, 0.0, max(inertial), 1e-9)


def _paper_links(link1_area: str = "printed") -> list[Link]:
    """Return the uniform links of the paper's arm."""
    return [link.sections[0] for link in catalog.paper_rrr(link1_area).links]


def _jacobian(model: Model, state: Array, columns: IntArray, step: float = 1e-5) -> Array:
    """Return the Jacobian of the accelerations of some coordinates by the same coordinates (central differences)."""
    derivatives = []
    for column in columns:
        shift = step * np.eye(len(state))[column]
        ahead, behind = (acceleration(model, state + sign * shift, [0.0]) for sign in (1.0, -1.0))
        derivatives.append((ahead - behind)[columns] / (2.0 * step))
    return np.transpose(derivatives)


CASES = (
    _convergence_rows,
    _spring_rows,
    _rotating_beam_rows,
    _paper_arm_rows,
    catalog_rows,
    _rigid_paper_rows,
    _identity_rows,
)
