"""Compile the kernels ahead of the first environment.

The processes take about a minute of CPU time, longer on busy cores. The
machine code is kept in a cache, from where later runs load it.
"""

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from flexman_gym.commands import CommandLine
from flexman_gym.common.errors import suggestion


def _arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    from flexman_gym.kernels.first_use import JOBS

    names = ", ".join(JOBS)
    parser.add_argument("job", nargs="*", help=f"compile only some kernels, in this process: {names} (default: all)")
    parser.add_argument("--count", action="store_true", help=argparse.SUPPRESS)  # a line for each compiled function


def _run(options: argparse.Namespace) -> int:
    """Compile the kernels; return the exit status."""
    from flexman_gym.kernels.first_use import JOBS, count_functions

    if options.count:
        count_functions()
    for job in options.job:
        if job not in JOBS:
            options.parser.error(f"job: {job} is not allowed; give some of {', '.join(JOBS)}{suggestion(job, JOBS)}")
        USES[job]()
    return 0 if options.job else _compile_all()


def _compile_all() -> int:
    """Compile all kernels of the first use, or find them; return 0, or 1 if a process fails."""
    from flexman_gym.kernels import CACHE_FOLDER, machine_code
    from flexman_gym.kernels.first_use import JOBS, compile_first_use

    if machine_code.LEVEL is not None:
        print(f"nothing to compile: this installation brings machine code for {machine_code.LEVEL}")
        return 0
    if CACHE_FOLDER is None:
        print("flexman: error: no private cache folder can be written; set NUMBA_CACHE_DIR to one", file=sys.stderr)
        return 1
    purposes = ", ".join(JOBS.values())
    print(f"compiling kernels for {purposes}, into {CACHE_FOLDER}", flush=True)
    started = time.perf_counter()
    error = compile_first_use(CACHE_FOLDER)
    if error:
        print(f"flexman: error: {error}", file=sys.stderr)
        return 1
    print(f"ready after {time.perf_counter() - started:.1f} s")
    return 0


def _step_environment(maker: str, *given: Any) -> None:
    """Make an environment, or a vector environment, and step it."""
    import gymnasium as gym

    import flexman_gym  # noqa: F401  registers the environments

    env: Any = getattr(gym, maker)("FlexRRR-v0", *given)
    env.reset(seed=0)
    env.step(env.action_space.sample())


def _linearize() -> None:
    """Linearise an arm, and compute the forces that hold it."""
    import numpy as np

    import flexman_gym as fm
    from flexman_gym.model.dynamics import elastic_forces

    model = fm.build_model(fm.catalog.paper_scene("rr").arm)
    fm.linearize(model)
    elastic_forces(model, np.zeros(model.n_dof))


def _simulate() -> None:
    """Simulate a scene."""
    import flexman_gym as fm

    fm.simulate(replace(fm.catalog.paper_scene("rr"), duration=0.01))


USES: dict[str, Callable[[], None]] = {  # job of `first_use` -> function that uses its kernels
    "single": lambda: _step_environment("make"),
    "batch": lambda: _step_environment("make_vec", 2, "vector_entry_point"),
    "control": _linearize,
    "simulation": _simulate,
}
EXAMPLES = (
    "flexman compile  # all kernels, once",
    "flexman compile simulation  # those of flexman simulate",
)
COMMAND = CommandLine(_arguments, _run, EXAMPLES)
