"""Model of an arm of MuJoCo rods: every link is a 1-D flex that bends, twists and stretches.

A rod connects the body of its joint to a free body at its tip, which carries the next joint. Each of the two has the
mass of half a piece and clamps a very short edge. Points have no rotary inertia, so both bodies carry that of the
pieces between them. The twist of an edge is a separate hinge. A round section with our second moment of area and a
matching shear modulus has our bending and torsional stiffness.
"""

from functools import partial
from typing import Any
from xml.etree.ElementTree import SubElement

import numpy as np

from flexman_gym.toolbox.interchange.mjcf import to_mjcf
from flexman_gym.toolbox.precision.peers.mujoco import advance, fewest_parts, sane_error
from flexman_gym.toolbox.precision.peers.peer_run import peer_row
from flexman_gym.toolbox.precision.runs import PrecisionRow, PrecisionScene, Timer

LENGTHS, CLAMP = (0.5, 0.25), 1e-3  # approximate piece lengths, m; clamped share of a piece at each end
METHODS = ("Euler", "RK4")  # `implicit`, `implicitfast`: no rods; `discrete`: no rods with edge springs


def rod(length: float, root: Any, body: Any, link: Any) -> tuple[Any, dict[str, str]]:
    """Append a round link in pieces of a length (m) to a body; return its tip body and the tip position in it."""
    (section,), turn, name = link.sections, np.array(link.orientation), body.get("name")
    pieces = round(link.length / length)
    along, whole, second = turn[:, 0], link.length / pieces, section.second_moment_y
    mass, polar = section.density * section.area * whole, section.density * 2.0 * second * whole
    slender = pieces * polar / 4 + mass * whole**2 / 24 * (pieces - 0.75)
    half = {
        "mass": repr(mass / 2),
        "diaginertia": _numbers((polar / 2, slender, slender)),
        "xyaxes": _numbers(turn.T[:2].ravel()),
    }
    world, ends = root.find("worldbody"), root.findall("worldbody/body[freejoint]")
    place = np.array(ends[-1].get("pos").split(), dtype=float) if ends else np.zeros(3)
    tip = SubElement(world, "body", name=f"{name}_tip", pos=_numbers(place + link.length * along))
    SubElement(tip, "freejoint")
    for end, side in ((body, 1.0), (tip, -1.0)):
        SubElement(end, "inertial", half, pos=_numbers(side * along * whole / 4))
    for j in range(1, pieces + 1):
        edge = SubElement(world, "body", name=f"{name}_twist_{j}")
        SubElement(edge, "joint", name=f"{name}_twist_{j}", axis=_numbers(along))
        SubElement(edge, "inertial", pos="0 0 0", mass="1e-9", diaginertia=_numbers([polar] * 3))
    for j in range(1, pieces):
        point = SubElement(world, "body", name=f"{name}_{j}", pos=_numbers(place + j * whole * along))
        SubElement(point, "inertial", pos="0 0 0", mass=repr(mass), diaginertia="1e-9 1e-9 1e-9")
        for axis in np.eye(3):
            SubElement(point, "joint", type="slide", axis=_numbers(axis))
    bodies = " ".join([name, name, *(f"{name}_{j}" for j in range(1, pieces)), f"{name}_tip", f"{name}_tip"])
    vertices = _numbers(np.concatenate([-CLAMP * whole * along, np.zeros(3 * pieces + 3), CLAMP * whole * along]))
    flex = SubElement(
        SubElement(root, "deformable"), "flex", name=name, dim="1", radius=repr(float((4.0 * second / np.pi) ** 0.25))
    )
    flex.attrib.update(body=bodies, vertex=vertices, element=" ".join(f"{j} {j + 1}" for j in range(pieces + 2)))
    SubElement(flex, "contact", selfcollide="none", contype="0", conaffinity="0")
    SubElement(flex, "edge", stiffness=repr(section.youngs_modulus * section.area / whole))
    shear = section.shear_modulus * section.torsion_constant / (2.0 * second)
    SubElement(flex, "elasticity", young=repr(section.youngs_modulus), shear=repr(shear))
    return tip, {"pos": "0 0 0"}


def _numbers(values: Any) -> str:
    """Return numbers as text in the format of MJCF."""
    return " ".join(repr(float(value)) for value in values)


def run(scene: PrecisionScene, length: float, integrator: str, parts: int) -> PrecisionRow:
    """Run a scene of constant torques from rest at zero angles with a number of steps per output step."""
    step = scene.scene.output_step / parts
    text = to_mjcf(scene.scene.arm, 0, integrator, step, partial(rod, length))
    done = advance(scene.scene, f"MuJoCo, rods of {length:g} m", integrator, step, text)
    return peer_row(scene, done, sane=sane_error(scene.scene.arm))


def runs(scene: PrecisionScene) -> list[Timer]:
    """Return timers at the longest stable step of each integrator."""
    calls = [partial(run, scene, length, integrator) for length in LENGTHS for integrator in METHODS]
    return [partial(call, fewest_parts(call)) for call in calls]
