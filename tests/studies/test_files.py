"""Tests of the output folder: a read-only folder is rejected before a study starts."""

import argparse

import pytest

from studies.files import folder

from oracles.files import command


def test_a_folder_is_made(tmp_path):
    assert folder(str(tmp_path / "a" / "b")) == tmp_path / "a" / "b"
    assert (tmp_path / "a" / "b").is_dir()


@pytest.mark.parametrize("name", ["file", "file/below", 300 * "x"])
def test_what_is_no_folder_is_one_line(tmp_path, name):
    (tmp_path / "file").write_text("")
    with pytest.raises(argparse.ArgumentTypeError) as error:
        folder(str(tmp_path / name))
    assert "\n" not in str(error.value) and "Errno" in str(error.value)


@pytest.mark.parametrize(
    "script",
    [
        "benchmark",
        "peers",
        "learning",
        "ring_down",
        "robust",
        "safety",
        "servos",
        "stability",
        "strain",
        "work_precision",
    ],
)
def test_every_study_refuses_it_at_once(script, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", [script, "--folder", "/dev/null/here"])
    with pytest.raises(SystemExit) as stop:
        command(f"studies.runners.{script}").main()
    assert stop.value.code == 2
    assert "argument --folder: [Errno 20] Not a directory: '/dev/null/here'" in capsys.readouterr().err
