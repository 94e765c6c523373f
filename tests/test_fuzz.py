"""Fuzz tests: odd calls and defective files work or raise a clear one-line error; see `oracles.fuzz` and `.mutants`."""

import time
from dataclasses import replace

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym import metrics
from flexman_gym.agent.pd import PD
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.model.assembled_modes import assembled_modes
from flexman_gym.toolbox.controllers.lqr import LQR
from flexman_gym.toolbox.fidelity.mesh_search import MeshSearch
from flexman_gym.toolbox.fidelity.model_search import CANDIDATE_METHODS

from oracles import fuzz
from oracles.fuzz import arguments, described, outcome, too_much
from oracles.fuzz_targets import JOINT, LINK, ONE, PARTS, SCENE, TARGETS, Target, arm_of
from oracles.odd_values import BAD, fits

CALLS, FILES = 8, 100  # of each target, and in all


@pytest.fixture(scope="module", autouse=True)
def compiled():
    """Compile the methods tried by `choose_model`, since compiling one exceeds the time limit of a call."""
    for method in {*CANDIDATE_METHODS, *MeshSearch.methods}:
        fm.simulate(SCENE, method=method, step=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("name", TARGETS)
def test_a_call_with_odd_arguments_works_or_is_refused_in_one_line(name):
    target = TARGETS[name]
    target.call(**target.good)  # compiles what it needs
    assert outcome(target, target.good, {}) == ("works", "")
    for seed in range(CALLS):
        _, given, strange = arguments(seed, name)
        if not too_much(target, strange):
            kind, what = outcome(target, given, strange)
            assert kind != "finding", f"seed {seed}: {what}: {described(strange)}"


@pytest.mark.slow
def test_a_broken_file_is_read_or_refused_in_one_line(tmp_path):
    pytest.importorskip("stable_baselines3")
    from oracles import mutants

    kinds = [mutants.outcome(seed, tmp_path) for seed in range(FILES)]
    assert [(seed, what) for seed, (kind, what) in enumerate(kinds) if kind == "finding"] == []
    assert {kind for kind, _ in kinds} == {"read", "refused"}


WIDE = replace(SCENE.arm, links=[replace(LINK, area=1.27e19)] * 2)
SHORT = arm_of(**PARTS | {"length": 8.187e-20})
HEAVY = replace(SCENE.arm, joints=[replace(JOINT, damping=9.2e18)] * 2)
FOUND = [  # by the fuzz, once
    (metrics.rms, (int,), "values"),
    (metrics.rms, (range(10**9),), "values"),
    (metrics.rms, ([1e200],), "values"),
    (metrics.final_error, (["a", "b"], 1.0), "errors"),
    (metrics.overshoot, (10**400, 1.0), "errors"),
    (metrics.median_interval, ([1.0], -3.0), "level"),
    (metrics.median_interval, ([1.0], 0.9, 0.5), "draws"),
    (metrics.median_interval, ([1.0] * 1000, 0.9, 10**6), "draws"),
    (metrics.squared_acceleration, ([1.0, 2.0], 1.7e308), "period"),
    (metrics.peak_to_peak, (np.zeros((3, 3)), 5e-324), "period"),
    (fm.frequencies, (3,), "model"),
    (lambda arm: fm.frequencies(fm.build_model(arm, 1)), (SHORT,), "arm"),
    (lambda arm: fm.linearize(fm.build_model(arm, 1)), (SHORT,), "arm"),
    (lambda arm: LQR(fm.build_model(arm, 1), 1.0, 0.01).gain(np.zeros(2)), (HEAVY,), "arm"),
    (assembled_modes, (WIDE,), "arm"),
    (PD, ([1.0], [1.0], 3e206), "PD.torque_limit"),
    (lambda step: fm.simulate(SCENE, method="ros2", step=step), (1.7e308,), "step"),
    (Configuration.find, (["a"],), "environment"),
    (Configuration().changed, (3,), "--set"),
    (Configuration().changed, ([3.0],), "--set"),
    (Configuration.from_plain, ({None: 1.0},), "a key of environment"),
    (Configuration.from_plain, ({"randomisation": {3: (0, 1)}},), "a key of randomisation"),
    (Configuration.from_plain, ({"arm": {"catalog": "one_link", 3: 1.0}},), "a key of arm"),
    (Configuration.from_plain, ({"arm": {"catalog": "one_link", "x": 1.0}},), "arm"),
    (Configuration.from_plain, ({"history": b"12"},), "history"),
    (Configuration.from_plain, ({"history": np.array(1)},), "history"),
    (fm.Scene.from_dict, ({"\n": 1.0},), "'\\n'"),
    (fm.Scene.from_dict, ({"x" * 1000: 1.0},), "x" * 60),
    (ONE.set_state, ({**ONE.get_state(), "episodes": {("a",): 1}},), "state.episodes"),
]


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize(("call", "given", "field"), FOUND)
def test_what_the_fuzz_has_found_is_refused_by_name(call, given, field):
    with pytest.raises(ValueError) as error:
        call(*given)
    assert str(error.value).startswith(f"{field}: ") and fits(str(error.value))


@pytest.mark.filterwarnings("error")
def test_numbers_of_odd_sizes_and_types_are_numbers():
    decay = np.exp(-0.01 * np.arange(100.0)) * np.cos(np.arange(100.0))
    tiny = metrics.damping_ratio(2.0**-1040 * decay)
    assert metrics.damping_ratio(decay) == pytest.approx(tiny, rel=1e-3)  # of ten digits that are left
    assert metrics.settling_time([1.0, 0.0], 0.5, np.uint64(2**63)) == np.inf
    assert fm.simulate(SCENE, method="dop853", step=5e-324).status == "ok"


def refuse(line):
    """Raise a one-line error."""
    raise ValueError(line)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda value: {}[value], "KeyError"),
        (lambda value: len(None), "TypeError"),
        (lambda value: refuse("no"), "ValueError"),
        (lambda value: refuse("value: 1 is not allowed; give\n2"), "ValueError"),
        (lambda value: refuse("value: 1 is not allowed; give " + 440 * "2"), "ValueError"),
        (lambda value: (np.zeros(2), {"a": [np.nan]}), "not finite"),
        (lambda value: np.isinf(np.float64(1e300) * np.float64(1e300)), "RuntimeWarning"),
        (lambda value: time.sleep(0.1), "took more than"),
        (lambda value: 1.0, "no number"),
    ],
)
def test_the_fuzz_finds_what_is_planted(call, said, monkeypatch):
    monkeypatch.setattr(fuzz, "LONGEST", 0.05)
    numbers = ("value",) if said == "no number" else ()
    kind, what = outcome(Target(call, {"value": 1.0}, numbers), {"value": BAD[0]}, {"value": BAD[0]})
    assert kind == "finding" and said in what


def test_a_good_line_is_known():
    assert fits("Link.length: -1.0 is not allowed; give a number from 1e-30 to 1e+30 (m)") and not fits("no")
