"""Scenes of an arm with changed dimensions and materials, for derivatives of motions."""

from typing import Any

import numpy as np

import flexman_gym as fm
from flexman_gym.common.arrays import Array

Z, Y = (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)
NOMINAL = {
    "link_length[0]": 0.5, "link_length[1]": 0.4, "link_width[0]": 0.04, "link_thickness[0]": 0.003,
    "link_diameter[1]": 0.02, "link_wall[1]": 0.002, "link_youngs_modulus[0]": 68.9e9, "link_shear_modulus[0]": 26.0e9,
    "link_density[1]": 2700.0, "gear_ratio[0]": 100.0,
}  # fmt: skip
OUTPUTS = ("tip", "tip_velocity", "motor_rates", "root_strains", "kinetic_energy", "elastic_energy")


def arm(payload: float = 0.1, **changes: float) -> fm.Arm:
    """Return a strip and a tube, bent out of plane by gravity, with given values of the parameters in NOMINAL."""
    given = {name.partition("[")[0]: value for name, value in (NOMINAL | changes).items()}
    length, outer = (NOMINAL | changes)["link_length[0]"], given["link_length"]
    first = fm.Link.strip(length, given["link_width"], given["link_thickness"], masses=[fm.LumpedMass(0.05, length)],
                          material=(given["link_youngs_modulus"], given["link_shear_modulus"], 2700.0))  # fmt: skip
    second = fm.Link.tube(outer, given["link_diameter"], given["link_wall"],
                          material=(68.9e9, 26.0e9, given["link_density"]))  # fmt: skip
    motor = fm.Motor(given["gear_ratio"], 0.05, 2e-6, torque_ripple=0.01, ripple_cycles=0.05)
    joints = [fm.Joint(Z, stiffness=60.0, motor=motor), fm.Joint(Y, 0.01, stiffness=40.0)]
    load = fm.Payload(payload, offset=(0.0, 0.02, 0.0)) if payload else None
    return fm.Arm([first, second], joints, load, gravity=(0.0, -9.81, 0.0), modal_damping_ratio=0.02)


def scene(given: fm.Arm, **choice: Any) -> fm.Scene:
    """Return a motion of 0.1 s under constant torques; `choice` as in `ModelChoice`."""
    start = fm.Initial((0.2, -0.4), (0.5, 0.1))
    return fm.Scene(given, fm.ModelChoice((True, True), **choice), fm.ConstantTorque((1.2, -0.6)), start, duration=0.1,
                    output_step=0.02)  # fmt: skip


def outputs_of(run: Any) -> Array:
    """Return the outputs (T, m) of a simulation in the order of OUTPUTS, with both energies added."""
    return np.column_stack(
        [run.tip, run.tip_velocity, run.readings["motor_rates"], run.readings["root_strains"], run.moving_energy]
    )


def reduced(values: Array) -> Array:
    """Return outputs (T, m, ...) of sensitivities with both energies added."""
    return np.concatenate([values[:, :-2], values[:, -2:].sum(axis=1, keepdims=True)], axis=1)
