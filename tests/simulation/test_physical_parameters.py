"""Placed: an arm of a batch with parameters of its own is a model of its own, and goes on from where it is put."""

from dataclasses import replace

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.kernels import layout
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.physical_parameters import varied_model

from oracles.chains import laden_rrr
from oracles.random_inputs import drives, states_of

ARM = laden_rrr()
METHODS = ("ros2", "midpoint_3", "generalised_alpha", "rk4", "dop853")


def everything(batch):
    """All that a batch says of its arms, (b, ...) each."""
    return [np.array(getattr(batch, name)) for name in ("rows", "outputs", "status", "energy_residual")]


PARAMETERS = {
    "payload_mass": 4.0, "joint_stiffness": [4e3, 6e3, 5e3], "joint_damping": [1.0, 2.0, 3.0],
    "rotor_inertia": [9.0, 10.0, 12.0], "viscous_friction": [1.0, 0.0, 2.0], "link_stiffness_factor": [0.8, 1.3, 0.9],
}  # fmt: skip


@pytest.mark.parametrize("several", [{"payload_mass": 4.0}, PARAMETERS])
def test_a_varied_model_is_that_of_an_arm_of_the_batch(several):
    """It moves as an arm that was varied so, to the bit, and has the coordinates of the model that it came from."""
    joints = [replace(joint, viscous_friction=0.5) for joint in ARM.joints]
    nominal = fm.build_model(replace(ARM, joints=joints, modal_damping_ratio=0.01), modes=2, spinning_rotors=True)
    own = varied_model(nominal, **several)
    batch, alone = Batch(nominal, arms=2), Batch(own)
    batch.vary(np.array([1]), **{name: np.array([value]) for name, value in several.items()})
    states, drive = states_of(nominal, 2), drives(2, 2)
    batch.reset(np.arange(2), states)
    alone.reset(np.array([0]), states[1:])
    for each in drive:
        batch.step(each)
        alone.step(each[1:])
    for result, expected in zip(everything(batch), everything(alone), strict=True):
        assert np.array_equal(result[1], expected[0])
    assert (own.n_dof, own.arm) == (nominal.n_dof, nominal.arm)
    assert nominal.constants.payload_mass[0] == 3.0, "the model that it came from stays"


@pytest.mark.parametrize("method", METHODS)
def test_an_arm_that_is_placed_moves_as_one_that_was_reset(method):
    """From its state on, to the bit, though it has failed before; the others do not notice."""
    model = fm.build_model(ARM, modes=2)
    step = 0.0001 if method == "rk4" else 0.005
    placed, reset = (Batch(model, method, step, 0.01, arms=3) for _ in range(2))
    states, (first, second) = states_of(model, 3), drives(3, 2)
    for batch in (placed, reset):
        batch.reset(np.arange(3), states)
        batch.step(np.where([[False], [True], [False]], 1e12, first))
        assert batch.status.tolist() == [layout.OK, layout.DIVERGED, layout.OK]
    some = np.array([1, 2])
    placed.tip_accelerations()
    placed.place(some, states[1:])
    reset.reset(some, states[1:])
    for batch in (placed, reset):
        batch.step(second)
    assert placed.status.tolist() == [layout.OK] * 3
    assert np.array_equal(placed.rows, reset.rows) and np.array_equal(placed.outputs, reset.outputs)
    assert np.array_equal(placed.tip_accelerations(), reset.tip_accelerations())
