"""Machine, records: the files of the Czech Technical University as measurements of the catalog's arm."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from flexman_gym.fit import Filter, Measurement

DATA = Path(__file__).parent / "data"
LOGGED = Filter.low_pass(2.0, 0.9)  # which the logged deflections passed, and the hub angles did not
RESOLUTION = (1.534e-5, 3.068e-5)  # of the encoders at the joints, rad
ROUNDING = {f"motor_angle_{i + 1}": each / 12.0**0.5 for i, each in enumerate(RESOLUTION)}
LENGTHS = (0.202, 0.20185)  # of the strips, m: a deflection is an angle w(L) / L
MOVING = 1e-3  # rad: a deflection that moves less shows the noise of the gauge
FEWER = 5  # samples for one
STAGE_1, STAGE_2 = "link_deflection_1_y", "link_deflection_2_y"


def columns(path: Path) -> dict[str, np.ndarray]:
    """Columns of a file by name."""
    with path.open(encoding="utf-8") as file:
        names = file.readline().strip().split(",")
    return dict(zip(names, np.loadtxt(path, delimiter=",", skiprows=1).T, strict=True))


def stage_1(path: Path) -> Measurement:
    """A run of the first stage: hub angle in, tip deflection out."""
    data = columns(path)
    return Measurement(
        data["time_s"],
        {"motor_angle_1": data["hub_angle_rad"]},
        {STAGE_1: LENGTHS[0] * data["tip_deflection_rad"]},
        {STAGE_1: LOGGED},
        gains=(STAGE_1,),
        deviations={"motor_angle_1": ROUNDING["motor_angle_1"]},
    )


def moving(folder: Path) -> dict[str, Measurement]:
    """The runs of the first stage in a folder whose deflection moves, by name."""
    runs = {path.stem: stage_1(path) for path in sorted(folder.glob("*deg*.csv"))}
    return {name: run for name, run in runs.items() if np.ptp(run.outputs[STAGE_1]) > MOVING * LENGTHS[0]}


def both_stages(path: Path) -> Measurement:
    """A run of both stages: hub angles in, tip deflections out."""
    data = columns(path)
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


def driven(path: Path) -> Measurement:
    """The same with currents in, and hub angles out as well, at 100 Hz: a simulation stops at every sample."""
    data, record = columns(path), both_stages(path)
    angles = {f"motor_angle_{i}": data[f"hub_angle_{i}_rad"][::FEWER] for i in (1, 2)}
    return replace(
        record,
        times=np.asarray(record.times)[::FEWER],
        inputs={f"current_{i}": data[f"current_{i}_A"][::FEWER] for i in (1, 2)},
        outputs=angles | {name: values[::FEWER] for name, values in record.outputs.items()},
        deviations={},
    )
