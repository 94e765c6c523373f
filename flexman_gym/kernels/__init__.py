"""Compiled kernels. Their machine code is kept on disk, see `cache`.

While kernels compile, lines on stderr say so; FLEXMAN_QUIET=1 silences them.
"""

import sys
from typing import Any

import numba
from numba.core import event

from flexman_gym.kernels.cache import find_cache_folder, is_quiet

# Seconds of a processor of 2024 from the start of each until it is done; of the first ones of an environment, until
# this can take its first step. The others take less than two.
COMPILE_SECONDS = {
    "inertial_forces": 25, "advance_single": 17, "advance_batch": 20, "tip_accelerations_single": 6,
    "tip_accelerations_batch": 6, "run_batch": 16, "run_extrapolation": 18, "run_fixed_newton": 11,
    "run_linearly_implicit": 6, "run_explicit": 5, "run_implicit": 5,
}  # fmt: skip


class _CompileMessages(event.Listener):
    """Says which kernel compiles and how long it takes; Numba tells of that, and not of those that it loads."""

    def __init__(self) -> None:
        self._said, self._depth = False, 0

    def on_start(self, event: Any) -> None:
        """Before Numba compiles something, which need not be ours."""
        function = event.data["dispatcher"].py_func
        self._depth += 1
        if is_quiet() or self._depth > 1 or not function.__module__.startswith(f"{__name__}."):
            return
        if not self._said:
            kept = f"each only once: they are kept in {CACHE_FOLDER}"
            if CACHE_FOLDER is None:
                kept = "in every process: no folder that is yours alone can be written; set NUMBA_CACHE_DIR to one"
            print(f"flexman_gym compiles kernels, {kept} (FLEXMAN_QUIET=1 silences this)", file=sys.stderr)
            self._said = True
        if left := COMPILE_SECONDS.get(function.__name__):
            print(f"  {function.__name__}: about {left} s left", file=sys.stderr, flush=True)

    def on_end(self, event: Any) -> None:
        """After it."""
        self._depth -= 1


if numba.config.DISABLE_JIT:
    raise ImportError("NUMBA_DISABLE_JIT: 1 is not allowed; give 0 or nothing: these kernels run compiled only")

CACHE_FOLDER = find_cache_folder()
event.register("numba:compile", _CompileMessages())

# Numba reads the setting when a kernel is decorated; it is put back so that other packages keep theirs.
_setting = numba.config.CACHE_DIR
numba.config.CACHE_DIR = CACHE_FOLDER or ""
try:
    from flexman_gym.kernels import (
        arguments,
        batch,
        compile,
        control_period,
        dynamics,
        forces,
        implicit,
        inverse,
        kinematics,
        lanes,
        layout,
        linalg,
        outputs,
        raster,
        rigid_arm,
        runge_kutta,
        thread_sync,
    )
finally:
    numba.config.CACHE_DIR = _setting

__all__ = [
    "arguments",
    "batch",
    "compile",
    "control_period",
    "dynamics",
    "forces",
    "implicit",
    "inverse",
    "kinematics",
    "lanes",
    "layout",
    "linalg",
    "outputs",
    "raster",
    "rigid_arm",
    "runge_kutta",
    "thread_sync",
]
