"""Completion of command lines in a shell: commands, options, and names of agents, environments, recipes and methods."""

import argparse
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from flexman_gym.commands import SCENES, output_file, output_folder
from flexman_gym.common.computer import optional_module


def completion_script(parser: argparse.ArgumentParser, shell: str) -> str:
    """Return the script by which a shell completes the arguments of a parser.

    Args:
        parser: parser of the program, with the arguments of all commands.
        shell: "bash", "zsh" or "fish".

    Raises:
        ImportError: without the package shtab.
    """
    shtab = optional_module("shtab", "completion", "train")
    names, files = _names(), {Path: shtab.FILE, output_file: shtab.FILE, output_folder: shtab.DIRECTORY}
    for action in _actions(parser):
        if action.dest in names and action.nargs != 0:
            setattr(action, "complete", _names_or_files(action.dest, names[action.dest]))  # noqa: B010
        elif action.type in files:
            setattr(action, "complete", files[action.type])  # noqa: B010
    return str(shtab.complete(parser, shell))


def _actions(parser: argparse.ArgumentParser) -> Iterable[argparse.Action]:
    """Yield the arguments of a parser, of its commands, and of their kinds."""
    for action in parser._actions:
        yield action
        if isinstance(action, argparse._SubParsersAction):
            for each in action.choices.values():
                yield from _actions(each)


def _names() -> Mapping[str, Iterable[str]]:
    """Return argument -> names that it may have."""
    from flexman_agents.settings import RECIPES
    from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
    from flexman_gym.evaluation.trained_agents import AGENTS
    from flexman_gym.scene.serialization import ARMS
    from flexman_gym.simulation.methods import METHODS

    return {
        "agent": AGENTS, "agents": AGENTS, "arm": ARMS, "env": NAMED_ENVIRONMENTS, "environment": NAMED_ENVIRONMENTS,
        "method": METHODS, "recipe": RECIPES, "scene": SCENES,
    }  # fmt: skip


def _names_or_files(argument: str, names: Iterable[str]) -> dict[str, Any]:
    """Return the completion of an argument that is one of some names or a file, by shell."""
    words, function = " ".join(names), f"_flexman_{argument}"
    return {
        "bash": function,
        "zsh": f"{{compadd {words}; _files}}",
        "fish": f"{words} (__fish_complete_path (commandline -ct))",
        "preamble": {"bash": f'{function}() {{ compgen -W "{words}" -- "$1"; compgen -f -- "$1"; }}'},
    }
