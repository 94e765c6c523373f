"""Rollout: the same episodes for all, recorded in every control period, to the end of each."""

import warnings

import gymnasium as gym
import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.agent.pd import PD
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.agent_spec import AgentSpec
from flexman_gym.evaluation.agents import common_environment, find_agent
from flexman_gym.evaluation.metrics import METRICS
from flexman_gym.evaluation.rollouts import TEST_SEEDS, rollout
from flexman_gym.metrics import BAND

from oracles.assertions import refusal

SHORT = Configuration("FlexOne-v0", {"horizon": 0.2})


def test_a_number_of_episodes_is_that_of_the_first_test_seeds():
    """Those of `flexman evaluate --episodes`."""
    assert fm.rollout("pd", SHORT, 3).metadata["seeds"] == list(TEST_SEEDS[:3])
    assert (
        fm.evaluate("pd", SHORT, 3) == fm.evaluate("pd", SHORT, TEST_SEEDS[:3]) == fm.evaluate("pd", SHORT, np.int64(3))
    )
    assert fm.rollout("pd", SHORT, np.arange(2)).metadata["seeds"] == [0, 1]


@pytest.mark.parametrize("wrong", [0, -1, True, 2.0, None, "10", []])
def test_other_numbers_are_refused(wrong):
    line = refusal(fm.evaluate, "pd", SHORT, wrong)
    assert line.startswith("seeds: ") and "\n" not in line


@pytest.mark.feature
@pytest.mark.parametrize("name", ["ppo-flexplanar", "shaping-flexrrr", "lab-flexrrr"])
def test_a_policy_of_another_arm_is_refused_by_its_name(name):
    own, other = ("FlexPlanar-v0", "FlexRRR-v0") if "planar" in name else ("FlexRRR-v0", "FlexOne-v0")
    line = refusal(fm.evaluate, name, other, 1)
    assert line.startswith(f"agent: '{name}' is not allowed; give ") and own in line and other in line


ONE = Configuration("FlexOne-v0", {"horizon": 1.5})
SEEDS = range(9000, 9003)


def test_a_policy_with_a_history_sees_what_it_saw_in_training():
    """Readings an action repeat apart, also for episodes side by side."""
    interface = {"base": "pd", "action_repeat": 3, "history": 4, "sensors": ["full"]}
    observed, seen = [], []

    def act(observations):
        observed.append(observations.copy())
        return np.tanh(observations[:, -1:])

    rollout(AgentSpec("watching", act, interface), ONE, [9001, 9002])
    env = gym.make(ONE.id, **ONE.keywords(), **interface)
    observation, ended = env.reset(seed=9001)[0], False
    while not ended:
        seen.append(observation)
        action = np.tanh(observation[-1:])
        observation, _, _, ended, _ = env.step(action)
    assert np.array_equal(np.array(observed)[:, 0], seen) and np.ptp(seen, axis=0).max() > 0.1


def test_an_episode_that_fails_ends_there_and_the_arms_beside_it_go_on():
    """One arm gets full torque, the others none."""

    def act(observations):
        return np.array([[1.0]] + [[0.0]] * (len(observations) - 1))

    environment = Configuration("FlexOne-v0", {"horizon": 1.5, "limits": {"rate": 3.0, "angle": 4.0}})
    together = rollout(AgentSpec("push", act), environment, SEEDS)
    failed, *others = together.records
    assert "rate" in failed.failure and len(failed.actions) < 75
    assert len(failed.tips) == len(failed.errors) == len(failed.actions) + 1 == len(failed.rewards) + 1
    (alone,) = rollout(AgentSpec("push", act), environment, [9000]).records
    assert np.array_equal(alone.tips, failed.tips) and alone.failure == failed.failure
    for record in others:
        assert record.failure == "" and len(record.actions) == 75 and not record.actions.any()
    assert METRICS["settling_time"].function(failed) == METRICS["vibration"].function(failed) == np.inf
    assert np.isnan(together.tips[0, together.lengths[0] + 1 :]).all() and together.tips.shape == (3, 76, 3)
    assert together.actions.shape == (3, 75, 1) and np.isnan(together.rewards[0, together.lengths[0] :]).all()


def test_nothing_begins_anew_where_an_episode_has_ended():
    """The base controller is reset for the episodes of the seeds only."""
    begun = []

    class RecordedPD(PD):
        def reset(self, arms, episode, count):
            begun.extend(arms.tolist())

        def act(self, readings, applied=None, playing=None):
            return np.array([[1.0], [0.0], [0.0]])

    environment = Configuration("FlexOne-v0", {"horizon": 1.5, "limits": {"rate": 3.0, "angle": 4.0}})
    lengths = rollout(RecordedPD([1.0], [0.1], 1.0), environment, SEEDS).lengths
    assert lengths[0] < 70 and lengths[1:].tolist() == [75, 75] and begun == [0, 1, 2]


def test_a_failed_episode_is_counted_to_its_last_period():
    """As a user counts it who steps the environment by hand: with the reward of the failure, which is not the least."""

    def act(observations):
        return np.ones((len(observations), 1))

    environment = Configuration("FlexOne-v0", {"horizon": 1.5, "limits": {"rate": 3.0, "angle": 4.0}})
    (record,) = rollout(AgentSpec("push", act), environment, [9000]).records
    env, rewards, failed = gym.make(environment.id, **environment.keywords()), [], False
    errors = [env.reset(seed=9000)[1]["tip_error"]]
    while not failed:
        _, reward, failed, _, info = env.step(np.ones(1, dtype=np.float32))
        rewards.append(reward)
        errors.append(info["tip_error"])
    result = {name: metric.function(record) for name, metric in METRICS.items()}
    assert record.failure == info["failure"] and len(record.rewards) == len(rewards)
    assert result["reward"] == pytest.approx(sum(rewards), rel=1e-9) and abs(rewards[-1]) > 1e-3 * abs(result["reward"])
    assert result["rms_error"] == pytest.approx(np.sqrt(np.mean(np.square(errors))), rel=1e-9)
    assert (result["effort"], result["roughness"]) == (1.0, 0.0), "full torque in all of them"


def test_a_controller_reads_with_the_errors_of_the_instruments_of_an_environment():
    """As in an environment with this base; instruments without errors change nothing, to the bit."""
    settings = {"horizon": 0.4, "elements": 1, "modes": 1}
    made = {name: Configuration("FlexPlanar-v0", {**settings, "sensors": sensors}) for name, sensors in {
        "full": "full", "lab": "lab", "coarse": [{"kind": "motor_encoders", "quantisation": "200 counts"}],
    }.items()}  # fmt: skip
    errors = {name: rollout("pd", each, [3]).records[0].errors for name, each in made.items()}
    assert np.array_equal(errors["full"], errors["lab"]) and not np.array_equal(errors["full"], errors["coarse"])
    env = gym.make("FlexPlanar-v0", base="pd", **made["coarse"].keywords())
    info = env.reset(seed=3)[1]
    own = [info["tip_error"]]
    while len(own) < len(errors["coarse"]):
        own.append(env.step(np.zeros(2))[-1]["tip_error"])
    assert own == errors["coarse"].tolist()
    named = common_environment([find_agent("pd")], made["coarse"])
    assert np.array_equal(rollout("pd", named, [3]).records[0].errors, errors["coarse"])


@pytest.mark.feature
def test_the_band_is_a_part_of_the_reach():
    """Of two links of half a metre: an episode settles in the band that the head of the table names, in mm."""
    environment = Configuration("FlexPlanar-v0", {"horizon": 3.0})
    result = rollout("lqr-tracking", environment, SEEDS)
    assert result.band == pytest.approx(BAND * 1.0) == pytest.approx(0.02 / 8.5), "20 mm where the reach is 8.5 m"
    for record in result.records:
        after = round(METRICS["settling_time"].function(record) / record.period)
        assert (record.errors[after:] <= record.band).all() and record.errors[after - 1] > record.band


@pytest.mark.slow
def test_an_environment_has_an_id_a_condition_or_a_file(tmp_path):
    (tmp_path / "one.yaml").write_text("id: FlexOne-v0\nhorizon: 0.5\n")
    assert fm.rollout("zero", str(tmp_path / "one.yaml"), [1]).lengths.tolist() == [25]
    late, now = (fm.rollout("pd", f"FlexPlanar-v0/{condition}", [1]) for condition in ("delay", "nominal"))
    assert (late.actions != now.actions).any() and np.array_equal(late.tips[:, 0], now.tips[:, 0])


def test_who_watches_sees_the_reset_and_every_period():
    seen = []
    result = rollout("pd", ONE, SEEDS, lambda episodes: seen.append(episodes.view.tip.copy()))
    assert np.array_equal(np.array(seen).swapaxes(0, 1), result.tips)


def test_episodes_are_kept_with_all_that_was_recorded(tmp_path):
    environment = Configuration("FlexOne-v0", {"horizon": 0.2, "randomisation": {"delay": [1, 1]}})
    result = rollout("pd", environment, [9001, 9002])
    first, second = map(fm.Episode.load, result.save(tmp_path))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["pd-9001.npz", "pd-9002.npz"]
    assert first.about["seed"] == 9001 and first.about["environment"] == "FlexOne-v0" and first.name == "pd"
    assert first.about["settings"]["interface"] == {"base": "pd"} and not np.array_equal(first.tips, second.tips)
    assert np.array_equal(second.tips, result.tips[1]) and len(second.actions) == 10
    ends = fm.curves(second.model, second.states, 2).positions[:, -1, -1]
    assert np.allclose(ends, second.tips, rtol=0.0, atol=1e-12)
    assert second.errors == pytest.approx(np.linalg.norm(second.tips - second.targets, axis=1))
    limit = np.array(second.about["torque_limits"])
    assert np.array_equal(second.torques[1:], second.actions[:-1] * limit) and not second.torques[0].any(), "a delay"
    angles = second.states[:, second.model.motor_columns]
    assert second.readings["motor_angles"] == pytest.approx(angles, abs=1e-6)


def test_an_episode_that_failed_is_kept_to_its_end():
    environment = Configuration("FlexOne-v0", {"horizon": 1.5, "limits": {"rate": 3.0, "angle": 4.0}})
    result = rollout(AgentSpec("push", lambda seen: np.ones((len(seen), 1))), environment, [9000])
    episode = result.episode(0)
    assert len(episode.time) == result.lengths[0] + 1 < 76 and "rate" in episode.about["failure"]
    assert np.isfinite(episode.states).all() and len(episode.actions) == result.lengths[0]


def test_a_base_of_the_environment_is_left_out_for_the_agent_without_torque_with_a_warning():
    based = Configuration("FlexOne-v0", {"base": "pd"})
    with pytest.warns(UserWarning, match='base: left out for the agent "zero"'):
        result = fm.rollout("zero", based, range(1))
    assert not result.torques[np.isfinite(result.torques)].any()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        alone, asked = (fm.rollout("pd", each, range(1)).tips for each in (based, Configuration("FlexOne-v0")))
    assert np.array_equal(alone, asked)
