"""Identification of a real arm: records, fits and their scores, coverage on simulated arms."""

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import flexman_gym as fm
from flexman_gym.model.dynamics import mass_matrix
from flexman_gym.model.model import Model, build_model
from flexman_gym.simulation.physical_parameters import nominal_parameters
from flexman_gym.toolbox.identification.least_squares import FreeParameters
from flexman_gym.toolbox.identification.measurement import Filter, Measurement, SimulatedResponse

DATA = Path(__file__).parent / "data"
LOGGED = Filter.low_pass(2.0, 0.9)  # filter of the logged deflections; hub angles are unfiltered
RESOLUTION = (1.534e-5, 3.068e-5)  # rad; encoder resolution of the joints
ROUNDING = {f"motor_angle_{i + 1}": each / 12.0**0.5 for i, each in enumerate(RESOLUTION)}
LENGTHS = (0.202, 0.20185)  # m; lengths of the strips: a deflection is logged as the angle w(L) / L
MOVING = 1e-3  # rad; smaller deflections are dominated by the noise of the gauge
FEWER = 5  # decimation factor of the current-driven record, since a simulation stops at every sample
STAGE_1, STAGE_2 = "link_deflection_1_y", "link_deflection_2_y"


def _columns(path: Path) -> dict[str, np.ndarray]:
    """Return the columns of a CSV file by name."""
    with path.open(encoding="utf-8") as file:
        names = file.readline().strip().split(",")
    return dict(zip(names, np.loadtxt(path, delimiter=",", skiprows=1).T, strict=True))


def _stage_1_record(path: Path) -> Measurement:
    """Return a record of the first stage: hub angle as input, tip deflection as output."""
    data = _columns(path)
    return Measurement(
        data["time_s"],
        {"motor_angle_1": data["hub_angle_rad"]},
        {STAGE_1: LENGTHS[0] * data["tip_deflection_rad"]},
        {STAGE_1: LOGGED},
        gains=(STAGE_1,),
        deviations={"motor_angle_1": ROUNDING["motor_angle_1"]},
    )


def moving(folder: Path) -> dict[str, Measurement]:
    """Return the runs of the first stage in a folder by name, without those whose deflection is below the noise."""
    runs = {path.stem: _stage_1_record(path) for path in sorted(folder.glob("*deg*.csv"))}
    return {name: run for name, run in runs.items() if np.ptp(run.outputs[STAGE_1]) > MOVING * LENGTHS[0]}


def both_stages(path: Path) -> Measurement:
    """Return a record of both stages: hub angles as inputs, tip deflections as outputs."""
    data = _columns(path)
    return Measurement(
        data["time_s"] - data["time_s"][0],
        {f"motor_angle_{i}": data[f"hub_angle_{i}_rad"] for i in (1, 2)},
        {f"link_deflection_{i}_y": LENGTHS[i - 1] * data[f"tip_deflection_{i}_rad"] for i in (1, 2)},
        {STAGE_1: LOGGED, STAGE_2: LOGGED},
        gains=(STAGE_1, STAGE_2),
        offsets=(STAGE_1, STAGE_2),
        deviations=ROUNDING,
        settling=1.0,
    )


def driven(path: Path, fewer: int = FEWER) -> Measurement:
    """Return a record of both stages with currents as inputs and hub angles among the outputs, by default at 100 Hz."""
    data, record = _columns(path), both_stages(path)
    angles = {f"motor_angle_{i}": data[f"hub_angle_{i}_rad"][::fewer] for i in (1, 2)}
    return replace(
        record,
        times=np.asarray(record.times)[::fewer],
        inputs={f"current_{i}": data[f"current_{i}_A"][::fewer] for i in (1, 2)},
        outputs=angles | {name: values[::fewer] for name, values in record.outputs.items()},
        deviations={},
    )


ONE = {"elements": 1, "modes": 4}
FACTORS = ["link_stiffness_factor", "link_damping"]  # fitted parameters
TWO = {"elements": 1, "modes": (4, 3)}
FIT, SCORE, SHEET, MUJOCO, COUPLED, CURRENT = "fit", "score", "data sheet", "MuJoCo", "both stages", "currents"
HALF = 5.0  # s; half of the record of both stages


@dataclass(frozen=True)
class FitRow:
    """Result of the study: part of the study, run or fit, quantity, value."""

    part: str
    run: str
    what: str
    value: float


def _r_squared(measured: np.ndarray, computed: np.ndarray) -> float:
    """Return the coefficient of determination."""
    return 1.0 - float(np.sum((measured - computed) ** 2) / np.sum((measured - measured.mean()) ** 2))


def stage_1(folder: Path = DATA, others: bool = True) -> tuple[list[FitRow], dict[str, Any]]:
    """Fit half of the runs of the first stage and predict the other half, then vice versa.

    Args:
        folder: folder of the runs.
        others: simulate with MuJoCo as well, if it is installed.

    Returns:
        Rows, and run name -> times, measured and predicted deflections (rad).
    """
    runs, rows, lines = moving(folder), [], {}
    names = sorted(runs)
    for half, label in ((names[::2], "A"), (names[1::2], "B")):
        started = time.process_time()
        arm = fm.catalog.quanser_2dsfl(1)
        records = [runs[name] for name in half]
        found = fm.fit(arm, FACTORS, records=records, starts=0, **ONE)  # type: ignore[arg-type]
        rows.append(FitRow(FIT, label, "CPU s", time.process_time() - started))
        rows += [FitRow(FIT, label, name, value) for name, value in _fit_results(found).items()]
        rest = [name for name in names if name not in half]
        for name in rest:
            record = runs[name]
            shown = found.predicted(record)[STAGE_1]
            rows.append(FitRow(SCORE, name, label, found.score(record)[STAGE_1]))
            sheet = _sheet(build_model(arm, **ONE), record)  # type: ignore[arg-type]
            rows.append(FitRow(SHEET, name, label, _r_squared(np.asarray(record.outputs[STAGE_1]), sheet)))
            lines[name] = [
                np.asarray(record.times),
                np.asarray(record.outputs[STAGE_1]) / LENGTHS[0],
                shown / LENGTHS[0],
            ]
        rows += _by_mujoco(found, {name: runs[name] for name in rest}) if others else []
    return rows, lines


def _fit_results(found: fm.Fit) -> dict[str, float]:
    """Return the results of a fit of the first stage by name."""
    model = build_model(found.arm, **ONE)  # type: ignore[arg-type]
    ringing = fm.modes(model)
    frequency, ratio = float(ringing.frequencies[0]), float(ringing.damping_ratios[0])
    at_strip, at_block = _amplitudes(model)
    gain = found.gains[STAGE_1]
    return {
        "EI factor": found.values["link_stiffness_factor"][0], "EI factor, deviation":
        found.deviations["link_stiffness_factor"][0],
        "natural frequency, Hz": frequency / np.sqrt(1.0 - ratio**2), "damping ratio": ratio,
        "damping ratio, deviation": found.deviations["link_damping"][0],
        "amplitude factor, measured": at_block * gain[0], "amplitude factor, deviation": at_block * gain[1],
        "amplitude factor of the model": at_strip,
    }  # fmt: skip


def _amplitudes(model: Model) -> tuple[float, float]:
    """Return the coefficient c of the first in-plane vibration of the strip, at its end and at the end of its block.

    The vibration satisfies y'' + 2 z w y' + w^2 y = -c (hub angle)'', with y = w / L and the length L of the strip.
    """
    from scipy.linalg import eigh

    mass, columns = mass_matrix(model, np.zeros(2 * model.n_dof)), np.arange(model.n_joints, model.n_dof)
    starts = model.constants.square_start
    stiffness = model.constants.stiffness[: starts[1]].reshape(len(columns), -1)
    _, shapes = eigh(stiffness, mass[np.ix_(columns, columns)])
    caused = shapes.T @ mass[columns, 0]
    first = int(np.argmax(np.abs(caused) * np.abs(model.constants.tip_translation[:, 1] @ shapes)))
    end = model.bases[0][1] @ shapes[:, first]  # y displacement of the node at the end of the strip
    tip = model.constants.tip_translation[:, 1] @ shapes[:, first]
    return tuple(float(abs(each * caused[first]) / LENGTHS[0]) for each in (end, tip))  # type: ignore[return-value]


def _sheet(model: Model, record: fm.Measurement) -> Any:
    """Return the first output of a record with the calibration of the data sheet (w / L of the strip, ideal gauge)."""
    nominal = {"payload_mass": np.array([nominal_parameters(model)["payload_mass"]])}
    at_strip, at_block = _amplitudes(model)
    return SimulatedResponse(model.arm, record, None).signals(model, nominal)[0, 0] * at_strip / at_block


def _by_mujoco(found: fm.Fit, runs: Mapping[str, fm.Measurement]) -> list[FitRow]:
    """Return the scores of MuJoCo's rigid pieces with the fitted parameters."""
    try:
        from studies.machine import mujoco
    except ModuleNotFoundError:
        print("MuJoCo is missing, so it is left out: pip install 'flexman_gym[peers]'")
        return []
    rows = []
    for name, record in runs.items():
        started = time.process_time()
        shown = mujoco.deflection(found.arm, record) * found.gains[STAGE_1][0]
        rows.append(FitRow(MUJOCO, name, "R2", _r_squared(np.asarray(record.outputs[STAGE_1]), shown)))
        rows.append(FitRow(MUJOCO, name, "CPU s", time.process_time() - started))
    return rows


def stages(path: Path) -> list[FitRow]:
    """Fit the first half of a record of both stages and predict the second half, from hub angles and from currents."""
    record, arm = both_stages(path), fm.catalog.quanser_2dsfl()
    found = fm.fit(arm, FACTORS, records=[record.part(0.0, HALF)], **TWO)  # type: ignore[arg-type]
    return [*_coupled(found, record, COUPLED), *_currents(found, path)]


def _coupled(found: fm.Fit, record: fm.Measurement, part: str) -> Iterator[FitRow]:
    """Yield the parameters of a fit of both stages and its scores on the second half of the record."""
    for name in found.values:
        for i, (value, deviation) in enumerate(zip(found.values[name], found.deviations[name], strict=True)):
            yield FitRow(part, f"{name}[{i}]", "value", float(value))
            yield FitRow(part, f"{name}[{i}]", "deviation", float(deviation))
    for name, (gain, deviation) in found.gains.items():
        yield FitRow(part, f"gain of {name}", "value", gain)
        yield FitRow(part, f"gain of {name}", "deviation", deviation)
    late, shown = np.asarray(record.times) >= HALF, found.predicted(record)
    for name, values in shown.items():
        yield FitRow(part, name, "R2", _r_squared(np.asarray(record.outputs[name])[late], values[late]))


def _currents(found: fm.Fit, path: Path) -> Iterator[FitRow]:
    """Fit the friction with currents as inputs to the first half, with the fitted links; yield results."""
    record = driven(path)
    yield from _coupled(friction_fit(found, record), record, CURRENT)


def friction_fit(found: fm.Fit, record: fm.Measurement) -> fm.Fit:
    """Return the fit of the friction of both joints to the first half of a record with currents as inputs."""
    joints = [
        replace(joint, coulomb_friction=0.5 * size) for joint, size in zip(found.arm.joints, (2.0, 0.2), strict=True)
    ]
    arm = replace(found.arm, joints=joints)
    free = ["viscous_friction", "coulomb_friction"]
    return fm.fit(arm, free, records=[record.part(0.0, HALF)], starts=0, check=False, **TWO)  # type: ignore[arg-type]


PERIOD, SAMPLES, NOISE, FINER = 0.005, 241, 0.005, 4
CHOICE: dict[str, Any] = {"elements": 1, "modes": 3}
FREE = ("joint_stiffness", "joint_damping", "link_stiffness_factor", "link_damping", "payload_mass")
FAR = 0.3  # largest offset of the initial guesses, in the logarithm
AXES = ((0.0, 0.0, 1.0), (0.0, -1.0, 0.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0))


def _random_arm(rng: np.random.Generator) -> fm.Arm:
    """Return a random arm of one to three strips on elastic joints, planar or spatial."""
    count, spatial = int(rng.integers(1, 4)), bool(rng.integers(2))
    links, joints = [], []
    for i in range(count):
        thin = str(rng.choice(["y", "z"])) if spatial else "y"
        links.append(fm.Link.strip(rng.uniform(0.3, 0.6), rng.uniform(0.03, 0.05), rng.uniform(0.002, 0.005), thin))
        axis = AXES[rng.integers(3)] if spatial and i else AXES[0]
        size = 0.5 ** (2 * i)
        joints.append(fm.Joint(axis, 0.05 * size, rng.uniform(20.0, 80.0) * size, rng.uniform(0.02, 0.1) * size))
    ratios = rng.uniform(0.005, 0.03, count).tolist()
    return fm.Arm(links, joints, fm.Payload(rng.uniform(0.05, 0.2)), modal_damping_ratio=ratios)


def _simulated_record(arm: fm.Arm, rng: np.random.Generator) -> fm.Measurement:
    """Return the simulated response to piecewise constant torques, at a quarter of the step of the fit."""
    count, times = arm.n_joints, PERIOD * np.arange(SAMPLES)
    inputs = {}
    for i in range(count):
        levels = np.repeat(rng.uniform(-1.0, 1.0, -(-SAMPLES // 20)), 20)[:SAMPLES]
        inputs[f"torque_{i + 1}"] = 0.5 ** (2 * i) * levels
    names = [
        f"{kind}_{i + 1}{end}"
        for i in range(count)
        for kind, end in (("motor_angle", ""), ("root_strain", "_y"), ("root_strain", "_z"))
    ]
    record = fm.Measurement(times, inputs, {name: times for name in names}, start=np.zeros(count))
    response = SimulatedResponse(arm, record, PERIOD / FINER)
    signals = response.signals(build_model(arm, **CHOICE), {"payload_mass": np.array([arm.payload.mass])})[0]  # type: ignore[union-attr]
    kept = {name: values for name, values in zip(names, signals, strict=True) if np.std(values) > 1e-9}
    return replace(record, outputs=kept)


def draws(seed: int, count: int) -> list[tuple[str, float, bool]]:
    """Fit an arm to noisy records; return parameter names, errors in standard deviations, and whether determined."""
    rng = np.random.default_rng(seed)
    arm = _random_arm(rng)
    record, free = _simulated_record(arm, rng), FreeParameters(arm, FREE)
    result = []
    for _ in range(count):
        start = free.build_arm(free.start * np.exp(rng.uniform(-FAR, FAR, len(free.start))))
        noisy = {
            name: values + NOISE * np.std(values) * rng.standard_normal(SAMPLES)
            for name, values in record.outputs.items()
        }
        found = fm.fit(start, FREE, records=[replace(record, outputs=noisy)], **CHOICE)
        scale = np.where([number.name == "link_stiffness_factor" for number in free.numbers], 1.0, free.start)
        moduli = [
            a.sections[0].youngs_modulus / b.sections[0].youngs_modulus
            for a, b in zip(arm.links, start.links, strict=True)
        ]
        for number, true in zip(free.numbers, scale, strict=True):
            place = number.part or 0
            value, deviation = (np.ravel(each[number.name])[place] for each in (found.values, found.deviations))
            right = moduli[place] if number.name == "link_stiffness_factor" else true
            result.append((str(number), float((value - right) / deviation), str(number) not in found.undetermined))
    return result


def coverage(arms: int, count: int, first: int = 0) -> tuple[float, int, int]:
    """Return the share of determined estimates within two standard deviations, and the numbers determined and not."""
    found = [each for seed in range(first, first + arms) for each in draws(seed, count)]
    inside = [abs(error) <= 2.0 for _, error, determined in found if determined]
    return float(np.mean(inside)), len(inside), len(found) - len(inside)
