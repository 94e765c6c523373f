"""Slew table: torques that a search found, by start and goal, kept in a file without pickles."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.checks import BROKEN, SHOWN, open_arrays, refusal, shown_path
from flexman_gym.control.shooting import Slew, spread
from flexman_gym.model.model import Model

SHIPPED = Path(__file__).parent / "tables" / "FlexRRR-v0.npz"  # seeds 9000 to 9099
SAME, LIKE = 1e-9, 1e-9  # rad between postures that are the same, and of the numbers of an arm relative to them
MAKE = "flexman optimise ENVIRONMENT --seeds FIRST COUNT --out FILE"
ENTRIES = ("about", "arm", "seeds", "ends", "periods", "times", "counts", "knots")


@dataclass
class SlewTable:
    """Optimised slews of one arm.

    Attributes:
        about: what it was made with: environment, method, model, command and so on; texts, numbers and lists.
        arm: numbers by which the arm is known, see `numbers_of`.
        found: seed of an episode -> its start and goal (2, n) rad, the Slew, and the settling time (s) of its replay in
            the environment, infinite where it did not settle.
    """

    about: Mapping[str, Any]
    arm: Array
    found: dict[int, tuple[Array, Slew, float]] = field(default_factory=dict)

    def torques(self, start: Array, goal: Array) -> Array:
        """Gives the torques (T, n) N m of the slew between two postures (n,) rad.

        Raises:
            ValueError: where there is none.
        """
        for ends, slew, _ in self.found.values():
            if ends.shape == (2, len(start)) and np.abs(ends - [start, goal]).max() <= SAME:
                return spread(slew.knots, slew.periods)
        allowed = f"a start and a goal that the table has, or make one: {MAKE}"
        raise refusal("episode", [start.tolist(), goal.tolist()], allowed)

    def settling_time(self, seed: int) -> float:
        """Gives the settling time (s) of the optimised slew of an episode.

        Raises:
            ValueError: for an episode that the table does not have.
        """
        if seed not in self.found:
            raise refusal("seed", seed, f"one that the table has, or make one: {MAKE}")
        return self.found[seed][2]

    def check_arm(self, arm: Array) -> None:
        """Refuses a table of another arm.

        Raises:
            ValueError: one line.
        """
        if arm.shape != self.arm.shape or not np.allclose(arm, self.arm, rtol=LIKE, atol=0.0):
            about = self.about.get("environment")
            raise refusal("table", about, f"one of this arm, with its torque limits and control period: {MAKE}")

    def save(self, path: Path) -> None:
        """Writes it, whole or not at all."""
        rows = [self.found[seed] for seed in sorted(self.found)]
        beside = path.with_name(f"{path.name}.part")
        with beside.open("wb") as file:
            np.savez_compressed(
                file,
                about=np.array(json.dumps(dict(self.about))),
                arm=self.arm,
                seeds=np.array(sorted(self.found), dtype=np.int64),
                ends=np.array([ends for ends, _, _ in rows]),
                periods=np.array([(slew.periods, slew.arrival) for _, slew, _ in rows], dtype=np.int64),
                times=np.array([time for _, _, time in rows]),
                counts=np.array([len(slew.knots) for _, slew, _ in rows], dtype=np.int64),
                knots=np.concatenate([slew.knots for _, slew, _ in rows]) if rows else np.zeros((0, 1)),
            )
        beside.replace(path)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Reads a table; nothing in it is run.

        Raises:
            FileNotFoundError: where there is no such file.
            ValueError: for a file that is none.
        """
        try:
            with open_arrays(path, packed=True) as data:
                about, arm, seeds, ends, periods, times, counts, knots = (data[name] for name in ENTRIES)
            parts = np.split(knots, np.cumsum(counts))[:-1]
            rows = zip(seeds, ends, parts, periods, times, strict=True)
            slews = {
                int(seed): (both, Slew(part, *map(int, ages)), float(time)) for seed, both, part, ages, time in rows
            }
            return cls(json.loads(str(about)), arm, slews)
        except FileNotFoundError:
            raise
        except BROKEN as error:
            said = " ".join(str(error).split())[:SHOWN] or type(error).__name__
            raise ValueError(f"{shown_path(path)}: it is no table of slews, which {MAKE} makes ({said})") from None


def numbers_of(model: Model, limits: Array, period: float) -> Array:
    """Gives what tells arms apart however finely they are modelled: lengths, springs, rotors, load, weight, motors."""
    constants = model.constants
    mass = np.atleast_1d(constants.payload_mass).ravel()
    parts = constants.length, constants.joint_stiffness, constants.rotor_inertia, mass, constants.gravity, limits
    return np.concatenate([*parts, [period]])
