"""Copy of the folder of kernels with two small ones that compile quickly, and processes that call them."""

import os
import subprocess
import sys

from oracles.files import ROOT

LONGEST = 200.0  # s; a process that lasts longer waits for ever
CALLEE = """from flexman_gym.kernels.compile import kernel
@kernel
def constant():
    return {value}
"""
CALLER = """from flexman_gym.kernels.callee import constant
from flexman_gym.kernels.compile import kernel
@kernel
def doubled():
    return 2 * constant()
"""
CALL = """import sys
from flexman_gym.kernels.caller import doubled
print(doubled(), sum(doubled.stats.cache_hits.values()), doubled.stats.cache_path)
"""


def process(folder, cache, script, **variables):
    """Start a process whose script imports the package from `folder`."""
    settings = {"PYTHONPATH": str(folder), "NUMBA_CACHE_DIR": str(cache), "FLEXMAN_COMPILE_AHEAD": "0"}
    environment = os.environ | settings | variables
    command = [sys.executable, "-c", script]
    return subprocess.run(command, capture_output=True, text=True, env=environment, cwd=folder, timeout=LONGEST)


def run(folder, cache, script, **variables):
    """Return the words printed by the process."""
    done = process(folder, cache, script, **variables)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def copied(folder, value):
    """Copy the kernels to `folder` with two additional ones, one of which calls the other from another file.

    The package has nothing else, so that the processes import no more than Numba.
    """
    target = folder / "flexman_gym"
    (target / "kernels").mkdir(parents=True, exist_ok=True)
    (target / "__init__.py").touch()
    for source in sorted((ROOT / "flexman_gym" / "kernels").glob("*.py")):
        (target / "kernels" / source.name).write_bytes(source.read_bytes())
    (target / "kernels" / "callee.py").write_text(CALLEE.format(value=value))
    (target / "kernels" / "caller.py").write_text(CALLER)
