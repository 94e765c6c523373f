"""Decorators that compile kernels, their common flags, and checksummed files of compiled code.

Numba optimises each function together with all functions it calls, and emits machine code for it. For a kernel that is
only inlined into other kernels both are omitted: it is optimised in its callers. This saves two fifths of the compile
time.
"""

import hashlib
import pickle
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba import _dynfunc
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.compiler_machinery import register_pass
from numba.core.typed_passes import NativeLowering

DIGEST_SIZE = hashlib.sha256().digest_size  # bytes; size of the digest at the beginning of a file


class _ChecksummedFiles(IndexDataCacheFile):
    """Numba's cache files of a kernel, each with a digest of its content; a damaged file counts as missing."""

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
    """Numba's cache of a kernel with checksummed files; if the disk is full, compilation succeeds without a cache.

    Numba identifies a kernel by the path and the modification time of its file. Kernels of this package are identified
    by the name of the cache folder, a hash of the sources, so that all copies of the package share the compiled code.
    """

    _warned = False

    def __init__(self, function: Any, folder: str) -> None:
        super().__init__(function)
        stamp = self._impl.locator.get_source_stamp()
        if Path(function.__code__.co_filename).parent == Path(__file__).parent:
            self._cache_path, stamp = folder, None
        self._cache_file = _ChecksummedFiles(self._cache_path, self._impl.filename_base, stamp)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Write the compiled code of a kernel to the disk."""
        try:
            super().save_overload(sig, data)
        except OSError as error:
            if not _ChecksummedCache._warned:
                _ChecksummedCache._warned = True
                print(f"flexman_gym cannot cache compiled kernels: {error}", file=sys.stderr)


def _read_checked(path: str) -> Any:
    """Return the content of a file; raise OSError for a file that is missing or damaged."""
    content = Path(path).read_bytes()
    if hashlib.sha256(content[DIGEST_SIZE:]).digest() != content[:DIGEST_SIZE]:
        raise OSError(f"{path} is damaged")
    return pickle.loads(content[DIGEST_SIZE:])


def _cached(decorate: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Return a decorator that compiles a kernel and caches its code on the disk, if there is a cache folder."""

    def compile_cached(function: Any) -> Any:
        result = decorate(function)
        if FOLDER is not None and not numba.config.DISABLE_JIT:
            result._cache = _ChecksummedCache(function, FOLDER)
        return result

    return compile_cached


class _InlineLibrary(JITCodeLibrary):
    """Code of an inner kernel, which is linked into its callers; no machine code is emitted for it."""

    def _optimize_final_module(self) -> None:
        """Leave this optimisation to the callers; Numba's passes over each function, run before, matter for speed."""

    def _finalize_final_module(self) -> None:
        self._finalized = True


@register_pass(mutates_CFG=True, analysis_only=False)
class _InlineLowering(NativeLowering):
    """Pass that lowers a typed function to an `_InlineLibrary`."""

    _name = "ingredient_lowering"

    def run_pass(self, state: Any) -> bool:
        """Run Numba's pass without machine code; callers see a function without an address."""
        state.library = library = _InlineLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        state.flags.no_compile = True
        super().run_pass(state)
        lowered = state.cr
        described = lowered.fndesc
        name = _dynfunc.make_function(described.lookup_module(), described.qualname, "", 0, lowered.env, (library,))
        state.targetctx.insert_user_function(name, described, [library])
        state.cr = lowered._replace(cfunc=name)
        return True


class _InlineCompiler(Compiler):
    """Numba's compiler with `_InlineLowering` as the last pass."""

    def define_pipelines(self) -> list[Any]:
        """Return Numba's passes, with `_InlineLowering` in place of the lowering."""
        (passes,) = super().define_pipelines()
        passes.add_pass_after(_InlineLowering, NativeLowering)
        passes.passes = [each for each in passes.passes if each[0] is not NativeLowering]
        passes.finalize()
        return [passes]


# "_nrt": without Numba's runtime a call does not count references to each array of a model, which took ten times as
# long as the arithmetic; a kernel that allocates memory does not compile. Fast arithmetic is off because last digits
# would differ between one arm and a batch; `lanes.fma` has most of its gain.
FLAGS: dict[str, Any] = {"_nrt": False, "error_model": "numpy"}
FOLDER = numba.config.CACHE_DIR or None  # cache folder, set while the modules of this package are imported
kernel = _cached(numba.njit(**FLAGS))  # called from Python
released = _cached(numba.njit(**FLAGS, nogil=True))  # called from Python, in several threads at once
inner = numba.njit(  # called by other kernels only
    **FLAGS, forceinline=True, no_cpython_wrapper=True, no_cfunc_wrapper=True, pipeline_class=_InlineCompiler
)
