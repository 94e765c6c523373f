"""Files: a file is either complete or unchanged, and it is flushed to disk."""

import os

import pytest

from flexman_gym.common.files import write_atomically


def test_a_file_is_whole_or_not_there(tmp_path):
    """What fails in the middle of writing leaves the file of before and nothing beside it."""
    path = tmp_path / "file"
    write_atomically(path, lambda file: file.write(b"first"))

    def fail(file):
        file.write(b"second")
        raise OSError(28, "No space left on device")

    with pytest.raises(OSError, match="No space left"):
        write_atomically(path, fail)
    assert path.read_bytes() == b"first" and list(tmp_path.iterdir()) == [path]


def test_a_file_takes_its_place_when_all_of_it_is_on_the_disk(tmp_path, monkeypatch):
    """So that a computer that goes off leaves the file of before or the new one, not an empty one."""
    replace_file, flushed, placed = os.replace, {}, []
    monkeypatch.setattr(os, "fsync", lambda file: flushed.update({os.fstat(file).st_ino: os.fstat(file).st_size}))
    monkeypatch.setattr(os, "replace", lambda *paths: placed.append(os.stat(paths[0])) or replace_file(*paths))
    write_atomically(tmp_path / "file", lambda file: file.write(b"all of it"))
    assert [flushed[each.st_ino] for each in placed] == [9] and (tmp_path / "file").read_bytes() == b"all of it"
    assert tmp_path.stat().st_ino in flushed, "its name too"
