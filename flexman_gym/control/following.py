"""Following: motions of arms that follow goals which move, bent as their payloads and stiffness ask."""

from collections.abc import Mapping, Sequence

import numpy as np

from flexman_gym.arrays import Array, IntArray, grown
from flexman_gym.control.reference import plan_path
from flexman_gym.control.slews import friction, friction_torques, payload_weights, payloads_of, softness
from flexman_gym.model.model import Model
from flexman_gym.simulation.parameters import varied_model


class Following:
    """States and torques of b arms along paths of their motors, planned ahead for some payloads, see `plan_path`.

    Args:
        model: of the arm.
        period: of control, s.
        payloads: kg, one or three, ascending.
    """

    kept = ("_weights", "_soft", "_friction")

    def __init__(self, model: Model, period: float, payloads: Sequence[float]) -> None:
        self.model, self._period, self._payloads = model, period, np.array(payloads, dtype=float)
        self._models = [varied_model(model, payload_mass=mass) for mass in payloads]
        self._plans: dict[int, tuple[Array, Array, Array]] = {}  # arm -> rigid states, departures, torques by payload
        self._weights, self._soft = np.zeros((0, len(payloads))), np.zeros((0, model.n_dof))
        self._friction = np.zeros((0, 2, model.n_joints))

    def begin(self, arm: int, path: Array) -> None:
        """Plans how an arm follows a path (T + 1, n) rad of its motors, one for each period; `adapt` it next."""
        plans = [plan_path(model, path, self._period) for model in self._models]
        straight = self.model.at_rest(path)
        straight[:, self.model.n_dof :] = np.gradient(straight[:, : self.model.n_dof], self._period, axis=0)
        departures = np.array([plan.states - straight for plan in plans])
        self._plans[arm] = straight, departures, np.array([plan.torques for plan in plans])
        for name in self.kept:
            setattr(self, name, grown(getattr(self, name), arm + 1))

    def adapt(self, arms: IntArray, parameters: Mapping[str, Array]) -> None:
        """Takes the physical parameters (b, ...) of the arms (r,) as they are estimated, see `Estimate`."""
        if not len(arms):
            return
        self._weights[arms] = payload_weights(self._payloads, payloads_of(self.model, parameters, arms))
        self._soft[arms] = softness(self.model, parameters, arms)
        self._friction[arms] = friction(self.model, parameters, arms)

    def at(self, now: Array, arms: IntArray) -> tuple[Array, Array]:
        """Gives the states (r, 2 d) of arms (r,) at times (r,) s and their torques (r, n) N m in the period after."""
        states, torques = [], []
        rates = self.model.n_dof + self.model.motor_columns
        for moment, arm in zip((now / self._period).round().astype(int).tolist(), arms.tolist(), strict=True):
            straight, departures, forward = self._plans[arm]
            row, weights = min(moment, len(straight) - 1), self._weights[arm, :, None]
            bent = (weights * departures[:, row]).sum(axis=0) * np.tile(self._soft[arm], 2)
            states.append(straight[row] + bent)
            sliding = friction_torques(self.model, self._friction[arm], states[-1][rates])
            torques.append((weights * forward[:, min(moment, forward.shape[1] - 1)]).sum(axis=0) + sliding)
        return np.array(states), np.array(torques)
