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
from typing import Any

from llvmlite import binding
from numba.core.serialize import dumps

from flexman_gym.kernels.checked_files import read_checked, write_checked
from flexman_gym.kernels.machine_code import LEVELS, MADE_WITH, made_with

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
    for index in sorted(cache.glob("*.nbi")):
        _, _, overloads = read_checked(index)
        codes = {key[0]: dumps(slim(read_checked(cache / name))) for key, name in overloads.items()}
        with (folder / index.name.rsplit("-", 1)[0]).open("xb") as file:
            write_checked(file, dumps(codes))


def slim(code: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return a reduced compilation result without what no run needs: the text of types, and code for other kernels.

    A kernel is not called by others, so that the functions in the code for others need only their names. They trap.
    """
    name, kind, (machine_code, bitcode) = code[0]
    module = binding.parse_bitcode(bitcode)
    names = [each.name for each in module.functions if not each.is_declaration]
    lines = [f'define void @"{each}"() {{ call void @llvm.trap() unreachable }}' for each in names]
    stubs = "\n".join([f'target triple = "{module.triple}"', "declare void @llvm.trap()", *lines])
    result = list(code)
    result[0], result[ANNOTATION] = (name, kind, (machine_code, binding.parse_assembly(stubs).as_bitcode())), ""
    return tuple(result)


if __name__ == "__main__":
    main()
