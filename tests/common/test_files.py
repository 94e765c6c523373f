"""Files: a file is either complete or unchanged, and it is flushed to disk."""

import os
import threading

import pytest

from flexman_gym.common.files import check_output, new_folder, write_atomically, write_file


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


@pytest.mark.parametrize("stop", [KeyboardInterrupt, ValueError])
def test_any_exception_while_a_file_is_filled_leaves_no_temporary_file(stop, tmp_path):
    def fail(file):
        file.write(b"second")
        raise stop

    with pytest.raises(stop):
        write_atomically(tmp_path / "file", fail)
    assert list(tmp_path.iterdir()) == []


def test_a_file_takes_its_place_when_all_of_it_is_on_the_disk(tmp_path, monkeypatch):
    """So that a computer that goes off leaves the file of before or the new one, not an empty one."""
    replace_file, flushed, placed = os.replace, {}, []
    monkeypatch.setattr(os, "fsync", lambda file: flushed.update({os.fstat(file).st_ino: os.fstat(file).st_size}))
    monkeypatch.setattr(os, "replace", lambda *paths: placed.append(os.stat(paths[0])) or replace_file(*paths))
    write_atomically(tmp_path / "file", lambda file: file.write(b"all of it"))
    assert [flushed[each.st_ino] for each in placed] == [9] and (tmp_path / "file").read_bytes() == b"all of it"
    assert tmp_path.stat().st_ino in flushed, "its name too"


def test_a_replaced_file_keeps_its_permissions(tmp_path):
    path = tmp_path / "secret"
    path.write_text("first")
    path.chmod(0o600)
    write_file(path, "second")
    assert path.read_text() == "second" and path.stat().st_mode & 0o777 == 0o600


def test_a_link_remains_and_its_target_is_written(tmp_path):
    link, target = tmp_path / "link", tmp_path / "folder" / "target"
    link.symlink_to(target)
    for content in ("first", b"second", lambda file: file.write(b"third")):
        write_file(link, content)
    assert link.is_symlink() and target.read_bytes() == b"third" and os.listdir(target.parent) == ["target"]


def test_a_new_folder_has_the_first_free_number(tmp_path):
    made = [new_folder(tmp_path / "a" / "now") for _ in range(3)]
    assert made == [tmp_path / "a" / name for name in ("now", "now-2", "now-3")] and all(map(os.path.isdir, made))
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="file"):
        new_folder(tmp_path / "file" / "now")


def test_a_pipe_is_written_in_place(tmp_path):
    """As /dev/stdout in a shell; it is not replaced by a file."""
    pipe, read = tmp_path / "pipe", []
    os.mkfifo(pipe)
    reader = threading.Thread(target=lambda: read.append(pipe.read_text()))
    reader.start()
    write_file(check_output(pipe), "all of it")
    reader.join()
    assert read == ["all of it"] and pipe.is_fifo() and list(tmp_path.iterdir()) == [pipe]


def test_a_path_at_which_no_file_can_be_written_is_refused_beforehand(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("first")
    assert check_output(tmp_path / "new" / "file") == tmp_path / "new" / "file"
    assert check_output(str(tmp_path / "file")) == tmp_path / "file" and os.listdir(tmp_path) == ["file"]
    for path, words in ((tmp_path, "Is a directory"), (tmp_path / "file" / "inside", "Not a directory|File exists"),
                        ("/proc/file", "No such file"), (tmp_path / ("x" * 300), "File name too long")):  # fmt: skip
        for write in (check_output, lambda path: write_file(path, "second")):
            with pytest.raises(OSError, match=words):
                write(path)
    monkeypatch.setattr(os, "access", lambda *_: False)  # a write-protected file, for a user who is not root
    for write in (check_output, lambda path: write_file(path, "second")):
        with pytest.raises(PermissionError, match="file"):
            write(tmp_path / "file")
    assert (tmp_path / "file").read_text() == "first"
