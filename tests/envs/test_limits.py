"""Tests of limits of strain, spring torque and workspace: distances, margins, ends of episodes, cost and metrics."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import flexman_gym as fm
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.envs.vector_env import FlexManVectorEnv
from flexman_gym.evaluation.metrics import LIMIT_METRICS, evaluate
from flexman_gym.evaluation.rollouts import SELECTION_SEEDS
from flexman_gym.evaluation.tables import metrics_table
from flexman_gym.simulation.physical_parameters import varied_model

from oracles.assertions import refusal, same, same_alone_and_among_others, same_side_by_side
from oracles.files import ROOT
from oracles.random_inputs import actions, states_of

FLOOR, BOX, BALL = {"half_space": [[0, 3, -4], 5.0]}, {"box": [[-8, -7, -6], [8, 7, 6]]}, {"sphere": [[0, 0, 1], 8.5]}
ALL = {
    "strain": [4e-5, 1e-4, 1.2e-4], "spring_torque": 300.0, "workspace": [FLOOR, BOX, BALL],
    "margin": {"strain": 1e-5, "spring_torque": 20.0, "workspace": 0.1, "angle": 1.0, "deflection": 0.23},
}  # fmt: skip


def motion(name, torque, periods, **settings):
    """Return the state and the info after each period of an episode under constant torques, and if it terminated."""
    env = gym.make(name, **settings).unwrapped
    env.reset(seed=0, options=settings.get("options"))
    rows, action = [], np.full(env.action_space.shape, torque)
    for _ in range(periods):
        *_, terminated, _, info = env.step(action)
        rows.append((env.simulator.state.copy(), info, terminated))
        if terminated:
            break
    return env, rows


def strains(env, rows):
    """Return the strains (T,) at the gauge y = r of the root of the only link, by its curvature."""
    model, (radius, *_) = env.simulator.model, env.episodes.view.gauge_radii[0]
    return np.array([fm.strain(model, state, 0, 0.0, y=radius) for state, _, _ in rows])


def springs(env, rows):
    """Return the torques (T,) of the spring of the only joint, stiffness times twist."""
    twists = [state[env.simulator.model.motor_columns[0]] - state[0] for state, _, _ in rows]
    return env.simulator.model.arm.joints[0].stiffness * np.array(twists)


WALL = [{"half_space": [[0, 2, 0], 0.8]}], [{"half_space": [[0, -2, 0], 0.8]}]  # y <= 0.4 m, y >= -0.4 m


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("limit", "quantity"), [("strain", strains), ("spring_torque", springs)])
def test_an_episode_ends_in_the_first_period_beyond_a_limit_minus_its_margin(limit, quantity, sign):
    env, rows = motion("FlexOne-v0", 0.2 * sign, 12)
    sizes = np.abs(quantity(env, rows))
    first = int(np.argmax(sizes))
    assert first > 0, "the limit lies between two periods"
    level = 0.5 * (sizes[first] + sizes[:first].max())
    for margin in (0.0, 0.2 * level):
        limits = {limit: level + margin, "margin": {limit: margin}}
        ended = motion("FlexOne-v0", 0.2 * sign, 12, limits=limits)[1]
        assert [terminated for *_, terminated in ended] == [False] * first + [True]
        left = [info["limits"][limit].min() for _, info, _ in ended]
        assert left == pytest.approx(level - sizes[: first + 1], rel=1e-9, abs=1e-9 * level)
        assert ended[-1][1]["failure"].startswith(f"{limit} beyond its limit by ")


@pytest.mark.parametrize(("sign", "wall"), [(1.0, WALL[0]), (-1.0, WALL[1])])
def test_an_episode_ends_at_a_wall(sign, wall):
    start = {"start": [0.0], "goal_angles": [0.1 * sign]}
    env = FlexManEnv(name="FlexOne-v0")
    env.reset(seed=0, options=start)
    ended = FlexManEnv(name="FlexOne-v0", limits={"workspace": wall, "margin": {"workspace": 0.1}})
    ended.reset(seed=0, options=start)
    for _ in range(200):
        action = np.array([0.3 * sign])
        tip = env.step(action)[-1]["tip"]
        *_, terminated, _, info = ended.step(action)
        assert np.array_equal(tip, info["tip"])
        assert info["limits"]["workspace"] == pytest.approx([0.4 - sign * tip[1] - 0.1])
        assert terminated == (sign * tip[1] > 0.3)
        if terminated:
            return
    raise AssertionError("the arm stays in front of the wall")


def test_distances_to_regions_are_those_of_geometry():
    env = FlexManEnv(limits=ALL | {"on_violation": "record"})
    for seed in range(4):
        tip = env.reset(seed=seed)[1]["tip"]
        info = env.step(np.ones(3))[-1]
        tip, distances = info["tip"], info["limits"]["workspace"]
        assert distances[0] == pytest.approx((5.0 - 3.0 * tip[1] + 4.0 * tip[2]) / 5.0 - 0.1)
        assert distances[1] == pytest.approx(np.min([8.0, 7.0, 6.0] - np.abs(tip)) - 0.1)
        assert distances[2] == pytest.approx(8.5 - np.linalg.norm(tip - [0.0, 0.0, 1.0]) - 0.1)


def test_each_link_and_joint_has_its_own_limit():
    env = FlexManEnv(limits={"strain": [1.0, 2.0, 3.0], "spring_torque": [1e4, 2e4, 3e4], "on_violation": "record"})
    env.reset(seed=0)
    left = env.step(np.ones(3))[-1]["limits"]
    linear = fm.linearize(env.simulator.model, outputs=("root_strains", "joint_twists"))
    strains, twists = np.split(np.abs(linear.C @ env.simulator.state), [9])
    assert left["strain"].reshape(3, 3) == pytest.approx(np.array([[1.0], [2.0], [3.0]]) - strains.reshape(3, 3))
    stiffness = [joint.stiffness for joint in env.simulator.model.arm.joints]
    assert left["spring_torque"] == pytest.approx([1e4, 2e4, 3e4] - stiffness * twists)


def test_distances_to_the_limits_of_the_model_are_in_their_units():
    env = FlexManEnv(limits=fm.Limits(margin={"angle": 1.0, "rate": 2.0, "deflection": 0.1}, on_violation="record"))
    env.reset(seed=0)
    for _ in range(20):
        *_, info = env.step(np.array([1.0, -1.0, 1.0]))
    left, view = info["limits"], env.episodes.current_view
    lengths = np.repeat([link.length for link in env.simulator.model.arm.links], 2)
    assert left.keys() == {"angle", "rate", "twist", "deflection", "deflection_rate", "tip_speed"}
    assert left["angle"] == pytest.approx(3.0 - np.abs(view.motor_angles))
    assert left["rate"] == pytest.approx(8.0 - np.abs([*view.motor_rates, *view.joint_twist_rates]))
    assert left["twist"] == pytest.approx(1.0 - np.abs(view.joint_twists))
    assert left["deflection"] * lengths == pytest.approx(0.15 * lengths - np.abs(view.link_deflections))
    assert left["deflection_rate"] == pytest.approx(15.0 - np.abs(view.link_deflection_rates))
    assert left["tip_speed"] == pytest.approx(40.0 - np.abs(view.tip_velocity))


def test_springs_with_knees_have_the_torques_that_accelerate_the_rotors():
    """J a = - spring torque of a rotor at rest without motor torque, by the kernels of the dynamics."""
    parameters = {"joint_stiffness": np.array([[5e3, 4e3, 3e3], [6e3, 5e3, 4e3]]),
                  "soft_stiffness": np.array([[0.3, 0.5, 0.8], [1.0, 0.6, 0.4]]),
                  "backlash": np.array([[2e-3, 0.0, 1e-3], [0.0, 3e-3, 2e-3]])}  # fmt: skip
    env = FlexManVectorEnv(2, condition="unmodelled", randomisation=None, limits={"spring_torque": 1e5})
    env.reset(seed=0)
    assert not env.episodes.view.spring_torques.any(), "at rest, before the parameters change"
    env.reset(seed=0, options={"parameters": parameters})
    batch, model = env.batch, env.batch.model
    for twist in (1e-5, -3e-3, 0.02, -0.1):
        states = np.zeros((2, 2 * model.n_dof))
        states[:, model.motor_columns] = twist * np.array([1.0, -0.5, 0.25])
        batch.reset(np.arange(2), states)
        env.episodes.view.read()
        for arm in range(2):
            varied = varied_model(model, **{name: values[arm] for name, values in parameters.items()})
            rates = fm.acceleration(varied, states[arm], np.zeros(3))[model.motor_columns]
            expected = -rates * [joint.rotor_inertia for joint in model.arm.joints]
            assert env.episodes.view.spring_torques[arm] == pytest.approx(expected, rel=1e-9, abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("settings", [{"on_violation": "cost"}, {"on_violation": "record"}, {}])
@pytest.mark.parametrize("repeat", [1, 3])
def test_many_arms_have_the_distances_and_costs_of_single_ones(settings, repeat):
    same_alone_and_among_others("FlexRRR-v0", 25, limits=ALL | settings, action_repeat=repeat, condition="stiffness")


@pytest.mark.slow
@pytest.mark.parametrize("mode", tuple(AutoresetMode))
def test_distances_and_costs_after_the_end_of_episodes_are_those_of_single_arms(mode):
    ours = FlexManVectorEnv(3, autoreset_mode=mode, limits=ALL)
    theirs = gym.vector.SyncVectorEnv([lambda: FlexManEnv(limits=ALL)] * 3, autoreset_mode=mode)
    assert same_side_by_side(ours, theirs, actions(3, 40))[0], "some episodes end"
    ending = FlexManVectorEnv(
        3, autoreset_mode=mode, infos="at end", limits=ALL | {"on_violation": "cost"}, horizon=0.1
    )
    ending.reset(seed=0)
    *_, infos = [ending.step(np.ones((3, 3)))[-1] for _ in range(5)]
    infos = infos["final_info"] if mode == AutoresetMode.SAME_STEP else infos
    assert infos["cost"].shape == (3,) and infos["limits"]["strain"].shape == (3, 9)


@pytest.mark.parametrize("condition", ["stiffness", "unmodelled"])
def test_shares_of_predicted_states_are_the_signed_quantities_over_their_limits(condition):
    """1 - share is the distance over the limit; a torque of a spring with knees is bounded by that of a linear one."""
    limits = fm.Limits(**ALL)
    env = FlexManVectorEnv(3, limits=limits, condition=condition)
    env.reset(seed=0)
    batch, view = env.batch, env.episodes.view
    batch.reset(np.arange(3), states_of(batch.model, 3))
    view.refresh()
    stiffness = batch.spring_constants()[0]
    shares = limits.predicted(batch.model).shares(batch.state[:, None], batch.outputs[:, None], stiffness)[:, 0]
    margin = dict.fromkeys(("rate", "twist", "deflection_rate", "tip_speed"), 0.0) | dict(limits.margin)
    quantities = {
        "angle": view.motor_angles, "rate": np.hstack([view.motor_rates, view.joint_twist_rates]),
        "twist": view.joint_twists, "deflection": view.link_deflections / np.repeat(view.lengths, 2),
        "deflection_rate": view.link_deflection_rates, "strain": view.root_strains, "tip_speed": view.tip_velocity,
    }  # fmt: skip
    expected = [each / (limits.of_quantities(name) - margin[name]) for name, each in quantities.items()]
    first = sum(each.shape[1] for each in expected)
    assert shares[:, :first] == pytest.approx(np.hstack(expected), rel=1e-9, abs=1e-12)
    torques, depths = np.split(shares[:, first:], [3], axis=1)
    exact = view.spring_torques / (300.0 - 20.0)
    same_torques = torques == pytest.approx(exact, rel=1e-9, abs=1e-9)
    assert same_torques if condition == "stiffness" else (np.abs(torques) >= np.abs(exact) - 1e-9).all()
    reach = batch.model.constants.length.sum()
    inside = np.minimum(limits.distances(view)["workspace"], reach)  # deeper points are as safe
    assert 1.0 - depths == pytest.approx(inside / reach)


def test_the_cost_of_a_step_is_its_number_of_periods_in_violation():
    costs, beyond = {}, None
    for rule, repeat in (("record", 1), ("cost", 1), ("cost", 5)):
        env = FlexManEnv(limits=ALL | {"on_violation": rule}, action_repeat=repeat)
        env.reset(seed=1)
        infos = [env.step(np.array([0.6, -0.6, 0.6]))[-1] for _ in range(40 // repeat)]
        costs[rule, repeat] = [info["cost"] for info in infos]
        assert {type(cost) for cost in costs[rule, repeat]} == {float}
        if beyond is None:
            beyond = [float(min(each.min() for each in info["limits"].values()) < 0.0) for info in infos]
    assert 0 < sum(beyond) < 40 and not any(costs["record", 1]) and costs["cost", 1] == beyond
    assert costs["cost", 5] == np.reshape(beyond, (8, 5)).sum(axis=1).tolist()
    assert env.reset(seed=1)[1]["cost"] == 0.0


def test_an_environment_without_these_limits_has_no_distances():
    for env in (FlexManEnv(), FlexManEnv(limits={"angle": 3.0}), FlexManVectorEnv(2)):
        env.reset(seed=0)
        *_, info = env.step(np.zeros(env.action_space.shape))
        assert {"limits", "cost"}.isdisjoint(info)


def test_starts_and_goals_are_drawn_in_the_workspace():
    wall, free = [{"half_space": [[0, 0, -1], 1.0]}], FlexManEnv()  # z >= -1 m
    inside, outside = FlexManEnv(limits={"workspace": wall, "margin": {"workspace": 2.5}}), 0
    for seed in range(12):
        info = inside.reset(seed=seed)[1]
        assert info["tip"][2] >= 1.5 and info["target"][2] >= 1.5
        given = free.reset(seed=seed)[1]
        low = min(given["tip"][2], given["target"][2]) < 1.5
        outside += low
        assert low or np.array_equal(given["tip"], info["tip"]), "a draw in the workspace is kept"
    assert outside
    nowhere = FlexManEnv(limits={"workspace": [{"sphere": [[0, 0, 0], 0.01]}]})
    assert refusal(lambda: nowhere.reset(seed=0)).startswith("limits.workspace: ")
    beyond = {"start": [0.0, -1.0, 0.0]}
    assert "workspace beyond its limit" in refusal(lambda: inside.reset(seed=0, options=beyond))


def test_a_state_is_restored_with_its_distances_and_costs():
    envs = [FlexManVectorEnv(3, limits=ALL | {"on_violation": "cost"}, action_repeat=2) for _ in range(2)]
    for seed, env in enumerate(envs):
        env.reset(seed=seed)
        env.step(np.full((3, 3), 0.5))
    envs[1].set_state(envs[0].get_state())
    for _ in range(10):
        (*_, first), (*_, second) = (env.step(np.full((3, 3), -0.5)) for env in envs)
        same(first, second)


def test_limits_are_the_same_by_keyword_file_and_command(tmp_path):
    given = Configuration("FlexRRR-v0", {"limits": ALL | {"on_violation": "cost"}})
    assert given.limits == fm.Limits(**ALL, on_violation="cost") and given.limits.recorded
    for suffix in ("json", "yaml"):
        given.save(tmp_path / f"own.{suffix}")
        assert Configuration.load(tmp_path / f"own.{suffix}").limits == given.limits
    changes = ["limits.strain=1e-4", "limits.margin.strain=1e-5", "limits.workspace=[{sphere: [[0, 0, 0], 8]}]"]
    ball = [{"sphere": [[0, 0, 0], 8]}]
    assert Configuration.find("FlexRRR-v0", changes).limits == fm.Limits(
        strain=1e-4, margin={"strain": 1e-5}, workspace=ball
    )
    assert fm.Limits(angle=2.0).to_plain().keys() == {"angle", "rate", "twist", "deflection", "deflection_rate",
                                                      "tip_speed"}  # fmt: skip


def test_a_material_yields_at_the_surface_of_a_rod_when_its_gauge_is_at_the_limit():
    radius, rod = 0.01, fm.Link.rod(1.0, 0.02, material="steel")
    gauge = np.sqrt(rod.second_moment_y / rod.area)
    strain = fm.Limits(strain="steel").strain
    assert strain * radius / gauge * rod.youngs_modulus == pytest.approx(435e6)


WRONG = {
    "strain": [0.0, -1.0, np.nan, True, "wood", [], [1e-4, 0.0], {}],
    "spring_torque": [0.0, "steel", [1.0, "2"], [], np.inf],
    "workspace": [
        [], {}, "box", [1], [{}], [FLOOR | BOX], [{"cone": [1, 2]}], [{"sphere": [[0, 0, 0], 0.0]}],
        [{"sphere": [[0, 0], 1.0]}], [{"box": [[0, 0, 0], [1, 0, 1]]}], [{"half_space": [[0, 0, 0], 1.0]}],
        [{"half_space": [[0, 0, 1]]}], [{"half_space": 3}], [{"half_space": [[0, 0, 1], None]}],
    ],
    "margin": [0.1, {"strain": 1e-5}, {"angle": -1.0}, {"angle": 4.0}, {"angles": 0.1}, {"angle": "wide"}],
    "on_violation": ["stop", None, 1],
}  # fmt: skip


@pytest.mark.parametrize(("name", "value"), [(name, value) for name, values in WRONG.items() for value in values])
def test_a_wrong_limit_is_refused_in_one_line(name, value):
    line = refusal(lambda: fm.Limits(**{name: value}))
    assert line.startswith(f"Limits.{name}") and " is not allowed; give " in line


def test_limits_that_do_not_fit_the_arm_are_refused():
    line = refusal(lambda: FlexManEnv(limits={"strain": [1e-4, 1e-4]}))
    assert line == "limits.strain: [0.0001, 0.0001] is not allowed; give one number, or one for each of the 3 joints"
    assert refusal(lambda: FlexManEnv(name="FlexOne-v0", limits="study")).startswith("limits: 'study' is not allowed")
    assert refusal(lambda: FlexManEnv(limits="wide")).endswith("'study' for " + ", ".join(STUDIES))


STUDIES = ("FlexRRR-v0", "FlexRRR-Track-v0", "FlexRRR-Hold-v0", "FlexPlanar-v0", "FlexPlanar-Track-v0",
           "FlexPlanar-Hold-v0")  # fmt: skip


@pytest.mark.feature
@pytest.mark.parametrize("name", ["FlexRRR-v0", "FlexPlanar-v0"])
def test_half_of_the_slews_of_the_lqr_exceed_a_limit_of_the_study(name):
    rows, count = [], 40
    study = Configuration(name, {"limits": "study"}).limits

    def record(episodes):
        rows.append(np.hstack([episodes.view.root_strains, episodes.view.spring_torques]))

    fm.rollout("lqr", name, SELECTION_SEEDS[:count], record)
    peaks = np.abs(rows).max(axis=0)
    joints = peaks.shape[1] // 4
    peaks = np.hstack([peaks[:, : 3 * joints].reshape(count, joints, 3).max(axis=2), peaks[:, 3 * joints :]])
    shares = np.mean(peaks > [*study.strain, *study.spring_torque], axis=0)
    assert (np.abs(shares - 0.5) < 0.2).all(), shares


@pytest.mark.feature
def test_an_episode_names_the_times_of_its_violations():
    limits = {"spring_torque": 0.5, "on_violation": "record"}
    result = fm.rollout("lqr", Configuration("FlexOne-v0", {"limits": limits, "horizon": 2.0}), range(3))
    for i, excess in enumerate(result.excess):
        about = result.episode(i).about
        times = result.period * (1.0 + np.flatnonzero(excess > 0.0))
        listed = [time for time in result.period * np.arange(101)
                  if any(first - 1e-9 < time < last + 1e-9 for first, last, _ in about["violations"])]  # fmt: skip
        assert listed == pytest.approx(times) and len(times) > 0
        assert max(largest for *_, largest in about["violations"]) == excess.max()
        assert about["limits"]["spring_torque"] == 0.5
    assert "limits" not in fm.rollout("pd", "FlexOne-v0", [0]).episode(0).about


@pytest.mark.feature
def test_the_rotary_joint_has_the_limits_of_its_benchmark():
    """Motor angle 1 rad, motor rate 5 rad/s, deflection 0.1 rad of the spring; 10 V; an LQR ignores the spring."""
    environment = Configuration.load(ROOT / "docs/examples/rotary_joint.yaml")
    env = gym.make("FlexRotary-v0", configuration=environment).unwrapped
    env.reset(seed=0, options={"start": [0.3], "goal_angles": [0.8]})
    distances = env.step(np.ones(1))[-1]["limits"]
    view = env.episodes.view
    assert distances["angle"] == pytest.approx(1.0 - np.abs(view.motor_angles[0]))
    assert distances["rate"][0] == pytest.approx(5.0 - abs(view.motor_rates[0, 0]))
    assert distances["spring_torque"] / 1.61 == pytest.approx(0.1 - np.abs(view.joint_twists[0]), abs=1e-12)
    motor = environment.arm.joints[0].motor
    standstill = motor.gear_ratio * motor.torque_constant * 10.0 / 2.6
    assert environment.torque_limit == pytest.approx((standstill,)) and environment.arm.gravity == (0.0, 0.0, 0.0)
    lqr = {"kind": "lqr", "design": "named"}  # with weights of the reach: torques cost less
    found = evaluate(lqr, environment, range(10))
    assert found["settled"] == 1.0 and found["violations"] > 500.0 and found["failed"] == 0.0
    safe = evaluate(lqr, environment, range(10), safety=True)
    assert safe["settled"] == 1.0 and safe["violations"] == 0.0
    assert safe["settling_time"] < 1.1 * found["settling_time"] and safe["change"] > 0.0


@pytest.mark.feature
def test_frames_show_the_strain_over_its_limit_and_the_workspace():
    floor = {"half_space": [[0, 0, -1], 0.3]}
    limits = fm.Limits(strain=1e-5, workspace=[floor], margin={"strain": 2e-6}, on_violation="record")
    env = gym.make("FlexPlanar-v0", limits=limits, render_mode="rgb_array").unwrapped
    plain = gym.make("FlexPlanar-v0", render_mode="rgb_array").unwrapped
    for each in (env, plain):
        each.reset(seed=0)
        each.step(np.ones(2))
    assert (env.render() != plain.render()).any()
    share = limits.strain_share(env.episodes.view)
    assert share[0] == pytest.approx(np.abs(env.episodes.view.root_strains[0]).max() / 1e-5) and share[0] > 1.0
    painter = env._rendering._painter
    assert painter.workspace == limits.workspace and painter.scale == pytest.approx(3.0**0.5 * 1e-5)


@pytest.mark.feature
def test_metrics_of_violations_are_those_of_the_states():
    limits = {"spring_torque": 1.0, "margin": {"spring_torque": 0.2}, "on_violation": "cost"}
    environment = Configuration("FlexOne-v0", {"limits": limits, "horizon": 2.0})
    result = fm.rollout("lqr", environment, range(3))
    env = gym.make("FlexOne-v0").unwrapped
    twists = result.states[..., env.simulator.model.motor_columns[0]] - result.states[..., 0]
    excess = np.maximum(np.abs(env.simulator.model.arm.joints[0].stiffness * twists[:, 1:]) - 0.8, 0.0)
    found = {metric.name: metric.values(result.records) for metric in LIMIT_METRICS}
    assert found["violations"] == pytest.approx(1e3 * (excess > 0.0).any(axis=1))
    assert found["excess"] == pytest.approx(excess.max(axis=1))
    assert found["violation_time"] == pytest.approx(environment.control_period * np.sum(excess > 0.0, axis=1))
    assert (excess > 0.0).any() and evaluate("lqr", environment, range(3))["excess"] == np.max(found["excess"])
    table = metrics_table({"lqr": result.records}, environment)
    lines = table.splitlines()
    first, second = (line for line in lines if line.startswith("agent "))
    assert max(map(len, lines)) <= 100 and first.endswith(" failed")
    assert second == "agent  violations of 1000  excess  violation, s", "a wide table goes on below"
    plain = fm.rollout("pd", "FlexOne-v0", [0])
    assert plain.excess is None and "violations" not in metrics_table(
        {"pd": plain.records}, Configuration("FlexOne-v0")
    )
