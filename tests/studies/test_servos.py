"""Tests of gain limits of servos against closed forms and environments."""

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.model.dynamics import mass_matrix
from flexman_gym.toolbox.controllers.margins import sampled_loops
from studies.files import read_rows
from studies.servos.measure import (
    APART,
    AT_REST,
    CHECKED,
    LARGEST,
    LOOPS,
    PERIODS,
    FrictionRow,
    ServoRow,
    limit,
    limits,
    rounds_of,
    tried_by_environment,
)

from oracles.files import ROOT

DOCS = ROOT / "docs" / "evidence"


@pytest.mark.parametrize("late", [0, 1, 2, 4])
def test_a_rigid_motor_bears_the_limit_of_levin_and_may(late):
    """Theoretical Population Biology 9, 1976, 178: damping x period / inertia below 2 sin(pi / (4 k + 2))."""
    model = fm.build_model(fm.catalog.one_link(rotor_inertia=0.1), flexible_links=False, flexible_joints=False)
    inertia = mass_matrix(model, np.zeros(2))[0, 0]
    loop = sampled_loops(model, [0.0], 0.01, late)[0]
    found = limit(loop, np.array([1e-7]), np.array([0.01 * inertia / 0.01]))
    assert found == pytest.approx(100.0 * 2.0 * np.sin(np.pi / (4 * late + 2)), rel=2e-3)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:actions. a servo:UserWarning")
def test_an_environment_comes_to_rest_below_a_limit_and_not_above_it():
    row = min((row for row in limits("FlexOne-v0", True) if 0.0 < row.factor < LARGEST), key=rounds_of)
    tried = tried_by_environment(row, "midpoint_3")
    assert tried.below is not None and tried.above is not None and APART < 0.2
    assert tried.below < 0.5 < tried.above


@pytest.mark.evidence
def test_published_limits_are_confirmed_by_environments():
    result, rubbing = read_rows(DOCS / "servos.csv", ServoRow), read_rows(DOCS / "servos_friction.csv", FrictionRow)
    tried = [row for row in result if row.below is not None]
    assert len(tried) == CHECKED and {row.period for row in result} == set(PERIODS)
    assert all(row.below < 0.5 < row.above for row in tried), "as the page says"
    stable = [row for row in rubbing if row.is_stable]
    assert len(stable) == LOOPS and all(row.left < AT_REST for row in stable), "as the page says"
