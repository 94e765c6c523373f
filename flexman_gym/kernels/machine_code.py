"""Machine code of kernels, compiled ahead of time, in the folder `machine_code` of a wheel.

The folder has one folder for each level of processors, see `LEVELS`, with one file for each kernel. The code is
used if the sources of the kernels, Python, Numba, its compiler and its settings are those that it was made with, and if
the processor has all instructions of the level. Otherwise, and for signatures that a file lacks, kernels compile.
`scripts/machine_code.py` makes the folder.

The files are pickles, like the files of the cache: whoever can change them can also change the sources beside them.
"""

import json
import pickle
import platform
import sysconfig
from collections.abc import Callable
from pathlib import Path
from typing import Any

import llvmlite
import numba
from llvmlite import binding

from flexman_gym.kernels.cache import CODE_SETTINGS, digest_sources
from flexman_gym.kernels.checked_files import read_checked

_AVX2 = "avx avx2 bmi bmi2 cx16 f16c fma lzcnt movbe popcnt sahf sse3 sse4.1 sse4.2 ssse3 xsave"
_LEVELS = {
    "x86_64": {"x86-64-v4": f"{_AVX2} avx512f avx512bw avx512cd avx512dq avx512vl", "x86-64-v3": _AVX2},
    "aarch64": {"generic": ""},
    "arm64": {"apple-m1": ""},
}
LEVELS: dict[str, str] = _LEVELS.get(platform.machine(), {})
"""Level, a name of a processor in LLVM -> instructions that it needs, by their names in LLVM; the fastest first.

Those of x86-64 are the levels of its psABI. All 64-bit ARM processors have what "generic" needs, and those by
Apple what "apple-m1" needs.
"""
FOLDER = Path(__file__).parent / "machine_code"
MADE_WITH = "made_with.json"  # file with the result of `made_with` when the folder was made
PROCESSOR_SETTINGS = ("CPU_NAME", "CPU_FEATURES")  # settings of Numba that are the level's in the folder


def made_with() -> dict[str, str]:
    """Return what machine code depends on, apart from the processor: versions, settings and sources by their names."""
    settings = {
        f"NUMBA_{name}": str(getattr(numba.config, name)) for name in CODE_SETTINGS if name not in PROCESSOR_SETTINGS
    }
    versions = {"numba": numba.__version__, "llvmlite": llvmlite.__version__}
    python = {"python": str(sysconfig.get_config_var("SOABI"))}
    return python | versions | settings | {"sources of kernels": digest_sources()}


def find_level() -> tuple[str | None, str]:
    """Return the fastest level that can be used and an empty reason, or None and the reason why there is none."""
    try:
        made = json.loads((FOLDER / MADE_WITH).read_text())
    except (OSError, ValueError):
        return None, "this installation brings none"
    for name, here in made_with().items():
        if made.get(name) != here:
            return None, f"it was made with {name} {made.get(name)}, here {here}"
    for name in PROCESSOR_SETTINGS:
        if getattr(numba.config, name) is not None:
            return None, f"NUMBA_{name} is set"
    try:
        features = binding.get_host_cpu_features()
    except RuntimeError:
        return None, "the features of the processor are unknown"
    for level, needed in LEVELS.items():
        if all(features.get(each) for each in needed.split()) and (FOLDER / level).is_dir():
            return level, ""
    return None, f"the processor lacks instructions of {', '.join(LEVELS)}"


def file_name(function: Callable[..., Any]) -> str:
    """Return the name of the file with the machine code of a kernel."""
    return f"{function.__module__.rpartition('.')[2]}.{function.__qualname__}"


def read_code(function: Callable[..., Any], signature: Any) -> Any:
    """Return Numba's reduced compilation result of a kernel for a signature; None if the folder lacks it."""
    if LEVEL is None or function.__module__.rpartition(".")[0] != __package__:
        return None
    try:
        codes = read_checked(FOLDER / LEVEL / file_name(function))
    except OSError:
        return None
    return pickle.loads(codes[signature]) if signature in codes else None


LEVEL, REASON = find_level()
