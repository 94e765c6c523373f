"""Charts our runs beside MuJoCo's on the paper's arm: python scripts/compare_peers.py --folder docs"""

import argparse
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

import numpy as np

import flexman_gym as fm
from flexman_gym.charts import peers_chart
from flexman_gym.precision import Row, Study, Truth, read_rows, write_rows
from flexman_gym.precision_cases import FINEST, LARGE_ROTATION, PLAIN, models
from flexman_gym.precision_page import peers_conclusion
from flexman_gym.verification import machine_text

REFERENCE = Path(__file__).parents[1] / "tests" / "reference" / LARGE_ROTATION
ROUNDS = 2
FINE = [f"{mesh}, foreshortening" for mesh in ("1, 2 and 2 elements", "2 elements a link", "3 elements a link")]
GRID = {"extrapolated_euler_3": (1, 2, 3, 4, 5, 6), "extrapolated_euler_5": (1, 2, 3), "implicit_midpoint": range(2, 7)}
Timer = Callable[[], Row]
NOTE = """The rows are in `peers.csv`. MuJoCo's links are 4 or 8 rigid pieces between springs; Exudyn is left out,
since its floating frame needs finite-element data that nobody has written here.
Each run takes the paper's arm with everything flexible through 2 s under 400 N m; the error is the largest distance of
the tip from an independent large-rotation code. The cost is CPU time, the best of {} rounds in which all take turns."""


def ours(study: Study) -> list[Timer]:
    """Our runs: fine models against the truth, and the paper's own model, whose time error counts."""
    found: list[Timer] = []
    for model in [*FINE, PLAIN]:
        for method, parts in GRID.items():
            found += [lambda a=(model, method, 0.01 / part): study.row(*a) for part in parts]  # type: ignore[misc]
    return found


def mujoco(study: Study) -> list[Timer]:
    """Those of MuJoCo, none where it is not installed."""
    try:
        from peers_mujoco import stable_runs
    except ImportError:
        print("MuJoCo is missing, so it is left out: pip install 'flexman_gym[peers]'")
        return []
    return stable_runs(study)


def in_turns(timers: list[Timer]) -> list[Row]:
    """A row of each, with the lowest cost of all rounds."""
    rounds = [[timer() for timer in timers] for _ in range(ROUNDS)]
    best = [min(rows, key=lambda row: row.cpu) for rows in zip(*rounds, strict=True)]
    return sorted(best, key=lambda row: (row.model, row.method, -(row.step or 0.0)))


def publish(rows: list[Row], floor: float, folder: Path) -> None:
    """Draws the rows and writes a page about them."""
    mine = [row for row in rows if not row.model.startswith("MuJoCo")]
    peers: dict[str, list[Row]] = {}
    for row in rows:
        if row not in mine:
            peers.setdefault(f"{row.model}, {row.method}", []).append(row)
    peers_chart(mine, peers, floor, "The paper's arm, everything flexible", folder / "work_precision_peers.png")
    known = machine_text(**({"mujoco": version("mujoco")} if peers else {}))
    lines = ["# Beside other codes", "", NOTE.format(ROUNDS), "", "![error over cost](work_precision_peers.png)", ""]
    lines += [f"Computed with {known}, one core.", ""]
    lines += [f"- {text}" for text in peers_conclusion(mine, [row for row in rows if row not in mine], PLAIN)]
    (folder / "peers.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    print("\n".join(lines[-3:]))


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
    finest = Truth(tip, 0.0, "").distance(fm.simulate(scene, built[FINEST], "implicit_midpoint", step=1e-4))
    if not options.redraw:
        plain = Truth(fm.simulate(scene, built[PLAIN], "rk4", step=1e-4).tip, 2e-8, "rk4, 0.1 ms")
        study = Study("paper_ff", scene, built, Truth(tip, finest, LARGE_ROTATION), {PLAIN: plain})
        write_rows(in_turns(ours(study) + mujoco(study)), file)
    publish(read_rows(file, Row), finest, options.folder)


if __name__ == "__main__":
    main()
