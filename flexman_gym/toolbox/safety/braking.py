"""Brake of the safety filter, and the prediction of the motion after it.

The brake holds the weight of the arm and damps its motors. The fast brake drops the torques of the agent at once, which
is the shortest way to rest. The slow brake takes them back with a time constant: a step of the torques twists the
joints, so that a limit of their rates may be kept by the slow brake only.
"""

from collections.abc import Mapping
from typing import Protocol

import numpy as np

from flexman_gym.agent.controller import Plant
from flexman_gym.common.arrays import Array, IntArray
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.physical_parameters import varied_constants

BRAKE = 0.3  # fraction of the damping of the PD tuned for the arm; a stronger brake strains the links
DECAY = 0.3  # s; time constant with which the slow brake takes back the torques, as a step of them twists the joints
NEAR_PERIODS = 40  # control periods predicted with the sampled brake, after the delay; sampling costs damping
STAGES = ((0.025, 20), (0.1, 30))  # interval (s) and number of intervals of the later motion, with a continuous damper
METHOD, MAX_STEP = "midpoint_corrected_3", 0.007  # of the prediction; longest step (s) in the near periods
ROUNDING = 1e-6  # steps; error of a number of steps
DIVERGED = 1e3  # magnitude that replaces a prediction that diverged


class PredictedLimits(Protocol):
    """Quantities with limits, as functions of predicted states, see `envs.limits.Limits.predicted`."""

    def shares(self, states: Array, outputs: Array, stiffness: Array) -> Array:
        """Return quantities as fractions (k, T, m) of their limits, magnitudes up to 1 within the limits.

        Args:
            states: (k, T, 2 d) states.
            outputs: (k, T, OUTPUTS) outputs of these states, see `kernels.layout`.
            stiffness: (k, n) joint stiffness, N m/rad.
        """
        ...


class BrakePrediction:
    """Prediction of the motion of arms: torques in one period, then the brake.

    Args:
        plant: plant model.
        limits: quantities with limits.
        damping: (n,) damping of the brake, N m s/rad.
        arms: largest number of arms.
    """

    def __init__(self, plant: Plant, limits: PredictedLimits, damping: Array, arms: int) -> None:
        self._plant, self._limits, self._damping, period = plant, limits, damping, plant.period
        step = plant.integration[1]
        steps = int(np.ceil(period / (MAX_STEP if isinstance(step, str) else min(MAX_STEP, step)) - ROUNDING))
        self._near = Batch(plant.model, METHOD, period / steps, period, arms=arms)
        self._later = [Batch(plant.model, METHOD, interval, interval, arms=arms) for interval, _ in STAGES]
        self._stiffness = np.repeat(plant.model.constants.joint_stiffness[None], arms, axis=0)
        self._vary(np.arange(arms), {})

    def _vary(self, arms: IntArray, parameters: Mapping[str, Array]) -> None:
        """Set physical parameters, name -> (r, ...), of the first r arms."""
        constants = varied_constants(self._plant.model, len(arms), parameters)
        nominal = np.tile(self._plant.model.constants.rotor_damping, (len(arms), 1))
        damping = constants.get("rotor_damping", nominal) + self._damping
        self._near.set_constants(arms, constants)
        for batch in self._later:
            batch.set_constants(arms, {**constants, "rotor_damping": damping})
        self._stiffness[: len(arms)] = parameters.get("joint_stiffness", self._stiffness[: len(arms)])

    def present(self, states: Array, parameters: Mapping[str, Array]) -> Array:
        """Return the quantities (r, m) of r arms in states (r, 2 d) as fractions of their limits."""
        used = len(states)
        if parameters:
            self._vary(np.arange(used), parameters)
        self._near.reset(np.arange(used), states)
        shares = self._limits.shares(states[:, None], self._near.outputs[:used, None], self._stiffness[:used])
        return np.asarray(shares[:, 0])

    def __call__(
        self,
        states: Array,
        commands: Array,
        delays: IntArray,
        hold: Array,
        decaying: Array,
        parameters: Mapping[str, Array],
    ) -> tuple[Array, Array]:
        """Return the quantities (r, T, m) of r arms as fractions of their limits, and their motor rates (r, P, n).

        The motor rates are those at the end of the P control periods of the sampled brake, rad/s.

        Args:
            states: (r, 2 d) present states.
            commands: (r, D + 1, n) torques of this period, then those commanded before, the latest first, N m.
            delays: (r,) delays of the torques up to D, control periods.
            hold: (r, n) torques of the brake at rest, N m.
            decaying: (r, n) decaying torques of the brake in this period, N m.
            parameters: name -> (r, ...) physical parameters.
        """
        every, n, largest = np.arange(len(states)), len(self._damping), np.array(self._plant.torque_limit)
        if parameters:
            self._vary(every, parameters)
        periods, period = commands.shape[1] + NEAR_PERIODS, self._plant.period
        drives = self._drives(hold, decaying, period * (np.arange(float(periods)) - delays[:, None]))
        for t in range(commands.shape[1]):  # a torque acts after the delay
            known = np.flatnonzero(delays >= t)
            drives[known, t, :n] = commands[known, delays[known] - t]
        gains = np.repeat(np.array([np.zeros(n), self._damping, largest, np.zeros(n)])[None], len(drives), axis=0)
        timing = np.zeros((len(drives), 2), dtype=np.int64)
        timing[every] = np.stack([1 + delays, delays], axis=1)
        self._near.place(every, states)
        parts = [self._near.roll(drives, (gains, timing, self._near.rows.copy()))]
        start = period * (periods - delays[:, None])
        for batch, (interval, count) in zip(self._later, STAGES, strict=True):
            batch.place(every, np.nan_to_num(parts[-1][0][every, -1], nan=DIVERGED))
            middles = start + interval * (np.arange(count) + 0.5)
            parts.append(batch.roll(self._drives(hold, decaying, middles)))
            start = start + interval * count
        motion, outputs = (np.concatenate([each[i][every] for each in parts], axis=1) for i in range(2))
        shares = self._limits.shares(motion, outputs, self._stiffness[every])
        shares[np.isnan(shares)] = DIVERGED
        model = self._plant.model
        return shares, parts[0][0][every][:, :, model.n_dof :][..., model.motor_columns]

    def _drives(self, hold: Array, decaying: Array, times: Array) -> Array:
        """Return the inputs of all arms at times (r, P), s, after this period: weight and decaying torques (r, n)."""
        result = np.zeros((len(self._near.rows), times.shape[1], hold.shape[1] + 6))
        torques = hold[:, None] + decaying[:, None] * np.exp(-times / DECAY)[..., None]
        result[: len(hold), :, : hold.shape[1]] = torques
        return result
