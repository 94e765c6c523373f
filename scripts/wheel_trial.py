"""Use an installed wheel as README does, with a listener for compiled kernels:

    python wheel_trial.py README [--silent]

It prints the kernels that compile in each use; with --silent it fails if there are any. Further uses, in which kernels
may compile, come last.
"""

import argparse
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numba.core import event


class Listener(event.Listener):
    """Names of the kernels that compile, without those that they call."""

    def __init__(self) -> None:
        self.names: list[str] = []
        self._depth = 0

    def on_start(self, event: Any) -> None:
        """Keep the name of a kernel."""
        if self._depth == 0:
            self.names.append(event.data["dispatcher"].py_func.__name__)
        self._depth += 1

    def on_end(self, event: Any) -> None:
        """Return to the kernel that calls this one."""
        self._depth -= 1


def run_readme(text: str) -> None:
    """Run the Python code of README."""
    for code in re.findall(r"```python\n(.*?)```", text, re.DOTALL):
        exec(compile(code, "README.md", "exec"), {"__name__": "readme"})


def command(*words: str) -> Callable[[], None]:
    """Return a function that runs a command of flexman in this process."""

    def run() -> None:
        from flexman_gym.__main__ import main

        if main(list(words)):
            raise SystemExit(f"flexman {' '.join(words)} failed")

    return run


def step(name: str, **settings: Any) -> Callable[[], None]:
    """Return a function that steps an environment."""

    def run() -> None:
        import gymnasium as gym

        import flexman_gym  # noqa: F401  registers the environments

        env: Any = gym.make(name, **settings)
        env.reset(seed=0)
        env.step(env.action_space.sample())

    return run


def main() -> int:
    """Run all uses; return 1 if a kernel compiles where none should."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("readme", type=Path)
    parser.add_argument("--silent", action="store_true", help="fail if a kernel compiles")
    options = parser.parse_args()
    uses = {
        "README": lambda: run_readme(options.readme.read_text()),
        "simulation of the paper's arm": simulate_paper,
        "flexman arm vertical_2r --try": command("arm", "vertical_2r", "--try"),
        "flexman train ppo_on_pd_minute": command("train", "ppo_on_pd_minute", "--steps", "2000", "--quiet",
                                                  "--folder", "runs/trial"),
        "a crane": step("FlexCrane-v0"),
    }  # fmt: skip
    further = {
        "gauss_2": step("FlexRRR-v0", method="gauss_2", step=0.01),
        "ros2": step("FlexRRR-v0", method="ros2", step=0.01),
        "flexman evaluate planned": command("evaluate", "planned", "--episodes", "1"),
    }
    listener, compiled = Listener(), 0
    event.register("numba:compile", listener)
    for name, use in (uses | further).items():
        before = len(listener.names)
        use()
        names = listener.names[before:]
        compiled += len(names) if name in uses else 0
        print(f"{name}: {', '.join(names) or 'nothing'} compiled", flush=True)
    return 1 if compiled and options.silent else 0


def simulate_paper() -> None:
    """Simulate a scene of the paper."""
    import flexman_gym as fm

    fm.simulate(fm.catalog.paper_scene("rr"))


if __name__ == "__main__":
    sys.exit(main())
