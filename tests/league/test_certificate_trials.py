"""Trials of a certificate: each is compared with the episodes as trained, and another method has a finer step."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from flexman_gym.envs.env import FlexManEnv
from flexman_gym.evaluation.policy_files import write_policy
from flexman_gym.evaluation.rollout import EpisodeRecord
from flexman_gym.league import certificate
from flexman_gym.league.certificate import certify

from oracles.shipped import DESCRIBED, made_up

QUIET, LOUD = 1e-3, 3e-3  # vibration, m peak to peak


@pytest.fixture
def policy(tmp_path):
    """The folder of an exported policy."""
    about, arrays = made_up()
    about["recipe"]["settings"]["environment"] = DESCRIBED.to_plain()
    write_policy(tmp_path, about, arrays)
    return str(tmp_path)


def record(vibration):
    """An episode of 4 s that settles at once, after which the tip vibrates."""
    tips = np.zeros((401, 3))
    tips[200::2, 0] = vibration
    return EpisodeRecord(tips, np.zeros(401), np.zeros((400, 2)), np.zeros(400), "", 0.01, 0.01)


def tried(monkeypatch, folder, vibration):
    """Rows of a certificate and the environments by trial; `vibration` is a function of the number of the trial."""
    environments = []

    def rollout(entrant, environment, seeds, **_):
        environments.append(environment)
        return SimpleNamespace(records=[record(vibration(len(environments)))] * len(seeds))

    monkeypatch.setattr(certificate, "rollout", rollout)
    monkeypatch.setattr(certificate, "find_plant", lambda name: name)
    rows = json.loads(certify(folder, range(9000, 9002), 1, lambda said: None).read_text())["trials"]
    played = [row for row in rows if not row["name"].endswith("(not told)")]  # of a PD that is built already
    return {row["name"]: (row, each) for row, each in zip(played, environments, strict=True)}


def test_more_vibration_than_as_trained_fails_in_every_other_physics(policy, monkeypatch):
    rows = tried(monkeypatch, policy, lambda trial: QUIET if trial == 1 else LOUD)
    assert not rows["as trained"][0]["fails"] and not rows["delay 0 (told)"][0]["fails"]
    for name in ("finer", "mujoco", "method"):
        row, _ = rows[name]
        assert row["vibration"] == pytest.approx(LOUD) and row["fails"] == "the tip moves by more than 1.2 mm", name


def test_vibration_as_trained_fails_nowhere(policy, monkeypatch):
    assert not any(row["fails"] for row, _ in tried(monkeypatch, policy, lambda trial: LOUD).values())


def test_another_method_takes_a_quarter_of_the_step(policy, monkeypatch):
    rows = tried(monkeypatch, policy, lambda trial: QUIET)
    (_, trained), (row, other) = rows["as trained"], rows["method"]
    assert other.method == certificate.METHOD != trained.method
    batch = FlexManEnv(name=DESCRIBED.id).episodes.batch
    assert 4.0 * batch.substeps * other.step == pytest.approx(batch.control_period)
    assert row["what"].endswith("at a quarter of the step")
