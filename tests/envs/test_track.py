"""Track: paths that arms can follow, targets that move on them, and controllers that tell themselves apart there."""

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import flexman_gym as fm
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.envs.tasks import Track
from flexman_gym.envs.tasks.track import PATH_SHAPES, RAMP_FRACTION
from flexman_gym.metrics import rms

from oracles.assertions import refusal

NAMES = ("FlexRRR-Track-v0", "FlexPlanar-Track-v0")
ROUND = 2.0 * np.pi * np.arange(400) / 400
QUICK = settings(deadline=None, derandomize=True, max_examples=20)


def series(values, phases):
    """Values of a Fourier series (size, 2 h + 1), term by term."""
    result = np.repeat(values[:, :1], len(phases), axis=1)
    for k in range(1, values.shape[1] // 2 + 1):
        result += values[:, 2 * k - 1 : 2 * k] * np.cos(k * phases) + values[:, 2 * k : 2 * k + 1] * np.sin(k * phases)
    return result.T


@QUICK
@given(seed=st.integers(0, 10**6), harmonics=st.integers(1, 9))
def test_goals_are_sums_of_waves(seed, harmonics):
    random = np.random.default_rng(seed)
    path, postures = (random.normal(size=(4, size, 2 * harmonics + 1)) for size in (3, 2))
    parameters = {"path": path, "postures": postures, "period": random.uniform(1.0, 5.0, 4)}
    time, ramp = random.uniform(0.0, 20.0, 4), RAMP_FRACTION * parameters["period"]
    phases = 2.0 * np.pi / parameters["period"] * (time - ramp * np.tanh(time / ramp))
    result = Track().goal(parameters, time, None)
    for row in range(4):
        one = Track().goal({name: each[row : row + 1] for name, each in parameters.items()}, time[row : row + 1], None)
        for values, whole, alone in ((path, result.target, one.target), (postures, result.angles, one.angles)):
            assert whole[row] == pytest.approx(series(values[row], phases[row : row + 1])[0], abs=1e-11 * harmonics)
            assert np.array_equal(alone[0], whole[row]), "its own bits"


@pytest.mark.parametrize("shape", PATH_SHAPES)
def test_shapes_are_what_they_are_called(shape):
    places = series(PATH_SHAPES[shape](np.random.default_rng(0), 0.5), ROUND)
    x, y, z = places.T
    assert np.linalg.norm(places, axis=1).max() == pytest.approx(0.5, rel=0.2 if shape == "lemniscate" else 0.01)
    if shape == "circle":
        assert x**2 + y**2 == pytest.approx(0.25) and not z.any()
    if shape == "lemniscate":  # of Gerono: x^4 = a^2 (x^2 - y^2), turned by a quarter here
        assert x**4 == pytest.approx(0.25 * (x**2 - (y) ** 2), abs=1e-12) and not z.any()
    if shape == "smooth":
        assert np.abs(z).max() > 0.01


def test_a_target_starts_from_rest_and_comes_to_an_even_speed():
    time, circle = np.linspace(0.0, 20.0, 20001), np.zeros((20001, 3, 3))
    circle[:, 0, 1] = circle[:, 1, 2] = 1.0
    x, y, _ = Track().goal({"path": circle, "postures": circle, "period": np.full(20001, 4.0)}, time, None).target.T
    phase = np.unwrap(np.arctan2(y, x))
    rate = np.gradient(phase, time)
    assert phase[0] == 0.0 and abs(rate[0]) < 1e-4
    assert (np.diff(rate) > -1e-9).all() and rate[-1] == pytest.approx(np.pi / 2.0, rel=1e-6)
    assert rate[time > 2.0 * RAMP_FRACTION * 4.0].min() > 0.9 * np.pi / 2.0


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("path", PATH_SHAPES)
def test_the_posture_of_a_moment_holds_the_tip_on_the_path(name, path):
    """At rest: to a ten-thousandth of the reach, with weight to a thousandth; the series of the motors is cut off."""
    env = FlexManEnv(name=name, task=Track(path=path))
    view, task = env.episodes.view, env.task
    for seed in range(5):
        env.reset(seed=seed)
        plan = {key: np.repeat(values, 40, axis=0) for key, values in view.episode_parameters.items()}
        goal = task.goal(plan, np.linspace(0.0, 3.0 * plan["period"][0], 40), view)
        far = np.linalg.norm(view.rest_tips(goal.angles) - goal.target, axis=1).max()
        assert far < (1e-3 if view.has_gravity else 1e-4) * view.reach
        first = env.episodes.view.episode_parameters["start"][0]
        assert first == pytest.approx(goal.angles[0], abs=1e-12)
        spread = np.ptp(goal.target, axis=0).max()
        assert 0.05 * view.reach < spread <= 2.5 * task.size * view.reach
    assert env.episodes.view.episode_parameters["period"][0] * view.first_frequency == pytest.approx(3.75, abs=1.25)


def test_a_path_of_a_plane_arm_stays_in_its_plane():
    env = FlexManEnv(name="FlexPlanar-Track-v0", task=Track(path="smooth"))
    for seed in range(5):
        env.reset(seed=seed)
        plan = env.episodes.view.episode_parameters
        assert np.abs(plan["path"][0, 1]).max() < 1e-9, "x and z only"


def test_the_preview_is_where_the_target_will_be():
    times = (0.1, 0.4)
    env = FlexManEnv(name="FlexRRR-Track-v0", task=Track(preview=times))
    observation, info = env.reset(seed=1)
    targets, seen = [info["target"]], [observation]
    for _ in range(60):
        observation, _, _, _, info = env.step(np.zeros(3))
        targets.append(info["target"])
        seen.append(observation)
    place = env.sensors.slices["preview"]
    for step in range(0, 40, 7):
        ahead = np.concatenate([targets[step + round(time / 0.02)] for time in times])
        assert seen[step][place] == pytest.approx(ahead, abs=1e-5)
    rates = (np.array(targets[1:]) - np.array(targets[:-1])) / 0.02
    assert info["target_velocity"] == pytest.approx(rates[-1], abs=1e-9) and np.abs(rates).max() > 0.01


def test_the_reward_is_one_where_the_tip_goes_with_the_target():
    """On a view whose tip is on the target and as fast; and less than zero beyond 5 m of 8.5."""
    env = FlexManEnv(name="FlexRRR-Track-v0")
    env.reset(seed=0)
    for _ in range(50):
        env.step(np.zeros(3))
    view = env.episodes.view
    view.tip_velocity[:], view.tip_error = view.target_velocity, np.zeros(1)
    assert env.task.reward_terms(view)["distance"] == pytest.approx(1.0)
    view.tip_velocity[0, 0] += 1.0
    assert env.task.reward_terms(view)["distance"][0] < 0.8
    view.tip_error = np.full(1, 5.5)
    assert env.task.reward_terms(view)["distance"][0] < 0.0


@pytest.mark.feature
def test_a_plan_that_follows_a_path_keeps_the_tip_of_the_bent_arm_on_it():
    """The planned states, with links bent by their inertia, have their tips where the arm would rest."""
    from flexman_gym.toolbox.controllers.references.trajectories import plan_path

    env = FlexManEnv(name="FlexRRR-Track-v0", task=Track(path="circle"), horizon=8.0)
    env.reset(seed=3)
    view, model = env.episodes.view, env.simulator.model
    times = 0.02 * np.arange(401.0)
    goal = env.task.goal(
        {key: np.repeat(values, 401, axis=0) for key, values in view.episode_parameters.items()}, times, view
    )
    slew = plan_path(model, goal.angles, 0.02)
    d = model.n_dof
    simulator = fm.Simulator(model, control_period=0.02)
    off, bent = [], []
    for state, target in zip(slew.states[20:-20], goal.target[20:-20], strict=True):
        simulator.reset(state=state)
        off.append(np.linalg.norm(simulator.tip - target))
        bent.append(np.linalg.norm(simulator.deflection))
    assert max(off) < 0.01 * max(bent) and max(bent) > 0.01
    rates = (slew.states[2:, :d] - slew.states[:-2, :d]) / 0.04
    assert slew.states[21:-21, d:] == pytest.approx(rates[20:-20], abs=2e-3), "but for the ends"


@pytest.mark.feature
@pytest.mark.slow
@pytest.mark.parametrize("name", ["FlexRRR-Track-v0", "FlexPlanar-Track-v0", "FlexRRR-Hold-v0", "FlexPlanar-Hold-v0"])
def test_nothing_a_pd_and_an_lqr_are_apart(name):
    """RMS tip error over eight episodes: the LQR has at most half of the PD's, the PD half of what nothing has."""
    result = []
    for base in (None, "pd", "lqr-tracking"):
        env = gym.make_vec(name, 8, "vector_entry_point", base=base, autoreset_mode="Disabled").unwrapped
        _, infos = env.reset(seed=9000)
        errors, over = [infos["tip_error"]], np.zeros(8, dtype=bool)
        still = np.zeros(env.action_space.shape, dtype=np.float32)
        for _ in range(env.max_episode_steps):
            _, _, failed, truncated, infos = env.step(still)
            over |= failed
            errors.append(np.where(over, np.nan, infos["tip_error"]))
            if failed.any() and not truncated.all():
                env.reset(options={"reset_mask": failed})
        assert base is None or not over.any()
        values = np.array(errors)
        result.append(rms(values[np.isfinite(values)]))
    assert result[2] <= result[1] / 2.0 and result[1] <= result[0] / 2.0, result


def test_a_path_that_an_arm_cannot_follow_is_refused_in_one_line():
    for settings_ in ({"name": "FlexOne-v0", "task": Track()}, {"name": "FlexPlanar-v0", "task": Track(size=2.0)}):
        line = refusal(lambda settings_=settings_: FlexManEnv(**settings_).reset(seed=0))
        assert line.startswith("Track.size: ") and "m, a path that the tip of this arm can follow" in line
