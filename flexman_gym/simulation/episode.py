"""Episode: record of an episode, or of the simulation of a scene, with the data needed to draw or repeat it."""

import hashlib
import json
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.computer import computer_info
from flexman_gym.common.files import open_arrays, reading, write_csv, write_file
from flexman_gym.common.registry import load_entry
from flexman_gym.model.model import Model, build_model
from flexman_gym.scene.scene import ModelChoice
from flexman_gym.scene.serialization import find_arm, from_plain, to_plain
from flexman_gym.simulation.trajectory import Trajectory

FORMAT = 1  # version of the file format
METADATA_KEY = "about"  # name of the metadata in a file and of their attribute
AXES = "xyz"
# array of an episode -> its axes, see `Episode.to_xarray`
ARRAY_AXES = {
    "time": ("time",), "states": ("time", "state"), "tips": ("time", "axis"), "targets": ("time", "axis"),
    "errors": ("time",), "actions": ("period", "joint"), "torques": ("period", "joint"), "rewards": ("period",),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Episode:
    """Record of T control periods of one arm, or of T + 1 output times of a scene; missing quantities are nan.

    Attributes:
        time: (T + 1,) time since the reset, s.
        states: (T + 1, 2 d) coordinates and speeds, in the order of `kernels.layout`.
        tips: (T + 1, 3) tip positions, base frame, m.
        targets: (T + 1, 3) positions of the target, base frame, m.
        errors: (T + 1,) distances between tip and target, m.
        readings: name -> (T + 1, k) latest readings of the agent's sensors.
        actions: (T, n) actions that reach the motors, as fractions of the torque limits.
        torques: (T, n) motor torques after delays and other effects, N m.
        rewards: (T,) rewards of the control periods.
        about: metadata as JSON-compatible data: name of the agent, environment, its settings and their hash, seed,
            versions, failure, arm and model, units of the readings; in an environment with limits that are recorded
            also "limits" and "violations": start and end (s) of each violation, and its largest excess.
        bases: (T + 1, 3) positions of a base that moves, world frame, m; None for a fixed base.

    Examples:
        >>> trajectory = fm.simulate(fm.catalog.paper_scene("rr"), step=0.01)
        >>> episode = fm.Episode.from_trajectory(trajectory, "paper")
        >>> episode.name, episode.tips.shape
        ('paper', (201, 3))
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
    bases: Array | None = None

    @classmethod
    def from_trajectory(cls, trajectory: Trajectory, name: str = "scene") -> Self:
        """Return a trajectory as an episode without targets, actions, torques and rewards; these arrays hold nan.

        Args:
            trajectory: the solution of a scene.
            name: name of the episode in plots.
        """
        rows, n = trajectory.joint_angles.shape
        sizes = {"time": rows, "period": rows - 1, "axis": 3, "joint": n}
        missing = ("targets", "errors", "actions", "torques", "rewards")
        failure = "" if trajectory.status == "ok" else trajectory.status
        return cls(
            trajectory.time, trajectory.states, trajectory.tip, readings=trajectory.readings,
            about=cls.metadata(trajectory.model, name=name, failure=failure),
            **{name: np.full([sizes[axis] for axis in ARRAY_AXES[name]], np.nan) for name in missing},
        )  # fmt: skip

    @staticmethod
    def metadata(model: Model, settings: dict[str, Any] | None = None, **more: Any) -> dict[str, Any]:
        """Return the metadata of an episode as JSON-compatible data: arm, model, versions, settings and their hash.

        Args:
            model: the model of the simulation.
            settings: settings of environment and agent.
            **more: further entries, such as name, seed and failure.
        """
        versions = {name: value for name, value in computer_info().items() if name not in ("processor", "scipy")}
        text = json.dumps(settings or {}, sort_keys=True, default=_plain_value)
        return {
            "format": FORMAT, "settings": json.loads(text), "hash": hashlib.sha256(text.encode()).hexdigest()[:16],
            "arm": to_plain(model.arm), "model": to_plain(model.choice), "versions": versions, **more,
        }  # fmt: skip

    @cached_property
    def model(self) -> Model:
        """Model of the simulation, built from the metadata.

        Raises:
            ValueError: for an invalid arm or model.
        """
        choice = from_plain(ModelChoice, "model", self.about["model"])
        return build_model(find_arm(self.about["arm"]), **vars(choice))

    @property
    def base_positions(self) -> Array:
        """Positions of the base in the world frame, (T + 1, 3), m; zeros for a fixed base."""
        return np.zeros((len(self.time), 3)) if self.bases is None else self.bases

    @property
    def name(self) -> str:
        """Name of the agent or of the scene; "" if missing in the metadata."""
        return str(self.about.get("name", ""))

    @property
    def period(self) -> float:
        """Time between two rows, s."""
        return float(self.time[1] - self.time[0]) if len(self.time) > 1 else 1.0

    @property
    def band(self) -> float:
        """Distance from the target within which the tip counts as settled, m; nan if missing in the metadata."""
        return float(self.about.get("band", np.nan))

    def save(self, path: str | Path) -> Path:
        """Write arrays and metadata to a file (npz, without pickles), atomically, and return its path.

        Args:
            path: the file; missing folders are created.

        Raises:
            OSError: if it cannot be written; an existing file remains unchanged.
        """
        path, text = Path(path), json.dumps(self.about).encode()
        arrays = {name: getattr(self, name) for name in ARRAY_AXES}
        arrays |= {f"readings/{name}": values for name, values in self.readings.items()}
        arrays |= {} if self.bases is None else {"bases": self.bases}
        arrays[METADATA_KEY] = np.frombuffer(text, dtype=np.uint8)
        write_file(path, lambda file: np.savez(file, allow_pickle=False, **arrays))
        return path

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a file written by `save`; no code in it is executed.

        Args:
            path: the file.

        Raises:
            FileNotFoundError: if the file does not exist.
            ValueError: for a file that is no saved episode.
        """
        with reading(path, "is not a saved episode"):
            with open_arrays(path) as data:
                metadata = json.loads(data[METADATA_KEY].tobytes())
                arrays = {name: data[name] for name in ARRAY_AXES}
                prefix = "readings/"
                readings = {name.removeprefix(prefix): data[name] for name in data.files if name.startswith(prefix)}
                bases = data["bases"] if "bases" in data.files else None
            result = cls(**arrays, readings=readings, bases=bases, about=metadata)
            result._check()
        return result

    def _check(self) -> None:
        """Check the shapes of the arrays and the format of the metadata."""
        if self.about["format"] != FORMAT or not isinstance(self.about["name"], str):
            raise ValueError("unknown format")
        rows, n = len(self.time), len(self.about["arm"]["links"])
        sizes = {"time": rows, "period": rows - 1, "axis": 3, "joint": n, "state": self.states.shape[-1]}
        arrays = {name: (getattr(self, name), tuple(sizes[axis] for axis in axes)) for name, axes in ARRAY_AXES.items()}
        arrays |= {f"readings.{name}": (each, (rows, each.shape[-1])) for name, each in self.readings.items()}
        arrays |= {} if self.bases is None else {"bases": (self.bases, (rows, 3))}
        for name, (values, shape) in arrays.items():
            if values.shape != shape or values.dtype.kind != "f" or rows < 1:
                raise ValueError(f"{name} is {values.dtype} {values.shape}")

    def columns(self) -> dict[str, Array]:
        """Return all quantities except the states as columns (T + 1,) by name and unit, such as "tip_x (m)".

        Joints are numbered from 1. Actions, torques and rewards of a control period stand in the row of its end; in the
        first row they are nan.
        """
        units, joints = self.about.get("units", {}), range(1, self.actions.shape[1] + 1)
        result = {"time (s)": self.time, "error (m)": self.errors, "reward": _shift_to_period_ends(self.rewards)}
        for name, values in (("tip", self.tips), ("target", self.targets)):
            result |= {f"{name}_{axis} (m)": values[:, i] for i, axis in enumerate(AXES)}
        if self.bases is not None:
            result |= {f"base_{axis} (m)": self.bases[:, i] for i, axis in enumerate(AXES)}
        result |= {f"action_{i}": _shift_to_period_ends(self.actions[:, i - 1]) for i in joints}
        result |= {f"torque_{i} (N m)": _shift_to_period_ends(self.torques[:, i - 1]) for i in joints}
        for name, values in self.readings.items():
            unit = f" ({units[name]})" if units.get(name, "1") != "1" else ""
            result |= {f"{name}_{i + 1}{unit}": values[:, i] for i in range(values.shape[1])}
        return result

    def to_csv(self, path: str | Path) -> None:
        """Write `columns` to a CSV file: a row of names and units, then a row for each time, with all digits.

        Args:
            path: the file.

        Raises:
            OSError: where the file cannot be written.
        """
        write_csv(path, self.columns())

    def to_pandas(self) -> Any:
        """Return `columns` as a pandas DataFrame; its `attrs` hold the metadata.

        Raises:
            ImportError: without pandas.
        """
        import pandas

        result = pandas.DataFrame(self.columns())
        result.attrs.update(self.about)
        return result

    def to_xarray(self) -> Any:
        """Return an xarray Dataset with the metadata as `attrs`.

        Coordinates: `time`, and for actions, torques and rewards `period`, the end of a control period, s.

        Raises:
            ImportError: without xarray.
        """
        import xarray

        data: dict[str, Any] = {
            name: (axes, getattr(self, name)) for name, axes in ARRAY_AXES.items() if name != "time"
        }
        data |= {name: (("time", f"{name}_part"), values) for name, values in self.readings.items()}
        data |= {} if self.bases is None else {"bases": (("time", "axis"), self.bases)}
        coordinates = {"time": self.time, "axis": list(AXES), "period": self.time[1:]}
        return xarray.Dataset(data, coordinates, attrs=self.about)

    def _repr_png_(self) -> bytes:
        """Return a picture for a notebook."""
        picture: bytes = load_entry("flexman_gym.toolbox.view.notebook:episode_picture")(self)
        return picture


def _plain_value(value: Any) -> Any:
    """Return an array as lists, and any other object as the name of its class."""
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else type(value).__name__


def _shift_to_period_ends(values: Array) -> Array:
    """Return the values (T,) of control periods after a nan, (T + 1,)."""
    result: Array = np.append(np.nan, values)
    return result
