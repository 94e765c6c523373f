"""Command line: python -m flexman_gym compile | check. What a command runs is imported when it runs."""

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

KINDS = {"one": "one arm alone", "abreast": "arms abreast"}  # how arms are moved: kernels/arms.py
KERNELS = {"one": "advance_one", "abreast": "advance_arms"}
PACKAGES = ("gymnasium", "torch", "stable-baselines3")
STEPS = 500


def main(arguments: list[str] | None = None) -> int:
    """Runs a command and returns the exit status."""
    parser = argparse.ArgumentParser(prog="flexman", description="Robot arms that bend, as Gymnasium environments.")
    commands = parser.add_subparsers(dest="command", required=True, metavar="command")
    ahead = commands.add_parser("compile", help="compile the kernels ahead of the first environment")
    ahead.add_argument("kind", nargs="?", choices=sorted(KINDS), help="only those of one arm, or of arms abreast")
    commands.add_parser("check", help="say versions, processor and cache folder, and step an environment")
    options = parser.parse_args(arguments)
    if options.command == "check":
        return check()
    return compile_both() if options.kind is None else compile_kind(options.kind)


def compile_both() -> int:
    """Compiles both kinds of kernels at once, each in a process of its own, and returns 0, or 1 where one fails."""
    from flexman_gym.kernels import FOLDER

    print(f"compiling {' and '.join(KINDS.values())}, into {FOLDER}", flush=True)
    started, quiet = time.perf_counter(), os.environ | {"FLEXMAN_QUIET": "1"}
    command = [sys.executable, "-m", "flexman_gym", "compile"]
    running = [subprocess.Popen([*command, kind], env=quiet, stderr=subprocess.PIPE, text=True) for kind in KINDS]
    failed = 0
    for process in running:
        words = process.communicate()[1].strip()
        if process.returncode:
            print(f"flexman: error: {words.splitlines()[-1] if words else process.returncode}", file=sys.stderr)
            failed = 1
    if not failed:
        print(f"ready after {time.perf_counter() - started:.1f} s")
    return failed


def compile_kind(kind: str) -> int:
    """Compiles what the environments of one kind call."""
    import gymnasium as gym

    import flexman_gym  # noqa: F401  registers the environments

    started = time.perf_counter()
    env: Any = gym.make("FlexRRR-v0") if kind == "one" else gym.make_vec("FlexRRR-v0", 2, "vector_entry_point")
    env.reset(seed=0)
    env.step(env.action_space.sample())
    print(f"{KINDS[kind]}: {time.perf_counter() - started:.1f} s", flush=True)
    return 0


def check() -> int:
    """Says what a report of a problem needs, and steps an environment."""
    from flexman_gym.kernels import FOLDER
    from flexman_gym.studies.machine import machine

    for name, value in (machine(PACKAGES) | {"vector registers": f"{vector_bits()} bits"}).items():
        print(f"{name}: {value}")
    print(f"cache folder: {FOLDER or 'none that is yours alone can be written'}")
    for kind, words in KINDS.items():
        there = FOLDER is not None and any(Path(FOLDER).rglob(f"*{KERNELS[kind]}*.nbc"))
        print(f"kernels of {words}: {'compiled' if there else 'not compiled yet'}", flush=True)
    print(f"steps of FlexRRR-v0: {steps_a_second():,.0f} a second")
    return 0


def vector_bits() -> int:
    """The width of the widest vector registers that the compiler finds."""
    from llvmlite import binding

    features = binding.get_host_cpu_features()
    return next((bits for name, bits in (("avx512f", 512), ("avx", 256)) if features.get(name)), 128)


def steps_a_second() -> float:
    """Steps of one environment under random actions, by the clock."""
    import gymnasium as gym

    import flexman_gym  # noqa: F401  registers the environments

    env = gym.make("FlexRRR-v0")
    env.reset(seed=0)
    env.action_space.seed(0)
    env.step(env.action_space.sample())  # compiles what is not on disk
    started = time.perf_counter()
    for _ in range(STEPS):
        *_, terminated, truncated, _ = env.step(env.action_space.sample())
        if terminated or truncated:
            env.reset()
    return STEPS / (time.perf_counter() - started)


if __name__ == "__main__":
    sys.exit(main())
