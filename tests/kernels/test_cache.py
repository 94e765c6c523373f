"""Cache: processes and threads load compiled kernels from the disk, with the same results."""

import hashlib
import json
import os
import pickle
import shutil
import stat
import subprocess
import sys
from functools import cache
from pathlib import Path

import numba
import numpy as np
import pytest

import flexman_gym
from flexman_gym.kernels import batch as kernels
from flexman_gym.kernels.cache import find_cache_folder, is_quiet

from oracles.small_package import CALL, copied, process, run

SCRIPT = '''
import hashlib, json, multiprocessing, sys
from concurrent.futures import ThreadPoolExecutor
import numpy as np
from numba.core.dispatcher import Dispatcher
from flexman_gym import kernels
from flexman_gym.envs.vector_env import FlexManVectorEnv

def environment(arms):
    env = FlexManVectorEnv(arms, threads=2, max_episode_steps=30)
    env.reset(seed=0)
    return env

def bits(env, seed):
    """Return a digest of the results of 50 steps."""
    digest, random = hashlib.sha256(), np.random.default_rng(seed)
    for _ in range(50):
        observations, rewards, *_ = env.step(random.uniform(-1.0, 1.0, env.action_space.shape))
        digest.update(observations.tobytes() + rewards.tobytes())
    return digest.hexdigest()

def counts():
    """Return the number of kernels loaded from the disk and compiled."""
    modules = [getattr(kernels, name) for name in kernels.__all__]
    result = {each for module in modules for each in vars(module).values() if isinstance(each, Dispatcher)}
    stats = [each.stats for each in result]
    return [sum(sum(part.values()) for part in parts) for parts in
            ([each.cache_hits for each in stats], [each.cache_misses for each in stats])]

def fresh(number=0):
    """Return the digests of an environment with many arms and with a single arm, and the counts."""
    return bits(environment(72), 1), bits(environment(1), 1), counts()

def inherited():
    """Return the digest of an environment made and used before this process was forked."""
    return bits(used, 2)

if __name__ == "__main__":
    method, used = sys.argv[1], None
    if method == "thread":
        with ThreadPoolExecutor(4) as pool:
            print(json.dumps(list(pool.map(fresh, range(4)))))
    else:
        context = multiprocessing.get_context(method)
        with context.Pool(2) as pool:
            result = pool.map(fresh, range(2))
        if method == "fork":
            used = environment(72)
            bits(used, 1)
            with context.Pool(1) as pool:
                result.append([pool.apply(inherited), inherited()])
        print(json.dumps(result))
'''


@pytest.fixture(scope="module")
def here(tmp_path_factory):
    """Return the script and the digests of its environments in this process, which compiles missing kernels."""
    file = tmp_path_factory.mktemp("cache") / "script.py"
    file.write_text(SCRIPT)
    names: dict = {"__name__": "script"}
    exec(compile(SCRIPT, str(file), "exec"), names)
    return file, names["fresh"]()[:2]


@cache
def elsewhere(file, way):
    """Return the output of the script in another process with the same folder of kernels."""
    folder = next(each for each in Path(kernels.advance_batch.stats.cache_path).parents if each.name == "flexman_gym")
    root = Path(flexman_gym.__file__).parents[1]
    environment = os.environ | {"PYTHONPATH": str(root), "NUMBA_CACHE_DIR": str(folder.parent)}
    command = [sys.executable, str(file), way]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=300)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.slow
@pytest.mark.parametrize("way", ["fork", "spawn", "thread"])
def test_kernels_are_loaded_with_the_same_results(here, way):
    file, expected = here
    for *result, (loaded, compiled) in elsewhere(file, way)[: 4 if way == "thread" else 2]:
        assert tuple(result) == expected
        assert loaded > 0 and compiled == 0


@pytest.mark.slow
def test_an_environment_with_threads_continues_in_a_forked_process(here):
    *_, (child, parent) = elsewhere(here[0], "fork")
    assert child == parent


NOBODY = 65534


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    folder = tmp_path_factory.mktemp("package")
    copied(folder, 1)
    return folder


@pytest.fixture(scope="module")
def filled(package, tmp_path_factory):
    """Return a cache folder with the code of the small kernels."""
    folder = tmp_path_factory.mktemp("cache")
    assert run(package, folder, CALL)[:2] == ["2", "0"]
    return folder


@pytest.fixture(name="cache")
def copy_of_cache(filled, tmp_path):
    """Return a copy of that folder."""
    shutil.copytree(filled, tmp_path, dirs_exist_ok=True)
    return tmp_path


def noise(content):
    return np.random.default_rng(0).bytes(len(content))


def flipped(content):
    """Return the content with one bit changed."""
    place = len(content) // 2
    return content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :]


DAMAGES = {
    "empty": lambda content: b"",
    "cut off": lambda content: content[: len(content) // 2],
    "one byte short": lambda content: content[:-1],
    "noise": noise,
    "noise in the middle": lambda content: content[:40] + noise(content[40:60]) + content[60:],
    "one bit": flipped,
    "longer": lambda content: content + b"more",
}


@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_file_counts_as_missing_until_it_is_written_again(tmp_path, damage, suffix):
    files = type(kernels.run_steps._cache._cache_file)(str(tmp_path), "kernel", "stamp")
    files.save("key", "code")
    assert files.load("key") == "code" and files.load("other") is None
    (path,) = tmp_path.glob(f"*.{suffix}")
    path.write_bytes(DAMAGES[damage](path.read_bytes()))
    assert files.load("key") is None
    files.save("key", "code again")
    assert files.load("key") == "code again"
    path.unlink()
    assert files.load("key") is None


@pytest.mark.slow
@pytest.mark.parametrize(("damage", "suffix"), [("noise", "nbi"), ("one bit", "nbc")])
def test_a_damaged_kernel_is_compiled_again_once(package, cache, damage, suffix):
    (path,) = cache.rglob(f"caller*.{suffix}")
    path.write_bytes(DAMAGES[damage](path.read_bytes()))
    assert run(package, cache, CALL)[:2] == ["2", "0"]
    assert run(package, cache, CALL)[:2] == ["2", "1"]


@pytest.mark.slow
def test_a_cache_that_cannot_be_written_costs_the_cache_and_not_the_call(package, tmp_path):
    """Opening for writing fails as on a full disk."""
    script = "import numba.core.caching as c, errno\n" \
             "def full(self, path): raise OSError(errno.ENOSPC, 'No space left on device')\n" \
             "c.IndexDataCacheFile._open_for_write = full\n" + CALL  # fmt: skip
    done = process(package, tmp_path, script)
    assert done.returncode == 0 and done.stdout.split()[:2] == ["2", "0"]
    assert done.stderr.count("flexman_gym cannot cache compiled kernels: ") == 1


@pytest.mark.slow
def test_folders_are_the_users_alone(package, cache):
    (result,) = cache.glob("flexman_gym/*")
    for folder in (result, result.parent):
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700


@pytest.mark.slow
@pytest.mark.parametrize("level", [0, 1])
def test_a_folder_open_to_others_is_not_read(package, cache, tmp_path, level):
    """The folder is emptied and closed; code in a file that others could have written is not executed."""

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
    assert run(package, cache, CALL)[:2] == ["2", "0"], "compiled again"
    assert not (tmp_path / "ran").exists() and not (inner / "link").exists()
    assert stat.S_IMODE(opened.stat().st_mode) == 0o700
    assert run(package, cache, CALL)[:2] == ["2", "1"]
    assert (inner.parent / "mine.txt").read_text() == "mine", "a folder of that name may hold other things"


@pytest.mark.slow
@pytest.mark.skipif(os.getuid() != 0, reason="only root can give a folder to somebody else")
@pytest.mark.parametrize("prepared", ["foreign", "open", "link"])
def test_a_prepared_folder_in_the_temporary_folder_is_refused(package, tmp_path, prepared):
    """No other folder can be written, so kernels are compiled and not cached."""
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
    assert "in every process, as no private cache folder can be written" in done.stderr
    assert not [path for path in tmp_path.rglob("*.nb*")]


@pytest.mark.slow
def test_the_temporary_folder_is_used_with_one_message_if_the_home_cannot_be_written(package, tmp_path):
    (tmp_path / "file").write_text("")
    for hits in ("0", "1"):
        done = process(package, tmp_path / "file", CALL, TMPDIR=str(tmp_path))
        words = done.stdout.split()
        assert words[:2] == ["2", hits] and Path(words[2]).is_relative_to(tmp_path / f"user-{os.getuid()}")
        assert (f"caches compiled kernels in {tmp_path}" in done.stderr) == (hits == "0"), "one message"
    assert stat.S_IMODE((tmp_path / f"user-{os.getuid()}").stat().st_mode) == 0o700


@pytest.mark.slow
def test_a_home_that_does_not_exist_is_not_made(package, tmp_path):
    words = run(package, "", CALL, HOME=str(tmp_path / "home"), XDG_CACHE_HOME="", TMPDIR=str(tmp_path))
    assert words[:2] == ["2", "0"] and not (tmp_path / "home").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "value", "another"), [("BOUNDSCHECK", "1", "0"), ("CPU_NAME", "generic", ""), ("OPT", "1", "3")]
)
def test_settings_that_change_the_code_have_another_folder(package, cache, name, value, another):
    """If the tests run with the first value, the other value is set."""
    setting = {f"NUMBA_{name}": another if os.environ.get(f"NUMBA_{name}") == value else value}
    words = run(package, cache, CALL, **setting)
    assert words[:2] == ["2", "0"] and len(list(cache.glob("flexman_gym/*"))) == 2


# In this process


@pytest.mark.parametrize("name", ["OPT", "CPU_NAME", "CPU_FEATURES", "ENABLE_AVX", "LOOP_VECTORIZE", "SLP_VECTORIZE"])
def test_every_setting_of_the_code_makes_another_folder(tmp_path, monkeypatch, name):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    before = find_cache_folder()
    monkeypatch.setattr(numba.config, name, "another")
    assert find_cache_folder() != before


@pytest.mark.parametrize("mode", [0o770, 0o707, 0o777])
def test_a_folder_in_which_the_group_or_all_may_write_is_emptied(tmp_path, monkeypatch, mode):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    folder = Path(find_cache_folder())
    (folder / "theirs").write_text("")
    folder.chmod(mode)
    assert find_cache_folder() == str(folder) and not list(folder.iterdir())
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700


def test_the_folder_for_numba_goes_before_the_one_for_everything(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "numba"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "all"))
    assert Path(find_cache_folder()).is_relative_to(tmp_path / "numba")
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    assert Path(find_cache_folder()).is_relative_to(tmp_path / "all")


@pytest.mark.parametrize(("value", "silent"), [("1", True), ("yes", True), ("0", False), ("", False)])
def test_nothing_and_zero_do_not_silence(monkeypatch, value, silent):
    monkeypatch.setenv("FLEXMAN_QUIET", value)
    assert is_quiet() == silent
