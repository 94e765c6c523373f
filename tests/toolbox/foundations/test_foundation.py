"""Foundation that an agent moves: limits of its servo, motion of the arm on it, goals, shaping and refusals."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import flexman_gym as fm
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.foundation import find_foundation, plain_foundation
from flexman_gym.evaluation.agents import find_agent
from flexman_gym.evaluation.rollouts import rollout
from flexman_gym.toolbox.foundations.travel import MovingFoundation, Travel

from oracles.assertions import refusal

ID = "FlexGantry-v0"
TEXTBOOK = {"modes": 0, "control_period": 0.01, "horizon": 40.0}  # a rigid bridge


def textbook_arm(rope=4.0):
    """Return the gantry without friction, and with a portal and a bridge that do not yield."""
    arm = fm.catalog.gantry(rope=rope, payload=fm.Payload(500.0))
    stiff = [replace(arm.joints[0], stiffness=1e12), *(replace(each, viscous_friction=0.0) for each in arm.joints[1:])]
    return replace(arm, joints=stiff)


def textbook(rope=4.0, **changes):
    """Return the environment of a trolley with a pendulum."""
    limits = {"angle": 3.2, "rate": 9.0, "deflection_rate": 9.0, "tip_speed": 9.0}
    given = {"arm": textbook_arm(rope), "settings": "named", "limits": limits} | TEXTBOOK | changes
    return gym.make(ID, **given).unwrapped


@settings(deadline=None, max_examples=40, derandomize=True)
@given(
    st.integers(0, 10**6),
    st.floats(0.1, 3.0),
    st.floats(0.05, 2.0),
    st.floats(0.2, 4.0),
    st.sampled_from([0.005, 0.02]),
)
def test_servo_keeps_its_limits_and_stops_before_the_end_of_the_travel(seed, speed, acceleration, travel, period):
    rng = np.random.default_rng(seed)
    foundation = MovingFoundation(Travel((0.0, 1.0, 0.0), speed, acceleration, travel), 3, period)
    ends = {"travel_start": rng.uniform(-travel, travel, (3, 1)), "travel_goal": np.zeros((3, 1))}
    foundation.begin(np.arange(3), ends)
    every, slack = np.ones(3, dtype=bool), 1.0 + 1e-9
    for k in range(600):
        before, commands = foundation.velocity.copy(), rng.uniform(-1.0, 1.0, (3, 1))
        commands[0] = np.sign(np.sin(k / 90.0))  # full speed to and fro
        commands[1] = 1.0
        foundation.advance(commands, every)
        assert np.abs(foundation.position).max() <= travel * slack
        assert np.abs(foundation.velocity).max() <= speed * slack
        assert np.abs(foundation.velocity - before).max() <= acceleration * period * slack


@pytest.mark.parametrize("period", [0.005, 0.02, 0.1])
def test_servo_at_full_speed_comes_to_rest_at_the_stop(period):
    foundation = MovingFoundation(Travel(speed=1.5, acceleration=0.7, travel=2.0), 1, period)
    foundation.begin(np.array([0]), {"travel_start": np.full((1, 1), -2.0), "travel_goal": np.zeros((1, 1))})
    for _ in range(round(12.0 / period)):
        foundation.advance(np.ones((1, 1)), np.array([True]))
    assert 0.0 <= foundation.velocity[0, 0] < 0.01
    assert 2.0 - 0.01 * 2.0 - 1.5 * period < foundation.position[0, 0] <= 2.0


def test_servo_reaches_a_commanded_velocity_at_the_end_of_a_period_half_a_period_late():
    foundation = MovingFoundation(Travel(speed=1.0, acceleration=100.0, travel=50.0), 1, 0.01)
    foundation.begin(np.array([0]), {"travel_start": np.zeros((1, 1)), "travel_goal": np.zeros((1, 1))})
    for _ in range(100):
        foundation.advance(np.array([[0.5]]), np.array([True]))
    assert foundation.velocity[0, 0] == 0.5
    assert foundation.position[0, 0] == pytest.approx(0.5 * (1.0 - 0.005))


def test_base_accelerates_as_its_velocity_rises_and_the_load_lags_behind():
    env = gym.make(ID).unwrapped
    env.reset(seed=3, options={"travel_start": [-1.0], "travel_goal": [1.0]})
    foundation, start = env.episodes.foundation, env.episodes.view.tip[0, 0]
    for _ in range(20):
        before = foundation.velocity[0, 0]
        env.step(np.ones(1, dtype=np.float32))
        rate = (foundation.velocity[0, 0] - before) / 0.02
        np.testing.assert_allclose(foundation.accelerations[0], [rate, 0.0, 0.0], atol=1e-12)
    assert rate == pytest.approx(0.3) and env.episodes.view.tip[0, 0] < start - 1e-3


def test_arm_on_a_foundation_moves_as_a_scene_with_its_acceleration():
    """The accelerations of the servo as the acceleration of the base, on the same model and from the same state."""
    env = gym.make(ID, control_period=0.02).unwrapped
    env.reset(seed=3, options={"travel_start": [-1.0], "travel_goal": [1.0]})
    episodes, rng, accelerations, tips = env.episodes, np.random.default_rng(0), [], []
    state, model = episodes.view.state[0].copy(), episodes.batch.model
    for _ in range(100):
        env.step(rng.uniform(0.0, 1.0, 1).astype(np.float32))
        accelerations.append(episodes.foundation.accelerations[0].copy())
        tips.append(episodes.view.tip[0].copy())
    simulator = fm.Simulator(model, "dop853", None, 0.02, rtol=1e-9, atol=1e-12)
    simulator.reset(state=state)
    found = []
    for each in accelerations:
        simulator.step([0.0] * 3, base_acceleration=each)
        found.append(simulator.tip.copy())
    np.testing.assert_allclose(tips, found, atol=2e-4)
    assert np.ptp(np.array(tips)[:, 0]) > 0.1  # m; swing
    world = tips[-1] + episodes.foundation.position[0] * [1.0, 0.0, 0.0]
    goal = fm.rest_state(model, [0.0] * 3)
    assert goal.shape == state.shape
    target = episodes.view.target[0] + episodes.foundation.position[0] * [1.0, 0.0, 0.0]
    np.testing.assert_allclose(target, [1.0, *episodes.view.rest_tips(np.zeros((1, 3)))[0, 1:]], atol=1e-9)
    assert episodes.view.tip_error[0] == pytest.approx(np.linalg.norm(target - world))


def test_an_action_is_the_velocity_of_the_foundation_alone_where_all_joints_are_passive():
    env = gym.make(ID).unwrapped
    assert env.action_space.shape == (1,) and env.episodes.agent.mode.names == ("travel",)
    assert not env.torque_limit.any()
    names = list(env.episodes.sensors.slices)
    assert names[-3:] == ["travel", "travel_rate", "travel_error"]
    refused = refusal(lambda: gym.make("FlexPlanar-v0", arm=textbook_arm()))
    assert "a joint with a motor, or the setting foundation" in refused


def test_start_and_goal_of_the_travel_are_drawn_between_the_stops_or_given():
    venv = gym.make_vec(ID, 64, "vector_entry_point")
    venv.reset(seed=1)
    foundation = venv.unwrapped.episodes.foundation
    for drawn in (foundation.position, foundation.goal):
        assert drawn.min() < -4.0 and drawn.max() > 4.0 and np.abs(drawn).max() <= 8.0
    env = gym.make(ID).unwrapped
    env.reset(seed=1, options={"travel_start": [2.0], "travel_goal": [-3.0]})
    assert env.episodes.foundation.readings.tolist() == [[2.0, 0.0, -5.0]]
    line = refusal(lambda: env.reset(options={"travel_goal": [9.0]}))
    assert line.startswith("options['travel_goal']") and "8 m" in line


def test_swing_lowers_the_reward_at_the_goal():
    env = gym.make(ID).unwrapped
    rewards = []
    for acceleration in (0.0, 0.3):  # of the base, before the arm is at the goal
        env.reset(seed=1, options={"travel_start": [0.0], "travel_goal": [0.0]})
        env.episodes.batch.state[0, env.episodes.batch.model.n_dof + 1] = acceleration  # rad/s, of the swing
        rewards.append(sum(env.step(np.zeros(1, dtype=np.float32))[1] for _ in range(60)))
    assert rewards[1] < rewards[0] - 5.0


def residual(env, commands, periods):
    """Return the amplitude of the free swing after commanded velocities, m, by a fit at the frequency of the swing."""
    env.reset(seed=0, options={"travel_start": [0.0], "travel_goal": [0.0]})
    tips = []
    for k in range(len(commands) + periods):
        command = commands[k] if k < len(commands) else commands[-1]
        env.step(np.array([command], dtype=np.float32))
        if k >= len(commands):
            tips.append(env.episodes.view.tip[0, 0])
    rate, time = 2.0 * np.pi * fm.modes(env.episodes.batch.model).frequencies[0], 0.01 * np.arange(len(tips))
    basis = np.column_stack([np.cos(rate * time), np.sin(rate * time), np.ones(len(time))])
    return np.hypot(*np.linalg.lstsq(basis, tips, rcond=None)[0][:2])


@pytest.mark.feature
@pytest.mark.slow
def test_zv_shaping_of_the_trolley_leaves_the_residual_that_theory_predicts():
    """A ramp of the velocity, with ZV shaping (Singer and Seering, 1990) for a rope of 4 m; impulses split by 10 ms.

    The swing stays below 2 degrees. At the design length the residual is below 0.1 % of that of the ramp alone.
    """
    from flexman_gym.toolbox.controllers.input_shaping.shapers import design_shaper, shaper_residual

    env = textbook()
    design = fm.modes(env.episodes.batch.model).frequencies[0]
    shaper, top = design_shaper("zv", design), 0.08  # fraction of 1 m/s
    fractions = shaper.sample(0.01)
    plain, shaped = np.full(1, top), np.cumsum(fractions) * top
    for rope in (4.0, 3.0, 3.6, 4.5, 5.5):
        env = textbook(rope, foundation={"kind": "travel", "acceleration": 10.0, "travel": 50.0})
        own = fm.modes(env.episodes.batch.model).frequencies[0]
        alone, after = residual(env, plain, 400), residual(env, shaped, 400)
        assert 0.0 < alone < np.radians(2.0) * rope
        ratio, expected = after / alone, shaper_residual(shaper, own) / 100.0
        if rope == 4.0:
            assert ratio < 1e-3
        else:
            assert ratio == pytest.approx(expected, rel=0.02)
            assert expected == pytest.approx(abs(np.cos(np.pi / 2.0 * own / design)), rel=1e-9)


@pytest.mark.feature
@pytest.mark.slow
@pytest.mark.parametrize("condition", ["nominal", "short-rope", "long-rope", "unknown"])
def test_shaped_travel_settles_where_the_travel_alone_swings(condition):
    name = ID if condition == "nominal" else f"{ID}/{condition}"
    shaped, plain = (fm.evaluate(agent, name, seeds=range(8)) for agent in ("pd-shaped", "pd"))
    assert shaped["settled"] == 1.0 and plain["settled"] <= 0.25 and shaped["failed"] == plain["failed"] == 0.0


def test_single_and_vector_environment_are_equal_and_a_state_is_restored():
    env, venv = gym.make(ID, base="pd-shaped").unwrapped, gym.make_vec(ID, 3, "vector_entry_point", base="pd-shaped")
    env.reset(seed=5)
    venv.reset(seed=[4, 5, 6])
    rng, stored, tail = np.random.default_rng(1), None, []
    for k in range(60):
        action = rng.uniform(-0.1, 0.1, 1).astype(np.float32)
        one = env.step(action)
        many = venv.step(np.tile(action, (3, 1)))
        assert np.array_equal(one[0], many[0][1]) and one[1] == many[1][1]
        if k == 30:
            stored, tail = env.get_state(), []
        tail.append(one[0])
    rng = np.random.default_rng(1)
    env.set_state(stored)
    actions = [rng.uniform(-0.1, 0.1, 1).astype(np.float32) for _ in range(60)]
    again = [env.step(action)[0] for action in actions[31:]]
    assert np.array_equal(again, tail[1:])


def test_files_keep_the_foundation(tmp_path):
    configuration = Configuration(ID, {"foundation": {"kind": "travel", "speed": 0.5}})
    configuration.save(tmp_path / "gantry.yaml")
    loaded = Configuration.load(tmp_path / "gantry.yaml")
    assert loaded == configuration and loaded.foundation == Travel(speed=0.5)
    assert find_foundation(plain_foundation(Travel((0.0, 2.0, 0.0)))) == Travel((0.0, 1.0, 0.0))
    assert Configuration(ID).changed(["foundation.speed=0.7"]).foundation.speed == 0.7


@pytest.mark.parametrize("value, field", [
    ({"kind": "rail"}, "foundation.kind"), ({"speed": 1.0}, "foundation"), ("travel", "foundation"),
    ({"kind": "travel", "speed": 0.0}, "Travel.speed"), ({"kind": "travel", "axis": [0, 0, 0]}, "Travel.axis"),
    ({"kind": "travel", "stops": 1.0}, "foundation"),
])  # fmt: skip
def test_foundations_that_are_not_allowed_are_refused(value, field):
    assert refusal(lambda: Configuration(ID, {"foundation": value})).startswith(field)


def test_what_a_moving_foundation_excludes_is_refused_in_one_line():
    assert "passive" in refusal(lambda: Configuration(ID, {"safety": True}))
    line = refusal(lambda: Configuration("FlexPlanar-v0", {"safety": True, "foundation": {"kind": "travel"}}))
    assert line.startswith("safety") and "the foundation of the arm moves" in line
    assert "the setting foundation" in refusal(lambda: gym.make("FlexPlanar-v0", sensors=["full", "foundation"]))


def programs_without_travel():
    """Return calls of programs that command torques only, by name."""
    from flexman_gym.toolbox.controllers.margins import sampled_loops
    from flexman_gym.toolbox.deployment.c_code import begin_agent
    from flexman_gym.toolbox.deployment.machine.arm import SimulatedArm
    from flexman_gym.toolbox.deployment.machine.drive import wanted_quantities

    planar = Configuration("FlexPlanar-v0", {"foundation": {"kind": "travel"}})
    return {
        "export c": lambda: begin_agent("pd-shaped", ID),
        "drive": lambda: wanted_quantities("pd", planar),
        "simulated machine": lambda: SimulatedArm(planar, 0),
        "sensitivities": lambda: fm.sensitivities(planar, of="tip", to=("payload_mass",), agent="pd"),
        "bode": lambda: sampled_loops(fm.build_model(fm.catalog.gantry()), [0.0] * 3, 0.02),
    }


@pytest.mark.parametrize("name", ["export c", "drive", "simulated machine", "sensitivities", "bode"])
def test_programs_without_the_travel_are_refused_in_one_line(name):
    expected = "arm.joints: 'passive joints'" if name == "bode" else "foundation: 'travel' is not allowed; give None: "
    assert refusal(programs_without_travel()[name]).startswith(expected)


def test_a_designed_agent_commands_the_travel_once():
    """Trained policies and the agents of the league have an action mode that commands the foundation already."""
    bare = Configuration(ID, {"horizon": 4.0})
    spec = find_agent("pd-shaped")
    designed = spec.designed(bare)
    assert designed.interface["actions"].names == ("travel",)
    expected, found, (timed, _) = rollout(spec, bare, [3]), rollout(designed, bare, [3]), spec.timed(bare)
    assert np.array_equal(found.tips, expected.tips)
    assert np.array_equal(rollout(timed, bare, [3]).tips, expected.tips)
    assert np.ptp(expected.bases[0, :, 0]) > 0.5


def test_a_saved_episode_has_the_positions_of_the_base(tmp_path):
    result = rollout("pd", Configuration(ID, {"horizon": 1.0}), [9000, 9001])
    episode = result.episode(1)
    travel, axis = episode.readings["travel"], np.array([1.0, 0.0, 0.0])
    assert np.array_equal(episode.bases, travel * axis) and np.ptp(travel) > 0.05
    assert np.ptp(episode.targets + episode.bases, axis=0) == pytest.approx(0.0, abs=1e-12)
    loaded = fm.Episode.load(episode.save(tmp_path / "episode.npz"))
    assert np.array_equal(loaded.bases, episode.bases)
    assert np.array_equal(loaded.columns()["base_x (m)"], travel[:, 0])
    fixed = rollout("pd", Configuration("FlexOne-v0", {"horizon": 0.1}), [0]).episode(0)
    assert fixed.bases is None and not fixed.base_positions.any() and "base_x (m)" not in fixed.columns()


def test_frames_show_the_travel():
    """A frame of an arm at a base elsewhere is the frame of the arm, seen by a camera that is elsewhere by as much."""
    from flexman_gym.toolbox.view.frames import FramePainter

    model, base = fm.build_model(fm.catalog.gantry()), np.array([3.0, -2.0, 0.0])
    state, painter = fm.rest_state(model, [0.0] * 3), FramePainter(model, (96, 72), overlays=False)
    points = np.array([[2.0, 7.0, 1.0], [-2.0, -1.0, -5.0]])
    shots = painter.shot(points), painter.shot(points + base, base[None])
    np.testing.assert_allclose(shots[1].camera.eye, shots[0].camera.eye + base, atol=1e-9)
    shot = shots[0]._replace(camera=shots[1].camera)  # the grid of the floor stays in the world
    target = np.array([0.5, 6.0, -4.0])
    still = painter.paint(state, target, shot=shots[0])
    moved = painter.paint(state, target + base, shot=shot, base=base)
    assert np.abs(still.astype(int) - moved).mean() < 0.05
    assert np.abs(still.astype(int) - painter.paint(state, target + base, shot=shot)).mean() > 2.0

    env = gym.make(ID, render_mode="rgb_array", render_size=(96, 72), base="pd")
    env.reset(seed=1, options={"travel_start": [-6.0], "travel_goal": [6.0]})
    first = env.render().astype(int)
    for _ in range(200):
        env.step(np.zeros(1, dtype=np.float32))
    assert np.abs(env.render() - first).mean() > 2.0


def test_live_view_of_the_gantry_starts_and_refuses_a_target():
    with fm.live(ID, ["pd-shaped"]) as session:
        assert "joint_damping" not in session.state()["values"]
        assert "fixed foundation" in refusal(lambda: session.command({"target": [0.0, 6.0, -4.0]}))


def test_description_of_an_arm_with_passive_joints_only():
    text = str(fm.describe("gantry", ID))
    assert "joint 1                      passive" in text and "nan" not in text


def test_gantry_in_mujoco_moves_as_here():
    """Rigid links have one body, and a passive joint is a hinge with its spring and without an actuator."""
    pytest.importorskip("mujoco")
    from flexman_gym.toolbox.interchange.mjcf import to_mjcf
    from flexman_gym.toolbox.league.scenarios import PLANTS

    text = to_mjcf(fm.catalog.gantry())
    assert text.count("<motor") == 0 and 'name="spring 0"' not in text and 'stiffness="2000000.0"' in text
    bare = Configuration(ID, {"horizon": 6.0})
    here, there = (rollout("pd", bare, [9000], set_plant=PLANTS[each][1]) for each in ("usual", "mujoco"))
    assert np.ptp(here.tips[0, :, 0]) > 0.3 and np.abs(here.tips - there.tips).max() < 2e-3
    assert np.array_equal(here.bases, there.bases)
