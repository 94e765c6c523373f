"""Verification cases with closed-form solutions: beams, stepped links, bars and flexible joints at rest.

The paper is "Dynamic modeling and simulation of spatial manipulator with flexible links and joints".
"""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.model.beam import build_beam
from flexman_gym.model.dynamics import frequencies, mass_matrix, stiffness_matrix
from flexman_gym.model.model import build_model
from flexman_gym.scene import catalog
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.joint import Joint
from flexman_gym.scene.link import Link, NonUniformLink
from flexman_gym.scene.rigid_body import Payload
from flexman_gym.toolbox.verification.closed_forms import (
    bar_frequencies,
    cantilever_frequencies,
    flexible_joint_frequencies,
    hub_beam_frequencies,
    stepped_cantilever_frequencies,
)
from flexman_gym.toolbox.verification.table import VerificationRow

# Coordinates of a node in axial vibration, torsion, and bending along y and along z.
AXIAL, TWIST, BENDING_Y, BENDING_Z = (0,), (3,), (1, 5), (2, 4)
UNIT_LOAD = "integrals of M m / EI (Gere and Timoshenko, Mechanics of Materials)"
STEPPED = "closed form: two Euler-Bernoulli segments"
BEAM = "closed form: Euler-Bernoulli beam"
MECHANICS = "Gere and Timoshenko, Mechanics of Materials"


def slender_link(
    length: float = 1.0, mass_per_length: float = 1.0, rigidity: float = 1.0, rigidity_ratio: float = 1e4
) -> Link:
    """Return a slender link that, by default, bends in the x-y plane only.

    Its radius of gyration is 1e-4 of its length: rotary inertia changes a frequency by less than a relative 1e-5.

    Args:
        length: m.
        mass_per_length: kg/m.
        rigidity: bending stiffness EI_z in the x-y plane, N m^2.
        rigidity_ratio: bending stiffness in the x-z plane / bending stiffness in the x-y plane, 1.
    """
    gyration = 1e-8 * length**2  # m^2; squared radius of gyration
    # Largest area that these second moments of area allow, for realistic values of E and rho. It is a power of two
    # times the gyration, so that the products E I and rho A are exact.
    area = 4.0 * 2.0 ** math.floor(math.log2(rigidity_ratio)) * gyration
    moment = gyration * area
    modulus = rigidity / moment
    stiff_moment = rigidity_ratio * moment
    return Link(length, area, stiff_moment, moment, stiff_moment, modulus, modulus, mass_per_length / area)


def link_frequencies(link: Link, elements: int, columns: Sequence[int], tip_mass: float = 0.0) -> Array:
    """Return the natural frequencies, Hz, ascending, of a clamped link with some free coordinates at each node.

    Args:
        link: the link.
        elements: number of finite elements.
        columns: free coordinates of each node, such as BENDING_Y; all others are fixed.
        tip_mass: kg.
    """
    model = build_model(Arm([link], [Joint((0.0, 0.0, 1.0))], Payload(tip_mass)), elements)
    nodes = np.arange(model.n_dof)[model.elastic_columns(0)].reshape(elements, 6)
    free = nodes[:, list(columns)].ravel()
    mass, stiffness = mass_matrix(model, np.zeros(2 * model.n_dof)), stiffness_matrix(model)
    flexibility = np.linalg.solve(stiffness[np.ix_(free, free)], mass[np.ix_(free, free)])
    return np.sort(1.0 / np.sqrt(np.linalg.eigvals(flexibility).real)) / (2.0 * np.pi)


def bar_frequency_scale(link: Link, columns: Sequence[int]) -> float:
    """Return c / (2 pi L), Hz, with the wave speed c of axial vibration, or of torsion with I_p = I_y + I_z.

    Args:
        link: the bar.
        columns: AXIAL or TWIST.
    """
    modulus, moments = link.youngs_modulus, link.second_moment_y + link.second_moment_z
    if columns == TWIST:
        modulus = link.shear_modulus * link.torsion_constant / moments
    return float(np.sqrt(modulus / link.density) / (2.0 * np.pi * link.length))


def _stepped_link(step_position: float, thickness_ratio: float) -> NonUniformLink:
    """Return a strip 1 m long and 128 mm wide with a step in its thickness, which bends in the x-y plane.

    The inboard segment is 1.28 mm thick, with EI = 1 N m^2 and 1 kg/m. EI of the outboard segment is proportional to
    the cube of its thickness, and its mass to the thickness.

    Args:
        step_position: length of the inboard segment, m.
        thickness_ratio: outboard thickness / inboard thickness, 1.
    """
    sections = []
    for length, thickness in ((step_position, 1.28e-3), (1.0 - step_position, 1.28e-3 * thickness_ratio)):
        width, modulus, density = 0.128, 12e18 / 2**28, 1e8 / 2**14
        area, about_y, about_z = width * thickness, thickness * width**3 / 12.0, width * thickness**3 / 12.0
        sections.append(Link(length, area, about_y, about_z, about_y, modulus, modulus, density))
    return NonUniformLink(sections)


def _cantilever_rows() -> Iterator[VerificationRow]:
    """Yield lambda = omega L^2 sqrt(rho A / EI) of cantilevers without and with a tip mass, 24 elements."""
    link = slender_link()
    for ratio in (0.0, 0.1, 0.5, 1.0, 5.0):
        result = 2.0 * np.pi * link_frequencies(link, 24, BENDING_Y, ratio)[:3]
        name = f"cantilever, tip mass / beam mass {ratio:g}" if ratio else "cantilever"
        yield from VerificationRow.series(name + ", lambda_{}", BEAM, cantilever_frequencies(3, ratio), result, 2e-5)


def _hub_rows() -> Iterator[VerificationRow]:
    """Yield the dimensionless frequencies lambda > 0 of a beam with a freely rotating hub, 32 elements."""
    for ratio in (0.0, 0.1, 1.0):
        model = build_model(Arm([slender_link()], [Joint((0.0, 0.0, 1.0), ratio)]), 32)
        result = 2.0 * np.pi * frequencies(model)[1:4]
        name = f"free hub, J / (rho A L^3) {ratio:g}, lambda_{{}}"
        yield from VerificationRow.series(name, BEAM, hub_beam_frequencies(3, ratio), result, 2e-5)


def _static_rows() -> Iterator[VerificationRow]:
    """Yield tip displacements and rotations of link 2 of the paper's arm, clamped, under unit loads and its weight."""
    link = catalog.paper_rrr().links[1].sections[0]
    beam, length, mass = build_beam(link, 2), link.length, link.mass
    bending, twisting = link.youngs_modulus * link.second_moment_z, link.shear_modulus * link.torsion_constant
    # 1 N distributed along the link
    weight = sum(m * shape[1] for m, shape in zip(beam.masses, beam.shapes, strict=True)) / mass
    deflection, rotation = beam.tip_translation[1], beam.tip_rotation
    cases = (
        ("P L^3 / 3 EI, m/N", deflection, deflection, length**3 / (3.0 * bending)),
        ("P L^2 / 2 EI, rad/N", rotation[2], deflection, length**2 / (2.0 * bending)),
        ("M L^2 / 2 EI, 1/N", deflection, rotation[2], length**2 / (2.0 * bending)),
        ("w L^4 / 8 EI with w L = 1 N, m/N", deflection, weight, length**3 / (8.0 * bending)),
        ("T L / G J, rad/(N m)", rotation[0], rotation[0], length / twisting),
    )
    for name, motion, load, expected in cases:
        yield VerificationRow(
            f"tip under load, {name}", MECHANICS, expected, motion @ np.linalg.solve(beam.stiffness, load), 1e-9
        )


def _stepped_rows() -> Iterator[VerificationRow]:
    """Yield tip displacement and rotation under a unit load, and lambda of stepped cantilevers.

    lambda refers to rho A and EI of the inboard segment and is computed with 16 elements per segment.
    """
    for position, ratio in ((0.5, 0.5), (0.3, 0.7)):
        link, rigidity, outboard = _stepped_link(position, ratio), ratio**3, 1.0 - position
        beam = build_beam(link, 1)
        deformed = np.linalg.solve(beam.stiffness, beam.tip_translation[1])
        name = f"cantilever stepped at {position:g} L to {ratio:g} of its thickness"
        deflection = (1.0 - outboard**3 + outboard**3 / rigidity) / 3.0
        slope = (1.0 - outboard**2 + outboard**2 / rigidity) / 2.0
        yield VerificationRow(
            f"{name}, tip under load, m/N", UNIT_LOAD, deflection, beam.tip_translation[1] @ deformed, 1e-9
        )
        computed = beam.tip_rotation[2] @ deformed
        yield VerificationRow(f"{name}, slope of the tip, rad/N", UNIT_LOAD, slope, computed, 1e-9)
        model = build_model(Arm([link], [Joint((0.0, 0.0, 1.0))]), 16, rotary_inertia=False)
        result = 2.0 * np.pi * frequencies(model, lock_joints=True)[:3]
        expected = stepped_cantilever_frequencies(3, position, rigidity, ratio)
        yield from VerificationRow.series(f"{name}, lambda_{{}}", STEPPED, expected, result, 2e-5)


def _bar_rows() -> Iterator[VerificationRow]:
    """Yield axial and torsional frequencies (Hz) of link 3 of the paper's arm, clamped, with 24 elements."""
    link = catalog.paper_rrr().links[2].sections[0]
    for name, columns in (("axial", AXIAL), ("torsional", TWIST)):
        scale = bar_frequency_scale(link, columns)
        result = link_frequencies(link, 24, columns)
        yield from VerificationRow.series(
            f"{name} f_{{}}, link 3, Hz", "closed form: bar", scale * bar_frequencies(2), result[:2], 2e-3
        )


def _elastic_joint_rows() -> Iterator[VerificationRow]:
    """Yield frequencies (Hz) of a flexible link on a flexible joint, with a free and with a clamped rotor."""
    length, mass_per_length, rigidity = 0.7, 4.0, 0.6  # m, kg/m, N m^2
    stiffness, rotor = 100.0, 1.0  # N m/rad, stiffness of the joint; kg m^2, rotor inertia
    scale = np.sqrt(rigidity / mass_per_length) / (2.0 * np.pi * length**2)
    link, joint = slender_link(length, mass_per_length, rigidity), Joint((0.0, 0.0, 1.0), rotor, stiffness)
    for tip in (0.0, 2.0):
        model = build_model(Arm([link], [joint], Payload(tip)), 32)
        for name, ratio in (("free", rotor / (mass_per_length * length**3)), ("clamped", None)):
            clamped = ratio is None
            result = frequencies(model, lock_joints=clamped)[0 if clamped else 1 :][:3]
            mass_ratio = tip / (mass_per_length * length)
            lambdas = flexible_joint_frequencies(3, stiffness * length / rigidity, ratio, mass_ratio)
            case = f"flexible link on elastic joint, rotor {name}, tip {tip:g} kg, f_{{}}, Hz"
            yield from VerificationRow.series(case, "closed form: beam, spring, rotor", scale * lambdas, result, 2e-5)


CLOSED_FORMS = (_cantilever_rows, _hub_rows, _static_rows, _stepped_rows, _bar_rows, _elastic_joint_rows)
