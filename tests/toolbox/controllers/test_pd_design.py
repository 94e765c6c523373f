"""Design of PD gains: cost of a double integrator, bounds, margins, similarity of arms, control periods that work."""

import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.agent.pd import PD
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.tasks import Slew
from flexman_gym.metrics import BAND
from flexman_gym.model.statics import rigid_holding_torques
from flexman_gym.toolbox.controllers import pd_design
from flexman_gym.toolbox.controllers.margins import MIN_MARGINS, has_margins, margins
from flexman_gym.toolbox.controllers.pd_design import RELEASE, SLEW, PDDesign, design_pd, shorter_periods

from oracles.assertions import refusal

Z = (0.0, 0.0, 1.0)
INERTIA, TORQUE, PERIOD = 0.5, 4.0, 0.01  # kg m^2, N m, s; of the rigid arm about its joint


def rigid_arm(factor=1.0):
    """Arm of one rigid link, a double integrator; all inertias and the torque limit times a factor."""
    link = fm.Link.rigid(1.0, 1.2 * factor, (0.5, 0.0, 0.0), np.diag([1e-4, 0.1, 0.1]) * factor)
    rotor = INERTIA - (0.1 + 1.2 * 0.25)
    return fm.Arm([link], [fm.Joint(Z, rotor_inertia=rotor * factor, torque_limit=TORQUE * factor)])


def rigid(**settings):
    return Configuration("FlexOne-v0", {"arm": rigid_arm(), "control_period": PERIOD, "horizon": 5.0} | settings)


def flexible(factor=1.0, coulomb=0.0, **settings):
    """Two flexible links in an environment; masses, stiffnesses and torques times a factor."""
    tube = fm.Link.tube(0.5, 0.03, 0.001)
    changed = {name: getattr(tube, name) * factor for name in ("youngs_modulus", "shear_modulus", "density")}
    joints = [
        fm.Joint(Z, stiffness=each * factor, rotor_inertia=0.02 * factor, torque_limit=10.0 * factor,
                 coulomb_friction=coulomb)
        for each in (400.0, 300.0)
    ]  # fmt: skip
    arm = fm.Arm([replace(tube, **changed)] * 2, joints, fm.Payload(0.5 * factor), modal_damping_ratio=0.01)
    return Configuration("FlexPlanar-v0", {"arm": arm, "control_period": 0.005, "horizon": 5.0} | settings)


@pytest.mark.parametrize("stiffness, damping", [(3.0, 2.0), (10.0, 2.0), (1.0, 4.0)])
def test_cost_of_a_double_integrator_is_that_of_its_sampled_motion(stiffness, damping):
    """Windows of 1, 1, 2, 4, ... periods of x[k + 1] = A x[k] under zero-order hold, stepped one by one."""
    gain, design = np.array([[stiffness, damping]]), PDDesign(rigid())
    step = np.array([[1.0, PERIOD], [0.0, 1.0]]) - np.array([[PERIOD**2 / 2.0], [PERIOD]]) / INERTIA @ gain
    x, errors = np.array([RELEASE, 0.0]), []
    for _ in range(512):
        errors.append(x[0] ** 2)
        x = step @ x
    bounds = [0, *2 ** np.arange(10)]
    means = [np.mean(errors[start:end]) for start, end in pairwise(bounds)]
    expected = PERIOD * sum(np.diff(bounds) * means / (np.array(means) + BAND**2))
    assert design.cost(gain[0]) == pytest.approx(expected, rel=1e-5)
    assert design.cost(np.array([stiffness, -damping])) > 5.0, "a loop without damping never settles"


def test_gains_of_a_double_integrator_brake_within_its_torque_limit():
    """On the line error = -(damping / stiffness) rate the deceleration is at most torque / inertia."""
    found = design_pd(rigid())
    ratio = found["stiffness"][0] / found["damping"][0]  # 1/s
    assert ratio**2 * SLEW * INERTIA / 2.0 <= TORQUE * 1.01
    damping_ratio = found["damping"][0] / (2.0 * np.sqrt(INERTIA * found["stiffness"][0]))
    assert 0.5 < damping_ratio < 2.0


@pytest.mark.slow
@pytest.mark.parametrize("coulomb, delay", [(0.0, 0), (0.0, 1), (0.3, 0)])
def test_designed_gains_have_margins_with_delay_and_with_sticking_motors(coulomb, delay):
    environment = flexible(coulomb=coulomb, control_period=0.002, randomisation={"delay": [0, delay]})
    loops, found = PDDesign(environment).loops, design_pd(environment)
    assert len(loops) == pd_design.POSTURES * (3 if coulomb else 1)
    assert has_margins(loops, found["stiffness"], found["damping"], MIN_MARGINS)
    reached = margins(loops, found["stiffness"], found["damping"])
    assert reached.gain >= MIN_MARGINS.gain * (1.0 - 1e-9) and reached.phase >= MIN_MARGINS.phase


def test_loops_with_sticking_motors_join_the_next_search(monkeypatch):
    """With these gains all loops with sliding motors have the margins, and some with a sticking motor do not."""
    design, gains = PDDesign(flexible(coulomb=0.3, control_period=0.01)), np.array([0.233, 0.0604, 0.2, 0.194])
    failed = [loop for loop in design.loops if not has_margins([loop], gains[:2], gains[2:], MIN_MARGINS)]
    assert failed and all(loop.stuck for loop in failed)
    searches = []
    monkeypatch.setattr(
        design, "_search", lambda checked: searches.append([*checked]) or (None, gains)[len(searches) < 2]
    )
    monkeypatch.setattr(pd_design, "shorter_periods", lambda period: ())
    assert "nor at any shorter" in refusal(design.gains)
    sliding = design.loops[: pd_design.POSTURES]
    assert [[id(loop) for loop in each] for each in searches] == [
        [id(loop) for loop in each] for each in (sliding, [*sliding, *failed])
    ]


@pytest.mark.slow
def test_gains_have_three_digits_and_are_bounded_by_the_free_rotor():
    found, design = design_pd(flexible()), PDDesign(flexible())
    for values in found.values():
        assert values == tuple(float(f"{value:.3g}") for value in values)
    beyond = design.bounded(np.array([1.0, 1.0, 1e9, 1e9]))
    model = fm.build_model(flexible().arm)
    assert PD([0.0] * 2, 1.98 * beyond[2:], 1.0).unstable(model, 0.005) == ""
    assert PD([0.0] * 2, 2.2 * beyond[2:], 1.0).unstable(model, 0.005) != ""


@pytest.mark.slow
def test_gains_scale_with_masses_stiffnesses_and_torques():
    """To the third digit, to which each candidate is rounded."""
    one, thousand = design_pd(flexible()), design_pd(flexible(1000.0))
    for name, values in one.items():
        assert np.array(thousand[name]) == pytest.approx(1000.0 * np.array(values), rel=0.01)
    gains = np.array([*one["stiffness"], *one["damping"]])
    assert PDDesign(flexible(1000.0)).cost(1000.0 * gains) == pytest.approx(PDDesign(flexible()).cost(gains), rel=1e-5)


def test_gains_of_a_slower_similar_arm_have_equal_stiffness_and_damping_times_the_time():
    """Inertias times 100 stretch all times by 10."""
    fast = design_pd(rigid())
    slow = design_pd(rigid(arm=rigid_arm(100.0), torque_limit=TORQUE, control_period=10 * PERIOD, horizon=50.0))
    assert slow["stiffness"] == pytest.approx(fast["stiffness"], rel=1e-9)
    assert slow["damping"] == pytest.approx(10.0 * np.array(fast["damping"]), rel=1e-9)


def test_the_error_of_an_arm_without_damping_names_the_damping():
    links = [fm.Link.tube(length, 0.03, 0.0015) for length in (0.62, 0.54)]
    joints = [fm.Joint((0, 0, 1), rotor_inertia=0.1, stiffness=each, torque_limit=20.0) for each in (3100.0, 870.0)]
    bare, damped = (fm.Arm(links, joints, fm.Payload(0.35), modal_damping_ratio=each) for each in (0.0, 0.01))
    line = refusal(lambda: design_pd(Configuration("FlexRRR-v0", {"arm": bare})))
    words = "on an arm without damping (modal_damping_ratio; or damping of the joints, 1 % of critical: "
    critical = ", ".join(f"{0.02 * np.sqrt(each.stiffness * each.rotor_inertia):.2g}" for each in joints)
    assert f"{words}{critical} N m s/rad)" in line
    assert design_pd(Configuration("FlexRRR-v0", {"arm": damped}))


@pytest.mark.slow
def test_the_error_of_a_period_without_gains_names_the_longest_that_works():
    line = refusal(lambda: design_pd(Configuration("FlexPlanar-v0", {"control_period": 0.05})))
    assert line.startswith("control_period: 0.05 is not allowed; give ") and "no PD at 50 ms has" in line
    works = float(re.search(r"([\d.e-]+) ms works$", line).group(1)) / 1e3
    longer = [each for each in shorter_periods(0.05) if each > works]
    assert works in shorter_periods(0.05)
    assert design_pd(Configuration("FlexPlanar-v0", {"control_period": works}))
    for period in longer:
        assert refusal(lambda period=period: design_pd(Configuration("FlexPlanar-v0", {"control_period": period})))


def test_shorter_periods_are_one_two_five_times_powers_of_ten():
    assert list(shorter_periods(0.02))[:5] == [0.01, 0.005, 0.002, 0.001, 0.0005]
    assert next(shorter_periods(0.013)) == 0.01 and next(shorter_periods(0.05)) == 0.02
    assert min(shorter_periods(0.02)) == 2e-5


def test_weight_stiffness_of_a_pendulum_is_its_largest_moment():
    """Potential energy m g c sin q: its second derivative is at most m g c."""
    arm = replace(rigid_arm(), gravity=(0.0, -9.81, 0.0))
    bound = pd_design.weight_stiffness(fm.build_model(arm))
    assert bound == pytest.approx([1.2 * 9.81 * 0.5], rel=0.01) and bound[0] <= 1.2 * 9.81 * 0.5
    assert (pd_design.weight_stiffness(fm.build_model(rigid_arm())) == 0.0).all()


def test_least_stiffness_exceeds_the_curvature_of_the_weight_in_any_posture():
    """Stiffness plus the Hessian of the potential energy is positive definite: the goal is the only equilibrium."""
    environment = Configuration("FlexPlanar-v0")
    stiffness, model = PDDesign(environment).bounded(np.full(4, 1e-9))[:2], fm.build_model(environment.arm)
    random, step = np.random.default_rng(7), 1e-4 * np.eye(2)
    for q in [[np.pi / 2.0, 0.0], [-np.pi / 2.0, 0.0], *random.uniform(-np.pi, np.pi, (20, 2))]:
        rows = [rigid_holding_torques(model, q + each) - rigid_holding_torques(model, q - each) for each in step]
        assert np.linalg.eigvalsh(np.diag(stiffness) + np.array(rows) / 2e-4).min() > 0.0


def test_equal_environments_share_one_design(monkeypatch):
    environment = rigid(horizon=4.0)
    found = design_pd(environment)
    monkeypatch.setattr(pd_design, "PDDesign", None)
    assert design_pd(environment.replace(base="pd", action_repeat=4)) == found


@pytest.mark.slow
def test_gains_are_designed_for_a_task_without_plain_data():
    class OwnTask(Slew):
        pass

    assert design_pd(rigid(task=OwnTask())) == design_pd(rigid(task=Slew()))
