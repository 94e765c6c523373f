"""Reference shaping: time scaling, joint offsets and added torques by which an agent changes a reference."""

from typing import NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array, IntArray, pad_rows
from flexman_gym.control.references.adaptive_references import SlewReferences

TIME_SCALING_GAIN = 0.35  # of the way to the pace that is wanted, in each control period
OFFSET_FREQUENCY = 12.0  # rad/s, natural frequency of the critically damped way to an offset that is wanted


class ShapingLimits(NamedTuple):
    """How far an agent may go.

    Attributes:
        pace: of the clock, which an action of 1 makes exp(pace) times as fast; 0 for none, as of the others.
        offset: rad, of each joint of the reference.
        torque: of each motor, a part of its limit.
        fading: last part of the path over which offsets and torques fade out; 0 where they stay.
    """

    pace: float = 0.7
    offset: float = 0.08
    torque: float = 0.5
    fading: float = 0.05


class ReferenceShaping:
    """How the slews of b arms of n joints are shaped. Where nothing is wanted it changes no bit.

    Args:
        slews: whose clocks it sets.
        limits: (n,) N m.
        period: of control, s.
        authority: of the agent.

    Attributes:
        ahead: (b,) s, by which the clocks of the slews are ahead of time.
        offsets: (b, 2, n) of the reference, rad and rad/s.
        wanted: (b, 1 + 2 n) of the agent, from -1 to 1: pace, offsets, torques.
    """

    state_fields = ("ahead", "offsets", "wanted")

    def __init__(self, slews: SlewReferences, limits: Array, period: float, authority: ShapingLimits) -> None:
        self._slews, self._limits, self._period, self._authority = slews, limits, period, authority
        n = self._joints = len(limits)
        self.ahead, self.offsets, self.wanted = np.zeros(0), np.zeros((0, 2, n)), np.zeros((0, 1 + 2 * n))

    def reset(self, arms: IntArray, count: int) -> None:
        """Begins anew for the arms (r,)."""
        for name in self.state_fields:
            setattr(self, name, pad_rows(getattr(self, name), count))
            getattr(self, name)[arms] = 0.0

    def quicken(self, arms: IntArray) -> None:
        """Lets the clocks of the arms (r,) run nearer to the pace that is wanted."""
        slews, wanted = self._slews, np.exp(self._authority.pace * self.wanted[arms, 0])
        change = TIME_SCALING_GAIN * (wanted - slews.pace[arms])
        slews.pace[arms] += change
        slews.quickening[arms] = 0.5 * change / self._period  # the bending follows later than a step of the pace

    def advance(self, arms: IntArray, places: Array) -> Array:
        """Moves on by a period; gives the torques (r, n) N m beside those of the law, at places (r,) of the paths."""
        n, fading = self._joints, self._authority.fading
        left = np.clip((1.0 - places) / fading, 0.0, 1.0)[:, None] if fading else np.ones((len(arms), 1))
        offsets, rates = self.offsets[arms, 0], self.offsets[arms, 1]
        wanted = left * self._authority.offset * self.wanted[arms, 1 : 1 + n]
        rates = rates + self._period * (OFFSET_FREQUENCY**2 * (wanted - offsets) - 2.0 * OFFSET_FREQUENCY * rates)
        self.offsets[arms, 0], self.offsets[arms, 1] = offsets + self._period * rates, rates
        self.ahead[arms] += self._period * (self._slews.pace[arms] - 1.0)
        result: Array = left * self._authority.torque * self._limits * self.wanted[arms, 1 + n :]
        return result

    def offset_states(self, arms: IntArray) -> Array:
        """Gives what the offsets of the arms (r,) add to the states (r, 2 d) of their references."""
        model = self._slews.model
        angles, rates = (model.at_rest(self.offsets[arms, i])[:, : model.n_dof] for i in (0, 1))
        return np.concatenate([angles, rates], axis=1)
