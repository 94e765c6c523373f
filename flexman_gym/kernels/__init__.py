"""The compiled rooms. Their binaries are cached in a folder whose name is a hash of these sources.

Numba checks only the file of a kernel, not the files of the kernels it calls, so a shared folder would serve stale
binaries after an edit. `NUMBA_CACHE_DIR`, `XDG_CACHE_HOME` and, where the home cannot be written, the temporary folder
are respected in this order. While kernels compile, one line on stderr says so; FLEXMAN_QUIET=1 silences it.
"""

import hashlib
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

import numba
from numba.core import event


def _source_hash() -> str:
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


def _cache_folder() -> str:
    home = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    for parent in (home, os.path.join(tempfile.gettempdir(), f"user-{getattr(os, 'getuid', int)()}")):
        folder = os.path.join(parent, "flexman_gym", _source_hash())
        try:
            os.makedirs(folder, exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            return folder
    raise OSError(f"no folder for compiled kernels can be written: set NUMBA_CACHE_DIR (tried {home})")


class _Words(event.Listener):
    """Says once in a process that kernels compile; Numba tells of that, and not of those that it loads from disk."""

    def __init__(self) -> None:
        self._said = os.environ.get("FLEXMAN_QUIET", "0") not in ("", "0")

    def on_start(self, event: Any) -> None:
        """Before Numba compiles something, which need not be ours."""
        if self._said or not event.data["dispatcher"].py_func.__module__.startswith(f"{__name__}."):
            return
        self._said = True
        print(
            "flexman_gym compiles its kernels, for up to a minute, and only once:"
            f" they are kept in {FOLDER} (FLEXMAN_QUIET=1 silences this line)",
            file=sys.stderr,
            flush=True,
        )

    def on_end(self, event: Any) -> None:
        """Nothing is left to say."""


FOLDER = _cache_folder()
event.register("numba:compile", _Words())

# Numba reads the setting when a kernel is decorated; it is put back so that other packages keep theirs.
_setting = numba.config.CACHE_DIR
numba.config.CACHE_DIR = FOLDER
try:
    from flexman_gym.kernels import (
        arms,
        compile,
        dynamics,
        elastic,
        explicit,
        forces,
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
        stages,
        stiffening,
    )
finally:
    numba.config.CACHE_DIR = _setting

__all__ = [
    "arms",
    "compile",
    "dynamics",
    "elastic",
    "explicit",
    "forces",
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
    "stages",
    "stiffening",
]
