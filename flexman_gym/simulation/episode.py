"""Episode: what happened in an episode, or to a scene, as arrays with all that is needed to draw or repeat it."""

import hashlib
import json
import platform
from dataclasses import dataclass, field, fields
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Self

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import short_path
from flexman_gym.common.files import READ_ERRORS, open_arrays
from flexman_gym.common.time_series import write_csv
from flexman_gym.model.model import Model, build_model
from flexman_gym.scene.scene import ModelChoice
from flexman_gym.scene.serialization import find_arm, from_plain, to_plain
from flexman_gym.simulation.trajectory import Trajectory

FORMAT = 1
METADATA_KEY = "about"  # the plain data among the arrays of a file
AXES = "xyz"


@dataclass(frozen=True, eq=False)
class Episode:
    """T control periods of one arm, or the T + 1 output times of a scene; nan where there is no such thing.

    Attributes:
        time: (T + 1,) s, from the reset on.
        states: (T + 1, 2 d), the order is that of `kernels.layout`.
        tips: (T + 1, 3) m, base frame.
        targets: (T + 1, 3) m, base frame.
        errors: (T + 1,) m, distances of tip and target.
        readings: name -> (T + 1, k) what the agent's sensors had read last.
        actions: (T, n) what the motors were asked for, parts of their limits.
        torques: (T, n) N m, what the motors gave, after delays and other effects.
        rewards: (T,).
        about: plain data: name of who acted, environment, its settings and their hash, seed, versions, failure, arm and
            model, units of the readings.
    """

    time: Array
    states: Array
    tips: Array
    targets: Array
    errors: Array
    actions: Array
    torques: Array
    rewards: Array
    readings: dict[str, Array] = field(default_factory=dict)
    about: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def of_trajectory(cls, trajectory: Trajectory, name: str = "scene") -> Self:
        """Gives a trajectory in the form of an episode, without targets, actions, torques and rewards.

        Args:
            trajectory: the solution of a scene.
            name: by which pictures call it.
        """
        rows, n = trajectory.joint_angles.shape
        nothing = {"targets": (rows, 3), "errors": (rows,), "actions": (rows - 1, n), "torques": (rows - 1, n),
                   "rewards": (rows - 1,)}  # fmt: skip
        failure = "" if trajectory.status == "ok" else trajectory.status
        return cls(
            trajectory.time, trajectory.states, trajectory.tip, readings=trajectory.readings,
            about=episode_metadata(trajectory.model, name=name, failure=failure),
            **{each: np.full(shape, np.nan) for each, shape in nothing.items()},
        )  # fmt: skip

    @cached_property
    def model(self) -> Model:
        """The model that was moved, built anew.

        Raises:
            ValueError: one line, for an arm or a model that is not allowed.
        """
        choice = from_plain(ModelChoice, "model", self.about["model"])
        return build_model(find_arm(self.about["arm"]), **vars(choice))

    @property
    def name(self) -> str:
        """Who acted."""
        return str(self.about.get("name", ""))

    @property
    def period(self) -> float:
        """Time between two rows, s."""
        return float(self.time[1] - self.time[0]) if len(self.time) > 1 else 1.0

    @property
    def band(self) -> float:
        """Distance of tip and target within which it has settled, m; nan where nobody said one."""
        return float(self.about.get("band", np.nan))

    def save(self, path: str | Path) -> Path:
        """Writes arrays and plain data to one file (npz), in which nothing is a pickle; returns its path.

        Raises:
            OSError: where it cannot be written.
        """
        path, text = Path(path), json.dumps(self.about).encode()
        arrays = {
            each.name: getattr(self, each.name) for each in fields(self) if each.name not in ("readings", METADATA_KEY)
        }
        arrays |= {f"readings/{name}": values for name, values in self.readings.items()}
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("wb") as file:
            np.savez(file, allow_pickle=False, **arrays, **{METADATA_KEY: np.frombuffer(text, dtype=np.uint8)})
        return path

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Reads a file that `save` wrote; nothing in it is run.

        Raises:
            FileNotFoundError: when there is none.
            ValueError: one line, for a file that is something else.
        """
        try:
            with open_arrays(path) as data:
                told = json.loads(data[METADATA_KEY].tobytes())
                names = [each.name for each in fields(cls) if each.name not in ("readings", METADATA_KEY)]
                arrays = {name: data[name] for name in names}
                prefix = "readings/"
                readings = {name.removeprefix(prefix): data[name] for name in data.files if name.startswith(prefix)}
            result = cls(**arrays, readings=readings, about=told)
            result._check()
        except FileNotFoundError:
            raise FileNotFoundError(f"{short_path(path)}: no such file; give an episode that was saved") from None
        except READ_ERRORS as error:
            said = " ".join(str(error).split())[:120] or type(error).__name__
            raise ValueError(f"{short_path(path)}: this is not an episode that was saved ({said})") from None
        return result

    def _check(self) -> None:
        """Refuses arrays that do not belong together, and other plain data than `episode_metadata` gives."""
        if self.about["format"] != FORMAT or not isinstance(self.about["name"], str):
            raise ValueError("it has another format")
        rows, n = len(self.time), len(self.about["arm"]["links"])
        expected = {"time": (rows,), "states": (rows, self.states.shape[-1]), "tips": (rows, 3), "targets": (rows, 3),
                    "errors": (rows,), "actions": (rows - 1, n), "torques": (rows - 1, n), "rewards": (rows - 1,),
                    **{f"readings.{name}": (rows, each.shape[-1]) for name, each in self.readings.items()}}  # fmt: skip
        for name, shape in expected.items():
            values = self.readings[name[9:]] if name.startswith("readings.") else getattr(self, name)
            if values.shape != shape or values.dtype.kind != "f" or rows < 1:
                raise ValueError(f"{name} is {values.dtype} {values.shape}")

    def columns(self) -> dict[str, Array]:
        """Gives all but the states: columns (T + 1,) by name and unit, such as "tip_x (m)"; joints count from 1.

        Actions, torques and rewards stand at the end of their period; the first row has none.
        """
        units, joints = self.about.get("units", {}), range(1, self.actions.shape[1] + 1)
        result = {"time (s)": self.time, "error (m)": self.errors, "reward": _shift_to_period_ends(self.rewards)}
        for name, values in (("tip", self.tips), ("target", self.targets)):
            result |= {f"{name}_{axis} (m)": values[:, i] for i, axis in enumerate(AXES)}
        result |= {f"action_{i}": _shift_to_period_ends(self.actions[:, i - 1]) for i in joints}
        result |= {f"torque_{i} (N m)": _shift_to_period_ends(self.torques[:, i - 1]) for i in joints}
        for name, values in self.readings.items():
            unit = f" ({units[name]})" if units.get(name, "1") != "1" else ""
            result |= {f"{name}_{i + 1}{unit}": values[:, i] for i in range(values.shape[1])}
        return result

    def to_csv(self, path: str | Path) -> None:
        """Writes `columns` to a file: a line of names and units, then a line for each time, numbers with all digits.

        Raises:
            OSError: where the file cannot be written.
        """
        write_csv(path, self.columns())

    def to_pandas(self) -> Any:
        """Gives `columns` as a pandas DataFrame; its `attrs` hold `episode_metadata`.

        Raises:
            ImportError: without pandas.
        """
        import pandas

        result = pandas.DataFrame(self.columns())
        result.attrs.update(self.about)
        return result

    def to_xarray(self) -> Any:
        """Gives an xarray Dataset over time, and periods for actions, torques and rewards; `attrs` hold
        `episode_metadata`.

        Raises:
            ImportError: without xarray.
        """
        import xarray

        named = {"states": ("time", "state"), "tips": ("time", "axis"), "targets": ("time", "axis"),
                 "errors": ("time",), "actions": ("period", "joint"), "torques": ("period", "joint"),
                 "rewards": ("period",)}  # fmt: skip
        data: dict[str, Any] = {name: (axes, getattr(self, name)) for name, axes in named.items()}
        data |= {name: (("time", f"{name}_part"), values) for name, values in self.readings.items()}
        places = {"time": self.time, "axis": list(AXES), "period": self.time[1:]}
        return xarray.Dataset(data, places, attrs=self.about)


def episode_metadata(model: Model, settings: dict[str, Any] | None = None, **more: Any) -> dict[str, Any]:
    """Gives the plain data of an episode: arm, model, versions, and the hash of settings.

    Args:
        model: that was moved.
        settings: of environment and entrant, plain.
        more: name, seed, failure and so on.
    """
    text = json.dumps(settings or {}, sort_keys=True, default=_plain_value)
    return {
        "format": FORMAT, "settings": json.loads(text), "hash": hashlib.sha256(text.encode()).hexdigest()[:16],
        "arm": to_plain(model.arm), "model": to_plain(model.choice), "versions": _versions(), **more,
    }  # fmt: skip


def _plain_value(value: Any) -> Any:
    """What stands in a file for an array, and for an object of one's own."""
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else type(value).__name__


def _versions() -> dict[str, str]:
    result = {"python": platform.python_version()}
    for name in ("flexman_gym", "numpy", "numba"):
        try:
            result[name] = version(name)
        except PackageNotFoundError:
            continue
    return result


def _shift_to_period_ends(values: Array) -> Array:
    """Values (T,) of periods at their ends, (T + 1,), nan first."""
    result: Array = np.append(np.nan, values)
    return result
