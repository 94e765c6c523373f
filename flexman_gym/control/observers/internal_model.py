"""Internal models of observers: simulated arms, Jacobians of their discrete dynamics, and delay compensation."""

from dataclasses import replace

import numpy as np

from flexman_gym.common.arrays import Array, BoolArray, IntArray, pad_rows
from flexman_gym.control.controller import Plant
from flexman_gym.kernels.layout import OK
from flexman_gym.model.linearization import coordinate_scales
from flexman_gym.simulation.batch import Batch


class InternalModels:
    """Batches of simulated arms with the plant model, created on demand.

    Batches are not copied: the copy of a controller creates its own and starts with the next episodes.

    Args:
        plant: plant model with method and step.
    """

    def __init__(self, plant: Plant) -> None:
        self._plant, self._batches = plant, dict[tuple[str, int], Batch]()

    def __call__(self, purpose: str, arms: int) -> Batch:
        """Return the batch of a number of arms for a purpose; repeated calls return the same batch."""
        key = purpose, arms
        if key not in self._batches:
            plant = self._plant
            self._batches[key] = Batch(plant.model, *plant.integration, plant.period, arms=arms)
        return self._batches[key]

    def step(self, batch_key: tuple[str, int], arms: IntArray, states: Array, forces: Array) -> Array:
        """Return the states (r, 2 d) after one control period.

        Args:
            batch_key: purpose and number of arms of a batch.
            arms: (r,) arms of the batch.
            states: (r, 2 d) before the period.
            forces: (r, k) first k of the n + 6 inputs of an arm, see `Batch.step`.

        Returns:
            States (r, 2 d).
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


BATCH_ARMS = 16  # arms whose perturbed copies are simulated together; limits the memory
STATE_STEP = 1e-5  # perturbation of coordinates and rates, relative to their scales
FORCE_STEP = 1e-3  # perturbation of forces, relative to their scales


class DiscreteJacobians:
    """Finite-difference Jacobians of the discrete dynamics with respect to state, torques and tip force.

    Each perturbed arm differs in one number. At an equilibrium the result equals the zero-order hold of the linear
    model (`model.state_space.discretize`) within the error of the integration method. Motors slide, see
    `model.linearization`: Coulomb friction has zero derivative then and is omitted.

    Args:
        plant: plant model with method and step.

    Attributes:
        scales: (n + 3,) of the forces: torque limits (N m), and for each axis the tip force (N) that the strongest
            motor balances at full reach.
    """

    def __init__(self, plant: Plant) -> None:
        model, limits = plant.model, np.array(plant.torque_limit)
        self.scales = np.append(limits, np.full(3, limits.max() / model.constants.length.sum()))
        self._changes = np.concatenate([np.tile(STATE_STEP * coordinate_scales(model), 2), FORCE_STEP * self.scales])
        self._size = 2 * model.n_dof
        self._around = np.vstack([np.zeros(len(self._changes)), np.diag(self._changes)])  # nominal, perturbed
        none = np.zeros(model.n_joints)
        smooth = model.constants._replace(coulomb_friction=none, has_coulomb_friction=none.astype(np.int64))
        self._models = InternalModels(plant._replace(model=replace(model, constants=smooth)))

    def __call__(self, states: Array, torques: Array) -> tuple[Array, BoolArray]:
        """Return Jacobians (r, 2 d, 2 d + n + 3) and flags (r,) of successful simulations.

        Args:
            states: (r, 2 d) before the period.
            torques: (r, n) during the period, N m.

        Returns:
            Jacobians (r, 2 d, 2 d + n + 3) and flags (r,).
        """
        result, valid = np.zeros((len(states), self._size, len(self._changes))), np.zeros(len(states), dtype=bool)
        for first in range(0, len(states), BATCH_ARMS):
            some = slice(first, first + BATCH_ARMS)
            result[some], valid[some] = self._differences(states[some], torques[some])
        return result, valid

    def _differences(self, states: Array, torques: Array) -> tuple[Array, BoolArray]:
        batch = self._models("jacobians", BATCH_ARMS * len(self._around))
        shape, n = (len(states), len(self._around)), len(self.scales)
        used = np.arange(shape[0] * shape[1])
        place = np.concatenate([states, torques, np.zeros((len(states), 3))], axis=1)
        perturbed = (place[:, None] + self._around).reshape(len(used), -1)
        drive, moving = np.zeros((len(batch.rows), n + 3)), np.zeros(len(batch.rows), dtype=bool)
        drive[used, :n], moving[used] = perturbed[:, self._size :], True
        batch.place(used, perturbed[:, : self._size])
        batch.step(drive, moving)
        ends = batch.state[used].reshape(*shape, -1)
        valid: BoolArray = (batch.status[used] == OK).reshape(shape).all(axis=1)
        return ((ends[:, 1:] - ends[:, :1]) / self._changes[:, None]).mT, valid


class DelayCompensation:
    """Delay compensation: prediction of the states of b arms to the time at which torques commanded now take effect.

    Args:
        plant: plant model with its delay.

    Attributes:
        past: (b, late + 1, n) commanded torques, N m, the newest first.
    """

    state_fields = ("past",)

    def __init__(self, plant: Plant) -> None:
        self._models, self._plant_limits = InternalModels(plant), np.array(plant.torque_limit)
        self.past, self._limits = (
            np.zeros((0, plant.delay[1] + 1, len(self._plant_limits))),
            np.zeros((0, len(self._plant_limits))),
        )

    def reset(self, arms: IntArray, count: int, limits: Array | None = None) -> None:
        """Start new episodes of the arms (r,), with torque limits (r, n) N m if they differ from those of the plant."""
        self.past, self._limits = pad_rows(self.past, count), pad_rows(self._limits, count)
        self.past[arms], self._limits[arms] = 0.0, self._plant_limits if limits is None else limits

    def remember(self, delay: int) -> None:
        """Extend the record of commanded torques for a delay (control periods) beyond that of the plant."""
        missing = delay + 1 - self.past.shape[1]
        if missing > 0:
            self.past = np.pad(self.past, ((0, 0), (0, missing), (0, 0)))

    def vary(self, arms: IntArray, parameters: dict[str, Array]) -> None:
        """Set physical parameters, name -> (r, ...), of the arms (r,)."""
        if parameters:
            self._models("prediction", len(self.past)).vary(arms, **parameters)

    def record(self, arms: IntArray, actions: Array) -> None:
        """Record the torques commanded to arms (r,) in the previous period, fractions of the limits (r, n)."""
        self.past[arms, 1:] = self.past[arms, :-1]
        self.past[arms, 0] = actions * self._limits[arms]

    def __call__(self, arms: IntArray, states: Array, delays: IntArray, disturbance: Array | float = 0.0) -> Array:
        """Return the states (r, 2 d) of arms (r,) after delays (r,) in control periods.

        Args:
            arms: (r,).
            states: (r, 2 d) now.
            delays: (r,) control periods.
            disturbance: (r, n) torques on the motors in addition to the commanded ones, N m.

        Returns:
            Predicted states (r, 2 d).
        """
        longest = int(delays.max(initial=0))
        if not longest:
            return states
        batch = self._models("prediction", len(self.past))
        drive, moving = np.zeros((len(self.past), len(self._plant_limits) + 6)), np.zeros(len(self.past), dtype=bool)
        batch.place(arms, states)
        for period in range(longest):
            lag = delays - 1 - period
            moving[arms] = lag >= 0
            drive[arms, : len(self._plant_limits)] = self.past[arms, np.maximum(lag, 0)] + disturbance
            batch.step(drive, moving)
        return batch.state[arms]
