"""Export a policy as data or ONNX, an arm for MuJoCo."""

import argparse
import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from flexman_gym.commands import CommandLine


class _Target(NamedTuple):
    """Export target: its help text, a function that adds its arguments, and one that exports and returns a message."""

    words: str
    arguments: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace], str]


def _arguments(result: argparse.ArgumentParser) -> None:
    """Add the arguments of each target."""
    chosen = result.add_subparsers(dest="target", required=True, metavar="target")
    for name, target in TARGETS.items():
        target.arguments(chosen.add_parser(name, help=target.words, description=target.words))


def _run(options: argparse.Namespace) -> int:
    """Export the target and print the message; return 0."""
    print(TARGETS[options.target].run(options))
    return 0


def _policy_arguments(result: argparse.ArgumentParser) -> None:
    result.add_argument("run", type=Path, help="folder of a training run")
    result.add_argument("folder", type=Path, help="a new one, or a name: the policy is then one of the package")
    result.add_argument("--words", required=True, help="one sentence that says what it is")
    result.add_argument("--recipe", default="", help="name of the recipe")
    result.add_argument("--env", default="", help="for which it is, where that is not the one of the training")
    result.add_argument("--licence", default="MIT")


def _policy(options: argparse.Namespace) -> str:
    from flexman_gym.common.checks import value_error
    from flexman_gym.evaluation.export import export_policy
    from flexman_gym.evaluation.policy_files import FOLDER

    folder = options.folder
    if len(folder.parts) <= 1:
        if not re.fullmatch(r"[A-Za-z0-9-]{0,59}[A-Za-z0-9]", str(folder)):
            allowed = "1 to 60 letters a to z, digits and hyphens, with no hyphen at the end"
            raise value_error("name", str(folder), allowed)
        folder = FOLDER / folder
    figures = export_policy(options.run, folder, options.words, options.recipe, options.env, options.licence)
    reached = ", ".join(f"{name} {figures[name]:.3g}" for name in ("settled", "settling_time", "vibration"))
    return f"{folder} holds the policy: {reached}"


def _onnx_arguments(result: argparse.ArgumentParser) -> None:
    result.add_argument("entrant", help="name of a policy, or folder of a policy or a run")
    result.add_argument("path", type=Path, help="of the file")


def _onnx(options: argparse.Namespace) -> str:
    from flexman_gym.evaluation.export import write_onnx

    apart = write_onnx(options.entrant, options.path)
    return f"{options.path}: actions within {apart:.1g} of those of {options.entrant}"


def _mujoco_arguments(result: argparse.ArgumentParser) -> None:
    from flexman_gym.envs.config.named_environments import DEFAULT_ID
    from flexman_gym.model.mjcf import PIECES

    result.add_argument("arm", nargs="?", default=DEFAULT_ID, help="an id, an id and a condition, a name in the "
                        "catalog, or a file of an environment, an arm or a scene")  # fmt: skip
    result.add_argument("--pieces", type=int, default=PIECES, help="of each section of a link")
    result.add_argument("--out", type=Path, default=Path("arm.xml"))


def _mujoco(options: argparse.Namespace) -> str:
    from flexman_gym.common import files
    from flexman_gym.envs.config.configuration import Configuration
    from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
    from flexman_gym.model.mjcf import mjcf
    from flexman_gym.scene.serialization import ARMS, SUFFIXES, find_arm

    name = options.arm
    alone = name in ARMS or (name.endswith(SUFFIXES) and "id" not in files.read_data(Path(name)))
    arm = find_arm(name) if alone else Configuration.find(name).arm
    options.out.write_text(mjcf(arm, options.pieces), encoding="utf-8")
    known = f" of {name}" if name.partition("/")[0] in NAMED_ENVIRONMENTS else ""
    return f"{options.out} has the arm{known}: {arm.n_joints} links of {options.pieces} pieces a section."


TARGETS = {
    "policy": _Target("a policy as arrays and JSON, which NumPy alone runs", _policy_arguments, _policy),
    "mujoco": _Target("an arm as MJCF, every link rigid pieces between springs", _mujoco_arguments, _mujoco),
    "onnx": _Target("a policy as ONNX, with its normalisation inside", _onnx_arguments, _onnx),
}


COMMAND = CommandLine(_arguments, _run)
