"""Random streams: effects, arms and episodes draw for themselves, over the whole of their ranges."""

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.envs.vector_env import FlexManVectorEnv

STILL = {"start": [0.3, 0.4, -0.5], "goal_angles": [0.3, 0.4, -0.5]}
FACTORS = {"joint_stiffness_factor": (0.5, 1.5), "rotor_inertia_factor": (0.5, 1.5), "torque_limit_factor": (0.5, 1.5)}


def forces(gap, period=0.02, steps=300, arms=50):
    """Impulses (steps, arms, 3) in N s that the tips were given, of 1 N s each: forces times the control period."""
    env = FlexManVectorEnv(
        arms, modes=1, control_period=period, horizon=100.0, limits=fm.Limits(1e3, 1e3, 1e3, 1e3, 1e5, 1e5),
        randomisation={"tip_impulse": (1.0, 1.0), "impulse_gap": gap},
    )  # fmt: skip
    env.reset(seed=0)
    result, step = [], env.batch.step
    env.batch.step = lambda drive, playing: result.append(drive[:, 3:6].copy()) or step(drive, playing)
    for _ in range(steps):
        env.step(np.zeros((arms, 3)))
    return np.array(result) * period


@pytest.mark.slow
def test_effects_draw_independently_of_each_other():
    """The correlation of two independent draws of 1000 arms is normal with a deviation of 1 / sqrt(1000)."""
    env = FlexManVectorEnv(1000, modes=1, randomisation=FACTORS | {"payload_mass": (0.0, 1.0), "delay": (0, 9)})
    drawn = env.reset(seed=0)[1]["drawn"]
    names = [name for name in drawn if not name.startswith("_")]  # beside them stand Gymnasium's masks
    columns = np.column_stack([drawn[name].reshape(1000, -1) for name in names])
    assert columns.shape[1] == 11
    assert np.abs(np.corrcoef(columns.T) - np.eye(11)).max() < 5 / np.sqrt(1000)


def test_arms_and_episodes_have_noise_of_their_own():
    env = FlexManVectorEnv(40, modes=1, randomisation={"sensor_noise": (0.01, 0.01)})
    plain = FlexManVectorEnv(40, modes=1)
    noise = []
    for seed in (0, 1000):
        seen = [each.reset(seed=seed, options=STILL)[0] for each in (env, plain)]
        noise.append(((seen[0] - seen[1]) / env.observation_space.high)[:, np.r_[:24, 33:36]])  # what is measured
    rows = np.concatenate(noise)
    assert len(np.unique(rows[:, 0])) == len(rows), "no two arms, and no two seeds, see the same noise"
    assert np.abs(np.corrcoef(rows.T) - np.eye(rows.shape[1])).max() < 6 / np.sqrt(len(rows))


def test_the_initial_vibration_takes_every_direction_across_the_link():
    """The mean of n unit vectors of random direction in a plane is normal, with a deviation of 1 / sqrt(2 n)."""
    arm = fm.catalog.one_link(rotor_inertia=1.0)
    link = arm.links[0]
    round_link = fm.Link(
        link.length, link.area, *2 * [link.area**2 / (4 * np.pi)], link.area**2 / (2 * np.pi), 7e10, 2.6e10, 2700.0
    )
    env = FlexManVectorEnv(
        1000, arm=fm.Arm([round_link], arm.joints), modes=None, torque_limit=1.0,
        randomisation={"initial_vibration": (1e-3, 1e-3)},
    )  # fmt: skip
    tips = env.reset(seed=0)[1]["drawn"]["initial_vibration"][:, 0]
    np.testing.assert_allclose(np.linalg.norm(tips, axis=1), 1e-3, rtol=1e-9)
    angles = np.arctan2(tips[:, 1], tips[:, 0])
    for turns in (1, 2):  # directions, and lines without direction
        assert abs(np.exp(1j * turns * angles).mean()) < 5 / np.sqrt(2 * 1000)


def test_gaps_between_impulses_are_geometric():
    """A process without memory: whether a period has an impulse tells nothing of the next one."""
    chance = 0.2
    hit = (np.abs(forces(gap=0.02 / chance)) > 0.0).any(axis=2)
    count = hit.size
    assert hit.mean() == pytest.approx(chance, abs=5 * np.sqrt(chance * (1 - chance) / count))
    for later in (1, 2, 5):
        both = (hit[:-later] & hit[later:]).mean()
        assert both == pytest.approx(chance**2, abs=5 * np.sqrt(chance**2 / count))
    assert 0.0 < hit[0].mean() < 1.0, "arms are not hit together"


@pytest.mark.parametrize("period", [0.005, 0.02, 0.04])
def test_an_impulse_is_its_force_times_the_control_period(period):
    sizes = np.linalg.norm(forces(10 * period, period, steps=40, arms=20), axis=2)
    np.testing.assert_allclose(sizes[sizes > 0.0], 1.0, rtol=1e-12)
    assert (sizes > 0.0).any()
