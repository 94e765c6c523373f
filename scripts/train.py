"""The command `flexman train`, from a checkout."""

import sys

from flexman_gym.__main__ import main as flexman


def main() -> int:
    """Runs it with the arguments of this script; returns the exit code."""
    return flexman(["train", *sys.argv[1:]])


if __name__ == "__main__":
    sys.exit(main())
