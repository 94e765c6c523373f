"""Chains: random arms, models and states for tests, with the dense oracle of each in the same coordinates."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import flexman_gym as fm
from flexman_gym import Arm, Joint, Link, Model, Payload, build_model
from flexman_gym.kernels import layout, outputs

from oracles.coordinates import agreed, agreed_modes, loaded_link, outboard_masses, own_damping, own_stations
from oracles.dense import Base, Chain, LinkModel

QUICK = settings(deadline=None, derandomize=True, max_examples=25)
AMPLITUDES = (0.0, 1e-6, 0.05, 1.5)  # rad, rotation of a link's tip; also its deflection / length


@dataclass(frozen=True)
class Sample:
    """Random arm with model options; `seed` determines the random states."""

    arm: Arm
    elements: tuple[int, ...]
    modes: tuple[int, ...] | None
    flexible_links: tuple[bool, ...]
    flexible_joints: bool
    amplitude: float
    seed: int
    stiffening: bool = False

    @cached_property
    def model(self) -> Model:
        """Return the model under test."""
        return build_model(
            self.arm, self.elements, self.modes, self.flexible_links, self.flexible_joints, self.stiffening
        )

    @cached_property
    def chain(self) -> Chain:
        """Return the oracle in the coordinates of the model, with modes and damping of the oracle's own beams."""
        loads, links = outboard_masses(self.arm, self.elements), []
        for i, (link, count) in enumerate(zip(self.arm.links, self.elements, strict=True)):
            stiffness, mass = loaded_link(link, count, loads[i])
            basis = np.eye(6 * count)
            if self.modes is not None and self.flexible_links[i]:
                basis = agreed_modes(self.model.bases[i], stiffness, mass)
                assert basis.shape[1] == min(self.modes[i], 6 * count)
            damping = own_damping(stiffness, mass, self.arm.modal_damping_ratio)
            damping = basis.T @ (damping + self.arm.stiffness_proportional_damping * stiffness) @ basis
            if self.flexible_links[i]:
                scale = np.sqrt(np.diag(basis.T @ mass @ basis))
                damping = agreed(damping, self.damping(i), np.outer(scale, scale))
            stations = own_stations(link, count) if self.stiffening else None
            links.append(LinkModel(basis, damping, stations))
        return Chain(self.arm, self.elements, self.flexible_links, self.flexible_joints, links)

    def damping(self, link: int) -> np.ndarray:
        """Return the damping matrix (k, k) of a link in the layout of the kernels."""
        start, stop = self.model.constants.square_start[link : link + 2]
        size = self.model.bases[link].shape[1]
        return self.model.constants.damping[start:stop].reshape(size, size)

    def state(self, more: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Return random coordinates and speeds (d,): any joint angles, links bent by about the amplitude.

        `more` is added to the seed.
        """
        rng = np.random.default_rng(self.seed + more)
        joints = self.model.n_joints + self.model.n_motors
        x, v = rng.uniform(-1.0, 1.0, (2, self.model.n_dof))
        x[: self.model.n_joints] *= np.pi
        x[self.model.motor_columns] = x[: self.model.n_joints] + 0.1 * rng.uniform(-1.0, 1.0, self.model.n_joints)
        v[:joints] *= 3.0
        for i, (beam, columns) in enumerate(zip(self.chain.beams, self.chain.elastic, strict=True)):
            mass = np.einsum("p,pia,pia->a", beam.masses, beam.S, beam.S)
            for vector, size in ((x, self.amplitude), (v, max(self.amplitude, 0.1))):
                q = vector[columns] / np.sqrt(mass)
                bend = max(np.linalg.norm(beam.S_r @ q), np.linalg.norm(beam.S_t @ q) / self.arm.links[i].length)
                vector[columns] = q * (size / bend if q.size else 0.0)
        return x, v

    def torque(self) -> np.ndarray:
        """Return random motor torques (n,), N m."""
        return np.random.default_rng(self.seed + 1).uniform(-50.0, 50.0, self.model.n_joints)

    def applied(self, x: np.ndarray, v: np.ndarray, torque: np.ndarray) -> np.ndarray:
        """Return the forces (d,) of motors, springs and dampers from their definitions (Eq. 18, 23)."""
        forces, drag = np.zeros(len(x)), np.zeros(len(x))
        forces[self.model.motor_columns] = torque
        for i, motor in self.chain.motor.items():
            joint = self.arm.joints[i]
            forces[[i, motor]] += joint.stiffness * (x[motor] - x[i]) * np.array([1.0, -1.0])
            drag[[i, motor]] += joint.damping * (v[motor] - v[i]) * np.array([-1.0, 1.0])
        for beam, damping, columns in zip(self.chain.beams, self.chain.damping, self.chain.elastic, strict=True):
            forces[columns] -= beam.K @ x[columns]
            drag[columns] += damping @ v[columns]
        return forces - drag


def random_link(rng: np.random.Generator) -> Link:
    """Return a random beam of about 1 m, of metal or plastic, with any section and orientation."""
    area, youngs_modulus = 10 ** rng.uniform(-3.5, -2.5), 10 ** rng.uniform(9.0, 11.0)
    y, z, twist = 10 ** rng.uniform(-1.0, 0.0, 3)
    return Link(
        length=rng.uniform(0.5, 2.0),
        area=area,
        second_moment_y=y * area**2,
        second_moment_z=z * area**2,
        torsion_constant=twist * area**2,
        youngs_modulus=youngs_modulus,
        shear_modulus=youngs_modulus * rng.uniform(0.2, 0.5),
        density=rng.uniform(1000.0, 8000.0),
        orientation=Rotation.random(random_state=rng).as_matrix(),
    )


def random_joint(rng: np.random.Generator, spring: bool) -> Joint:
    """Return a random joint about any axis, elastic and damped or rigid."""
    axis = Rotation.random(random_state=rng).as_matrix()[0]
    if not spring:
        return Joint(axis, rotor_inertia=rng.choice([0.0, rng.uniform(0.0, 2.0)]))
    return Joint(axis, rng.uniform(0.05, 2.0), 10 ** rng.uniform(2.0, 4.0), rng.choice([0.0, rng.uniform(0.0, 20.0)]))


def random_payload(rng: np.random.Generator, inertia: bool, offset: bool) -> Payload:
    """Return a random payload of a few kg and a few dm: a point, or a body between a rod and a disk."""
    mass, turn = rng.uniform(0.1, 5.0), Rotation.random(random_state=rng).as_matrix()
    spread = turn @ np.diag(rng.uniform(0.01, 0.3, 3) ** 2 * rng.integers(0, 2, 3)) @ turn.T
    moments = mass * (np.trace(spread) * np.eye(3) - (spread + spread.T) / 2)
    return Payload(mass, moments if inertia else None, rng.uniform(-0.3, 0.3, 3) if offset else None)


def slender_link(length: float = 0.7, mass_per_length: float = 4.0, stiffness: float = 0.6) -> Link:
    """Return a link that bends in its x-y plane with EI = `stiffness` and negligible rotary inertia.

    Across it is 100 times stiffer in frequency, so that the modes in the plane come first.
    """
    area = 1e-8 * length**2
    second_moment = area**2
    return Link(
        length=length,
        area=area,
        second_moment_y=1e4 * second_moment,
        second_moment_z=second_moment,
        torsion_constant=1e4 * second_moment,
        youngs_modulus=stiffness / second_moment,
        shear_modulus=stiffness / second_moment,
        density=mass_per_length / area,
    )


@st.composite
def samples(draw, most_links=7, flexible_links=None, flexible_joints=None, reduced=None, stiffening=False):
    """Arms of 1 to `most_links` links; a flag that is not None holds for the whole arm and the model."""
    n = draw(st.integers(1, most_links))
    each = lambda flag: st.tuples(*[st.booleans() if flag is None else st.just(flag)] * n)  # noqa: E731
    links, springs = draw(each(flexible_links)), draw(each(flexible_joints))
    elements = draw(st.tuples(*[st.integers(1, 3)] * n))
    modes = None
    if draw(st.booleans()) if reduced is None else reduced:
        modes = tuple(draw(st.integers(0, 6 * count)) for count in elements)
    free_springs = draw(st.booleans()) if flexible_joints is None else flexible_joints
    seed = draw(st.integers(0, 10**6))
    rng = np.random.default_rng(seed)
    carried = draw(st.sampled_from([None, (False, False), (True, False), (False, True), (True, True)]))
    arm = Arm(
        [random_link(rng) for _ in range(n)],
        [random_joint(rng, spring) for spring in springs],
        None if carried is None else random_payload(rng, *carried),
        draw(st.sampled_from([(0.0, 0.0, 0.0), tuple(rng.uniform(-10.0, 10.0, 3))])),
        stiffness_proportional_damping=draw(st.sampled_from([0.0, 1e-4])),
        modal_damping_ratio=draw(st.sampled_from([0.0, 0.02])),
    )
    amplitude = draw(st.sampled_from(AMPLITUDES))
    shortened = draw(st.booleans()) if stiffening is None else stiffening
    return Sample(arm, elements, modes, links, free_springs, amplitude, seed, shortened)


def pinocchio_model(pin, arm):
    """Return the rigid arm with rotors and payload as a Pinocchio model (module `pin`)."""
    model = pin.Model()
    model.gravity.linear = np.array(arm.gravity)
    place, parent = np.zeros(3), 0
    for link, joint in zip(arm.links, arm.joints, strict=True):
        kind = pin.JointModelRevoluteUnaligned(np.array(joint.axis))
        parent = model.addJoint(parent, kind, pin.SE3(np.eye(3), place), "")
        turn = np.array(link.orientation)
        # about the centre: a slender rod and the rotary inertia of the section
        y, z = link.density * link.length * np.array([link.second_moment_y, link.second_moment_z])
        rod = link.mass * link.length**2 / 12
        inertia = turn @ np.diag([y + z, rod + y, rod + z]) @ turn.T
        place = link.length * turn[:, 0]
        model.appendBodyToJoint(parent, pin.Inertia(link.mass, place / 2, inertia), pin.SE3.Identity())
    if arm.payload is not None:
        offset, moments = arm.payload.offset or np.zeros(3), arm.payload.inertia or np.zeros((3, 3))
        payload = pin.Inertia(arm.payload.mass, place + offset, np.array(moments))
        model.appendBodyToJoint(parent, payload, pin.SE3.Identity())
    model.armature = np.array([joint.rotor_inertia for joint in arm.joints])
    return model


@dataclass(frozen=True)
class Affected:
    """Random chain with (spinning) rotors, friction, disturbances, joints of prescribed motion and a rotating base."""

    sample: Sample
    spinning: bool
    held: tuple[int, ...]
    rotating: bool = False

    @cached_property
    def arm(self):
        """Return the chain's arm with friction."""
        rng = np.random.default_rng(self.sample.seed)
        numbers = rng.uniform(0.0, 20.0, (self.sample.model.n_joints, 3))
        joints = [
            replace(
                joint,
                viscous_friction=viscous,
                coulomb_friction=coulomb,
                coulomb_rate=0.01 + rate,
                static_friction=1.5 * coulomb,
                stribeck_rate=0.5 + viscous,
            )
            for joint, (viscous, coulomb, rate) in zip(self.sample.arm.joints, numbers, strict=True)
        ]
        return replace(self.sample.arm, joints=joints)

    @cached_property
    def model(self):
        """Return the model under test."""
        choice = replace(self.sample.model.choice, spinning_rotors=self.spinning)
        return fm.build_model(self.arm, **vars(choice))

    @cached_property
    def constants(self):
        """Return the constants of the model with the held joints and the rotation of the base."""
        flags = np.isin(np.arange(self.model.n_joints), self.held).astype(np.int64)
        return self.model.constants._replace(prescribed=flags, rotating=np.array([int(self.rotating)]))

    @cached_property
    def base(self):
        """Return the rotation of the base."""
        rng = np.random.default_rng(self.sample.seed + 3)
        attitude, (rate, acceleration) = Rotation.random(random_state=rng).as_matrix(), rng.uniform(-4.0, 4.0, (2, 3))
        return Base(attitude, rate, acceleration) if self.rotating else Base()

    @cached_property
    def chain(self):
        """Return the oracle in the same coordinates."""
        plain = self.sample.chain
        chain = Chain.__new__(Chain)
        chain.__dict__ |= plain.__dict__ | {"arm": self.arm, "spinning_rotors": self.spinning}
        return chain

    def drive(self):
        """Return the drive (n + 6,) of the kernels: torques, held joint accelerations, tip force, base acceleration.

        With a rotating base (n + 15,), then gravity, angular velocity and angular acceleration in the base frame.
        """
        drive = np.random.default_rng(self.sample.seed + 2).uniform(-50.0, 50.0, self.model.n_joints + 6)
        drive[-3:] *= 0.2
        turned = self.arm.gravity, self.base.rate, self.base.acceleration
        return np.r_[drive, np.ravel(turned @ self.base.attitude)] if self.rotating else drive

    def expected(self, x, v):
        """Return the accelerations and motor torques of the oracle."""
        n, drive = self.model.n_joints, self.drive()
        prescribed = {joint: drive[joint] for joint in self.held}
        return self.chain.driven(x, v, drive[:n], prescribed, drive[n : n + 3], drive[n + 3 : n + 6], self.base)


@st.composite
def affected(draw, held=True, rotating=False):
    """Return random chains with all effects, optionally with held joints, and with or without a rotating base."""
    sample = draw(samples(stiffening=None))
    joints = st.sets(st.integers(0, sample.model.n_joints - 1))
    return Affected(sample, draw(st.booleans()), tuple(draw(joints)) if held else (), rotating)


def random_scene(seed, links, elements, duration):
    """Return a scene of a random chain with springs and dampers in its joints, under sine torques."""
    rng = np.random.default_rng(seed)
    arm = fm.Arm([random_link(rng) for _ in range(links)], [random_joint(rng, True) for _ in range(links)])
    torque = fm.SineTorque(rng.uniform(5.0, 20.0, links), rng.uniform(0.5, 2.0, links), [0.0] * links)
    start = fm.Initial([0.0] * links, [0.0] * links)
    return fm.Scene(arm, fm.ModelChoice(True, elements), torque, start, duration, 0.02)


def observed(model, x, v):
    """Return the output row (OUTPUTS,) of the kernels at coordinates and speeds."""
    out = np.zeros(layout.OUTPUTS)
    outputs.compute_outputs(model.constants, layout.make_work(model.constants), x, v, out)
    return out


def laden_rrr(weight=9.81):
    """Return the arm of the paper with heavier rotors, a body off its tip, gravity and damped links."""
    payload = fm.Payload(3.0, inertia=np.diag([0.2, 0.3, 0.4]).tolist(), offset=(0.1, 0.0, 0.2))
    arm = fm.catalog.paper_rrr(rotor_inertia=10.0, link1_area="corrected")
    return replace(arm, payload=payload, gravity=(0.0, 0.0, -weight), stiffness_proportional_damping=1e-4)
