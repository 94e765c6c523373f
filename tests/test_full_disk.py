"""Writers of files on a full disk: the file of before stays whole, and nothing remains beside it."""

import json
import subprocess
import sys

import pytest

pytestmark = pytest.mark.slow

SCRIPT = """
import json, os, resource, sys
from pathlib import Path
import numpy as np
import flexman_gym as fm
from flexman_gym.__main__ import main
from flexman_gym.common.plot_style import new_figure, save_figure
from flexman_gym.agent.normalisation import RunningMeanStd
from flexman_gym.draw import write_picture, write_video
from flexman_gym.toolbox.league.page import write_page
from flexman_gym.toolbox.league.rows import LeagueRows
from flexman_gym.scene.signals import SampledTorque

os.chdir(sys.argv[1])
frames = list(np.random.default_rng(0).integers(0, 255, (3, 64, 64, 3)).astype(np.uint8))
torque = SampledTorque.from_function(lambda time: [time], 1.0, 0.01)
scene = fm.catalog.paper_scene("rr")
episode = fm.rollout("zero", "FlexOne-v0", [0]).episode(0)
figure = new_figure((2.0, 2.0), 72.0)
figure.add_subplot().plot([0.0, 1.0])
episode.save("read.npz"); scene.save("read.yaml")
command = lambda *words: (lambda path: main([*words, str(path)]) and (_ for _ in ()).throw(OSError("exit status")))
WRITERS = {
    "episode.npz": episode.save, "episode.csv": episode.to_csv, "torque.csv": torque.to_csv, "scene.yaml": scene.save,
    "scene.json": scene.save, "statistics.npz": RunningMeanStd((99,)).save,
    "figure.png": lambda path: save_figure(figure, path),
    "figure.svg": lambda path: save_figure(figure, path), "picture.png": lambda path: write_picture(frames[0], path),
    "video.gif": lambda path: write_video(frames, path), "video.mp4": lambda path: write_video(frames, path),
    "league.md": lambda path: write_page(LeagueRows(), path.parent, ""),
    "replay.html": command("replay", "read.npz", "--out"), "arm.xml": command("export", "mujoco", "one_joint", "--out"),
    "arm.urdf": command("export", "urdf", "one_joint"), "table.csv": command("simulate", "read.yaml", "--out"),
    "trajectory.npz": command("simulate", "read.yaml", "--out"),
    "modes.csv": command("shape", "one_joint", "--postures=2", "--csv"),
    "shaped.csv": lambda path: command("shape", "one_joint", str(path), "--out")(path),
}
result = {}
most = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
for name, write in WRITERS.items():
    folder = Path(name).resolve().parent / name.replace(".", "_"); folder.mkdir()
    path, times = folder / name, 0.02 * np.arange(50)
    path.write_text("time (s),angle (rad)\\n" + "".join(f"{t},{t * t * (3.0 - 2.0 * t)}\\n" for t in times))
    before = path.read_bytes()
    resource.setrlimit(resource.RLIMIT_FSIZE, (200, most))
    try:
        write(path)
        outcome = "written"
    except Exception as error:
        outcome = "refused" if isinstance(error, OSError) else repr(error)
    resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))
    result[name] = [outcome, path.read_bytes() == before, sorted(os.listdir(folder)) == [name]]
print(json.dumps(result), flush=True)
"""


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory):
    """Return for each file the outcome of its writer, True if the file of before is whole, and True if it is alone."""
    folder = tmp_path_factory.mktemp("full")
    done = subprocess.run([sys.executable, "-c", SCRIPT, folder], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_a_writer_on_a_full_disk_leaves_the_file_of_before(outcomes):
    assert {name: outcome for name, outcome in outcomes.items() if outcome != ["refused", True, True]} == {}
    assert len(outcomes) >= 19
