"""Compare arms read from URDF files with Pinocchio.

The interpreter needs the packages pin and example-robot-data; without --python they are taken from this one.
"""

import argparse
import sys

from flexman_gym.common.computer import computer_text
from studies.files import folder, write_rows
from studies.urdf.measure import measured


def main() -> None:
    """Write the rows and print them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--python", default=sys.executable, help="interpreter with pin and example-robot-data")
    parser.add_argument("--folder", type=folder, default="out", help="output folder of the rows")
    options = parser.parse_args()
    rows, versions = measured(options.python)
    packages = ", ".join(f"{name} {version}" for name, version in versions.items())
    write_rows(rows, options.folder / "urdf.csv", digits=2, comment=f"{computer_text()}, {packages}")
    print((options.folder / "urdf.csv").read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
