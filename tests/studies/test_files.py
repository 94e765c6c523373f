"""Tests of the output folder: created, or refused in one line."""

import argparse

import pytest

from studies.files import folder


def test_a_missing_output_folder_is_created(tmp_path):
    assert folder(str(tmp_path / "a" / "b")) == tmp_path / "a" / "b"
    assert (tmp_path / "a" / "b").is_dir()


@pytest.mark.parametrize("name", ["file", "file/below", 300 * "x"])
def test_an_output_folder_that_is_a_file_is_refused_in_one_line(tmp_path, name):
    (tmp_path / "file").write_text("")
    with pytest.raises(argparse.ArgumentTypeError) as error:
        folder(str(tmp_path / name))
    assert "\n" not in str(error.value) and "Errno" in str(error.value)
