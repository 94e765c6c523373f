"""The compiled rooms. Their code is kept on disk, see `cache`.

While kernels compile, one line on stderr says so; FLEXMAN_QUIET=1 silences it.
"""

import sys
from typing import Any

import numba
from numba.core import event

from flexman_gym.kernels.cache import find_folder, quiet


class _Words(event.Listener):
    """Says once in a process that kernels compile; Numba tells of that, and not of those that it loads from disk."""

    def __init__(self) -> None:
        self._said = quiet()

    def on_start(self, event: Any) -> None:
        """Before Numba compiles something, which need not be ours."""
        if self._said or not event.data["dispatcher"].py_func.__module__.startswith(f"{__name__}."):
            return
        self._said = True
        kept = f"only once: they are kept in {FOLDER}"
        if FOLDER is None:
            kept = "in every process: no folder that is yours alone can be written; set NUMBA_CACHE_DIR to one"
        text = f"flexman_gym compiles its kernels, for up to a minute, and {kept} (FLEXMAN_QUIET=1 silences this line)"
        print(text, file=sys.stderr, flush=True)

    def on_end(self, event: Any) -> None:
        """Nothing is left to say."""


if numba.config.DISABLE_JIT:
    raise ImportError("NUMBA_DISABLE_JIT: 1 is not allowed; give 0 or nothing: these kernels run compiled only")

FOLDER = find_folder()
event.register("numba:compile", _Words())

# Numba reads the setting when a kernel is decorated; it is put back so that other packages keep theirs.
_setting = numba.config.CACHE_DIR
numba.config.CACHE_DIR = FOLDER or ""
try:
    from flexman_gym.kernels import (
        arms,
        compile,
        dynamics,
        elastic,
        explicit,
        fields,
        forces,
        gauss,
        groups,
        implicit,
        inverse,
        joints,
        kinematics,
        lanes,
        layout,
        linalg,
        linearly_implicit,
        midpoint,
        outputs,
        pace,
        parts,
        paths,
        readings,
        stages,
        statics,
        stiffening,
        sweeps,
        tip,
        turning,
    )
finally:
    numba.config.CACHE_DIR = _setting

__all__ = [
    "arms",
    "compile",
    "dynamics",
    "elastic",
    "explicit",
    "fields",
    "forces",
    "gauss",
    "groups",
    "implicit",
    "inverse",
    "joints",
    "kinematics",
    "lanes",
    "layout",
    "linalg",
    "linearly_implicit",
    "midpoint",
    "outputs",
    "pace",
    "parts",
    "paths",
    "readings",
    "stages",
    "statics",
    "stiffening",
    "sweeps",
    "tip",
    "turning",
]
