"""Compiled kernels: equations of motion, integration methods, and all arithmetic of a control period.

The machine code is cached on the disk, see `cache`. Messages on stderr announce kernels that compile; FLEXMAN_QUIET=1
silences the messages.
"""

import pkgutil
import sys
import time
from importlib import import_module
from typing import Any

import numba
from numba.core import event

from flexman_gym.kernels.cache import find_cache_folder, is_quiet

# Compile time, s, on a processor of 2024: of the kernel, and of the kernels that follow it until the first result of an
# environment or a simulation. Kernels that compile in less than 2 s are not listed.
COMPILE_SECONDS = {
    "inertial_forces": (5, 19), "advance_single": (18, 0), "advance_batch": (19, 0), "tip_accelerations": (6, 0),
    "run_steps": (16, 0), "run_adaptive": (14, 0), "inertial_jacobian": (8, 0),
}  # fmt: skip


class _CompileMessages(event.Listener):
    """Messages about kernels that compile; Numba sends no event for a kernel loaded from the cache.

    The remaining time is that of COMPILE_SECONDS times a factor, measured with the last of these kernels.
    """

    def __init__(self) -> None:
        self._announced, self._depth, self._factor = False, 0, 1.0
        self._started, self._listed = 0.0, 0  # s; start of the kernel, and its time in COMPILE_SECONDS or 0

    def on_start(self, event: Any) -> None:
        """Announce a kernel of this package when Numba begins to compile it."""
        function = event.data["dispatcher"].py_func
        self._depth += 1
        if self._depth == 1:
            self._started = time.perf_counter()
            self._listed, following = COMPILE_SECONDS.get(function.__name__, (0, 0))
        if is_quiet() or self._depth > 1 or not function.__module__.startswith(f"{__name__}."):
            return
        if not self._announced:
            storage = f"once and caches them in {CACHE_FOLDER}"
            if CACHE_FOLDER is None:
                storage = "in every process, as no private cache folder can be written; set NUMBA_CACHE_DIR to one"
            print(f"flexman_gym compiles kernels {storage} (FLEXMAN_QUIET=1 silences this)", file=sys.stderr)
            self._announced = True
        if self._listed:
            seconds = self._factor * (self._listed + following)
            print(f"  {function.__name__}: about {max(1, round(seconds))} s left", file=sys.stderr, flush=True)

    def on_end(self, event: Any) -> None:
        """Decrease the depth of nested compilations; measure the factor of the remaining time."""
        self._depth -= 1
        if self._depth == 0 and self._listed:
            self._factor = (time.perf_counter() - self._started) / self._listed


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
