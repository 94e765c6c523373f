"""Files with keys of earlier versions: refused in one line with the script that converts them to the present form."""

import json
import shutil
from copy import deepcopy
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from flexman_gym.common import files
from flexman_gym.common.run_folder import BEST, NEWEST, SETTINGS, read_npz, write_npz
from flexman_gym.common.snapshot import set_state
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.envs.vector_env import FlexManVectorEnv
from flexman_gym.evaluation.agents import find_agent
from flexman_gym.evaluation.policy_files import FOLDER, METADATA, read_policy
from flexman_gym.evaluation.trained_agents import check_settings
from flexman_gym.toolbox.league.certificate_file import CERTIFICATE, read_certificate
from flexman_gym.toolbox.league.rows import CELLS, ROWS, LeagueRows

from oracles.assertions import refusal
from oracles.files import command

CONVERT = command("convert")
STORED = Path(__file__).parent / "agents" / "stopped_run"
HINT = files.CONVERSION


def old(data, table):
    """Return a mapping with the old keys of a table."""
    return CONVERT.rename(data, {new: before for before, new in table.items()})


def old_environment(data):
    """Return the mapping of an environment with old keys and without its method."""
    return {key: value for key, value in old(data, CONVERT.ENVIRONMENT_KEYS).items() if key != "method"}


def old_settings(data):
    """Return the settings of a training with old keys."""
    return old(data, CONVERT.SETTINGS_KEYS) | {"environment": old_environment(data["environment"])}


def old_state(data):
    """Return the state of an environment with the observations beside the measurements, and without new constants."""
    agent, episodes = dict(data["agent"]), dict(data["episodes"])
    sight = {**episodes.pop("measurements"), "_history": agent["_history"], "seen": agent["observations"]}
    own = episodes["batch"]["_mover"]["own"]
    mover = {"own": [{key: each[key] for key in each.keys() - CONVERT.ADDED_CONSTANTS} for each in own]}
    episodes |= {"batch": episodes["batch"] | {"_mover": mover}, "sight": sight}
    rest = {name: each for name, each in data.items() if name != "agent"}
    return {**rest, "episodes": episodes, "acting": {name: agent[name] for name in ("base", "mode")}}


def old_fields(data):
    """Return part of a state with the old names of all fields."""
    if not isinstance(data, dict):
        return data
    names = {new: before for before, new in CONVERT.STATE_FIELDS.items()}
    return {names.get(name, name): old_fields(each) for name, each in data.items()}


def converted(monkeypatch, *arguments):
    """Return the exit status of the script."""
    monkeypatch.setattr("sys.argv", ["convert", *map(str, arguments)])
    return CONVERT.main()


@pytest.fixture
def run(tmp_path):
    """Folder of a training run with old keys in all files."""
    folder = shutil.copytree(STORED / "run", tmp_path / "run")
    record = json.loads((folder / SETTINGS).read_text())
    (folder / SETTINGS).write_text(json.dumps(old_settings(record)))
    for name in (NEWEST, BEST):
        data = old(read_npz(folder / name), CONVERT.RUN_KEYS)
        data["settings"] = old_settings(data["settings"])
        if "training" in data:
            data["training"] = data["training"] | {"environment": old_state(data["training"]["environment"])}
        write_npz(folder / name, data)
    return folder


def test_a_run_folder_with_old_keys_is_refused_until_it_is_converted(run, monkeypatch, capsys):
    line = refusal(find_agent, run)
    assert line.startswith(f"{run / SETTINGS}: judge_every: 128 is not allowed; give one of algo") and line.endswith(
        HINT
    )
    assert converted(monkeypatch, run) == 0
    assert capsys.readouterr().out.count(": converted\n") == 3
    assert json.loads((run / SETTINGS).read_text()) == json.loads((STORED / "run" / SETTINGS).read_text())
    for name in (NEWEST, BEST):
        np.testing.assert_equal(read_npz(run / name), read_npz(STORED / "run" / name))
    assert converted(monkeypatch, run) == 0 and capsys.readouterr().out.count(": unchanged\n") == 3
    assert find_agent(run).interface["action_repeat"] == 5


def test_each_old_key_of_a_run_folder_is_named(run):
    """Each is refused where it is the only one."""
    record = json.loads((STORED / "run" / SETTINGS).read_text())
    environment = record["environment"]
    for changed, start in (
        ({"value_first": 3}, "value_first: 3 is not allowed; give one of algo"),
        ({"engine": "rllib"}, "engine: 'rllib' is not allowed; give one of algo"),
        (
            {"environment": old_environment(environment)},
            "environment.method: None is not allowed; give the integration",
        ),
        ({"environment": environment | {"hold": 5}}, "this has no settings of a training run (hold: 5 is not allowed"),
    ):
        (run / SETTINGS).write_text(json.dumps(record | changed))
        line = refusal(find_agent, run)
        assert line.startswith(f"{run / SETTINGS}: {start}") and line.endswith(HINT), changed
    (run / SETTINGS).write_text(json.dumps(record))
    line = refusal(check_settings, run / BEST, read_npz(run / BEST), record)
    assert line.startswith(f"{run / BEST}: judge_every: 128 is not allowed") and line.endswith(HINT)


def test_a_policy_with_old_keys_is_refused_until_it_is_converted(tmp_path, monkeypatch):
    name = "ppo-flexplanar"
    folder = shutil.copytree(FOLDER / name, tmp_path / name)
    present = json.loads((folder / METADATA).read_text())
    environment, settings = old_environment(present["environment"]), old_settings(present["recipe"]["settings"])
    about = present | {"environment": environment, "recipe": present["recipe"] | {"settings": settings}}
    hashes = {"environment_hash": CONVERT.json_hash(environment), "settings_hash": CONVERT.json_hash(settings)}
    (folder / METADATA).write_text(json.dumps(about | hashes))
    certificate = json.loads((folder / CERTIFICATE).read_text())
    rows = [old(row, {"name": "scenario"}) for row in certificate["rows"]]
    text = json.dumps({**old(certificate, {"machine": "computer"}), "trials": rows, "rows": []})
    (folder / CERTIFICATE).write_text(text.replace(', "rows": []', "").replace("gauss_2", "gauss_2_sweeps"))
    for read, file, key in ((read_policy, METADATA, "judge_every"), (read_certificate, CERTIFICATE, "'machine'")):
        line = refusal(read, folder)
        assert line.startswith(f"{folder / file}: this is no ") and key in line and line.endswith(HINT)
    assert converted(monkeypatch, folder) == 0
    assert json.loads((folder / METADATA).read_text()) == present
    assert json.loads((folder / CERTIFICATE).read_text()) == certificate


def test_a_policy_that_was_changed_after_its_export_is_not_converted(tmp_path, monkeypatch, capsys):
    folder = shutil.copytree(FOLDER / "ppo-flexplanar", tmp_path / "changed")
    about = json.loads((folder / METADATA).read_text())
    (folder / METADATA).write_text(json.dumps(about | {"environment": about["environment"] | {"hold": 3}}))
    assert converted(monkeypatch, folder) == 1
    assert "environment_hash: the file was changed after its export" in capsys.readouterr().err


def test_a_state_with_old_fields_is_refused_until_it_is_converted(tmp_path, monkeypatch):
    """A controller with an observer and slews, and randomised links; the converted state has the same bits."""
    own = {"id": "FlexOne-v0", "base": "adaptive-lqr", "action_repeat": 2}
    own |= {"randomisation": {"link_stiffness_factor": [0.8, 1.2]}}
    files.write_data(tmp_path / "own.yaml", own)
    for kind in (FlexManEnv, partial(FlexManVectorEnv, 2)):
        env, other = (kind(**Configuration.from_plain(own).keywords()) for _ in range(2))
        env.reset(seed=3)
        env.step(np.zeros(env.action_space.shape))  # an old state lacks the command, which is zero when converted
        state = env.get_state()
        before = old_state(deepcopy(state))
        before["acting"]["base"] = old_fields(before["acting"]["base"])
        before["episodes"]["view"] = old_fields(before["episodes"]["view"])
        drawn = before["episodes"]["effects"]["drawn"]
        before["episodes"]["effects"]["drawn"] = {"link_stiffness": drawn["link_stiffness_factor"]}
        assert refusal(other.set_state, before).startswith("state: ")
        write_npz(tmp_path / "state.npz", before)
        assert converted(monkeypatch, tmp_path / "state.npz") == 1, "the environment is needed"
        assert converted(monkeypatch, tmp_path / "state.npz", "--env", tmp_path / "own.yaml") == 0
        other.set_state(read_npz(tmp_path / "state.npz"))
        np.testing.assert_equal(other.get_state(), state)


def test_a_state_without_all_constants_and_effects_is_refused_in_one_line():
    env = FlexManEnv(name="FlexOne-v0", randomisation={"link_stiffness_factor": [0.8, 1.2]})
    env.reset(seed=0)
    for path, line in (
        (("batch", "_mover", "own", 0, "coulomb_rate"), "state.batch._mover.own: 'list' is not allowed"),
        (("effects", "drawn", "link_stiffness_factor"), "effects.drawn: [] is not allowed"),
    ):
        state = env.get_state()["episodes"]
        inner = state
        for part in path[:-1]:
            inner = inner[part]
        del inner[path[-1]]
        assert refusal(set_state, "state", env.episodes, state).startswith(line)


def test_a_league_with_old_heads_is_refused_until_it_is_converted(tmp_path, monkeypatch):
    rows = "key,entrant,venue,seed,reward\nk,pd,FlexOne-v0/method=gauss_2_sweeps,7,0.5\n"
    cells = "key,entrant,venue,first,end,action,design,why\nk,pd,FlexOne-v0/method=gauss_2_sweeps,7,8,0,0,\n"
    for name, text in ((ROWS, rows), (CELLS, cells)):
        (tmp_path / name).write_text(text)
    line = refusal(LeagueRows.load, tmp_path)
    assert line.startswith(f"{tmp_path / CELLS}: entrant is no head of a league") and line.endswith(HINT)
    assert converted(monkeypatch, tmp_path) == 0
    assert [*LeagueRows.load(tmp_path).rows] == [("FlexOne-v0/method=gauss_2", "pd", 7)]


def test_rows_of_a_study_keep_all_other_characters(tmp_path, monkeypatch):
    text = "# gauss_2 on a computer\r\nroom,error\r\ncontrol,the room of midpoint_3_sweeps; 1e-05\r\n"
    (tmp_path / "rows.csv").write_bytes(text.encode())
    assert converted(monkeypatch, tmp_path / "rows.csv") == 0
    expected = text.replace("room,", "part,").replace("_sweeps", "")
    assert (tmp_path / "rows.csv").read_bytes().decode() == expected


@pytest.mark.parametrize("suffix", [".json", ".yaml"])
@pytest.mark.parametrize(
    ("before", "now", "key"),
    [
        ({"hold": 3}, {"action_repeat": 3}, "hold"),
        ({"tell": ["tip"]}, {"info_keys": ["tip"]}, "tell"),
        ({"base": {"kind": "lqr-tracking", "law": "trapezoid"}},
         {"base": {"kind": "lqr-tracking", "timing": "trapezoid"}}, "law"),
        ({"base": {"kind": "lqr-tracking", "timing_law": "minimum-jerk"}},
         {"base": {"kind": "lqr-tracking", "timing": "quintic"}}, "timing_law"),
        ({"method": "midpoint_3_sweeps"}, {"method": "midpoint_3"}, "method"),
    ],
)  # fmt: skip
def test_a_file_of_an_environment_with_an_old_key_is_refused_until_it_is_converted(
    before, now, key, suffix, tmp_path, monkeypatch
):
    path = tmp_path / f"own{suffix}"
    files.write_data(path, {"id": "FlexOne-v0", **before})
    line = refusal(lambda: FlexManEnv(**Configuration.load(path).keywords()))
    assert key in line and ("law" in key or line.startswith(f"{path}: "))
    assert key in ("law", "timing_law", "method") or line.endswith(HINT)
    assert converted(monkeypatch, path) == 0
    assert Configuration.load(path) == Configuration("FlexOne-v0", now)


@pytest.mark.parametrize("kind", ["lqr-tracking", "lqg", "adaptive-lqr", "privileged-lqr"])
def test_a_stored_base_that_tracks_slews_keeps_its_quintics(kind):
    """Run folders and policies without a timing had quintics; an environment of the user gets the default."""
    settings = {"environment": {"base": kind}, "base_in_use": {"kind": kind, "design": "named"}}
    settings["hyperparameters"] = {"teacher": kind}
    present, quintic = CONVERT.present_settings(settings, stored=True), {"kind": kind, "timing": "quintic"}
    assert present["environment"]["base"] == present["hyperparameters"]["teacher"] == quintic
    assert present["base_in_use"] == {**quintic, "design": "named"}
    assert CONVERT.present_settings(present, stored=True) == present
    assert CONVERT.present_settings(settings)["environment"]["base"] == kind
    assert CONVERT.present_base("pd", stored=True) == "pd"


def test_a_stored_training_state_with_an_old_field_is_refused_in_one_line(tmp_path):
    """The settings are in the present form, and one field of the environment is not."""
    training = pytest.importorskip("flexman_agents.training")
    folder = shutil.copytree(STORED / "run", tmp_path / "run")
    data = read_npz(folder / NEWEST)
    episodes = data["training"]["environment"]["episodes"]
    episodes["view"] = old_fields(episodes["view"])
    write_npz(folder / NEWEST, data)
    line = refusal(lambda: training.resume(folder, progress=False))
    assert line.startswith(f"{folder / NEWEST}: this has no state of a run (state.episodes.view: [")
    assert "'plan'" in line and line.endswith(HINT)


def test_a_recipe_with_old_keys_is_refused_until_it_is_converted(tmp_path, monkeypatch):
    Settings = pytest.importorskip("flexman_agents.settings").Settings
    path = tmp_path / "recipe.yaml"
    files.write_data(path, {"algo": "dagger", "hyperparameters": {"rounds_kept": 3}, "judge_every": 0})
    line = refusal(Settings.recipe, path)
    assert line.startswith(f"{path}: settings: 'judge_every' is not allowed") and line.endswith(HINT)
    assert converted(monkeypatch, path) == 0
    settings = Settings.recipe(path)
    assert settings.hyperparameters == {"iterations_kept": 3} and "method" not in settings.environment.given


def test_a_value_under_both_names_is_not_converted(tmp_path, monkeypatch, capsys):
    path = tmp_path / "own.json"
    files.write_data(path, {"id": "FlexOne-v0", "hold": 3, "action_repeat": 4})
    assert converted(monkeypatch, path) == 1
    assert "hold: the mapping also has action_repeat; delete one of them" in capsys.readouterr().err
