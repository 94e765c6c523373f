"""Compile the kernels of the installed package ahead of time, into a folder for a wheel, see `kernels/machine_code.py`.

It runs in an environment with the package and the Numba of its users; kernels are compiled in processes of their own.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from types import CodeType
from typing import Any

from llvmlite import binding
from numba.core.serialize import dumps

from flexman_gym.kernels.checked_files import read_checked, write_checked
from flexman_gym.kernels.machine_code import FOLDER, LEVELS, MADE_WITH, made_with

SOURCES = FOLDER.parent
ANNOTATION = 6  # index of the text of the types in Numba's reduced compilation result, which no run needs


def main() -> None:
    """Write the machine code of all levels."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="new folder")
    parser.add_argument("uses", type=Path, help="program that uses the kernels")
    options = parser.parse_args()
    for level in LEVELS:
        with tempfile.TemporaryDirectory() as cache:
            settings = {"NUMBA_CPU_NAME": level, "NUMBA_CPU_FEATURES": "", "NUMBA_CACHE_DIR": cache}
            subprocess.run([sys.executable, str(options.uses)], env=os.environ | settings, check=True)
            (compiled,) = Path(cache, "flexman_gym").iterdir()
            write_level(compiled, options.folder / level)
    (options.folder / MADE_WITH).write_text(json.dumps(made_with(), indent=1) + "\n")


def write_level(cache: Path, folder: Path) -> None:
    """Write the machine code of a cache folder to a new folder, a file for each kernel."""
    folder.mkdir(parents=True)
    called = called_names(SOURCES)
    for index in sorted(cache.glob("*.nbi")):
        _, _, overloads = read_checked(index)
        kernel = index.name.rsplit("-", 1)[0]  # module.name
        keep = kernel.partition(".")[2] in called
        codes = {key[0]: dumps(slim(read_checked(cache / name), keep)) for key, name in overloads.items()}
        with (folder / kernel).open("xb") as file:
            write_checked(file, dumps(codes))


def called_names(folder: Path) -> set[str]:
    """Return all names that functions in the sources of a folder use, among them those of kernels that others call."""
    codes = [compile(path.read_text(), str(path), "exec") for path in folder.glob("*.py")]
    used: set[str] = set()
    functions = [each for code in codes for each in code.co_consts if isinstance(each, CodeType)]
    while functions:
        code = functions.pop()
        used.update(code.co_names)
        functions += [each for each in code.co_consts if isinstance(each, CodeType)]
    return used


def slim(code: tuple[Any, ...], keep: bool) -> tuple[Any, ...]:
    """Return a reduced compilation result without what no run needs.

    That is the text of types, and the code for other kernels unless `keep`: in its place are functions that trap.
    """
    result = list(code)
    result[ANNOTATION] = ""
    if not keep:
        name, kind, (machine_code, bitcode) = code[0]
        module = binding.parse_bitcode(bitcode)
        names = [each.name for each in module.functions if not each.is_declaration]
        lines = [f'define void @"{each}"() {{ call void @llvm.trap() unreachable }}' for each in names]
        stubs = "\n".join([f'target triple = "{module.triple}"', "declare void @llvm.trap()", *lines])
        result[0] = (name, kind, (machine_code, binding.parse_assembly(stubs).as_bitcode()))
    return tuple(result)


if __name__ == "__main__":
    main()
