"""Study of the first use: phases of new processes, and the page of their medians."""

import os
import sys
from argparse import ArgumentTypeError

import pytest

from studies.runners.starts import interpreter
from studies.starts.measure import COLD, PHASES, WARM, WHEEL, StartRow, start_rows
from studies.starts.page import page, total


def rows(way, *seconds):
    """Rows of a way whose phases last equally long in a run, with twice the CPU time."""
    return [StartRow(way, phase, run, 2.0 * each, each) for run, each in enumerate(seconds) for phase in PHASES]


def test_the_total_is_the_median_over_the_runs_of_the_sum_of_the_phases():
    assert total(rows(COLD, 3.0, 1.0, 2.0), COLD) == 2.0 * len(PHASES)
    assert total(rows(COLD, 3.0, 1.0, 2.0), COLD, "cpu") == 4.0 * len(PHASES)


def test_the_page_has_a_column_for_each_way_that_was_measured():
    both = rows(COLD, 12.0) + rows(WARM, 0.5)
    text = " ".join(page(both, {"starts.csv": "computer"}).split())
    assert "Where kernels are compiled 60 s, once; from then on 2 s." in text and WHEEL not in text
    assert f"| | {COLD} | {WARM} |" in text and "| 64 arms | 12.00 (24.00) | 0.50 (1.00) |" in text
    text = " ".join(page(both + rows(WHEEL, 0.4), {"starts.csv": "computer"}).split())
    assert "With a wheel that brings machine code the first use takes 2 s;" in text


@pytest.mark.slow
def test_every_phase_of_a_new_process_takes_time():
    measured = list(start_rows(1, None, cold=False))
    assert [row.phase for row in measured] == list(PHASES) and {row.way for row in measured} == {WARM}
    assert all(0.0 < row.wall < 100.0 and 0.0 < row.cpu < 100.0 for row in measured)


def test_an_interpreter_is_found_from_any_folder_and_has_the_version_of_the_checkout(tmp_path):
    assert interpreter(os.path.relpath(sys.executable)).startswith("/")
    with pytest.raises(ArgumentTypeError, match="nothing does not exist; give the interpreter"):
        interpreter(str(tmp_path / "nothing"))
    other = tmp_path / "python"
    other.write_text("#!/bin/sh\necho 0.1.0\n")
    other.chmod(0o755)
    with pytest.raises(ArgumentTypeError, match=r"python has flexman_gym 0\.1\.0; install the wheel of version"):
        interpreter(str(other))
