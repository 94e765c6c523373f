"""Predicting: any object with `predict` is an entrant, and acts as the environment says that an agent does."""

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.envs.description import Description
from flexman_gym.evaluation import find_entrant, rollout
from flexman_gym.evaluation.entrants import load_shipped, predicting
from flexman_gym.evaluation.shipped import read_shipped, write_shipped

from oracles.shipped import made_up

AGENT = {"base": "pd", "hold": 3, "history": 2, "sensors": ["full", "fine"]}
BARE = Description("FlexOne-v0", {"horizon": 0.6})
WHOLE = Description("FlexOne-v0", {"horizon": 0.6, **AGENT})


class Own:
    """Gives the same action whatever it sees, and remembers the sizes of that."""

    def __init__(self, action):
        self.action, self.sizes = action, set()

    def predict(self, observations):
        self.sizes.add(observations.shape[1:])
        return np.full((len(observations), 1), self.action)


def test_it_adds_to_the_base_and_holds_as_the_environment_says():
    still, pushing = Own(0.0), Own(0.2)
    assert np.array_equal(rollout(still, WHOLE, [0, 1]).actions, rollout("pd", BARE, [0, 1]).actions)
    more = rollout(pushing, WHOLE, [0, 1]).actions
    assert not np.array_equal(more, rollout("pd", BARE, [0, 1]).actions)
    assert np.allclose(rollout(pushing, BARE, [0]).actions, 0.2), "nothing acts beside it where nothing is named"
    assert still.sizes == {(2 * 32,)} and pushing.sizes == {(2 * 32,), (18,)}


def test_its_actions_may_come_first_of_a_pair_and_end_at_one():
    class Pair(Own):
        def predict(self, observations, deterministic=False):
            assert deterministic
            return super().predict(observations), None

    assert np.array_equal(rollout(Pair(7.0), BARE, [0]).actions, np.ones((1, 30, 1)))
    assert find_entrant(Pair(0.0)).name == "Pair"


def test_it_is_evaluated_in_one_line():
    assert fm.evaluate(Own(0.0), WHOLE, [0, 1]) == fm.evaluate("pd", BARE, [0, 1])


@pytest.mark.parametrize(
    "condition",
    [
        "nominal",
        pytest.param("unknown-lab", marks=pytest.mark.xfail(
            reason="sensors of an agent and of a controller draw their noise from different streams", strict=True)),
    ],
)  # fmt: skip
def test_a_policy_acts_alike_whether_its_network_is_asked_or_it_is_loaded_from_its_files(condition, tmp_path):
    """The same weights, seeds and sensors: the same noise, bias and lost samples, hence the same actions."""
    agent = {"base": "pd", "hold": 2, "sensors": "lab", "horizon": 0.4}
    described = Description.from_dict(
        {"id": "FlexPlanar-v0", **Description.under("FlexPlanar-v0", condition).whole_settings(), **agent}
    )
    write_shipped(tmp_path, *made_up(described))
    network = read_shipped(tmp_path)[1]

    class Live:
        def predict(self, observations):
            return network(observations)

    entrants = load_shipped(tmp_path), predicting(Live(), described)
    loaded, live = (rollout(each, described, [0, 1]) for each in entrants)
    assert np.array_equal(loaded.actions, live.actions)
