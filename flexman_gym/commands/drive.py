"""Drive a machine, or a simulated one, by an agent in real time.

The arm is brought to rest at the end and at each fault, such as missing or impossible readings. The exit status is 1
after a fault. For deadlines that are kept on a busy computer: chrt -f 50 flexman drive ...
"""

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from flexman_gym.commands import CommandLine, add_options, load_agent, numbers

if TYPE_CHECKING:
    from flexman_gym.simulation.episode import Episode


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
        "--out", type=Path, metavar="FILE", default=Path("drive.npz"), help="log (default: %(default)s)"
    )
    parser.add_argument(
        "--jitter", type=float, default=0.0, metavar="T", help="mean random delay of the readings of sim:, s"
    )
    parser.add_argument("--loss", type=float, default=0.0, metavar="P", help="probability that sim: loses a packet")
    parser.add_argument(
        "--asynchronous", action="store_true", help="torques of sim: act from their arrival, not in whole periods"
    )


def _run(options: argparse.Namespace) -> int:
    """Drive the machine, write the log and print a summary; return 0, or 1 after a fault."""
    from flexman_gym.common.checks import value_error
    from flexman_gym.envs.config.configuration import Configuration
    from flexman_gym.evaluation.machine.drive import drive
    from flexman_gym.evaluation.machine.simulated import Disturbances, SimulatedMachine

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
    log.save(options.out)
    loop, rest = log.about["machine"], log.about["machine"]["rest_seconds"]
    median, longest = (1e3 * each for each in loop["lateness"])
    print(f"{log.name}: {log.about['failure'] or 'completed'} after {log.time[-1]:.2f} s")
    print(_outcome(log))
    print(f"  {loop['periods']} periods of {1e3 * log.period:g} ms, late by {median:.3f} ms (at most {longest:.3g} ms)")
    print(f"  {loop['missed']:.2%} of the torques missed, {loop['silent']} periods without new readings")
    print("  the machine does not answer" if rest is None else f"  motors at rest {rest:.2f} s after the stop")
    print(f"{options.out}: to go on: flexman replay {options.out}, flexman why {options.out}, or fm.fit")
    return 1 if log.about["failure"] else 0


def _outcome(log: "Episode") -> str:
    """Return a line with the settling time, the final error and the vibration of the tip as its readings show them."""
    from flexman_gym.metrics import SETTLING_WINDOW, final_error, peak_to_peak, settling_time

    settled = settling_time(log.errors, log.about["band"], log.period)
    settling = f"tip settles in {settled:.2f} s" if math.isfinite(settled) else "tip does not settle"
    error, vibration = final_error(log.errors, log.period), peak_to_peak(log.tips, log.period, SETTLING_WINDOW)
    return f"  {settling}, error {1e3 * error:.2g} mm and vibration {1e3 * vibration:.2g} mm (p-p) in the last second"


COMMAND = CommandLine(_arguments, _run)
