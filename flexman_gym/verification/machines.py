"""Verification, machines: frequencies that others have published of their arms."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.model.instant import frequencies
from flexman_gym.model.model import build_model
from flexman_gym.scene import catalog
from flexman_gym.scene.arm import Arm, Payload
from flexman_gym.scene.joint import Joint
from flexman_gym.scene.link import Link
from flexman_gym.verification.rows import Row, printed

DE_LUCA = "De Luca and Siciliano, IEEE Trans. SMC 21 (1991)"
NASA, ROME = "NASA JSC, ASME DETC2007-35511", "De Luca et al., IEEE CDC (1990), measured"
GIFU = "Gifu University, ROBOMECH J. 5:28 (2018), usual moduli"


def published_rows() -> Iterator[Row]:
    """Arms of the catalog that others have published, Hz.

    De Luca and Siciliano take each link as clamped, with what it carries at its tip, and leave out the mass moment of
    link 2 about the tip of link 1.
    """
    arm = catalog.de_luca_siciliano()
    second, tool = arm.links[1].sections[0], arm.payload
    assert tool is not None
    behind = 0.1 + second.mass * second.length**2 / 3.0 + tool.mass * second.length**2 + 0.0005
    loads = {1: (1.0 + second.mass + tool.mass, behind, ("0.48", "1.80")), 2: (tool.mass, 0.0005, ("2.18", "15.91"))}
    for number, (mass, inertia, texts) in loads.items():
        result = _clamped(second, Payload(mass, (inertia * np.eye(3)).tolist()))
        for i, text in enumerate(texts):
            yield printed(f"two links, link {number} clamped, f_{i + 1}, Hz", DE_LUCA, text, result[i])
    result = 2.0 * np.pi * frequencies(build_model(catalog.nasa_beam(), 12))
    for i, (column, known) in enumerate(zip((1, 2, 4, 5), (5.28, 20.9, 46.7, 83.4), strict=True)):
        yield Row(f"pinned beam with tip mass, w_{i + 1} in its plane, rad/s", NASA, known, result[column], 5e-3)
    result = frequencies(build_model(catalog.flexarm_rome(), 4, flexible_links=(False, True)))
    yield Row("FLEXARM, motors free, f_1, Hz, to which EI is fitted", ROME, 4.716, result[2], 1e-3)
    yield Row("FLEXARM, motors free, f_2, Hz", ROME, 14.395, result[3], None)
    for link, text in zip(catalog.gifu_2link().links[1:], ("35.6", "29.4"), strict=True):
        bare = replace(link.sections[0], masses=())
        case = f"rod of {bare.youngs_modulus / 1e9:g} GPa, clamped and bare, f_1, Hz"
        yield printed(case, GIFU, text, _clamped(bare)[0])


def _clamped(link: Link, payload: Payload | None = None) -> Array:
    """Frequencies (Hz) of a link that is clamped."""
    return frequencies(build_model(Arm([link], [Joint((0.0, 0.0, 1.0))], payload), 8), lock_joints=True)
