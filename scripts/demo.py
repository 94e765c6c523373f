"""The main job: the three cases of the paper with figures, a training on FlexRRR-v0, one table of policies."""

import shutil
import time
from pathlib import Path

import numpy as np
from matplotlib.image import imsave

import flexman_gym as fm
from flexman_agents.evaluation import evaluate, table
from flexman_agents.training import Settings, train
from flexman_gym import draw
from flexman_gym.model.model import scene_model

OUT = Path("out")
METHOD, RTOL = "dop853", 1e-7
CASES = {
    "rr": "rigid links, rigid joints",
    "fr": "flexible links, rigid joints",
    "ff": "flexible links, flexible joints",
}
TRAINING = Settings(algo="ppo", steps=1_000_000, residual=True)
EPISODES, FIRST_SEED = 20, 1000


def main() -> None:
    started = time.perf_counter()
    print("1. The paper's scene: 2 s under 400 N m at each joint, by the adaptive reference method.")
    print("   The first run also compiles the kernels, which takes a minute.")
    draw_cases(simulate_cases())
    print("2. Training: PPO, a million steps, adding to a PD controller of the motors.")
    shutil.rmtree(OUT / "ppo", ignore_errors=True)
    train(TRAINING, OUT / "ppo")
    print(f"3. Evaluation: {EPISODES} episodes of FlexRRR-v0 each, the same for all.")
    policies = {"PPO on PD": str(OUT / "ppo"), "PD": "pd", "zero": "zero", "random": "random"}
    results = {name: evaluate(policy, EPISODES, FIRST_SEED) for name, policy in policies.items()}
    print(table(results))
    print(f"Done in {time.perf_counter() - started:.0f} s.")


def simulate_cases() -> dict[str, fm.Trajectory]:
    """The trajectory of each of the paper's cases, with a line of progress and result for each."""
    print(f"   {'case':<33}{'status':<10}{'computing':>10}{'largest energy residual':>26}")
    trajectories = {}
    for case, name in CASES.items():
        print(f"   {name:<33}", end="", flush=True)
        trajectory = fm.simulate(fm.catalog.paper_scene(case), method=METHOD, rtol=RTOL)
        residual = np.abs(trajectory.energy_residual).max()
        print(f"{trajectory.status:<10}{trajectory.wall_seconds:>8.2f} s{residual:>24.1e} J", flush=True)
        trajectories[case] = trajectory
    return trajectories


def draw_cases(trajectories: dict[str, fm.Trajectory]) -> None:
    """Draws Figures 6 to 11 and the moment at which flexible links are bent most."""
    paths = draw.paper_figures(trajectories["rr"], trajectories["fr"], trajectories["ff"], OUT)
    model, trajectory = scene_model(fm.catalog.paper_scene("fr")), trajectories["fr"]
    row = np.linalg.norm(trajectory.deflection, axis=1).argmax()
    imsave(OUT / "arm.png", draw.arm_frame(model, trajectory.states[row], size=(960, 720)))
    print(f"   Figures 6 to 11 are in {OUT}/, together in {paths[-1]}.")
    print(f"   {OUT}/arm.png shows the arm at {trajectory.time[row]:.2f} s, its links bent most, its joints rigid.")


if __name__ == "__main__":
    main()
