"""Base controllers by name and their arguments."""

import numpy as np
import pytest

from flexman_gym.agent.base_controllers import BASES, make_base
from flexman_gym.agent.pd import PD
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.config.plant import make_plant
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.evaluation.metrics import evaluate
from flexman_gym.evaluation.rollouts import rollout
from flexman_gym.toolbox.controllers.cost_weights import CostWeights, NamedWeights
from flexman_gym.toolbox.controllers.input_shaping.shaped_controller import InputShapedController
from flexman_gym.toolbox.controllers.lqr import LQR, TrackingLQR
from flexman_gym.toolbox.controllers.output_feedback import OutputFeedback
from flexman_gym.toolbox.controllers.torque_feedback_pd import TorqueFeedbackPD

from oracles.assertions import refusal

ONE = Configuration("FlexOne-v0", {"horizon": 0.4})
GAINS = {"stiffness": (2.0,), "damping": (0.3,)}
WEIGHTS = {"tip": 0.1, "tip_speed": 0.5, "motor": 0.2}


def plant(name="FlexOne-v0"):
    setup = Configuration.from_keywords({"name": name})
    return make_plant(setup, resolve_fidelity(setup).model)._replace(gains=lambda: GAINS)


KINDS = {
    "pd": PD, "pd-torque": TorqueFeedbackPD, "pd-shaped": InputShapedController, "lqr": LQR,
    "lqr-tracking": TrackingLQR, "adaptive-lqr": OutputFeedback, "privileged-lqr": OutputFeedback,
}  # fmt: skip


@pytest.mark.parametrize(("name", "kind"), KINDS.items())
def test_a_name_makes_the_controller_of_that_name(name, kind):
    result = make_base(name, plant())
    assert type(result) is kind
    assert ("true state" in BASES[name].information) == ("state" in result.sensors), "who reads the state knows it"


def test_a_mapping_gives_arguments_in_place_of_what_is_usual():
    assert make_base("pd", plant()).stiffness.tolist() == [2.0]
    own = make_base({"kind": "pd", "damping": [0.1]}, plant())
    assert (own.stiffness.tolist(), own.damping.tolist()) == ([2.0], [0.1])
    weights = make_base({"kind": "lqr", "weights": WEIGHTS}, plant()).weights
    assert weights == CostWeights(**WEIGHTS) != make_base("lqr", plant()).weights
    assert make_base({"kind": "lqr-tracking", "timing": "trapezoid"}, plant()).timing == "trapezoid"


def test_the_design_follows_from_the_arm_and_is_an_argument():
    """The fixed design is that of the arms for which it was tuned; policies trained on it name it for any arm."""
    named, other = plant(), plant()._replace(named_period=None)
    for given, design, expected in (
        (named, None, True), (other, None, False), (named, "arm", False), (other, "named", True),
    ):  # fmt: skip
        own = make_base({"kind": "lqr-tracking"} | ({"design": design} if design else {}), given)
        assert own.scales.named == expected == isinstance(own.weights, NamedWeights)
    line = refusal(make_base, {"kind": "adaptive-lqr", "design": "mine"}, named)
    assert line == "base.design: 'mine' is not allowed; give one of arm, named"


def test_times_of_a_named_arm_last_as_long_at_any_control_period():
    """A time unit of adaptation is a control period of the named environment; without one it is the present period."""
    for kind in ("adaptive-lqr", "privileged-lqr"):
        for factor in (1, 4):
            quick = plant()._replace(period=plant().period / factor)
            assert make_base(kind, quick).law.unit == factor
            assert make_base({"kind": kind, "design": "named"}, quick._replace(named_period=None)).law.unit == 1


def test_a_shaped_pd_takes_the_arguments_of_both():
    own = make_base({"kind": "pd-shaped", "damping": [0.1], "shaper": "ei", "modes": 2, "duration": 0.4}, plant())
    assert (own.inner.stiffness.tolist(), own.inner.damping.tolist()) == ([2.0], [0.1])
    assert (own.shaper, own.duration, make_base("pd-shaped", plant()).shaper) == ("ei", 0.4, "zvd")


def test_only_under_gravity_a_pd_holds_the_weight():
    assert make_base("pd", plant()).gravity_model is None
    heavy = plant("FlexPlanar-v0")._replace(gains=lambda: {"stiffness": (1.0, 1.0), "damping": (0.1, 0.1)})
    assert make_base("pd", heavy).gravity_model is heavy.model


@pytest.mark.parametrize(
    ("base", "line"),
    [
        ({"kind": "pid"}, f"base.kind: 'pid' is not allowed; give one of {', '.join(BASES)}"),
        ({"weights": WEIGHTS}, "base: {'weights': {'tip': 0.1, 'tip_speed': 0.5, 'motor': 0.2}} is not allowed; give"),
        ({"kind": "pd", "weights": WEIGHTS}, "base: "),
        ({"kind": "lqr", "timing": "trapezoid"}, "base: "),
        (
            {"kind": "lqr-tracking", "timing": "bang-bang"},
            "timing: 'bang-bang' is not allowed; give one of time-optimal, quintic",
        ),
        (
            {"kind": "lqr", "weights": {"tip": 0.1}},
            "base.weights: {'tip': 0.1} is not allowed; give a mapping with tip",
        ),
        ({"kind": "lqr", "weights": WEIGHTS | {"tip": 0.0}}, "base.weights.tip: 0.0 is not allowed; give a finite"),
        ({"kind": "pd", "damping": [0.1, 0.2, 0.3, 0.4]}, "PD.damping: "),
    ],
)
def test_what_is_no_base_is_refused_in_one_line(base, line):
    said = refusal(lambda: FlexManEnv(base=base))
    assert said.startswith(line) and "\n" not in said


def test_an_environment_and_an_evaluation_build_the_same_base():
    """The mapping beside an agent that does nothing, in a file, and as an entrant."""
    base = {"kind": "lqr", "weights": WEIGHTS}
    described = Configuration.from_plain({"id": "FlexOne-v0", "horizon": 0.4, "base": base})
    assert described.to_plain()["base"] == base
    entrant, plain = rollout(base, ONE, [1, 2]), rollout("lqr", ONE, [1, 2])
    env = FlexManEnv(name="FlexOne-v0", horizon=0.4, base=base)
    env.reset(seed=1)
    asked = []
    for _ in range(20):
        env.step(np.zeros(1, dtype=np.float32))
        asked.append(env.episodes.view.action[0].copy())
    assert np.array_equal(entrant.actions[0], asked) and (entrant.actions != plain.actions).any()
    assert evaluate(base, ONE, [1]) == evaluate(base, ONE, [1])
