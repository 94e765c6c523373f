"""Peers, compare: our runs and those of other codes on the paper's arm, which take turns."""

import importlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

import flexman_gym as fm
from studies.peers.runs import Timer
from studies.precision.cases import FINEST, LARGE_ROTATION, PLAIN, RIGID, RIGID_LINKS, models
from studies.precision.measure import Row, Study, Truth

ROUNDS = 3
FINE = [f"{mesh}, foreshortening" for mesh in ("1, 2 and 2 elements", "2 elements a link", "3 elements a link")]
# Of the loaded modes of a mesh those that are left when one after the other goes, each time the one without which the
# tip moves least in this scene; all that went moves it by 1.0 mm. Link 1 keeps all modes but the axial one, link 2 four
# of bending along each axis and two of torsion, link 3 two of bending along each axis and the first axial one.
CUT, CUT_MESH = "20 modes of 1, 3 and 3 elements, foreshortening", (1, 3, 3)
CUT_MODES = ((0, 1, 2, 3, 4), (0, 1, 2, 3, 4, 5, 6, 7, 8, 14), (0, 1, 2, 3, 9))
CHOSEN, TOLERANCE = "chosen for 4.5 mm with its mesh", 4.5e-3  # m, by `choose_model`, from the converged arm
GRID = {"extrapolated_euler_3": (1, 2, 3, 4, 5, 6), "extrapolated_euler_5": (1, 2, 3)}
GRID |= {"midpoint_2_sweeps": (1, 2, 3, 4, 5, 6), "midpoint_3_sweeps": (1, 2, 3, 4, 5, 6)}
GRID |= {"gauss_2_sweeps": (1, 2, 3, 4), "gauss_3_sweeps": (1, 2, 3, 4)}
GRID["implicit_midpoint"] = (2, 3, 4, 5, 6, 100)  # the last for the error of the model alone
MORE = {"extrapolated_euler_4": (1, 2, 3), "ros2": (5, 10), "generalised_alpha": range(4, 7)}  # where time errors count
PEERS = {"MuJoCo": "mujoco", "Exudyn": "exudyn", "Pinocchio": "pin", "SoRoMoX": "soromox"}  # name: package
ROOMS = {"MuJoCo": ("mujoco", "rods"), "Exudyn": ("exudyn",), "Pinocchio": ("pinocchio",), "SoRoMoX": ("soromox",)}


def truth(reference: Path) -> Truth:
    """The tip of an independent code in a folder of reference solutions; its floor is the distance to our finest."""
    tip, scene = np.loadtxt(reference / LARGE_ROTATION, delimiter=",", skiprows=1)[:, 1:4], fm.catalog.paper_scene("ff")
    finest = fm.simulate(scene, models(scene)[FINEST], "implicit_midpoint", step=1e-4)
    return Truth(tip, Truth(tip, 0.0, "").distance(finest), LARGE_ROTATION)


def study(known: Truth) -> Study:
    """The scene with its truth, our models, and the converged solution of the one whose time error counts."""
    scene = fm.catalog.paper_scene("ff")
    built = models(scene) | {CUT: fm.build_model(scene.arm, CUT_MESH, CUT_MODES, stiffening=True)}
    built[CHOSEN] = chosen().model
    plain = Truth(fm.simulate(scene, built[PLAIN], "rk4", step=1e-4).tip, 2e-8, "rk4, 0.1 ms")
    return Study("paper_ff", scene, built, known, {PLAIN: plain})


def chosen() -> fm.Choice:
    """The choice for the scene with an open mesh; found once."""
    scene = fm.catalog.paper_scene("ff")
    return fm.choose_model(replace(scene, model=replace(scene.model, elements=None)), TOLERANCE)


def ours(result: Study) -> list[Timer]:
    """Our runs: fine models against the truth, the paper's own model, whose time error counts, and rigid ones."""
    timers: list[Timer] = []
    for model in [CUT, *FINE, PLAIN]:
        for method, parts in (GRID | (MORE if model == PLAIN else {})).items():
            timers += [lambda a=(model, method, 0.01 / part): result.row(*a) for part in parts]  # type: ignore[misc]
    choice = chosen()
    timers.append(lambda: result.row(CHOSEN, choice.method, choice.step))
    rigid = (RIGID, 1e-3), (RIGID_LINKS, 5e-3)
    return timers + [lambda a=(model, "rk4", step): result.row(*a) for model, step in rigid]


def theirs(result: Study) -> list[Timer]:
    """Those of the peers that are installed."""
    timers: list[Timer] = []
    for name, rooms in ROOMS.items():
        try:
            timers += [each for room in rooms for each in importlib.import_module(f"studies.peers.{room}").runs(result)]
        except ModuleNotFoundError:
            print(f"{name} is missing, so it is left out: pip install 'flexman_gym[peers]'")
    return timers


def in_turns(timers: Sequence[Timer]) -> list[Row]:
    """A row of each, with the lowest cost of all rounds."""
    rounds = [[timer() for timer in timers] for _ in range(ROUNDS)]
    best = [min(rows, key=lambda row: row.cpu) for rows in zip(*rounds, strict=True)]
    return sorted(best, key=lambda row: (row.model, row.method, -(row.step or 0.0)))


def of_peers(rows: Sequence[Row]) -> list[Row]:
    """The rows of other codes, one code after the other."""
    return [row for name in PEERS for row in rows if row.model.startswith(name)]
