"""Machine, measure: what fits to some runs say of the others."""

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import flexman_gym as fm
from flexman_gym.fit.fit import r_squared
from flexman_gym.fit.response import Response
from flexman_gym.model.instant import mass_matrix
from flexman_gym.model.model import Model, build_model
from flexman_gym.simulation.parameters import nominal_parameters
from studies.machine.records import DATA, LENGTHS, STAGE_1, both_stages, driven, moving

ONE = {"elements": 1, "modes": 4}
TWO = {"elements": 1, "modes": (4, 3)}
FIT, SCORE, SHEET, MUJOCO, COUPLED, CURRENT = "fit", "score", "data sheet", "MuJoCo", "both stages", "currents"
HALF = 5.0  # s, of the record of both stages


@dataclass(frozen=True)
class Row:
    """A number: in which part of the study, of which run or fit, and what."""

    part: str
    run: str
    what: str
    value: float


def stage_1(folder: Path = DATA, others: bool = True) -> tuple[list[Row], dict[str, Any]]:
    """Fits half of the moving runs of the first stage and scores the rest, then the other way round.

    Args:
        folder: of the runs.
        others: whether MuJoCo is asked as well, where it is installed.

    Returns:
        Rows, and name of a run -> times, measured and predicted deflections (rad).
    """
    runs, rows, lines = moving(folder), [], {}
    names = sorted(runs)
    for half, label in ((names[::2], "A"), (names[1::2], "B")):
        started = time.process_time()
        arm = fm.catalog.quanser_2dsfl(1)
        found = fm.fit(arm, ["link_stiffness", "link_damping"], records=[runs[name] for name in half], starts=0, **ONE)  # type: ignore[arg-type]
        rows.append(Row(FIT, label, "CPU s", time.process_time() - started))
        rows += [Row(FIT, label, name, value) for name, value in _told(found).items()]
        rest = [name for name in names if name not in half]
        for name in rest:
            record = runs[name]
            shown = found.predicted(record)[STAGE_1]
            rows.append(Row(SCORE, name, label, found.score(record)[STAGE_1]))
            sheet = _sheet(build_model(arm, **ONE), record)  # type: ignore[arg-type]
            rows.append(Row(SHEET, name, label, r_squared(np.asarray(record.outputs[STAGE_1]), sheet)))
            lines[name] = [
                np.asarray(record.times),
                np.asarray(record.outputs[STAGE_1]) / LENGTHS[0],
                shown / LENGTHS[0],
            ]
        rows += _by_mujoco(found, {name: runs[name] for name in rest}) if others else []
    return rows, lines


def _told(found: fm.Fit) -> dict[str, float]:
    """What a fit of the first stage says."""
    model = build_model(found.arm, **ONE)  # type: ignore[arg-type]
    ringing = fm.modes(model)
    frequency, ratio = float(ringing.frequencies[0]), float(ringing.damping_ratios[0])
    at_strip, at_block = _amplitudes(model)
    gain = found.gains[STAGE_1]
    return {
        "EI factor": found.values["link_stiffness"][0], "EI factor, deviation": found.deviations["link_stiffness"][0],
        "natural frequency, Hz": frequency / np.sqrt(1.0 - ratio**2), "damping ratio": ratio,
        "damping ratio, deviation": found.deviations["link_damping"][0],
        "amplitude factor, measured": at_block * gain[0], "amplitude factor, deviation": at_block * gain[1],
        "amplitude factor of the model": at_strip,
    }  # fmt: skip


def _amplitudes(model: Model) -> tuple[float, float]:
    """c in y'' + 2 z w y' + w^2 y = -c (hub angle)'' of the first vibration in the plane, for y = w / L of strip 1.

    First w at the end of the strip, then that of the block which it carries, both over the strip's length.
    """
    from scipy.linalg import eigh

    mass, columns = mass_matrix(model, np.zeros(2 * model.n_dof)), np.arange(model.n_joints, model.n_dof)
    starts = model.constants.square_start
    stiffness = model.constants.stiffness[: starts[1]].reshape(len(columns), -1)
    _, shapes = eigh(stiffness, mass[np.ix_(columns, columns)])
    caused = shapes.T @ mass[columns, 0]
    first = int(np.argmax(np.abs(caused) * np.abs(model.constants.tip_translation[:, 1] @ shapes)))
    end = model.bases[0][1] @ shapes[:, first]  # y of the node at the end of the strip
    tip = model.constants.tip_translation[:, 1] @ shapes[:, first]
    return tuple(float(abs(each * caused[first]) / LENGTHS[0]) for each in (end, tip))  # type: ignore[return-value]


def _sheet(model: Model, record: fm.Measurement) -> Any:
    """What the data sheet says of the first output of a record: w / L of the strip, by a gauge without an error."""
    nominal = {"payload_mass": np.array([nominal_parameters(model)["payload_mass"]])}
    at_strip, at_block = _amplitudes(model)
    return Response(model.arm, record, None).signals(model, nominal)[0, 0] * at_strip / at_block


def _by_mujoco(found: fm.Fit, runs: Mapping[str, fm.Measurement]) -> list[Row]:
    """Scores of MuJoCo's pieces with the fitted numbers."""
    try:
        from studies.machine import mujoco
    except ModuleNotFoundError:
        print("MuJoCo is missing, so it is left out: pip install 'flexman_gym[peers]'")
        return []
    rows = []
    for name, record in runs.items():
        started = time.process_time()
        shown = mujoco.deflection(found.arm, record) * found.gains[STAGE_1][0]
        rows.append(Row(MUJOCO, name, "R2", r_squared(np.asarray(record.outputs[STAGE_1]), shown)))
        rows.append(Row(MUJOCO, name, "CPU s", time.process_time() - started))
    return rows


def stages(path: Path) -> tuple[list[Row], list[Any]]:
    """Fits the first half of a record of both stages, coupled, and scores the second; then the same from currents.

    Returns:
        Rows, and times, measured and predicted deflections.
    """
    record, arm = both_stages(path), fm.catalog.quanser_2dsfl()
    found = fm.fit(arm, ["link_stiffness", "link_damping"], records=[record.part(0.0, HALF)], **TWO)  # type: ignore[arg-type]
    told = [np.asarray(record.times), dict(record.outputs), found.predicted(record)]
    return [*_coupled(found, record, COUPLED), *currents(found, path)], told


def _coupled(found: fm.Fit, record: fm.Measurement, part: str) -> Iterator[Row]:
    """Numbers of a fit of both stages, and its scores on the second half."""
    for name in found.values:
        for i, (value, deviation) in enumerate(zip(found.values[name], found.deviations[name], strict=True)):
            yield Row(part, f"{name}[{i}]", "value", float(value))
            yield Row(part, f"{name}[{i}]", "deviation", float(deviation))
    for name, (gain, deviation) in found.gains.items():
        yield Row(part, f"gain of {name}", "value", gain)
        yield Row(part, f"gain of {name}", "deviation", deviation)
    late, shown = np.asarray(record.times) >= HALF, found.predicted(record)
    for name, values in shown.items():
        yield Row(part, name, "R2", r_squared(np.asarray(record.outputs[name])[late], values[late]))


def currents(found: fm.Fit, path: Path) -> Iterator[Row]:
    """Currents in, angles out: friction fitted on the first half, with what the deflections told of the links."""
    record = driven(path)
    joints = [
        replace(joint, coulomb_friction=0.5 * size) for joint, size in zip(found.arm.joints, (2.0, 0.2), strict=True)
    ]
    arm = replace(found.arm, joints=joints)
    free = ["viscous_friction", "coulomb_friction"]
    result = fm.fit(arm, free, records=[record.part(0.0, HALF)], starts=0, check=False, **TWO)  # type: ignore[arg-type]
    yield from _coupled(result, record, CURRENT)
