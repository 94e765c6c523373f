"""Tests of public names: `fm` lists them, they are typed, and `help` explains them with units."""

import pydoc
from collections.abc import Mapping

import gymnasium as gym
import pytest

import flexman_gym as fm
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.tasks import Slew

from oracles.assertions import refusal


def told(value):
    """Return the output of `help` for a value."""
    return " ".join(pydoc.render_doc(value, renderer=pydoc.plaintext).split())


def test_packages_that_pages_reach_through_fm_are_public():
    """A package is an attribute once it is imported; those that are meant to be used so are in `__all__`."""
    assert {"catalog", "control", "draw", "metrics"} <= set(fm.__all__)
    assert fm.control.PD and fm.control.LQR


@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("METHODS", ("order", "kind", "step", "(s)", "rtol", "Integration methods")),
        ("catalog", ("SI units", "m, kg, s, rad", "N m", "Hz")),
        ("rollout", ("tips (b, T + 1, 3) m", "errors (b, T + 1) m", "torques (b, T, n) N m", "the control period (s)")),
        ("evaluate", ("settling_time (s)", "vibration (m)", "error (m)")),
        ("tune", ("N m/rad", "N m s/rad", "degrees")),
    ],
)
def test_help_has_units(name, parts):
    text = told(getattr(fm, name))
    assert [part for part in parts if part not in text] == []


def test_methods_are_a_mapping_by_name():
    assert isinstance(fm.METHODS, Mapping) and fm.METHODS["rk4"].order == 4 and "dop853" in fm.METHODS


@pytest.mark.parametrize("suffix", ["yaml", "json"])
@pytest.mark.parametrize(
    "given",
    [
        Configuration("FlexOne-v0", {"randomisation": {"delay": (1, 1)}, "base": "pd", "action_repeat": 2}),
        Configuration("FlexRRR-v0", {"arm": {"catalog": "paper_rrr", "torque_limit": 300.0}, "task": {"kind": "slew"}}),
        Configuration("FlexRRR-v0", {"condition": "unknown-lab", "limits": {"angle": 2.0}, "reward": {"effort": 0.0}}),
        Configuration(),
        Configuration(
            "FlexOne-v0", {"history": (0.1, 0.5), "modes": (2,), "sensors": ("full", "fine"), "info_keys": ["tip"]}
        ),
    ],
)
def test_a_description_is_saved_and_loaded(given, suffix, tmp_path):
    """The file holds the whole environment: arm, condition and gains."""
    path = tmp_path / f"env.{suffix}"
    given.save(path)
    same = Configuration.load(path)
    (one, _), (other, _) = ((gym.make(each.id, **each.keywords()).reset(seed=1), 0) for each in (given, same))
    assert (one[0] == other[0]).all()
    own, read = given, same
    for name in (
        "arm",
        "task",
        "limits",
        "horizon",
        "action_repeat",
        "gains",
        "reward",
        "control_period",
        "torque_limit",
    ):
        assert getattr(own, name) == getattr(read, name), name
    assert fm.rollout("zero", str(path), 1).lengths[0] > 0


def test_an_environment_made_of_objects_is_saved(tmp_path):
    arm = fm.catalog.paper_rrr(rotor_inertia=9.0, torque_limit=300.0)
    parts = {"arm": arm, "task": Slew(slew=0.3), "limits": fm.Limits(angle=2.0), "torque_limit": (1.0, 2.0, 3.0)}
    env = gym.make("FlexRRR-v0", **parts)
    env.unwrapped.configuration.save(tmp_path / "env.yaml")
    setup = Configuration.load(tmp_path / "env.yaml")
    assert (setup.arm, setup.task, setup.limits.angle) == (arm, Slew(slew=0.3), 2.0)
    assert setup.torque_limit == (1.0, 2.0, 3.0)


def test_a_description_with_an_object_of_ones_own_or_another_suffix_is_not_saved(tmp_path):
    own = Configuration("FlexOne-v0", {"reward": lambda view: 0.0})
    assert refusal(own.save, tmp_path / "env.yaml").startswith("reward: ")
    assert "suffix" in refusal(Configuration("FlexOne-v0").save, tmp_path / "env.txt")


@pytest.mark.slow
def test_gains_are_tuned_from_python_and_used():
    """A gain margin of 2 and a phase margin of 30 degrees, as of the command."""
    found = fm.tune("FlexOne-v0", around=1, episodes=1)
    assert found.margins.gain >= 2.0 and found.margins.phase >= 30.0
    env = gym.make("FlexOne-v0", base="pd", gains=found.gains)
    assert env.unwrapped.configuration.gains == {"stiffness": found.stiffness, "damping": found.damping}
