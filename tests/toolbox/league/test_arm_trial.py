"""Trial of an arm: number of episodes, refused designs, and the choice among controllers."""

from dataclasses import replace

import numpy as np
import pytest

from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.toolbox.league import arm_trial
from flexman_gym.toolbox.league.arm_trial import KNOWN, UNKNOWN, Trial, choose, try_agents, unknown_settings

QUICK = Trial("quick", KNOWN, 20, 1.0, 0.5)
SLOW = Trial("slow", KNOWN, 20, 1.0, 2.0)
LOOSE = Trial("loose", KNOWN, 20, 0.9, 0.1)
ADAPTIVE = Trial("adaptive", UNKNOWN, 20, 1.0, 0.4)


@pytest.mark.parametrize(
    ("trials", "chosen"),
    [
        ((SLOW, QUICK, LOOSE, ADAPTIVE), "quick"),
        ((LOOSE, ADAPTIVE), "loose"),
        ((Trial("bad", KNOWN, 20, 0.0),), None),
        ((Trial("refused", KNOWN, refusal="gains: none"), SLOW), "slow"),
        ((Trial("refused", KNOWN, refusal="gains: none"),), None),
    ],
)
def test_the_quickest_controller_that_settles_is_recommended(trials, chosen):
    found, reason = choose(trials)
    assert (found.agent if found else None) == chosen and reason
    assert ("adaptive" in reason) == (chosen == "quick")


def test_a_recommended_controller_that_reads_the_true_state_has_a_measured_one_beside_it():
    trials = [Trial("lqr-tracking", KNOWN, 20, 1.0, 1.0), Trial("pd", KNOWN, 20, 1.0, 3.0)]
    found, reason = choose(trials)
    assert found.agent == "lqr-tracking" and "reads the true state" in reason and "for a real arm pd" in reason
    assert "for a real arm" not in choose(trials[:1])[1] and "true state" not in choose(trials[1:])[1]


def test_the_shaper_is_tried_on_a_hanging_load(monkeypatch):
    monkeypatch.setattr(arm_trial, "EPISODES", 2)
    monkeypatch.setattr(arm_trial, "TRIAL_AGENTS", {})
    (found,) = try_agents(Configuration("FlexCrane-v0", {"horizon": 1.0}))
    assert found.agent == "pd-shaped" and not found.refusal and found.episodes == 2
    assert list(try_agents(Configuration("FlexOne-v0"))) == []


def test_an_unknown_arm_has_payload_stiffness_delay_and_the_sensors_of_a_laboratory():
    environment = Configuration("FlexPlanar-v0")
    heavy = environment.replace(arm=replace(environment.arm, payload=replace(environment.arm.payload, mass=0.3)))
    settings = unknown_settings(heavy)
    ranges = settings["randomisation"]
    assert ranges["payload_mass"] == pytest.approx([0.0, 0.6]) and ranges["joint_stiffness_factor"] == [0.7, 1.3]
    assert settings["sensors"] == "lab" and ranges["delay"] == [1, 1] and "arm" not in settings


def test_a_trial_has_the_metrics_of_its_episodes_and_a_refused_design_its_message(monkeypatch):
    monkeypatch.setattr(arm_trial, "EPISODES", 3)
    environment = Configuration("FlexOne-v0", {"horizon": 4.0})
    own = environment.replace(arm=replace(environment.arm, links=[replace(environment.arm.links[0], length=0.7)]))
    found = list(
        try_agents(own.replace(gains={"stiffness": [1.0], "damping": [1.0, 2.0]}), {"pd-torque": KNOWN, "pd": KNOWN})
    )
    assert found[0].episodes == 3 and not found[0].refusal and 0.0 <= found[0].settled <= 1.0
    assert np.isfinite(found[0].settling_time) == (found[0].settled > 0.5)
    assert "gains.damping" in found[1].refusal and found[1].episodes == 0


@pytest.mark.parametrize(("seconds", "episodes"), [(0.1, 18), (10.0, 3), (40.0, 0)])
def test_slow_controllers_have_fewer_episodes(seconds, episodes):
    assert arm_trial._affordable(seconds) == episodes
