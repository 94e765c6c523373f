"""Methods: coefficients check themselves, and every method converges with the order that it claims."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.methods import EXPLICIT, LINEARLY_IMPLICIT, METHODS, REFERENCE

FIXED = [name for name, method in METHODS.items() if not method.adaptive]
ADAPTIVE = [name for name, method in METHODS.items() if method.adaptive]
DURATION = 0.5  # s
STEPS = (32, 64, 128, 256, 512)
ROUNDING = 1e-11  # errors below are no longer those of a method


@cache
def scene():
    """A rigid 2R arm on soft damped springs, swung by sine torques: a smooth problem without stiff modes."""
    arm = fm.catalog.planar_2r(joint_stiffness=5.0, payload=fm.Payload(0.2), gravity=(0.0, -9.81, 0.0))
    arm = replace(arm, joints=[replace(joint, damping=0.002) for joint in arm.joints])
    torque = fm.SineTorque((2.0, 1.0), (1.0, 2.0), (0.3, 0.0))
    choice = fm.ModelChoice(flexible_links=False, elements=1)
    return fm.Scene(arm, choice, torque, fm.Initial((0.4, -0.6), (1.0, 0.5)), DURATION, DURATION)


@cache
def truth():
    """The last state, to rounding."""
    return fm.simulate(scene(), method="dop853", rtol=1e-13, atol=1e-14).states[-1]


def error(method, **options):
    """Error of the last state."""
    return np.linalg.norm(fm.simulate(scene(), method=method, **options).states[-1] - truth())


def observed_orders(errors):
    """Orders seen between runs of which each has half the step of the one before, as long as rounding is far off."""
    errors = np.array([error for error in errors if error > ROUNDING])
    assert len(errors) >= 3, "too few errors above rounding"
    return np.log2(errors[:-1] / errors[1:])


@pytest.mark.parametrize("name", FIXED)
def test_a_fixed_step_method_converges_with_its_order(name):
    orders = observed_orders(error(name, step=DURATION / steps) for steps in STEPS)
    assert orders[-2:] == pytest.approx(METHODS[name].order, abs=0.15)


@pytest.mark.parametrize("name", FIXED)
def test_the_energy_ledger_converges_with_the_order_of_the_method(name):
    runs = [fm.simulate(scene(), method=name, step=DURATION / steps) for steps in STEPS]
    orders = observed_orders(abs(run.energy_residual[-1]) / run.energy.max() for run in runs)
    assert orders[-1] > METHODS[name].order - 0.5  # at least: errors of opposite sign leave it wavering


@pytest.mark.parametrize("name", ADAPTIVE)
def test_the_error_of_an_adaptive_method_follows_rtol(name):
    tolerances = 10.0 ** -np.arange(5, 11)  # with looser ones a step of order 8 is too long for its error estimate
    errors = np.array([error(name, rtol=rtol, atol=rtol) for rtol in tolerances])
    assert (errors < 10 * tolerances).all()
    assert errors[-1] < 1e-4 * errors[0]
    work = [fm.simulate(scene(), method=name, rtol=rtol, atol=rtol).evaluations for rtol in (1e-4, 1e-7, 1e-10)]
    assert work == sorted(work) and work[0] < work[-1]


def test_two_explicit_methods_agree():
    """The reference has only its own word for it; another method at its finest says the same."""
    assert error("rk4", step=DURATION / 4096) < 1e-11


def test_methods_are_named_and_have_a_source():
    assert {"rk4", "dop853"} <= set(METHODS)
    for name, method in METHODS.items():
        assert method.name == name and method.source
        assert method.kind in (EXPLICIT, LINEARLY_IMPLICIT, REFERENCE)
        assert method.tableau.abscissae == pytest.approx(method.a.sum(axis=1))


@pytest.mark.parametrize("name", ADAPTIVE)
def test_error_estimates_vanish_for_a_constant_slope(name):
    assert METHODS[name].error.sum(axis=1) == pytest.approx(0.0, abs=1e-14)


@pytest.mark.parametrize("name", [name for name in FIXED if METHODS[name].kind == LINEARLY_IMPLICIT])
def test_a_linearly_implicit_method_damps_infinitely_stiff_modes(name):
    """L-stable: R(z) = 1 + z b (I - z B)^-1 1, with B = a + coupling + gamma I, goes to 0 as z goes to -infinity."""
    method = METHODS[name]
    ones = np.ones(len(method.b))
    matrix = method.a + method.coupling_matrix + method.gamma * np.eye(len(ones))

    def stability(z):
        return 1 + z * method.b @ np.linalg.solve(np.eye(len(ones)) - z * matrix, ones)

    assert abs(stability(-1e9)) < 1e-7
    along_axis = [abs(stability(1j * w)) for w in 10 ** np.linspace(-3, 6, 200)]
    assert max(along_axis) <= 1 + 1e-12  # A-stable, for its poles lie in the right half plane
    assert method.gamma > 0.0


def changed(array, index, value):
    """A copy with one entry changed."""
    copy = np.array(array)
    copy[index] = value
    return copy


RK4, ROS2, DOP853 = METHODS["rk4"], METHODS["ros2"], METHODS["dop853"]


@pytest.mark.parametrize(
    ("method", "changes"),
    [
        (RK4, {"b": changed(RK4.b, 0, 0.2)}),
        (RK4, {"b": np.array([1, 3, 3, 1]) / 8}),
        (RK4, {"a": changed(RK4.a, (2, 1), 0.4)}),
        (RK4, {"a": changed(RK4.a, (0, 1), 0.5)}),
        (RK4, {"a": changed(RK4.a, (1, 1), 0.5)}),
        (RK4, {"a": RK4.a[:3, :3]}),
        (RK4, {"b": changed(RK4.b, 0, np.nan)}),
        (RK4, {"a": changed(RK4.a, (1, 0), np.nan)}),
        (RK4, {"kind": "implicit"}),
        (RK4, {"kind": LINEARLY_IMPLICIT}),
        (RK4, {"kind": REFERENCE}),
        (RK4, {"gamma": 0.5}),
        (ROS2, {"b": np.array([0.4, 0.6])}),
        (ROS2, {"gamma": 0.0}),
        (ROS2, {"gamma": 0.3}),
        (ROS2, {"coupling": None}),
        (ROS2, {"kind": EXPLICIT}),
        (DOP853, {"error": DOP853.error[:, :12]}),
        (DOP853, {"error": np.zeros((3, 13))}),
        (DOP853, {"a": changed(DOP853.a, (11, 0), DOP853.a[11, 0] + 1e-6)}),
        (DOP853, {"b": changed(DOP853.b, 0, DOP853.b[0] + 1e-9)}),
    ],
)
def test_wrong_coefficients_are_refused_in_one_line(method, changes):
    with pytest.raises(ValueError) as error:
        replace(method, **changes)
    line = str(error.value)
    assert line.startswith(f"{method.name}: ") and "\n" not in line


def test_a_method_may_claim_less_than_its_order():
    assert replace(RK4, order=3).order == 3
