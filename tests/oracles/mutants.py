"""Files of scenes, environments, recipes and policies with random defects, each read or rejected.

`PYTHONPATH=tests python -m oracles.mutants 2000` reads 2000 files and prints the findings with their seeds.
"""

import io
import json
import re
import sys
import tempfile
import warnings
from collections import Counter
from functools import cache
from pathlib import Path

import numpy as np
import yaml

import flexman_gym as fm
from flexman_agents.settings import Settings
from flexman_gym.envs.config.configuration import Configuration

from oracles.files import ROOT
from oracles.fuzz import TooLong, bounded, loud
from oracles.fuzz_targets import ARM, CHOICE, DESCRIBED, SCENE, TRAINING, TWO
from oracles.odd_values import KEYS, odd
from oracles.runs import RUNS

LONGEST = 450  # characters of a line beside the path of the file
TOKENS = (b"null", b"true", b"-1", b"1e999", b"1e-999", b"nan", b".inf", b"'x'", b"{", b"]", b"\t", b"\xff", b"\x00",
          b"9" * 400, b"- ", b": ", b"&a ", b"*a", b"!!python/object", b"\n", b"[" * 2000, b"10000000000")  # fmt: skip
SINE = fm.SineTorque([0.1, 0.0], [1.0, 2.0], TWO)
PUSHED = fm.Scene(
    fm.Arm([fm.NonUniformLink([ARM.links[0]] * 2), ARM.links[1]], ARM.joints, fm.Payload(0.1, np.eye(3).tolist())),
    CHOICE, SINE, SCENE.initial, 1.0, 0.1, "pushed", [None, None], [fm.Signal(1.0)] * 3, [fm.Signal(0.0, 1.0, 2.0)] * 3,
)  # fmt: skip
TREES = {
    "scene.yaml": PUSHED.to_dict(), "scene.json": SCENE.to_dict(), "environment.yaml": DESCRIBED,
    "recipe.yaml": TRAINING,
    "environment.json": {**DESCRIBED, "arm": SCENE.to_dict()["arm"], "gains": {"stiffness": [1, 1], "damping": [1, 1]}},
}  # fmt: skip
TEXTS = {
    "environment.yaml": [*sorted((ROOT / "flexman_gym/envs/conditions").rglob("*.yaml")),
                         ROOT / "docs/examples/planar_payload.yaml"],
    "recipe.yaml": sorted((ROOT / "agents/recipes").glob("*.yaml")),
    "scene.yaml": sorted((ROOT / "docs/examples").glob("paper*.yaml")),
}  # fmt: skip


@cache
def policy():
    """Return the files of an untrained policy."""
    from flexman_agents.sb3 import make_model
    from flexman_agents.training import policy_state
    from flexman_gym.common.run_folder import NEWEST, SETTINGS, write_npz

    settings = RUNS["ppo"]
    with tempfile.TemporaryDirectory() as folder:
        write_npz(Path(folder) / NEWEST, policy_state(make_model(settings)) | {"settings": settings.plain()})
        newest = (Path(folder) / NEWEST).read_bytes()
    return {SETTINGS: json.dumps(settings.plain(), indent=1).encode(), NEWEST: newest}


def read_policy(folder):
    """Return the action of the policy of a folder for zero observations."""
    from flexman_gym.evaluation.agents import find_agent

    network = find_agent(folder).law
    size = len(np.load(io.BytesIO(policy()["newest.npz"]))["/statistics/mean"])
    return network(np.zeros((1, size), np.float32))


READERS = {"scene": fm.Scene.load, "environment": Configuration.load, "recipe": Settings.recipe}


def mangled(random, content):
    """Return bytes with a piece removed, doubled, overwritten, exchanged or inserted."""
    first, last = np.sort(random.integers(0, len(content) + 1, 2))
    token = TOKENS[random.integers(len(TOKENS))]
    kind = random.integers(8)
    if kind == 0:
        return content[:first]
    if kind == 1:
        return content[:first] + content[min(last, first + 40) :]
    if kind == 2:
        return content[:last] + content[first:last] + content[last:]
    if kind == 3:
        return content[:first] + token + content[first:]
    if kind == 4:
        return content[:first] + random.bytes(random.integers(1, 9)) + content[first + 1 :]
    if kind == 5:
        numbers = [each.span() for each in re.finditer(rb"\d[\d.e+-]*", content)] or [(0, 0)]
        start, end = numbers[random.integers(len(numbers))]
        return content[:start] + token + content[end:]
    lines = content.splitlines(keepends=True) or [b""]
    one, other = random.integers(len(lines), size=2)
    lines[one], lines[other] = lines[other], (lines[one] if kind == 6 else lines[other])
    return b"".join(lines)


def plain(value):
    """Return an odd value that a file can contain."""
    try:
        return json.loads(json.dumps(np.asarray(value).tolist() if isinstance(value, np.ndarray) else value))
    except Exception:
        return str(type(value))


def bent(random, tree):
    """Return a tree with a node changed, removed, renamed, moved or duplicated."""
    if isinstance(tree, dict) and tree:
        some, name = dict(tree), list(tree)[random.integers(len(tree))]
    elif isinstance(tree, list) and tree:
        some, name = list(tree), int(random.integers(len(tree)))
    else:
        return plain(odd(random, tree))
    kind = random.integers(8)
    if kind == 0:
        del some[name]
    elif kind == 1 and isinstance(some, dict):
        some[plain(KEYS[random.integers(len(KEYS) - 1)])] = some.pop(name)
    elif kind == 2:
        other = list(some)[random.integers(len(some))] if isinstance(some, dict) else int(random.integers(len(some)))
        some[name], some[other] = some[other], some[name]
    elif kind == 3:
        return [some]
    else:
        some[name] = bent(random, some[name])
    return some


def written(tree, suffix):
    """Return the bytes of a tree."""
    if suffix == ".json":
        return json.dumps(tree).encode()
    return yaml.safe_dump(tree, sort_keys=False).encode()


def arrays_bent(random, content):
    """Return a file of arrays with one array changed, removed or renamed."""
    with np.load(io.BytesIO(content)) as result:
        arrays = {name: result[name] for name in result.files}
    name = list(arrays)[random.integers(len(arrays))]
    kind = random.integers(6)
    if kind == 0:
        del arrays[name]
    elif kind > 3 and arrays[name].dtype.kind == "f":
        arrays[name] = arrays[name].copy()
        arrays[name].flat[random.integers(arrays[name].size)] = (np.nan, np.inf, 1e30, -1e-30)[random.integers(4)]
    elif kind == 1:
        arrays[name + "x"] = arrays.pop(name)
    else:
        value = odd(random, arrays[name])
        arrays[name] = (
            value if isinstance(value, np.ndarray) and value.dtype != object else np.array(plain(value), dtype=str)
        )
    if random.integers(4) == 0 and "data.json" in arrays:
        tree = json.loads(arrays["data.json"].tobytes()) if arrays["data.json"].dtype == np.uint8 else {}
        arrays["data.json"] = np.frombuffer(json.dumps(bent(random, tree)).encode(), dtype=np.uint8)
    out = io.BytesIO()
    np.savez(out, **arrays)
    return out.getvalue()


def mutant(random, folder):
    """Write a defective file or policy; return its reader and its path."""
    if random.integers(3) == 0:
        files = policy()
        name = list(files)[random.integers(2)]
        wrong = files[name]
        if random.integers(2) == 0:
            wrong = mangled(random, wrong)
        elif name.endswith(".npz"):
            wrong = arrays_bent(random, wrong)
        else:
            wrong = json.dumps(bent(random, json.loads(wrong))).encode()
        for each, content in {**files, name: wrong}.items():
            (folder / each).write_bytes(content)
        return read_policy, folder
    name = list(TREES)[random.integers(len(TREES))]
    path = folder / name
    if name in TEXTS and random.integers(3) == 0:
        content = TEXTS[name][random.integers(len(TEXTS[name]))].read_bytes()
        path.write_bytes(mangled(random, content))
    elif random.integers(3) == 0:
        path.write_bytes(mangled(random, written(plain(TREES[name]), path.suffix)))
    else:
        path.write_bytes(written(bent(random, plain(TREES[name])), path.suffix))
    return READERS[path.stem], path


def outcome(seed, folder):
    """Return ("read" or "refused", "") for the mutant with a seed, or ("finding", defect)."""
    read, path = mutant(np.random.default_rng(seed), folder)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            with bounded():
                result = read(path)
        except (ValueError, FileNotFoundError) as error:
            line = str(error)
            short = len(line) - len(str(path)) < LONGEST
            clear = str(path) in line and "\n" not in line and short and line.isprintable()
            return ("refused", "") if clear and not loud(said) else ("finding", f"{type(error).__name__}: {line}")
        except TooLong:
            return "finding", "took too long"
        except Exception as error:
            return "finding", f"{type(error).__name__}: {error}"
    if isinstance(result, np.ndarray) and not np.isfinite(result).all():
        return "finding", "acts by what is no number"
    return ("finding", loud(said)) if loud(said) else ("read", "")


def run(count, first=0):
    """Read mutants from a seed on; return outcome counts and findings (seed, name, defect)."""
    outcomes, findings = Counter(), []
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(first, first + count):
            kind, what = outcome(seed, Path(folder))
            outcomes[kind] += 1
            if kind == "finding":
                findings.append((seed, what))
    return outcomes, findings


if __name__ == "__main__":
    total, result = run(*(int(each) for each in sys.argv[1:3]))
    for row in result:
        print(" | ".join(map(str, row))[:600].replace("\n", "\\n"))
    print(dict(total))
