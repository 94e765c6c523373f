"""Shape: the command prints what was found, for environments, arms and files, and writes shaped trajectories."""

import csv

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.__main__ import main
from flexman_gym.common.time_series import read_time_series, write_csv
from flexman_gym.control.input_shaping.shapers import excited_modes
from flexman_gym.control.references.trajectories import TIMING_LAWS
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity

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
    frequency, ratio, _ = excited_modes(fm.build_model(fm.catalog.one_link(), 2), [0.5])[0]
    times, damped = 0.01 * np.arange(1000), frequency * np.sqrt(1.0 - ratio**2)
    vibration = np.exp(-2.0 * np.pi * frequency * ratio * times) * np.cos(2.0 * np.pi * damped * times)
    noisy = vibration + 0.01 * np.random.default_rng(0).standard_normal(len(times))
    write_csv(tmp_path / "ringing.csv", {"time (s)": times, "strain (um/m)": noisy})
    moved = TIMING_LAWS["minimum-jerk"].at(np.linspace(0.0, 1.0, 201))[0]
    move, out, picture = (str(tmp_path / name) for name in ("move.csv", "out.csv", "picture.png"))
    write_csv(move, {"time (s)": 0.01 * np.arange(201), "joint (rad)": 0.5 * moved})
    modes = []
    for subject in (str(tmp_path / "ringing.csv"), "one_link"):
        lines = said(capsys, subject, move, "--shaper", "zvd", "--out", out, "--picture", picture)
        modes.append([float(lines[0].split()[1]), *[float(line.split()[4]) for line in lines if "residual at" in line]])
        shaped = read_time_series(out).columns["joint"][1]
        assert len(shaped) > 201 and shaped[-1] == pytest.approx(0.5)
    assert (
        modes[0][0] == pytest.approx(modes[1][0], rel=1e-3) and max(each for mode in modes for each in mode[1:]) < 5.0
    )
    assert said(capsys, str(tmp_path / "ringing.csv"))[0].startswith("mode: ")


def test_the_old_name_is_deprecated(capsys):
    with pytest.warns(DeprecationWarning, match="flexman resonance is flexman shape now"):
        assert main(["resonance", "nowhere.json"]) == 2
    assert "nowhere.json: there is no such file" in capsys.readouterr().err
