"""Cases of verification of non-uniform links: a stepped cantilever, its tip under load and its frequencies."""

from collections.abc import Iterator

import numpy as np

from flexman_gym.model.beam import build_beam
from flexman_gym.model.instant import frequencies
from flexman_gym.model.model import build_model
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.joint import Joint
from flexman_gym.scene.link import Link, NonUniformLink
from flexman_gym.verification.closed_forms import stepped_eigenvalues
from flexman_gym.verification.rows import Row, series

UNIT_LOAD = "integrals of M m / EI (Gere and Timoshenko, Mechanics of Materials)"
STEPPED = "closed form: two Euler-Bernoulli segments"


def stepped_link(place: float, thickness_ratio: float) -> NonUniformLink:
    """A strip of 1 m that bends in x-y with EI 1 N m^2 and has 1 kg/m up to a place, and is thinner from there on.

    EI goes with the cube of its thickness, the mass with the thickness; across it is 100 times as high as thick.
    """
    sections = []
    for length, thickness in ((place, 1e-5), (1.0 - place, 1e-5 * thickness_ratio)):
        height, modulus, density = 1e-3, 12e18, 1e8
        area, about_y, about_z = height * thickness, thickness * height**3 / 12.0, height * thickness**3 / 12.0
        sections.append(Link(length, area, about_y, about_z, about_y, modulus, modulus, density))
    return NonUniformLink(sections)


def stepped_rows() -> Iterator[Row]:
    """Tip under a unit load, and lambda = omega sqrt(rho A L^4 / EI) of the inboard segment, 16 elements a segment."""
    for place, ratio in ((0.5, 0.5), (0.3, 0.7)):
        link, rigidity, outboard = stepped_link(place, ratio), ratio**3, 1.0 - place
        beam = build_beam(link, 1)
        bent = np.linalg.solve(beam.stiffness, beam.tip_translation[1])
        name = f"cantilever stepped at {place:g} L to {ratio:g} of its thickness"
        deflection = (1.0 - outboard**3 + outboard**3 / rigidity) / 3.0
        slope = (1.0 - outboard**2 + outboard**2 / rigidity) / 2.0
        yield Row(f"{name}, tip under load, m/N", UNIT_LOAD, deflection, beam.tip_translation[1] @ bent, 1e-9)
        yield Row(f"{name}, slope of the tip, rad/N", UNIT_LOAD, slope, beam.tip_rotation[2] @ bent, 1e-9)
        model = build_model(Arm([link], [Joint((0.0, 0.0, 1.0))]), 16, rotary_inertia=False)
        result = 2.0 * np.pi * frequencies(model, lock_joints=True)[:3]
        expected = stepped_eigenvalues(3, place, rigidity, ratio)
        yield from series(f"{name}, lambda_{{}}", STEPPED, expected, result, 2e-5)
