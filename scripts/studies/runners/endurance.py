"""Check random steps of all environments with all conditions: energy alarms, or single against vector environments."""

from argparse import ArgumentParser, Namespace

from gymnasium.vector import AutoresetMode

import flexman_gym as fm
from flexman_gym.commands import CommandLine
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from studies.benchmark.endurance import alike, all_conditions, endure

MOST_ALARMS = 0.005  # allowed share of steps with an energy alarm
SENSORS = ("full", "lab", ("lab", "accelerometer", "tip"))
TIGHT = fm.Limits(rate=2.5)  # rad/s; low joint rate limit that arms under random torques exceed often
FEW = 8  # arms in the comparison of single and vector environments


def arguments(parser: ArgumentParser) -> None:
    """Add the kind and the size of the check."""
    parser.add_argument("check", choices=("alarms", "alike"), help="energy alarms, or equality bit by bit")
    parser.add_argument("--steps", type=int, default=10_000_000, help="total number of steps of all arms")
    parser.add_argument("--arms", type=int, default=256, help="number of arms of the check of alarms")


def run(options: Namespace) -> int:
    """Run the check and return 1 if it fails."""
    if options.check == "alarms":
        return alarms(options.steps, options.arms)
    compare(options.steps)
    return 0


def alarms(steps: int, arms: int) -> int:
    """Step each environment with all of its conditions and each set of sensors, and print one line each.

    Returns:
        1 as soon as the share of steps with an energy alarm reaches `MOST_ALARMS`, otherwise 0.
    """
    for name, named in NAMED_ENVIRONMENTS.items():
        for sensors in SENSORS:
            conditions = all_conditions(name) if named.conditions else {}
            count = endure(steps, arms, steps, name, sensors=sensors, **conditions)
            share, rate = count.alarms / count.steps, count.steps / count.cpu
            text = f"{name}, {sensors}: {count.steps:,} steps, alarm {share:.4%}, {rate:,.0f} a second"
            print(f"{text}, {dict(count.failures)}", flush=True)
            if share >= MOST_ALARMS:
                return 1
    return 0


def compare(steps: int) -> None:
    """Check for each autoreset mode that single and vector environments agree bit by bit, and print one line each."""
    settings = all_conditions("FlexRRR-v0") | {"history": 4, "action_repeat": 3, "limits": TIGHT}
    for mode in AutoresetMode:
        count = steps // len(AutoresetMode)
        failures = alike("FlexRRR-v0", count, FEW, mode, **settings)
        print(f"{mode.value}: {count:,} steps equal bit by bit, {failures:,} failures", flush=True)


RUNNER = CommandLine(arguments, run)
