"""Motors of b arms: torques, and the forces and base motions that disturb the arms."""

from collections.abc import Sequence

import numpy as np

from flexman_gym.common.arrays import Array


class Motors:
    """Torques of the motors of b arms with n joints, and the forces and base motions that disturb the arms.

    Args:
        limits: (n,) torque limits, N m.
        arms: number of arms b.
        lag: result of `model.state_space.first_order_lag` for one control period; None for motors without a lag.

    Attributes:
        limits: (b, n) torque limits, N m; effects may change them.
        drive: (b, n + 6) inputs of `Batch.step`: each row holds n motor torques (N m), the tip force (3, N) and the
            base acceleration (3, m/s^2) of an arm.
        torques: (b, n) torques of the last control period, N m; a view of `drive`.
        forces: (b, 3) forces at the tips in the base frame, N; a view of `drive`.
        pushes: (b, 3) the part of the forces that effects do not draw, N, see `Episodes.push`.
        accelerations: (b, 3) accelerations of the bases in the base frame, m/s^2; a view of `drive`.
        reached: (b, n) torques that the lagging motors have reached, as fractions of the limits; 0 at a reset.
    """

    state_fields = ("limits", "forces", "accelerations", "reached")

    def __init__(self, limits: Sequence[float], arms: int, lag: tuple[float, float] | None = None) -> None:
        joints = len(limits)
        self.limits, self._lag = np.tile(limits, (arms, 1)), lag
        self.reached = np.zeros((arms, joints if lag else 0))
        self.drive, self.pushes = np.zeros((arms, joints + 6)), np.zeros((arms, 3))
        self.torques, self.forces = self.drive[:, :joints], self.drive[:, joints : joints + 3]
        self.accelerations = self.drive[:, joints + 3 :]

    def lagged(self, actions: Array) -> Array:
        """Return the mean torques (b, n) of a control period for commands (b, n), as fractions of the limits."""
        if self._lag is None:
            return actions
        missing = self.reached - actions
        self.reached[:] = actions + self._lag[0] * missing
        return actions + self._lag[1] * missing
