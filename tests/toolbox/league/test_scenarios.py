"""Physical: whoever acts does so on other simulations of the same arms, and does about as well there."""

import numpy as np
import pytest

from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.metrics import METRICS, evaluate
from flexman_gym.evaluation.rollouts import rollout
from flexman_gym.toolbox.league import scenarios
from flexman_gym.toolbox.league.scenarios import PLANT_SCENARIOS, PLANTS, find_scenario

from oracles.assertions import refusal

ONE = Configuration("FlexOne-v0", {"horizon": 1.5, "randomisation": {"link_stiffness_factor": [0.8, 1.2]}})
SEEDS = range(9000, 9002)


def test_the_usual_plant_is_what_there_was():
    records = rollout("pd", ONE, SEEDS, set_plant=PLANTS["usual"][1]).records
    assert {name: metric.evaluate(records) for name, metric in METRICS.items()} == evaluate("pd", ONE, SEEDS)


@pytest.mark.parametrize("plant", [name for name in PLANTS if name != "usual"])
def test_other_plants_move_the_tip_about_alike(plant):
    if plant == "mujoco":
        pytest.importorskip("mujoco", minversion="4")
    ours, theirs = rollout("lqr", ONE, SEEDS), rollout("lqr", ONE, SEEDS, set_plant=PLANTS[plant][1])
    swing = np.abs(ours.tips - ours.tips[:, :1]).max()
    apart = np.abs(theirs.tips - ours.tips).max()
    assert 0.0 < apart < 0.03 * swing
    assert np.allclose(theirs.rewards, ours.rewards, rtol=0.0, atol=0.03)


@pytest.mark.slow
def test_each_arm_is_its_own_there():
    """Whose stiffness is another one moves otherwise, as far as it does on the usual plant."""
    soft = Configuration("FlexOne-v0", {"horizon": 0.6, "randomisation": {"link_stiffness_factor": [0.85, 0.85]}})
    hard = Configuration("FlexOne-v0", {"horizon": 0.6, "randomisation": {"link_stiffness_factor": [1.15, 1.15]}})
    for plant in ("method", "finer"):
        usual, other = (
            np.abs(
                rollout("lqr", hard, SEEDS, set_plant=set_plant).tips
                - rollout("lqr", soft, SEEDS, set_plant=set_plant).tips
            ).max()
            for set_plant in (PLANTS["usual"][1], PLANTS[plant][1])
        )
        assert other == pytest.approx(usual, rel=0.05), plant


def test_plants_have_names(monkeypatch):
    assert PLANT_SCENARIOS[0] == "FlexRRR-v0@method" and find_scenario("FlexRRR-v0@finer").plant == "finer"
    assert find_scenario("FlexRRR-v0/unknown@mujoco").environment == find_scenario("FlexRRR-v0/unknown").environment
    assert "give one of usual, method, finer, mujoco" in refusal(find_scenario, "FlexRRR-v0@webots")
    monkeypatch.setattr(scenarios, "find_spec", lambda name: None)
    assert "pip install mujoco" in refusal(lambda: rollout("pd", ONE, SEEDS, set_plant=PLANTS["mujoco"][1]))


def test_what_is_given_is_part_of_the_name():
    """One name is one trial: an id alone stands for the condition of the change, a condition for itself."""
    ids, lab = find_scenario("FlexRRR-v0/delay=3"), find_scenario("FlexRRR-v0/unknown-lab/delay=3")
    assert ids.given.disturbances.delay == (0, 2) and lab.given.disturbances.delay == (1, 1)
    assert find_scenario("FlexRRR-v0/nominal/delay=3").given.disturbances is None
    assert lab.given == find_scenario("FlexRRR-v0/unknown-lab").environment
    for name in ("FlexRRR-v0/delay=3", "FlexRRR-v0/unknown-lab/delay=3"):
        given = find_scenario(f"{name}+given@finer")
        assert given.environment == given.given == find_scenario(name).environment and given.plant == "finer"
    ranged = find_scenario("FlexRRR-v0/unknown-lab/payload=20:25").environment.disturbances
    assert ranged.payload_mass == (20.0, 25.0) and ranged.link_stiffness_factor == (0.7, 1.3)
    own = find_scenario("lab-flexrrr/delay=3").environment
    assert own.without(["method"]) == lab.environment and own.method == "midpoint_3", "the method of its training"


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("FlexRRR-v0/delay+given", "condition: 'delay+given' is not allowed; give one of nominal, delay, "),
        ("FlexRRR-v0/payload=5:3", "Randomisation.payload_mass: [5, 3] is not allowed; give a range (low, high)"),
        ("FlexRRR-v0/payload=5:", "sweep: 'FlexRRR-v0/payload=5:' is not allowed; give a number after payload="),
        ("FlexRRR-v0/method=rk5", "method: 'rk5' is not allowed; give one of "),
        ("FlexOne-v0/nominal/friction=1", "condition: 'FlexOne-v0/friction' is not allowed; give one for FlexRRR-v0"),
    ],
)
def test_names_of_no_scenario_are_refused_in_one_line(name, line):
    assert refusal(find_scenario, name).startswith(line)
