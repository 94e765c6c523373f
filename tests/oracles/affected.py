"""Affected: made-up chains with every effect, spinning rotors, friction, disturbances and joints that are held."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from hypothesis import strategies as st

import flexman_gym as fm

from oracles.chains import Sample, samples
from oracles.dense import Chain


@dataclass(frozen=True)
class Affected:
    """A random chain with rotors that spin or not, friction, disturbances and joints whose motion is prescribed."""

    sample: Sample
    spinning: bool
    held: tuple[int, ...]

    @cached_property
    def arm(self):
        """The chain's arm with friction."""
        rng = np.random.default_rng(self.sample.seed)
        numbers = rng.uniform(0.0, 20.0, (self.sample.model.n_joints, 3))
        joints = [
            replace(joint, viscous_friction=viscous, coulomb_friction=coulomb, coulomb_rate=0.01 + rate)
            for joint, (viscous, coulomb, rate) in zip(self.sample.arm.joints, numbers, strict=True)
        ]
        return replace(self.sample.arm, joints=joints)

    @cached_property
    def model(self):
        """The model under test."""
        choice = replace(self.sample.model.choice, spinning_rotors=self.spinning)
        return fm.build_model(self.arm, **vars(choice))

    @cached_property
    def constants(self):
        """Its constants, with the joints that are held."""
        flags = np.isin(np.arange(self.model.n_joints), self.held).astype(np.int64)
        return self.model.constants._replace(prescribed=flags)

    @cached_property
    def chain(self):
        """The oracle in the same coordinates."""
        plain = self.sample.chain
        chain = Chain.__new__(Chain)
        chain.__dict__ |= plain.__dict__ | {"arm": self.arm, "spinning_rotors": self.spinning}
        return chain

    def drive(self):
        """The drive (n + 6,) of the kernels: torques, accelerations of held joints, tip force, base acceleration."""
        drive = np.random.default_rng(self.sample.seed + 2).uniform(-50.0, 50.0, self.model.n_joints + 6)
        drive[-3:] *= 0.2
        return drive

    def expected(self, x, v):
        """Accelerations and motor torques by the oracle."""
        n, drive = self.model.n_joints, self.drive()
        prescribed = {joint: drive[joint] for joint in self.held}
        return self.chain.driven(x, v, drive[:n], prescribed, drive[n : n + 3], drive[n + 3 :])


@st.composite
def affected(draw, held=True):
    """Random chains with all effects; some joints are held where that is wanted."""
    sample = draw(samples(stiffening=None))
    joints = st.sets(st.integers(0, sample.model.n_joints - 1))
    return Affected(sample, draw(st.booleans()), tuple(draw(joints)) if held else ())
