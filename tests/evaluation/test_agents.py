"""Entrants: who acts, on the environment that a policy was trained on, with the gains that it learned on."""

import gymnasium as gym
import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.agent.action_modes import TorqueMode
from flexman_gym.agent.agent import Agent
from flexman_gym.agent.network import Network
from flexman_gym.agent.pd import PD
from flexman_gym.envs.config.base_and_mode import make_base_and_mode
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.envs.vector_env import FlexManVectorEnv
from flexman_gym.evaluation.agent_spec import BASELINES, AgentSpec, split_interface
from flexman_gym.evaluation.agents import common_environment, find_agent
from flexman_gym.evaluation.metrics import evaluate
from flexman_gym.evaluation.policy_files import read_policy, write_policy
from flexman_gym.evaluation.rollouts import rollout

from oracles.assertions import refusal
from oracles.shipped import made_up

ARM = {"catalog": "vertical_2r", "payload": {"mass": 0.3}}
TRAINED = {
    "id": "FlexPlanar-v0",
    "arm": ARM,
    "horizon": 1.5,
    "base": "pd",
    "action_repeat": 5,
    "sensors": ["full", "fine"],
}
ONE = Configuration("FlexOne-v0", {"horizon": 1.5})
SEEDS = range(9000, 9003)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run on a planar arm that carries three times as much as the named one."""
    pytest.importorskip("stable_baselines3")
    from flexman_agents.settings import Settings
    from flexman_agents.training import train

    folder = tmp_path_factory.mktemp("runs") / "planar"
    settings = Settings(environment=TRAINED, steps=256, envs=2, hyperparameters={"net_arch": [8]})
    train(settings, folder, progress=False)
    return folder


@pytest.mark.feature
@pytest.mark.slow
def test_a_policy_is_evaluated_on_the_environment_that_it_was_trained_on(run):
    policy = find_agent(str(run))
    environment = common_environment([policy, find_agent("pd")], None)
    setup = environment
    assert (environment.id, setup.arm.payload.mass, setup.horizon) == ("FlexPlanar-v0", 0.3, 1.5)
    interface = policy.interface
    assert isinstance(policy.law, Network) and isinstance(interface["actions"], TorqueMode)
    assert (interface["sensors"], interface["action_repeat"]) == (["full", "fine"], 5), "which go with the policy"
    gains = {name: getattr(interface["base"], name).tolist() for name in ("stiffness", "damping")}
    assert gains == {name: list(each) for name, each in NAMED_ENVIRONMENTS["FlexPlanar-v0"].pd.items()}
    assert setup.base is None and setup.action_repeat == 1
    result = rollout(policy, environment, SEEDS)
    assert result.period == 0.01 and result.lengths.tolist() == [150] * 3
    for record, held in zip(result.records, rollout("pd", environment, SEEDS).records, strict=True):
        assert np.array_equal(record.tips[0], held.tips[0]), "the same episodes for both"
        assert (record.actions[1:] != held.actions[1:]).any(), "the agent does something beside its base"


@pytest.mark.feature
def test_a_policy_acts_as_in_an_environment_with_its_own_hold_and_base(run):
    """What is recorded period by period is what happens in the environment of the training."""
    policy = find_agent(str(run))
    (record,) = rollout(policy, common_environment([policy], None), [9001]).records
    described = Configuration.from_plain(TRAINED)
    env = gym.make(described.id, **described.keywords())
    seen, info = env.reset(seed=9001)
    errors, rewards = [info["tip_error"]], []
    for _ in range(30):
        seen, reward, _, ended, info = env.step(policy.law(seen[None])[0].astype(np.float32))
        errors.append(info["tip_error"])
        rewards.append(reward)
    assert ended and np.array_equal(record.errors[::5], errors)
    assert record.rewards.reshape(-1, 5).mean(axis=1) == pytest.approx(rewards, rel=1e-12)


@pytest.mark.feature
@pytest.mark.slow
def test_a_policy_keeps_the_gains_that_it_learned_on(run):
    """Under a condition with another PD, which is the baseline beside it."""
    learned = NAMED_ENVIRONMENTS["FlexPlanar-v0"].pd
    delayed = Configuration.find("FlexPlanar-v0/delay")
    assert delayed.gains != learned
    environments = delayed, Configuration("FlexPlanar-v0", {**delayed.given, "gains": learned})
    for name in (str(run), "pd"):
        policy = find_agent(name)
        both = [rollout(policy, common_environment([policy], each), [9001]) for each in environments]
        assert np.array_equal(both[0].actions, both[1].actions) == (name != "pd"), "the baseline has the condition's"


@pytest.mark.feature
@pytest.mark.slow
def test_baselines_run_on_the_environment_that_is_named():
    described = Configuration(
        "FlexPlanar-v0", {"arm": ARM, "horizon": 1.5, "base": "lqr", "action_repeat": 3, "sensors": "fine"}
    )
    environment = common_environment([find_agent("pd"), find_agent("zero")], described)
    assert environment.given == {"arm": ARM, "horizon": 1.5}, "base, hold and sensors belong to what acts"
    elsewhere = {"optimised", "mpc", "hinf"}  # the first has a table of one arm, the others need packages
    anywhere = [name for name in BASELINES if name not in elsewhere]
    results = {name: evaluate(name, environment, SEEDS) for name in anywhere}
    rewards = {name: result["reward"] for name, result in results.items()}
    assert rewards["lqr-tracking"] > rewards["pd"] > max(rewards["zero"], rewards["random"])
    assert evaluate("zero", environment, SEEDS) == results["zero"]
    assert common_environment([find_agent("pd")], None) == Configuration()


@pytest.mark.feature
def test_rows_on_different_environments_are_refused_and_a_named_one_settles_it(run):
    one = find_agent(str(run))
    other = AgentSpec("other", one.law, one.interface, Configuration("FlexPlanar-v0"))
    line = refusal(common_environment, [one, find_agent("pd"), other], None)
    assert line.startswith("agent: 'other' is not allowed; give policies of one environment")
    assert line.endswith("or name one with --env: planar was trained in another environment")
    assert common_environment([one, other], ONE) == ONE
    same = AgentSpec("same", one.law, {"action_repeat": 1}, one.environment)
    assert common_environment([one, same], None) == one.environment, "another hold is not another environment"


def test_the_pd_beside_policies_has_the_gains_of_the_first_that_learned_on_one():
    """Gains belong to a policy: other ones make no other environment."""

    def learned(name, damping):
        gains = {"stiffness": [2.0], "damping": [damping]}
        environment, interface = split_interface(Configuration(ONE.id, {**ONE.given, "base": "pd", "gains": gains}))
        return AgentSpec(name, find_agent("zero").law, interface, environment)

    alone = AgentSpec("alone", find_agent("zero").law, {}, ONE)
    result = common_environment([alone, learned("soft", 0.1), learned("hard", 0.2), find_agent("pd")], None)
    assert result.pd_gains == {"stiffness": (2.0,), "damping": (0.1,)}
    assert result.horizon == 1.5


def test_gains_of_a_training_belong_to_the_policy_and_to_the_environment():
    gains = {"stiffness": [2.0], "damping": [0.1]}
    environment, interface = split_interface(Configuration(ONE.id, {**ONE.given, "base": "pd", "gains": gains}))
    assert interface["gains"] == environment.to_plain()["gains"] == gains


def test_what_a_policy_was_trained_with_is_not_changed_in_part_either():
    assert common_environment([], ONE, ["arm.payload.mass=0.1"]).arm.payload.mass == 0.1
    for change in ("sensors.kind=fine", "action_repeat=2", "base=pd"):
        line = refusal(common_environment, [], ONE, [change])
        assert line.startswith(f"--set: '{change}' is not allowed; give a setting of the environment: base, action_rep")


def test_random_torques_go_both_ways():
    result = rollout("random", Configuration("FlexPlanar-v0", {"horizon": 1.0}), [0, 1]).actions.reshape(-1, 2)
    assert result.shape == (200, 2) and -1.0 <= result.min() < -0.9 and 0.9 < result.max() <= 1.0
    assert np.abs(result.mean(axis=0)).max() < 0.2, "five deviations of the mean of so many"


def test_a_controller_of_ones_own_is_an_agent_like_any_other():
    setup = ONE
    own = PD(**NAMED_ENVIRONMENTS[ONE.id].pd, torque_limit=setup.torque_limit)
    assert fm.evaluate(own, ONE, SEEDS) == fm.evaluate("pd", ONE, SEEDS)
    assert find_agent(own).name == "PD" and find_agent(own).environment is None


@pytest.mark.feature
def test_who_acts_brings_everything_that_it_wants_of_an_environment(run):
    """Neither base nor hold, sensors or history of a description reach an agent that has none."""
    own = {"base": "pd", "action_repeat": 3, "history": 2, "sensors": "lab"}
    for name in ("zero", "pd", str(run)):
        expected = evaluate(name, Configuration("FlexPlanar-v0", {"horizon": 1.5}), SEEDS)
        assert evaluate(name, Configuration("FlexPlanar-v0", {"horizon": 1.5, **own}), SEEDS) == expected
    environment, interface = split_interface(Configuration("FlexPlanar-v0", {"condition": "unknown-lab"}))
    assert interface == {"sensors": "lab"} and environment.randomisation is not None
    bare = (
        common_environment([], ONE),
        common_environment([], Configuration("FlexPlanar-v0"), ["condition=unknown-lab"]),
    )
    assert bare[0] == ONE and "sensors" not in bare[1].given and bare[1].disturbances.delay == (1, 1)


def test_runs_of_one_name_on_different_environments_are_refused():
    both = [AgentSpec("seed-0", None, {}, Configuration(name)) for name in ("FlexOne-v0", "FlexRRR-v0")]
    assert refusal(common_environment, both, None).startswith("agent: 'seed-0' is not allowed")


@pytest.mark.feature
def test_a_controller_may_act_on_fewer_arms_afterwards():
    from flexman_gym.toolbox.controllers.lqr import LQR, TrackingLQR

    model = gym.make(ONE.id).unwrapped.simulator.model
    for own in (LQR(model, 0.5, 0.02), TrackingLQR(model, 0.5, 0.02)):
        many = rollout(own, ONE, range(3))
        assert np.array_equal(rollout(own, ONE, range(2)).tips, many.tips[:2])


@pytest.mark.feature
def test_a_policy_may_act_on_fewer_arms_afterwards(run):
    policy = find_agent(str(run))
    environment = common_environment([policy], None)
    many = rollout(policy, environment, range(3))
    assert np.array_equal(rollout(policy, environment, range(2)).actions, many.actions[:2])


@pytest.mark.feature
def test_a_policy_refuses_what_it_was_not_trained_for(run):
    policy = find_agent(str(run))
    allowed = "a policy for FlexOne-v0, of 1 joints: it is one for FlexPlanar-v0, of 2"
    assert refusal(rollout, policy, ONE, [0]) == f"agent: {policy.name!r} is not allowed; give {allowed}"
    path = Configuration("FlexPlanar-Track-v0")
    assert rollout(policy, path, [0]).lengths.tolist() == [1000], "a task that it did not learn, seen as its own"
    other = AgentSpec("other", policy.law, {"sensors": "servo"})
    line = refusal(rollout, other, Configuration("FlexPlanar-v0"), [0])
    assert (
        line
        == "base: 'a policy with 49 inputs' is not allowed; give one with 6, the number of values of its sensors here"
    )


def test_what_acts_nowhere_is_refused_in_one_line(tmp_path):
    for nobody, kind in (("nobody", ValueError), (PD, FileNotFoundError), ("runs/nobody", FileNotFoundError)):
        with pytest.raises(kind, match=r"^agent: .* does not exist; give the folder of a training"):
            find_agent(nobody)
    with pytest.raises(FileNotFoundError, match="no such file"):
        find_agent(str(tmp_path))


@pytest.mark.feature
@pytest.mark.slow
def test_a_policy_is_used_with_the_base_that_its_run_says(tmp_path):
    """On the estimates of an observer that is made for the environment in which it plays, with a delay there."""
    pytest.importorskip("stable_baselines3")
    from flexman_agents.settings import Settings
    from flexman_agents.training import train

    heavy = {"payload_mass": [0.0, 0.05]}
    shaped = {
        "id": "FlexOne-v0",
        "horizon": 0.5,
        "action_repeat": 5,
        "sensors": [],
        "actions": "shaping",
        "randomisation": heavy,
    }
    shaped["base"] = {"kind": "privileged-lqr", "doubt": True}
    settings = Settings(
        environment=shaped, steps=64, envs=2, hyperparameters={"net_arch": [8], "n_steps": 16}, value_warmup=32,
        base_in_use="adaptive-lqr",
    )  # fmt: skip
    train(settings, tmp_path / "run", progress=False)
    late = Configuration("FlexOne-v0", {"horizon": 0.5, "randomisation": {**heavy, "delay": [1, 1]}})
    player = find_agent(str(tmp_path / "run"))
    result, controller = (rollout(each, late, SEEDS) for each in (player, "adaptive-lqr"))
    assert result.failures == ("",) * 3
    assert 0.0 < np.abs(result.actions - controller.actions).max() < 0.5, "it does a little beside it"
    path = tmp_path / "run" / "settings.json"
    path.write_text(path.read_text().replace('"adaptive-lqr"', '"lqg"'))
    assert refusal(find_agent, str(tmp_path / "run")).endswith("different now are base_in_use")


AGENT = {"base": "pd", "action_repeat": 3, "history": 2, "sensors": ["full", "fine"]}
BARE = Configuration("FlexOne-v0", {"horizon": 0.6})
WHOLE = Configuration("FlexOne-v0", {"horizon": 0.6, **AGENT})


class Own:
    """Gives the same action whatever it sees, and remembers the sizes of that."""

    def __init__(self, action):
        self.action, self.sizes = action, set()

    def predict(self, observations):
        self.sizes.add(observations.shape[1:])
        return np.full((len(observations), 1), self.action)


def test_it_adds_to_the_base_and_holds_as_the_environment_says():
    still, pushing = Own(0.0), Own(0.2)
    assert np.array_equal(rollout(still, WHOLE, [0, 1]).actions, rollout("pd", BARE, [0, 1]).actions)
    more = rollout(pushing, WHOLE, [0, 1]).actions
    assert not np.array_equal(more, rollout("pd", BARE, [0, 1]).actions)
    assert np.allclose(rollout(pushing, BARE, [0]).actions, 0.2), "nothing acts beside it where nothing is named"
    assert still.sizes == {(2 * 32,)} and pushing.sizes == {(2 * 32,), (18,)}


def test_its_actions_may_come_first_of_a_pair_and_end_at_one():
    class Pair(Own):
        def predict(self, observations, deterministic=False):
            assert deterministic
            return super().predict(observations), None

    assert np.array_equal(rollout(Pair(7.0), BARE, [0]).actions, np.ones((1, 30, 1)))
    assert find_agent(Pair(0.0)).name == "Pair"


def test_it_is_evaluated_in_one_line():
    assert fm.evaluate(Own(0.0), WHOLE, [0, 1]) == fm.evaluate("pd", BARE, [0, 1])


FLAWED = {"kind": "lab", "noise": 0.01, "bias": 0.01, "dropped": 0.2}


def asked(env, act, steps):
    """Torques (b, T, n) of the control periods of so many steps, parts of the limits."""
    rows, seen = [], env.reset(seed=[0, 1])[0]
    env.episodes.callback = lambda: rows.append(env.episodes.view.action.copy())
    for _ in range(steps):
        seen = env.step(act(seen).astype(np.float32))[0]
    return np.array(rows).swapaxes(0, 1)


@pytest.mark.parametrize(
    ("condition", "sensors"), [("nominal", "lab"), ("unknown-lab", "lab"), ("unknown-lab", FLAWED)]
)
def test_an_agent_acts_alike_in_training_live_loaded_and_under_another_agent(condition, sensors, tmp_path):
    """The same weights, seeds and sensors: the same noise, bias and lost samples, hence the same actions.

    Flaws of the instruments of a base are its own.
    """
    moved = Configuration.find(f"FlexPlanar-v0/{condition}").given | {"horizon": 0.4}
    agent = {"base": "pd", "action_repeat": 2, "history": 3, "sensors": sensors}
    described = Configuration.from_plain({"id": "FlexPlanar-v0", **moved, **agent})
    write_policy(tmp_path, *made_up(described))
    network = read_policy(tmp_path)[1]

    class Live:
        def predict(self, observations):
            return network(observations)

    agents = find_agent(tmp_path), AgentSpec.from_predictor(Live(), described)
    loaded, live = (rollout(each, described, [0, 1]) for each in agents)
    assert np.array_equal(loaded.actions, live.actions) and np.array_equal(loaded.readings, live.readings)
    trained = FlexManVectorEnv(2, name="FlexPlanar-v0", **described.keywords())
    assert np.array_equal(asked(trained, network, 20), loaded.actions) and np.ptp(loaded.actions) > 0.1
    if sensors == "lab":
        base, mode = make_base_and_mode(trained.configuration, trained.batch.model)
        inner = Agent(trained.configuration.sensors, len(trained.sensors.bound), mode, base, 3, 2, network)
        keywords = Configuration.from_plain({"id": "FlexPlanar-v0", **moved, "sensors": []}).keywords()
        outer = FlexManVectorEnv(2, name="FlexPlanar-v0", **keywords, base=inner)
        assert np.array_equal(asked(outer, lambda seen: np.zeros((2, 2)), 40), loaded.actions)
