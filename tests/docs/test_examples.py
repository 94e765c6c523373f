"""Examples: what the docstrings of public names show runs, and gives what they say."""

import doctest

import gymnasium as gym
import pytest

import flexman_gym as fm
from flexman_gym.envs import FlexManEnv

# What people type most; every other name may have an example.
USUAL = {
    "Arm", "FlexManEnv", "Joint", "Link", "Motor", "Payload", "SampledTorque", "Scene", "Simulator", "acceleration",
    "Fit", "Model", "choose_model", "curves", "evaluate", "frequencies", "linearize", "mass_matrix", "modes",
    "paper_rrr", "rollout", "simulate",
}  # fmt: skip
PUBLIC = {name: getattr(fm, name) for name in fm.__all__} | vars(fm.catalog) | {"FlexManEnv": FlexManEnv}
FOUND = {
    name: [each for each in doctest.DocTestFinder(exclude_empty=True).find(value, name) if each.examples]
    for name, value in PUBLIC.items()
    if callable(value)
}


def test_the_usual_names_have_examples():
    assert {name for name, examples in FOUND.items() if examples} >= USUAL


@pytest.mark.parametrize("name", sorted(name for name, examples in FOUND.items() if examples))
def test_examples_run_and_give_what_they_say(name):
    for each in FOUND[name]:
        each.globs = {"fm": fm, "gym": gym}
        said = []
        result = doctest.DocTestRunner(optionflags=doctest.FAIL_FAST).run(each, out=said.append)
        assert result.attempted and not result.failed, "".join(said)
