"""Synthetic exported policy and defective variants of its files.

`PYTHONPATH=tests python -m oracles.shipped 1000` reads 1000 variants and prints the findings.
"""

import json
import sys
import tempfile
from collections import Counter
from functools import cache
from pathlib import Path

import numpy as np

from flexman_gym.agent.agent import history_length
from flexman_gym.agent.network import Network
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.agents import find_agent
from flexman_gym.evaluation.policy_files import ARRAYS, CHECK_ROWS, METADATA, write_policy
from flexman_gym.evaluation.trained_agents import observation_layout

DESCRIBED = Configuration.from_plain({
    "id": "FlexPlanar-v0", "base": "pd", "action_repeat": 5, "sensors": ["full", "fine"], "horizon": 1.0,
    "gains": {"stiffness": [39.0, 5.56], "damping": [9.35, 1.33]},
})  # fmt: skip
FIRST = "mlp_extractor.policy_net.0"


def made_up(described=DESCRIBED, seed=0):
    """Return the description of a policy and its arrays, random layers with nonzero actions."""
    random, names = np.random.default_rng(seed), observation_layout(described)
    size = history_length(described.history) * sum(each["size"] for each in names)
    joints = described.arm.n_joints
    shapes = {f"{FIRST}.weight": (7, size), f"{FIRST}.bias": (7,), "action_net.weight": (joints, 7),
              "action_net.bias": (joints,)}  # fmt: skip
    layers = {name: random.normal(0.0, 0.3, shape).astype(np.float32) for name, shape in shapes.items()}
    moments = {"mean": random.normal(0.0, 0.1, size), "var": random.uniform(0.5, 2.0, size)}
    seen = random.normal(0.0, 1.0, (CHECK_ROWS, size)).astype(np.float32)
    actions = Network("ppo", None, layers, moments)(seen)
    settings = {"algo": "ppo", "hyperparameters": {}, "seed": 3, "envs": 4, "eval_every": 0}
    about = {
        "words": "Made up.", "licence": "MIT", "commit": "", "versions": {}, "training_seconds": 2.0, "league": {},
        "recipe": {"name": "", "settings": settings}, "environment": described.to_plain(), "observation": names,
    }  # fmt: skip
    arrays = layers | {f"statistics.{name}": each for name, each in moments.items()}
    return about, arrays | {"check.observations": seen, "check.actions": actions}


def write_still(folder):
    """Write a policy with zero actions, added to its PD controller and trained in its own environment, to a folder."""
    about, arrays = made_up()
    for name in ("action_net.weight", "action_net.bias", "check.actions"):
        arrays[name] = np.zeros_like(arrays[name])
    about["recipe"]["settings"]["environment"] = DESCRIBED.to_plain()
    write_policy(folder, about, arrays)


@cache
def files():
    """Return the files of the policy."""
    with tempfile.TemporaryDirectory() as folder:
        write_policy(Path(folder), *made_up())
        return {name: (Path(folder) / name).read_bytes() for name in (METADATA, ARRAYS)}


@cache
def torques():
    """Return observations and the corresponding outputs of the policy's network."""
    with tempfile.TemporaryDirectory() as folder:
        seen = np.random.default_rng(1).normal(0.0, 1.0, (5, made_up()[1]["statistics.mean"].size)).astype(np.float32)
        return seen, acting(Path(folder), files()).law(seen)


def acting(folder, contents):
    """Return the policy loaded from a folder with files of given contents."""
    for name, content in contents.items():
        (folder / name).write_bytes(content)
    return find_agent(folder)


def mutant(random):
    """Return the files with bytes of one of them changed, or with its JSON (of arrays: the header) modified."""
    from oracles.mutants import bent, mangled

    name = (METADATA, ARRAYS)[random.integers(2)]
    content = files()[name]
    if random.integers(2) == 0:
        wrong = mangled(random, content)
    elif name == METADATA:
        wrong = json.dumps(bent(random, json.loads(content))).encode()
    else:
        start = 8 + int.from_bytes(content[:8], "little")
        header = json.dumps(bent(random, json.loads(content[8:start]))).encode()
        wrong = len(header).to_bytes(8, "little") + header + content[start:]
    return {**files(), name: wrong}


def outcome(seed, folder):
    """Return ("acts" or "refused", "") for the mutant with a seed, or ("finding", defect)."""
    try:
        policy = acting(folder, mutant(np.random.default_rng(seed)))
    except (ValueError, FileNotFoundError) as error:
        line = str(error)
        clear = "\n" not in line and str(folder) in line and len(line) < 700 and line.isprintable()
        return ("refused", "") if clear else ("finding", line)
    except Exception as error:
        return "finding", f"{type(error).__name__}: {error}"
    same = np.array_equal(policy.law(torques()[0]), torques()[1])
    same &= (
        policy.interface["base"].stiffness.tolist() == DESCRIBED.given["gains"]["stiffness"]
        and policy.interface["action_repeat"] == 5
    )
    return ("acts", "") if same else ("finding", "it acts otherwise")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        result = [(seed, *outcome(seed, Path(place))) for seed in range(int(sys.argv[1]))]
    for row in result:
        if row[1] == "finding":
            print(" | ".join(map(str, row))[:600])
    print(dict(Counter(kind for _, kind, _ in result)))
