"""Machines: arms that others have built or published, with their numbers and what was measured of them."""

import numpy as np

from flexman_gym.arrays import Matrix
from flexman_gym.checks import whole_number
from flexman_gym.scene.arm import Arm, Payload
from flexman_gym.scene.joint import Joint
from flexman_gym.scene.link import UP, Link, NonUniformLink
from flexman_gym.scene.lumped import LumpedMass
from flexman_gym.scene.motor import Motor

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
