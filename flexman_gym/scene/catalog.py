"""Catalog: named arms and scenes, with their sources.

The paper is "Dynamic modeling and simulation of spatial manipulator with flexible links and joints".

Each named arm is a YAML file in scene/arms with its description, source, parameters and options. To add an arm, write
such a file and assign its function in this module. `fm.catalog.NAME(...)` returns an Arm and `paper_scene` returns a
Scene, in SI units: m, kg, s, rad, N m, m^4 (second moments of area), N m/rad (joint stiffness), N m s/rad (joint
damping), kg m^2 (rotor inertia) and m/s^2 (gravity).

`fm.frequencies(fm.build_model(fm.catalog.one_link()))` returns natural frequencies in Hz. `flexman list arms` prints
the names of the arms, and `help(fm.catalog.paper_rrr)` prints the options and the source of an arm.
"""

from flexman_gym.common.checks import one_of
from flexman_gym.scene.rigid_body import Payload
from flexman_gym.scene.scene import Initial, ModelChoice, Scene
from flexman_gym.scene.serialization import named_arm
from flexman_gym.scene.signals import ConstantTorque

__all__ = [
    "LIGHT_TOOL",
    "TOOL",
    "apkarian_1998",
    "de_luca_siciliano",
    "deck_arm",
    "flexarm_rome",
    "gantry",
    "gifu_2link",
    "gu_2005",
    "loader_crane",
    "moberg_2005",
    "nasa_beam",
    "one_joint",
    "one_link",
    "paper_rrr",
    "paper_scene",
    "planar_2r",
    "quanser_2dsfl",
    "quanser_rotary",
    "rome_elastic_joint",
    "rotary_joint",
    "two_mass",
    "vertical_2r",
    "wernholt_2006",
]

paper_rrr = named_arm("paper_rrr")
"""Spatial arm with three revolute joints (RRR), from Table 1 of the paper."""
planar_2r = named_arm("planar_2r")
"""Horizontal arm of two aluminium strips of 0.5 m; joint axes along +z, links along +x at zero joint angles."""
one_link = named_arm("one_link")
"""Slender aluminium link of 2 m on a hub with a rigid joint, along +x at a zero joint angle."""
vertical_2r = named_arm("vertical_2r")
"""Two aluminium strips of 0.5 m that move in the vertical x-z plane, with flexible joints."""
one_joint = named_arm("one_joint")
"""Aluminium strip of 0.8 m on one flexible joint with a vertical axis, +z."""
quanser_2dsfl = named_arm("quanser_2dsfl")
"""Quanser 2-DoF Serial Flexible Link: two steel strips in a horizontal plane, with geared motors."""
flexarm_rome = named_arm("flexarm_rome")
"""FLEXARM of the University of Rome: a rigid link, then a flexible link."""
de_luca_siciliano = named_arm("de_luca_siciliano")
"""Two-link arm of De Luca and Siciliano."""
deck_arm = named_arm("deck_arm")
"""Arm on the deck of a ship: the links of the paper's arm, its boom raised by 60 degrees and its jib lowered by 30."""
gantry = named_arm("gantry")
"""Cantilever bridge on the portal of a gantry crane, with a load that hangs from a universal joint at its tip."""
gifu_2link = named_arm("gifu_2link")
"""Arm of Gifu University: three joints, two flexible rods of 0.44 m."""
nasa_beam = named_arm("nasa_beam")
"""Pinned beam with a tip mass, published by NASA's Johnson Space Center."""
quanser_rotary = named_arm("quanser_rotary")
"""Quanser rotary flexible link: a steel strip on a hub that a geared motor turns about a vertical axis."""
rotary_joint = named_arm("rotary_joint")
"""Rotary flexible joint: a hub that a geared motor turns, a spring, and an arm that hangs in a vertical plane."""
gu_2005 = named_arm("gu_2005")
"""Flexible-link manipulator of Gu, Petkov and Konstantinov, an example of robust control."""
moberg_2005 = named_arm("moberg_2005")
"""ABB benchmark of Moberg, Ohr and Gunnarsson: motor, gear and arm as four inertias in a chain, on the motor side."""
apkarian_1998 = named_arm("apkarian_1998")
"""Flexible two-link manipulator of Apkarian and Adams, an example of gain scheduling over the posture of the elbow."""
rome_elastic_joint = named_arm("rome_elastic_joint")
"""Flexible link on an elastic joint of the University of Rome: one link of 0.7 m in a horizontal plane."""
wernholt_2006 = named_arm("wernholt_2006")
"""Axis of an industrial robot identified by Wernholt and Gunnarsson: motor, gear and arm in a chain, motor side."""
loader_crane = named_arm("loader_crane")
"""Small loader crane: slewing column, two flexible booms on elastic drives, and a load on a universal joint."""
two_mass = named_arm("two_mass")
"""Two masses and a spring, the benchmark of Wie and Bernstein: rotor and rigid link on a joint spring."""
TOOL = Payload(0.1)
"""Payload of `vertical_2r`, 0.1 kg."""
LIGHT_TOOL = Payload(0.05)
"""Payload of `one_joint`, 0.05 kg."""

_PAPER_CASES = {  # case -> flexible links, flexible joints
    "rr": (False, False),
    "fr": (True, False),
    "ff": (True, True),
}


def paper_scene(case: str = "ff") -> Scene:
    """Build a scene of the paper: `paper_rrr` from rest at zero angles under 400 N m at each joint, for 2 s.

    The model has two finite elements per link, as in the paper. Initial pose and duration are read from the figures of
    the paper, which does not print them. The output step of 0.01 s is not from the paper.

    Args:
        case: "rr" for rigid links and joints, "fr" for flexible links and rigid joints, "ff" for flexible links and
            joints.
    """
    flexible_links, flexible_joints = _PAPER_CASES[one_of("case", case, _PAPER_CASES)]
    return Scene(
        arm=paper_rrr(),
        model=ModelChoice((flexible_links,) * 3, elements=(2, 2, 2), flexible_joints=flexible_joints),
        torque=ConstantTorque((400.0, 400.0, 400.0)),
        initial=Initial((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        duration=2.0,
        output_step=0.01,
        note=f"the paper's case {case.upper()}: constant torques of 400 N m from rest",
    )
