"""Check the installation and print versions, processor and speed.

Please add the output to a report of a problem.
"""

import argparse
import time
from statistics import median

from flexman_gym.commands import CommandLine, add_options

PACKAGES = ("gymnasium", "torch", "stable-baselines3")
TIMED_STEPS, ROUNDS = 500, 5  # environment steps of a round; rounds


def _arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    add_options(parser, "--json")


def _run(options: argparse.Namespace) -> int:
    """Print the state of the installation and the speed of an environment; return 0."""
    from flexman_gym.common.computer import computer_info
    from flexman_gym.common.formatting import json_text

    vectors = {"vector registers": f"{_vector_bits()} bits"}
    state = computer_info(PACKAGES) | vectors | _kernel_states()
    if options.json:
        print(json_text(state | {"steps per CPU second": _steps_per_second()}))
        return 0
    for name, value in state.items():
        print(f"{name}: {value}", flush=True)
    speed = f"{_steps_per_second():,.0f} per CPU second"
    print(f"steps of FlexRRR-v0: {speed} (one arm, random actions; median of {ROUNDS} rounds of {TIMED_STEPS})")
    return 0


def _kernel_states() -> dict[str, str]:
    """Return whether machine code of the wheel is used, and where kernels are compiled otherwise."""
    from flexman_gym.kernels import CACHE_FOLDER, first_use, machine_code

    compiled = "in every process, as no folder has write access for this user only"
    if CACHE_FOLDER is not None:
        later = machine_code.LEVEL is None and not first_use.is_done(CACHE_FOLDER)
        compiled = f"{'not yet, ' if later else ''}in {CACHE_FOLDER}"
    return {
        "machine code of the wheel": machine_code.LEVEL or f"not used: {machine_code.REASON}",
        "compiled kernels": compiled,
    }


def _vector_bits() -> int:
    """Return the width of the widest vector registers that the compiler finds, bits."""
    from llvmlite import binding

    features = binding.get_host_cpu_features()
    return next((bits for name, bits in (("avx512f", 512), ("avx", 256)) if features.get(name)), 128)


def _steps_per_second() -> float:
    """Return the steps per second of CPU time of one environment under random actions, as the median of the rounds.

    CPU time is that of the rows in docs/evidence/benchmark.csv; other programs on the computer do not count.
    """
    import gymnasium as gym

    import flexman_gym  # noqa: F401  registers the environments

    env = gym.make("FlexRRR-v0")
    env.reset(seed=0)
    env.action_space.seed(0)
    env.step(env.action_space.sample())  # compiles the kernels that are not in the cache
    seconds = []
    for _ in range(ROUNDS):
        started = time.process_time()
        for _ in range(TIMED_STEPS):
            *_, terminated, truncated, _ = env.step(env.action_space.sample())
            if terminated or truncated:
                env.reset()
        seconds.append(time.process_time() - started)
    return TIMED_STEPS / median(seconds)


EXAMPLES = (
    "flexman check",
    "flexman check --json | python3 -m json.tool",
)
COMMAND = CommandLine(_arguments, _run, EXAMPLES)
