"""Tests of the ring-down study: cases, errors, rows."""

import numpy as np
import pytest

from flexman_gym.kernels import layout
from studies.ringdown import measure
from studies.ringdown.measure import (
    BENT,
    DURATION,
    IMPULSE,
    PARTS,
    PERIOD,
    REFERENCE,
    RELEASE,
    SLEW,
    UNDAMPED,
    cases,
    default_model,
    outcome,
    percentiles,
    row,
    settings,
)

DEFAULT = "midpoint_3", PERIOD / 3


@pytest.mark.parametrize("kind", DURATION)
def test_arms_start_with_the_energy_that_their_kind_names(kind):
    each, again = cases(kind, 3), cases(kind, 3)
    assert len(each.drives) * PERIOD == pytest.approx(DURATION[kind], rel=1e-12)
    np.testing.assert_array_equal(each.states, again.states)
    result = outcome(default_model(kind == UNDAMPED), each, *DEFAULT)
    assert (result.status == layout.OK).all() and (result.first > 1e-3).all()
    n = default_model().n_joints
    torques, forces = each.drives[:, :, :n], each.drives[:, :, n:]
    assert torques.any() == (kind == SLEW) and forces.any() == (kind == IMPULSE)
    bent = (each.states[:, default_model().elastic_columns(1)] != 0.0).any()
    assert bent == (kind in (RELEASE, UNDAMPED, BENT))


@pytest.mark.slow
def test_the_midpoint_rule_keeps_the_energy_that_ros2_loses():
    model, each = default_model(undamped=True), cases(UNDAMPED, 3)
    reference = outcome(model, each, REFERENCE, None)
    np.testing.assert_allclose(reference.energy, reference.first, rtol=1e-4)
    kept = {
        name: row(UNDAMPED, name, 0.005, outcome(model, each, name, 0.005), reference) for name in ("ros2", DEFAULT[0])
    }
    assert kept["ros2"].energy_median > 0.3
    assert kept[DEFAULT[0]].energy_median < 0.01
    assert kept[DEFAULT[0]].kept == pytest.approx(1.0, abs=0.01)


def test_a_failed_arm_is_infinitely_far_and_counted():
    model, each = default_model(), cases(RELEASE, 2)
    reference = outcome(model, each, *DEFAULT)
    exact = row(RELEASE, "reference", 1.0, reference, reference)
    assert exact.energy_99 == exact.tip_99 == exact.failed == 0.0
    failed = row(
        RELEASE, "failed", 1.0, reference._replace(status=reference.status + np.array([0, 1], np.int8)), reference
    )
    assert failed.failed == 0.5 and failed.tip_median == 0.0
    assert not np.isfinite(percentiles(np.array([np.inf]), np.array([np.inf]))["tip_99"])


@pytest.mark.slow
def test_rows_are_those_of_every_kind_method_and_step(monkeypatch):
    monkeypatch.setattr(measure, "fixed_step_methods", lambda: [DEFAULT[0], "ros2"])
    monkeypatch.setattr(measure, "PARTS", (3, 4))
    rows = [each for kind in DURATION for each in measure.rows(kind, 2, 1)]
    assert len(rows) == len(DURATION) * 2 * 2 and set(PARTS) >= {3, 4} and settings("rk4") == measure.FINE_PARTS
