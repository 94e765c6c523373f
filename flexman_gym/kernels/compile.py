"""Decorators that compile kernels, their common flags, and their caches.

Numba optimises each function together with all functions it calls, and emits machine code for it. For a kernel that is
only inlined into other kernels both are omitted: it is optimised in its callers. This saves two fifths of the compile
time.
"""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import numba
from numba import _dynfunc
from numba.core.caching import FunctionCache, IndexDataCacheFile, NullCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, CompileResult, Flags
from numba.core.compiler_machinery import register_pass
from numba.core.typed_passes import NativeLowering

from flexman_gym.kernels.checked_files import read_checked, write_checked
from flexman_gym.kernels.first_use import compile_first_use, is_first_use
from flexman_gym.kernels.machine_code import read_code


class _ChecksummedFiles(IndexDataCacheFile):
    """Numba's cache files of a kernel, each with a digest of its content; a damaged file counts as missing."""

    def _load_index(self) -> Any:
        try:
            version, stamp, overloads = read_checked(self._index_path)
        except OSError:
            return {}
        return overloads if (version, stamp) == (self._version, self._source_stamp) else {}

    def _save_index(self, overloads: Any) -> None:
        self._write(self._index_path, (self._version, self._source_stamp, overloads))

    def _load_data(self, name: str) -> Any:
        return read_checked(self._data_path(name))

    def _save_data(self, name: str, data: Any) -> None:
        self._write(self._data_path(name), data)

    def _write(self, path: str, data: Any) -> None:
        with self._open_for_write(path) as file:
            write_checked(file, self._dump(data))


class _MachineCode:
    """Part of the cache of a kernel that takes the machine code of a wheel first, see `machine_code`."""

    _py_func: Any  # kernel

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the compiled kernel for a signature, or None if it is to be compiled."""
        code = read_code(self._py_func, sig)
        if code is None:
            return super().load_overload(sig, target_context)  # type: ignore[misc]
        target_context.refresh()
        return CompileResult._rebuild(target_context, *code)


class _NoFolder(_MachineCode, NullCache):
    """Cache of a kernel without a cache folder."""

    def __init__(self, function: Any) -> None:
        self._py_func = function


class _ChecksummedCache(_MachineCode, FunctionCache):
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

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the compiled kernel for a signature, or None if it is to be compiled; see `first_use`."""
        result = super().load_overload(sig, target_context)
        if result is None and self._cache_path == FOLDER and is_first_use(FOLDER):
            compile_first_use(FOLDER)
            result = super().load_overload(sig, target_context)
        return result

    def save_overload(self, sig: Any, data: Any) -> None:
        """Write the compiled code of a kernel to the disk."""
        try:
            super().save_overload(sig, data)
        except OSError as error:
            if not _ChecksummedCache._warned:
                _ChecksummedCache._warned = True
                print(f"flexman_gym cannot cache compiled kernels: {error}", file=sys.stderr)


def _cached(decorate: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Return a decorator that loads a kernel or compiles it, and caches its code on the disk, if there is a folder."""

    def compile_cached(function: Any) -> Any:
        result = decorate(function)
        result._cache = _NoFolder(function) if FOLDER is None else _ChecksummedCache(function, FOLDER)
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


class _SharedFlags(Flags):
    """Compiler flags whose equal copies are one object.

    Numba compares the flags with those of earlier functions at each operation whose types it infers. Comparing all
    values each time took a twelfth of the compile time.
    """

    _copies: ClassVar[dict[str, "_SharedFlags"]] = {}

    def copy(self) -> "_SharedFlags":
        """Return the copy of all flags with the same values; it is not to be changed."""
        return self._copies.setdefault(repr(self), _SharedFlags(self))

    __eq__, __hash__ = object.__eq__, object.__hash__


class _KernelCompiler(Compiler):
    """Numba's compiler with shared flags."""

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.state.flags = _SharedFlags(self.state.flags)


class _InlineCompiler(_KernelCompiler):
    """Compiler with `_InlineLowering` as the last pass."""

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
CALLED: dict[str, Any] = FLAGS | {"pipeline_class": _KernelCompiler}  # of kernels that Python calls, and no kernel
kernel = _cached(numba.njit(**CALLED))
released = _cached(numba.njit(**CALLED, nogil=True))  # in several threads at once
inner = numba.njit(  # called by other kernels only
    **FLAGS, forceinline=True, no_cpython_wrapper=True, no_cfunc_wrapper=True, pipeline_class=_InlineCompiler
)
