"""Write the linear arm of the experiment in docs/concepts.md: python scripts/ringing.py --folder docs/assets

ringing_arm.js: matrices of the arm of FlexOne-v0 about rest, affine in payload and joint stiffness, with the gains and
the input shapers designed for the nominal arm. ringing.js simulates this arm in the browser.
"""

import argparse
import json
from typing import Any

import numpy as np

import flexman_gym as fm
from flexman_gym.common.arrays import Array
from flexman_gym.envs.tasks.rewards import NEAR
from flexman_gym.model.deformation import link_shapes
from flexman_gym.model.model import Model
from flexman_gym.model.state_space import LinearModel
from flexman_gym.simulation.physical_parameters import varied_model
from flexman_gym.toolbox.controllers.cost_weights import NamedWeights
from flexman_gym.toolbox.controllers.excited_modes import excited_modes
from flexman_gym.toolbox.controllers.input_shaping.shapers import design_shaper
from studies.files import folder

FILE = "ringing_arm.js"
PERIOD, DURATION = 0.002, 5.0  # s; control period and length of the experiment
ANGLE = 0.5  # rad; slew of the motor
IMPULSE, IMPULSE_TIME = 0.02, 3.0  # N s; s; impulse on the tip
SERVO_FACTOR = 40.0  # 1; stiffness of the motor controller / joint stiffness, so that the motor follows its command
POINTS = 13  # number of points of the drawn link


def nominal_model() -> Model:
    """Return the model of the arm of FlexOne-v0 with two bending modes of its link: four coordinates."""
    return fm.build_model(fm.catalog.one_joint(), elements=2, modes=2)


def changed_model(model: Model, payload: float, factor: float) -> Model:
    """Return the model of the arm with a payload (kg) and a factor on its joint stiffness, in the same coordinates."""
    return varied_model(model, payload_mass=payload, joint_stiffness=factor * model.constants.joint_stiffness)


def linear_model(model: Model, payload: float, factor: float) -> LinearModel:
    """Return the linear model about rest by motor torque and tip force; arguments as in `changed_model`."""
    return fm.linearize(changed_model(model, payload, factor), inputs=("motor_torques", "tip_force"))


def matrices(model: Model, payload: float, factor: float) -> tuple[Array, Array, Array]:
    """Return mass, stiffness and damping matrix (d, d) about rest; arguments as in `changed_model`."""
    form = linear_model(model, payload, factor).balance
    assert form is not None
    stiffness, damping, _ = np.split(-form.forces, [model.n_dof, 2 * model.n_dof], axis=1)
    return form.mass, stiffness, damping


def designs(model: Model) -> dict[str, Any]:
    """Return gains (2 d,) of motor controller and LQR, feed-forward inertia and shapers of the nominal arm."""
    d, (motor,), limits = model.n_dof, model.motor_columns, np.array([model.arm.joints[0].torque_limit])
    rotor, stiffness = model.arm.joints[0].rotor_inertia, SERVO_FACTOR * float(model.constants.joint_stiffness[0])
    servo = np.zeros(2 * d)
    servo[[motor, d + motor]] = stiffness, 2.0 * np.sqrt(stiffness * rotor)  # critical damping of the rotor
    nominal = fm.linearize(model)
    regulator = NamedWeights.of_reach(model).gain(nominal, model.motor_columns, limits, PERIOD)[0]
    rigid = np.zeros(d)
    rigid[[0, motor]] = 1.0  # rotation of the undeformed arm
    frequency, ratio, _ = excited_modes(model, [0.0])[0]
    shapers = {name: design_shaper(name, frequency, ratio)._asdict() for name in ("zv", "zvd")}
    assert nominal.balance is not None
    return {
        "servo": servo, "lqr": regulator, "inertia": rigid @ nominal.balance.mass @ rigid, "shapers": shapers,
        "frequency": frequency, "limit": limits[0],
    }  # fmt: skip


def arm_data(model: Model) -> dict[str, Any]:
    """Return the data of the experiment, in SI units; coordinates: joint and motor angle, then two bending modes."""
    d, length, payload = model.n_dof, model.arm.links[0].length, model.arm.payload
    assert payload is not None
    mass, stiffness, damping = matrices(model, 0.0, 1.0)
    by_payload, by_factor = matrices(model, 1.0, 1.0)[0] - mass, matrices(model, 0.0, 2.0)[1] - stiffness
    shapes = np.zeros((POINTS, d))  # lateral displacement of the points by the coordinates
    shapes[:, model.elastic_columns(0)] = link_shapes(model, POINTS)[0].rows[:, 1]
    return {
        "period": PERIOD, "duration": DURATION, "angle": ANGLE, "impulse": IMPULSE, "impulseTime": IMPULSE_TIME,
        "length": length, "band": NEAR * length, "payload": payload.mass,
        "mass": mass, "massByPayload": by_payload, "stiffness": stiffness - by_factor, "stiffnessByFactor": by_factor,
        "damping": damping, "tip": linear_model(model, payload.mass, 1.0).C[1, :d], "shapes": shapes,
    } | designs(model)  # fmt: skip


def main() -> None:
    """Write the file and print its size."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=folder, default="out", help="output folder")
    path = parser.parse_args().folder / FILE
    lines = [f"  {json.dumps(name)}: {json.dumps(value, default=np.ndarray.tolist)}"
             for name, value in arm_data(nominal_model()).items()]  # fmt: skip
    text = "// Written by scripts/ringing.py.\nconst ringingArm = {\n" + ",\n".join(lines) + "\n};\n"
    path.write_text(text, encoding="utf-8")
    print(f"{path}: {path.stat().st_size / 1e3:.1f} kB")


if __name__ == "__main__":
    main()
