"""Certificate: each trial plays the episodes that it names, what fails is said, and it belongs to one policy."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.envs import episodes
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation import policy_files
from flexman_gym.evaluation.agent import design_for, find_agent
from flexman_gym.evaluation.policy_files import ABOUT, write_policy
from flexman_gym.evaluation.rollout import EpisodeRecord
from flexman_gym.league import certificate
from flexman_gym.league.certificate import PHYSICS, SHOWN, certify, policy_trials
from flexman_gym.league.scenarios import evaluate_on_plants

from oracles.assertions import refusal
from oracles.shipped import DESCRIBED, made_up, write_still

SEEDS = range(9000, 9002)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A policy that does nothing beside its PD controller, under a name."""
    write_still(tmp_path / "still")
    monkeypatch.setattr(policy_files, "FOLDER", tmp_path)
    monkeypatch.setattr(certificate, "METHOD", "midpoint_2_sweeps")  # another one compiles for long
    monkeypatch.delitem(certificate.PLANTS, "mujoco")  # and this one plays for long
    return tmp_path / "still"


def test_trials_are_played_where_they_say_and_kept_beside_the_policy(folder):
    assert policy_files.describe_policy("still") == "Made up. It has no certificate."
    said = []
    path = certify(str(folder), SEEDS, 6, said.append)
    result = json.loads(path.read_text())
    rows = {row["name"]: row for row in result["trials"]}
    assert len(said) == len(rows) and list(rows)[:3] == ["as trained", "finer", "method"]
    assert rows["finer"]["error"] == evaluate_on_plants("pd", DESCRIBED, SEEDS, ("finer",))["finer"]["error"]
    far = ("payload", "stiffness", "friction", "delay 0", "delay 3", "noise 0.003")
    assert {"search", *(f"{name} ({words})" for name in far for words in ("told", "not told"))} <= rows.keys()
    for name, changes in (
        ("as trained", {}),
        ("payload (told)", {"randomisation": {"payload_mass": [0.0, 0.2]}}),
        ("delay 1 (not told)", {"randomisation": {"delay": [1, 1]}}),
        ("friction (told)", Configuration.find("FlexPlanar-v0/friction").settings),
    ):
        expected = fm.evaluate("pd", Configuration("FlexPlanar-v0", {**DESCRIBED.settings, **changes}), SEEDS)
        shown = {each: expected[each] if np.isfinite(expected[each]) else None for each in SHOWN}
        assert {each: rows[name][each] for each in SHOWN} == shown, name
    search = range(certificate.FIRST_DRAW, certificate.FIRST_DRAW + 6)
    rewards = {seed: fm.evaluate("pd", DESCRIBED, [seed])["reward"] for seed in search}
    worst = [each["seed"] for each in rows["search"]["worst"]]
    assert worst == sorted(search, key=rewards.__getitem__)[:5]
    assert result["fails"] == [row["name"] for row in result["trials"] if row["fails"]]
    assert "delay 3 (told)" in result["fails"], "the arm then never settles in its second"
    assert policy_files.describe_policy("still").startswith("Made up. Not recommended: it fails ")


def test_a_policy_without_failures_is_recommended_and_another_has_no_certificate_of_it(folder):
    about = json.loads((folder / ABOUT).read_text())
    empty = {"arrays_hash": about["arrays_hash"], "fails": [], "trials": []}
    (folder / policy_files.CERTIFICATE).write_text(json.dumps(empty))
    assert policy_files.describe_policy("still") == "Made up. Recommended."
    (folder / policy_files.CERTIFICATE).write_text(json.dumps({**empty, "arrays_hash": "another"}))
    assert policy_files.describe_policy("still") == "Made up. It has no certificate."


def record(vibration=0.0, failure="", error=0.0):
    """An episode of 4 s, in which the tip moves along an axis at its end."""
    tips = np.zeros((401, 3))
    tips[200::2, 0] = vibration
    return EpisodeRecord(tips, np.full(401, error), np.zeros((400, 2)), np.zeros(400), failure, 0.01, 0.01)


@pytest.mark.parametrize(
    ("kind", "records", "said"),
    [
        ("usual", [record()] * 20, ""),
        ("usual", [record()] * 18 + [record(error=1.0)] * 2, "less than 95% settle"),
        ("far", [record()] * 18 + [record(error=1.0)] * 2, ""),
        ("far", [record()] * 17 + [record(error=1.0)] * 3, "less than 90% settle"),
        ("far", [record()] * 99 + [record(failure="angle")], "an episode ended at a limit"),
        ("physics", [record(1.19e-3)] * 3, ""),
        ("physics", [record(1.21e-3)] * 3, "the tip moves by more than 1.2 mm"),
    ],
)
def test_a_row_fails_for_what_it_says(kind, records, said):
    trial = certificate.CertificateTrial("a", "b", kind, {})
    assert certificate._row(trial, records, [record(1e-3)])["fails"] == said
    assert PHYSICS == 0.95


def test_small_vibration_may_grow_by_a_tenth_of_a_millimetre():
    trial = certificate.CertificateTrial("a", "b", "physics", {})
    for vibration, fails in ((9e-5, False), (1.2e-4, True)):
        assert bool(certificate._row(trial, [record(vibration)], [record()])["fails"]) == fails


def test_what_the_training_drew_is_left(monkeypatch):
    """A policy that learned with payloads and stiffness is tried beyond them."""
    trained = Configuration.find("FlexRRR-v0/unknown")
    changes = {each.name: each.changes for each in policy_trials(Configuration(), trained)}
    assert changes["payload (told)"] == {"randomisation": {"payload_mass": [20.0, 25.0]}}
    assert changes["payload (not told)"] == changes["payload (told)"]
    both = changes["stiffness (told)"]["randomisation"]
    assert both["joint_stiffness_factor"] == both["link_stiffness_factor"] == pytest.approx([0.55, 0.7])
    kept = {each.name: each.changes for each in policy_trials(trained, trained)}["delay 3 (told)"]["randomisation"]
    assert kept["delay"] == [3, 3] and kept["payload_mass"] == [0.0, 20.0]


def test_friction_is_that_of_the_named_arm_and_no_other_arm_is_tried_with_it():
    own = Configuration("FlexRRR-v0", {"arm": {**dict(Configuration().to_plain()["arm"]), "payload": {"mass": 5.0}}})
    tried = [[each.name for each in policy_trials(what, what)] for what in (Configuration(), own)]
    assert ["friction (told)" in names for names in tried] == [True, False]


@pytest.mark.parametrize(("words", "delay"), [("told", (3, 3)), ("not told", (1, 1))])
def test_a_controller_is_designed_for_the_delay_that_it_is_told_and_else_for_its_own(words, delay, monkeypatch):
    """Torques come 3 periods late in both; the observer of `lab-flexrrr` fits its own simulations at `delay`."""
    entrant, plants = find_agent("lab-flexrrr"), []
    made = episodes.make_action_mode
    monkeypatch.setattr(
        episodes, "make_action_mode", lambda value, plant, base: plants.append(plant) or made(value, plant, base)
    )

    def rollout(player, environment, seeds, **_):
        assert environment.randomisation.given["delay"] == [3, 3]
        design_for(player, environment)  # as the environment does with a controller that is not built yet
        return SimpleNamespace(records=[])

    monkeypatch.setattr(certificate, "rollout", rollout)
    (trial,) = (each for each in policy_trials(*[entrant.environment] * 2) if each.name == f"delay 3 ({words})")
    certificate._run_trial(entrant, trial, SEEDS)
    assert plants[0].delay == delay


def test_only_policies_of_tasks_in_which_something_settles(tmp_path):
    assert refusal(certify, "pd") == "name: 'pd' is not allowed; give an exported policy, by its name or folder"
    path = Configuration.from_plain({"id": "FlexPlanar-Track-v0", "base": "pd", "sensors": "full", "horizon": 1.0})
    write_policy(tmp_path, *made_up(path))
    assert "a policy for a task in which the arm settles" in refusal(certify, str(tmp_path))
