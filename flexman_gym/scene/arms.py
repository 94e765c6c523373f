"""Named arms: examples of this library, and published robots with their sources."""

import warnings

import numpy as np

from flexman_gym.common.arrays import Matrix, Vector
from flexman_gym.common.checks import one_of, whole_number
from flexman_gym.scene.arm import Arm, Payload
from flexman_gym.scene.joint import Joint, Motor
from flexman_gym.scene.link import IDENTITY, UP, Link, LumpedMass, NonUniformLink

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


STEEL, ALUMINIUM, STAINLESS = (206.8e9, 79.3e9, 7850.0), (70e9, 26e9, 2700.0), (193e9, 74e9, 7930.0)  # Pa, Pa, kg/m^3
_UPRIGHT = (0.0, 0.0, 1.0)


def quanser_2dsfl(stages: int = 2) -> Arm:
    """Builds the Quanser 2-DoF serial flexible link: two steel strips in a horizontal plane, driven through gears.

    Numbers of strips, drives and inertias are those of the data file of the Czech Technical University in Prague
    (github.com/basta/quanser-2-dof-serial-flexible-link, MIT licence). It gives what strip 1 carries as 1.578 kg and
    0.17043 kg m^2 about its hub. Here strip 1 carries the second drive, an aluminium block of 76.2 x 43 mm and 1.367 kg
    from its end to joint 2, and behind that strip 2 with 0.157 kg at its end. The length of the block, 0.155 m, is not
    published: with it, both together have that inertia, outstretched, within 1 %. The damping ratios are fitted, see
    docs/machine.md.

    Args:
        stages: 2, or 1 for the first with the second locked, as its payload.

    Raises:
        ValueError: for another number.
    """
    first, second = Link.strip(0.202, 0.0762, 0.00127, "y", STEEL), Link.strip(0.20185, 0.0381, 0.000889, "y", STEEL)
    block = Link.strip(0.155, 0.0762, 1.3673 / (0.155 * 0.0762 * ALUMINIUM[2]), "y", ALUMINIUM)
    carried = NonUniformLink([first, block])
    motors = (
        Motor(100.0, 0.119, 6.354e-6, 0.94, efficiency=0.75, encoder_resolution=1.534e-3),  # rotor and fixture
        Motor(50.0, 0.0232, 1.208e-6, 0.94, efficiency=0.75, encoder_resolution=1.534e-3),
    )
    frictions = zip((4.0, 1.5), motors, strict=True)
    joints = [Joint(_UPRIGHT, viscous_friction=each, motor=motor) for each, motor in frictions]
    tool = Payload(0.157, _sphere(0.00644 - 0.157 * second.length**2))
    if whole_number("stages", stages, 1, 2) == 2:
        return Arm([carried, second], joints, tool, modal_damping_ratio=(0.11, 0.11))
    total = second.mass + tool.mass
    centre = (second.mass / 2.0 + tool.mass) * second.length / total
    about = second.mass * second.length**2 / 3.0 + 0.00644 - total * centre**2
    return Arm([carried], joints[:1], Payload(total, _sphere(about), (centre, 0.0, 0.0)), modal_damping_ratio=0.11)


def de_luca_siciliano() -> Arm:
    """Builds the two-link arm of De Luca and Siciliano (IEEE Trans. Systems, Man, and Cybernetics 21, 1991).

    Links of 0.5 m, 0.2 kg/m and 1 N m^2 that bend in the plane of motion; hubs of 0.1 kg m^2, of which the second has 1
    kg and sits on link 1; 0.1 kg and 0.0005 kg m^2 at the tip.
    """
    hub = LumpedMass(1.0, 0.5, _sphere(0.1))
    links = [_slender(0.5, 0.2, 1.0, [hub]), _slender(0.5, 0.2, 1.0)]
    return Arm(links, [Joint(_UPRIGHT, rotor_inertia=0.1), Joint(_UPRIGHT)], Payload(0.1, _sphere(0.0005)))


def nasa_beam() -> Arm:
    """Builds the pinned beam with a tip mass of NASA's Johnson Space Center (ASME DETC2007-35511).

    2.82 kg/m, 100.642 N m^2 and 3.372 m, with 5.18 times its mass at the tip.
    """
    link = _slender(3.372, 2.82, 100.642)
    return Arm([link], [Joint(_UPRIGHT)], Payload(5.18 * link.mass))


def flexarm_rome() -> Arm:
    """Builds FLEXARM of the University of Rome (IEEE Conf. Decision and Control 1990): a rigid and a flexible link.

    Links of 0.3 and 0.7 m. The inertias about their joints, 0.447 and 0.303 kg m^2, and that of hub 2, 6.35e-4 kg m^2,
    were published. The bending stiffness of link 2, 2.29 N m^2, is ours: it gives the measured first frequency, 4.716
    Hz, with free motors. Damping ratios of 0.07 and 0.03 were measured of the first two vibrations.
    """
    second, beam = _slender(0.7, 3.0 * (0.303 - 6.35e-4) / 0.7**3, 2.29), Link.strip(0.3, 0.05, 0.02)
    first = 0.447 - beam.mass * beam.length**2 / 3.0
    joints = [Joint(_UPRIGHT, rotor_inertia=first), Joint(_UPRIGHT, rotor_inertia=6.35e-4)]
    return Arm([beam, second], joints, modal_damping_ratio=(0.0, 0.07))


def gifu_2link() -> Arm:
    """Builds the arm of Gifu University (ROBOMECH Journal 5:28, 2018): three joints, two flexible rods of 0.44 m.

    Rods of stainless steel, 5 mm in radius, and of aluminium, 4 mm; gears of 1:100 with motors of 6e-4, 3.7e-5 and
    8.4e-6 kg m^2. Joint 1 turns the arm about the vertical, joints 2 and 3 raise it. The moduli are usual ones of these
    metals; the column, 0.1 m long, is not published. The elbow's motor, 0.4 kg, sits on the end of the first rod.
    """
    column = Link.tube(0.1, 0.08, 0.01, orientation=UP)
    steel = Link.rod(0.44, 0.010, STAINLESS, masses=[LumpedMass(0.4, 0.44)])
    aluminium = Link.rod(0.44, 0.008, ALUMINIUM)
    axes, rotors = (_UPRIGHT, (0.0, -1.0, 0.0), (0.0, -1.0, 0.0)), (6e-4, 3.7e-5, 8.4e-6)
    joints = [Joint(axis, 1e4 * rotor) for axis, rotor in zip(axes, rotors, strict=True)]
    return Arm([column, steel, aluminium], joints, gravity=(0.0, 0.0, -9.81))


def _slender(length: float, density: float, rigidity: float, masses: list[LumpedMass] | None = None) -> Link:
    """A link of which kg/m and EI (N m^2) in the plane are known: of aluminium, and stiff across the plane."""
    modulus, shear, heavy = ALUMINIUM
    moment = rigidity / modulus
    return Link(length, density / heavy, 1e4 * moment, moment, 1e4 * moment, modulus, shear, heavy, masses=masses or ())


def _sphere(inertia: float) -> Matrix:
    """The same inertia about every axis; in a plane one of them matters."""
    return tuple(tuple(row) for row in (inertia * np.eye(3)).tolist())
