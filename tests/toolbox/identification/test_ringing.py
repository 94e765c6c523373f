"""Ringing: parameters from frequencies and damping ratios, against closed forms."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

import flexman_gym as fm
from flexman_gym.model.dynamics import frequencies
from flexman_gym.model.model import build_model
from flexman_gym.toolbox.identification.least_squares import RELATIVE_STEP, FreeParameters
from flexman_gym.toolbox.identification.ringing import Ringing

STIFFNESS, ROTOR, DAMPING = 80.0, 0.3, 0.4


def rigid_on_a_spring(stiffness=STIFFNESS, damping=DAMPING):
    """A stiff link on a spring and a damper, and its inertia about the joint."""
    link = fm.Link.strip(0.5, 0.04, 0.03, "y", (7e11, 2.6e11, 2700.0))
    inertia = link.mass * link.length**2 / 3.0 + link.density * link.length * link.second_moment_z
    return fm.Arm([link], [fm.Joint((0.0, 0.0, 1.0), ROTOR, stiffness, damping)]), inertia


def test_spring_and_damper_follow_from_frequency_and_damping_ratio():
    _, inertia = rigid_on_a_spring()
    natural = np.sqrt(STIFFNESS / inertia)
    ratio = DAMPING / (2.0 * np.sqrt(STIFFNESS * inertia))
    known = [natural * np.sqrt(1.0 - ratio**2) / (2.0 * np.pi)], [ratio]
    start, _ = rigid_on_a_spring(50.0, 0.1)
    found = fm.fit(start, ["joint_stiffness", "joint_damping"], *known, elements=1)
    assert found.values["joint_stiffness"] == pytest.approx([STIFFNESS], rel=1e-3)  # the link bends a little
    assert found.values["joint_damping"] == pytest.approx([DAMPING], rel=1e-3)
    # f = sqrt(K / J) / 2 pi, so that 0.5 % of f is 1 % of K; the damper is as uncertain as the ratio and half of that
    assert found.deviations["joint_stiffness"] == pytest.approx([0.01 * STIFFNESS], rel=0.02)
    assert found.deviations["joint_damping"] == pytest.approx([np.hypot(0.1, 0.005) * DAMPING], rel=0.02)
    # in parts, of dK = 2 df + 2 s dz and dD = df + (1 + s) dz, s = z^2 / (1 - z^2)
    share = ratio**2 / (1.0 - ratio**2)
    rows = np.array([[2.0, 2.0 * share], [1.0, 1.0 + share]]) * [0.005, 0.1]
    sizes = np.linalg.norm(rows, axis=1)
    assert found.correlation == pytest.approx(rows @ rows.T / np.outer(sizes, sizes), abs=1e-3)
    assert found.undetermined == ()
    assert found.frequencies[:, 1] == pytest.approx(np.ravel(known), rel=1e-6)


def test_a_joint_that_is_rigid_has_no_deviation():
    """Its stiffness is not free; that of the other joint is, by its name or with all."""
    arm = fm.catalog.vertical_2r(gravity=(0.0, 0.0, 0.0))
    arm = replace(arm, joints=[arm.joints[0], replace(arm.joints[1], stiffness=None, damping=0.0)])
    known = frequencies(build_model(arm, 1), lock_joints=True)[:2]
    every, one = (fm.fit(arm, name, known, elements=1) for name in ("joint_stiffness", "joint_stiffness[0]"))
    assert every.deviations["joint_stiffness"][1] == 0.0 < every.deviations["joint_stiffness"][0]
    assert one.deviations["joint_stiffness[0]"] == pytest.approx(every.deviations["joint_stiffness"][0])


def test_free_motors_ring_faster():
    """Two inertias and a spring: w^2 = K (1 / J_m + 1 / J_l) (Spong)."""
    _, inertia = rigid_on_a_spring(damping=0.0)
    free = np.sqrt(STIFFNESS * (1.0 / ROTOR + 1.0 / inertia)) / (2.0 * np.pi)
    start, _ = rigid_on_a_spring(50.0, 0.0)
    found = fm.fit(start, "joint_stiffness[0]", {"frequencies": [free], "lock_joints": False}, elements=1)
    assert found.values["joint_stiffness[0]"] == pytest.approx(STIFFNESS, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("locked", [True, False])
def test_slopes_are_those_of_the_numbers_themselves(locked):
    arm = fm.catalog.vertical_2r(gravity=(0.0, 0.0, 0.0))
    free = FreeParameters(
        arm, ["joint_stiffness", "joint_damping", "link_stiffness_factor", "link_damping", "payload_mass"]
    )
    known = Ringing([1.0, 2.0, 3.0], [0.01, 0.02, 0.03], (0.2, -0.7), locked)

    def numbers(x):
        model = build_model(free.build_arm(free.start * np.exp(x)), 1)
        return known.predict(model, free.perturbed(model, np.zeros(len(x))), RELATIVE_STEP)

    _, slopes = numbers(np.zeros(len(free.start)))
    for i, unit in enumerate(np.eye(len(free.start))):
        difference = (numbers(1e-4 * unit)[0] - numbers(-1e-4 * unit)[0]) / 2e-4
        # a payload moves the loaded modes by which links are damped, which the slope of a fixed model does not see
        rows = slice(0, 3) if str(free.numbers[i]) == "payload_mass" else slice(None)
        assert slopes[rows, i] == pytest.approx(difference[rows], abs=2e-6 * np.abs(slopes).max(), rel=1e-3)


def test_an_arm_with_weight_rings_as_its_modes_do():
    model = build_model(fm.catalog.vertical_2r(), 1)
    known = Ringing([1.0, 2.0], [0.01, 0.02], (0.2, -0.7), lock_joints=False)
    result, _ = known.predict(model, {"payload_mass": np.array([0.1])}, 1.0)
    modes = fm.modes(model, (0.2, -0.7), motors="free")
    assert result == pytest.approx([*modes.frequencies[:2], *modes.damping_ratios[:2]], rel=1e-9)


def test_slow_frequencies_are_exact_up_to_rounding_beside_fast_ones():
    """Differences over a change of 1e-7 of the moduli are those of a square root; SciPy differentiates over 1.5e-8."""
    arm = fm.catalog.planar_2r()
    model = build_model(arm)
    free = FreeParameters(arm, "link_stiffness_factor")
    before, after = (
        frequencies(build_model(free.build_arm(np.full(2, each))), lock_joints=True)[0] for each in (1, 1 + 1e-7)
    )
    assert (after / before - 1.0) / 5e-8 == pytest.approx(1.0, rel=1e-6)
    known = frequencies(build_model(free.build_arm(np.array([1.3, 0.8]))), lock_joints=True)[:3]
    found = least_squares(
        lambda x: frequencies(build_model(free.build_arm(x)), lock_joints=True)[:3] / known - 1.0, np.ones(2)
    )
    assert found.x == pytest.approx([1.3, 0.8], rel=1e-5)
    assert model.n_dof > 20


def test_what_frequencies_cannot_tell_is_named():
    arm = fm.catalog.one_joint()
    known = frequencies(build_model(arm, 1), lock_joints=True)[:3]
    with pytest.raises(ValueError, match="at least as many as free parameters, 4"):
        fm.fit(arm, ["joint_stiffness", "joint_damping", "link_stiffness_factor", "payload_mass"], known, elements=1)
    found = fm.fit(arm, ["joint_stiffness", "joint_damping"], known, elements=1)
    assert found.undetermined == ("joint_damping[0]",)
    assert found.explanation == "The data do not determine joint_damping[0]."
    found = fm.fit(
        arm, ["link_stiffness_factor", "payload_mass"], {"frequencies": [known[0]] * 2, "numbers": [0, 0]}, elements=1
    )
    assert found.undetermined == ("link_stiffness_factor[0]", "payload_mass")
    assert found.explanation == "The data do not determine link_stiffness_factor[0] and payload_mass separately."


def test_a_number_is_untold_from_half_of_itself_on():
    """A frequency is the square root of a stiffness factor: it has half of its relative deviation."""
    arm = fm.catalog.planar_2r()
    known = frequencies(build_model(arm, 1), lock_joints=True)[:1]
    free = "link_stiffness_factor[0]"
    sizes = [fm.fit(arm, free, {"frequencies": known, "deviation": part}, elements=1) for part in (1e-3, 2e-3)]
    unit = sizes[0].deviations[free] / 1e-3
    assert sizes[1].deviations[free] == pytest.approx(2e-3 * unit, rel=1e-3) and unit >= 2.0
    for deviation, undetermined in ((0.49, ()), (0.51, (free,))):
        found = fm.fit(arm, free, {"frequencies": known, "deviation": deviation / unit}, elements=1)
        assert found.undetermined == undetermined


def test_a_fit_shows_its_numbers_with_deviations():
    arm = fm.catalog.one_joint()
    measured = frequencies(build_model(arm, 1), lock_joints=True)[:2]
    found = fm.fit(arm, ["joint_stiffness", "link_stiffness_factor"], measured, elements=1)
    first, *rows, last = repr(found).splitlines()
    assert first == "<Fit" and last == f"  {found.explanation}>"
    for row in rows:
        name, value, deviation = re.fullmatch(r"  (\w+): (\S+) \+- (\S+)", row).groups()
        assert float(value) == pytest.approx(found.values[name][0], rel=1e-3)
        assert float(deviation) == pytest.approx(found.deviations[name][0], rel=1e-3)
    assert len(rows) == 2
