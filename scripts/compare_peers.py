"""Charts our runs beside those of other codes on the paper's arm: python scripts/compare_peers.py --folder docs"""

import argparse
import importlib
from pathlib import Path

import numpy as np

import flexman_gym as fm
from flexman_gym.studies.machine import machine_text
from flexman_gym.studies.peers.runs import Timer
from flexman_gym.studies.precision.cases import FINEST, LARGE_ROTATION, PLAIN, RIGID, RIGID_LINKS, models
from flexman_gym.studies.precision.charts import peers_chart
from flexman_gym.studies.precision.measure import Row, Study, Truth
from flexman_gym.studies.precision.page import peers_conclusion
from flexman_gym.studies.table import read_rows, write_rows

REFERENCE = Path(__file__).parents[1] / "tests" / "reference" / LARGE_ROTATION
ROUNDS = 3
FINE = [f"{mesh}, foreshortening" for mesh in ("1, 2 and 2 elements", "2 elements a link", "3 elements a link")]
# Of the loaded modes of a mesh those that are left when one after the other goes, each time the one without which the
# tip moves least in this scene; all that went moves it by 1.0 mm. Link 1 keeps all modes but the axial one, link 2 four
# of bending along each axis and two of torsion, link 3 two of bending along each axis and the first axial one.
CUT, CUT_MESH = "20 modes of 1, 3 and 3 elements, foreshortening", (1, 3, 3)
CUT_MODES = ((0, 1, 2, 3, 4), (0, 1, 2, 3, 4, 5, 6, 7, 8, 14), (0, 1, 2, 3, 9))
GRID = {"extrapolated_euler_3": (1, 2, 3, 4, 5, 6), "extrapolated_euler_5": (1, 2, 3)}
GRID["implicit_midpoint"] = (2, 3, 4, 5, 6, 100)  # the last for the error of the model alone
MORE = {"extrapolated_euler_4": (1, 2, 3), "ros2": (5, 10), "generalised_alpha": range(4, 7)}  # where time errors count
PEERS = {"MuJoCo": "mujoco", "Exudyn": "exudyn", "Pinocchio": "pin"}  # name: package
ROOMS = {"MuJoCo": "mujoco", "Exudyn": "exudyn", "Pinocchio": "pinocchio"}
NOTE = """The rows are in `peers.csv`. Each run takes the paper's arm, everything flexible, through 2 s under 400 N m.
The error is the largest distance of the tip from an independent large-rotation code, the cost is CPU time on one core:
the best of {} rounds in which all take turns.

- MuJoCo: every link 4 or 8 rigid pieces between springs, or one rigid link; compiled. Its `discrete` integrator eats
  the vibration.
- Exudyn: a floating frame of reference with 2 beam elements a link, the same mass points, shapes and stiffness as our
  model without foreshortening; generalised-alpha method; compiled, without range checks or user functions. Once with
  the settings that are quickest here, once with its default ones. Where links bend out of a plane it treats the
  rotation of their tips a little differently: its converged tip is within 5 mm of ours. Its time error is that from
  its own converged run.
- Pinocchio: rigid links and joints; its compiled `aba` called from a Runge-Kutta loop in Python.

The rigid arms show what flexibility costs, and what it costs to leave it out."""


def ours(study: Study) -> list[Timer]:
    """Our runs: fine models against the truth, the paper's own model, whose time error counts, and rigid ones."""
    found: list[Timer] = []
    for model in [CUT, *FINE, PLAIN]:
        for method, parts in (GRID | (MORE if model == PLAIN else {})).items():
            found += [lambda a=(model, method, 0.01 / part): study.row(*a) for part in parts]  # type: ignore[misc]
    rigid = (RIGID, 1e-3), (RIGID_LINKS, 5e-3)
    return found + [lambda a=(model, "rk4", step): study.row(*a) for model, step in rigid]


def theirs(study: Study) -> list[Timer]:
    """Those of the peers that are installed."""
    found: list[Timer] = []
    for name, room in ROOMS.items():
        try:
            found += importlib.import_module(f"flexman_gym.studies.peers.{room}").runs(study)
        except ImportError:
            print(f"{name} is missing, so it is left out: pip install 'flexman_gym[peers]'")
    return found


def in_turns(timers: list[Timer]) -> list[Row]:
    """A row of each, with the lowest cost of all rounds."""
    rounds = [[timer() for timer in timers] for _ in range(ROUNDS)]
    best = [min(rows, key=lambda row: row.cpu) for rows in zip(*rounds, strict=True)]
    return sorted(best, key=lambda row: (row.model, row.method, -(row.step or 0.0)))


def publish(rows: list[Row], floor: float, folder: Path) -> None:
    """Draws the rows and writes a page about them."""
    others = {name: [row for row in rows if row.model.startswith(name)] for name in PEERS}
    peers = [row for found in others.values() for row in found]
    mine = [row for row in rows if row not in peers]
    peers_chart(mine, peers, floor, "The paper's arm, everything flexible", folder / "work_precision_peers.png")
    known = machine_text(PEERS[name] for name, found in others.items() if found)
    lines = ["# Beside other codes", "", NOTE.format(ROUNDS), "", "![error over cost](work_precision_peers.png)", ""]
    lines += [f"Computed with {known}, one core.", ""]
    lines += [f"- {text}" for text in peers_conclusion(mine, peers, PLAIN)]
    (folder / "peers.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    print("\n".join(lines[-5:]))


def main() -> None:
    """Reads the command line, runs everything in turns, and writes rows, a picture and a page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--redraw", action="store_true", help="only draw and write about the rows of an earlier run")
    parser.add_argument("--folder", type=Path, default=Path("out"), help="where rows, picture and page go")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    file = options.folder / "peers.csv"
    scene = fm.catalog.paper_scene("ff")
    tip, built = np.loadtxt(REFERENCE, delimiter=",", skiprows=1)[:, 1:4], models(scene)
    built[CUT] = fm.build_model(scene.arm, CUT_MESH, CUT_MODES, stiffening=True)
    finest = Truth(tip, 0.0, "").distance(fm.simulate(scene, built[FINEST], "implicit_midpoint", step=1e-4))
    if not options.redraw:
        plain = Truth(fm.simulate(scene, built[PLAIN], "rk4", step=1e-4).tip, 2e-8, "rk4, 0.1 ms")
        study = Study("paper_ff", scene, built, Truth(tip, finest, LARGE_ROTATION), {PLAIN: plain})
        write_rows(in_turns(ours(study) + theirs(study)), file)
    publish(read_rows(file, Row), finest, options.folder)


if __name__ == "__main__":
    main()
