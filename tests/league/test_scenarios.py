"""Physical: whoever acts does so on other simulations of the same arms, and does about as well there."""

import numpy as np
import pytest

from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.metrics import evaluate
from flexman_gym.evaluation.rollout import rollout
from flexman_gym.league import scenarios
from flexman_gym.league.scenarios import PLANTS, evaluate_on_plants, find_plant, find_scenario, plant_scenarios

from oracles.assertions import refusal

ONE = Configuration("FlexOne-v0", {"horizon": 1.5, "randomisation": {"link_stiffness_factor": [0.8, 1.2]}})
SEEDS = range(9000, 9002)


def test_the_usual_plant_is_what_there_was():
    assert evaluate_on_plants("pd", ONE, SEEDS, ["usual"]) == {"usual": evaluate("pd", ONE, SEEDS)}


@pytest.mark.parametrize("plant", [name for name in PLANTS if name != "usual"])
def test_other_plants_move_the_tip_about_alike(plant):
    if plant == "mujoco":
        pytest.importorskip("mujoco", minversion="4")
    ours, theirs = rollout("lqr", ONE, SEEDS), rollout("lqr", ONE, SEEDS, moved=find_plant(plant))
    swing = np.abs(ours.tips - ours.tips[:, :1]).max()
    apart = np.abs(theirs.tips - ours.tips).max()
    assert 0.0 < apart < 0.03 * swing
    assert np.allclose(theirs.rewards, ours.rewards, rtol=0.0, atol=0.03)


def test_each_arm_is_its_own_there():
    """Whose stiffness is another one moves otherwise, as far as it does on the usual plant."""
    soft = Configuration("FlexOne-v0", {"horizon": 0.6, "randomisation": {"link_stiffness_factor": [0.85, 0.85]}})
    hard = Configuration("FlexOne-v0", {"horizon": 0.6, "randomisation": {"link_stiffness_factor": [1.15, 1.15]}})
    for plant in ("method", "finer"):
        usual, other = (
            np.abs(rollout("lqr", hard, SEEDS, moved=moved).tips - rollout("lqr", soft, SEEDS, moved=moved).tips).max()
            for moved in (find_plant("usual"), find_plant(plant))
        )
        assert other == pytest.approx(usual, rel=0.05), plant


def test_plants_have_names(monkeypatch):
    assert plant_scenarios()[0] == "FlexRRR-v0@method" and find_scenario("FlexRRR-v0@finer").plant == "finer"
    assert find_scenario("FlexRRR-v0/unknown@mujoco").environment == find_scenario("FlexRRR-v0/unknown").environment
    assert "give one of usual, method, finer, mujoco" in refusal(find_scenario, "FlexRRR-v0@webots")
    monkeypatch.setattr(scenarios, "find_spec", lambda name: None)
    assert "pip install mujoco" in refusal(evaluate_on_plants, "pd", ONE, SEEDS, ["mujoco"])
