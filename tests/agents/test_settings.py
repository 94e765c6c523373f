"""Settings: from mappings, files and the record of a run; what is wrong is named in one line."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flexman_agents.settings import (
    DEFAULT_ENVS,
    MAX_ENVS,
    MAX_SEED,
    RECIPE_FOLDER,
    RECIPES,
    Schedule,
    Settings,
    find_recipe,
)
from flexman_gym.common import files
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.evaluation.rollouts import SELECTION_SEEDS, TEST_SEEDS, TRAINING_SEEDS_STRIDE, training_seed

from oracles.assertions import refusal

ENVIRONMENT = {"id": "FlexPlanar-v0", "base": "pd", "action_repeat": 5, "sensors": ["full", "fine"], "horizon": 1.0}
RECIPE = {
    "algo": "sac", "environment": ENVIRONMENT, "steps": 64, "seed": 7, "envs": 2,
    "hyperparameters": {"gamma": 0.98}, "schedules": {"learning_rate": {"start": 1e-3, "end": 0.0}},
    "normalise_reward": False,
}  # fmt: skip


@pytest.mark.parametrize("suffix", [".yaml", ".yml", ".json"])
def test_settings_come_from_a_file_and_back_from_the_record_of_a_run(tmp_path, suffix):
    path = tmp_path / f"recipe{suffix}"
    files.write_data(path, RECIPE)
    settings = find_recipe(str(path))
    assert settings == Settings(**RECIPE) == Settings.recipe(path)
    (tmp_path / "settings.json").write_text(json.dumps(settings.plain() | {"versions": {}}))
    assert Settings.load(tmp_path) == settings
    assert settings.plain()["environment"]["arm"]["payload"]["mass"] == 0.1, "the whole arm is kept"
    setup = settings.environment
    assert (setup.action_repeat, setup.base, len(setup.sensors), setup.horizon) == (5, "pd", 2, 1.0)


def test_an_arm_in_a_file_is_found_beside_the_recipe_and_kept_without_it(tmp_path):
    files.write_data(
        tmp_path / "arm.yaml", Settings(**RECIPE).plain()["environment"]["arm"] | {"payload": {"mass": 0.25}}
    )
    files.write_data(tmp_path / "recipe.yaml", RECIPE | {"environment": {"id": "FlexPlanar-v0", "arm": "arm.yaml"}})
    settings = Settings.recipe(tmp_path / "recipe.yaml")
    (tmp_path / "arm.yaml").unlink()
    assert settings.environment.arm.payload.mass == 0.25


def test_what_is_left_out_is_the_default():
    settings = Settings()
    assert (settings.algo, settings.steps, settings.seed, settings.normalise_reward) == ("ppo", 1_000_000, 0, True)
    assert settings.envs == DEFAULT_ENVS["ppo"] and Settings(algo="sac").envs == DEFAULT_ENVS["sac"]
    assert settings.environment.id == "FlexRRR-v0" and settings.environment.arm == NAMED_ENVIRONMENTS["FlexRRR-v0"].arm


def test_another_seed_changes_nothing_else():
    settings = Settings(**RECIPE)
    other = settings.with_seed(8)
    assert other.seed == 8 and other.with_seed(7) == settings != other


def test_sac_may_learn_from_its_first_step():
    assert Settings("sac", hyperparameters={"learning_starts": 0}).hyperparameters == {"learning_starts": 0}


def test_tqc_may_keep_all_its_quantiles():
    values = {"top_quantiles_to_drop_per_net": 0, "n_quantiles": 1}
    assert Settings("tqc", hyperparameters=values).hyperparameters == values


@pytest.mark.parametrize(("algo", "recorded"), [("sac", False), ("tqc", True), ("crossq", True)])
def test_the_version_of_sb3_contrib_is_recorded_for_its_algorithms(algo, recorded, tmp_path):
    Settings(algo).write(tmp_path, 0)
    assert ("sb3-contrib" in json.loads((tmp_path / "settings.json").read_text())["versions"]) == recorded


@pytest.mark.parametrize("name", RECIPES)
def test_every_recipe_can_be_read_and_trained(name):
    settings = find_recipe(name)
    assert settings == Settings.recipe(RECIPE_FOLDER / f"{name}.yaml")
    assert settings.steps > 0 and settings.environment


# What is wrong


@pytest.mark.parametrize(
    ("keywords", "line"),
    [
        ({"algo": "dqn"}, "algo: 'dqn' is not allowed; give one of ppo, sac"),
        ({"environment": {"id": "CartPole-v1"}}, "id: 'CartPole-v1' is not allowed; give one of FlexRRR-v0, Flex"),
        ({"environment": "FlexRRR-v0"}, "environment: 'FlexRRR-v0' is not allowed; give a mapping"),
        (
            {"environment": {"action_repeats": 5}},
            "action_repeats: 5 is not allowed; give a setting: the nearest is act",
        ),
        ({"environment": {"action_repeat": 0}}, "action_repeat: 0 is not allowed; give a whole number from 1 to 1000"),
        ({"steps": 0}, "steps: 0 is not allowed; give a whole number from 1"),
        ({"seed": -1}, "seed: -1 is not allowed; give a whole number from 0"),
        ({"envs": 2.5}, "envs: 2.5 is not allowed; give a whole number from 1"),
        ({"normalise_reward": 1}, "normalise_reward: 1 is not allowed; give true or false"),
        ({"hyperparameters": [1]}, "hyperparameters: [1] is not allowed; give a mapping"),
        ({"hyperparameters": {"learning_rate": 0}}, "hyperparameters.learning_rate: 0 is not allowed; give a finite"),
        ({"hyperparameters": {"gamma": "x"}}, "hyperparameters.gamma: 'x' is not allowed; give a finite number > 0"),
        ({"hyperparameters": {"tau": 1.5}}, "hyperparameters.tau: 1.5 is not allowed; give a number > 0, at most 1"),
        ({"hyperparameters": {"n_steps": 2.5}}, "hyperparameters.n_steps: 2.5 is not allowed; give a whole number fr"),
        ({"hyperparameters": {"activation": "sin"}}, "hyperparameters.activation: 'sin' is not allowed; give one of"),
        ({"schedules": {"gamma": {}}}, "schedules: 'gamma' is not allowed; give one of learning_rate, log_std"),
        ({"schedules": {"log_std": 3}}, "schedules.log_std: 3 is not allowed; give a mapping with start, end and"),
        ({"schedules": {"log_std": {"start": 1}}}, "schedules.log_std: {'start': 1} is not allowed; give a mapping"),
        ({"algo": "sac", "schedules": {"log_std": {"start": -1, "end": -4}}}, "schedules.log_std: 'sac' is not all"),
        (
            {"schedules": {"target_entropy": {"start": -1, "end": -4}}},
            "schedules.target_entropy: 'ppo' is not allowed; give it with sac, tqc, crossq only",
        ),
        (
            {"algo": "tqc", "hyperparameters": {"top_quantiles_to_drop_per_net": 25}},
            "hyperparameters.top_quantiles_to_drop_per_net: 25 is not allowed; give a whole number below n_quant",
        ),
        (
            {"algo": "crossq", "hyperparameters": {"policy_delay": 0}},
            "hyperparameters.policy_delay: 0 is not allowed; ",
        ),
        (
            {"algo": "sac", "hyperparameters": {"critic_norm": 1}},
            "hyperparameters.critic_norm: 1 is not allowed; give tr",
        ),
        (
            {"algo": "sac", "hyperparameters": {"net_arch": {"pi": [8], "vf": [8]}}},
            "hyperparameters.net_arch: {'pi': [8], 'vf': [8]} is not allowed; give a list of widths, or a mapping",
        ),
        (
            {"algo": "tqc", "hyperparameters": {"net_arch": {"pi": [8], "qf": [0]}}},
            "hyperparameters.net_arch.qf[0]: 0 is not allowed; give a whole number from 1",
        ),
        (
            {"algo": "dagger", "hyperparameters": {"net_arch": {"pi": [8]}}},
            "hyperparameters.net_arch: {'pi': [8]} is not allowed; give a list of widths",
        ),
    ],
)
def test_bad_settings_are_named_in_one_line(keywords, line):
    assert refusal(lambda: Settings(**keywords)).startswith(line)


def test_a_bad_recipe_names_its_file_and_the_field(tmp_path):
    path = tmp_path / "recipe.yaml"
    for data, line in (
        ({"algo": "ddpg"}, "algo: 'ddpg' is not"),
        ({"step": 3}, "settings: 'step' is not"),
        (3, "this is no mapping"),
    ):
        files.write_data(path, data)
        assert refusal(Settings.recipe, path).startswith(f"{path}: {line}")
    with pytest.raises(ValueError, match=r"^recipe: nothing does not exist; give the path of a file, or one of "):
        find_recipe("nothing")
    with pytest.raises(ValueError, match=r"; the nearest is ppo_on_pd$"):
        find_recipe("ppo_on_p")


@pytest.mark.parametrize("text", ["", "3", "{}", "[1]", '{"algo": "ppo"}', "[" * 10_000])
def test_a_broken_record_names_its_file(tmp_path, text):
    (tmp_path / "settings.json").write_text(text)
    line = refusal(Settings.load, tmp_path)
    assert line.startswith(f"{tmp_path / 'settings.json'}: ") and "settings of a training run" in line


# Schedules


@given(st.floats(-5, 5), st.floats(-5, 5), st.floats(0.01, 1.0), st.floats(0.0, 1.0))
def test_a_schedule_is_linear_and_then_stays(start, end, until, progress):
    schedule = Schedule(start, end, until)
    expected = end if progress >= until else start + (end - start) * progress / until
    assert schedule.at(progress) == pytest.approx(expected, abs=1e-9)
    assert schedule(1.0 - progress) == pytest.approx(expected, abs=1e-6 + 1e-12 * abs(end - start) / until)
    assert (schedule.at(0.0), schedule.at(1.0)) == (start, pytest.approx(end, abs=1e-9))


@pytest.mark.parametrize(
    ("values", "line"),
    [
        (("a", 1.0), "schedule.start: 'a' is not allowed; give a"),
        ((float("nan"), 1.0), "schedule.start: nan is not allowed; give a finite"),
        ((1.0, None), "schedule.end: None is not allowed; give a"),
        ((1.0, 1.0, 0.0), "schedule.until: 0.0 is not allowed; give a fraction of the training, > 0 and at most 1"),
        ((1.0, 1.0, 1.5), "schedule.until: 1.5 is not allowed; give a fraction of the training, > 0 and at most 1"),
    ],
)
def test_bad_schedules_are_named(values, line):
    assert refusal(Schedule, *values).startswith(line)


# Seeds


@given(st.integers(0, MAX_SEED), st.integers(0, MAX_SEED), st.integers(0, MAX_ENVS - 1))
def test_seeds_of_training_selection_and_test_are_disjoint(run, other, arm):
    """Also those of the arms of two runs."""
    first = training_seed(run) + arm
    assert first not in SELECTION_SEEDS and first not in TEST_SEEDS and set(SELECTION_SEEDS).isdisjoint(TEST_SEEDS)
    assert run == other or abs(training_seed(other) - training_seed(run)) >= MAX_ENVS
    assert (
        max(TEST_SEEDS.stop, SELECTION_SEEDS.stop) < TRAINING_SEEDS_STRIDE
        and len(TEST_SEEDS) == len(SELECTION_SEEDS) == 100
    )
