"""Errors of unknown keywords and names: types that programs catch, and suggestions of similar names only."""

import string

import gymnasium as gym
import pytest

import flexman_gym as fm
from flexman_gym.agent.base_controllers import BASES
from flexman_gym.common.checks import one_of
from flexman_gym.common.errors import KeywordError, nearest, suggestion, unknown_name
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.envs.registration import CONDITIONS
from flexman_gym.evaluation.agents import find_agent
from flexman_gym.evaluation.metrics import METRICS
from flexman_gym.evaluation.trained_agents import AGENTS
from flexman_gym.scene.serialization import ARMS
from flexman_gym.simulation.methods import METHODS

from oracles.assertions import refusal

TABLES = {"agents": AGENTS, "environments": NAMED_ENVIRONMENTS, "conditions": CONDITIONS,
          "metrics": METRICS, "arms": ARMS, "methods": METHODS}  # fmt: skip


def arm_with(**keywords):
    return fm.Arm(fm.catalog.planar_2r().links, **keywords)


KEYWORDS = [
    lambda **given: gym.make("FlexOne-v0", **given),
    lambda **given: gym.make_vec("FlexOne-v0", 2, **given),
    lambda **given: gym.make_vec("FlexOne-v0", 2, vectorization_mode="sync", **given),
    lambda **given: Configuration("FlexOne-v0").replace(**given),
    fm.Randomisation,
    fm.catalog.planar_2r,
    fm.Joint,
    fm.Link,
    fm.Payload,
    fm.Motor,
    fm.Scene,
    arm_with,
]


@pytest.mark.parametrize("make", KEYWORDS)
def test_unknown_keyword_is_a_type_error_and_a_value_error(make):
    """The message has the words by which TorchRL recognises a keyword that it may leave out."""
    for kind in (TypeError, ValueError, KeywordError):
        with pytest.raises(kind, match="unexpected keyword argument 'frameskip'"):
            make(frameskip=1)


def test_keyword_that_is_probed_is_left_out():
    """The loop of a client: try with a keyword, and without it after a TypeError about this keyword."""
    keywords = {"frameskip": 1, "action_repeat": 2}
    while True:
        try:
            env = gym.make("FlexOne-v0", **keywords)
            break
        except TypeError as error:
            assert "unexpected keyword argument 'frameskip'" in str(error)
            keywords.pop("frameskip")
    assert env.unwrapped.configuration.action_repeat == 2


def test_unknown_key_of_a_mapping_is_a_value_error_only():
    for make in (lambda: Configuration("FlexOne-v0", {"frameskip": 1}), lambda: one_of("name", "a", ["b"])):
        with pytest.raises(ValueError) as error:
            make()
        assert not isinstance(error.value, TypeError)


@pytest.mark.parametrize("table", TABLES)
def test_misspelt_name_is_answered_with_the_name(table):
    """One letter less, one letter more, capitals and underscores, of every name of every table."""
    names = list(TABLES[table])
    for name in names:
        for typed in (name[:-1], f"{name}x", name.upper(), name.replace("-", "_")):
            near = nearest(typed, names)
            assert near == name or (near and (typed in names or len(name) < 5 or near.startswith(typed[:3]))), typed


@pytest.mark.parametrize("table", TABLES)
def test_unlike_text_is_answered_with_no_name(table):
    for typed in ("bogus", "foo", "", "x" * 10**6, string.punctuation, None, 3):
        assert nearest(typed, TABLES[table]) == "" == suggestion(typed, TABLES[table])


@pytest.mark.parametrize(
    ("action", "near"),
    [
        (lambda: fm.evaluate("lqr-trackin", "FlexOne-v0", [0]), "lqr-tracking"),
        (lambda: find_agent("ppo-flexrr"), "ppo-flexrrr"),
        (lambda: fm.evaluate("pd", "FlexRR-v0", [0]), "FlexRRR-v0"),
        (lambda: fm.evaluate("pd", "flexone-v0", [0]), "FlexOne-v0"),
        (lambda: fm.evaluate("pd", "FlexRRR-v0/unkown", [0]), "unknown"),
        (lambda: gym.make("FlexRRR-v0", condition="unkown"), "unknown"),
        (lambda: FlexManEnv(method="midpoint_corected_3"), "midpoint_corrected_3"),
        (lambda: FlexManEnv(base="lqr-trackin"), "lqr-tracking"),
        (lambda: FlexManEnv(arm="planar_2"), "planar_2r"),
        (lambda: FlexManEnv(task="slwe"), "slew"),
        (lambda: FlexManEnv(sensors="servos"), "servo"),
        (lambda: fm.Randomisation(payload_mas=(0, 1)), "payload_mass"),
    ],
)
def test_error_suggests_a_name_that_is_near(action, near):
    assert refusal(action).partition(" (unexpected")[0].endswith(f"; the nearest is {near}")


@pytest.mark.parametrize(
    "action",
    [
        lambda: fm.evaluate("bogus", "FlexOne-v0", [0]),
        lambda: fm.evaluate("pd", "bogus", [0]),
        lambda: FlexManEnv(bogus=1),
        lambda: FlexManEnv(base="bogus"),
        lambda: FlexManEnv(arm="bogus"),
    ],
)
def test_error_suggests_no_name_for_a_text_that_is_like_none(action):
    line = refusal(action)
    assert "bogus" in line and "nearest" not in line


def test_missing_path_is_a_file_that_does_not_exist_and_a_name_is_a_value():
    for name, kind in (("bogus", ValueError), ("runs/bogus", FileNotFoundError), ("bogus.yaml", FileNotFoundError)):
        error = unknown_name("agent", name, list(BASES), "a folder")
        assert type(error) is kind and str(error).startswith(f"agent: {name} does not exist; give a folder, or one of ")
