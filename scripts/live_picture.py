"""Make the picture of the live view on the home page: python scripts/live_picture.py --folder docs

live.gif: screenshots of the page in Chromium, with a fixed simulated time between two of them. The same slew under a PD
controller and a tracking LQR, again with softer joints, and a push on the tips. It needs chromium and chromedriver.
"""

import argparse
import base64
import importlib
import io
import sys
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from flexman_gym.toolbox.view.live_session import LiveSession, live
from flexman_gym.toolbox.view.video import write_video
from studies.files import folder

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
Browser: Any = importlib.import_module("oracles.browser").Browser
ENVIRONMENT, AGENTS, SEED = "FlexRRR-v0", ("pd", "lqr-tracking"), 9000
PAGE, SIZE = (1120, 630), (800, 450)  # pixels; of the page, and of the picture
RATE, PERIODS = 10, 10  # 1/s, and control periods of 0.02 s between two frames: twice real time
SOFT, FORCE = 0.5, [0.0, 0.0, 60.0]  # factor on the joint stiffness; push, N
FRAMES = (24, 24, 2, 22)  # numbers of frames: nominal joints, soft joints, during the push, after it


def main() -> None:
    """Write the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=folder, default="out", help="output folder")
    options = parser.parse_args()
    browser = Browser()
    with live(ENVIRONMENT, AGENTS, SEED) as session:
        session.command({"pause": True})
        session.command({"again": 0})
        browser.size(*PAGE)
        browser.open(session.url, "window.replay && replay.views[0].tip.position.length() > 0")
        browser.run("const { stage } = replay; stage.coarse = false; stage.renderer.shadowMap.enabled = true;"
                    "dispatchEvent(new Event('resize'))")  # fmt: skip
        frames = record(session, browser, FRAMES[0])
        session.command({"values": {"joint_stiffness": SOFT}})
        frames += record(session, browser, FRAMES[1])
        session.command({"push": FORCE})
        frames += record(session, browser, FRAMES[2])
        session.command({"push": [0.0, 0.0, 0.0]})
        frames += record(session, browser, FRAMES[3])
    browser.close()
    write_video(frames, options.folder / "live.gif", RATE)


def record(session: LiveSession, browser: Browser, count: int) -> list[np.ndarray]:
    """Return frames (height, width, 3), uint8, each after PERIODS control periods."""
    frames = []
    for _ in range(count):
        session.command({"step": PERIODS})
        newest = len(session._rows[0])
        current = "replay.shown() && Math.abs(replay.plots[0].time - replay.runs[0].last) < 1e-6"
        browser.wait(f"replay.rows()[0] === {newest} && {current}")
        picture = Image.open(io.BytesIO(base64.b64decode(browser.picture()))).convert("RGB")
        frames.append(np.asarray(picture.resize(SIZE, Image.Resampling.LANCZOS)))
    return frames


if __name__ == "__main__":
    main()
