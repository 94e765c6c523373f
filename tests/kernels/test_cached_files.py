"""Cached files: damaged ones are compiled anew, foreign folders are not read, settings have folders of their own."""

import hashlib
import os
import pickle
import shutil
import stat
from pathlib import Path

import numba
import numpy as np
import pytest

from flexman_gym.kernels.cache import SealedFiles, find_folder, quiet

from oracles.small_package import CALL, copied, process, run

NOBODY = 65534


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    folder = tmp_path_factory.mktemp("package")
    copied(folder, 1)
    return folder


@pytest.fixture(scope="module")
def filled(package, tmp_path_factory):
    """A folder that holds the code of the small kernels."""
    folder = tmp_path_factory.mktemp("cache")
    assert run(package, folder, CALL)[:2] == ["2", "0"]
    return folder


@pytest.fixture
def cache(filled, tmp_path):
    """A copy of it."""
    shutil.copytree(filled, tmp_path, dirs_exist_ok=True)
    return tmp_path


def noise(content):
    return np.random.default_rng(0).bytes(len(content))


def turned(content):
    """One bit in the middle is another."""
    place = len(content) // 2
    return content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :]


DAMAGES = {
    "empty": lambda content: b"",
    "cut off": lambda content: content[: len(content) // 2],
    "one byte short": lambda content: content[:-1],
    "noise": noise,
    "noise in the middle": lambda content: content[:40] + noise(content[40:60]) + content[60:],
    "one bit": turned,
    "longer": lambda content: content + b"more",
}


@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
@pytest.mark.parametrize("damage", DAMAGES)
def test_what_is_damaged_counts_as_missing_until_it_is_kept_again(tmp_path, damage, suffix):
    files = SealedFiles(str(tmp_path), "kernel", "stamp")
    files.save("key", "code")
    assert files.load("key") == "code" and files.load("other") is None
    (path,) = tmp_path.glob(f"*.{suffix}")
    path.write_bytes(DAMAGES[damage](path.read_bytes()))
    assert files.load("key") is None
    files.save("key", "code again")
    assert files.load("key") == "code again"
    path.unlink()
    assert files.load("key") is None


@pytest.mark.parametrize(("damage", "suffix"), [("noise", "nbi"), ("one bit", "nbc")])
def test_a_damaged_file_is_compiled_anew_once(package, cache, damage, suffix):
    (path,) = cache.rglob(f"caller*.{suffix}")
    path.write_bytes(DAMAGES[damage](path.read_bytes()))
    assert run(package, cache, CALL)[:2] == ["2", "0"]
    assert run(package, cache, CALL)[:2] == ["2", "1"]


def test_a_cache_that_cannot_be_written_costs_the_cache_and_not_the_call(package, tmp_path):
    """A file where the folder of the kernels should be, as root may write everywhere."""
    script = "import numba.core.caching as c, errno\n" \
             "def full(self, path): raise OSError(errno.ENOSPC, 'No space left on device')\n" \
             "c.IndexDataCacheFile._open_for_write = full\n" + CALL  # fmt: skip
    done = process(package, tmp_path, script)
    assert done.returncode == 0 and done.stdout.split()[:2] == ["2", "0"]
    assert done.stderr.count("flexman_gym cannot keep compiled kernels: ") == 1


def test_folders_are_the_users_alone(package, cache):
    (result,) = cache.glob("flexman_gym/*")
    for folder in (result, result.parent):
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700


@pytest.mark.parametrize("level", [0, 1])
def test_what_others_could_write_is_not_read(package, cache, tmp_path, level):
    """A folder of ours that was open is emptied and closed: what a file in it would run does not run."""

    class Evil:
        def __reduce__(self):
            return (Path.touch, (tmp_path / "ran",))

    (inner,) = cache.glob("flexman_gym/*")
    (index,) = cache.rglob("caller*.nbi")
    content = pickle.dumps(Evil())
    index.write_bytes(hashlib.sha256(content).digest() + content)
    (inner / "link").symlink_to(cache)
    opened = (inner.parent, inner)[level]
    (inner.parent / "mine.txt").write_text("mine")
    opened.chmod(0o777)
    assert run(package, cache, CALL)[:2] == ["2", "0"], "compiled anew"
    assert not (tmp_path / "ran").exists() and not (inner / "link").exists()
    assert stat.S_IMODE(opened.stat().st_mode) == 0o700
    assert run(package, cache, CALL)[:2] == ["2", "1"]
    assert (inner.parent / "mine.txt").read_text() == "mine", "a folder of that name may hold other things"


@pytest.mark.skipif(os.getuid() != 0, reason="only root can give a folder to somebody else")
@pytest.mark.parametrize("prepared", ["foreign", "open", "link"])
def test_a_prepared_folder_in_the_temporary_folder_is_refused(package, tmp_path, prepared):
    """No other folder can be written: kernels are compiled and not kept."""
    temporary, other = tmp_path / "tmp", tmp_path / "other"
    ours = temporary / f"user-{os.getuid()}"
    (other / "flexman_gym").mkdir(parents=True)
    temporary.mkdir()
    if prepared == "link":
        ours.symlink_to(other)
    else:
        (ours / "flexman_gym").mkdir(parents=True)
        ours.chmod(0o777 if prepared == "open" else 0o700)
    if prepared == "foreign":
        os.chown(ours, NOBODY, NOBODY)
    (tmp_path / "file").write_text("")
    script = CALL.replace(", doubled.stats.cache_path", "")
    done = process(package, tmp_path / "file", script, TMPDIR=str(temporary))
    assert done.returncode == 0 and done.stdout.split() == ["2", "0"], done.stderr
    assert "in every process: no folder that is yours alone can be written" in done.stderr
    assert not [path for path in tmp_path.rglob("*.nb*")]


def test_the_temporary_folder_serves_where_the_home_does_not_and_is_not_made_in_silence(package, tmp_path):
    (tmp_path / "file").write_text("")
    for hits in ("0", "1"):
        done = process(package, tmp_path / "file", CALL, TMPDIR=str(tmp_path))
        words = done.stdout.split()
        assert words[:2] == ["2", hits] and Path(words[2]).is_relative_to(tmp_path / f"user-{os.getuid()}")
        assert (f"keeps compiled kernels in {tmp_path}" in done.stderr) == (hits == "0"), "said once"
    assert stat.S_IMODE((tmp_path / f"user-{os.getuid()}").stat().st_mode) == 0o700


def test_a_home_that_does_not_exist_is_not_made(package, tmp_path):
    words = run(package, "", CALL, HOME=str(tmp_path / "home"), XDG_CACHE_HOME="", TMPDIR=str(tmp_path))
    assert words[:2] == ["2", "0"] and not (tmp_path / "home").exists()


@pytest.mark.parametrize(
    ("name", "value", "another"), [("BOUNDSCHECK", "1", "0"), ("CPU_NAME", "generic", ""), ("OPT", "1", "3")]
)
def test_settings_that_change_the_code_have_a_folder_of_their_own(package, cache, name, value, another):
    """Another value where the tests themselves run with the first."""
    setting = {f"NUMBA_{name}": another if os.environ.get(f"NUMBA_{name}") == value else value}
    words = run(package, cache, CALL, **setting)
    assert words[:2] == ["2", "0"] and len(list(cache.glob("flexman_gym/*"))) == 2


# In this process


@pytest.mark.parametrize("name", ["OPT", "CPU_NAME", "CPU_FEATURES", "ENABLE_AVX", "LOOP_VECTORIZE", "SLP_VECTORIZE"])
def test_every_setting_of_the_code_makes_another_folder(tmp_path, monkeypatch, name):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    before = find_folder()
    monkeypatch.setattr(numba.config, name, "another")
    assert find_folder() != before


@pytest.mark.parametrize("mode", [0o770, 0o707, 0o777])
def test_a_folder_in_which_the_group_or_all_may_write_is_emptied(tmp_path, monkeypatch, mode):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    folder = Path(find_folder())
    (folder / "theirs").write_text("")
    folder.chmod(mode)
    assert find_folder() == str(folder) and not list(folder.iterdir())
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700


def test_the_folder_for_numba_goes_before_the_one_for_everything(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "numba"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "all"))
    assert Path(find_folder()).is_relative_to(tmp_path / "numba")
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    assert Path(find_folder()).is_relative_to(tmp_path / "all")


@pytest.mark.parametrize(("value", "silent"), [("1", True), ("yes", True), ("0", False), ("", False)])
def test_nothing_and_zero_do_not_silence(monkeypatch, value, silent):
    monkeypatch.setenv("FLEXMAN_QUIET", value)
    assert quiet() == silent
