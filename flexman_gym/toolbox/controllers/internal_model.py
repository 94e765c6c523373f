"""Internal models of observers: simulated arms, Jacobians of their discrete dynamics, and delay compensation."""

from dataclasses import replace

import numpy as np

from flexman_gym.agent.controller import Plant
from flexman_gym.common.arrays import Array, BoolArray, IntArray, pad_rows
from flexman_gym.kernels.layout import OK
from flexman_gym.model.linearization import coordinate_scales
from flexman_gym.simulation.batch import Batch


class InternalModels:
    """Batches of simulated arms with the plant model, created on demand.

    Batches are not copied: the copy of a controller creates new batches and must be reset before use.

    Args:
        plant: plant model with method and step.
    """

    def __init__(self, plant: Plant) -> None:
        self._plant, self._batches = plant, dict[tuple[str, int], Batch]()

    def __call__(self, purpose: str, arms: int) -> Batch:
        """Return the batch for a purpose with a number of arms; repeated calls return the same batch."""
        key = purpose, arms
        if key not in self._batches:
            plant = self._plant
            self._batches[key] = Batch(plant.model, *plant.integration, plant.period, arms=arms)
        return self._batches[key]

    def step(self, batch_key: tuple[str, int], arms: IntArray, states: Array, forces: Array) -> Array:
        """Return the states (r, 2 d) after one control period.

        Args:
            batch_key: purpose and number of arms of a batch.
            arms: (r,) indices in the batch.
            states: (r, 2 d) states before the period.
            forces: (r, k) first k of the n + 6 inputs of an arm: torques (n), tip force (3), base acceleration (3).
        """
        batch = self(*batch_key)
        drive, moving = np.zeros((batch_key[1], self._plant.model.n_joints + 6)), np.zeros(batch_key[1], dtype=bool)
        drive[arms, : forces.shape[1]], moving[arms] = forces, True
        batch.place(arms, states)
        batch.step(drive, None if moving.all() else moving)
        result: Array = batch.state[arms]
        return result

    def __deepcopy__(self, memo: object) -> "InternalModels":
        return InternalModels(self._plant)


BATCH_ARMS = 16  # number of arms whose perturbed copies are simulated together; limits the memory
STATE_STEP = 1e-5  # fraction of their scales; perturbation of coordinates and rates
FORCE_STEP = 1e-3  # fraction of their scales; perturbation of torques and tip forces


class DiscreteJacobians:
    """Finite-difference Jacobians of the discrete dynamics with respect to state, torques and tip force.

    One state variable or force is perturbed in each simulation. At an equilibrium the result equals the zero-order hold
    of the linear model (`model.state_space.discretize`) within the error of the integration method. Motors slide, see
    `model.linearization`: Coulomb friction of sliding motors has zero derivative and is omitted.

    Args:
        plant: plant model with method and step.

    Attributes:
        scales: (n + 3,) scales of the forces: torque limits (N m), 0 for passive joints, and, for each axis, the tip
            force (N) that the strongest motor balances at full reach.
    """

    def __init__(self, plant: Plant) -> None:
        model, limits = plant.model, np.array(plant.torque_limit)
        self.scales = np.append(limits, np.full(3, limits.max() / model.constants.length.sum()))
        forces = FORCE_STEP * np.where(self.scales > 0.0, self.scales, 1.0)
        self._steps = np.concatenate([np.tile(STATE_STEP * coordinate_scales(model), 2), forces])
        self._size = 2 * model.n_dof
        self._perturbations = np.vstack([np.zeros(len(self._steps)), np.diag(self._steps)])  # the nominal arm first
        zero = np.zeros(model.n_joints)
        sliding = model.constants._replace(coulomb_friction=zero, has_coulomb_friction=zero.astype(np.int64))
        self._models = InternalModels(plant._replace(model=replace(model, constants=sliding)))

    def __call__(self, states: Array, torques: Array) -> tuple[Array, BoolArray]:
        """Return Jacobians (r, 2 d, 2 d + n + 3) and flags (r,) of successful simulations.

        Args:
            states: (r, 2 d) states before the period.
            torques: (r, n) torques during the period, N m.
        """
        result, valid = np.zeros((len(states), self._size, len(self._steps))), np.zeros(len(states), dtype=bool)
        for first in range(0, len(states), BATCH_ARMS):
            part = slice(first, first + BATCH_ARMS)
            result[part], valid[part] = self._differences(states[part], torques[part])
        return result, valid

    def _differences(self, states: Array, torques: Array) -> tuple[Array, BoolArray]:
        batch = self._models("jacobians", BATCH_ARMS * len(self._perturbations))
        shape, forces = (len(states), len(self._perturbations)), len(self.scales)
        used = np.arange(shape[0] * shape[1])
        nominal = np.concatenate([states, torques, np.zeros((len(states), 3))], axis=1)
        perturbed = (nominal[:, None] + self._perturbations).reshape(len(used), -1)
        drive = np.zeros((len(batch.rows), forces + 3))  # torques, tip force, base acceleration
        moving = np.zeros(len(batch.rows), dtype=bool)
        drive[used, :forces], moving[used] = perturbed[:, self._size :], True
        batch.place(used, perturbed[:, : self._size])
        batch.step(drive, moving)
        ends = batch.state[used].reshape(*shape, -1)
        valid: BoolArray = (batch.status[used] == OK).reshape(shape).all(axis=1)
        return ((ends[:, 1:] - ends[:, :1]) / self._steps[:, None]).mT, valid


class DelayCompensation:
    """Delay compensation: prediction of the states of b arms to the time at which torques commanded now take effect.

    Args:
        plant: plant model with its delay.

    Attributes:
        past: (b, D + 1, n) torques commanded in the last periods, N m, the latest first; D is the largest delay.
    """

    state_fields = ("past",)

    def __init__(self, plant: Plant) -> None:
        self._models, self._plant_limits = InternalModels(plant), np.array(plant.torque_limit)
        n = len(self._plant_limits)
        self.past, self._limits = np.zeros((0, plant.delay[1] + 1, n)), np.zeros((0, n))

    def reset(self, arms: IntArray, count: int, limits: Array | None = None) -> None:
        """Start new episodes, see `Controller.reset`; limits (r, n), N m, or None for the limits of the plant."""
        self.past, self._limits = pad_rows(self.past, count), pad_rows(self._limits, count)
        self.past[arms], self._limits[arms] = 0.0, self._plant_limits if limits is None else limits

    def extend(self, delay: int) -> None:
        """Extend the record of commanded torques to a delay (control periods) longer than the record."""
        missing = delay + 1 - self.past.shape[1]
        if missing > 0:
            self.past = np.pad(self.past, ((0, 0), (0, missing), (0, 0)))

    def set_parameters(self, arms: IntArray, parameters: dict[str, Array]) -> None:
        """Set physical parameters, name -> (r, ...) in their units, of the simulated arms (r,)."""
        if parameters:
            self._models("prediction", len(self.past)).vary(arms, **parameters)

    def record(self, arms: IntArray, actions: Array) -> None:
        """Record the torques (r, n) commanded to arms (r,) in the previous period, fractions of the limits."""
        self.past[arms, 1:] = self.past[arms, :-1]
        self.past[arms, 0] = actions * self._limits[arms]

    def __call__(self, arms: IntArray, states: Array, delays: IntArray, disturbance: Array | float = 0.0) -> Array:
        """Return the states (r, 2 d) of arms (r,) after delays (r,) in control periods.

        Args:
            arms: (r,) indices.
            states: (r, 2 d) present states.
            delays: (r,) delays, control periods.
            disturbance: (r, n) disturbance torques on the motors, N m.
        """
        longest = int(delays.max(initial=0))
        if not longest:
            return states
        batch = self._models("prediction", len(self.past))
        drive, moving = np.zeros((len(self.past), len(self._plant_limits) + 6)), np.zeros(len(self.past), dtype=bool)
        batch.place(arms, states)
        for period in range(longest):
            row = delays - 1 - period  # of the torques that act in this period
            moving[arms] = row >= 0
            drive[arms, : len(self._plant_limits)] = self.past[arms, np.maximum(row, 0)] + disturbance
            batch.step(drive, moving)
        return batch.state[arms]
