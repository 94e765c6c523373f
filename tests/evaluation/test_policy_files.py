"""Shipped: an exported policy acts as it did, by its name too, and one in which something was changed is refused."""

import hashlib
import json
import os
import pickle
import subprocess
import sys

import numpy as np
import pytest
from safetensors.numpy import load, save

import flexman_gym as fm
from flexman_gym.agent.base_controllers import BASES
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation import policy_files
from flexman_gym.evaluation.agent_info import check_seeds_unseen, describe_agent, training_seconds
from flexman_gym.evaluation.agents import find_agent
from flexman_gym.evaluation.policy_files import (
    ARRAYS,
    MAX_BYTES,
    METADATA,
    POLICIES,
    policy_folder,
    read_policy,
    write_policy,
)
from flexman_gym.evaluation.rollouts import rollout

from oracles import shipped as made
from oracles.assertions import refusal


@pytest.fixture
def folder(tmp_path):
    """A policy that may be changed."""
    for name, content in made.files().items():
        (tmp_path / name).write_bytes(content)
    return tmp_path


def changed(folder, change):
    """Changes what is said of a policy."""
    about = json.loads((folder / METADATA).read_text())
    change(about)
    (folder / METADATA).write_text(json.dumps(about))


def hash_of(data):
    """Return the SHA-256 of plain data."""
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()


def settings(about, **given):
    """Changes settings of the training, and the hash beside them too."""
    about["recipe"]["settings"] |= given
    about["settings_hash"] = hash_of(about["recipe"]["settings"])


def forged(folder, change):
    """Changes its arrays, and the hash beside them too."""
    arrays = {name: each.copy() for name, each in load((folder / ARRAYS).read_bytes()).items()}
    change(arrays)
    (folder / ARRAYS).write_bytes(save(arrays))
    changed(folder, lambda about: about.__setitem__("arrays_hash", policy_files.hashlib.sha256(
        (folder / ARRAYS).read_bytes()).hexdigest()))  # fmt: skip


def test_it_acts_as_the_network_from_which_it_was_made(folder):
    about, arrays = made.made_up()
    policy = find_agent(str(folder))
    seen = arrays["check.observations"]
    assert np.array_equal(policy.law(seen), arrays["check.actions"])
    assert policy.interface["base"].stiffness.tolist() == [39.0, 5.56] and policy.environment.horizon == 1.0
    assert policy.environment.base is None, "which is a part of the policy"
    result = rollout(policy, policy.environment, [0, 1])
    assert result.lengths.tolist() == [100, 100] and np.abs(result.actions).max() > 0.01
    assert about["observation"][0] == {"name": "motor_angles", "unit": "rad", "size": 2}


def test_the_league_is_given_of_it_what_it_is_given_of_a_run(folder):
    assert (
        describe_agent(str(folder)).information == ("training", "true state") and training_seconds(str(folder)) == 2.0
    )
    check_seeds_unseen(str(folder), range(9000, 9100))
    assert "trained nor selected on the seed 4000001" in refusal(check_seeds_unseen, str(folder), [4_000_001])


@pytest.mark.feature
def test_what_its_base_knows_it_needs_too(tmp_path):
    environment = Configuration.from_plain(
        {"id": "FlexPlanar-v0", "base": "privileged-lqr", "sensors": "lab", "horizon": 1.0}
    )
    write_policy(tmp_path, *made.made_up(environment))
    assert describe_agent(str(tmp_path)).information == ("training", *BASES["privileged-lqr"].information)
    about, arrays = made.made_up(environment)
    about["recipe"]["settings"]["base_in_use"] = "adaptive-lqr"
    write_policy(tmp_path, about, arrays)
    assert describe_agent(str(tmp_path)).information == ("training", *BASES["adaptive-lqr"].information), (
        "that in use takes its place"
    )


def test_a_scale_an_index_and_gains_that_were_changed_are_refused(folder, tmp_path):
    """Also where whoever changed them knows of the hash."""
    wrong = {
        "a scale": lambda arrays: arrays["statistics.var"].__imul__(1.001),
        "an index": lambda arrays: arrays[f"{made.FIRST}.weight"][:, [0, 1]].__class__ and arrays.__setitem__(
            f"{made.FIRST}.weight", np.roll(arrays[f"{made.FIRST}.weight"], 1, axis=1)),
        "a mean": lambda arrays: arrays["statistics.mean"].__iadd__(1e-3),
        "a weight": lambda arrays: arrays["action_net.weight"][0].__imul__(-1.0),
        "an action": lambda arrays: arrays["check.actions"][5].__iadd__(1e-6),
    }  # fmt: skip
    for name, change in wrong.items():
        for file, content in made.files().items():
            (folder / file).write_bytes(content)
        forged(folder, change)
        assert "actions" in refusal(find_agent, folder), name
    for file, content in made.files().items():
        (folder / file).write_bytes(content)
    changed(folder, lambda about: about["environment"]["gains"]["damping"].__setitem__(0, 9.4))
    assert "of the export" in refusal(find_agent, folder)


def test_sensors_in_another_order_are_refused_by_their_names(folder):
    def swap(about):
        about["environment"]["sensors"] = ["fine", "full"]
        about["environment_hash"] = hash_of(about["environment"])

    changed(folder, swap)
    assert refusal(find_agent, folder).startswith(f"{folder / METADATA}: observation: ")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda arrays: arrays.__setitem__("extra", np.zeros(1)), "extra"),
        (lambda arrays: arrays.pop("statistics.var"), "statistics.var"),
        (lambda arrays: arrays.pop("action_net.bias"), "policy.action_net"),
        (lambda arrays: arrays.__setitem__("check.actions", arrays["check.actions"][:63]), "check: "),
        (lambda arrays: arrays["statistics.var"].__imul__(-1.0), "finite numbers >= 0"),
        (lambda arrays: arrays["action_net.bias"].__setitem__(0, np.nan), "finite numbers"),
        (lambda arrays: arrays["check.observations"].__setitem__(0, np.nan), "check: "),
    ],
)
def test_arrays_of_another_policy_are_refused(folder, change, said):
    forged(folder, change)
    assert said in refusal(read_policy, folder)


def test_other_keys_forms_and_sizes_are_refused(folder):
    whole = (folder / METADATA).read_text()
    for change, said in (
        (lambda about: about.__setitem__("code", "import os"), "keys: "),
        (lambda about: about.pop("licence"), "keys: "),
        (lambda about: about.__setitem__("format", "flexman_gym policy 2"), "format: "),
        (lambda about: settings(about, algo="td3"), "algo: "),
        (lambda about: settings(about, algo="sac"), "arrays: "),
        (lambda about: settings(about, hyperparameters={"activation": "relu"}), "check: "),
        (lambda about: about["recipe"]["settings"].__setitem__("base_in_use", "lqg"), "settings: "),
        (lambda about: about.__setitem__("recipe", None), "this is no exported policy"),
    ):
        (folder / METADATA).write_text(whole)
        changed(folder, change)
        assert said in refusal(read_policy, folder)
    (folder / METADATA).write_text(whole + " " * MAX_BYTES)
    assert f"at most {MAX_BYTES}" in refusal(read_policy, folder)
    (folder / METADATA).write_text(whole)
    (folder / ARRAYS).unlink()
    with pytest.raises(FileNotFoundError, match="no such file"):
        read_policy(folder)


class Bomb:
    """Says so when it is unpickled."""

    def __reduce__(self):
        return exec, ("import os; os.environ['FLEXMAN_BOMB'] = '1'",)


def test_nothing_in_it_runs(folder):
    for name in (METADATA, ARRAYS):
        kept = (folder / name).read_bytes()
        (folder / name).write_bytes(pickle.dumps(Bomb()))
        assert "this is no exported policy" in refusal(read_policy, folder)
        (folder / name).write_bytes(kept)
    assert "FLEXMAN_BOMB" not in os.environ


@pytest.mark.feature
@pytest.mark.parametrize("first", range(0, 60, 20))
def test_mutated_files_are_refused_in_one_line_or_act_as_before(first, tmp_path):
    """`python -m oracles.shipped 1000` tries more."""
    kinds = [made.outcome(seed, tmp_path) for seed in range(first, first + 20)]
    assert [what for kind, what in kinds if kind == "finding"] == []
    assert "refused" in {kind for kind, _ in kinds}


def test_what_cannot_be_read_is_not_written_as_a_policy(tmp_path):
    about, arrays = made.made_up()
    wrong = {**arrays, "check.actions": arrays["check.actions"] + 1e-3}
    assert "check: " in refusal(write_policy, tmp_path, about, wrong)


@pytest.mark.slow
def test_a_policy_needs_no_training_library(folder):
    script = "import sys; sys.modules['torch'] = sys.modules['stable_baselines3'] = None; "
    script += "from flexman_gym.evaluation import find_agent; print(find_agent(sys.argv[1]).name)"
    done = subprocess.run([sys.executable, "-c", script, folder], capture_output=True, text=True)
    assert done.stdout.strip() == folder.name, done.stderr


@pytest.mark.parametrize("name", POLICIES)
def test_a_policy_of_the_package_is_small_and_says_what_it_is(name):
    folder, about = policy_folder(name), read_policy(policy_folder(name)).metadata
    assert sum(path.stat().st_size for path in folder.iterdir()) < 1e6
    assert about["licence"] == "MIT" and len(about["commit"]) == 40 and about["words"].endswith(".")
    league = about["league"]
    assert league["seeds"] == [9000, 9100] and {"settled", "settling_time", "vibration"} <= league.keys()
    shaped = "base_in_use" in about["recipe"]["settings"]  # it sees parts of ranges that its base estimates
    assert {each["unit"] for each in about["observation"]} >= ({"1"} if shaped else {"rad", "m"})


@pytest.mark.feature
@pytest.mark.slow
@pytest.mark.parametrize("name", POLICIES)
def test_a_policy_of_the_package_reaches_its_row_again(name):
    """A policy beside an observer takes longer, and plays some of the episodes."""
    policy, about = find_agent(name), read_policy(policy_folder(name)).metadata
    row, quick = about["league"], about["environment"].get("base") == "pd"
    figures = fm.evaluate(name, policy.environment, range(9000, 9100 if quick else 9004))
    assert figures["failed"] == 0.0 and figures["settled"] > 0.7
    if quick:
        # processors round otherwise: what rests within a nanometre is not compared by its digits
        assert {each: row[each] for each in figures} == pytest.approx(figures, rel=1e-3, abs=1e-8)


def regulators(data):
    """The bases with an LQR in nested mappings and lists."""
    if isinstance(data, dict) and str(data.get("kind", "")).endswith("-lqr"):
        yield data
    for each in data.values() if isinstance(data, dict) else data if isinstance(data, list) else ():
        yield from regulators(each)


def test_policies_of_the_package_name_the_design_of_their_regulators():
    """Weights, planner and times of the design "arm" are other ones than those that they were trained on."""
    found = {name: list(regulators(read_policy(policy_folder(name)).metadata)) for name in POLICIES}
    assert {name for name, each in found.items() if each} == {"lab-flexrrr", "shaping-flexrrr"}
    assert all(base["design"] == "named" for each in found.values() for base in each)
