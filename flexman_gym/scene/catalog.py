"""Catalog: named arms and scenes, each with its source.

Every function returns an Arm, `paper_scene` a Scene, in SI units: m, kg, s, rad, N m; second moments of area in m^4,
stiffness of joints in N m/rad, damping in N m s/rad, rotor inertia in kg m^2, gravity in m/s^2. Their frequencies (Hz)
are those of the model: `fm.frequencies(fm.build_model(fm.catalog.one_link()))`. `flexman list arms` prints their names.
"""

from flexman_gym.common.checks import one_of
from flexman_gym.scene.arms import (
    LIGHT_TOOL,
    TOOL,
    de_luca_siciliano,
    flexarm_rome,
    gifu_2link,
    nasa_beam,
    one_joint,
    one_link,
    paper_rrr,
    planar_2r,
    quanser_2dsfl,
    vertical_2r,
)
from flexman_gym.scene.scene import Initial, ModelChoice, Scene
from flexman_gym.scene.signals import ConstantTorque

__all__ = [
    "LIGHT_TOOL",
    "TOOL",
    "de_luca_siciliano",
    "flexarm_rome",
    "gifu_2link",
    "nasa_beam",
    "one_joint",
    "one_link",
    "paper_rrr",
    "paper_scene",
    "planar_2r",
    "quanser_2dsfl",
    "vertical_2r",
]

_PAPER_CASES = {  # case: (flexible links, flexible joints)
    "rr": (False, False),
    "fr": (True, False),
    "ff": (True, True),
}


def paper_scene(case: str = "ff") -> Scene:
    """Builds a scene of the paper: `paper_rrr` from rest at zero angles under 400 N m at each joint, for 2 s.

    It has two elements a link, as in the paper. The paper leaves pose and duration to its figures; the scene has our
    reading of them. The output step of 0.01 s is our choice too.

    Args:
        case: "rr" rigid links and joints, "fr" flexible links and rigid joints, "ff" flexible links and joints.

    Raises:
        ValueError: for another `case`.
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
