"""Drive a machine, or a simulated one, by an agent in real time.

The arm is brought to rest at the end, at Ctrl+C and SIGTERM, and at each fault, such as readings that are missing,
late or impossible, or contradict the commands. The exit status is 1 after a fault. For deadlines that are kept on a
busy computer: chrt -f 50 flexman drive ...
"""

import argparse
import math
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flexman_gym.commands import CommandLine, add_options, load_agent, numbers, output_file
from flexman_gym.common.files import check_output

if TYPE_CHECKING:
    from flexman_gym.simulation.episode import Episode

DEFAULT_LOG = "drive"  # name of a log without --out
MAX_LOGS = 10_000  # logs of this name in a folder


def _arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    seed = {"help": "seed of the goal, for a simulated machine also of start and randomisation (default: %(default)s)"}
    env = {"help": "environment for which the agent is designed (default: that of sim:, or of the agent)"}
    add_options(parser, "agent", "--env", "--seed", "--trust", seed=seed, env=env)
    parser.add_argument(
        "--machine", required=True, metavar="NAME",
        help="sim:ENVIRONMENT for a simulated machine, udp:HOST:PORT, or udp:PORT on this computer",
    )  # fmt: skip
    parser.add_argument("--seconds", type=float, metavar="T", help="duration, s (default: horizon of the environment)")
    parser.add_argument("--goal", type=numbers, metavar="A,B", help="motor angles of the goal, rad: --goal=0.1,-0.2")
    parser.add_argument(
        "--silence", type=int, default=5, metavar="N",
        help="control periods without readings or commands after which the arm is stopped (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument(
        "--out", type=output_file, metavar="FILE",
        help="log (default: drive.npz, or drive-2.npz and so on: an earlier log is kept)",
    )  # fmt: skip
    parser.add_argument(
        "--jitter", type=float, default=0.0, metavar="T", help="mean random delay of the readings of sim:, s"
    )
    parser.add_argument("--loss", type=float, default=0.0, metavar="P", help="probability that sim: loses a packet")
    parser.add_argument(
        "--asynchronous", action="store_true", help="torques of sim: act from their arrival, not in whole periods"
    )


def _run(options: argparse.Namespace) -> int:
    """Drive the machine, write the log and print a summary; return 0, or 1 after a fault."""
    from flexman_gym.common.errors import value_error
    from flexman_gym.envs.config.configuration import Configuration
    from flexman_gym.toolbox.deployment.machine.drive import drive
    from flexman_gym.toolbox.deployment.machine.server import Disturbances
    from flexman_gym.toolbox.deployment.machine.simulated import SimulatedMachine

    out = options.out or _free_log()
    agent, kind = load_agent(options.agent, options.trust), options.machine.partition(":")[0]
    move = {"goal_angles": options.goal} if options.goal else {}
    given = options.seed, options.seconds, move, options.silence
    if kind == "sim":
        plant = Configuration.find(options.machine.removeprefix("sim:"))
        disturbances = Disturbances(options.jitter, options.loss, options.asynchronous)
        with SimulatedMachine(plant, options.seed, disturbances, move, options.silence) as machine:
            log = drive(agent, machine.address, options.env or plant, *given)
    elif kind != "udp":
        raise value_error("machine", options.machine, "sim:ENVIRONMENT, udp:HOST:PORT, or udp:PORT on this computer")
    else:
        log = drive(agent, options.machine, options.env, *given)
    out = _save(log, out)
    loop = log.about["machine"]
    median, longest = (1e3 * each for each in loop["lateness"])
    print(f"{log.name}: {log.about['failure'] or 'completed'} after {log.time[-1]:.2f} s")
    print(_outcome(log))
    print(f"  {loop['periods']} periods of {1e3 * log.period:g} ms, late by {median:.3f} ms (at most {longest:.3g} ms)")
    print(f"  {loop['missed']:.2%} of the torques missed, {loop['silent']} periods without new readings")
    print(f"  {rest_text(loop)}")
    print(f"{out}: to go on: flexman replay {out}, flexman why {out}, or fm.fit")
    return 1 if log.about["failure"] else 0


def _free_log() -> Path:
    """Return the path of a log in this folder that does not exist, after checking that it can be written."""
    names = [f"{DEFAULT_LOG}.npz", *(f"{DEFAULT_LOG}-{number}.npz" for number in range(2, MAX_LOGS))]
    return check_output(next(path for path in map(Path, names) if not path.exists()))


def _save(log: "Episode", path: Path) -> Path:
    """Write the log and return its path: another one in the temporary folder if the disk became full meanwhile."""
    try:
        return log.save(path)
    except OSError as error:
        other = log.save(Path(tempfile.mkdtemp(prefix="flexman-")) / path.name)
        print(f"{path}: {error.strerror}; the log is in {other}")
        return other


def rest_text(loop: dict[str, Any]) -> str:
    """Return a text with the times at which motors and tip came to rest after the stop, or with their last speeds."""
    if loop["motor_rate"] is None:
        return "rest after the stop is not known: the machine sends no readings of the rates that can be trusted"
    motors, tip, speed = loop["rest_seconds"], loop["tip_rest_seconds"], loop["tip_speed"]
    first = f"motors still at {loop['motor_rate']:.2g} rad/s" if motors is None else f"motors at rest {motors:.2f} s"
    if speed is None:
        return f"{first} after the stop; the speed of the tip is not measured"
    return f"{first} and tip {f'still at {speed:.2g} m/s' if tip is None else f'at rest {tip:.2f} s'} after the stop"


def _outcome(log: "Episode") -> str:
    """Return a line with the settling time, the final error and the vibration of the tip as its readings show them."""
    from flexman_gym.metrics import SETTLING_WINDOW, final_error, peak_to_peak, settling_time

    settled = settling_time(log.errors, log.about["band"], log.period)
    settling = f"tip settles in {settled:.2f} s" if math.isfinite(settled) else "tip does not settle"
    error, vibration = final_error(log.errors, log.period), peak_to_peak(log.tips, log.period, SETTLING_WINDOW)
    return f"  {settling}, error {1e3 * error:.2g} mm and vibration {1e3 * vibration:.2g} mm (p-p) in the last second"


EXAMPLES = (
    "flexman drive pd --machine sim:FlexOne-v0 --seconds 2",
    "flexman why drive.npz  # a cause of the error in the log",
)
COMMAND = CommandLine(_arguments, _run, EXAMPLES)
