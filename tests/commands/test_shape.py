"""Shape: the command prints what was found, for environments, arms and files, and writes shaped trajectories."""

import csv

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.__main__ import main
from flexman_gym.common.files import read_data, write_csv, write_data
from flexman_gym.common.time_series import read_time_series
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.toolbox.controllers.excited_modes import excited_modes
from flexman_gym.toolbox.controllers.input_shaping.joint_trajectory import read_trajectory
from flexman_gym.toolbox.controllers.references.trajectories import TIMINGS

from oracles.files import REFERENCE

pytestmark = pytest.mark.filterwarnings("ignore:Link.second_moment_y:UserWarning")


def said(capsys, *given):
    """The lines that the command prints."""
    assert main(["shape", *given]) == 0
    return capsys.readouterr().out.splitlines()


def test_of_an_environment_it_tells_goals_payloads_modes_and_shapers(tmp_path, capsys):
    out = tmp_path / "modes.csv"
    lines = said(capsys, "FlexPlanar-v0/payload", "--postures", "2", "--csv", str(out))
    assert lines[0] == "FlexPlanar-v0/payload: 2 postures, payloads of 0, 0.1, 0.2 kg"
    assert lines[-1].startswith("recommendation: ")
    shapers = [line.split(",")[0] for line in lines if line.split(",")[0] in ("zv", "mzv", "zvd", "ei", "two-hump-ei")]
    assert shapers == ["zv", "mzv", "zvd", "ei", "two-hump-ei"] * 2
    with out.open() as file:
        rows = list(csv.DictReader(file))
    first = [row for row in rows if row["motors"] == "held" and row["mode"] == "1"]
    assert len(first) == 6 and len({row["motor_angle_1"] for row in first}) == 2
    model = resolve_fidelity(Configuration.from_keywords({"name": "FlexPlanar-v0"})).model  # whose payload is 0.1 kg
    for row in (row for row in first if row["payload"] == "0.1"):
        posture = [float(row["motor_angle_1"]), float(row["motor_angle_2"])]
        assert float(row["frequency"]) == pytest.approx(excited_modes(model, posture)[0, 0], rel=1e-4)
    frequencies = np.array([float(row["frequency"]) for row in first])
    line = next(line for line in lines if line.startswith("1, motors held"))
    assert [float(each) for each in line.split()[3:6]] == pytest.approx(
        [frequencies.min(), np.median(frequencies), frequencies.max()], rel=1e-3
    )
    left = np.array([float(row["zvd, 1"]) for row in first])
    line = next(line for line in lines if line.startswith("zvd, 1 "))
    assert f"{np.median(left):.1f} / {left.max():.1f}" in line
    assert all(row["zv, 1"] == "" for row in rows if row["motors"] == "free")


@pytest.mark.slow
def test_an_arm_of_the_catalog_and_a_scene_of_it_say_the_same(capsys):
    """Of one joint without gravity all postures ring alike, so that what it takes is two modes and the least delay."""
    scene = str(REFERENCE / "paper_fr.json")
    known, of_file = (said(capsys, name, "--payload", "0", "2", "--postures", "1") for name in ("paper_rrr", scene))
    assert known[0].endswith("1 postures, payloads of 0, 1, 2 kg") and known[1:] == of_file[1:]
    assert said(capsys, "one_link")[-1].startswith(
        "recommendation: zv, 1 + 2, designed for the median case. In the worst case it leaves 0.0"
    )


def test_none_is_recommended_with_the_mode_that_is_to_blame(capsys):
    line = said(capsys, "one_joint", "--payload", "0", "1", "--postures", "1")[-1]
    assert line.startswith("recommendation: none. The best shaper, ") and " there mode 1 is at " in line


def test_what_does_not_bend_needs_no_shaper(tmp_path, capsys):
    arm = fm.catalog.planar_2r(rotor_inertia=0.1)
    scene = fm.Scene(
        arm, fm.ModelChoice(False, 1), fm.ConstantTorque([0.0, 0.0]), fm.Initial([0.0] * 2, [0.0] * 2), 1, 1
    )
    scene.save(tmp_path / "scene.json")
    file = tmp_path / "rigid.yaml"
    file.write_text("id: FlexPlanar-v0\narm: scene.json\nmodes: 0\ntorque_limit: 5.0\n")
    assert said(capsys, str(file))[-1] == "recommendation: none, as the motors excite no vibration"


@pytest.mark.parametrize(
    ("given", "line"),
    [
        (["nowhere.json"], "nowhere.json: there is no such file"),
        (["FlexPlanar-v9"], "environment: FlexPlanar-v9 does not exist; give the path of a file, or one of "),
        (["FlexOne-v0", "--postures", "0"], "--postures: 0 is not allowed; give a whole number from 1 to 10000"),
        (["one_joint", "--postures", "1000000000"], "give a whole number from 1 to 10000"),
        (["one_joint", "--payload", "-1", "1"], "payload_mass: -1.0 is not allowed; give a finite number >= 0 (kg)"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(given, line, capsys):
    try:
        code = main(["shape", *given])
    except SystemExit as stop:
        code = stop.code
    assert code == 2 and line in capsys.readouterr().err.splitlines()[-1]


def test_a_trajectory_is_shaped_for_a_record_and_for_an_arm(tmp_path, capsys):
    """The same arm, once by its ringing and once by its model, gives the same mode and a shaped file with a picture."""
    frequency, ratio, _ = excited_modes(fm.build_model(fm.catalog.one_joint(), 2), [0.5])[0]
    times, damped = 0.01 * np.arange(1000), frequency * np.sqrt(1.0 - ratio**2)
    vibration = np.exp(-2.0 * np.pi * frequency * ratio * times) * np.cos(2.0 * np.pi * damped * times)
    noisy = vibration + 0.01 * np.random.default_rng(0).standard_normal(len(times))
    write_csv(tmp_path / "ringing.csv", {"time (s)": times, "strain (um/m)": noisy})
    moved = TIMINGS["quintic"].at(np.linspace(0.0, 1.0, 201))[0]
    move, out, picture = (str(tmp_path / name) for name in ("move.csv", "out.csv", "picture.png"))
    write_csv(move, {"time (s)": 0.01 * np.arange(201), "joint (rad)": 0.5 * moved})
    modes = []
    for subject in (str(tmp_path / "ringing.csv"), "one_joint"):
        lines = said(capsys, subject, move, "--shaper", "zvd", "--out", out, "--picture", picture)
        modes.append([float(lines[0].split()[1]), *[float(line.split()[4]) for line in lines if "residual at" in line]])
        shaped = read_time_series(out).columns["joint"][1]
        assert len(shaped) > 201 and shaped[-1] == pytest.approx(0.5)
    assert (
        modes[0][0] == pytest.approx(modes[1][0], rel=1e-3) and max(each for mode in modes for each in mode[1:]) < 5.0
    )
    assert said(capsys, str(tmp_path / "ringing.csv"))[0].startswith("mode: ")


def ring(path, heads, *more):
    """Write a record of a vibration of 5.2 Hz with a damping ratio of 0.02, and other columns."""
    times, rate = 0.005 * np.arange(600), 2.0 * np.pi * 5.2
    values = np.exp(-0.02 * rate * times) * np.cos(rate * times)
    rows = zip(times, values, *more, strict=True)
    path.write_text("\n".join([heads, *(",".join(map(repr, map(float, row))) for row in rows)]))
    return str(path)


def test_a_record_without_units_is_read_and_told(tmp_path, capsys):
    path = ring(tmp_path / "ring.csv", "#time,accel_x")
    [line] = said(capsys, path)
    assert float(line.split()[1]) == pytest.approx(5.2, rel=1e-3)
    assert main(["shape", path]) == 0
    assert capsys.readouterr().err == "ring.csv: read as time in s, accel_x without a unit\n"


def test_set_points_are_no_readings_unless_chosen(tmp_path, capsys):
    times = 0.005 * np.arange(600)
    path = ring(tmp_path / "ring.csv", "time (s),q,q_cmd", np.exp(-1.5 * times) * np.cos(60.0 * times))
    for given, frequency in (([], 5.2), (["--column", "q"], 5.2), (["--column", "q_cmd"], 60.0 / (2.0 * np.pi))):
        assert float(said(capsys, path, *given)[0].split()[1]) == pytest.approx(frequency, rel=1e-3)
    main(["shape", path])
    assert "ring.csv: q_cmd not read: command, set point or temperature by name" in capsys.readouterr().err
    assert main(["shape", path, "--column", "w"]) == 2
    assert capsys.readouterr().err == "--column: 'w' is not allowed; give one of q, q_cmd\n"
    assert main(["shape", "one_link", "--column", "w"]) == 2
    assert capsys.readouterr().err == "--column: 'w' is not allowed; give none without a CSV file\n"


def plan(path, count=20):
    """Write a DisplayTrajectory of a quintic in steps of 0.1 s, the last of which is shorter."""
    times = np.append(0.1 * np.arange(count), 0.1 * count - 0.0427)
    part = np.polynomial.Polynomial([0.0, 1.0 / times[-1]])
    quintic = 10.0 * part**3 - 15.0 * part**4 + 6.0 * part**5
    names = ("positions", "velocities", "accelerations")
    points = [
        {name: [float(quintic.deriv(k)(time) if k else quintic(time))] for k, name in enumerate(names)}
        | {"effort": [], "time_from_start": {"sec": int(time), "nanosec": round(1e9 * (time % 1.0))}}
        for time in times.tolist()
    ]
    write_data(path, {"trajectory": [{"joint_trajectory": {"joint_names": ["a"], "points": points}}]})
    return str(path)


def vibration(path):
    """The vibration of 5.2 Hz that the polynomials between the points of a file excite."""
    points, _ = read_trajectory("plan", read_data(path))
    times, rate = np.linspace(points.times[0], points.times[-1], 40001), 2.0 * np.pi * 5.2
    rate *= (-0.02 + 1j * np.sqrt(1.0 - 0.02**2)) / np.sqrt(1.0 - 0.02**2)
    accelerations = points.curve((2,), times)[0, :, 0]
    return abs(np.trapezoid(accelerations * np.exp(rate * (times[-1] - times)), times))


@pytest.mark.parametrize("given", [[], ["--rate", "100"]])
def test_a_plan_with_a_shorter_last_step_is_shaped_at_its_rate_or_the_given_one(given, tmp_path, capsys):
    """At 10 samples per s too, below two per cycle: the shaper acts on the polynomials between the points."""
    record, out = ring(tmp_path / "ring.csv", "time (s),acc (m/s^2)"), tmp_path / "out.yaml"
    assert main(["shape", record, plan(tmp_path / "plan.yaml"), "--out", str(out), *given]) == 0
    assert "plan.yaml: 21 points in steps of 57.3 ms to 100 ms are sampled at steps of" in capsys.readouterr().err
    points, orders = read_trajectory("plan", read_data(out))
    assert orders == (0, 1, 2) and np.diff(points.times) == pytest.approx(0.01 if given else 0.1)
    assert points.values[0, -1] == pytest.approx([1.0]) and not points.values[1:, -1].any()
    assert vibration(out) < 0.01 * vibration(tmp_path / "plan.yaml")


def test_time_scaling_needs_two_samples_per_cycle(tmp_path, capsys):
    record = ring(tmp_path / "ring.csv", "time (s),acc (m/s^2)")
    assert main(["shape", record, plan(tmp_path / "plan.yaml"), "--shaper", "scaling"]) == 2
    assert capsys.readouterr().err.splitlines()[-1] == (
        "motion: '10 samples per s for a mode at 5.2 Hz' is not allowed; give a motion with more than 10.4 samples "
        "per s (--rate)"
    )
