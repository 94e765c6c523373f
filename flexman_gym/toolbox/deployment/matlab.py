"""Export of linear models and gains as a .mat file."""

from pathlib import Path
from typing import Any

import numpy as np

from flexman_gym.common.arrays import Vector
from flexman_gym.common.checks import vector
from flexman_gym.common.files import write_file
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.model.statics import holding_torques, rest_state
from flexman_gym.scene.serialization import SUFFIXES
from flexman_gym.simulation.linearization import linearize
from flexman_gym.toolbox.deployment.c_code import begin_agent

OUTPUTS = ("tip", "tip_velocity", "motor_angles", "motor_rates", "joint_twists", "root_strains")


def write_matlab(name: str, path: Path, environment: str = "", goal: Vector | None = None) -> list[str]:
    """Write the linear model of an arm at rest, and the gains of an agent, as a .mat file.

    The file has A, B, C and D of the continuous model, Ad and Bd of the model sampled with the control period, names
    with units, the posture (rad) with its holding torques (N m), and for an agent the structure `agent` with its gains.
    Inputs and rows of the gains are those of the motors, without passive joints.

    Args:
        name: agent as in `begin_agent`, or an environment.
        path: path of the file.
        environment: environment of an agent, as in `begin_agent`.
        goal: (n,) motor angles, rad; None for zero, or for an agent for the goal of the first test episode.

    Returns:
        Names of the variables.
    """
    from scipy.io import savemat

    data: dict[str, Any] = {}
    if name.partition("/")[0] in NAMED_ENVIRONMENTS or name.endswith(SUFFIXES):
        bare = Configuration.find(name)
        model = resolve_fidelity(bare).model
        posture = np.zeros(model.n_joints) if goal is None else np.array(vector("goal", goal, model.n_joints, "rad"))
    else:
        move: dict[str, Any] = {} if goal is None else {"goal_angles": goal}
        session = begin_agent(name, environment, **move)
        program, bare, posture = session.program(), session.environment, session.move[1]
        model = session.episodes.batch.model
        tables = program.constants | program.rows | program.matrices
        motors = model.constants.passive == 0
        data["agent"] = tables | {each: tables[each][..., motors, :] for each in ("gains", "K") if each in tables}
    holding = holding_torques(model, posture)
    linear = linearize(model, state=rest_state(model, posture), torque=holding, outputs=OUTPUTS)
    sampled = linear.discrete(bare.control_period)
    data |= dict(zip("ABCD", linear, strict=True)) | {"Ad": sampled.A, "Bd": sampled.B, "period": bare.control_period}
    data |= {each: np.array(getattr(linear, each), dtype=object) for each in ("states", "inputs", "outputs")}
    data |= {"posture": posture, "holding_torques": holding, "torque_limit": np.array(bare.torque_limit)}
    write_file(path, lambda file: savemat(file, data, oned_as="column"))
    return sorted(data)
