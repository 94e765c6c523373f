"""Arms: named arms, each with its source.

"The paper" is "Dynamic modeling and simulation of spatial manipulator with flexible links and joints".
"""

import warnings

from flexman_gym.arrays import Matrix, Vector
from flexman_gym.checks import one_of
from flexman_gym.scene.arm import Arm, Payload
from flexman_gym.scene.joint import Joint
from flexman_gym.scene.link import IDENTITY, UP, Link

TOOL = Payload(0.1)
"""Payload of `vertical_2r`, 0.1 kg."""
LIGHT_TOOL = Payload(0.05)
"""Payload of `one_joint`, 0.05 kg."""
_LINK1_AREAS = {"printed": 0.028, "corrected": 0.0028}


def paper_rrr(
    link1_area: str = "printed",
    rotor_inertia: float = 1.0,
    joint_stiffness: float | None = 5000.0,
    joint_damping: float = 0.0,
    payload: Payload | None = None,
    gravity: Vector = (0.0, 0.0, 0.0),
    *,
    torque_limit: float | None = None,
    **damping: float,
) -> Arm:
    """Builds the spatial RRR arm of the paper's Table 1.

    The printed area of link 1, 0.028 m^2, is impossible with its printed polar moment, 1.66e-6 m^4. Of all sections of
    one area A a solid disc has the least polar moment, A^2 / (2 pi), here 1.25e-4 m^4. The corrected area, 0.0028 m^2,
    fits: the least moment is then 1.25e-6 m^4. The printed area is the default because the paper's figures and the
    reference trajectories use it. It is built without the warning that a Link gives of such a section.

    The paper shows axes and pose in a figure only. Here, at zero angles, link 1 stands along +Z, and links 2 and 3 lie
    along +X. The axes are +Z, -Y, -Y, so that positive angles of joints 2 and 3 raise the arm.

    Args:
        link1_area: "printed", 0.028 m^2, or "corrected", 0.0028 m^2.
        rotor_inertia: of each joint, kg m^2; the paper gives none, 1.0 is our choice.
        joint_stiffness: of each joint, N m/rad, 5000 in the paper; None for rigid joints.
        joint_damping: of each joint, N m s/rad, 0 in the paper.
        payload: at the tip; none in the paper.
        gravity: (3,) m/s^2; none in the paper's scene, as its 400 N m could not hold the arm.
        torque_limit: of each joint, N m; the paper has none.
        damping: stiffness_proportional_damping (s) and modal_damping_ratio of the Arm, both 0 in the paper.

    Raises:
        ValueError: for another `link1_area`, and for arguments that Joint or Arm refuses.

    Examples:
        >>> [link.length for link in fm.catalog.paper_rrr().links]
        [1.0, 4.0, 3.5]
    """
    area = _LINK1_AREAS[one_of("link1_area", link1_area, _LINK1_AREAS)]
    links = (
        _paper_link(1.0, area, 8.33e-7, 1.66e-6, UP),
        _paper_link(4.0, 0.0020, 6.24e-7, 1.24e-6),
        _paper_link(3.5, 0.0008, 5.37e-7, 1.07e-6),
    )
    axes = ((0.0, 0.0, 1.0), (0.0, -1.0, 0.0), (0.0, -1.0, 0.0))
    joints = [Joint(axis, rotor_inertia, joint_stiffness, joint_damping, torque_limit=torque_limit) for axis in axes]
    return Arm(links, joints, payload, gravity, **damping)


def _paper_link(
    length: float,
    area: float,
    second_moment: float,
    polar_moment: float,
    orientation: Matrix = IDENTITY,
) -> Link:
    """Builds a link from one column of Table 1, in m, m^2, m^4 and m^4."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # about the printed area of link 1
        return Link(
            length,
            area,
            second_moment_y=second_moment,
            second_moment_z=second_moment,
            torsion_constant=polar_moment,
            youngs_modulus=206e9,
            shear_modulus=79.3e9,
            density=8253.0,
            orientation=orientation,
        )


def one_link(
    axis: Vector = (0.0, 0.0, 1.0),
    rotor_inertia: float = 0.0,
    joint_stiffness: float | None = None,
    payload: Payload | None = None,
    gravity: Vector = (0.0, 0.0, 0.0),
    **damping: float,
) -> Arm:
    """Builds a slender aluminium link of 2 m on a hub, along +X at a zero angle.

    It is an example of our own, not a published arm. Its two bending stiffnesses differ (I_y = 3.25 I_z). No section of
    4e-4 m^2 has its two second moments of area. Their sum, 1.7e-8 m^4, is less than the torsion constant and than the
    2.55e-8 m^4 of a solid disc. The numbers stay because a reference trajectory uses them.

    Args:
        axis: of the hub's Joint; by default +Z.
        rotor_inertia: of the hub's Joint, kg m^2; by default none.
        joint_stiffness: of the hub's Joint, N m/rad; by default it is rigid.
        payload: of the Arm, as in `paper_rrr`.
        gravity: of the Arm, as in `paper_rrr`.
        damping: of the Arm, as in `paper_rrr`.

    Raises:
        ValueError: for arguments that Joint or Arm refuses.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # about the section of the link
        link = Link(2.0, 4e-4, 1.3e-8, 4e-9, 2.2e-8, youngs_modulus=70e9, shear_modulus=26e9, density=2700.0)
    return Arm([link], [Joint(axis, rotor_inertia, joint_stiffness)], payload, gravity, **damping)


def planar_2r(
    rotor_inertia: float = 0.1,
    joint_stiffness: float | None = None,
    payload: Payload | None = None,
    gravity: Vector = (0.0, 0.0, 0.0),
    **damping: float,
) -> Arm:
    """Builds two aluminium strips of 0.5 m in a horizontal plane: axes +Z, both links along +X at zero angles.

    It is an example of our own, not a published arm. The strips, 40 mm high and 3 mm thick, bend in the plane of
    motion. Their torsion constant is that of a thin rectangle, h t^3 (1 - 0.63 t/h) / 3 (Roark's Formulas for Stress
    and Strain).

    Args:
        rotor_inertia: of each joint, kg m^2.
        joint_stiffness: of each joint, N m/rad; None for rigid joints.
        payload: of the Arm, as in `paper_rrr`.
        gravity: of the Arm, as in `paper_rrr`.
        damping: of the Arm, as in `paper_rrr`.

    Raises:
        ValueError: for arguments that Joint or Arm refuses.
    """
    link = _strip(0.5, thickness=0.003, height=0.040)
    joint = Joint((0.0, 0.0, 1.0), rotor_inertia, joint_stiffness)
    return Arm([link, link], [joint, joint], payload, gravity, **damping)


def vertical_2r(payload: Payload | None = TOOL, gravity: Vector = (0.0, 0.0, -9.81), **damping: float) -> Arm:
    """Builds two aluminium strips of 0.5 m that move in the vertical x-z plane, on elastic joints, with their motors.

    Args:
        payload: of the Arm; by default 0.1 kg.
        gravity: of the Arm, (3,) m/s^2; by default the earth's.
        damping: of the Arm, as in `paper_rrr`.

    Raises:
        ValueError: for what Arm refuses.

    An example of our own, not a published arm: strips 40 mm wide and 5 mm thick that bend in the plane of motion,
    joints of 100 and 60 N m/rad, motors of 12 and 4 N m. Outstretched and at rest, the tip sags by some 7 cm.
    """
    width, thickness = 0.040, 0.005
    link = _strip(0.5, thickness=thickness, width=width)
    axis = (0.0, -1.0, 0.0)  # positive angles raise the arm
    joints = [
        Joint(axis, rotor_inertia=0.1, stiffness=100.0, damping=0.05, torque_limit=12.0),
        Joint(axis, rotor_inertia=0.04, stiffness=60.0, damping=0.02, torque_limit=4.0),
    ]
    return Arm([link, link], joints, payload, gravity, **({"modal_damping_ratio": 0.005} | damping))


def one_joint(payload: Payload | None = LIGHT_TOOL, gravity: Vector = (0.0, 0.0, 0.0), **damping: float) -> Arm:
    """Builds an aluminium strip of 0.8 m on one elastic joint, which turns it in a horizontal plane about +Z.

    Args:
        payload: of the Arm; by default 0.05 kg.
        gravity: of the Arm, (3,) m/s^2; by default none.
        damping: of the Arm, as in `paper_rrr`.

    Raises:
        ValueError: for what Arm refuses.

    The textbook case, with numbers of our own: a strip 30 mm high and 2 mm thick, a joint of 20 N m/rad, a motor of
    0.5 N m and 0.01 kg m^2.
    """
    link = _strip(0.8, thickness=0.002, height=0.030)
    joint = Joint((0.0, 0.0, 1.0), rotor_inertia=0.01, stiffness=20.0, damping=0.005, torque_limit=0.5)
    return Arm([link], [joint], payload, gravity, **({"modal_damping_ratio": 0.005} | damping))


def _strip(length: float, thickness: float, width: float = 0.0, height: float = 0.0) -> Link:
    """Return an aluminium strip, thin along z where it has a width along y, thin along y where it has a height along z.

    Its torsion constant is that of a thin rectangle, h t^3 (1 - 0.63 t/h) / 3 (Roark's Formulas for Stress and Strain).
    """
    broad = width or height
    stiff, soft = thickness * broad**3 / 12.0, broad * thickness**3 / 12.0
    about_y, about_z = (soft, stiff) if width else (stiff, soft)
    torsion = broad * thickness**3 * (1.0 - 0.63 * thickness / broad) / 3.0
    return Link(length, broad * thickness, about_y, about_z, torsion, 70e9, 26e9, 2700.0)
