"""Masses and inertias of the links of a URDF file, with the correction of inertias that no body can have."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import physical
from flexman_gym.scene.inertia import POSSIBLE, ROUNDING, Body, nearest_inertia, triangle_excess
from flexman_gym.toolbox.interchange.urdf_file import Pose, numbers, origin, required

INERTIAS = ("project", "strict")  # values of `inertias` of `Arm.from_urdf`
ROUNDED = 0.01  # dimensionless; largest excess by rounding: three digits change each of three moments by up to 0.5 %
LIGHT = 0.05  # dimensionless; mass of a light link / moving mass; masses of arms are seldom known more accurately
SMALL = 1e-3  # m; a change is small if a body of the same mass with this radius of gyration has a larger inertia
PARALLEL = 1e-6  # rad; axes at a smaller angle are parallel
ENTRIES = {f"i{'xyz'[i]}{'xyz'[j]}": (i, j) for i in range(3) for j in range(i, 3)}  # attributes of <inertia>
MAX_TEXT = 24  # characters of a number of the file in a message


class Inertial(NamedTuple):
    """<inertial> of a link: mass, kg; pose of its axes in the link; inertia matrix (3, 3), kg m^2; its text."""

    mass: float
    pose: Pose
    inertia: Array
    text: str


def read_inertials(links: Mapping[str, ElementTree.Element]) -> dict[str, Inertial]:
    """Return the <inertial> of each link that has a mass or an inertia."""
    result = {}
    for name, link in links.items():
        element, field = link.find("inertial"), f"link {name!r}.inertial"
        if element is None:
            continue
        written, entries = required(field, element, "mass"), element.find("inertia")
        mass = physical(f"{field}.mass", float(numbers(f"{field}.mass", written, "value")[0]), "kg", zero=True)
        if mass == 0.0 and entries is None:
            continue
        entries, inertia = required(field, element, "inertia"), np.zeros((3, 3))
        for entry, (i, j) in ENTRIES.items():
            inertia[i, j] = inertia[j, i] = numbers(field, entries, entry)[0]
        if mass or inertia.any():
            text = " ".join(f"{entry}={entries.get(entry, '').strip()[:MAX_TEXT]}" for entry in ENTRIES)
            text += f" (kg m^2) with mass {written.get('value', '').strip()[:MAX_TEXT]} (kg)"
            result[name] = Inertial(mass, origin(field, element), inertia, text)
    return result


def nearest_bodies(inertials: Mapping[str, Inertial], poses: Mapping[str, Pose]) -> tuple[dict[str, Body], list[str]]:
    """Return the body of each link in the root link, with the nearest possible inertia, and the links changed by it.

    A link without mass has no body, so that an inertia without mass is a change, too.

    Args:
        inertials: link -> its <inertial>.
        poses: link -> its pose in the root link.
    """
    bodies, changed = {}, []
    for name, (mass, pose, inertia, _) in inertials.items():
        if not mass or triangle_excess(inertia) > ROUNDING:
            changed.append(name)
            inertia = nearest_inertia(inertia)
        if mass:
            turn, place = poses[name]
            rotation = turn @ pose[0]
            bodies[name] = Body(mass, place + turn @ pose[1], rotation @ inertia @ rotation.T)
    return bodies, changed


def check_change(name: str, inertial: Inertial, total: float, axes: Sequence[Array], inertias: str) -> str:
    """Check that the inertia of a link may be replaced by the nearest one, and return a note about it.

    Args:
        name: the link.
        inertial: its <inertial>.
        total: mass that the joints of the arm move, kg.
        axes: unit vectors (3,) of all joints that move the link, in the axes of the link; empty if it has further
            motions.
        inertias: one of INERTIAS; "strict" allows no change.

    Raises:
        ValueError: for an inertia that is neither rounded, light, small nor without effect, see `Arm.from_urdf`.
    """
    mass, pose, inertia, text = inertial
    field, nearest = f"link {name!r}.inertial: {text}", nearest_inertia(inertia)
    values = " ".join(f"{entry}={nearest[at]:.6g}" for entry, at in ENTRIES.items())
    change = nearest - inertia
    minor = triangle_excess(inertia) <= ROUNDED or mass < LIGHT * total or np.abs(change).max() <= mass * SMALL**2
    if inertias == "strict" or not (minor or _is_without_effect(change, [pose[0].T @ axis for axis in axes])):
        allowed = f"{POSSIBLE}; the nearest are {values}" if mass else "a mass > 0 (kg) where an inertia is given"
        raise ValueError(f"{field} is not allowed; give {allowed}")
    meaning = f"is impossible and read as {values}" if mass else "is read as no mass and no inertia"
    return f'{field} {meaning}; inertias="strict" refuses it'


def _is_without_effect(change: Array, axes: Sequence[Array]) -> bool:
    """Return True if all axes (3,) are parallel and the change of an inertia matrix (3, 3) is zero about them."""
    if not axes or any(np.linalg.norm(np.cross(axes[0], axis)) > PARALLEL for axis in axes):
        return False
    return bool(abs(axes[0] @ change @ axes[0]) <= PARALLEL * np.abs(change).max())
