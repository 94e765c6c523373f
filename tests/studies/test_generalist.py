"""Study of the policy for all arms: it acts on any number of joints, and its wins are counted by two criteria."""

from dataclasses import replace

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.policy_files import read_policy
from studies.generalist.measure import AGENTS, ARMS, FOLDER, LAW, PLANNED, POLICY, GeneralistRow, environment_of
from studies.generalist.page import page, wins_of

ROWS = [GeneralistRow(arm, 2, 1.0, 1.5, agent, 1.0, 2.0, 0.0, 1.0) for arm in ARMS for agent in AGENTS]
Z, Y = (0.0, 0.0, 1.0), (0.0, -1.0, 0.0)


def changed(agent, arms, **values):
    """The rows, with other values of an agent on the first arms."""
    return [replace(row, **values) if row.agent == agent and row.arm in ARMS[:arms] else row for row in ROWS]


def test_a_policy_wins_where_it_settles_as_often_and_quicker():
    assert wins_of(POLICY, ROWS) == wins_of(LAW, ROWS) == 0
    assert wins_of(POLICY, changed(POLICY, 3, settling_time=1.9)) == 3
    assert wins_of(POLICY, changed(POLICY, 3, settling_time=1.9, settled=0.95)) == 0
    assert wins_of(PLANNED, changed(LAW, 4, settling_time=np.inf, settled=0.4)) == 4


def test_the_page_has_the_decision_of_its_rows():
    quicker = [changed(POLICY, wins, settling_time=1.5) for wins in (14, 15)]
    texts = [" ".join(page(rows, {"generalist.csv": "computer"}).split()) for rows in quicker]
    assert "on 14 of 20 arms" in texts[0] and "does not take it" in texts[0]
    assert "on 15 of 20 arms" in texts[1] and "takes it" in texts[1]
    assert "| `generalist` | 0 of short, 14 of long | 20 | none | 0.75 |" in texts[0]


@pytest.mark.parametrize("joints", [1, 2, 3])
def test_the_policy_acts_on_arms_with_any_number_of_joints(joints):
    links = [fm.Link.tube(0.4, 0.02, 0.001, material="aluminium")] * joints
    axes = [Z, Y, Y][:joints]
    arm = fm.Arm(links, [fm.Joint(axis, rotor_inertia=0.02, torque_limit=6.0) for axis in axes], fm.Payload(0.1))
    environment = Configuration("FlexRRR-v0", {"arm": arm, "horizon": 1.0})
    policy, law = (fm.rollout(agent, environment, range(2)) for agent in (str(FOLDER), LAW))
    assert policy.torques.shape == law.torques.shape and np.isfinite(policy.torques).all()
    assert np.abs(policy.torques - law.torques).max() > 0.01 * 6.0  # it changes the pace


def test_the_policy_was_trained_with_the_recipe_and_tried_under_unknown_payload_and_stiffness():
    from flexman_agents.settings import Settings, find_recipe

    stored = read_policy(FOLDER).metadata["recipe"]
    settings = {name: each for name, each in stored["settings"].items() if name != "earlier_versions"}
    assert stored["name"] == "generalist" and Settings.from_dict(settings) == find_recipe("generalist")
    ranges = environment_of(ARMS[0]).randomised_ranges
    assert {"payload_mass", "link_stiffness_factor", "delay"} <= ranges.keys()
