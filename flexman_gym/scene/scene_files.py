"""Signals of a scene in its file: samples in the file or in CSV files beside it."""

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flexman_gym.common.checks import mapping, one_of, text
from flexman_gym.common.errors import short_path, value_error
from flexman_gym.scene.serialization import from_plain
from flexman_gym.scene.signals import ConstantTorque, SampledAngles, SampledSignal, SampledTorque, Signal, SineTorque

if TYPE_CHECKING:
    from flexman_gym.common.time_series import TimeSeries

MAX_INLINE_SAMPLES = 100  # largest number of samples of a signal in a scene file; longer signals go to CSV files
# Field of a scene -> units of a column of a CSV file with this signal.
COLUMN_UNITS = {
    "prescribed": ("rad", "rad/s^2"), "tip_force": ("N",), "base_acceleration": ("m/s^2",),
    "base_angular_acceleration": ("rad/s^2",),
}  # fmt: skip


def torque_from_plain(data: object, folder: Path) -> ConstantTorque | SineTorque | SampledTorque:
    """Return the torque for a mapping with the key "kind"; the key "csv" may replace times and values of samples."""
    if not isinstance(data, dict):
        raise value_error("torque", data, "a mapping with the key kind")
    kinds: dict[str, Any] = {kind.kind: kind for kind in (ConstantTorque, SineTorque, SampledTorque)}
    kind = kinds[one_of("torque.kind", data.get("kind"), kinds)]
    entries = {name: value for name, value in data.items() if name != "kind"}
    if kind is SampledTorque and "csv" in entries:
        given = mapping("torque", entries, ("csv", "columns", "hold"))
        name = text("torque.csv", given.pop("csv"))
        torque = SampledTorque.from_csv(folder / name, **given)
        _warn_outside("torque.csv", name, folder)
        return torque
    return from_plain(kind, "torque", entries)


def signal_from_plain(
    path: str, data: object, units: tuple[str, ...], folder: Path
) -> Signal | SampledSignal | SampledAngles | None:
    """Return the signal for a mapping with samples, with the fields of Signal, or with the keys "csv" and "column".

    Args:
        path: field of the scene file, for errors.
        data: the mapping, or None.
        units: units allowed for a column.
        folder: folder to which the path of a CSV file is relative.

    Returns:
        The signal; None for None.

    Raises:
        FileNotFoundError: if the CSV file does not exist.
    """
    if data is None:
        return None
    keys = data if isinstance(data, dict) else {}
    if "csv" in keys:
        options = dict(mapping(path, data, ("csv", "column", "hold", "deviation")))
        name = text(f"{path}.csv", options.pop("csv"))
        column = text(f"{path}.column", options.pop("column", None))
        from flexman_gym.common.time_series import read_time_series

        record = read_time_series(folder / name, [column], units).warn()
        _warn_outside(f"{path}.csv", name, folder)
        return _sampled_signal(record, column, options)
    if "angles" in keys and "rad" in units:
        return from_plain(SampledAngles, path, data)
    return from_plain(SampledSignal, path, data) if "times" in keys else from_plain(Signal, path, data)


def _warn_outside(field: str, name: str, folder: Path) -> None:
    """Warn (FutureWarning) of a CSV file outside the folder of its scene file, which may be untrusted."""
    if not (folder / name).resolve().is_relative_to(folder.resolve()):
        line = f"{field}: {short_path(name)} is outside the folder of the scene file"
        warnings.warn(f"{line}; the next release will require explicit permission", FutureWarning, stacklevel=2)


def split_samples(path: Path, data: dict[str, Any]) -> tuple[dict[str, Any], dict[Path, dict[str, Any]]]:
    """Return the mapping of a scene with CSV files in place of long signals, and the columns of each CSV file."""
    result, tables = dict(data), {}

    def move(label: str, item: dict[str, Any], columns: dict[str, Any]) -> dict[str, Any]:
        file = path.with_name(f"{path.stem}_{label}.csv")
        tables[file] = {"time (s)": item["times"], **columns}
        options = {name: value for name, value in item.items() if name not in ("times", "values", "angles")}
        return options | {"csv": file.name}

    if len(data["torque"].get("times", ())) > MAX_INLINE_SAMPLES:
        heads = [f"torque_{i} (N m)" for i in range(1, len(data["torque"]["values"][0]) + 1)]
        columns = dict(zip(heads, zip(*data["torque"]["values"], strict=True), strict=True))
        result["torque"] = move("torque", data["torque"], columns)
    for name, units in COLUMN_UNITS.items():
        for i, item in enumerate(data.get(name) or ()):
            if item is not None and len(item.get("times", ())) > MAX_INLINE_SAMPLES:
                label, is_angle = f"{name}_{i}", "angles" in item
                columns = {f"{label} ({units[0 if is_angle else -1]})": item["angles" if is_angle else "values"]}
                result[name] = list(result[name])
                result[name][i] = move(label, item, columns) | {"column": label}
    return result, tables


def _sampled_signal(record: "TimeSeries", column: str, options: dict[str, Any]) -> Any:
    """Return the signal in the column of a record: SampledAngles if the unit is rad, otherwise a SampledSignal."""
    [(unit, values)] = record.columns.values()
    kind: Any = SampledAngles if unit == "rad" else SampledSignal
    try:
        return kind(record.times, values, **options)
    except TypeError:
        option = "deviation" if kind is SampledAngles else "hold"
        raise value_error(column, sorted(options), f"only the keys csv, column and {option}") from None
