"""Compile: the decorators of the kernels, the flags that all of them share, and how inner kernels are compiled.

Numba optimises every function with all that it calls, and makes machine code of it. A kernel that others take in whole
needs neither: it is optimised where it ends up, once. Two fifths of the time to compile were spent on that.
"""

from typing import Any

import numba
from numba import _dynfunc
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.compiler_machinery import register_pass
from numba.core.typed_passes import NativeLowering

from flexman_gym.kernels.cache import cache_kernels


class _InlineLibrary(JITCodeLibrary):
    """The code of an inner kernel, for the kernels that call it to link: of its own there is nothing to run."""

    def _optimize_final_module(self) -> None:
        """Left to the caller; what Numba does function by function has been done, without it arms move slower."""

    def _finalize_final_module(self) -> None:
        self._finalized = True


@register_pass(mutates_CFG=True, analysis_only=False)
class _InlineLowering(NativeLowering):
    """Makes an `_InlineLibrary` of a typed function."""

    _name = "ingredient_lowering"

    def run_pass(self, state: Any) -> bool:
        """Numba's pass without machine code; a function without an address stands for the kernel where it is called."""
        state.library = library = _InlineLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        state.flags.no_compile = True
        super().run_pass(state)
        lowered = state.cr
        about = lowered.fndesc
        name = _dynfunc.make_function(about.lookup_module(), about.qualname, "", 0, lowered.env, (library,))
        state.targetctx.insert_user_function(name, about, [library])
        state.cr = lowered._replace(cfunc=name)
        return True


class _InlineCompiler(Compiler):
    """Numba's compiler, but for the last step."""

    def define_pipelines(self) -> list[Any]:
        """Its passes with another lowering."""
        (passes,) = super().define_pipelines()
        passes.add_pass_after(_InlineLowering, NativeLowering)
        passes.passes = [each for each in passes.passes if each[0] is not NativeLowering]
        passes.finalize()
        return [passes]


# Without Numba's runtime a kernel that allocates does not compile, and a call does not count references to every array
# of a model, which took ten times as long as the arithmetic. Fast arithmetic is off, as it would give one arm other
# last digits than several abreast; what it gains most, `fused` gains too.
FLAGS: dict[str, Any] = {"_nrt": False, "error_model": "numpy"}
FOLDER = numba.config.CACHE_DIR or None  # set while the rooms are imported
kernel = cache_kernels(numba.njit(**FLAGS), FOLDER)  # what Python calls
released = cache_kernels(numba.njit(**FLAGS, nogil=True), FOLDER)  # what Python calls in several threads
inner = numba.njit(  # what other kernels call; they cannot be called from Python
    **FLAGS, forceinline=True, no_cpython_wrapper=True, no_cfunc_wrapper=True, pipeline_class=_InlineCompiler
)
