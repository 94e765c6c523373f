"""Drawing: the command puts each picture where it is told to."""

from pathlib import Path

import pytest

from flexman_gym.__main__ import main

LEAGUE = Path(__file__).parents[2] / "docs" / "league"


def drawn(capsys, *words):
    """Files that the command says it has written, once they are pictures."""
    assert main(["draw", *map(str, words)]) == 0
    files = [Path(line) for line in capsys.readouterr().out.splitlines()]
    assert all(file.read_bytes().startswith(b"\x89PNG") for file in files)
    return files


@pytest.mark.parametrize("what", ["modes", "bode", "campbell"])
def test_a_picture_of_an_environment_is_the_file_that_was_named(what, tmp_path, capsys):
    assert drawn(capsys, what, "FlexOne-v0", "--out", tmp_path / "a.png") == [tmp_path / "a.png"]


def test_pictures_of_a_league_go_into_the_folder_that_was_named(tmp_path, capsys):
    before = {file: file.stat().st_mtime_ns for file in LEAGUE.iterdir()}
    assert {file.parent for file in drawn(capsys, "robustness", LEAGUE, "--out", tmp_path / "new")} == {
        tmp_path / "new"
    }
    assert {file: file.stat().st_mtime_ns for file in LEAGUE.iterdir()} == before
    assert main(["draw", "league", str(LEAGUE), "--out", str(tmp_path / "one.png")]) == 2
    assert "one.png is not allowed; give a folder" in capsys.readouterr().err
