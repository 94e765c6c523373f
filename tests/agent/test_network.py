"""Network: NumPy acts as the algorithm that learned, row by row."""

import numpy as np
import pytest

from flexman_gym.agent.network import Network, policy_parameters

from oracles.assertions import refusal

SEEN = np.random.default_rng(0).normal(scale=2.0, size=(50, 6)).astype(np.float32)


def parameters(algo, random=None):
    """Made-up layers of 6, 5, 4 and 2 numbers."""
    random = random or np.random.default_rng(1)
    first, last = {"ppo": ("mlp_extractor.policy_net.", "action_net"), "sac": ("actor.latent_pi.", "actor.mu")}[algo]
    sizes = {f"{first}0": (5, 6), f"{first}2": (4, 5), last: (2, 4)}
    return {f"{name}.{part}": random.normal(size=shape[: 2 - (part == "bias")])
            for name, shape in sizes.items() for part in ("weight", "bias")}  # fmt: skip


STATISTICS = {"mean": np.linspace(-1.0, 1.0, 6), "var": np.linspace(0.0, 4.0, 6)}


@pytest.mark.parametrize(("algo", "function", "end"), [
    ("ppo", np.tanh, lambda x: np.clip(x, -1.0, 1.0)), ("sac", lambda x: np.maximum(x, 0.0), np.tanh),
])  # fmt: skip
def test_it_is_what_its_definition_says(algo, function, end):
    arrays = parameters(algo)
    result = Network(algo, None, arrays, STATISTICS)
    values = np.clip((SEEN - STATISTICS["mean"]) / np.sqrt(STATISTICS["var"] + 1e-8), -10.0, 10.0)
    names = list(dict.fromkeys(name.rsplit(".", 1)[0] for name in arrays))
    for name in names:
        values = values @ arrays[f"{name}.weight"].T + arrays[f"{name}.bias"]
        values = function(values) if name != names[-1] else end(values)
    assert result(SEEN) == pytest.approx(values, abs=1e-12) and (result.size, result.joints) == (6, 2)
    assert all(np.array_equal(result(SEEN[i : i + 1])[0], result(SEEN)[i]) for i in range(50)), "bits of a row alone"


def test_layers_follow_on_each_other_by_their_numbers():
    """Six of them, the last of which has the number 10: each turns two numbers a little further."""
    turns = [np.array([[np.cos(a), -np.sin(a)], [np.sin(a), a]]) for a in np.linspace(0.1, 1.2, 7)]
    names = [*(f"actor.latent_pi.{2 * i}" for i in range(6)), "actor.mu"]
    arrays = {f"{name}.weight": turn for name, turn in zip(names, turns, strict=True)}
    result = Network("sac", "tanh", arrays | {f"{name}.bias": np.zeros(2) for name in names},
                    {"mean": np.zeros(2), "var": np.ones(2)})  # fmt: skip
    values = SEEN[:, :2].astype(float)
    for turn in turns:
        values = np.tanh(values @ turn.T)
    assert result(SEEN[:, :2]) == pytest.approx(values, abs=1e-7)


def randomise_statistics(policy):
    """Give the batch renormalisations of CrossQ statistics and factors that change what they return."""
    random, state = np.random.default_rng(2), policy.state_dict()
    for name in (each.removesuffix("ra_var") for each in state if each.endswith("ra_var")):
        for part, values in (("ra_var", random.uniform(0.3, 3.0)), ("scale", random.uniform(0.5, 2.0)),
                             ("ra_mean", random.normal()), ("bias", random.normal())):  # fmt: skip
            array = state[name + part]
            array[:] = array.new_tensor(values + np.linspace(0.0, 0.5, len(array)))


@pytest.mark.feature
@pytest.mark.slow
@pytest.mark.parametrize("algo", ["ppo", "sac", "tqc", "crossq"])
@pytest.mark.parametrize("activation", ["tanh", "relu"])
def test_it_acts_as_the_policy_that_was_trained(algo, activation, tmp_path):
    pytest.importorskip("stable_baselines3")
    from flexman_agents.sb3 import make_model
    from flexman_agents.settings import Settings
    from flexman_agents.training import policy_state

    environment = {"id": "FlexOne-v0", "base": "pd"}
    settings = Settings(algo, environment, envs=1, hyperparameters={"net_arch": [7, 5], "activation": activation})
    model = make_model(settings)
    statistics = model.get_vec_normalize_env()
    size = len(statistics.obs_rms.mean)
    statistics.obs_rms.mean, statistics.obs_rms.var = np.linspace(-1, 1, size), np.linspace(0.1, 2, size)
    randomise_statistics(model.policy)
    data = policy_state(model)
    seen = np.random.default_rng(0).normal(size=(20, size)).astype(np.float32)
    result = Network(algo, activation, data["policy"], data["statistics"])
    expected, _ = model.predict(statistics.normalize_obs(seen), deterministic=True)
    assert result(seen) == pytest.approx(expected, abs=2e-6)


@pytest.mark.parametrize(("change", "line"), [
    ({"action_net.bias": np.zeros(3)}, "policy.action_net: 'arrays (2, 4) and (3,)' is not allowed"),
    ({"action_net.weight": np.zeros((2, 7))}, "policy: 'a layer with 7 inputs' is not allowed; give one with 4"),
    ({"mlp_extractor.policy_net.0.weight": np.full((5, 6), np.nan)}, "policy.mlp_extractor.policy_net.0.weight: "),
    ({"action_net.weight": "text"}, "policy.action_net.weight: 'str' is not allowed; give an array of numbers"),
])  # fmt: skip
def test_layers_that_do_not_follow_on_each_other_are_refused(change, line):
    said = refusal(Network, "ppo", None, parameters("ppo") | change, STATISTICS)
    assert said.startswith(line)


@pytest.mark.parametrize("number", ["\N{SUPERSCRIPT TWO}", "9" * 5000, "x"])
def test_what_has_no_number_is_no_layer(number):
    more = {f"mlp_extractor.policy_net.{number}.{part}": np.ones((4, 4)) for part in ("weight", "bias")}
    seen = np.random.default_rng(0).normal(size=(3, len(STATISTICS["mean"])))
    with_it, without = (Network("ppo", None, parameters("ppo") | each, STATISTICS) for each in (more, {}))
    assert np.array_equal(with_it(seen), without(seen)) and policy_parameters("ppo", more) == {}


RENORMED = {  # layers of 6, 4 and 2 numbers, each after a batch renormalisation
    **{f"actor.latent_pi.{number}.{part}": np.full(size, value) for number, size in ((0, 6), (3, 4))
       for part, value in (("ra_mean", 0.5), ("ra_var", 4.0), ("scale", 3.0), ("bias", -1.0))},
    **{f"actor.latent_pi.{number}.steps": np.array(7) for number in (0, 3)},
    "actor.latent_pi.1.weight": np.ones((4, 6)), "actor.latent_pi.1.bias": np.zeros(4),
    "actor.mu.weight": np.eye(2, 4), "actor.mu.bias": np.zeros(2),
}  # fmt: skip


def test_a_batch_renormalisation_is_merged_into_the_next_layer():
    layers = policy_parameters("crossq", RENORMED)
    factor = 3.0 / np.sqrt(4.001)
    assert sorted(layers) == [f"actor.{name}.{part}" for name in ("latent_pi.1", "mu") for part in ("bias", "weight")]
    assert layers["actor.mu.weight"] == pytest.approx(factor * np.eye(2, 4), rel=1e-15)
    assert layers["actor.latent_pi.1.bias"] == pytest.approx(np.full(4, 6.0 * (-1.0 - 0.5 * factor)), rel=1e-15)
    merged, renormed = (Network("crossq", None, each, STATISTICS) for each in (layers, RENORMED))
    assert np.array_equal(merged(SEEN), renormed(SEEN))


@pytest.mark.parametrize(("part", "value", "line"), [
    ("ra_mean", np.zeros(5), "policy.actor.latent_pi.3: "), ("bias", None, "policy.actor.latent_pi.3: "),
    ("ra_var", -np.ones(4), "policy.actor.latent_pi.3.ra_var: 'a number out of range' is not allowed; give finite"),
    ("scale", np.full(4, np.nan), "policy.actor.latent_pi.3.scale: "),
])  # fmt: skip
def test_a_batch_renormalisation_that_does_not_fit_is_refused(part, value, line):
    given = {**RENORMED, f"actor.latent_pi.3.{part}": value}
    given = {name: each for name, each in given.items() if each is not None}
    assert refusal(Network, "crossq", None, given, STATISTICS).startswith(line)


def test_missing_parts_are_refused():
    assert refusal(Network, "sac", None, parameters("ppo"), STATISTICS).startswith("policy.actor.mu: ")
    assert refusal(Network, "ppo", None, parameters("ppo"), {"mean": STATISTICS["mean"]}).startswith("statistics.var")
    assert refusal(Network, "ppo", "sigmoid", parameters("ppo"), STATISTICS).startswith("activation: 'sigmoid'")
