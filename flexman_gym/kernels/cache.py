"""Cache folder of compiled kernels.

The name of the folder is a hash of the sources of all kernels and of the Numba settings that affect the code: Numba
itself checks only the file of a kernel, not the files of the kernels it calls. The folder is created in
`NUMBA_CACHE_DIR`, else in `XDG_CACHE_HOME`, else in `~/.cache`. If the home folder is not writable, it is created in
the temporary folder, with a message on stderr.

The cached files are pickles, which can execute any code when they are read. They are read only from a folder that
belongs to the user and that nobody else can write to; a folder that was open to others is emptied first.
"""

import hashlib
import os
import re
import shutil
import stat
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numba

FOLDER_NAME = re.compile("[0-9a-f]{16}")  # names of cache folders, see `_folder_name`
CODE_SETTINGS = ("BOUNDSCHECK", "CPU_NAME", "CPU_FEATURES", "OPT", "ENABLE_AVX", "LOOP_VECTORIZE", "SLP_VECTORIZE")


def find_cache_folder() -> str | None:
    """Find or create the folder for the present kernels and Numba settings; None if no safe folder is writable."""
    for place, strict in _candidates():
        parent = place / "flexman_gym"
        folder = parent / _folder_name()
        try:
            place.mkdir(mode=0o700 if strict else 0o777, parents=True, exist_ok=True)
            parent.mkdir(mode=0o700, exist_ok=True)
            safe = all(_is_private(each, strict) for each in ([place, parent] if strict else [parent]))
            new = safe and not folder.exists()
            if safe:
                folder.mkdir(mode=0o700, exist_ok=True)
                safe = _is_private(folder, strict)
        except OSError:
            continue
        if safe and os.access(folder, os.W_OK):
            if strict and new and not is_quiet():
                print(f"flexman_gym caches compiled kernels in {folder}, as no cache can be written in the home "
                      "(NUMBA_CACHE_DIR names another folder)", file=sys.stderr)  # fmt: skip
            return str(folder)
    return None


def is_quiet() -> bool:
    """Return True if the environment variable FLEXMAN_QUIET silences messages on stderr."""
    return os.environ.get("FLEXMAN_QUIET", "0") not in ("", "0")


def _candidates() -> Iterator[tuple[Path, bool]]:
    """Yield parent folders in order of preference, each with True if others can write to the folder above it."""
    chosen, home = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME"), Path(os.path.expanduser("~"))
    if chosen:
        yield Path(chosen), False
    elif home.is_dir():  # a missing home folder is not created
        yield home / ".cache", False
    yield Path(tempfile.gettempdir()) / f"user-{os.getuid()}", True


def _is_private(folder: Path, strict: bool) -> bool:
    """Return True if a folder belongs to the user and no other user can write to it.

    If other users can write to it, a strict check returns False. Otherwise their permission is removed and the cache
    folders in it are deleted, recognised by their names; other files stay and are not read.
    """
    result = folder.lstat() if strict else folder.stat()
    if not stat.S_ISDIR(result.st_mode) or result.st_uid != os.getuid():
        return False
    if result.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        if strict:
            return False
        folder.chmod(0o700)
        for kernels in [folder] if FOLDER_NAME.fullmatch(folder.name) else list(folder.iterdir()):
            if FOLDER_NAME.fullmatch(kernels.name):
                kernels.unlink() if kernels.is_symlink() else shutil.rmtree(kernels)
        folder.mkdir(mode=0o700, exist_ok=True)
        if not is_quiet():
            print(f"flexman_gym: others could write to {folder}; kernels there are compiled anew", file=sys.stderr)
    return True


def digest_sources() -> str:
    """Return the SHA-256 of the kernels' sources, in hexadecimal digits."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


def _folder_name() -> str:
    """Return the hash of the kernels' sources and of the Numba settings that affect the code."""
    settings = (f"{name}={getattr(numba.config, name, None)}" for name in CODE_SETTINGS)
    return hashlib.sha256("\0".join([digest_sources(), *settings]).encode()).hexdigest()[:16]
