"""MPC: the LQR where no limit is active, within the limits where one is, and no arm looks at another."""

import sys
from itertools import count

import gymnasium as gym
import numpy as np
import pytest
from scipy.optimize import lsq_linear

import flexman_gym as fm
from flexman_gym.__main__ import main
from flexman_gym.agent.base_controllers import make_base
from flexman_gym.agent.controller import EpisodeInfo
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.config.plant import make_plant
from flexman_gym.evaluation.rollouts import rollout
from flexman_gym.metrics import settling_time
from flexman_gym.model.state_space import discretize
from flexman_gym.toolbox.controllers import mpc
from flexman_gym.toolbox.controllers.arm_scales import ArmScales
from flexman_gym.toolbox.controllers.cost_weights import CostWeights
from flexman_gym.toolbox.controllers.references.planned_slews import JACOBIAN_TIME

from oracles.assertions import refusal

daqp = pytest.importorskip("daqp")
PERIOD, ONLY, WEIGHTS = 0.02, np.array([0]), CostWeights(0.1, 0.5, 0.4)


def posed(name="FlexPlanar-v0"):
    """The model of a named environment, its limits, and a posture."""
    setup = Configuration.from_keywords({"name": name})
    return resolve_fidelity(setup).model, np.array(setup.torque_limit), np.array([0.4, -0.3, 0.2])[: setup.arm.n_joints]


def about(model, posture):
    """The linear model about rest at a posture."""
    held = fm.holding_torques(model, posture)
    return fm.linearize(model, state=fm.rest_state(model, posture), torque=held)


def horizon_at(monkeypatch, model, posture, limits, blocks):
    """The first linear prediction of a controller whose arm is at its goal, with the weights of these tests."""
    monkeypatch.setattr(mpc, "MOVE_BLOCKS", blocks)
    controller = mpc.MPC(model, limits, PERIOD)
    controller._weights = WEIGHTS
    controller.reset(ONLY, EpisodeInfo(posture[None], posture[None], PERIOD), 1)
    horizons = controller._plans[0].horizons
    return type(horizons)(*(each[0] for each in horizons))


@pytest.mark.slow
@pytest.mark.parametrize("blocks", [(1,) * 9, (1, 1)])
def test_without_limits_the_first_torque_is_that_of_the_lqr(blocks, monkeypatch):
    """Over any horizon, as the cost of its end is that of the LQR; for any torques that were planned before."""
    model, limits, posture = posed()
    linear, random = about(model, posture), np.random.default_rng(0)
    horizon, n = horizon_at(monkeypatch, model, posture, limits, blocks), len(limits)
    transition, inputs = discretize(linear.A, linear.B, PERIOD)
    start, planned = 1e-2 * random.normal(size=2 * model.n_dof), random.normal(size=(len(blocks), n))
    states = [start]
    for torques in planned:
        states.append(transition @ states[-1] + inputs @ (limits * torques))
    near = [np.concatenate([each / weight for each, weight in parts(linear, model, x)]) for x in states[1:-1]]
    gap = np.concatenate([*near, horizon.terminal @ states[-1]])
    slope = horizon.jacobian @ gap + planned.ravel()
    first = planned[0] - np.linalg.solve(horizon.curvature, slope)[:n]
    gain = WEIGHTS.gain(linear, model.motor_columns, limits, PERIOD)
    assert first == pytest.approx(-gain @ start / limits, rel=1e-6, abs=1e-8)


@pytest.mark.slow
def test_near_its_goal_the_controller_is_the_lqr(monkeypatch):
    """Its prediction is that of the simulator, which is linear there."""
    monkeypatch.setattr(mpc, "MOVE_BLOCKS", (1,) * 24)
    model, limits, posture = posed("FlexRRR-v0")
    controller = mpc.MPC(model, limits, PERIOD, ("midpoint_3", PERIOD / 20.0))
    controller.reset(ONLY, EpisodeInfo(posture[None], posture[None], PERIOD), 1)
    rest, off = fm.rest_state(model, posture), np.zeros(2 * model.n_dof)
    off[: model.n_dof] = (fm.rest_state(model, posture + np.array([1e-6, -2e-6, 3e-6])) - rest)[: model.n_dof]
    off[model.n_dof + model.motor_columns] = [2e-6, 1e-6, -1e-6]
    state = rest + off
    gain = controller._weights.gain(about(model, posture), model.motor_columns, limits, PERIOD)
    expected = -gain @ off / limits
    for planned in (0.0, 1e-5 * np.random.default_rng(2).normal(size=(24, 3))):
        controller._planned[0], controller._now[0] = planned, 0
        action = controller.act({"state": state[None]}, np.zeros((1, 3)), np.array([True]))[0]
        assert np.abs(action - expected).max() < 2e-3 * np.abs(expected).max()


def test_changes_of_blocks_cost_the_least(monkeypatch):
    """No change of a block beside them makes the sum of squares of outputs and torques less, period by period."""
    model, limits, posture = posed()
    linear, random, blocks = about(model, posture), np.random.default_rng(0), (1, 2, 4)
    horizon, n = horizon_at(monkeypatch, model, posture, limits, blocks), len(limits)
    transition, inputs = discretize(linear.A, linear.B, PERIOD)
    start = 1e-2 * random.normal(size=len(transition))

    def outputs(changes):
        states, torques = [start], np.repeat(changes.reshape(-1, n), blocks, axis=0)
        for each in torques:
            states.append(transition @ states[-1] + inputs @ (limits * each))
        near = [np.concatenate([each / weight for each, weight in parts(linear, model, x)]) for x in states[1:-1]]
        return np.concatenate([*near, horizon.terminal @ states[-1], torques.ravel()])

    nothing = np.zeros(n * len(blocks))
    slope = horizon.jacobian @ outputs(nothing)[: horizon.jacobian.shape[1]]
    best = -np.linalg.solve(horizon.curvature, slope)
    across = np.array([outputs(best + one) - outputs(best) for one in np.eye(len(best))])
    assert np.abs(across @ outputs(best)).max() < 1e-8 * np.abs(across @ outputs(nothing)).max()


def parts(linear, model, state):
    """Tip, its speed and motors of a state, each with its weight."""
    tip, d = linear.C[:, : model.n_dof], model.n_dof
    motors = state[model.motor_columns]
    return (tip @ state[:d], WEIGHTS.tip), (tip @ state[d:], WEIGHTS.tip_speed), (motors, WEIGHTS.motor)


def test_on_a_slew_that_the_arm_can_follow_nothing_is_changed():
    """A slew that the simulator has made, within the limits; the torques of each period are applied in it."""
    model, limits, posture = posed()
    controller, random = mpc.MPC(model, limits, PERIOD), np.random.default_rng(3)
    controller.reset(ONLY, EpisodeInfo(posture[None], posture[None] + 0.05, PERIOD), 1)
    torques = fm.holding_torques(model, posture) / limits + 0.05 * random.uniform(-1.0, 1.0, (90, 2))
    drives, batch = np.zeros((1, 90, 8)), controller._make_batch(1)
    drives[0, :, :2] = torques * limits
    batch.reset(ONLY, fm.rest_state(model, posture)[None])
    first = batch.outputs.copy()
    states, outputs = (each[0] for each in batch.roll(drives))
    states, outputs = np.vstack([fm.rest_state(model, posture), states]), np.vstack([first, outputs])
    controller._plans[0] = controller._plans[0]._replace(states=states, outputs=outputs, torques=torques)
    controller._planned[0] = torques[: sum(mpc.MOVE_BLOCKS)]
    for period in range(90 - sum(mpc.MOVE_BLOCKS)):
        action = controller.act({"state": states[period][None]}, np.zeros((1, 2)), np.array([True]))[0]
        assert action == pytest.approx(torques[period], abs=1e-9)


def test_planned_torques_change_by_little_in_a_period():
    """Of an arm far from where its plan would have it, to either side."""
    model, limits, posture = posed("FlexOne-v0")
    goals = np.array([posture + 1.5, posture - 1.5])
    controller = mpc.MPC(model, limits, PERIOD)
    controller.reset(np.arange(2), EpisodeInfo(goals, goals, PERIOD), 2)
    actions = controller.act({"state": model.at_rest(np.array([posture, posture]))}, goals, np.ones(2, dtype=bool))
    assert actions == pytest.approx(np.array([[mpc.MAX_CHANGE], [-mpc.MAX_CHANGE]]))


@pytest.mark.slow
def test_a_slew_to_a_posture_with_a_far_smaller_inertia_settles():
    """Near the vertical, the inertia about the vertical axis is 51 kg m^2; at the start it is 431 kg m^2."""
    environment = Configuration("FlexRRR-v0", {"horizon": 5.0})
    result = rollout("mpc", environment, [43000]).records
    assert settling_time(result[0].errors, result[0].band, result[0].period) < 4.0


def test_a_plan_whose_prediction_diverges_is_kept():
    """The other arm plans as usual."""
    model, limits, posture = posed()
    controller = mpc.MPC(model, limits, PERIOD)
    start = np.tile(posture, (2, 1))
    controller.reset(np.arange(2), EpisodeInfo(start, start + 0.3, PERIOD), 2)
    states, planned = np.tile(fm.rest_state(model, posture), (2, 1)), controller._planned.copy()
    states[0, model.n_dof :] = 1e6
    assert controller._predict(states, planned, [0, 1]).keys() == {1}
    controller._improve(states, [0, 1])
    kept = [np.array_equal(controller._planned[arm], planned[arm]) for arm in (0, 1)]
    controller._improve(states, [0])
    assert kept == [True, False] and np.array_equal(controller._planned[0], planned[0])


def test_torques_are_planned_once_in_a_time_unit():
    """In the periods between, the torques planned before are applied, whatever the state."""
    model, limits, posture = posed("FlexOne-v0")
    controller, random = mpc.MPC(model, limits, PERIOD / 20.0), np.random.default_rng(0)
    unit = controller._unit
    assert unit >= 2
    controller.reset(ONLY, EpisodeInfo(posture[None], posture[None] + 0.1, PERIOD / 20.0), 1)
    for _ in range(2):
        planned = controller._planned[0].copy()
        for period in range(unit):
            state = fm.rest_state(model, posture + 0.01 * random.uniform(-1.0, 1.0, model.n_joints))[None]
            action = controller.act({"state": state}, np.zeros((1, model.n_joints)), np.array([True]))[0]
            planned = np.vstack([action, controller._planned[0]]) if period == 0 else planned
            assert np.array_equal(action, planned[period])


def test_between_two_postures_slopes_are_between_theirs():
    model, limits, posture = posed("FlexOne-v0")
    controller = mpc.MPC(model, limits, PERIOD)
    controller.reset(ONLY, EpisodeInfo(posture[None], posture[None] + 1.0, PERIOD), 1)
    plan = controller._plans[0]
    each = plan.horizons._replace(jacobian=plan.horizons.jacobian * np.arange(5.0)[:, None, None])
    for come, place in ((-0.1, 0.0), (0.3, 1.2), (1.0, 4.0), (1.2, 4.0)):
        result = controller._interpolate(plan._replace(horizons=each), model.at_rest((posture + come)[None])[0])
        lower = min(int(place), 3)
        expected = each.jacobian[lower] + (place - lower) * (each.jacobian[lower + 1] - each.jacobian[lower])
        assert result.jacobian == pytest.approx(expected, abs=1e-9 * np.abs(expected).max() + 1e-12)


def test_changes_stay_within_their_bounds_and_cost_the_least():
    """Of a cost without coupling each bound cuts its own change off."""
    low, high = np.array([-1.0, -0.5, -0.2]), np.array([0.1, 0.5, 1.0])
    changes = mpc._solve_quadratic_program(np.diag([1.0, 2.0, 4.0]), np.array([-3.0, 4.0, 0.4]), low, high)
    assert changes == pytest.approx([0.1, -0.5, -0.1])


def test_where_it_saturates_its_plan_costs_the_least_of_all_within_the_limits(monkeypatch):
    """By another solver: torques from -1 to 1, changes up to MAX_CHANGE; some end at either, some at neither."""
    model, limits, posture = posed()
    controller, n, programs = mpc.MPC(model, limits, PERIOD), 2, []
    controller.reset(ONLY, EpisodeInfo(posture[None], posture[None], PERIOD), 1)
    blocks, random = len(mpc.MOVE_BLOCKS), np.random.default_rng(0)
    means = np.where(np.arange(blocks * n) % 3 == 0, 0.0, 0.98 * random.choice([-1.0, 1.0], blocks * n))
    planned = np.repeat(means.reshape(blocks, n), mpc.MOVE_BLOCKS, axis=0)
    controller._planned[0], least = planned, daqp.solve
    monkeypatch.setattr(daqp, "solve", lambda *given: programs.append(given[:2]) or least(*given))
    # the plan is so far from linear that the true costs would refuse the changes
    order = count()
    monkeypatch.setattr(mpc._Prediction, "cost", property(lambda _: next(order)))
    state = model.at_rest(posture[None] + np.array([[0.015, -0.015]]))
    action = controller.act({"state": state}, np.zeros((1, n)), np.array([True]))[0]
    [(curvature, slope)] = programs
    low, high = np.fmax(-1.0 - means, -mpc.MAX_CHANGE), np.fmin(1.0 - means, mpc.MAX_CHANGE)
    root = np.linalg.cholesky(curvature)
    best = lsq_linear(root.T, -np.linalg.solve(root, slope), (low, high), method="bvls", tol=1e-14).x
    expected = planned + np.repeat(best.reshape(blocks, n), mpc.MOVE_BLOCKS, axis=0)
    assert action == pytest.approx(expected[0], abs=1e-6)
    assert controller._planned[0, :-1] == pytest.approx(expected[1:], abs=1e-6)
    ends = np.abs(means + best) > 1.0 - 1e-9, np.abs(best) > mpc.MAX_CHANGE - 1e-9
    assert ends[0].any() and ends[1].any() and not (ends[0] | ends[1]).all()


def test_the_predicted_cost_changes_as_that_of_the_quadratic_program(monkeypatch):
    """By 2 g x + x H x for changes x, near the goal, where the arm is linear; H has the cost of the torques."""
    model, limits, posture = posed("FlexRRR-v0")
    controller, programs, least = mpc.MPC(model, limits, PERIOD), [], daqp.solve
    controller.reset(ONLY, EpisodeInfo(posture[None], posture[None], PERIOD), 1)
    monkeypatch.setattr(daqp, "solve", lambda *given: programs.append(given[:2]) or least(*given))
    state, planned = fm.rest_state(model, posture + 1e-5)[None], controller._planned
    before = controller._predict(state, planned, [0])[0]
    changes = controller._changes(planned[0], before)
    [(curvature, slope)], firsts = programs, np.cumsum((0, *mpc.MOVE_BLOCKS[:-1]))
    steps = changes[firsts].ravel()
    expected = 2.0 * slope @ steps + steps @ curvature @ steps
    after = controller._predict(state, planned + changes, [0])[0]
    assert after.cost - before.cost == pytest.approx(expected, rel=1e-3)


def test_changes_are_shortened_until_the_predicted_cost_decreases():
    """Of plans that differ more and more from the reference: whole, shortened, and no changes."""
    model, limits, posture = posed()
    controller, random, applied = mpc.MPC(model, limits, PERIOD), np.random.default_rng(0), []
    controller.reset(ONLY, EpisodeInfo(posture[None], posture[None], PERIOD), 1)
    state, rest, blocks = fm.rest_state(model, posture)[None], controller._planned.copy(), len(mpc.MOVE_BLOCKS)
    for amplitude in np.linspace(0.02, 0.6, 30):
        noise = amplitude * np.repeat(random.uniform(-1.0, 1.0, (blocks, 2)), mpc.MOVE_BLOCKS, axis=0)
        planned = np.clip(rest + noise, -0.95, 0.95)
        before = controller._predict(state, planned, [0])[0]
        changes = controller._changes(planned[0], before)
        controller._planned = planned.copy()
        controller._improve(state, [0])
        after = controller._predict(state, controller._planned, [0])[0]
        applied.append(np.abs(controller._planned - planned).sum() / np.abs(changes).sum())
        assert after.cost < before.cost or applied[-1] == 0.0
    assert {0.0, 1.0} < set(np.round(applied, 6).tolist())


def test_changes_act_as_about_where_the_arm_will_be(monkeypatch):
    """Amid a slew of the elbow by 1.7 rad: slopes are those of the simulator, by differences, to a third at most.

    About where the arm is at the end of the first period they are not half as good.
    """
    model, limits, _ = posed()
    start, goal, now = np.array([[0.0, 0.3]]), np.array([[1.2, 2.0]]), 20
    controller, between, used = mpc.MPC(model, limits, PERIOD), mpc.MPC._interpolate, []
    controller.reset(ONLY, EpisodeInfo(start, goal, PERIOD), 1)
    monkeypatch.setattr(controller, "_interpolate", lambda *given: used.append(between(controller, *given)) or used[-1])
    plan, ahead = controller._plans[0], sum(mpc.MOVE_BLOCKS)
    planned, state = np.clip(plan.torques[now : now + ahead], -1.0, 1.0), plan.states[now]
    controller._planned[0], controller._now[0] = planned, now
    controller.act({"state": state[None]}, np.zeros((1, 2)), np.array([True]))
    m, h = 2 * len(mpc.MOVE_BLOCKS), 1e-4
    changes = h * np.vstack([np.eye(m), -np.eye(m), np.zeros((1, m))])
    drives, batch = np.zeros((len(changes), ahead, 8)), controller._make_batch(len(changes))
    drives[..., :2] = (planned + np.repeat(changes.reshape(len(changes), -1, 2), mpc.MOVE_BLOCKS, axis=1)) * limits
    batch.reset(np.arange(len(changes)), np.repeat(state[None], len(changes), axis=0))
    states, outputs = batch.roll(drives)
    gaps = np.array(
        [controller._residuals(used[0], *each)[: -2 * model.n_dof] for each in zip(states, outputs, strict=True)]
    )
    true = (gaps[:m] - gaps[m:-1]) / (2.0 * h)
    horizons = used[0], between(controller, plan, states[-1, 0])
    errors = [np.linalg.norm(each.jacobian[:, : true.shape[1]] - true) / np.linalg.norm(true) for each in horizons]
    assert errors[0] < 1.0 / 3.0 and errors[0] < 0.5 * errors[1], errors


@pytest.mark.slow
@pytest.mark.parametrize("name", ["FlexOne-v0", "FlexPlanar-v0", "FlexRRR-v0"])
def test_it_is_quicker_than_the_tracking_lqr_within_the_limits(name):
    environment = Configuration(name, {"horizon": 5.0})
    results = [rollout(each, environment, [9000, 9001]).records for each in ("mpc", "lqr-tracking")]
    times = [[settling_time(each.errors, each.band, each.period) for each in records] for records in results]
    assert (np.array(times[0]) < np.array(times[1])).all()
    actions = np.concatenate([each.actions for each in results[0]])
    assert 0.99 < np.abs(actions).max() <= 1.0


@pytest.mark.slow
def test_an_arm_among_many_gets_what_an_arm_alone_gets_to_the_bit():
    """In the vector environment and in the single one."""
    seeds = [9000, 9003, 9007]
    venv = gym.make_vec("FlexPlanar-v0", 3, "vector_entry_point", base="mpc").unwrapped
    env = gym.make("FlexPlanar-v0", base="mpc").unwrapped
    venv.reset(seed=seeds)
    env.reset(seed=seeds[1])
    for _ in range(60):
        venv.step(np.zeros((3, 2), dtype=np.float32))
        env.step(np.zeros(2, dtype=np.float32))
        assert np.array_equal(env.episodes.view.action[0], venv.episodes.view.action[1])
    assert np.ptp(venv.episodes.view.action, axis=0).min() > 0.0


@pytest.mark.slow
def test_an_arm_that_does_not_play_gets_nothing_and_changes_nothing():
    model, limits, posture = posed()
    goals, starts = np.array([posture, -posture]), np.zeros((2, 2))
    both, states = mpc.MPC(model, limits, PERIOD), np.array([fm.rest_state(model, each) for each in starts])
    both.reset(np.arange(2), EpisodeInfo(starts, goals, PERIOD), 2)
    kept = both._planned[1].copy()
    actions = both.act({"state": np.array([states[0], np.full_like(states[1], 1e9)])}, starts, np.array([True, False]))
    assert actions[0].any() and not actions[1].any() and np.array_equal(both._planned[1], kept)
    alone = mpc.MPC(model, limits, PERIOD)
    alone.reset(ONLY, EpisodeInfo(starts[:1], goals[:1], PERIOD), 1)
    assert np.array_equal(alone.act({"state": states[:1]}, starts[:1], np.array([True]))[0], actions[0])


def test_a_goal_that_moves_and_a_missing_package_are_refused(monkeypatch, capsys):
    model, limits, posture = posed("FlexOne-v0")
    moving = EpisodeInfo(posture[None], posture[None], PERIOD, lambda: np.zeros((1, 4, 1)))
    assert refusal(mpc.MPC(model, limits, PERIOD).reset, ONLY, moving, 1).startswith("episode: 'a moving goal' is")
    monkeypatch.setitem(sys.modules, "daqp", None)
    with pytest.raises(ImportError, match=r"flexman_gym\[mpc\]"):
        mpc.MPC(model, limits, PERIOD)
    assert main(["evaluate", "mpc", "--env", "FlexOne-v0", "--episodes", "1"]) == 2
    assert capsys.readouterr().err == "the MPC needs daqp: pip install 'flexman_gym[mpc]'\n"


@pytest.mark.parametrize("unit", [1, 3])
def test_the_horizon_is_in_time_units(unit):
    """A third of the control period with three periods in a unit is the same time; torques change at the same times."""
    model, limits, _ = posed()
    own = mpc.MPC(model, limits, PERIOD / unit, scales=ArmScales((1.0,) * 2, torque_slew=150.0 * PERIOD))
    assert PERIOD / unit * np.array(own._blocks) == pytest.approx(PERIOD * np.array(mpc.MOVE_BLOCKS))
    assert own._planned.shape[1] == unit * sum(mpc.MOVE_BLOCKS)


def test_the_reference_is_within_the_rates():
    """The largest rate of the slew is the planned one, where torques allow more."""
    model, limits, posture = posed()
    own = mpc.MPC(model, 1e3 * limits, PERIOD, scales=ArmScales((0.5,) * 2, torque_slew=1.0))
    own.reset(ONLY, EpisodeInfo(np.zeros((1, 2)), posture[None], PERIOD), 1)
    rates = own._plans[0].states[:, model.n_dof + model.motor_columns]
    assert np.abs(rates).max() == pytest.approx(0.5, rel=0.03)


@pytest.mark.slow
def test_an_optimised_slew_is_followed_with_its_own_torques():
    """The prediction equals the reference, so that no change of the torques is due until its end is near."""
    configuration = Configuration("FlexRRR-v0")
    plant = make_plant(configuration, resolve_fidelity(configuration).model)
    controller, planner = make_base({"kind": "mpc", "slew": "planned"}, plant), make_base("planned", plant)
    start, goal = np.array([0.2, -0.3, 0.4]), np.array([-0.5, 0.1, 0.6])
    (states, torques), jacobians = planner.motion(start, goal)
    controller.reset(ONLY, EpisodeInfo(start[None], goal[None], plant.period), 1)
    for period in range(30):
        action = controller.act({"state": states[period][None]}, np.zeros((1, 3)), np.ones(1, dtype=bool))
        np.testing.assert_allclose(action[0], torques[period] / np.array(plant.torque_limit), atol=1e-9)
    assert controller.estimates["planning_time"].tolist() == [JACOBIAN_TIME * jacobians]
    assert make_base("mpc", plant).estimates == {}


def test_an_unknown_slew_is_refused():
    configuration = Configuration("FlexOne-v0")
    plant = make_plant(configuration, resolve_fidelity(configuration).model)
    assert "base.slew: 'bent'" in refusal(make_base, {"kind": "mpc", "slew": "bent"}, plant)
