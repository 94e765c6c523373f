"""Endurance test: random steps of many randomised arms, checked for NaN and growing memory."""

import argparse

from gymnasium.vector import AutoresetMode

import flexman_gym as fm
from flexman_gym.common.computer import computer_text
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from studies.benchmark.endurance import ALLOWED, SETTLED, alike, all_conditions, endurance_rows, endure
from studies.benchmark.page import ENDURANCE_FILE, ROWS_FILE, publish
from studies.files import folder, write_rows

MOST_ALARMS = 0.005  # allowed share of steps with an energy alarm
SENSORS = ("full", "lab", ("lab", "accelerometer", "tip"))
TIGHT = fm.Limits(rate=2.5)  # rad/s; low joint rate limit that arms under random torques exceed often
FEW = 8  # arms in the comparison of single and vector environments


def every(steps: int, arms: int) -> None:
    """Test each environment with all of its conditions and each set of sensors, and print one line each.

    Raises:
        SystemExit: if the share of steps with an energy alarm reaches `MOST_ALARMS`.
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
    """Check for each autoreset mode that single and vector environments agree bit by bit, and print one line each."""
    settings = all_conditions("FlexRRR-v0") | {"history": 4, "action_repeat": 3, "limits": TIGHT}
    for mode in AutoresetMode:
        count = steps // len(AutoresetMode)
        failures = alike("FlexRRR-v0", count, FEW, mode, **settings)
        print(f"{mode.value}: {count:,} steps equal bit by bit, {failures:,} failures", flush=True)


def main() -> None:
    """Run the test, write its rows and the benchmark page; fail if memory grows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=10_000_000, help="total number of steps of all arms")
    parser.add_argument("--arms", type=int, default=256, help="number of arms")
    parser.add_argument("--folder", type=folder, default="out", help="folder of rows and of the benchmark page")
    parser.add_argument(
        "--every", action="store_true", help="test each environment and set of sensors with all conditions"
    )
    parser.add_argument(
        "--alike", action="store_true", help="check that single and vector environments agree bit by bit"
    )
    options = parser.parse_args()
    if options.alike:
        compare(options.steps)
        return
    if options.every:
        every(options.steps, options.arms)
        return
    count = endure(options.steps, options.arms, min(SETTLED, options.steps))
    options.folder.mkdir(parents=True, exist_ok=True)
    rows = endurance_rows(count)
    print(*rows, sep="\n")
    write_rows(rows, options.folder / ENDURANCE_FILE, 9, computer_text())
    if (options.folder / ROWS_FILE).exists():
        publish(options.folder)
    if count.growth > ALLOWED:
        raise SystemExit(f"memory grew by {count.growth:.1%}")


if __name__ == "__main__":
    main()
