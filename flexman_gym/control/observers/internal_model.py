"""Internal model of observers: simulated arms, Jacobians of their discrete dynamics, and delay compensation."""

from dataclasses import replace

import numpy as np

from flexman_gym.common.arrays import Array, BoolArray, IntArray, pad_rows
from flexman_gym.control.controller import Plant
from flexman_gym.kernels.layout import OK
from flexman_gym.model.linearization import coordinate_scales
from flexman_gym.simulation.batch import Batch


class InternalModels:
    """Batches of the arm of a plant, made when they are asked for.

    A batch cannot be copied; the copy of a controller makes its own and begins with the next episodes.

    Args:
        plant: the arm, and how it is simulated.
    """

    def __init__(self, plant: Plant) -> None:
        self._plant, self._batches = plant, dict[tuple[str, int], Batch]()

    def __call__(self, purpose: str, arms: int) -> Batch:
        """Gives the batch of so many arms that serves a purpose, the same one each time."""
        key = purpose, arms
        if key not in self._batches:
            plant = self._plant
            self._batches[key] = Batch(plant.model, *plant.integration, plant.period, arms=arms)
        return self._batches[key]

    def step(self, twins: tuple[str, int], arms: IntArray, states: Array, forces: Array) -> Array:
        """Gives the states (r, 2 d) a control period after others.

        Args:
            twins: purpose and number of the arms of a batch.
            arms: (r,) those that move.
            states: (r, 2 d) before.
            forces: (r, k) the first of the n + 6 numbers of a drive, see `Batch.step`.
        """
        batch = self(*twins)
        drive, moving = np.zeros((twins[1], self._plant.model.n_joints + 6)), np.zeros(twins[1], dtype=bool)
        drive[arms, : forces.shape[1]], moving[arms] = forces, True
        batch.place(arms, states)
        batch.step(drive, None if moving.all() else moving)
        result: Array = batch.state[arms]
        return result

    def __deepcopy__(self, memo: object) -> "InternalModels":
        return InternalModels(self._plant)


BATCH_ARMS = 16  # arms whose neighbours are moved at once, for the memory that they take
STATE_STEP, FORCE_STEP = 1e-5, 1e-3  # by which coordinates (of their size) and forces (of their scale) are changed


class DiscreteJacobians:
    """Differences of arms that move beside one another, each from a state or under a force that differs in one number.

    At rest they are the exact zero-order hold of `control.lqr`, to the error of the integration method. Motors
    slide, see `model.linearization`: Coulomb friction has no slope, and these arms have none.

    Args:
        plant: the arm, and how it is simulated.

    Attributes:
        scales: (n + 3,) of the forces: torque limits (N m), and the force on the tip along each axis that the strongest
            motor bears at the whole reach (N).
    """

    def __init__(self, plant: Plant) -> None:
        model, limits = plant.model, np.array(plant.torque_limit)
        self.scales = np.append(limits, np.full(3, limits.max() / model.constants.length.sum()))
        self._changes = np.concatenate([np.tile(STATE_STEP * coordinate_scales(model), 2), FORCE_STEP * self.scales])
        self._size = 2 * model.n_dof
        self._around = np.vstack([np.zeros(len(self._changes)), np.diag(self._changes)])  # the arm, its neighbours
        none = np.zeros(model.n_joints)
        smooth = model.constants._replace(coulomb_friction=none, rubbing=none.astype(np.int64))
        self._models = InternalModels(plant._replace(model=replace(model, constants=smooth)))

    def __call__(self, states: Array, torques: Array) -> tuple[Array, BoolArray]:
        """Gives the slopes (r, 2 d, 2 d + n + 3) by states, torques and forces on the tip; where they are good (r,).

        Args:
            states: (r, 2 d) before the period.
            torques: (r, n) N m in it.
        """
        result, good = np.zeros((len(states), self._size, len(self._changes))), np.zeros(len(states), dtype=bool)
        for first in range(0, len(states), BATCH_ARMS):
            some = slice(first, first + BATCH_ARMS)
            result[some], good[some] = self._differences(states[some], torques[some])
        return result, good

    def _differences(self, states: Array, torques: Array) -> tuple[Array, BoolArray]:
        batch = self._models("slopes", BATCH_ARMS * len(self._around))
        shape, n = (len(states), len(self._around)), len(self.scales)
        used = np.arange(shape[0] * shape[1])
        place = np.concatenate([states, torques, np.zeros((len(states), 3))], axis=1)
        near = (place[:, None] + self._around).reshape(len(used), -1)
        drive, moving = np.zeros((len(batch.rows), n + 3)), np.zeros(len(batch.rows), dtype=bool)
        drive[used, :n], moving[used] = near[:, self._size :], True
        batch.place(used, near[:, : self._size])
        batch.step(drive, moving)
        ends = batch.state[used].reshape(*shape, -1)
        good: BoolArray = (batch.status[used] == OK).reshape(shape).all(axis=1)
        return ((ends[:, 1:] - ends[:, :1]) / self._changes[:, None]).mT, good


class DelayCompensation:
    """Moves estimated states of b arms on through the delay of their torques, by the simulator.

    Args:
        plant: the arm and its delay.

    Attributes:
        past: (b, late + 1, n) torques that were asked for, N m, the newest first.
    """

    state_fields = ("past",)

    def __init__(self, plant: Plant) -> None:
        self._models, self._usual = InternalModels(plant), np.array(plant.torque_limit)
        self.past, self._limits = np.zeros((0, plant.delay[1] + 1, len(self._usual))), np.zeros((0, len(self._usual)))

    def reset(self, arms: IntArray, count: int, limits: Array | None = None) -> None:
        """Starts new episodes of the arms (r,), whose torque limits (r, n) N m may be other than those of the plant."""
        self.past, self._limits = pad_rows(self.past, count), pad_rows(self._limits, count)
        self.past[arms], self._limits[arms] = 0.0, self._usual if limits is None else limits

    def remember(self, delay: int) -> None:
        """Make room for the torques of a delay (control periods) that is longer than the plant's."""
        missing = delay + 1 - self.past.shape[1]
        if missing > 0:
            self.past = np.pad(self.past, ((0, 0), (0, missing), (0, 0)))

    def vary(self, arms: IntArray, parameters: dict[str, Array]) -> None:
        """Takes physical parameters, name -> (r, ...), of the arms (r,)."""
        if parameters:
            self._models("prediction", len(self.past)).vary(arms, **parameters)

    def record(self, arms: IntArray, actions: Array) -> None:
        """Takes what the motors of arms (r,) were asked for in the last period, parts of the limits (r, n)."""
        self.past[arms, 1:] = self.past[arms, :-1]
        self.past[arms, 0] = actions * self._limits[arms]

    def __call__(self, arms: IntArray, states: Array, delays: IntArray, beside: Array | float = 0.0) -> Array:
        """Gives the states (r, 2 d) of arms (r,) after delays (r,) in control periods.

        Torques (r, n) N m may act on the motors beside those that were asked for.
        """
        longest = int(delays.max(initial=0))
        if not longest:
            return states
        batch = self._models("prediction", len(self.past))
        drive, moving = np.zeros((len(self.past), len(self._usual) + 6)), np.zeros(len(self.past), dtype=bool)
        batch.place(arms, states)
        for period in range(longest):
            lag = delays - 1 - period
            moving[arms] = lag >= 0
            drive[arms, : len(self._usual)] = self.past[arms, np.maximum(lag, 0)] + beside
            batch.step(drive, moving)
        return batch.state[arms]
