"""Roll: many control periods in a call are as many steps."""

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.kernels import layout
from flexman_gym.simulation.batch import Batch


@pytest.mark.parametrize("arms", [1, 9])
@pytest.mark.parametrize(("method", "step"), [("midpoint_3_sweeps", 0.01), ("gauss_2_sweeps", 0.02), ("rk4", 1e-4)])
def test_a_roll_is_as_many_steps_to_the_bit(method, step, arms):
    """Also of an arm that fails on the way, and of what is left to tell afterwards."""
    model, random = fm.build_model(fm.catalog.paper_rrr(), 1, 2), np.random.default_rng(0)
    drives = np.zeros((arms, 5, model.n_joints + 6))
    drives[:, :, :3] = random.uniform(-300.0, 300.0, (arms, 5, 3))
    drives[:, :, 3:] = random.uniform(-5.0, 5.0, (arms, 5, 6))  # on tip and base, which the tip feels at once
    drives[-1, 2, 0] = 1e14 if arms > 1 else 0.0  # which breaks it
    rolled, stepped = (Batch(model, method, step, 0.02, arms=arms) for _ in range(2))
    states, outputs = rolled.roll(drives)
    failed = np.zeros(arms, dtype=bool)
    for period in range(5):
        stepped.step(drives[:, period])
        failed |= stepped.status != layout.OK
        assert np.array_equal(states[~failed, period], stepped.state[~failed])
        assert np.array_equal(outputs[~failed, period], stepped.outputs[~failed])
        assert np.isnan(states[failed, period]).all() and np.isnan(outputs[failed, period]).all()
    assert failed.sum() == (arms > 1)
    for name in ("rows", "outputs", "status", "time", "energy_turnover", "energy_residual"):
        assert np.array_equal(getattr(rolled, name), getattr(stepped, name)), name
    assert np.array_equal(rolled.tip_accelerations(), stepped.tip_accelerations())


def test_a_long_roll_is_made_of_calls_that_are_not_long(monkeypatch):
    model = fm.build_model(fm.catalog.paper_rrr(), 1, 2)
    drives = np.random.default_rng(0).uniform(-100.0, 100.0, (9, 7, 9))
    whole, parted, single = (Batch(model, "midpoint_3_sweeps", 0.005, 0.02, arms=9) for _ in range(3))
    parted._mover._most, single._mover._most = 9, 3  # steps: two control periods, and not a whole one
    states = whole.roll(drives)[0]
    assert np.array_equal(states, parted.roll(drives)[0]) and np.array_equal(states, single.roll(drives)[0])
