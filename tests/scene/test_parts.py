"""Parts of a scene: torques, times and the choice of a model say what they mean and refuse the rest."""

import math
import warnings
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flexman_gym.scene.choice import ModelChoice
from flexman_gym.scene.drive import ConstantTorque, SineTorque
from flexman_gym.scene.scene import Initial, Scene

from oracles.files import REFERENCE
from oracles.refusals import refusal

# Of the printed area of link 1 in the reference scene.
pytestmark = pytest.mark.filterwarnings("ignore:Link.second_moment_y:UserWarning")
with warnings.catch_warnings():
    warnings.simplefilter("ignore", UserWarning)
    SCENE = Scene.load(REFERENCE / "paper_ff.json")
triples = st.tuples(*[st.floats(0.0, 100.0)] * 3)


@given(st.builds(ConstantTorque, triples) | st.builds(SineTorque, triples, triples, triples), st.floats(0.0, 10.0))
def test_the_signals_of_a_torque_are_its_formula(torque, time):
    signals = torque.signals()
    assert len(signals) == 3 and all(signal.start == 0.0 and signal.stop is None for signal in signals)
    numbers = [(signal.offset, signal.amplitude, signal.frequency_hz, signal.phase) for signal in signals]
    offset, amplitude, frequency_hz, phase = np.transpose(numbers)
    expected = offset + amplitude * np.sin(2.0 * np.pi * frequency_hz * time + phase)
    assert torque.at(time) == pytest.approx(expected, rel=0.0, abs=1e-8)


def test_a_torque_at_a_quarter_of_its_period_is_its_amplitude():
    assert SineTorque([3.0, 2.0], [0.25, 0.25], [0.0, math.pi / 2]).at(1.0) == pytest.approx([3.0, 0.0])
    assert ConstantTorque([3.0, 2.0]).at(1.0) == pytest.approx([3.0, 2.0])


@given(st.integers(1, 100_000), st.floats(1e-6, 1e3))
def test_output_times_run_from_zero_to_the_duration(steps, output_step):
    times = replace(SCENE, duration=steps * output_step, output_step=output_step).output_times
    assert times.shape == (steps + 1,)
    assert times[0] == 0.0 and times[-1] == steps * output_step
    assert np.allclose(np.diff(times), output_step, rtol=1e-6, atol=0.0)


@pytest.mark.parametrize(
    ("duration", "output_step"), [(1.5, 0.4), (1.0, 2.0), (1.0, 0.333), (1e300, 1e-300), (1.0, 1e-8)]
)
def test_the_duration_is_a_whole_number_of_output_steps(duration, output_step):
    line = refusal(lambda: replace(SCENE, duration=duration, output_step=output_step))
    assert line.startswith(f"Scene.output_step: {output_step} is not allowed")


@pytest.mark.parametrize(
    ("part", "value", "field"),
    [
        ("arm", None, "arm"),
        ("model", {}, "Scene.model"),
        ("torque", (1.0, 1.0, 1.0), "Scene.torque"),
        ("initial", (0.0, 0.0, 0.0), "Scene.initial"),
        ("note", 1, "Scene.note"),
        ("model", ModelChoice(True, (2, 2)), "Scene.model.elements"),
        ("model", ModelChoice((True,), 2), "Scene.model.flexible_links"),
        ("model", ModelChoice(True, 2, (1, 1, 1, 1)), "Scene.model.modes"),
        ("torque", ConstantTorque([1.0]), "Scene.torque.value"),
        ("torque", SineTorque([1.0], [1.0], [1.0]), "Scene.torque.amplitude"),
        ("initial", Initial([0.0], [0.0]), "Scene.initial.joint_angles"),
    ],
)
def test_the_parts_of_a_scene_fit_each_other(part, value, field):
    assert refusal(lambda: replace(SCENE, **{part: value})).startswith(f"{field}: ")


@pytest.mark.parametrize(
    ("entries", "field"),
    [
        ({"flexible_links": 1}, "flexible_links"),
        ({"flexible_links": [True, "no"]}, "flexible_links[1]"),
        ({"elements": 0}, "elements"),
        ({"elements": 65}, "elements"),
        ({"elements": 2.0}, "elements"),
        ({"elements": True}, "elements"),
        ({"elements": ()}, "elements"),
        ({"elements": np.array([2, 65])}, "elements[1]"),
        ({"modes": -1}, "modes"),
        ({"modes": [385]}, "modes[0]"),
        ({"modes": [4, (0, 384)]}, "modes[1][1]"),
        ({"modes": [4, (3, 1)]}, "modes[1]"),
        ({"modes": [4, (1, 1)]}, "modes[1]"),
        ({"modes": [()]}, "modes[0]"),
        ({"flexible_joints": None}, "flexible_joints"),
        ({"stiffening": "yes"}, "stiffening"),
        ({"rotary_inertia": 0}, "rotary_inertia"),
    ],
)
def test_a_model_choice_refuses(entries, field):
    line = refusal(lambda: ModelChoice(**({"flexible_links": True, "elements": 2} | entries)))
    assert line.startswith(f"ModelChoice.{field}: ")


def test_a_model_choice_takes_one_value_or_one_for_each_link():
    assert ModelChoice(np.array([True, False]), np.array([2, 3]), [4, 0]) == ModelChoice((True, False), (2, 3), (4, 0))
    assert ModelChoice(True, 2).modes is None
    assert ModelChoice(True, 2, [3, np.array([0, 2])]).modes == (3, (0, 2))


def test_sine_torques_agree_in_length_and_have_no_negative_frequency():
    assert refusal(SineTorque, [1.0, 1.0], [1.0], [0.0, 0.0]).startswith("SineTorque.frequency_hz: ")
    assert refusal(SineTorque, [1.0], [-1.0], [0.0]).startswith("SineTorque.frequency_hz[0]: -1.0")
    assert refusal(Initial, [0.0], [0.0, 0.0]).startswith("Initial.joint_rates: ")
