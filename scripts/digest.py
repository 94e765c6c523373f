"""Print hashes of simulation results to compare two versions bit by bit: python scripts/digest.py [other checkout]"""

import argparse
import contextlib
import hashlib
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

STEPS, SEEDS, ARMS = 1000, (0, 1, 2), (1, 3, 64, 136)
MODES = ((0, 1, 2, 3, 4, 6), (0, 1, 2, 3, 4, 5, 8), (0, 1, 2))
CONDITIONS = ("nominal", "delay", "friction", "payload", "random-delay", "stiffness", "uncertain", "unknown",
              "unknown-lab", "unmodelled")  # fmt: skip
LAB = "FlexRRR-v0/unknown-lab"
AGENTS = dict.fromkeys(("pd-torque", "lqr", "lqr-tracking", "lqg", "hinf", "mpc", "adaptive-lqr", "privileged-lqr",
                             "pd-shaped", "lab-flexrrr"), LAB)  # fmt: skip
AGENTS |= dict.fromkeys(("optimised", "ppo-flexrrr", "sac-flexrrr", "shaping-flexrrr"), "FlexRRR-v0")
AGENTS["ppo-flexplanar"] = "FlexPlanar-v0"
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


def pairs() -> list[tuple[str, str]]:
    """Return agent and environment of the episodes: two agents everywhere, and each agent where it is compared."""
    import gymnasium as gym

    import flexman_gym  # noqa: F401  registers the environments

    places = []
    for id in (name for name in gym.registry if name.startswith("Flex")):
        for condition in CONDITIONS:
            with contextlib.suppress(ValueError):  # the environment lacks this condition
                gym.make(id, condition=condition).close()
                places.append(id if condition == "nominal" else f"{id}/{condition}")
    usual = [(agent, place) for place in places for agent in ("zero", "pd")]
    return [*usual, *AGENTS.items()]


def episodes(agent: str, environment: str, count: int) -> str:
    """Return the digest of the first test episodes of an agent: states, torques, readings and rewards."""
    import flexman_gym as fm

    record = fm.rollout(agent, environment, seeds=count)
    digest = hashlib.sha256()
    for name in ("tips", "errors", "states", "targets", "actions", "torques", "rewards", "readings", "lengths"):
        update(digest, {name: getattr(record, name)})
    update(digest, record.failures)
    return digest.hexdigest()


def digests(count: int) -> dict[str, str]:
    """Return all digests by description, with this number of episodes of each pair of agent and environment."""
    import flexman_gym as fm

    result = {f"simulate, {name}": trajectory(name) for name in fm.METHODS}
    result |= {f"gym.make, seed {seed}": single(seed) for seed in SEEDS}
    for arms in ARMS:
        for seed in SEEDS:
            mode = ("NextStep", "SameStep", "NextStep")[seed % 3]
            result[f"make_vec, {arms} arms, seed {seed}, {mode}"] = vector(arms, seed, mode)
    if count:
        result |= {f"rollout, {agent}, {place}": episodes(agent, place, count) for agent, place in pairs()}
    return result


def main() -> int:
    """Print the digests, or compare them with another checkout; return 1 if any differ."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("other", nargs="?", type=Path, help="checkout with which the digests are compared")
    parser.add_argument("--episodes", type=int, default=3, help="episodes of each agent; 0 for none (default: 3)")
    options = parser.parse_args()
    if options.other is None:
        print("\n".join(f"{value[:16]}  {name}" for name, value in digests(options.episodes).items()))
        return 0
    runs = []
    for folder in (Path(__file__).parents[1], options.other.resolve()):
        environment = os.environ | {"PYTHONPATH": str(folder)}
        command = [sys.executable, __file__, "--episodes", str(options.episodes)]
        done = subprocess.run(command, capture_output=True, text=True, env=environment, check=True)
        runs.append({line.split("  ")[1]: line.split("  ")[0] for line in done.stdout.splitlines()})
    mine, other = runs
    both = [name for name in mine if name in other]
    different = [name for name in both if mine[name] != other[name]]
    print(f"{len(both) - len(different)} of {len(both)} digests are equal", *different, sep="\n")
    return int(bool(different) or not both)


if __name__ == "__main__":
    sys.exit(main())
