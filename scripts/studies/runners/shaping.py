"""Shape motions of simulated arms under servos."""

import argparse

from flexman_gym.common.computer import computer_text
from studies.files import folder, write_rows
from studies.machine.measure import DATA
from studies.shaping.measure import real_frequencies, simulate


def main() -> None:
    """Run the study, write its rows and print a summary."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=folder, default="out", help="output folder of the rows")
    parser.add_argument(
        "--arms", type=int, default=30, metavar="N", help="number of random arms (default: %(default)s)"
    )
    options = parser.parse_args()
    rows = [simulate(seed) for seed in range(options.arms)]
    write_rows(rows, options.folder / "shaping.csv", 6, computer_text())
    print(
        f"{sum(row.left <= 0.05 for row in rows)} of {len(rows)} arms keep at most 5 % of the vibration; the interval "
        f"contains the residual of {sum(row.low <= row.residual <= row.high for row in rows)}; in "
        f"{sum(row.found < row.modes for row in rows)} records a second mode is below the noise"
    )
    for name, frequency in real_frequencies(DATA).items():
        print(f"real arm, {name}: {frequency:.4g} Hz")


if __name__ == "__main__":
    main()
