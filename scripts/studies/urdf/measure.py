"""Comparison of arms read from URDF files with Pinocchio, and with themselves after an export."""

import json
import subprocess
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import flexman_gym as fm
from flexman_gym.common.arrays import Array
from flexman_gym.toolbox.interchange.urdf_export import to_urdf

PEER = Path(__file__).with_name("peer.py")
POSTURES = 10  # number of random postures
FINGERS = {"panda_finger_joint1": 0.01, "panda_finger_joint2": 0.02}  # m
ARMS: dict[str, tuple[str, str | None, dict[str, float]]] = {  # name -> file of example-robot-data, tip, held joints
    "UR5": ("ur_description/urdf/ur5_robot.urdf", "tool0", {}),
    "Panda": ("panda_description/urdf/panda.urdf", "panda_hand", FINGERS),
    "Kinova": ("kinova_description/robots/kinova.urdf", "j2s6s200_end_effector", {}),
}


@dataclass(frozen=True)
class UrdfRow:
    """Largest difference at random postures, relative to the largest entry of the matrix or vector.

    Attributes:
        arm: name.
        joints: number of joints.
        postures: number of postures.
        mass_matrix: difference of the mass matrix from Pinocchio, 1.
        gravity_torques: difference of the gravity torques from Pinocchio, 1.
        exported_mass_matrix: difference of the mass matrix after an export and an import, 1.
        exported_gravity_torques: difference of the gravity torques after an export and an import, 1.
    """

    arm: str
    joints: int
    postures: int
    mass_matrix: float
    gravity_torques: float
    exported_mass_matrix: float
    exported_gravity_torques: float


def measured(python: str) -> tuple[list[UrdfRow], dict[str, str]]:
    """Return the rows of all arms and the versions of the packages; `python` is an interpreter with Pinocchio."""
    folder, rng = Path(_peer(python, [])["folder"]), np.random.default_rng(0)
    arms = {name: fm.Arm.from_urdf(folder / file, tip=tip, held=held) for name, (file, tip, held) in ARMS.items()}
    postures = {name: rng.uniform(-np.pi, np.pi, (POSTURES, arm.n_joints)) for name, arm in arms.items()}
    cases = [[str(folder / file), held, postures[name].tolist()] for name, (file, _, held) in ARMS.items()]
    answer, rows = _peer(python, cases), []
    for (name, arm), theirs in zip(arms.items(), answer["dynamics"], strict=True):
        own, again = dynamics(arm, postures[name]), dynamics(exported(arm), postures[name])
        pairs = [[np.array(each) for each in pair] for pair in theirs]
        rows.append(UrdfRow(name, arm.n_joints, POSTURES, *differences(own, pairs), *differences(again, own)))
    return rows, answer["versions"]


def _peer(python: str, cases: list[Any]) -> dict[str, Any]:
    """Return the output of peer.py; its interpreter gets none of our variables."""
    done = subprocess.run(
        [python, str(PEER)], input=json.dumps(cases), capture_output=True, text=True, check=True, env={}
    )
    result: dict[str, Any] = json.loads(done.stdout)
    return result


def dynamics(arm: fm.Arm, postures: Array) -> list[list[Array]]:
    """Return mass matrix (n, n) and gravity torques (n,), N m, of a rigid arm at postures (k, n), rad."""
    model = fm.build_model(arm, flexible_links=False, flexible_joints=False)
    states = np.hstack([postures, np.zeros_like(postures)])
    return [[fm.mass_matrix(model, x), fm.holding_torques(model, x[: arm.n_joints])] for x in states]


def exported(arm: fm.Arm) -> fm.Arm:
    """Return an arm after an export to URDF and an import."""
    text, sidecar = to_urdf(arm)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "arm.urdf"
        path.write_text(text, encoding="utf-8")
        return fm.Arm.from_urdf(path, sidecar)


def differences(first: list[list[Array]], second: list[list[Array]]) -> tuple[float, float]:
    """Return the largest relative differences of mass matrices and of gravity torques."""
    errors = [[float(np.abs(a - b).max() / np.abs(b).max()) for a, b in zip(*each, strict=True)]
              for each in zip(first, second, strict=True)]  # fmt: skip
    mass, gravity = np.max(errors, axis=0)
    return float(mass), float(gravity)
