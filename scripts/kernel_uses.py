"""Use the kernels as programs do, in two processes, so that they are compiled into the cache before they are needed.

Otherwise both processes of the tests compile the same kernel whenever they need it at the same time, and the machine
code of a wheel lacks what this program does not use.
"""

import multiprocessing
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np

import flexman_gym as fm
from flexman_gym.__main__ import main as main_of_flexman
from flexman_gym.commands.compile import USES
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.simulation.batch import Batch

SCENE = replace(fm.catalog.paper_scene("rr"), duration=0.02)
STEP = 0.01  # s
FAMILIES = ("midpoint_corrected_3", "gauss_2", "ros2")  # methods of kernels of their own in a batch
AGENTS = ("pd", "pd-torque", "lqr-tracking", "lqg", "adaptive-lqr", "privileged-planned")


def first_use(job: str) -> None:
    """Use the kernels of a job of `flexman compile`."""
    USES[job]()


def step_arms(arms: int) -> None:
    """Step arms in a batch by a method of each family."""
    for method in FAMILIES:
        batch = Batch(fm.build_model(SCENE.arm), method, STEP, STEP, arms=arms)
        batch.step(np.zeros((arms, 2)))
        batch.tip_accelerations()


def simulate(*methods: str) -> None:
    """Simulate a scene by methods."""
    for method in methods:
        fm.simulate(SCENE, method=method, step=STEP)


def simulate_all() -> None:
    """Simulate several scenes by a method of each family."""
    for method in FAMILIES:
        fm.simulate_all([SCENE] * 9, method=method, step=STEP)


def differentiate() -> None:
    """Differentiate a simulation by a method of each family."""
    for method in FAMILIES:
        fm.sensitivities(SCENE, method=method, step=STEP)


def evaluate() -> None:
    """Evaluate controllers, one arm and several, and draw an arm."""
    for agent in AGENTS:
        for seeds in (range(9000, 9001), range(9000, 9002)):
            fm.evaluate(agent, "FlexRRR-v0", seeds=seeds)
    env: Any = gym.make("FlexRRR-v0", render_mode="rgb_array")
    env.reset(seed=0)
    env.render()


def try_arm() -> None:
    """Try controllers on an arm of the catalog."""
    main_of_flexman(["arm", "vertical_2r", "--try"])


def step_environments() -> None:
    """Step each named environment, alone and two at once."""
    for name in NAMED_ENVIRONMENTS:
        for env in (gym.make(name), gym.make_vec(name, 2, "vector_entry_point")):
            any_env: Any = env
            any_env.reset(seed=0)
            any_env.step(any_env.action_space.sample())


JOBS = (
    (first_use, "batch"), (first_use, "single"), (first_use, "control"), (first_use, "simulation"),
    (step_arms, 9), (step_arms, 1), (simulate_all,), (differentiate,),
    (simulate, "midpoint_corrected_3", "gauss_2", "implicit_midpoint"),
    (simulate, "rk4", "ros2", "extrapolated_euler_5"), (evaluate,), (try_arm,), (step_environments,),
)  # fmt: skip


def main() -> None:
    """Compile all kernels; print the time of each job."""
    start = time.perf_counter()
    with ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as pool:
        for (function, *given), running in [(job, pool.submit(*job)) for job in JOBS]:
            running.result()
            print(f"{function.__name__} {given}: after {time.perf_counter() - start:.0f} s", flush=True)


if __name__ == "__main__":
    main()
