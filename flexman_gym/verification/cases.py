"""Verification, cases: all that is compared, beams and motions."""

from pathlib import Path

from flexman_gym.verification.beams import CASES
from flexman_gym.verification.motions import motion_rows
from flexman_gym.verification.rows import Row

REFERENCE = Path(__file__).parent / "reference"  # scenes, and solutions of independent codes


def rows(reference: Path, quick: bool = False) -> list[Row]:
    """All rows, or those that take little time; `reference` is the folder of the reference scenes and solutions."""
    return [row for case in CASES for row in case()] + list(motion_rows(reference, quick))
