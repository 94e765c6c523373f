"""Batch: an arm among many moves as it would alone, and what is varied is what building the model anew gives."""

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import flexman_gym as fm
from flexman_gym.kernels import batch as kernels
from flexman_gym.kernels import layout
from flexman_gym.simulation.batch import Batch

from oracles.assertions import refusal
from oracles.chains import laden_rrr
from oracles.random_inputs import drives, states_of

ARM = laden_rrr()
FACTORS = st.tuples(*3 * [st.floats(0.5, 2.0)])
FEW = settings(deadline=None, derandomize=True, max_examples=10)
METHODS = ("ros2", "extrapolated_euler_3", "generalised_alpha", "rk4", "dop853")


def everything(batch):
    """All that a batch says of its arms, (b, ...) each."""
    names = ("rows", "outputs", "status", "time", "energy_turnover", "energy_residual")
    return [np.array(getattr(batch, name)) for name in names]


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("stiffening", [False, True])
def test_an_arm_among_many_moves_as_it_would_alone(method, stiffening):
    model = fm.build_model(ARM, modes=2, stiffening=stiffening)
    step = 0.0001 if method == "rk4" else 0.005
    together, alone = Batch(model, method, step, 0.01, arms=11), Batch(model, method, step, 0.01)
    states, drive = states_of(model, 11), drives(11, 5)
    together.reset(np.arange(11), states)
    for each in drive:
        together.step(each)
    for arm in range(11):
        alone.reset(np.array([0]), states[arm : arm + 1])
        for each in drive:
            alone.step(each[arm : arm + 1])
        for result, expected in zip(everything(together), everything(alone), strict=True):
            assert np.array_equal(result[arm], expected[0])


def test_arms_are_reset_at_different_times():
    """Two arms that start from the same state and are driven alike move alike, one period apart."""
    model = fm.build_model(ARM, modes=2)
    batch, state, drive = Batch(model, arms=2), states_of(model, 1), drives(1, 6)
    batch.reset(np.array([0]), state)
    earlier = []
    for period in range(6):
        if period == 1:
            batch.reset(np.array([1]), state)
        batch.step(np.concatenate([drive[period], drive[period - 1]]))
        earlier.append([each[0] for each in everything(batch)])
        if period:
            for result, expected in zip(everything(batch), earlier[period - 1], strict=True):
                assert np.array_equal(result[1], expected)


def test_a_failed_arm_rests_at_its_last_good_period_until_it_is_reset():
    model = fm.build_model(ARM, modes=2)
    batch, states, drive = Batch(model, arms=3), states_of(model, 3), drives(3, 4)
    batch.reset(np.arange(3), states)
    batch.step(drive[0])
    before = everything(batch)
    drive[1:, 1, 0] = 1e12
    for each in drive[1:3]:
        batch.step(each)
    assert batch.status.tolist() == [layout.OK, layout.DIVERGED, layout.OK]
    for result, old in zip(everything(batch)[:2], before[:2], strict=True):
        assert np.array_equal(result[1], old[1])
        assert (result[0] != old[0]).any() and np.isfinite(result).all()
    assert batch.time == pytest.approx([0.06, 0.02, 0.06])
    batch.reset(np.array([1]), states[1:2])
    batch.step(drives(3, 1)[0])
    assert batch.status[1] == layout.OK and np.array_equal(batch.rows[1], before[0][1])


def assert_varied(arm, changed, parameters, **choice):
    """Asserts that an arm with these parameters moves like the changed arm built anew, and its neighbour as before."""
    nominal, anew = fm.build_model(arm, **choice), fm.build_model(changed, **choice)
    times = {"step": 1e-4, "control_period": 1e-3}
    together, alone, unvaried = Batch(nominal, **times, arms=2), Batch(anew, **times), Batch(nominal, **times)
    together.vary(np.array([1]), **{name: np.array([value]) for name, value in parameters.items()})
    states, drive = states_of(nominal, 2), drives(2, 1)[0]
    for batch, part in ((together, slice(2)), (alone, slice(1, 2)), (unvaried, slice(1))):
        batch.reset(np.arange(len(batch.rows)), states[part])
        batch.step(drive[part])
    for result, same, expected in zip(*map(everything, (together, unvaried, alone)), strict=True):
        assert np.array_equal(result[0], same[0])
        size = np.abs(expected).max()
        assert result[1] == pytest.approx(expected[0], rel=1e-9, abs=1e-9 * size + 1e-9)
    assert not np.allclose(unvaried.state, alone.state, rtol=1e-6, atol=0.0), "the change is to be seen"


@FEW
@given(FACTORS, st.sampled_from([0.0, 0.01]))
def test_stiffer_links_are_links_of_stiffer_material(factors, ratio):
    """Their modal damping keeps its ratio: a factor on all of a link's stiffness leaves the shapes of its modes."""
    arm = replace(ARM, modal_damping_ratio=ratio)
    links = [
        replace(link, youngs_modulus=factor * link.youngs_modulus, shear_modulus=factor * link.shear_modulus)
        for link, factor in zip(arm.links, factors, strict=True)
    ]
    assert_varied(arm, replace(arm, links=links), {"link_stiffness_factor": factors})


@FEW
@given(st.floats(0.1, 20.0))
def test_a_heavier_payload_is_a_payload_of_the_same_shape(mass):
    inertia = (mass / ARM.payload.mass * np.array(ARM.payload.inertia)).tolist()
    assert_varied(ARM, replace(ARM, payload=replace(ARM.payload, mass=mass, inertia=inertia)), {"payload_mass": mass})


def test_a_payload_where_there_was_none_is_a_point():
    bare = replace(ARM, payload=None)
    assert_varied(bare, replace(bare, payload=fm.Payload(2.0)), {"payload_mass": 2.0})


@FEW
@given(FACTORS, st.booleans())
def test_joints_are_those_of_an_arm_with_such_joints(factors, spinning):
    values = {
        "joint_stiffness": 5000.0 * np.array(factors),
        "joint_damping": 10.0 * np.array(factors[::-1]),
        "rotor_inertia": 10.0 / np.array(factors),
    }
    joints = [
        replace(joint, stiffness=values["joint_stiffness"][i], damping=values["joint_damping"][i],
                rotor_inertia=values["rotor_inertia"][i]) for i, joint in enumerate(ARM.joints)
    ]  # fmt: skip
    assert_varied(ARM, replace(ARM, joints=joints), values, spinning_rotors=spinning)


@pytest.mark.slow
@pytest.mark.parametrize("method", fm.METHODS)
def test_parameters_act_by_every_method(method):
    """An arm with a heavier payload, one of two, ends where an arm with such a payload ends by the same method."""
    joint = fm.Joint((0.0, 1.0, 0.0), 1.0)
    arm = fm.Arm([ARM.links[0]], [joint], fm.Payload(1.0))
    models = [fm.build_model(replace(arm, payload=fm.Payload(mass)), flexible_links=False) for mass in (1.0, 4.0)]
    batch, expected = (
        Batch(models[0], method, 1e-3, 0.01, arms=2),
        [Batch(model, method, 1e-3, 0.01) for model in models],
    )
    batch.vary(np.array([1]), payload_mass=np.array([4.0]))
    batch.reset(np.arange(2), np.zeros((2, 2)))
    drive = np.tile([100.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], (2, 1))
    for each in (batch, *expected):
        each.step(drive[: len(each.rows)])
    for i in range(2):
        assert batch.state[i] == pytest.approx(expected[i].state[0], rel=1e-9)
    assert batch.state[1, 1] < 0.99 * batch.state[0, 1]


def test_a_reset_forgets_the_energy_that_was_turned_over():
    model = fm.build_model(ARM, modes=2)
    used, fresh = Batch(model, arms=2), Batch(model, arms=2)
    states = states_of(model, 2)
    used.reset(np.arange(2), 3.0 * states)
    for each in drives(2, 4):
        used.step(10.0 * each)
    for batch in (used, fresh):
        batch.reset(np.arange(2), states)
    assert np.array_equal(used.energy_turnover, fresh.energy_turnover)
    for each in drives(2, 3):
        used.step(0.01 * each)
        fresh.step(0.01 * each)
    assert np.array_equal(used.energy_turnover, fresh.energy_turnover)


def test_work_goes_into_energy_and_dampers_and_turnover_leaves_weight_out():
    """A damped arm that is pushed: what dampers took is most of the work, and nothing is left over.

    Held up by its weight alone an arm at rest has turned nothing over, however high it stands.
    """
    joints = [replace(joint, damping=200.0, viscous_friction=50.0) for joint in ARM.joints]
    model = fm.build_model(replace(ARM, joints=joints, gravity=(0.0, 0.0, 0.0)), 1)
    batch = Batch(model, "implicit_midpoint", 0.0025, arms=2)
    drive = np.zeros((2, 9))
    drive[:, :3] = [[100.0, 50.0, 20.0], [-50.0, 80.0, 10.0]]
    for _ in range(200):
        batch.step(drive)
    work, dissipated = batch.rows[:, -2], batch.rows[:, -1]
    assert (dissipated > 0.1 * work).all() and (work > 1.0).all()
    assert (np.abs(batch.energy_residual) < 1e-3 * dissipated).all()
    heavy = fm.build_model(ARM, 1)
    posture = np.array([[0.0, 1.2, 0.1]])
    resting = Batch(heavy)
    resting.reset(np.zeros(1, dtype=np.int64), fm.rest_state(heavy, posture[0])[None])
    elastic = resting.outputs[0, layout.LINK_ENERGY] + resting.outputs[0, layout.JOINT_ENERGY]
    assert resting.outputs[0, layout.GRAVITATIONAL] > 2.0 * elastic
    assert resting.energy_turnover[0] == pytest.approx(elastic, rel=1e-9)


def test_nominal_parameters_change_no_bit():
    model = fm.build_model(replace(ARM, modal_damping_ratio=0.01), modes=3)
    batch, states, drive = Batch(model, arms=2), states_of(model, 1), drives(1, 3)
    batch.vary(np.array([1]), **{name: np.array([value]) for name, value in batch.nominal.items()})
    batch.reset(np.arange(2), states.repeat(2, axis=0))
    for each in drive:
        batch.step(each.repeat(2, axis=0))
    for result in everything(batch):
        assert np.array_equal(result[0], result[1])


@pytest.mark.parametrize("duplicate", [copy.copy, copy.deepcopy, pickle.dumps])
def test_a_batch_refuses_to_be_copied(duplicate):
    """A copy would move the arrays of the first one, whose addresses its kernels know."""
    with pytest.raises(TypeError, match="cannot be copied or pickled"):
        duplicate(Batch(fm.build_model(ARM, modes=2)))


@pytest.mark.parametrize("method", ["midpoint_3", "rk4"])
def test_many_arms_that_vary_at_once_are_those_that_vary_one_by_one(method):
    arm = fm.catalog.paper_rrr()
    joints = [replace(joint, coulomb_friction=5.0, stiffness_pieces=[(40.0, 0.4)]) for joint in arm.joints]
    model, random = fm.build_model(replace(arm, joints=joints), 1, 2), np.random.default_rng(0)
    together, apart = (Batch(model, method, 1e-3, 0.02, arms=10) for _ in range(2))
    arms = np.array([7, 1, 9, 0])
    values = {
        name: nominal * random.uniform(0.5, 2.0, (4, *np.shape(nominal))) for name, nominal in together.nominal.items()
    }
    values["payload_mass"] = random.uniform(1.0, 9.0, 4)
    together.vary(arms, **values)
    for i, arm in enumerate(arms):
        apart.vary(np.array([arm]), **{name: each[[i]] for name, each in values.items()})
    for arm in range(10):
        ours, theirs = (batch._mover.constants(arm) for batch in (together, apart))
        assert all(np.array_equal(ours[name], theirs[name]) for name in theirs)
    stiffness = [together._mover.constants(arm)["stiffness"] for arm in (7, 1, 9, 0, 3)]
    assert len(np.unique([each.max() for each in stiffness])) == 5


@pytest.mark.parametrize("arms", [1, 9])
@pytest.mark.parametrize(("method", "step"), [("midpoint_3", 0.01), ("gauss_2", 0.02), ("rk4", 1e-4)])
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


@pytest.mark.parametrize("flexible", [True, False])
def test_a_roll_with_feedback_is_a_loop_of_steps_with_a_pd(flexible):
    """With delays of 0 to 2 periods, a first period, and torques within limits that bind."""
    model = fm.build_model(fm.catalog.paper_rrr(), 1, 1, flexible_joints=flexible)
    random, d, motors = np.random.default_rng(0), model.n_dof, model.motor_columns
    rolled, stepped = (Batch(model, "midpoint_3", 0.005, 0.02, arms=9) for _ in range(2))
    states, drives = states_of(model, 9), np.zeros((9, 12, 9))
    drives[:, :, :3] = random.uniform(-50.0, 50.0, (9, 12, 3))
    table = random.uniform([[200.0], [20.0], [60.0], [-0.3]], [[400.0], [50.0], [180.0], [0.3]], (9, 4, 3))
    delays = np.arange(9) % 3
    timing = np.stack([delays + np.arange(9) // 3, delays], axis=1)
    for batch in (rolled, stepped):
        batch.reset(np.arange(9), states)
    motion, outputs = rolled.roll(drives, (table, timing, rolled.rows.copy()))
    past, clipped = [stepped.state.copy()], 0
    for t in range(12):
        drive = drives[:, t].copy()
        for arm in np.flatnonzero(t >= timing[:, 0]):
            stiffness, damping, limit, reference = table[arm]
            state = past[max(t - delays[arm], 0)][arm]
            torque = drive[arm, :3] + stiffness * (reference - state[motors]) - damping * state[d + motors]
            drive[arm, :3] = np.clip(torque, -limit, limit)
            clipped += np.count_nonzero(np.abs(torque) > limit)
        stepped.step(drive)
        past.append(stepped.state.copy())
        assert motion[:, t] == pytest.approx(stepped.state, rel=1e-12, abs=1e-12)
        assert outputs[:, t] == pytest.approx(stepped.outputs, rel=1e-11, abs=1e-11)
    assert 20 < clipped < 200, "some of the 300 torques are at their limits"


def test_feedback_of_a_single_arm_is_refused():
    batch = Batch(fm.build_model(ARM, 1, 1), "midpoint_3", 0.01, 0.02)
    feedback = np.zeros((1, 4, 3)), np.zeros((1, 2), dtype=np.int64), batch.rows.copy()
    assert refusal(batch.roll, np.zeros((1, 3, 9)), feedback).startswith("drives: ")


def test_inputs_of_another_layout_need_no_other_kernel():
    model = fm.build_model(fm.catalog.paper_rrr(), 1, 2)
    batch, drives = Batch(model, "midpoint_3", 0.01, 0.02, arms=9), np.zeros((9, 2, 9))
    batch.step(drives[:, 0].copy())
    compiled = len(kernels.advance_batch.signatures)
    batch.step(drives[:, 1])
    assert len(kernels.advance_batch.signatures) == compiled


def test_a_long_roll_is_made_of_calls_that_are_not_long(monkeypatch):
    model = fm.build_model(fm.catalog.paper_rrr(), 1, 2)
    drives = np.random.default_rng(0).uniform(-100.0, 100.0, (9, 7, 9))
    whole, parted, single = (Batch(model, "midpoint_3", 0.005, 0.02, arms=9) for _ in range(3))
    parted._mover._max_steps, single._mover._max_steps = 9, 3  # steps: two control periods, and not a whole one
    states = whole.roll(drives)[0]
    assert np.array_equal(states, parted.roll(drives)[0]) and np.array_equal(states, single.roll(drives)[0])
