"""Compile the kernels ahead of the first environment.

This takes about a minute of CPU time, longer on busy cores. The machine code is kept in a cache, from where later runs
load it.
"""

import argparse
import os
import subprocess
import sys
import time
from typing import Any

from flexman_gym.commands import CommandLine

KERNEL_KINDS = {"single": "a single arm", "batch": "a batch of arms"}  # suffixes of the kernels in kernels/batch.py


def _arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    parser.add_argument(
        "kind",
        nargs="?",
        choices=sorted(KERNEL_KINDS),
        help="compile only the kernels of a single arm, or of a batch (default: both)",
    )


def _run(options: argparse.Namespace) -> int:
    """Compile the kernels; return the exit status."""
    return _compile_both() if options.kind is None else _compile_kind(options.kind)


def _compile_both() -> int:
    """Compile both kinds of kernels in parallel processes; return 0, or 1 if one process fails."""
    from flexman_gym.kernels import CACHE_FOLDER

    print(f"compiling {' and '.join(KERNEL_KINDS.values())}, into {CACHE_FOLDER}", flush=True)
    started, quiet = time.perf_counter(), os.environ | {"FLEXMAN_QUIET": "1"}
    command = [sys.executable, "-m", "flexman_gym", "compile"]
    running = [
        subprocess.Popen([*command, kind], env=quiet, stderr=subprocess.PIPE, text=True) for kind in KERNEL_KINDS
    ]
    failed = 0
    for process in running:
        errors = process.communicate()[1].strip()
        if process.returncode:
            print(f"flexman: error: {errors.splitlines()[-1] if errors else process.returncode}", file=sys.stderr)
            failed = 1
    if not failed:
        print(f"ready after {time.perf_counter() - started:.1f} s")
    return failed


def _compile_kind(kind: str) -> int:
    """Compile the kernels called by environments of one kind; return 0."""
    import gymnasium as gym

    import flexman_gym  # noqa: F401  registers the environments

    started = time.perf_counter()
    env: Any = gym.make("FlexRRR-v0") if kind == "single" else gym.make_vec("FlexRRR-v0", 2, "vector_entry_point")
    env.reset(seed=0)
    env.step(env.action_space.sample())
    print(f"{KERNEL_KINDS[kind]}: {time.perf_counter() - started:.1f} s", flush=True)
    return 0


COMMAND = CommandLine(_arguments, _run)
