"""Compiled kernels: equations of motion, integration methods, and all arithmetic of a control period.

The machine code comes with a wheel, see `machine_code`, or is compiled, see `first_use`, and cached on the disk, see
`cache`. A line of the terminal tells that kernels compile; FLEXMAN_QUIET=1 silences it.
"""

import pkgutil
import sys
from importlib import import_module
from typing import Any

import numba
from numba.core import event

from flexman_gym.kernels.cache import find_cache_folder, is_quiet
from flexman_gym.kernels.first_use import show_line


class _CompileMessages(event.Listener):
    """Messages about kernels that compile; Numba sends no event for a kernel loaded from the cache."""

    def __init__(self) -> None:
        self._depth, self._shown, self._warned = 0, False, CACHE_FOLDER is not None

    def on_start(self, event: Any) -> None:
        """Write a line of the terminal when Numba begins to compile a kernel of this package."""
        self._depth += 1
        ours = event.data["dispatcher"].py_func.__module__.startswith(f"{__name__}.")
        if self._depth > 1 or is_quiet() or not ours:
            return
        if not self._warned:
            print("flexman_gym compiles its kernels in every process, as no private cache folder can be written; set "
                  "NUMBA_CACHE_DIR to one", file=sys.stderr)  # fmt: skip
            self._warned = True
        show_line("flexman_gym compiles a kernel, once")
        self._shown = True

    def on_end(self, event: Any) -> None:
        """Erase the line at the end of the kernel."""
        self._depth -= 1
        if self._depth == 0 and self._shown:
            show_line("")
            self._shown = False


if numba.config.DISABLE_JIT:
    raise ImportError("NUMBA_DISABLE_JIT: 1 is not allowed; give 0 or unset it: the kernels run only compiled")

CACHE_FOLDER = find_cache_folder()
event.register("numba:compile", _CompileMessages())

# Numba reads this setting when a kernel is decorated; it is restored afterwards for other packages.
_setting = numba.config.CACHE_DIR
numba.config.CACHE_DIR = CACHE_FOLDER or ""
__all__ = [each.name for each in pkgutil.iter_modules(__path__)]
try:
    for _name in __all__:
        import_module(f"{__name__}.{_name}")
finally:
    numba.config.CACHE_DIR = _setting
