"""Make the pictures of the home page: python scripts/pictures.py --folder docs

side_by_side.gif: a PD controller and a policy that reach the same target at the same time. replay.html: the same two
episodes in a browser. arm.png: the arm of FlexRRR-v0 at its largest deflection in the episode of the policy.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.rollouts import rollout
from flexman_gym.model.deformation import curves
from flexman_gym.simulation.episode import Episode
from flexman_gym.toolbox.view.comparison import side_by_side
from flexman_gym.toolbox.view.frames import FramePainter
from flexman_gym.toolbox.view.overlay import Caption
from flexman_gym.toolbox.view.replay import replay_page
from flexman_gym.toolbox.view.video import write_picture, write_video
from studies.files import folder

ENVIRONMENT, POLICY, SEED = "FlexRRR-v0", "shaping-flexrrr", 9001
FACTORS = np.arange(3.0, 8.25, 0.25)  # 1; stiffness of the PD / its tuned stiffness, of which one is chosen
SIZE, RATE, SECONDS, HOLD = (1280, 640), 12.5, 8.0, 2.0  # pixels, 1/s, s, s
GAIN, ARM_GAIN = 15.0, 10.0  # magnifications of the deflection of the links: side by side, single arm
ARM_SIZE = (960, 720)  # pixels


def main() -> None:
    """Simulate both episodes and write the pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=folder, default="out", help="output folder")
    options = parser.parse_args()
    policy = rollout(POLICY, ENVIRONMENT, [SEED]).episode(0)
    arrival = policy.time[np.flatnonzero(policy.errors > policy.band)[-1] + 1]
    factor, pd = pd_that_arrives(arrival)
    print(f"{POLICY} settles after {arrival:.2f} s; the PD with {factor:g} times its stiffness passes the target then")
    episodes = [_named(pd, f"PD, {factor:g} times stiffer"), _named(policy, f"policy {POLICY}")]
    frames = side_by_side(episodes, SIZE, RATE, SECONDS, HOLD, GAIN)
    write_video(frames, options.folder / "side_by_side.gif", RATE)
    page = replay_page(episodes, f"{ENVIRONMENT}: the same slew under a PD controller and a policy")
    (options.folder / "replay.html").write_text(page, encoding="utf-8")
    draw_arm(policy, options.folder / "arm.png")


def pd_that_arrives(time: float) -> tuple[float, Episode]:
    """Return the PD whose tip is nearest to the target closest to a time (s): its stiffness factor, and its episode."""
    environment = Configuration.find(ENVIRONMENT)
    gains, found = environment.pd_gains, []
    for factor in FACTORS:
        stiffer = gains | {"stiffness": [factor * each for each in gains["stiffness"]]}
        episode = rollout("pd", environment.replace(gains=stiffer), [SEED]).episode(0)
        first = np.flatnonzero(np.diff(episode.errors) > 0.0)
        late = abs(episode.time[first[episode.errors[first] < 0.5 * episode.errors[0]][0]] - time)
        found.append((late, float(factor), episode))
    return min(found, key=lambda each: each[0])[1:]


def draw_arm(episode: Episode, path: Path) -> None:
    """Draw the arm at the largest strain of its links, with magnified deflection, over its rigid ghost."""
    strains = np.abs(curves(episode.model, episode.states, 9).strains).max(axis=(1, 2, 3))
    row, painter = int(strains.argmax()), FramePainter(episode.model, ARM_SIZE, gain=ARM_GAIN)
    caption = Caption(ENVIRONMENT, float(episode.time[row]), float(episode.errors[row]), None, episode.actions[row - 1])
    gains = painter.gains, (0.0, 0.0)
    points = [curves(episode.model, episode.states[row], 9, *each).positions.reshape(-1, 3) for each in gains]
    shot = painter.shot(np.vstack([*points, episode.targets[row]]))
    frame = painter.paint(episode.states[row], episode.targets[row], caption, episode.tips[: row + 1], shot)
    write_picture(frame, path)


def _named(episode: Episode, name: str) -> Episode:
    return replace(episode, about=episode.about | {"name": name})


if __name__ == "__main__":
    main()
