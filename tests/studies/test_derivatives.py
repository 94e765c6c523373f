"""Tests of the study of derivatives: it reports wrong derivatives, kinks and missed costs, and measures all costs."""

from dataclasses import replace

import numpy as np
import pytest

from studies.derivatives.costs import SEVEN, CostRow, cost_rows
from studies.derivatives.differences import allowed, deviations, remainder_orders
from studies.derivatives.measure import DerivativeRow
from studies.derivatives.page import page
from studies.files import read_rows

from oracles.files import ROOT

TIMES = np.linspace(0.0, 1.0, 5)[None, :, None]
ROWS = read_rows(ROOT / "docs" / "evidence" / "derivatives.csv", DerivativeRow)
COSTS = read_rows(ROOT / "docs" / "evidence" / "derivatives_costs.csv", CostRow)


def motions(changes):
    """Return the outputs (c, 5, 1) of exp(k t) for k = 1 + change."""
    return np.exp((1.0 + changes[:, None, None]) * TIMES)


@pytest.mark.parametrize("error, right", [(0.0, True), (1e-6, False)])
def test_a_deviation_beyond_the_limit_is_found(error, right):
    exact = (1.0 + error) * (TIMES * np.exp(TIMES))[0]
    deviation, estimate = deviations(exact, motions, 1.0)
    assert (deviation <= allowed(estimate)).all() == right


@pytest.mark.parametrize("error, order", [(0.0, 2.0), (0.5, 1.0)])
def test_the_remainder_is_of_first_order_with_a_wrong_derivative(error, order):
    exact = (1.0 + error) * (TIMES * np.exp(TIMES))[0]
    values, decades = motions(np.zeros(1))[0], np.geomspace(1e-2, 1e-4, 3)
    assert remainder_orders(values, exact, motions, 1.0, decades) == pytest.approx([order] * 2, abs=0.02)


def test_the_page_names_deviations_and_orders_beyond_their_limits_and_costs():
    wrong = replace(ROWS[0], difference=1e-3, order_low=1.0, order_high=1.0)
    costs = [replace(row, times_median=3.0) if row.name == SEVEN else row for row in COSTS]
    text = " ".join(page([wrong, *ROWS[1:]], costs, {}).split())
    assert f"Larger deviations: `{wrong.parameter}` with {wrong.method} ({wrong.effect})" in text
    assert "Without an explanation" in text and "motion cost 3 simulations" in text


@pytest.mark.slow
def test_every_cost_is_measured_beside_its_simulation():
    rows = cost_rows(1)
    assert [row.name for row in rows] == [row.name for row in COSTS]
    assert all(row.times_median == 1.0 for row in rows if row.name == row.peer) and all(row.least > 0.0 for row in rows)
