"""Export policies (ONNX), controllers (C), models (MATLAB) and arms."""

import argparse
import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from flexman_gym.commands import CommandLine, add_options, numbers, output_file, output_folder

if TYPE_CHECKING:
    from flexman_gym.scene.arm import Arm


class _Target(NamedTuple):
    """Export target: description, function that adds its arguments, function that exports and returns a message."""

    description: str
    arguments: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace], str]


def _arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of each target."""
    chosen = parser.add_subparsers(dest="target", required=True, metavar="target")
    for name, target in TARGETS.items():
        target.arguments(chosen.add_parser(name, help=target.description.rstrip("."), description=target.description))


def _run(options: argparse.Namespace) -> int:
    """Export the target and print the message; return 0."""
    print(TARGETS[options.target].run(options))
    return 0


def _policy_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run", type=Path, help="folder of a training run")
    parser.add_argument("folder", type=Path, help="new folder, or a name, for a policy of the package")
    parser.add_argument("--description", required=True, metavar="TEXT", help="description of the policy, one sentence")
    parser.add_argument("--recipe", default="", help="name of the recipe of the run")
    parser.add_argument("--env", default="", help="environment of the policy (default: that of the training)")
    parser.add_argument("--licence", default="MIT", help="licence of the policy (default: %(default)s)")


def _policy(options: argparse.Namespace) -> str:
    from flexman_gym.common.errors import value_error
    from flexman_gym.evaluation.policy_files import FOLDER
    from flexman_gym.toolbox.interchange.policy_export import export_policy

    folder = options.folder
    if len(folder.parts) <= 1:
        if not re.fullmatch(r"[A-Za-z0-9-]{0,59}[A-Za-z0-9]", str(folder)):
            allowed = "1 to 60 letters a to z, digits and hyphens, with no hyphen at the end"
            raise value_error("name", str(folder), allowed)
        folder = FOLDER / folder
    metrics = export_policy(options.run, folder, options.description, options.recipe, options.env, options.licence)
    text = ", ".join(f"{name} {metrics[name]:.3g}" for name in ("settled", "settling_time", "vibration"))
    return f"{folder} holds the policy: {text}"


def _onnx_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("agent", help="name of a policy, or folder of a policy or a run")
    parser.add_argument("path", type=output_file, help="file to write")


def _onnx(options: argparse.Namespace) -> str:
    from flexman_gym.toolbox.interchange.policy_export import write_onnx

    difference = write_onnx(options.agent, options.path)
    return f"{options.path}: actions within {difference:.1g} of those of {options.agent}"


def _mujoco_arguments(parser: argparse.ArgumentParser) -> None:
    from flexman_gym.envs.config.named_environments import DEFAULT_ID
    from flexman_gym.toolbox.interchange.mjcf import PIECES

    parser.add_argument("arm", nargs="?", default=DEFAULT_ID, help="environment, named arm, or file of an "
                        "environment, an arm or a scene (default: %(default)s)")  # fmt: skip
    parser.add_argument(
        "--pieces",
        type=int,
        metavar="N",
        default=PIECES,
        help="rigid bodies per section of a link (default: %(default)s)",
    )
    parser.add_argument(
        "--out", type=output_file, metavar="FILE", default="arm.xml", help="file to write (default: %(default)s)"
    )


def _mujoco(options: argparse.Namespace) -> str:
    from flexman_gym.common import files
    from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
    from flexman_gym.toolbox.interchange.mjcf import to_mjcf

    name = options.arm
    arm = _find_arm(name)
    files.write_file(options.out, to_mjcf(arm, options.pieces))
    known = f" of {name}" if name.partition("/")[0] in NAMED_ENVIRONMENTS else ""
    return f"{options.out} has the arm{known}: {arm.n_joints} links of {options.pieces} pieces a section."


def _c_arguments(parser: argparse.ArgumentParser) -> None:
    agent = {"help": "name or folder of an agent, such as pd, lqr, lqg or ppo-flexrrr"}
    add_options(parser, "agent", "--env", "--seed", agent=agent, seed={"help": "seed of start and goal"})
    parser.add_argument("--start", type=numbers, metavar="A,B", help="joint angles at the start, rad: --start=0.1,-0.2")
    parser.add_argument("--goal", type=numbers, metavar="A,B", help="motor angles of the goal, rad")
    parser.add_argument(
        "--out", type=output_folder, metavar="FOLDER", default="controller", help="(default: %(default)s)"
    )


def _c(options: argparse.Namespace) -> str:
    from flexman_gym.toolbox.deployment.c_code import begin_agent, write_c

    given = {"start": options.start, "goal_angles": options.goal}
    move = {name: angles for name, angles in given.items() if angles is not None}
    files = write_c(begin_agent(options.agent, options.env or "", options.seed, **move), options.out)
    return f"{options.out}: {', '.join(file.name for file in files)}"


def _matlab_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("name", help="environment, or name or folder of an agent")
    parser.add_argument("--env", default="", help="environment of the agent")
    parser.add_argument("--goal", type=numbers, metavar="A,B", help="motor angles of the linear model, rad")
    parser.add_argument(
        "--out", type=output_file, metavar="FILE", default="arm.mat", help="file to write (default: %(default)s)"
    )


def _matlab(options: argparse.Namespace) -> str:
    from flexman_gym.toolbox.deployment.matlab import write_matlab

    return f"{options.out}: {', '.join(write_matlab(options.name, options.out, options.env, options.goal))}"


def _urdf_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("arm", help="environment, named arm, or file of an environment, an arm or a scene")
    about = "file to write; the sidecar is FILE with suffix .yaml"
    parser.add_argument("path", type=output_file, metavar="FILE", help=about)


def _urdf(options: argparse.Namespace) -> str:
    from flexman_gym.common import files
    from flexman_gym.common.checks import one_of
    from flexman_gym.toolbox.interchange.urdf_export import to_urdf

    one_of("the suffix of FILE", options.path.suffix, (".urdf",))
    text, sidecar = to_urdf(_find_arm(options.arm))
    files.write_file(options.path, text)
    files.write_data(options.path.with_suffix(".yaml"), sidecar)
    return f"{options.path} has the rigid arm, {options.path.with_suffix('.yaml')} its sections, springs and motors."


def _find_arm(name: str) -> "Arm":
    """Return the arm of an environment, by the name of an arm, or from a file of an environment, an arm or a scene."""
    from flexman_gym.common import files
    from flexman_gym.envs.config.configuration import Configuration
    from flexman_gym.scene.serialization import ARMS, SUFFIXES, find_arm

    alone = name in ARMS or (name.endswith(SUFFIXES) and "id" not in files.read_data(Path(name)))
    return find_arm(name) if alone else Configuration.find(name).arm


TARGETS = {
    "policy": _Target("Export a policy as arrays and JSON, to be run with NumPy only.", _policy_arguments, _policy),
    "c": _Target("Export a controller as C99, without allocation and with a test program.", _c_arguments, _c),
    "matlab": _Target("Export a linear model, and the gains of an agent, as .mat.", _matlab_arguments, _matlab),
    "mujoco": _Target("Export an arm as MJCF, each link as rigid bodies with springs.", _mujoco_arguments, _mujoco),
    "urdf": _Target("Export an arm as URDF, with a sidecar for sections and motors.", _urdf_arguments, _urdf),
    "onnx": _Target("Export a policy as ONNX, including its normalisation.", _onnx_arguments, _onnx),
}


EXAMPLES = (
    "flexman export mujoco FlexRRR-v0 --out arm.xml",
    "flexman export urdf planar_2r arm.urdf",
    "flexman export c pd --env FlexOne-v0 --out pd  # cd pd; make test",
    "flexman export matlab FlexOne-v0 --out arm.mat",
    "flexman export onnx ppo-flexrrr policy.onnx",
    "flexman train ppo_on_pd_minute --folder runs/first",
    "flexman export policy runs/first my/first --description 'PPO on PD.'",
)
COMMAND = CommandLine(_arguments, _run, EXAMPLES)
