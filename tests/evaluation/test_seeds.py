"""Seeds: a number of episodes means the first test seeds, and a policy of another arm is refused by its name."""

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.envs.description import Description
from flexman_gym.evaluation.seeds import TEST

from oracles.refusals import refusal

SHORT = Description("FlexOne-v0", {"horizon": 0.2})


def test_a_number_of_episodes_is_that_of_the_first_test_seeds():
    """Those of `flexman evaluate --episodes`."""
    assert fm.rollout("pd", SHORT, 3).about["seeds"] == list(TEST[:3])
    assert fm.evaluate("pd", SHORT, 3) == fm.evaluate("pd", SHORT, TEST[:3]) == fm.evaluate("pd", SHORT, np.int64(3))
    assert fm.rollout("pd", SHORT, np.arange(2)).about["seeds"] == [0, 1]


@pytest.mark.parametrize("wrong", [0, -1, True, 2.0, None, "10", []])
def test_other_numbers_are_refused(wrong):
    line = refusal(fm.evaluate, "pd", SHORT, wrong)
    assert line.startswith("seeds: ") and "\n" not in line


@pytest.mark.parametrize("name", ["ppo-flexplanar", "shaping-flexrrr", "lab-flexrrr"])
def test_a_policy_of_another_arm_is_refused_by_its_name(name):
    own, other = ("FlexPlanar-v0", "FlexRRR-v0") if "planar" in name else ("FlexRRR-v0", "FlexOne-v0")
    line = refusal(fm.evaluate, name, other, 1)
    assert line.startswith(f"entrant: '{name}' is not allowed; give ") and own in line and other in line
