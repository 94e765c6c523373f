"""Mass matrices and gravity torques of URDF files by Pinocchio, for an interpreter without this library.

Input (JSON): a list of [file, held joints, postures]. Output (JSON): the versions, the folder of the files, and for
each arm the mass matrix and the gravity torques at each posture. An empty list returns folder and versions only.
"""

import importlib
import json
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

pin: Any = importlib.import_module("pinocchio")  # no type stubs
ROBOTS = Path(pin.__file__).parents[4] / "share/example-robot-data/robots"  # where the package has its files


def configuration(model: Any, angles: dict[str, float]) -> Any:
    """Return the configuration of a model at the angles (rad) or positions (m) of joints, zero for other joints."""
    result = pin.neutral(model)
    for name, value in angles.items():
        joint = model.joints[model.getJointId(name)]
        result[joint.idx_q : joint.idx_q + joint.nq] = value if joint.nq == 1 else (np.cos(value), np.sin(value))
    return result


def dynamics(file: str, held: dict[str, float], postures: list[list[float]]) -> list[Any]:
    """Return mass matrix (n, n) and gravity torques (n,), N m, of an arm at each posture (n,), rad."""
    model = pin.buildModelFromUrdf(file)
    if held:
        numbers = [model.getJointId(name) for name in held]
        model = pin.buildReducedModel(model, numbers, configuration(model, held))
    data, names, result = model.createData(), list(model.names)[1:], []
    for posture in postures:
        q = configuration(model, dict(zip(names, posture, strict=True)))
        upper = np.triu(pin.crba(model, data, q))
        gravity = pin.computeGeneralizedGravity(model, data, q)
        result.append([(upper + np.triu(upper, 1).T).tolist(), gravity.tolist()])
    return result


if __name__ == "__main__":
    packages = {name: version(name) for name in ("pin", "example-robot-data")}
    found = [dynamics(*case) for case in json.load(sys.stdin)]
    print(json.dumps({"versions": packages, "folder": str(ROBOTS), "dynamics": found}))
