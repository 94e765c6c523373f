"""Optimised slews: tables of torques, and replay of the torques."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np

from flexman_gym.agent.base_controllers import ControllerEntry
from flexman_gym.agent.controller import EpisodeInfo, Plant
from flexman_gym.common.arrays import Array, BoolArray, IntArray, Vector, pad_rows
from flexman_gym.common.checks import text
from flexman_gym.common.errors import value_error
from flexman_gym.common.files import open_arrays, reading, write_file
from flexman_gym.model.model import Model, check_model
from flexman_gym.toolbox.controllers.arm_scales import ArmScales
from flexman_gym.toolbox.controllers.lqr import LQR
from flexman_gym.toolbox.controllers.references.single_shooting import SlewTorques, interpolate_torques

SHIPPED_TABLE = Path(__file__).parent / "tables" / "FlexRRR-v0.npz"  # optimised slews of the seeds 9000 to 9099
POSTURE_TOLERANCE = 1e-9  # rad; largest difference of equal postures
ARM_TOLERANCE = 1e-9  # dimensionless; largest relative difference of the numbers of equal arms
COMMAND = "flexman optimise slews ENVIRONMENT --seeds FIRST COUNT --out FILE"
ENTRIES = ("about", "arm", "seeds", "ends", "periods", "times", "counts", "knots")  # arrays of a file


@dataclass
class SlewTable:
    """Optimised slews of one arm.

    Attributes:
        about: metadata of the table: environment, method, model, command and so on, as texts, numbers and lists.
        arm: (k,) numbers that identify the arm, see `fingerprint`.
        found: seed of an episode -> start and goal (2, n) rad, torques of the slew (knots, periods, arrival), and
            settling time (s) of the replay in the environment; infinite if the tip did not settle.
    """

    about: Mapping[str, Any]
    arm: Array
    found: dict[int, tuple[Array, SlewTorques, float]] = field(default_factory=dict)

    @staticmethod
    def fingerprint(model: Model, limits: Array, period: float) -> Array:
        """Return numbers (k,) that identify an arm with limits (n,) N m and a control period (s).

        The numbers are lengths, joint stiffnesses, rotor inertias, payload, gravity, torque limits and control period.
        They do not depend on the discretisation of the links.
        """
        constants = model.constants
        mass = np.atleast_1d(constants.payload_mass).ravel()
        parts = constants.length, constants.joint_stiffness, constants.rotor_inertia, mass, constants.gravity, limits
        return np.concatenate([*parts, [period]])

    def torques(self, start: Array, goal: Array) -> Array:
        """Return the torques (T, n) of the slew between two postures (n,) rad, N m.

        Args:
            start: (n,) initial motor angles, rad.
            goal: (n,) final motor angles, rad.

        Raises:
            ValueError: if the table has no such slew.
        """
        for ends, slew, _ in self.found.values():
            if ends.shape == (2, len(start)) and np.abs(ends - [start, goal]).max() <= POSTURE_TOLERANCE:
                return interpolate_torques(slew.knots, slew.periods)
        allowed = f"start and goal of a slew in the table, or compute one: {COMMAND}"
        raise value_error("episode", [start.tolist(), goal.tolist()], allowed)

    def settling_time(self, seed: int) -> float:
        """Return the settling time (s) of the optimised slew of an episode.

        Args:
            seed: seed of the episode.

        Raises:
            ValueError: if the table has no such episode.
        """
        if seed not in self.found:
            raise value_error("seed", seed, f"a seed in the table, or compute one: {COMMAND}")
        return self.found[seed][2]

    def is_of(self, arm: Array) -> bool:
        """Return True if the table belongs to an arm with numbers (k,) from `fingerprint`."""
        return arm.shape == self.arm.shape and np.allclose(arm, self.arm, rtol=ARM_TOLERANCE, atol=0.0)

    def check_arm(self, arm: Array) -> None:
        """Check that the table belongs to an arm.

        Args:
            arm: (k,) numbers from `fingerprint`.

        Raises:
            ValueError: for another arm.
        """
        if not self.is_of(arm):
            environment = self.about.get("environment")
            raise value_error(
                "table", environment, f"a table of this arm, with its torque limits and control period: {COMMAND}"
            )

    def save(self, path: Path) -> None:
        """Write the table to a file (npz), atomically."""
        rows = [self.found[seed] for seed in sorted(self.found)]
        arrays: dict[str, Any] = {
            "about": np.array(json.dumps(dict(self.about))),
            "arm": self.arm,
            "seeds": np.array(sorted(self.found), dtype=np.int64),
            "ends": np.array([ends for ends, _, _ in rows]),
            "periods": np.array([(slew.periods, slew.arrival) for _, slew, _ in rows], dtype=np.int64),
            "times": np.array([time for _, _, time in rows]),
            "counts": np.array([len(slew.knots) for _, slew, _ in rows], dtype=np.int64),
            "knots": np.concatenate([slew.knots for _, slew, _ in rows]) if rows else np.zeros((0, 1)),
        }
        write_file(path, lambda file: np.savez_compressed(file, **arrays))

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a table from a file written by `save`; no code in the file is executed.

        Args:
            path: path of the file.

        Raises:
            FileNotFoundError: if there is no file.
            ValueError: for a file without a table of slews.
        """
        with reading(path, f"is not a table of slews, as computed by {COMMAND}"):
            with open_arrays(path, packed=True) as data:
                about, arm, seeds, ends, periods, times, counts, knots = (data[name] for name in ENTRIES)
            parts = np.split(knots, np.cumsum(counts))[:-1]
            rows = zip(seeds, ends, parts, periods, times, strict=True)
            slews = {
                int(seed): (both, SlewTorques(part, *map(int, ages)), float(time))
                for seed, both, part, ages, time in rows
            }
            return cls(json.loads(str(about)), arm, slews)


class OptimisedController(LQR):
    """Replay of the optimised torques of a slew, followed by an LQR about the goal.

    The episodes must be known in advance. No feedback controller can be expected to settle as fast.

    Args:
        table: optimised slews of the arm.
        model: see `LQR`.
        torque_limit: see `LQR`.
        period: see `LQR`.

    Raises:
        ValueError: for arguments out of range and for a table of another arm; in `reset` for an episode missing in the
            table.
    """

    state_fields = ("_now",)

    def __init__(self, table: SlewTable, model: Model, torque_limit: float | Vector, period: float) -> None:
        super().__init__(model, torque_limit, period, scales=ArmScales.of_design_named(check_model(model)))
        table.check_arm(SlewTable.fingerprint(self.model, self.limits, self.period))
        self._table, self._slews, self._now = table, list[Array](), np.zeros(0, dtype=np.int64)

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Look up the slews of new episodes; arguments as in `Controller.reset`."""
        if episode.path is not None:
            raise value_error("episode", "a moving goal", "a fixed goal: slews are optimised for fixed goals only")
        found = [self._table.torques(*ends) for ends in zip(episode.start, episode.goal, strict=True)]
        super().reset(arms, episode, count)
        self._now = pad_rows(self._now, len(self._holding_torques))
        self._slews += [np.zeros((0, len(self.limits)))] * (len(self._holding_torques) - len(self._slews))
        for arm, torques in zip(arms.tolist(), found, strict=True):
            self._slews[arm], self._now[arm] = torques, 0

    def torques(self, states: Array) -> Array:
        """Return the torques (b, n) for states (b, 2 d), N m, and advance by a control period."""
        result = super().torques(states)
        for arm, now in enumerate(self._now.tolist()):
            if now < len(self._slews[arm]):
                result[arm] = self._slews[arm][now]
        self._now += 1
        return result

    def skip(self, active: BoolArray) -> None:
        """Advance the references of the active arms by a control period without readings, see `Controller`."""
        self._now[active] += 1


def _make(plant: Plant, table: object = None) -> OptimisedController:
    slews = SlewTable.load(SHIPPED_TABLE if table is None else text("base.table", table))
    return OptimisedController(slews, plant.model, plant.torque_limit, plant.period)


ENTRY = ControllerEntry(
    _make,
    ("model", "true state", "its episodes"),
    ("table",),
    "a replay of the fastest slew found by optimisation for each episode",
    "by `flexman optimise slews` on the test episodes themselves: a bound, not a competitor",
)
