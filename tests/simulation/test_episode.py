"""Episode: what is saved comes back to the bit, as tables too; anything else in a file is refused and not run."""

import csv
import io
import json
import sys
from dataclasses import replace

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.simulation.episode import Episode

MODEL = fm.build_model(fm.catalog.planar_2r(joint_stiffness=20.0), elements=1, modes=(2, (0, 2)), stiffening=True)


@pytest.fixture
def episode():
    random = np.random.default_rng(0)
    several = {name: random.normal(size=(5, 3)) for name in ("tips", "targets")}
    each = {name: random.normal(size=(4, 2)) for name in ("actions", "torques")}
    told = Episode.metadata(
        MODEL, {"gains": np.ones(2), "base": MODEL}, name="a b", seed=7, units={"angles": "rad", "near": "1"}
    )
    return Episode(
        time=0.1 * np.arange(5), states=random.normal(size=(5, 2 * MODEL.n_dof)), errors=np.ones(5),
        rewards=np.arange(4.0), readings={"angles": random.normal(size=(5, 2)), "near": np.ones((5, 1))}, about=told,
        **several, **each,
    )  # fmt: skip


def same(one, other):
    """Whether two episodes hold the same."""
    for name in ("time", "states", "tips", "targets", "errors", "actions", "torques", "rewards"):
        assert np.array_equal(getattr(one, name), getattr(other, name), equal_nan=True), name
    assert one.readings.keys() == other.readings.keys() and one.about == other.about
    assert all(np.array_equal(one.readings[name], other.readings[name]) for name in one.readings)
    return True


def test_a_saved_episode_comes_back_with_its_model(episode, tmp_path):
    again = Episode.load(episode.save(tmp_path / "new" / "a.npz"))
    assert same(again, episode) and again.name == "a b" and again.about["seed"] == 7
    assert again.about["settings"] == {"gains": [1.0, 1.0], "base": "Model"} and len(again.about["hash"]) == 16
    assert again.model.choice == MODEL.choice and again.model.arm == MODEL.arm
    assert np.array_equal(again.model.bases[1], MODEL.bases[1])


def test_the_same_settings_have_one_hash_and_others_another():
    hashes = [Episode.metadata(MODEL, settings)["hash"] for settings in ({"a": 1, "b": 2}, {"b": 2, "a": 1}, {"a": 1})]
    assert hashes[0] == hashes[1] != hashes[2]


def test_tables_have_every_number(episode, tmp_path):
    episode.to_csv(tmp_path / "a.csv")
    heads, *rows = csv.reader(io.StringIO((tmp_path / "a.csv").read_text()))
    assert heads == list(episode.columns()) and len(rows) == 5 and np.isnan(float(rows[0][heads.index("action_1")]))
    assert {"time (s)", "tip_x (m)", "torque_2 (N m)", "angles_2 (rad)", "near_1", "reward"} <= {*heads}
    assert [float(row[heads.index("action_2")]) for row in rows[1:]] == episode.actions[:, 1].tolist()
    assert [float(row[heads.index("target_z (m)")]) for row in rows] == episode.targets[:, 2].tolist()


@pytest.mark.slow
def test_pandas_and_xarray_have_them_too(episode):
    frame = pytest.importorskip("pandas")
    assert episode.to_pandas()["torque_1 (N m)"].tolist()[1:] == episode.torques[:, 0].tolist()
    pytest.importorskip("xarray")
    data = episode.to_xarray()
    assert data["tips"].sel(axis="y").values.tolist() == episode.tips[:, 1].tolist()
    assert data["actions"].dims == ("period", "joint") and data.attrs["seed"] == 7 and frame


def test_without_pandas_the_error_names_it(episode, monkeypatch):
    for name, attempt in (("pandas", episode.to_pandas), ("xarray", episode.to_xarray)):
        monkeypatch.setitem(sys.modules, name, None)
        with pytest.raises(ImportError, match=name):
            attempt()


def test_a_trajectory_is_an_episode_without_a_task(tmp_path):
    choice, start = fm.ModelChoice(True, 1), fm.Initial((0.1,), (0.0,))
    scene = fm.Scene(fm.catalog.one_link(), choice, fm.ConstantTorque((1.0,)), start, 0.02, 0.01)
    result = fm.simulate(scene, method="rk4", step=1e-4)
    again = Episode.load(Episode.from_trajectory(result, "push").save(tmp_path / "a.npz"))
    assert np.array_equal(again.states, result.states) and np.array_equal(again.tips, result.tip)
    assert np.isnan(again.targets).all() and again.actions.shape == (2, 1) and again.name == "push"
    assert np.allclose(fm.curves(again.model, again.states, 4).positions[:, -1, -1], result.tip, rtol=0.0, atol=1e-12)


class Evil:
    """What a pickle of it would run."""

    def __reduce__(self):
        return (sys.exit, (1,))


@pytest.mark.parametrize("wrong", ["noise", "pickle", "packed", "short", "format", "text", "no states", "integers"])
def test_other_files_are_refused_in_one_line(episode, tmp_path, wrong):
    path = episode.save(tmp_path / "a.npz")
    with np.load(path) as data:
        arrays = {name: data[name] for name in data.files}
    told = json.loads(arrays["about"].tobytes())
    if wrong == "noise":
        path.write_bytes(np.random.default_rng(0).bytes(1000))
    elif wrong == "packed":
        np.savez_compressed(path, **arrays | {"states": np.zeros((5, 8))})
    else:
        arrays |= {"pickle": {"tips": np.array([Evil()])}, "short": {"tips": arrays["tips"][1:]},
                   "format": {"about": np.frombuffer(json.dumps(told | {"format": 9}).encode(), "u1")},
                   "text": {"about": np.frombuffer(b"[", "u1")}, "no states": {},
                   "integers": {"errors": np.zeros(5, dtype=int)}}[wrong]  # fmt: skip
        if wrong == "no states":
            del arrays["states"]
        np.savez(path, **arrays)
    with pytest.raises(ValueError, match=r"a\.npz: this is not a saved episode \(") as error:
        Episode.load(path)
    assert "\n" not in str(error.value)


def test_a_file_that_is_not_there_is_said_so(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"a\.npz: there is no such file"):
        Episode.load(tmp_path / "a.npz")


def test_positions_of_a_base_are_saved_and_are_columns(episode, tmp_path):
    moving = replace(episode, bases=np.arange(15.0).reshape(5, 3))
    again = Episode.load(moving.save(tmp_path / "a.npz"))
    assert np.array_equal(again.bases, moving.bases) and np.array_equal(again.base_positions, moving.bases)
    assert np.array_equal(again.columns()["base_z (m)"], moving.bases[:, 2])
    assert Episode.load(episode.save(tmp_path / "b.npz")).bases is None and not episode.base_positions.any()


def test_a_trajectory_that_ended_early_has_its_status_as_failure():
    whole = fm.simulate(fm.catalog.paper_scene("rr"), step=0.01)
    assert Episode.from_trajectory(whole).about["failure"] == ""
    assert Episode.from_trajectory(replace(whole, status="not finite")).about["failure"] == "not finite"
