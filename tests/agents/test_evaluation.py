"""Evaluation: the same episodes for all, on the environment that a policy was trained on, in one table."""

import re

import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

import flexman_gym  # noqa: F401  registers the environments
from flexman_agents.evaluation import (
    Episode,
    Record,
    changed_environment,
    common_environment,
    evaluate,
    figures,
    run_episodes,
    summary,
    table,
)  # fmt: skip
from flexman_agents.policies import BASELINES, Policy, find_policy, parted
from flexman_agents.settings import Settings
from flexman_agents.training import train
from flexman_gym.envs import NAMED
from flexman_gym.envs.description import Description
from flexman_gym.metrics import BAND

from oracles.refusals import refusal

ARM = {"catalog": "vertical_2r", "payload": {"mass": 0.3}}
TRAINED = {"id": "FlexPlanar-v0", "arm": ARM, "horizon": 1.5, "base": "pd", "hold": 5, "sensors": ["full", "fine"]}
ONE = Description("FlexOne-v0", {"horizon": 1.5})
SEEDS = range(9000, 9003)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run on a planar arm that carries three times as much as the named one."""
    folder = tmp_path_factory.mktemp("runs") / "planar"
    settings = Settings(environment=TRAINED, steps=256, envs=2, hyperparameters={"net_arch": [8]})
    train(settings, folder, progress=False)
    return folder


def test_a_policy_is_evaluated_on_the_environment_that_it_was_trained_on(run):
    policy = find_policy(str(run))
    environment = common_environment([policy, find_policy("pd")], None)
    setup = environment.setup()
    assert (environment.id, setup.arm.payload.mass, setup.horizon) == ("FlexPlanar-v0", 0.3, 1.5)
    gains = {name: list(each) for name, each in NAMED["FlexPlanar-v0"].pd.items()}
    expected = {"base": "pd", "gains": gains, "hold": 5, "sensors": ["full", "fine"]}
    assert policy.interface == expected, "which go with the policy"
    assert setup.base is None and setup.hold == 1
    records, period = run_episodes(policy, environment, SEEDS)
    assert period == 0.01 and all(len(record.actions) == 150 for record in records)
    for record, held in zip(records, run_episodes(find_policy("pd"), environment, SEEDS)[0], strict=True):
        assert np.array_equal(record.tips[0], held.tips[0]), "the same episodes for both"
        assert (record.actions[1:] != held.actions[1:]).any(), "the agent does something beside its base"


def test_a_policy_acts_as_in_an_environment_with_its_own_hold_and_base(run):
    """What is recorded period by period is what happens in the environment of the training."""
    policy = find_policy(str(run))
    (record,), _ = run_episodes(policy, common_environment([policy], None), [9001])
    described = Description.from_dict(TRAINED)
    env = gym.make(described.id, **described.keywords())
    seen, info = env.reset(seed=9001)
    errors, rewards = [info["tip_error"]], []
    for _ in range(30):
        seen, reward, _, ended, info = env.step(policy.act(seen[None], (1, 2))[0])
        errors.append(info["tip_error"])
        rewards.append(reward)
    assert ended and np.array_equal(record.errors[::5], errors)
    assert record.rewards.reshape(-1, 5).mean(axis=1) == pytest.approx(rewards, rel=1e-12)


def test_a_policy_keeps_the_gains_that_it_learned_on(run):
    """Under a condition with another PD, which is the baseline beside it."""
    learned = NAMED["FlexPlanar-v0"].pd
    delayed = Description.find("FlexPlanar-v0/delay")
    assert delayed.setup().gains != learned
    environments = delayed, Description("FlexPlanar-v0", {**delayed.settings, "gains": learned})
    for name in (str(run), "pd"):
        policy = find_policy(name)
        both = [run_episodes(policy, common_environment([policy], each), [9001])[0][0] for each in environments]
        assert np.array_equal(both[0].actions, both[1].actions) == (name != "pd"), "the baseline has the condition's"


def test_a_policy_with_a_history_sees_what_it_saw_in_training():
    """Readings a hold apart, also where all episodes are judged side by side."""
    interface = {"base": "pd", "hold": 3, "history": 4, "sensors": ["full"]}
    judged, seen = [], []

    def act(observations, shape):
        judged.append(observations.copy())
        return np.tanh(observations[:, -shape[1] :])

    run_episodes(Policy("watching", act, interface), ONE, [9001, 9002])
    env = gym.make(ONE.id, **ONE.keywords(), **interface)
    observation, ended = env.reset(seed=9001)[0], False
    while not ended:
        seen.append(observation)
        action = np.tanh(observation[-1:])
        observation, _, _, ended, _ = env.step(action)
    assert np.array_equal(np.array(judged)[:, 0], seen) and np.ptp(seen, axis=0).max() > 0.1


def test_baselines_run_on_the_environment_that_is_named():
    described = Description("FlexPlanar-v0", {"arm": ARM, "horizon": 1.5, "base": "lqr", "hold": 3, "sensors": "fine"})
    environment = common_environment([find_policy("pd"), find_policy("zero")], described)
    assert environment.settings == {"arm": ARM, "horizon": 1.5}, "base, hold and sensors belong to what acts"
    results = {name: evaluate(find_policy(name), environment, SEEDS) for name in BASELINES}
    rewards = {name: np.mean([episode.reward for episode in episodes]) for name, episodes in results.items()}
    assert rewards["lqr-tracking"] > rewards["pd"] > max(rewards["zero"], rewards["random"])
    assert evaluate(find_policy("zero"), environment, SEEDS) == results["zero"]
    assert common_environment([find_policy("pd")], None) == Description()


def test_rows_on_different_environments_are_refused_and_a_named_one_settles_it(run):
    one = find_policy(str(run))
    other = Policy("other", one.act, one.interface, Description("FlexPlanar-v0"))
    line = refusal(common_environment, [one, find_policy("pd"), other], None)
    assert line == (
        "policy: 'other' is not allowed; give policies of one environment, or name one with --env: planar knows another"
    )
    assert common_environment([one, other], ONE) == ONE
    same = Policy("same", one.act, {"hold": 1}, one.environment)
    assert common_environment([one, same], None) == one.environment, "another hold is not another environment"


def test_the_pd_beside_policies_has_the_gains_of_the_first_that_learned_on_one():
    """Gains belong to a policy: other ones make no other environment."""

    def learned(name, damping):
        gains = {"stiffness": [2.0], "damping": [damping]}
        environment, interface = parted(Description(ONE.id, {**ONE.settings, "base": "pd", "gains": gains}))
        return Policy(name, find_policy("zero").act, interface, environment)

    alone = Policy("alone", find_policy("zero").act, {}, ONE)
    found = common_environment([alone, learned("soft", 0.1), learned("hard", 0.2), find_policy("pd")], None)
    assert found.setup().pd_gains == {"stiffness": (2.0,), "damping": (0.1,)}
    assert found.setup().horizon == 1.5


def test_what_a_policy_was_trained_with_is_not_changed_in_part_either():
    assert changed_environment(ONE, ["arm.payload.mass=0.1"]).setup().arm.payload.mass == 0.1
    for change in ("sensors.kind=fine", "hold=2", "base=pd"):
        line = refusal(changed_environment, ONE, [change])
        assert line.startswith(f"--set: '{change}' is not allowed; give a setting of what is moved: base, hold, ")


def test_random_torques_go_both_ways():
    found = find_policy("random").act(np.zeros((200, 3), dtype=np.float32), (200, 2))
    assert found.shape == (200, 2) and -1.0 <= found.min() < -0.9 and 0.9 < found.max() <= 1.0
    assert np.abs(found.mean(axis=0)).max() < 0.2, "five deviations of the mean of so many"


def test_an_episode_that_fails_ends_there_and_the_arms_beside_it_go_on():
    """One arm gets full torque, the others none."""

    def act(observations, shape):
        return np.array([[1.0]] + [[0.0]] * (shape[0] - 1))

    environment = Description("FlexOne-v0", {"horizon": 1.5, "limits": {"rate": 3.0, "angle": 4.0}})
    (failed, *others), period = run_episodes(Policy("push", act), environment, SEEDS)
    assert "rate" in failed.failure and len(failed.actions) < 75
    assert len(failed.tips) == len(failed.errors) == len(failed.actions) + 1 == len(failed.rewards) + 1
    alone = run_episodes(Policy("push", act), environment, [9000])[0][0]
    assert np.array_equal(alone.tips, failed.tips) and alone.failure == failed.failure
    for record in others:
        assert record.failure == "" and len(record.actions) == 75 and not record.actions.any()
    assert figures(failed, period, 1.0).stabilisation_time == figures(failed, period, 1.0).vibration == np.inf


def test_a_failed_episode_is_counted_to_its_last_period():
    """As a user counts it who steps the environment by hand: with the reward of the failure, which is not the least."""

    def act(observations, shape):
        return np.ones(shape)

    environment = Description("FlexOne-v0", {"horizon": 1.5, "limits": {"rate": 3.0, "angle": 4.0}})
    (record,), period = run_episodes(Policy("push", act), environment, [9000])
    env, rewards, failed = gym.make(environment.id, **environment.keywords()), [], False
    errors = [env.reset(seed=9000)[1]["tip_error"]]
    while not failed:
        _, reward, failed, _, info = env.step(np.ones(1, dtype=np.float32))
        rewards.append(reward)
        errors.append(info["tip_error"])
    found = figures(record, period, 1.0)
    assert found.failure == info["failure"] and len(record.rewards) == len(rewards)
    assert found.reward == pytest.approx(sum(rewards), rel=1e-9) and abs(rewards[-1]) > 1e-3 * abs(found.reward)
    assert found.rms_error == pytest.approx(np.sqrt(np.mean(np.square(errors))), rel=1e-9)
    assert found.effort == 1.0, "full torque in all of them"


def test_the_band_is_a_part_of_the_reach():
    """Of two links of half a metre: an episode settles in the band that the head of the table names, in mm."""
    environment = Description("FlexPlanar-v0", {"horizon": 3.0})
    records, period = run_episodes(find_policy("lqr-tracking"), environment, SEEDS)
    episodes = evaluate(find_policy("lqr-tracking"), environment, SEEDS)
    head = table({"lqr-tracking": episodes}, environment).splitlines()[1]
    band = 1e-3 * float(head.split("in ")[1].split(" mm")[0])
    assert band == pytest.approx(0.02 / 8.5 * 1.0, rel=1e-2), "20 mm where the reach is 8.5 m"
    for record, episode in zip(records, episodes, strict=True):
        after = round(episode.stabilisation_time / period)
        assert (record.errors[after:] <= 1.01 * band).all() and record.errors[after - 1] > 0.99 * band


def test_figures_are_those_of_the_metrics():
    time = 0.02 * np.arange(501)
    tips = np.zeros((501, 3))
    tips[:, 1] = 0.03 * np.cos(2 * np.pi * time)  # whole periods in 3 s
    errors = np.where(time < 3.99, 1.0, 0.01)
    found = figures(Record(tips, errors, np.full((500, 3), 0.5), np.full(500, 0.5), ""), 0.02, 0.02)
    assert (found.reward, found.error, found.effort, found.failure) == (250.0, 0.01, 0.25, "")
    assert found.stabilisation_time == pytest.approx(4.0) and found.vibration == pytest.approx(0.06, rel=1e-9)


def test_the_error_at_the_end_is_the_median_of_its_last_second():
    """Neither the last sample nor what was before."""
    errors = np.concatenate([np.full(450, 1.0), np.full(50, 0.01), [0.5]])
    record = Record(np.zeros((501, 3)), errors, np.zeros((500, 1)), np.zeros(500), "")
    assert figures(record, 0.02, 0.02).error == 0.01


# The table


def rows(names, count=3, settled=True):
    """A table of policies that do the same."""
    episode = Episode(123.4, 2.5 if settled else np.inf, 0.0012, 0.0034, 0.25, "")
    return table({name: [episode] * count for name in names}, ONE).splitlines()


@pytest.mark.parametrize("name", ["pd", "a name of more than twelve letters", "runs/" + 40 * "x", 300 * "long "])
def test_names_of_any_length_do_not_shift_the_table(name):
    title, head, *lines, caption = rows([name, "zero"])
    figured = [line for line in lines if "123.4" in line]
    assert len(figured) == 2 and max(map(len, [title, head, *lines, caption])) <= 160
    for word in ("reward", "stabilised, s", "p-p, mm", "failed"):
        end = head.index(word) + len(word)
        assert all(line[end - 1] != " " and line[end : end + 1] in ("", " ") for line in figured), word
    assert "".join(lines).replace(" ", "").count("x") == name.count("x")


def test_the_head_says_on_which_environment_all_rows_were_run():
    title, head, *_ = rows(["pd"])
    assert title == "3 episodes of FlexOne-v0 (horizon), the same for all"
    assert f"in {1e3 * BAND * 0.8:.3g} mm" in head, "the band is a part of the reach"
    assert "(as it is)" in table({"pd": [Episode(0, 1, 1, 1, 1, "")]}, Description())


def test_what_has_not_settled_is_a_dash_and_shares_are_parts_of_all():
    assert "- (---)" in rows(["pd"], settled=False)[2]
    times = [1.0, np.inf, 3.0, np.inf]
    found = summary([Episode(1.0, time, time, 1.0, 0.5, "" if time < 2 else "rate") for time in times])
    assert (found["settled"], found["failed"], found["reward"], found["effort"]) == (0.5, 0.75, 1.0, 0.5)
    assert found["stabilisation_time"][0] == np.inf and found["error"] == (1.0, 1.0, 1.0)


def test_a_task_that_does_not_settle_is_judged_by_its_rms_error():
    rows = {"pd": [Episode(1.0, np.inf, 0.001, 0.002, 0.1, "", 0.0123)]}
    text = table(rows, Description("FlexRRR-Track-v0"))
    assert "RMS error, mm" in text and "12.3" in text and "stabilised" not in text
    record = Record(np.zeros((3, 3)), np.array([0.3, 0.4, 0.0]), np.zeros((2, 3)), np.zeros(2), "")
    assert figures(record, 0.02, 0.01).rms_error == pytest.approx(np.sqrt(0.25 / 3.0))


def test_reward_and_effort_are_means_as_the_table_says():
    """Of episodes whose medians are others."""
    episodes = [Episode(reward, 1.0, 0.001, 0.001, effort, "") for reward, effort in ((0, 0.1), (1, 0.2), (11, 0.9))]
    found = summary(episodes)
    assert (found["reward"], found["effort"]) == pytest.approx((4.0, 0.4))
    assert "reward and effort are means" in table({"pd": episodes}, ONE).splitlines()[-1]


def test_every_figure_stands_below_its_name():
    """Three episodes, of which one fails: an interval goes from its low to its high end around the median."""
    numbers = (2.5, 0.001, 0.004, ""), (3.5, 0.002, 0.005, ""), (np.inf, 0.003, 0.006, "rate")
    episodes = [Episode(100.0, time, vibration, error, 0.25, failure) for time, vibration, error, failure in numbers]
    head, line = table({"pd": episodes}, ONE).splitlines()[1:3]
    found = dict(zip(re.split(r" {2,}", head), re.split(r" {2,}", line), strict=True))
    assert found == {
        "policy": "pd", "reward": "100.0", f"in {20.0 * 0.8 / 8.5:.3g} mm": "67%", "stabilised, s": "3.5 (2.5--)",
        "p-p, mm": "2 (1-3)", "error, mm": "5 (4-6)", "effort": "0.250", "failed": "33%",
    }  # fmt: skip
