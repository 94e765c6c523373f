"""Mass, damping and stiffness of an arm as functions of its sections and gears, with exact derivatives.

The mass matrix of the undeformed arm is linear in the area and the second moments of area of each section, and the
stiffness matrix in these and in the torsion constant. The matrices of unit sections are assembled once; a derivative is
their product with the derivative of the section. Modal damping of a link is 2 zeta M # K, with the geometric mean # of
the loaded mass matrix and the stiffness matrix; its derivative follows in the loaded modes, in which both are diagonal.

Design variables are logarithms of ratios to the given arm: of the thickness of each section and of each gear ratio.
The thickness of a strip is its thinner side; a section of another shape, or without outline, grows alike in both
directions. A gear ratio multiplies the torque limit of its joint, and its square the rotor inertia.
"""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array, Vector
from flexman_gym.model.beam import element_stiffness
from flexman_gym.model.dynamics import damping_matrix, inertial_forces, mass_matrix, stiffness_matrix
from flexman_gym.model.element import GAUSS_POINTS, NODE_COORDINATES
from flexman_gym.model.model import build_model
from flexman_gym.model.outboard_inertia import zero_pose_rotations
from flexman_gym.model.state_space import natural_modes
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.input_checks import replace_quietly
from flexman_gym.scene.joint import Joint
from flexman_gym.scene.link import SERIES_TERMS, SIZES, Link, NonUniformLink, Outline

SOFT_POWER = 150  # exponent of the soft minimum of squared frequencies; two equal frequencies give 0.2 % less
SPEED_TIME = 0.1  # s; weight of the speed of the tip, as in the reward "distance"
TIME_TOLERANCE = 1e-12  # relative; last step of the iteration for the settling time
MAX_ITERATIONS = 100  # of this iteration


def divide_links(arm: Arm, sections: int) -> Arm:
    """Return an arm whose uniform links are divided into equal sections; stepped links are unchanged."""
    links = [
        link if isinstance(link, NonUniformLink) else NonUniformLink(
            [replace_quietly(link, length=link.length / sections, orientation=Link.orientation, masses=())] * sections,
            link.orientation, link.masses,
        )
        for link in arm.links
    ]  # fmt: skip
    return replace(arm, links=links)


def resized(arm: Arm, thickness: Vector, gears: Vector | None = None) -> Arm:
    """Return an arm with the thickness of its sections and its gear ratios multiplied by factors.

    Args:
        arm: arm of stepped links with S sections in total, see `divide_links`.
        thickness: (S,) factors of the thickness, base to tip.
        gears: (n,) factors of the gear ratios; None for the given gears.
    """
    factors = iter(thickness)
    links = [NonUniformLink([_resized_section(part, float(next(factors))) for part in link.sections], link.orientation,
                            link.masses) for link in arm.links]  # fmt: skip
    joints = arm.joints if gears is None else list(map(_regeared, arm.joints, np.asarray(gears).tolist()))
    return replace(arm, links=links, joints=joints)


def _resized_section(section: Link, factor: float) -> Link:
    """Return a section with its thickness multiplied by a factor."""
    outline = section.outline
    if outline is None:
        powers = (2, 4, 4, 4)
        return replace_quietly(
            section, **{name: getattr(section, name) * factor**p for name, p in zip(SIZES, powers, strict=True)}
        )
    along = {axis: factor if outline.thin_axis in ("", axis) else 1.0 for axis in "yz"}
    wall = None if outline.wall is None else factor * outline.wall
    outline = Outline(outline.shape, along["y"] * outline.y, along["z"] * outline.z, wall)
    return replace_quietly(section, outline=outline, **outline.sizes)


def _regeared(joint: Joint, factor: float) -> Joint:
    """Return a joint with its gear ratio multiplied by a factor."""
    if joint.motor is not None:
        motor = replace(joint.motor, gear_ratio=factor * joint.motor.gear_ratio)
        limit = joint.torque_limit if motor.joint_torque_limit is None else None
        return replace(joint, motor=motor, rotor_inertia=0.0, torque_limit=limit and factor * limit)
    limit = joint.torque_limit and factor * joint.torque_limit
    return replace(joint, rotor_inertia=factor**2 * joint.rotor_inertia, torque_limit=limit)


def _section_slopes(section: Link) -> Array:
    """Return the derivatives (4,) of SIZES with respect to the logarithm of the thickness of a section."""
    outline, sizes = section.outline, np.array([getattr(section, name) for name in SIZES])
    if outline is None or not outline.thin_axis:
        return sizes * [2.0, 4.0, 4.0, 4.0]
    low, wide = sorted((outline.y, outline.z))
    odd = np.arange(1, 2 * SERIES_TERMS, 2)
    tanh = np.tanh(odd * math.pi * wide / (2.0 * low))
    # J = wide low^3 / 3 - 64 low^4 / pi^5 sum tanh(n pi wide / (2 low)) / n^5
    series, slope = (tanh / odd**5).sum(), ((1.0 - tanh**2) / odd**4).sum()
    torsion = wide * low**3 - 256.0 * low**4 * series / math.pi**5 + 32.0 * wide * low**3 * slope / math.pi**4
    powers = (1.0, 1.0, 3.0) if outline.thin_axis == "y" else (1.0, 3.0, 1.0)
    return np.append(sizes[:3] * powers, torsion)


def _unit_stiffness(section: Link, length: float) -> Array:
    """Return the stiffness matrices (4, 12, 12) of an element of given length (m) per unit of SIZES."""
    moduli = {"youngs_modulus": section.youngs_modulus, "shear_modulus": section.shear_modulus}
    units: list[Any] = [SimpleNamespace(**moduli, **dict(zip(SIZES, unit, strict=True))) for unit in np.eye(4)]
    return np.array([element_stiffness(unit, length) for unit in units])


class _Matrices(NamedTuple):
    """Matrices of a design at the r + 1 postures of a `DesignModel`.

    Attributes:
        mass: (r + 1, d, d).
        damping: (d, d).
        stiffness: (d, d).
        sizes: (S, 4) SIZES of the sections.
        slopes: (S, 4) derivatives of SIZES by the logarithm of the thickness.
        modes: for each link its columns, the frequencies omega (k,), rad/s, and shapes (k, k) of its loaded modes, and
            their inverse.
    """

    mass: Array
    damping: Array
    stiffness: Array
    sizes: Array
    slopes: Array
    modes: list[tuple[slice, Array, Array, Array]]


class DesignModel:
    """Metrics of an arm at fixed postures as functions of its sections and gears, with exact gradients.

    A design x (S + n,) holds the logarithms of the factors of the thickness of S sections, base to tip, and of n gear
    ratios; x = 0 is the given arm. Each section is one finite element.

    Args:
        arm: arm of stepped links, see `divide_links`.
        postures: (r, n) joint angles, rad, at which the metrics are computed.
    """

    def __init__(self, arm: Arm, postures: Array) -> None:
        self.arm, self.model = arm, build_model(arm, elements=1)
        self.sections = [section for link in arm.links for section in link.sections]
        self.rotors = self.model.constants.rotor_inertia
        d, count = self.model.n_dof, len(self.sections)
        # the first posture, of zero angles, determines the loaded modes
        angles = np.vstack([np.zeros(arm.n_joints), postures])
        self._unit_mass = np.zeros((len(angles), count, 3, d, d))  # per unit of area and second moments of area
        self._unit_moment = np.zeros((len(angles), count, 3, d))  # Jacobian of the first moment of mass, per area
        self._unit_stiffness, self._tips = np.zeros((count, 4, d, d)), np.zeros((len(angles), 3, d))
        for posture, each in enumerate(angles):
            self._tips[posture] = self._assemble(each, self._unit_mass[posture], self._unit_moment[posture])
        sizes = np.array([[getattr(section, name) for name in SIZES] for section in self.sections])
        rest, zero = [self.model.initial_state(each) for each in angles], np.zeros(d)
        # what the sections do not contribute: payload, lumped masses, rotors, joints
        self._mass = np.array([mass_matrix(self.model, state) for state in rest])
        self._mass -= np.tensordot(self._unit_mass, sizes[:, :3], ((1, 2), (0, 1)))
        self._weight = np.array([-inertial_forces(self.model)(state[:d], zero, zero) for state in rest])
        self._weight -= self._section_weight(sizes[:, 0])
        links = slice(d - self.model.n_elastic, d)
        self._stiffness, self._damping = stiffness_matrix(self.model), damping_matrix(self.model)
        self._stiffness[links, links] = self._damping[links, links] = 0.0

    def _assemble(self, angles: Array, unit_mass: Array, unit_moment: Array) -> Array:
        """Fill in the matrices of unit sections at one posture, and return the Jacobian (3, d) of the tip.

        Args:
            angles: (n,) joint angles, rad.
            unit_mass: (S, 3, d, d) mass matrices of the sections per unit of area and second moments of area.
            unit_moment: (S, 3, d) Jacobians of their first moments of mass per unit of area.
        """
        from scipy.spatial.transform import Rotation

        d, constants = self.model.n_dof, self.model.constants
        rotation, origin, spin, number = np.eye(3), np.zeros((3, d)), np.zeros((3, d)), 0
        abscissae, weights = np.polynomial.legendre.leggauss(GAUSS_POINTS)
        for i, mount in enumerate(zero_pose_rotations(self.arm)):
            rotation = rotation @ mount @ Rotation.from_rotvec(angles[i] * constants.axis[i]).as_matrix()
            spin[:, i] += rotation @ constants.axis[i]
            columns = self.model.elastic_columns(i)
            for element in self.model.elements(i):
                section, start, length, nodes = element
                first = columns.start - NODE_COORDINATES  # of the clamped node, which is no coordinate
                free = slice(max(first + nodes.start, columns.start), first + nodes.stop)
                inner = slice(-(free.stop - free.start), None)  # without the clamped node
                self._unit_stiffness[number, :, free, free] = _unit_stiffness(section, length)[:, inner, inner]
                for xi, weight in zip((1.0 + abscissae) / 2.0, weights / 2.0, strict=True):
                    motion = np.zeros((3, 3, d))  # of a point on the axis, and its changes with z and y in the section
                    for row, (y, z) in enumerate(((0.0, 0.0), (0.0, 1.0), (1.0, 0.0))):
                        point = rotation @ [start + xi * length, y, z]
                        motion[row] = origin - np.cross(point, spin, axisb=0, axisc=0)
                        motion[row][:, free] += rotation @ element.shapes(xi, y, z)[:, inner]
                    motion[1:] -= motion[0]
                    share = weight * length * section.density
                    unit_mass[number] += share * np.einsum("kia,kib->kab", motion, motion)
                    unit_moment[number] += share * motion[0]
                number += 1
            tip = rotation @ [self.arm.links[i].length, 0.0, 0.0]
            origin = origin - np.cross(tip, spin, axisb=0, axisc=0)
            origin[:, columns.stop - 6 : columns.stop - 3] += rotation
            spin[:, columns.stop - 3 : columns.stop] += rotation
        return origin

    def _section_weight(self, area: Array) -> Array:
        """Return the generalised weight (r + 1, d) of the sections with areas (S,), m^2."""
        return np.einsum("s,rsia,i->ra", area, self._unit_moment, self.model.constants.gravity)

    def _matrices(self, x: Array) -> _Matrices:
        """Return the matrices of a design, with the motors free."""
        count, gears = len(self.sections), np.exp(x[len(self.sections) :])
        parts = [_resized_section(*pair) for pair in zip(self.sections, np.exp(x[:count]).tolist(), strict=True)]
        sizes = np.array([[getattr(part, name) for name in SIZES] for part in parts])
        mass = self._mass + np.tensordot(self._unit_mass, sizes[:, :3], ((1, 2), (0, 1)))
        motors = self.model.motor_columns
        mass[:, motors, motors] += self.rotors * (gears**2 - 1.0)
        stiffness = np.tensordot(sizes, self._unit_stiffness, 2)
        damping, modes = self._damping + self.arm.stiffness_proportional_damping * stiffness, []
        for i, ratio in enumerate(self.arm.damping_ratios):
            columns = self.model.elastic_columns(i)
            squares, shapes = natural_modes(mass[0][columns, columns], stiffness[columns, columns])
            omega, inverse = np.sqrt(squares), shapes.T @ mass[0][columns, columns]
            damping[columns, columns] += 2.0 * ratio * (inverse.T * omega) @ inverse
            modes.append((columns, omega, shapes, inverse))
        slopes = np.array([_section_slopes(part) for part in parts])
        return _Matrices(mass, damping, self._stiffness + stiffness, sizes, slopes, modes)

    def _gradient(self, x: Array, at: _Matrices, mass: Array, stiffness: Array, damping: Array | None = None) -> Array:
        """Return the gradient (S + n,) of a function of the matrices.

        Args:
            x: design.
            at: its matrices.
            mass: (r + 1, d, d) derivatives of the function by the entries of the mass matrices.
            stiffness: (d, d) derivatives by those of the stiffness matrix.
            damping: (d, d) derivatives by those of the damping matrix; None for zero.
        """
        if damping is not None:
            mass, stiffness = mass.copy(), stiffness + self.arm.stiffness_proportional_damping * damping
            for ratio, (columns, omega, shapes, inverse) in zip(self.arm.damping_ratios, at.modes, strict=True):
                # C M^-1 C = 4 zeta^2 K, differentiated in the modes with M = 1 and K = omega^2
                modal = inverse @ damping[columns, columns] @ inverse.T * 2.0 * ratio / np.add.outer(omega, omega)
                stiffness[columns, columns] += shapes @ modal @ shapes.T
                mass[0][columns, columns] += shapes @ (modal * np.outer(omega, omega)) @ shapes.T
        by_sizes = np.tensordot(self._unit_stiffness, stiffness, 2)
        by_sizes[:, :3] += np.tensordot(self._unit_mass, mass, ((0, 3, 4), (0, 1, 2)))
        motors, gears = self.model.motor_columns, np.exp(x[len(self.sections) :])
        by_gears = 2.0 * self.rotors * gears**2 * mass[:, motors, motors].sum(axis=0)
        return np.concatenate([(by_sizes * at.slopes).sum(axis=1), by_gears])

    @property
    def thickness_limits(self) -> list[float]:
        """Factors (S,) at which strips are as thick as wide; infinity for other sections."""
        outlines = [section.outline for section in self.sections]
        return [max(each.y, each.z) / min(each.y, each.z) if each and each.thin_axis else math.inf for each in outlines]

    def link_masses(self, x: Array) -> tuple[Array, Array]:
        """Return the masses of the sections of each link (n,), kg, and their Jacobian (n, S + n)."""
        at, counts = self._matrices(x), [len(link.sections) for link in self.arm.links]
        owners = np.repeat(np.arange(len(counts)), counts)
        per_area = np.array([section.density * section.length for section in self.sections])
        own = per_area * (owners == np.arange(len(counts))[:, None])
        return own @ at.sizes[:, 0], np.hstack([own * at.slopes[:, 0], np.zeros((len(own), len(self.rotors)))])

    def frequency(self, x: Array) -> tuple[float, Array]:
        """Return the soft minimum of the natural frequencies at all postures, Hz, and its gradient (S + n,).

        The motors are held. The p-norm of the inverse squared frequencies is smooth even where two frequencies are
        equal; two equal frequencies give 0.2 % less than either.
        """
        at, free = self._matrices(x), np.setdiff1d(np.arange(self.model.n_dof), self.model.motor_columns)
        block = np.ix_(free, free)
        pairs = [natural_modes(mass[block], at.stiffness[block]) for mass in at.mass[1:]]
        lowest = min(squares[0] for squares, _ in pairs)
        weights = [(lowest / squares) ** SOFT_POWER for squares, _ in pairs]
        total = sum(each.sum() for each in weights)
        by_mass, by_stiffness = np.zeros_like(at.mass), np.zeros_like(at.stiffness)
        for r, ((squares, shapes), weight) in enumerate(zip(pairs, weights, strict=True), 1):
            # d log omega = phi^T (dK - omega^2 dM) phi / (2 omega^2)
            half = shapes * weight / (2.0 * total)
            by_mass[r][block] -= half @ shapes.T
            by_stiffness[block] += half / squares @ shapes.T
        result = math.sqrt(lowest * total ** (-1.0 / SOFT_POWER)) / (2.0 * math.pi)
        return result, result * self._gradient(x, at, by_mass, by_stiffness)

    def deflection(self, x: Array, force: Array) -> tuple[float, Array]:
        """Return the mean static deflection of the tip at the postures, m, and its gradient (S + n,).

        The arm is linear about its undeformed shape and the motors are held. The deflection has the direction of the
        force, without a force that of gravity.

        Args:
            x: design.
            force: (3,) force on the tip, N, base frame, in addition to the weight of the arm and the payload.
        """
        at, free = self._matrices(x), np.setdiff1d(np.arange(self.model.n_dof), self.model.motor_columns)
        direction = force if np.any(force) else self.model.constants.gravity
        direction = direction / np.linalg.norm(direction)
        by_stiffness, by_area = np.zeros_like(at.stiffness), np.zeros(len(self.sections))
        loads, block, result = self._weight + self._section_weight(at.sizes[:, 0]), np.ix_(free, free), 0.0
        for tip, load, unit in zip(self._tips[1:], loads[1:], self._unit_moment[1:], strict=True):
            right = np.stack([load + tip.T @ force, tip.T @ direction], axis=1)[free]
            bent, adjoint = np.linalg.solve(at.stiffness[block], right).T
            result += right[:, 1] @ bent
            by_stiffness[block] -= np.outer(adjoint, bent)
            by_area += np.einsum("sia,i,a->s", unit[:, :, free], self.model.constants.gravity, adjoint)
        count = len(loads) - 1
        gradient = self._gradient(x, at, np.zeros_like(at.mass), (by_stiffness + by_stiffness.T) / 2.0)
        gradient[: len(by_area)] += by_area * at.slopes[:, 0]
        return result / count, gradient / count

    def settling_time(self, x: Array, loop: "DesignLoop", guess: float = 1.0) -> tuple[float, Array]:
        """Return a settling time of the linear closed loop, s, and its gradient (S + 3 n,).

        The loop is a PD of the motors in continuous time without saturation. After this time the integral of e^2 +
        (SPEED_TIME v)^2, of tip error e and tip speed v, averaged over the postures and summed over slews of the single
        joints, is `loop.residual`. It solves tr(P X(T)) = residual, with X(T) the second moment of the state at T and
        the Gramian P of a Lyapunov equation.

        Args:
            x: (S + 3 n,) the design, and logarithms of stiffness and damping as fractions of the largest.
            loop: slews, largest gains and residual.
            guess: first guess of the time, s.
        """
        from scipy.linalg import expm

        count, n = len(self.sections), len(self.rotors)
        design, gears, shares = x[: count + n], np.exp(x[count : count + n]), np.exp(x[count + n :])
        at, motors = self._matrices(design), self.model.motor_columns
        gains = np.array([loop.stiffness * gears, loop.damping * gears**2]) * shares.reshape(2, n)
        at.stiffness[motors, motors] += gains[0]
        at.damping[motors, motors] += gains[1]
        loops = [
            _closed_loop(*each, at, self._slews(loop.slews)) for each in zip(at.mass[1:], self._tips[1:], strict=True)
        ]
        time, low, high = guess, 0.0, math.inf
        for _ in range(MAX_ITERATIONS):  # Newton's method on the logarithm, kept within the bracket
            moved = [expm(time * each.A) @ each.start for each in loops]
            left = np.mean([np.einsum("is,ij,js", z, each.gramian, z) for each, z in zip(loops, moved, strict=True)])
            rate = np.mean([((each.error @ z) ** 2).sum() for each, z in zip(loops, moved, strict=True)])
            low, high = (time, high) if left > loop.residual else (low, time)
            step = math.log(left / loop.residual) * left / rate
            if abs(step) < TIME_TOLERANCE * time:
                break
            inside = low < time + step < min(high, 3.0 * time)
            time = time + step if inside else 2.0 * time if high == math.inf else (low + high) / 2.0
        by_mass, by_stiffness, by_damping = (
            np.zeros_like(at.mass),
            np.zeros_like(at.stiffness),
            np.zeros_like(at.damping),
        )
        for r, (each, z) in enumerate(zip(loops, moved, strict=True), 1):
            by_mass[r], spring, damper = each.pull_back(each.residual_slope(time, z) / (rate * len(loops)))
            by_stiffness += spring
            by_damping += damper
        gradient = self._gradient(design, at, by_mass, by_stiffness, by_damping)
        by_gains = gains * [by_stiffness[motors, motors], by_damping[motors, motors]]
        gradient[count:] += by_gains[0] + 2.0 * by_gains[1]
        return time, np.concatenate([gradient, by_gains.ravel()])

    def _slews(self, angles: Array) -> Array:
        """Return the coordinates (d, n) at the start of slews of the single joints by angles (n,), rad."""
        result = np.zeros((self.model.n_dof, len(angles)))
        for i, motor in enumerate(self.model.motor_columns):
            result[[i, motor], i] = angles[i]
        return result


class DesignLoop(NamedTuple):
    """PD loop of a design whose settling time is minimised.

    Attributes:
        slews: (n,) slews of the joints, rad.
        stiffness: (n,) largest proportional gains with the given gears, N m/rad.
        damping: (n,) largest derivative gains with the given gears, N m s/rad.
        residual: integral of a settled arm, m^2 s, see `DesignModel.settling_time`.
    """

    slews: Array
    stiffness: Array
    damping: Array
    residual: float


class _ClosedLoop(NamedTuple):
    """Closed loop dz/dt = A z in the modes of the stiffness with gains: z = [omega eta, deta/dt], m = 2 d states.

    Attributes:
        A: (m, m).
        start: (m, n) states at the start of the slews.
        error: (6, m) tip error, and SPEED_TIME times the velocity of the tip, per unit state.
        gramian: (m, m) observability Gramian P of these errors.
        omega: (d,) natural frequencies, rad/s.
        shapes: (d, d) mass-normalised shapes.
    """

    A: Array
    start: Array
    error: Array
    gramian: Array
    omega: Array
    shapes: Array

    def residual_slope(self, time: float, moved: Array) -> Array:
        """Return the derivatives (m, m) of tr(P Z Z^T), Z = exp(A t) start (m, n), by the entries of A."""
        from scipy.linalg import expm_frechet, solve_continuous_lyapunov

        reach = solve_continuous_lyapunov(self.A, -moved @ moved.T)
        direction = 2.0 * time * self.gramian @ moved @ self.start.T
        return 2.0 * self.gramian @ reach + expm_frechet(time * self.A.T, direction, compute_expm=False)

    def pull_back(self, slope: Array) -> tuple[Array, Array, Array]:
        """Return the derivatives (d, d) by mass, stiffness and damping matrix of a function with derivatives by A."""
        d = len(self.omega)
        rows = -slope[d:]
        parts = rows @ self.A[d:].T, rows[:, :d] / self.omega, rows[:, d:]
        mass, stiffness, damping = (self.shapes @ (part + part.T) @ self.shapes.T / 2.0 for part in parts)
        return mass, stiffness, damping


def _closed_loop(mass: Array, tip: Array, at: _Matrices, slews: Array) -> _ClosedLoop:
    """Return the closed loop for a mass matrix (d, d), a Jacobian of the tip (3, d) and slews (d, n)."""
    from scipy.linalg import solve_continuous_lyapunov

    squares, shapes = natural_modes(mass, at.stiffness)
    omega, zero = np.sqrt(squares), np.zeros_like(mass)
    A = np.block([[zero, np.diag(omega)], [-np.diag(omega), -shapes.T @ at.damping @ shapes]])
    start = np.vstack([omega[:, None] * (shapes.T @ mass @ slews), np.zeros_like(slews)])
    moved, still = tip @ shapes, np.zeros_like(tip)
    errors = np.block([[moved / omega, still], [still, SPEED_TIME * moved]])
    return _ClosedLoop(A, start, errors, solve_continuous_lyapunov(A.T, -errors.T @ errors), omega, shapes)
