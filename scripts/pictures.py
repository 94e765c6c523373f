"""Make the pictures of the home page: python scripts/pictures.py --folder docs

side_by_side.gif: the PD controller of the environment and a policy in the same episode. replay.html: the same
episodes in a browser.
"""

import argparse
from dataclasses import replace

from flexman_gym.evaluation.rollouts import rollout
from flexman_gym.simulation.episode import Episode
from flexman_gym.toolbox.view.comparison import side_by_side
from flexman_gym.toolbox.view.replay import replay_page
from flexman_gym.toolbox.view.video import write_video
from studies.files import folder

ENVIRONMENT, POLICY, SEED = "FlexRRR-v0", "shaping-flexrrr", 9001
SIZE, RATE, SECONDS, HOLD = (800, 560), 12.5, 6.0, 2.0  # pixels, 1/s, s, s
GAIN = 30.0  # dimensionless; magnification of the deflection of the links


def main() -> None:
    """Simulate both episodes and write the pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=folder, default="out", help="output folder")
    options = parser.parse_args()
    names = {"pd": "PD controller", POLICY: POLICY}
    episodes = [_named(rollout(agent, ENVIRONMENT, [SEED]).episode(0), name) for agent, name in names.items()]
    write_video(side_by_side(episodes, SIZE, RATE, SECONDS, HOLD, GAIN), options.folder / "side_by_side.gif", RATE)
    page = replay_page(episodes, f"{ENVIRONMENT}: the same slew under a PD controller and a policy")
    (options.folder / "replay.html").write_text(page, encoding="utf-8")


def _named(episode: Episode, name: str) -> Episode:
    return replace(episode, about=episode.about | {"name": name})


if __name__ == "__main__":
    main()
