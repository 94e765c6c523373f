"""Cache: where compiled kernels are kept, in files that are known by their digest.

The folder is named by a hash of the sources of all kernels, as Numba checks only the file of a kernel and not those of
the kernels that it calls, and by the settings of Numba that change the code. `NUMBA_CACHE_DIR`, `XDG_CACHE_HOME` and,
where the home cannot be written, the temporary folder are respected in this order; one line on stderr says so when a
folder is made in the last.

The files are pickles of Numba, which can run any code when they are read. They are read only from a folder that belongs
to the user and in which nobody else may write or could have written: kernels in one that was open go. What is
damaged is compiled anew; what cannot be written is not kept.
"""

import hashlib
import os
import pickle
import re
import shutil
import stat
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numba
from numba.core.caching import FunctionCache, IndexDataCacheFile

FOLDER_NAME = re.compile("[0-9a-f]{16}")  # of a folder of kernels
DIGEST_SIZE = hashlib.sha256().digest_size  # bytes in front of a file
CODE_SETTINGS = ("BOUNDSCHECK", "CPU_NAME", "CPU_FEATURES", "OPT", "ENABLE_AVX", "LOOP_VECTORIZE", "SLP_VECTORIZE")


def find_cache_folder() -> str | None:
    """Makes the folder of these kernels and these settings, or finds it; None where none is safe and can be written."""
    for place, strict in _places():
        ours = place / "flexman_gym"
        folder = ours / _name()
        try:
            place.mkdir(mode=0o700 if strict else 0o777, parents=True, exist_ok=True)
            ours.mkdir(mode=0o700, exist_ok=True)
            safe = all(_belongs_to_us(each, strict) for each in ([place, ours] if strict else [ours]))
            new = safe and not folder.exists()
            if safe:
                folder.mkdir(mode=0o700, exist_ok=True)
                safe = _belongs_to_us(folder, strict)
        except OSError:
            continue
        if safe and os.access(folder, os.W_OK):
            if strict and new and not is_quiet():
                print(f"flexman_gym keeps compiled kernels in {folder}, as no cache can be written in the home "
                      "(NUMBA_CACHE_DIR names another folder)", file=sys.stderr)  # fmt: skip
            return str(folder)
    return None


def is_quiet() -> bool:
    """Whether the environment variable FLEXMAN_QUIET silences lines on stderr."""
    return os.environ.get("FLEXMAN_QUIET", "0") not in ("", "0")


def cache_kernels(make: Callable[[Any], Any], folder: str | None) -> Callable[[Any], Any]:
    """Gives a decorator that makes a kernel as `make` does and keeps its code in a folder, if there is one."""

    def decorate(function: Any) -> Any:
        made = make(function)
        if folder is not None and not numba.config.DISABLE_JIT:
            made._cache = _ChecksummedCache(function, folder)
        return made

    return decorate


class ChecksummedFiles(IndexDataCacheFile):
    """Numba's files of a kernel, each behind the digest of its content; a damaged one counts as missing."""

    def _load_index(self) -> Any:
        try:
            version, stamp, overloads = _read_checked(self._index_path)
        except OSError:
            return {}
        return overloads if (version, stamp) == (self._version, self._source_stamp) else {}

    def _save_index(self, overloads: Any) -> None:
        self._write(self._index_path, (self._version, self._source_stamp, overloads))

    def _load_data(self, name: str) -> Any:
        return _read_checked(self._data_path(name))

    def _save_data(self, name: str, data: Any) -> None:
        self._write(self._data_path(name), data)

    def _write(self, path: str, data: Any) -> None:
        content = self._dump(data)
        with self._open_for_write(path) as file:
            file.write(hashlib.sha256(content).digest() + content)


class _ChecksummedCache(FunctionCache):
    """Numba's cache of a kernel with such files. A disk that is full costs the cache, not the call.

    Numba knows a kernel by the path and the time of its file. The folder is named by the sources of these kernels, so
    that all copies of them share what is compiled; kernels elsewhere stay apart.
    """

    _said = False

    def __init__(self, function: Any, folder: str) -> None:
        super().__init__(function)
        stamp = self._impl.locator.get_source_stamp()
        if Path(function.__code__.co_filename).parent == Path(__file__).parent:
            self._cache_path, stamp = folder, None
        self._cache_file = ChecksummedFiles(self._cache_path, self._impl.filename_base, stamp)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keeps the code of a kernel."""
        try:
            super().save_overload(sig, data)
        except OSError as error:
            if not _ChecksummedCache._said:
                _ChecksummedCache._said = True
                print(f"flexman_gym cannot keep compiled kernels: {error}", file=sys.stderr)


def _read_checked(path: str) -> Any:
    """The content of a file; raises OSError where there is none or its digest is another."""
    content = Path(path).read_bytes()
    if hashlib.sha256(content[DIGEST_SIZE:]).digest() != content[:DIGEST_SIZE]:
        raise OSError(f"{path} is damaged")
    return pickle.loads(content[DIGEST_SIZE:])


def _places() -> Iterator[tuple[Path, bool]]:
    """Folders to try, and whether others may write beside them, so that what is there may be prepared."""
    chosen, home = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME"), Path(os.path.expanduser("~"))
    if chosen:
        yield Path(chosen), False
    elif home.is_dir():  # a home that does not exist is not made
        yield home / ".cache", False
    yield Path(tempfile.gettempdir()) / f"user-{os.getuid()}", True


def _belongs_to_us(folder: Path, strict: bool) -> bool:
    """Whether a folder is the user's and nobody else may write in it; one that was open is closed.

    Folders of kernels, whose names are ours alone, are then thrown away; whatever else is there stays and is not read.
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


def _name() -> str:
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    for name in CODE_SETTINGS:
        digest.update(f"{name}={getattr(numba.config, name, None)}\0".encode())
    return digest.hexdigest()[:16]
