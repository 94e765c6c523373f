"""Cache: other processes and threads load compiled kernels from the disk, and arms move there as they do here."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import flexman_gym
from flexman_gym.kernels import arms as kernels

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
    """A digest of all that 50 steps give."""
    digest, random = hashlib.sha256(), np.random.default_rng(seed)
    for _ in range(50):
        observations, rewards, *_ = env.step(random.uniform(-1.0, 1.0, env.action_space.shape))
        digest.update(observations.tobytes() + rewards.tobytes())
    return digest.hexdigest()

def counts():
    """How many kernels have been loaded from the disk, and how many compiled."""
    rooms = [getattr(kernels, name) for name in kernels.__all__]
    result = {each for room in rooms for each in vars(room).values() if isinstance(each, Dispatcher)}
    stats = [each.stats for each in result]
    return [sum(sum(part.values()) for part in parts) for parts in
            ([each.cache_hits for each in stats], [each.cache_misses for each in stats])]

def fresh(number=0):
    """Bits of an environment with many arms and of one with a single arm, and the counts."""
    return bits(environment(72), 1), bits(environment(1), 1), counts()

def inherited():
    """Bits of an environment that was made and used before this process was."""
    return bits(used, 2)

if __name__ == "__main__":
    way, used = sys.argv[1], None
    if way == "thread":
        with ThreadPoolExecutor(4) as pool:
            print(json.dumps(list(pool.map(fresh, range(4)))))
    else:
        context = multiprocessing.get_context(way)
        with context.Pool(2) as pool:
            result = pool.map(fresh, range(2))
        if way == "fork":
            used = environment(72)
            bits(used, 1)
            with context.Pool(1) as pool:
                result.append([pool.apply(inherited), inherited()])
        print(json.dumps(result))
'''


@pytest.fixture(scope="module")
def here(tmp_path_factory):
    """The script, and the bits of its environments in this process, which compiles what is not on disk yet."""
    file = tmp_path_factory.mktemp("cache") / "script.py"
    file.write_text(SCRIPT)
    names: dict = {"__name__": "script"}
    exec(compile(SCRIPT, str(file), "exec"), names)
    return file, names["fresh"]()[:2]


def elsewhere(file, way):
    """What the script prints in a process of its own that has the same folder of kernels."""
    folder = next(each for each in Path(kernels.advance_arms.stats.cache_path).parents if each.name == "flexman_gym")
    root = Path(flexman_gym.__file__).parents[1]
    environment = os.environ | {"PYTHONPATH": str(root), "NUMBA_CACHE_DIR": str(folder.parent)}
    command = [sys.executable, str(file), way]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=300)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize("way", ["fork", "spawn", "thread"])
def test_kernels_are_loaded_and_arms_move_as_here(here, way):
    file, expected = here
    for *result, (loaded, compiled) in elsewhere(file, way)[: 4 if way == "thread" else 2]:
        assert tuple(result) == expected
        assert loaded > 0 and compiled == 0


def test_an_environment_with_threads_goes_on_in_a_forked_process(here):
    *_, (child, parent) = elsewhere(here[0], "fork")
    assert child == parent
