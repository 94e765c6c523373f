"""Reference shaping: an agent changes a reference by time scaling, joint offsets and added torques."""

from typing import NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array, IntArray, pad_rows
from flexman_gym.toolbox.controllers.references.adaptive_references import SlewReferences

TIME_SCALING_GAIN = 0.35  # dimensionless; change of the time scaling in a control period / its distance to the command
OFFSET_FREQUENCY = 12.0  # rad/s; natural frequency of the critically damped filter of commanded offsets


class ShapingLimits(NamedTuple):
    """Largest changes of a reference that an agent can command.

    Attributes:
        pace: natural logarithm of the time scaling at an action of 1; 0 for no time scaling.
        offset: offset of each reference joint angle at an action of 1, rad.
        torque: added torque of each motor at an action of 1, as a fraction of the torque limit.
        fading: last fraction of the path over which offsets and torques fade out; 0 for no fading.
    """

    pace: float = 0.7
    offset: float = 0.08
    torque: float = 0.5
    fading: float = 0.05


class ReferenceShaping:
    """Reference shaping of the slews of b arms with n joints.

    With zero actions the references are unchanged, bit by bit.

    Args:
        slews: references whose clocks are scaled.
        limits: (n,) torque limits, N m.
        period: control period, s.
        authority: limits of the changes that the agent can command.
        gain: change of the time scaling in a control period / its distance to the command.

    Attributes:
        clock_offset: (b,) time by which the clock of each slew is ahead, s.
        offsets: (b, 2, n) offsets of the reference joint angles and rates, rad and rad/s.
        action: (b, 1 + 2 n) commands of the agent, from -1 to 1: time scaling, offsets, torques.
    """

    state_fields = ("clock_offset", "offsets", "action")

    def __init__(
        self,
        slews: SlewReferences,
        limits: Array,
        period: float,
        authority: ShapingLimits,
        gain: float = TIME_SCALING_GAIN,
    ) -> None:
        self._slews, self._limits, self._period, self._authority = slews, limits, period, authority
        self._gain = gain
        n = self._joints = len(limits)
        self.clock_offset, self.offsets, self.action = np.zeros(0), np.zeros((0, 2, n)), np.zeros((0, 1 + 2 * n))

    def reset(self, arms: IntArray, count: int) -> None:
        """Set clock offsets, joint offsets and actions of the arms with indices (r,) to zero; `count` arms in total."""
        for name in self.state_fields:
            setattr(self, name, pad_rows(getattr(self, name), count))
            getattr(self, name)[arms] = 0.0

    def update_time_scaling(self, arms: IntArray) -> None:
        """Move the time scaling of the arms (r,) towards its commanded value."""
        slews, target = self._slews, np.exp(self._authority.pace * self.action[arms, 0])
        change = self._gain * (target - slews.time_scaling[arms])
        slews.time_scaling[arms] += change
        slews.pace_rate[arms] = 0.5 * change / self._period  # half of the mean rate, since the deflection lags

    def advance(self, arms: IntArray, progress: Array) -> Array:
        """Advance offsets and clocks by a control period; return the added torques (r, n), N m.

        Args:
            arms: (r,) indices.
            progress: (r,) path parameters from 0 to 1.
        """
        n, fading = self._joints, self._authority.fading
        fade = np.clip((1.0 - progress) / fading, 0.0, 1.0)[:, None] if fading else np.ones((len(arms), 1))
        offsets, rates = self.offsets[arms, 0], self.offsets[arms, 1]
        target = fade * self._authority.offset * self.action[arms, 1 : 1 + n]
        rates = rates + self._period * (OFFSET_FREQUENCY**2 * (target - offsets) - 2.0 * OFFSET_FREQUENCY * rates)
        self.offsets[arms, 0], self.offsets[arms, 1] = offsets + self._period * rates, rates
        self.clock_offset[arms] += self._period * (self._slews.time_scaling[arms] - 1.0)
        result: Array = fade * self._authority.torque * self._limits * self.action[arms, 1 + n :]
        return result

    def offset_states(self, arms: IntArray) -> Array:
        """Return the changes (r, 2 d) of the reference states of the arms (r,) by the joint offsets."""
        model = self._slews.model
        angles, rates = (model.at_rest(self.offsets[arms, i])[:, : model.n_dof] for i in (0, 1))
        return np.concatenate([angles, rates], axis=1)
