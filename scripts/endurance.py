"""Run random steps of many randomised arms and check for NaN and for growing memory."""

import argparse

from gymnasium.vector import AutoresetMode

import flexman_gym as fm
from flexman_gym.envs import NAMED_ENVIRONMENTS
from studies.benchmark.endurance import ALLOWED, SETTLED, alike, all_conditions, endure, publish
from studies.files import folder

MOST_ALARMS = 0.005  # of the steps
SENSORS = ("full", "lab", ("lab", "accelerometer", "tip"))
TIGHT = fm.Limits(rate=2.5)  # which arms under random torques break often
FEW = 8  # arms that are moved alone too


def every(steps: int, arms: int) -> None:
    """Print a line for each environment, with all conditions that it has, and each set of sensors.

    It fails with an alarm too many.
    """
    for name, named in NAMED_ENVIRONMENTS.items():
        for sensors in SENSORS:
            conditions = all_conditions(name) if named.conditions else {}
            count = endure(steps, arms, steps, name, sensors=sensors, **conditions)
            share, rate = count.alarms / count.steps, count.steps / count.cpu
            ends = dict(count.failures)
            print(
                f"{name}, {sensors}: {count.steps:,} steps, alarm {share:.4%}, {rate:,.0f} a second, {ends}", flush=True
            )
            if share >= MOST_ALARMS:
                raise SystemExit(f"{name}, {sensors}: an energy alarm in {share:.2%} of the steps")


def compare(steps: int) -> None:
    """Print a line for each autoreset mode: arms alone and at once, with history, hold and all conditions."""
    settings = all_conditions("FlexRRR-v0") | {"history": 4, "action_repeat": 3, "limits": TIGHT}
    for mode in AutoresetMode:
        count = steps // len(AutoresetMode)
        failures = alike("FlexRRR-v0", count, FEW, mode, **settings)
        print(f"{mode.value}: {count:,} steps alike to the bit, {failures:,} failures", flush=True)


def main() -> None:
    """Read the command line, run, and write the section; fail if memory grows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=10_000_000, help="of all arms together")
    parser.add_argument("--arms", type=int, default=256)
    parser.add_argument("--folder", type=folder, default="out", help="of the page whose section this is")
    parser.add_argument("--every", action="store_true", help="each environment and set of sensors, all conditions on")
    parser.add_argument("--alike", action="store_true", help="arms alone and at once, which must have the same bits")
    options = parser.parse_args()
    if options.alike:
        compare(options.steps)
        return
    if options.every:
        every(options.steps, options.arms)
        return
    count = endure(options.steps, options.arms, min(SETTLED, options.steps))
    options.folder.mkdir(parents=True, exist_ok=True)
    print(publish(count, options.arms, options.folder))
    if count.growth > ALLOWED:
        raise SystemExit(f"memory grew by {count.growth:.1%}")


if __name__ == "__main__":
    main()
