"""Following: motions of arms that follow goals which move, bent as their payloads and stiffness ask."""

from collections.abc import Mapping, Sequence

import numpy as np

from flexman_gym.arrays import Array, IntArray
from flexman_gym.control.reference import plan_path
from flexman_gym.control.slews import friction, friction_torques, payload_weights, softness
from flexman_gym.model.model import Model
from flexman_gym.simulation.parameters import varied_model


class Following:
    """States and torques of b arms along paths of their motors, planned ahead for some payloads, see `plan_path`.

    Args:
        model: of the arm.
        period: of control, s.
        payloads: kg, one or three, ascending.
    """

    def __init__(self, model: Model, period: float, payloads: Sequence[float]) -> None:
        self.model, self._period, self._payloads = model, period, np.array(payloads, dtype=float)
        self._models = [varied_model(model, payload_mass=mass) for mass in payloads]
        self._plans: dict[int, tuple[Array, Array, Array]] = {}  # arm -> rigid states, departures, torques by payload
        self._now: dict[int, tuple[Array, Array, Array]] = {}  # arm -> states, torques, friction

    def begin(self, arm: int, path: Array, parameters: Mapping[str, Array]) -> None:
        """Plans how an arm follows a path (T + 1, n) rad of its motors, one posture for each control period."""
        plans = [plan_path(model, path, self._period) for model in self._models]
        straight = self.model.at_rest(path)
        straight[:, self.model.n_dof :] = np.gradient(straight[:, : self.model.n_dof], self._period, axis=0)
        departures = np.array([plan.states - straight for plan in plans])
        self._plans[arm] = straight, departures, np.array([plan.torques for plan in plans])
        self.adapt(np.array([arm]), parameters)

    def adapt(self, arms: IntArray, parameters: Mapping[str, Array]) -> None:
        """Takes the physical parameters (b, ...) of the arms (r,) as they are estimated, see `Estimate`."""
        weights, soft = payload_weights(self._payloads, parameters, arms), softness(self.model, parameters, arms)
        rubbing = friction(self.model, parameters, arms)
        for row, arm in enumerate(arms.tolist()):
            straight, departures, torques = self._plans[arm]
            bent = (weights[row, :, None, None] * departures).sum(axis=0) * np.tile(soft[row], 2)
            self._now[arm] = straight + bent, (weights[row, :, None, None] * torques).sum(axis=0), rubbing[row]

    def at(self, now: Array, arms: IntArray) -> tuple[Array, Array]:
        """Gives the states (r, 2 d) of arms (r,) at times (r,) s and their torques (r, n) N m in the period after."""
        states, torques = [], []
        rates = self.model.n_dof + self.model.motor_columns
        for moment, arm in zip((now / self._period).round().astype(int).tolist(), arms.tolist(), strict=True):
            places, forward, rubbing = self._now[arm]
            row = min(moment, len(places) - 1)
            states.append(places[row])
            sliding = friction_torques(self.model, rubbing, places[row, rates])
            torques.append(forward[min(moment, len(forward) - 1)] + sliding)
        return np.array(states), np.array(torques)
