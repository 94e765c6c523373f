"""Command lines of pages and of helps, with less work than they name."""

import importlib

LESS = {"--steps": "512", "--episodes": "2", "--eval-every": "256", "--seeds": "2"}  # in place of what a line names
LESS_EPISODES = (("flexman_agents.callbacks", "SELECTION_SEEDS", range(5000, 5002)),
                 ("flexman_agents.guard", "SELECTION_SEEDS", range(5000, 5002)),
                 ("flexman_gym.toolbox.league.arm_trial", "EPISODES", 2),
                 ("flexman_gym.commands.demo", "TEST_SEEDS", range(9000, 9002)),
                 ("flexman_gym.toolbox.interchange.policy_export", "TEST_SEEDS", range(9000, 9002)),
                 ("flexman_gym.evaluation.rollouts", "TEST_SEEDS", range(9000, 9002)))  # fmt: skip
# Modules with a name of their own for the seeds, which would keep the fewer ones if they were imported with these.
COPIES = ("league.certificate", "deployment.c_code", "deployment.machine.drive", "view.live_session",
          "sensitivity.episode_sensitivities")  # fmt: skip


def with_less_work(words):
    """Return the words of a command after `flexman` with fewer steps, episodes and arms."""
    words = [*words]
    for option in LESS.keys() & {*words}:
        words[words.index(option) + 1] = LESS[option]
    if words[0] == "train":
        words += ["--quiet", *([] if "--resume" in words else ["--envs", "2"])]
        words += [] if {"--steps", "--resume"} & {*words} else ["--steps", LESS["--steps"]]
        words += ["--keep-worse"] if "--arm" in words else []  # after few steps the base is better
    return words


def use_less_episodes(monkeypatch):
    """Let trainings and evaluations run few episodes, and imitations few updates."""
    for module in COPIES:
        importlib.import_module(f"flexman_gym.toolbox.{module}")
    for module, name, seeds in LESS_EPISODES:
        monkeypatch.setattr(importlib.import_module(module), name, seeds)
    defaults = importlib.import_module("flexman_agents.settings").DEFAULT_HYPERPARAMETERS
    monkeypatch.setitem(defaults["dagger"], "updates", 5)
