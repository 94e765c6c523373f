"""Tests of the experiment in docs/concepts.md: numbers, simulation in Chromium, and statements of the page."""

import json
from itertools import pairwise, product

import numpy as np
import pytest
import ringing

import flexman_gym as fm

from oracles.browser import one_browser
from oracles.files import ROOT

ASSETS = ROOT / "docs" / "assets"
ARM = json.loads((ASSETS / ringing.FILE).read_text(encoding="utf-8").partition("= ")[2].rstrip(";\n"))
MODEL = ringing.nominal_model()
SIMULATE = "const {states, tip, ...rest} = ringing.simulate(arguments[0]); return {states, tip, ...rest}"
NOMINAL = {"payload": ARM["payload"], "stiffness": 1.0, "motion": 0.71, "control": "none", "tap": False}
PERIOD = 1.0 / ARM["frequency"]  # s; period of the nominal arm
PLACE = '<meta charset="utf-8"><div id="ringing"></div>'

browser = pytest.fixture(one_browser, scope="module")


@pytest.fixture(scope="module")
def page(browser, tmp_path_factory):
    """Return a browser with the experiment alone."""
    path = tmp_path_factory.mktemp("ringing") / "page.html"
    scripts = [f'<script src="{(ASSETS / name).as_uri()}"></script>' for name in (ringing.FILE, "ringing.js")]
    path.write_text(PLACE + "".join(scripts), encoding="utf-8")
    browser.open(path.as_uri(), "document.querySelector('#ringing canvas')")
    assert browser.said() == []
    return browser


def flat(value):
    """Yield the numbers of nested mappings and sequences."""
    if isinstance(value, dict):
        value = value.values()
    elif np.ndim(value) == 0:
        yield float(value)
        return
    for each in value:
        yield from flat(each)


def test_the_numbers_are_those_of_the_library():
    computed = ringing.arm_data(MODEL)
    assert list(computed) == list(ARM)
    for name, value in computed.items():
        ours, theirs = ([*flat(each)] for each in (value, ARM[name]))
        np.testing.assert_allclose(theirs, ours, rtol=0.0, atol=1e-9 * np.abs(ours).max(), err_msg=name)


def test_the_matrices_are_affine_in_payload_and_stiffness():
    for payload, factor in np.random.default_rng(1).uniform([0.0, 0.2], [0.2, 3.0], (5, 2)):
        made = (np.array(ARM["mass"]) + payload * np.array(ARM["massByPayload"]),
                np.array(ARM["stiffness"]) + factor * np.array(ARM["stiffnessByFactor"]), ARM["damping"])  # fmt: skip
        for ours, theirs in zip(made, ringing.matrices(MODEL, payload, factor), strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=1e-12 * np.abs(theirs).max())


def test_two_bending_modes_suffice():
    """The first frequency is within 0.1 % of that of eight elements without modal reduction."""
    fine = fm.build_model(MODEL.arm, elements=8)
    for changes in product((0.0, 0.2), (0.2, 3.0)):
        ours, theirs = (
            fm.frequencies(ringing.changed_model(each, *changes), lock_joints=True) for each in (MODEL, fine)
        )
        assert ours[0] == pytest.approx(theirs[0], rel=1e-3)


def command(time, motion, shaper):
    """Return angle and rate of the command at times (T,): the integral of a constant acceleration, then braking."""
    angle, rate = np.zeros((2, len(time)))
    for delay, share in zip(shaper["times"], shaper["amplitudes"], strict=True):
        knots = delay + np.array([0.0, 0.5, 1.0]) * motion
        peak = 2.0 * share * ARM["angle"] / motion  # rad/s
        rate += np.interp(time, knots, [0.0, peak, 0.0], left=0.0, right=0.0)
        first, second = (np.clip(time - knots[i], 0.0, motion / 2.0) for i in (0, 1))
        angle += peak / motion * first**2 + peak * second - peak / motion * second**2
    return angle, rate


def simulated(settings):
    """Return states (T, 2 d) and torques of the sampled linear model of the library under the same control."""
    linear = ringing.linear_model(MODEL, settings["payload"], settings["stiffness"])
    sampled, d = linear.discrete(ARM["period"]), MODEL.n_dof
    gains = np.array(ARM["lqr" if settings["control"] == "lqr" else "servo"])
    shaper = ARM["shapers"].get(settings["control"], {"times": [0.0], "amplitudes": [1.0]})
    time = ARM["period"] * np.arange(round(ARM["duration"] / ARM["period"]) + 1)
    angles, rates = command(time, settings["motion"], shaper)
    states, torques = [np.zeros(2 * d)], []
    for k, (rate, following) in enumerate(pairwise(rates)):
        goal = np.repeat([angles[k], 0.0, rate, 0.0], [2, d - 2, 2, d - 2])
        torques.append(ARM["inertia"] * (following - rate) / ARM["period"] + gains @ (goal - states[k]))
        states.append(sampled.A @ states[k] + sampled.B[:, 0] * torques[-1])
        if settings["tap"] and np.isclose(time[k + 1], ARM["impulseTime"]):
            states[-1] = states[-1] + ARM["impulse"] * linear.B[:, linear.inputs.index("tip_force_y (N)")]
    return np.array(states), np.abs(torques).max(), linear.C[1]


def test_the_browser_simulates_the_linear_model_of_the_library(page):
    """Compare 20 random settings with `linearize(...).discrete(...)` over 5 s: differences at most 1e-9."""
    rng, largest = np.random.default_rng(2), 0.0
    for case, control in enumerate(5 * ["none", "zv", "zvd", "lqr"]):
        changes = dict(
            zip(("payload", "stiffness", "motion"), rng.uniform([0.0, 0.2, 0.4], [0.2, 3.0, 3.0]), strict=True)
        )
        settings = {name: float(value) for name, value in changes.items()} | {"control": control, "tap": case % 3 == 0}
        run, (states, torque, tip) = page.run(SIMULATE, settings), simulated(settings)
        largest = max(largest, np.abs(run["states"] - states).max(), np.abs(run["tip"] - states @ tip).max())
        assert run["torque"] == pytest.approx(torque, rel=1e-8)
        changed = ringing.changed_model(MODEL, settings["payload"], settings["stiffness"])
        assert run["frequency"] == pytest.approx(fm.frequencies(changed, lock_joints=True)[0], rel=1e-9)
        after = (states @ tip)[int(np.ceil(run["end"] / ARM["period"])) :]
        assert run["vibration"] == pytest.approx(np.ptp(after), rel=1e-8)
        late = np.flatnonzero(np.abs(states @ tip - ARM["angle"] * ARM["length"]) > ARM["band"])
        assert run["settled"] == pytest.approx(ARM["period"] * (late[-1] + 1))
    size = sum((ASSETS / name).stat().st_size for name in (ringing.FILE, "ringing.js")) / 1e3
    print(f"largest difference {largest:.1e} over {ARM['duration']} s; size {size:.1f} kB")
    assert largest <= 1e-9


def test_the_page_describes_what_is_seen(page):
    """Check each statement below the experiment: vibration (mm) after the command, and whether the tip settles."""

    def vibration(**changes):
        run = page.run(SIMULATE, NOMINAL | changes)
        return 1e3 * run["vibration"], run["settled"] <= ARM["duration"] - 1.0

    ringing_tip, settled = vibration()
    assert ringing_tip > 300.0 and not settled
    assert vibration(motion=1.42)[0] < 1.0 < 20.0 < vibration(motion=2.13)[0] < ringing_tip / 5.0
    assert min(vibration(motion=1.42, payload=0.1)[0], vibration(motion=1.42, stiffness=0.5)[0]) > 10.0
    zv, zvd = vibration(control="zv", payload=0.1), vibration(control="zvd", payload=0.1)
    assert vibration(control="zv")[1] and vibration(control="zvd")[1] and 20.0 < zvd[0] < zv[0] / 2.0
    assert page.run(SIMULATE, NOMINAL | {"control": "zv"})["end"] == pytest.approx(0.71 + PERIOD / 2.0, abs=0.01)
    assert not any(vibration(control=name, tap=True)[1] for name in ("zv", "zvd"))
    assert all(vibration(control="lqr", **each)[1] for each in ({}, {"tap": True}, {"payload": 0.1}))
    assert vibration(control="lqr", payload=0.0)[0] > 1000.0
