"""Samples: records round-trip with their units, signals are what their hold says, and what does not fit is refused."""

import json
import warnings
from dataclasses import replace

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.common.files import write_csv
from flexman_gym.common.time_series import read_time_series

from oracles.assertions import refusal

TIMES = np.linspace(0.0, 0.4, 5)
ARM = fm.catalog.planar_2r()
START = fm.Initial([0.1, -0.2], [0.0, 0.0])
SCENE = fm.Scene(ARM, fm.ModelChoice(True, 1, 2), fm.ConstantTorque([0.0, 0.0]), START, 0.4, 0.1)


def test_a_record_is_read_in_si_units_whatever_its_head_says(tmp_path):
    path = tmp_path / "bench.csv"
    path.write_text("hub [deg], time (ms),drive (mN*m),tip (g)\n90,0,1500,1\n180,2.5,-500,-2\n", encoding="utf-8")
    record = read_time_series(path)
    assert record.times.tolist() == [0.0, 0.0025]
    assert {name: unit for name, (unit, _) in record.columns.items()} == {"hub": "rad", "drive": "N m", "tip": "m/s^2"}
    assert record.values(("rad",))[:, 0] == pytest.approx([np.pi / 2.0, np.pi])
    assert record.values(("N m",), ["drive"]).tolist() == [[1.5], [-0.5]]
    assert record.values(("m/s^2",))[:, 0] == pytest.approx([9.80665, -19.6133])


@pytest.mark.parametrize("hold", ["zero", "linear"])
def test_a_sampled_torque_comes_back_from_its_file_to_the_bit(tmp_path, hold):
    torque = fm.SampledTorque(TIMES / 3.0, np.random.default_rng(0).normal(size=(5, 2)), hold)
    torque.to_csv(tmp_path / "torque.csv")
    assert (tmp_path / "torque.csv").read_text().splitlines()[0] == "time (s),torque_1 (N m),torque_2 (N m)"
    assert fm.SampledTorque.from_csv(tmp_path / "torque.csv", hold=hold) == torque
    turned = fm.SampledTorque.from_csv(tmp_path / "torque.csv", ["torque_2", "torque_1"], hold)
    assert np.array_equal(turned.values, np.array(torque.values)[:, ::-1])


def test_between_samples_a_signal_is_what_its_hold_says():
    times, values = [-0.5, 0.0, 0.1, 0.3], [9.0, 1.0, 3.0, -1.0]
    held, drawn = (fm.SampledTorque(times, np.array([values, values]).T, hold) for hold in ("zero", "linear"))
    moments = [0.0, 0.05, 0.1, 0.2, 0.3]
    assert [held.at(t)[0] for t in moments] == [1.0, 1.0, 3.0, 3.0, -1.0]
    assert [drawn.at(t)[1] for t in moments] == pytest.approx([1.0, 2.0, 3.0, 1.0, -1.0])
    assert held.at(0.49)[0] == -1.0, "the last sample lasts as long as the one before"
    for torque, late in ((held, 0.51), (drawn, 0.31)):
        assert refusal(torque.at, late).startswith(f"time: {late} is not allowed; give one from -0.5 to ")


@pytest.mark.parametrize("samples", [5, 401])
@pytest.mark.parametrize("suffix", ["json", "yaml"])
def test_a_scene_keeps_its_samples_in_its_file_or_in_others_beside_it(tmp_path, samples, suffix):
    random, times = np.random.default_rng(1), np.linspace(0.0, 0.4, samples)
    one = lambda hold: fm.SampledSignal(times, random.normal(size=samples), hold)  # noqa: E731
    scene = replace(
        SCENE,
        torque=fm.SampledTorque(times, np.column_stack([np.zeros(samples), times]), "linear"),
        prescribed=[fm.SampledAngles(times, 0.1 * times**2), None],
        tip_force=[one("zero"), fm.Signal(1.0), one("linear")],
        base_acceleration=[fm.Signal(), one("zero"), fm.Signal()],
    )
    scene.save(tmp_path / f"driven.{suffix}")
    beside = {path.name for path in tmp_path.glob("*.csv")}
    kept = {"torque", "prescribed_0", "tip_force_0", "tip_force_2", "base_acceleration_1"}
    assert beside == (set() if samples < 100 else {f"driven_{name}.csv" for name in kept})
    assert fm.Scene.load(tmp_path / f"driven.{suffix}") == scene


def test_a_scene_file_names_a_record_beside_it(tmp_path):
    columns = {"hub (deg)": 10.0 * TIMES, "elbow (mN m)": TIMES, "rest (N m)": 0.0 * TIMES, "wind (N)": TIMES}
    write_csv(tmp_path / "bench.csv", {"time (s)": TIMES.tolist(), **columns})
    data = SCENE.to_dict() | {
        "torque": {"kind": "sampled", "csv": "bench.csv", "columns": ["rest", "elbow"], "hold": "linear"},
        "prescribed": [{"csv": "bench.csv", "column": "hub", "deviation": 0.001}, None],
        "tip_force": [{}, {"csv": "bench.csv", "column": "wind", "hold": "linear"}, {}],
    }
    scene = fm.Scene.from_dict(data, tmp_path)
    assert scene.torque.at(0.4) == pytest.approx([0.0, 4e-4])
    assert (
        scene.prescribed[0].angles == pytest.approx(np.radians(10.0 * TIMES)) and scene.prescribed[0].deviation == 1e-3
    )
    assert scene.initial.joint_rates[0] == pytest.approx(np.radians(10.0)), "of the record, not of the file"
    assert scene.tip_force[1] == fm.SampledSignal.from_csv(tmp_path / "bench.csv", "wind", "N", "linear")
    with pytest.raises(FileNotFoundError, match=r"other\.csv: there is no such file"):
        fm.Scene.from_dict(data | {"torque": {"kind": "sampled", "csv": "other.csv"}}, tmp_path)
    said = refusal(fm.Scene.from_dict, data | {"tip_force": [{"csv": "bench.csv", "column": "hub"}, {}, {}]}, tmp_path)
    assert said == "bench.csv: columns[0]: 'hub' is not allowed; give one of wind"


def test_angles_are_those_of_a_spline_through_them_or_near_them():
    motion = fm.SampledAngles(TIMES, 1.0 - 2.0 * TIMES + 3.0 * TIMES**2 + 4.0 * TIMES**3)
    assert motion.start(0.0) == pytest.approx((1.0, -2.0)) and motion.start(0.1) == pytest.approx((0.834, -1.28))
    assert motion.acceleration.values == pytest.approx(6.0 + 24.0 * TIMES)
    times = np.linspace(0.0, 1.0, 401)
    noise = 1e-3 * np.random.default_rng(0).normal(size=401)
    smooth = fm.SampledAngles(times, np.sin(3.0 * times) + noise, 1e-3)
    wrong = np.array(smooth.acceleration.values) + 9.0 * np.sin(3.0 * np.array(smooth.acceleration.times))
    assert np.abs(wrong).max() < 1.0, "of 9 rad/s^2; through the noise it is beyond 100"
    assert np.abs(fm.SampledAngles(times, np.sin(3.0 * times) + noise).acceleration.values).max() > 100.0


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "time (s),torque_1\n0,1\n",
            "record.csv: the units: 'torque_1 without a unit' is not allowed; give columns in one of N m, Nm, mN m, "
            "kN m, in the header or as a chosen column 'NAME (UNIT)'",
        ),
        ("time (s),torque_1 (lb ft)\n0,1\n", "record.csv: the units: 'torque_1 in lb ft' is not allowed; give columns"),
        ("time (s),a (rad)\n0,1\n1,1\n", "record.csv: the units: 'a in rad' is not allowed; give columns in one of"),
        ("time (N),a (N m)\n0,1\n", "record.csv: the unit of time: 'N' is not allowed; give one of s"),
        ("time,a (N m)\n0,1\n", "record.csv: time: 'steps of 0 without a unit' is not allowed; give its unit"),
        ("time (s),a (N m)\n0,1\n1,two\n", "record.csv: line 3: '1,two' is not allowed; give 2 finite numbers"),
        ("time (s),a (N m)\n0,nan\n1,1\n", "record.csv: a not read: numbers in 50 % of the lines; choose columns"),
        ("time (s),a (N m)\n", "record.csv: this is no table; give headers, such as time (s),"),
        ("time (s),a (N m)\n1,0\n0,0\n", "record.csv: time: '0 after 1' is not allowed; give one record with"),
        ("time (s),a (N m)\n0,0\n0,1\n1,1\n", "SampledTorque.times: array([0., 0., 1.]) is not allowed; give 2 to 1"),
    ],
)
def test_a_file_that_is_no_record_is_refused_in_one_line(tmp_path, text, said):
    (tmp_path / "record.csv").write_text(text, encoding="utf-8")
    assert refusal(fm.SampledTorque.from_csv, tmp_path / "record.csv").startswith(said)


def test_the_name_of_a_file_leaves_room_for_what_is_wrong_with_it(tmp_path):
    path = tmp_path / f"{'bench' * 40}.csv"
    for text, said in (
        (f"time (s),{'a' * 300}\n0,1\n", ": the header: 'aaa"),
        ("time (s),a (1)\n0,1\n1,x\n", ": line 3: '1,x'"),
    ):
        path.write_text(text)
        assert said in refusal(read_time_series, path)
    for name in ("bench" * 2000, "a\0b", "a\nb"):
        with pytest.raises(FileNotFoundError, match=r"^\S.{0,250}: there is no such file$"):
            read_time_series(tmp_path / name)


@pytest.mark.parametrize("name", ["../bench.csv", "{folder}/bench.csv", "link.csv"])
def test_a_record_outside_the_folder_of_a_scene_is_warned_of(tmp_path, name):
    """Somebody else's scene may name any file; the next release reads these only where it is asked for."""
    (tmp_path / "scene").mkdir()
    (tmp_path / "scene" / "link.csv").symlink_to(tmp_path / "bench.csv")
    write_csv(
        tmp_path / "bench.csv", {"time (s)": TIMES.tolist(), "a (N m)": TIMES, "b (N m)": TIMES, "wind (N)": TIMES}
    )
    csv = name.format(folder=tmp_path)
    torque = SCENE.to_dict() | {"torque": {"kind": "sampled", "csv": csv, "columns": ["a", "b"], "hold": "linear"}}
    wind = SCENE.to_dict() | {"tip_force": [{}, {"csv": csv, "column": "wind", "hold": "linear"}, {}]}
    for data, field in ((torque, r"torque\.csv"), (wind, r"tip_force\[1\]\.csv")):
        with pytest.warns(FutureWarning, match=rf"^{field}: .* is outside the folder of the scene file; the next rel"):
            scene = fm.Scene.from_dict(data, tmp_path / "scene")
        with warnings.catch_warnings(action="error"):
            inside = json.loads(json.dumps(data).replace(csv, "./scene/../bench.csv"))
            assert fm.Scene.from_dict(inside, tmp_path) == scene


ENDS, SHORT = (0.0, 1.0), fm.SampledAngles(0.9 * TIMES, TIMES)


def under(rows, times=TIMES, hold="zero", **changes):
    """The scene under a sampled torque of equal rows."""
    return replace(SCENE, torque=fm.SampledTorque(times, rows * 5, hold), **changes)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: fm.SampledSignal([0.0], [1.0]), "SampledSignal.times: [0.0] is not allowed; give 2 to"),
        (lambda: fm.SampledSignal([0.0, 0.0], [1.0, 1.0]), "SampledSignal.times"),
        (lambda: fm.SampledSignal(ENDS, [1.0]), "SampledSignal.values: [1.0] is not allowed; give 2 finite numbers"),
        (lambda: fm.SampledSignal([0.0, 1.0], [1.0, np.inf]), "SampledSignal.values"),
        (lambda: fm.SampledSignal(ENDS, ENDS, "cubic"), "SampledSignal.hold: 'cubic' is not allowed; give one"),
        (lambda: fm.SampledTorque(ENDS, ENDS), "SampledTorque.values: (0.0, 1.0) is not allowed; give 2 lists"),
        (lambda: fm.SampledAngles([0.0, 1.0, 2.0], [1.0, 2.0, 3.0]), "SampledAngles.times"),
        (lambda: fm.SampledAngles(TIMES, TIMES, -1.0), "SampledAngles.deviation: -1.0"),
        (lambda: fm.SampledTorque.from_function(lambda t: [t], 1.0, 0.3), "period: 0.3 is not allowed"),
        (lambda: under([[0.0]]), "Scene.torque.values: (0.0,) is not allowed"),
        (lambda: under([[0.0] * 2], 0.5 * TIMES, "linear"), "Scene.torque[0]: 'samples from 0 to 0.2 s'"),
        (lambda: under([[0.0] * 2], TIMES + 0.1), "Scene.torque[0]: 'samples from 0.1 to 0.6 s'"),
        (lambda: replace(SCENE, prescribed=[None, SHORT]), "Scene.prescribed[1]: 'samples from 0 to 0.36 s'"),
        (lambda: under([[-2.0, 1.0]], prescribed=[fm.Signal(1.0), None]), "Scene.torque of joint 0: -2.0"),
    ],
)
def test_samples_that_cannot_be_are_refused_in_one_line(make, said):
    assert refusal(make).startswith(said)
