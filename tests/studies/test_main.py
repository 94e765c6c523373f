"""Tests of `python -m studies`: list of the programs, refusals, options."""

import subprocess
import sys

import pytest

from studies.__main__ import main

from oracles.files import PROGRAMS, ROOT, SCRIPTS, STUDIES, runner


def test_the_list_has_every_program_with_a_sentence(capsys):
    assert main([]) == 0
    lines = dict(line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines())
    assert list(lines) == PROGRAMS and all(text.endswith(".") for text in lines.values())


def test_an_unknown_name_is_refused_with_the_allowed_ones(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["nonsense"])
    assert stop.value.code == 2 and "invalid choice: 'nonsense' (choose from" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("name", STUDIES)
def test_an_output_folder_that_cannot_be_written_is_refused_before_a_study_starts(name, capsys):
    runner(name)
    with pytest.raises(SystemExit) as stop:
        main([name, "--folder", "/dev/null/here"])
    assert stop.value.code == 2
    assert "argument --folder: [Errno 20] Not a directory: '/dev/null/here'" in capsys.readouterr().err


def test_a_missing_file_of_rows_is_one_line(tmp_path, capsys):
    assert main(["robust", "--redraw", "--folder", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "No such file" in said and "robust.csv" in said


@pytest.mark.slow
def test_the_module_runs_from_the_folder_of_the_repository():
    call = [sys.executable, "-m", "studies"]
    done = subprocess.run(call, cwd=ROOT, env={"PYTHONPATH": str(SCRIPTS)}, capture_output=True, text=True, check=True)
    assert [line.split()[0] for line in done.stdout.splitlines()] == PROGRAMS
