"""Print hashes of simulation results to compare two versions bit by bit: python scripts/digest.py [other checkout]"""

import hashlib
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

STEPS, SEEDS, ARMS = 1000, (0, 1, 2), (1, 3, 64, 136)
MODES = ((0, 1, 2, 3, 4, 6), (0, 1, 2, 3, 4, 5, 8), (0, 1, 2))
FIDELITY: dict[str, Any] = {"modes": MODES, "method": "ros2", "step": 0.005}


def update(digest: Any, value: Any) -> None:
    """Add a value to a digest: arrays and numbers by their bits, dicts by sorted keys, strings as they are."""
    if isinstance(value, dict):
        for key in sorted(value):
            digest.update(key.encode())
            update(digest, value[key])
    elif isinstance(value, tuple | list) or (isinstance(value, np.ndarray) and value.dtype == object):
        for item in value:
            update(digest, item)
    elif isinstance(value, str) or value is None:
        digest.update(str(value).encode())
    else:
        digest.update(np.ascontiguousarray(value).tobytes())


def single(seed: int) -> str:
    """Return the digest of 1000 random steps of a single environment."""
    import gymnasium as gym

    import flexman_gym  # noqa: F401  registers the environments

    env, digest, random = gym.make("FlexRRR-v0", **FIDELITY), hashlib.sha256(), np.random.default_rng(seed)
    update(digest, env.reset(seed=seed))
    for _ in range(STEPS):
        outcome = env.step(random.uniform(-1.0, 1.0, 3).astype(np.float32))
        update(digest, outcome)
        if outcome[2] or outcome[3]:
            update(digest, env.reset())
    return digest.hexdigest()


def vector(arms: int, seed: int, mode: str) -> str:
    """Return the digest of 1000 random steps of a vector environment."""
    import gymnasium as gym

    import flexman_gym  # noqa: F401  registers the environments

    env = gym.make_vec("FlexRRR-v0", arms, "vector_entry_point", autoreset_mode=mode, **FIDELITY)
    digest, random = hashlib.sha256(), np.random.default_rng(seed)
    update(digest, env.reset(seed=seed))
    for _ in range(STEPS):
        update(digest, env.step(random.uniform(-1.0, 1.0, (arms, 3)).astype(np.float32)))
    return digest.hexdigest()


def trajectory(name: str) -> str:
    """Return the digest of 0.2 s of the paper's flexible arm, simulated with one method."""
    from dataclasses import replace

    import flexman_gym as fm

    scene = replace(fm.catalog.paper_scene("ff"), duration=0.2)
    step = {"explicit": 2e-5}.get(fm.METHODS[name].kind, None if fm.METHODS[name].kind == "reference" else 0.005)
    digest, result = hashlib.sha256(), fm.simulate(scene, method=name, step=step)
    update(digest, {"states": result.states, "tip": result.tip, "energy": result.energy, "work": result.work})
    update(digest, {"status": result.status, "evaluations": result.evaluations})
    return digest.hexdigest()


def digests() -> dict[str, str]:
    """Return all digests by description."""
    import flexman_gym as fm

    result = {f"simulate, {name}": trajectory(name) for name in fm.METHODS}
    result |= {f"gym.make, seed {seed}": single(seed) for seed in SEEDS}
    for arms in ARMS:
        for seed in SEEDS:
            mode = ("NextStep", "SameStep", "NextStep")[seed % 3]
            result[f"make_vec, {arms} arms, seed {seed}, {mode}"] = vector(arms, seed, mode)
    return result


def main() -> int:
    """Print the digests, or compare them with another checkout; return 1 if any differ."""
    if len(sys.argv) == 1:
        print("\n".join(f"{value[:16]}  {name}" for name, value in digests().items()))
        return 0
    runs = []
    for folder in (Path(__file__).parents[1], Path(sys.argv[1])):
        environment = os.environ | {"PYTHONPATH": str(folder)}
        done = subprocess.run([sys.executable, __file__], capture_output=True, text=True, env=environment, check=True)
        runs.append({line.split("  ")[1]: line.split("  ")[0] for line in done.stdout.splitlines()})
    mine, other = runs
    both = [name for name in mine if name in other]
    different = [name for name in both if mine[name] != other[name]]
    print(f"{len(both) - len(different)} of {len(both)} digests are equal", *different, sep="\n")
    return int(bool(different) or not both)


if __name__ == "__main__":
    sys.exit(main())
