"""Tests of the precision study: rows of the quick grid, Pareto front."""

import math
from collections import defaultdict
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flexman_gym.model.model import build_model
from flexman_gym.scene import catalog
from flexman_gym.simulation.methods import METHODS
from flexman_gym.simulation.scene_simulation import simulate
from flexman_gym.toolbox.precision.runs import PrecisionRow, ReferenceSolution, pareto_front
from studies.methods import largest_growth
from studies.precision.measure import RIGID_LINKS, cases, cheapest, choices, setbacks, whirl_scene
from studies.precision.page import compute

from oracles.files import REFERENCE

ROW = PrecisionRow("a scene", "a model", "ros2", 0.01, None, 1.0, 1.0, 100.0, 1e-2, 1e-1, "ok")
NUMBERS = st.floats(min_value=1e-6, max_value=1e6) | st.just(math.inf)


@pytest.fixture(scope="module")
def measured():
    """Return the rows of the quick study, and the errors of its reference solutions."""
    return compute(REFERENCE, quick=True)


@pytest.fixture(scope="module")
def rows(measured):
    return measured[0]


@pytest.fixture(scope="module")
def floors(measured):
    return measured[1]


@pytest.mark.slow
def test_rows_are_complete(rows, floors):
    assert len({(row.model, row.method, row.step, row.rtol) for row in rows}) == len(rows) > 20
    assert {row.model for row in rows} == {floor.model for floor in floors if floor.model}
    for row in rows:
        assert (row.step is None) != (row.rtol is None)
        assert row.status == "ok" and row.evaluations > 0
        assert row.wall > 0.0 and row.cpu > 0.0
        assert 0.0 < row.time_error < 0.1 and 0.0 < row.total_error < 0.1


@pytest.mark.slow
def test_finer_steps_have_smaller_errors_and_cost_more_evaluations(rows):
    ladders = defaultdict(list)
    for row in rows:
        ladders[row.model, row.method, row.step is None].append(row)
    for ladder in ladders.values():
        assert len(ladder) > 1
        for coarse, fine in pairwise(ladder):
            assert (fine.step or fine.rtol) < (coarse.step or coarse.rtol)
            assert fine.time_error < coarse.time_error
            assert fine.evaluations > coarse.evaluations


@pytest.mark.slow
def test_the_truth_is_better_than_the_rows_that_it_judges(rows, floors):
    known = {floor.model: floor.floor for floor in floors}
    assert all(row.time_error > known[row.model] > 0.0 for row in rows)


def test_the_error_of_the_model_is_what_the_methods_do_not_explain(rows):
    """Total and time error differ by the distance of two reference solutions, equal for all runs of a model."""
    for model in {row.model for row in rows}:
        mine = [row for row in rows if row.model == model]
        limit = min(mine, key=lambda row: row.time_error).total_error
        assert all(abs(row.total_error - limit) <= 1.01 * row.time_error + 1e-6 for row in mine)


@given(st.lists(st.tuples(NUMBERS, NUMBERS), max_size=40))
def test_the_front_is_what_no_other_point_beats(points):
    front = [points[i] for i in pareto_front(points)]
    assert front == sorted(front) and all(a[1] > b[1] for a, b in pairwise(front))
    for point in points:
        if all(map(math.isfinite, point)):
            assert any(better[0] <= point[0] and better[1] <= point[1] for better in front)
            beaten = any(other != point and other[0] <= point[0] and other[1] <= point[1] for other in points)
            assert (point in front) != beaten


@given(st.permutations(range(6)), st.lists(st.tuples(NUMBERS, NUMBERS), min_size=6, max_size=6))
def test_the_front_does_not_know_the_order_of_points(order, points):
    shuffled = [points[i] for i in order]
    assert [points[i] for i in pareto_front(points)] == [shuffled[i] for i in pareto_front(shuffled)]


def test_the_cheapest_run_within_an_error():
    better = replace(ROW, step=0.005, cpu=2.0, time_error=1e-3)
    late = replace(ROW, step=0.002, cpu=3.0, time_error=1e-4)
    rows = [late, ROW, better, replace(ROW, time_error=None, cpu=0.1), replace(ROW, method="rk4", cpu=0.1)]
    assert cheapest(rows, "a model", "ros2", 1e-2) is ROW
    assert cheapest(rows, "a model", "ros2", 5e-3) is better
    assert cheapest(rows, "a model", "ros2", 1e-6) is None


def test_a_finer_step_that_does_harm_is_found():
    fine, finer = replace(ROW, step=0.005, time_error=1e-3), replace(ROW, step=0.001, time_error=0.5)
    assert setbacks([finer, ROW, fine]) == [(fine, finer)]
    assert setbacks([ROW, fine, replace(finer, time_error=5e-3)]) == []
    failed = replace(finer, time_error=math.inf, status="diverged")
    assert setbacks([ROW, fine, failed]) == [(fine, failed)]
    assert setbacks([replace(ROW, time_error=math.inf), fine]) == []


def test_a_failed_run_is_infinitely_far_and_other_times_are_refused():
    scene = replace(catalog.paper_scene("rr"), duration=0.2)
    model = build_model(scene.arm, **choices(scene)["rigid"])
    result = simulate(scene, model, "rk4", step=0.02)
    fine = simulate(scene, model, "rk4", step=0.01)
    solution = ReferenceSolution(fine.tip, 1e-12, "")
    assert solution.distance(fine) == 0.0 < solution.distance(result) < 1e-6
    assert solution.distance(replace(result, status="diverged")) == math.inf
    with pytest.raises(ValueError, match="reference: 21 times"):
        solution.distance(replace(result, tip=np.zeros((8, 3))))


@pytest.mark.filterwarnings("ignore:Link.second_moment_y:UserWarning")
def test_scenes_and_models_of_the_study():
    result = cases(REFERENCE)
    assert len(result) == len({case.name for case in result}) >= 4
    for case in result:
        named = choices(case.scene)
        assert set(case.timed) <= set(named)
        assert (RIGID_LINKS in named) == case.scene.model.flexible_joints
        assert {"rigid", "1 mode a link", "7 modes a link", "1 element a link", "4 elements a link"} <= set(named)
    assert max(map(abs, whirl_scene().initial.joint_rates)) >= 5.0


@pytest.mark.parametrize("name", ["extrapolated_euler_3", "extrapolated_euler_4", "extrapolated_euler_5"])
def test_amplification_is_that_of_one_step_of_an_oscillator(name):
    """The linearly implicit Euler method in n parts multiplies exp(i w t) by (1 - i w h / n)^-n."""
    method = METHODS[name]
    factor, angle = largest_growth(method)
    table = [[(1 - 1j * angle / n) ** -n for n in method.sequence]]
    for column in range(1, method.order):  # Neville's scheme, one power of the step after another
        last, n = table[-1], method.sequence
        ratios = [n[i + column] / n[i] for i in range(len(last) - 1)]
        table.append([last[i + 1] + (last[i + 1] - last[i]) / (ratio - 1) for i, ratio in enumerate(ratios)])
    assert abs(table[-1][0]) == pytest.approx(factor, rel=1e-12)
    assert 1.0 < factor < 1.01
