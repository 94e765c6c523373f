"""Tests of the rest-to-rest motion by the flat output: exact in the linear model, without vibration when simulated."""

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.model.state_space import discretize
from flexman_gym.toolbox.verification import papers
from flexman_gym.toolbox.verification.flat_output import HeldModes
from flexman_gym.toolbox.verification.table import PASS

ANGLE, DURATION, PERIOD = np.pi / 2.0, 2.0, 1e-3  # rad, s, s


@pytest.fixture(scope="module")
def modes():
    return HeldModes.of_model(fm.build_model(fm.catalog.rome_elastic_joint(), 8), 3)


def test_a_rotor_and_a_rigid_link_on_a_spring_have_a_closed_form():
    """The flat output is the angle of the link: torque = (J_r + J_l) y'' + J_r J_l / k y''''."""
    rotor, link, stiffness, times = 1.0, 2.0, 3.0, np.linspace(0.0, DURATION, 50)
    pair = HeldModes(rotor + link, np.array([stiffness / link]), np.array([link**0.5]), np.array([link**-0.5]))
    assert pair.free_modes[0] == pytest.approx([0.0, stiffness * (1.0 / rotor + 1.0 / link)], abs=1e-12)
    s = np.polynomial.Polynomial([0.0, 0.0, 0.0, 0.0, 35.0, -84.0, 70.0, -20.0])  # degree 7, three derivatives of 0
    y = [ANGLE * s.deriv(k)(times / DURATION) / DURATION**k for k in (0, 2, 4)]
    np.testing.assert_allclose(
        pair.torque(times, ANGLE, DURATION), (rotor + link) * y[1] + rotor * link / stiffness * y[2], atol=1e-9
    )
    np.testing.assert_allclose(pair.deviation(times, ANGLE, DURATION), 0.0, atol=1e-9)


def test_the_linear_model_moves_from_rest_to_rest(modes):
    """A wrong inertia leaves a vibration."""
    count = len(modes.squares) + 1
    mass = np.eye(count)
    mass[0, 0] = modes.inertia
    mass[0, 1:] = mass[1:, 0] = modes.couplings
    A = np.zeros((2 * count, 2 * count))
    A[:count, count:], A[count:, :count] = np.eye(count), -np.linalg.solve(mass, np.diag(np.append(0.0, modes.squares)))
    B = np.append(np.zeros(count), np.linalg.solve(mass, np.eye(count)[0]))[:, None]
    transition, held = discretize(A, B, PERIOD)
    middles = (np.arange(round(DURATION / PERIOD)) + 0.5) * PERIOD
    goal = np.append(ANGLE, np.zeros(2 * count - 1))
    for chain, largest in ((modes, 1e-5), (modes._replace(inertia=1.05 * modes.inertia), None)):
        state, tips = np.zeros(2 * count), []
        for torque in chain.torque(middles, ANGLE, DURATION):
            state = transition @ state + held[:, 0] * torque
            tips.append(state[0] + modes.tip @ state[1:count])
        if largest is None:
            assert np.abs(state - goal).max() > 1e-2
            continue
        assert np.abs(state - goal).max() < largest
        times = np.arange(1, len(tips) + 1) * PERIOD
        path = modes._path(ANGLE, DURATION)(times / DURATION)
        np.testing.assert_allclose(tips - path, modes.deviation(times, ANGLE, DURATION), atol=1e-5)


@pytest.mark.parametrize(
    "angle, duration, stiffening, lowest, largest",
    [(0.05, 2.0, True, 0.0, 1e-6), (ANGLE, 4.0, True, 0.0, 5e-4), (ANGLE, 2.0, True, 3e-3, 6e-3),
     (ANGLE, 2.0, False, 0.02, 0.03)],
)  # fmt: skip
def test_the_simulated_arm_rests_at_the_end(angle, duration, stiffening, lowest, largest):
    """Exactly for small angles; centrifugal forces of fast moves, which the linear model lacks, leave millimetres."""
    goal = 0.7 * np.array([np.cos(angle), np.sin(angle), 0.0])
    assert lowest <= np.abs(papers.simulated_move(angle, duration, stiffening) - goal).max() < largest


def test_printed_angles_are_met_by_the_modal_data_of_the_source():
    rows = [row for row in papers.paper_tables()["printed"] if row.source == papers.ROME_MOTION]
    assert len(rows) == 7
    assert [row.verdict == PASS for row in rows] == [True, False] * 3 + [True]
    assert all(row.computed < 0.25 * row.expected for row in rows[1:6:2])
