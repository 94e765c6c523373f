"""Compile the kernels that many tests need, in two processes.

Otherwise both processes of the tests compile the same kernel whenever they need it at the same time.
"""

import multiprocessing
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

import numpy as np

import flexman_gym as fm
from flexman_gym.simulation.batch import Batch

SCENE = replace(fm.catalog.paper_scene("rr"), duration=0.02)
STEP = 0.01  # s
FAMILIES = ("midpoint_corrected_3", "gauss_2", "ros2")  # methods of kernels of their own in a batch


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


JOBS = (
    (step_arms, 9), (step_arms, 1), (simulate_all,), (differentiate,),
    (simulate, "midpoint_corrected_3", "gauss_2", "implicit_midpoint"),
    (simulate, "rk4", "ros2", "extrapolated_euler_5"),
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
