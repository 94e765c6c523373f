"""Scenes with an effect of joints, for derivatives of motions."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

import flexman_gym as fm
from flexman_gym.common.arrays import Array
from flexman_gym.model.model import Model, scene_model
from flexman_gym.simulation.methods import Method
from flexman_gym.simulation.physical_parameters import nominal_parameters
from flexman_gym.toolbox.sensitivity.differentiation import find_directions

Z = (0.0, 0.0, 1.0)
OUTPUTS = ("tip", "tip_velocity", "joint_angles", "motor_rates", "root_strains", "kinetic_energy", "elastic_energy",
           "gravitational_energy")  # fmt: skip
TIMES, TORQUES = (0.0, 0.11, 0.25, 0.4), ((1.2, 0.4), (-0.6, -0.3), (0.5, 0.2), (0.0, 0.1))  # s; N m
MOTOR: dict[str, Any] = {"gear_ratio": 100.0, "torque_constant": 0.05, "rotor_inertia": 2e-6}
RIPPLE: dict[str, Any] = {"torque_ripple": 0.002, "ripple_cycles": 2.0}
VOLTAGE: dict[str, Any] = {"resistance": 2.0, "back_emf_constant": 0.01}
COULOMB: dict[str, Any] = {"coulomb_friction": 0.1, "coulomb_rate": 0.3, "static_friction": 0.14, "stribeck_rate": 0.5}
GAP: dict[str, Any] = {"backlash": 1e-3, "stiffness_pieces": ((0.5, 0.6), (1.5, 0.8))}
ALL = ("friction", "backlash", "ripple")
# parameter -> index of the part, and size, where the nominal value is not the size
PARTS: dict[str, tuple[int | None, float | None]] = {
    "payload_mass": (None, None), "joint_stiffness": (0, None), "joint_damping": (1, None), "rotor_inertia": (1, None),
    "viscous_friction": (0, None), "coulomb_friction": (0, None), "coulomb_rate": (0, None),
    "static_excess": (0, None), "stribeck_rate": (0, None), "backlash": (1, None), "soft_stiffness": (1, None),
    "ripple_torque": (0, None), "link_stiffness_factor": (0, None), "link_damping": (1, None),
    "initial_joint_angles": (0, 0.1), "initial_joint_rates": (1, 0.5), "motor_torques": (1, 0.3),
    "tip_force": (1, 1.0), "base_acceleration": (0, 1.0),
}  # fmt: skip
OF_MOTORS = ("rotor_inertia", "motor_torques")  # a passive joint lacks them


def scene(effects: Sequence[str] = ALL) -> fm.Scene:
    """Return a planar arm under gravity for 0.4 s, with effects of its joints.

    Args:
        effects: "friction", "backlash", "ripple", "voltage" or "passive".
    """
    strip = fm.Link.strip(0.5, 0.04, 0.003)
    motor = fm.Motor(**MOTOR, **(RIPPLE if "ripple" in effects else {}), **(VOLTAGE if "voltage" in effects else {}))
    friction: dict[str, Any] = COULOMB if "friction" in effects else {}
    first = fm.Joint(Z, stiffness=60.0, damping=0.05, motor=motor, viscous_friction=0.05, **friction)
    passive = "passive" in effects
    own: dict[str, Any] = {"passive": True, "stiffness": 2.0} if passive else {"rotor_inertia": 0.01, "stiffness": 40.0}
    second = fm.Joint(Z, damping=0.02, **own, **(GAP if "backlash" in effects else {}))
    arm = fm.Arm([strip, strip], [first, second], fm.Payload(0.1, offset=(0.02, 0.0, 0.0)), gravity=(0.0, -9.81, 0.0),
                 modal_damping_ratio=0.01)  # fmt: skip
    choice = fm.ModelChoice(flexible_links=(True, True), elements=(2, 2), modes=(2, 2))
    torque = fm.SampledTorque(TIMES, (np.array(TORQUES) * (1.0, not passive)).tolist())
    initial = fm.Initial(joint_angles=(0.2, -0.4), joint_rates=(0.5, 0.1))
    return fm.Scene(arm, choice, torque, initial, duration=0.4, output_step=0.02)


def outputs_of(trajectory: Any) -> Array:
    """Return the outputs (T, m) of a trajectory in the order of OUTPUTS, with kinetic and elastic energy added."""
    readings, energy = trajectory.readings, trajectory.moving_energy
    return np.column_stack(
        [trajectory.tip, trajectory.tip_velocity, trajectory.joint_angles, readings["motor_rates"],
         readings["root_strains"], energy, trajectory.energy - energy]
    )  # fmt: skip


def reduced(values: Array) -> Array:
    """Return outputs (T, m, ...) of sensitivities with kinetic and elastic energy added, as in `outputs_of`."""
    return np.concatenate([values[:, :-3], values[:, -3:-2] + values[:, -2:-1], values[:, -1:]], axis=1)


@dataclass(frozen=True)
class ChangedScene:
    """Simulations of a scene with changes of one parameter.

    Attributes:
        scene: the scene.
        method: method.
        step: step, s.
    """

    scene: fm.Scene
    method: str | Method
    step: float

    @cached_property
    def model(self) -> Model:
        """Model of the scene."""
        return scene_model(self.scene)

    def parameters(self) -> Iterator[tuple[str, float]]:
        """Yield name and size of one parameter of each kind that the arm has."""
        nominal = nominal_parameters(self.model)
        for name, (part, size) in PARTS.items():
            try:
                parts = [index for _, index in find_directions(name, self.model, ())
                         if name not in OF_MOTORS or not self.scene.arm.joints[index or 0].passive]  # fmt: skip
            except ValueError:  # the arm lacks it
                continue
            index = part if part in parts else parts[0]
            value = size or float(np.ravel(nominal[name])[index or 0])
            yield (name if index is None else f"{name}[{index}]"), value or 1.0

    def outputs(self, text: str, changes: Array) -> Array:
        """Return the outputs (c, T, m) with changes (c,) of a parameter."""
        name, _, part = text.partition("[")
        index = int(part[:-1]) if part else None
        parameters: dict[str, Any] = {}
        scenes = [self._changed(name, index or 0, change) for change in changes.tolist()]
        if name in (nominal := nominal_parameters(self.model)):
            values = np.repeat(nominal[name][None].astype(float), len(changes), axis=0)
            values[(slice(None),) if index is None else (slice(None), index)] += changes
            parameters = {name: values}
        runs = fm.simulate_all(scenes, method=self.method, step=self.step, **parameters)
        return np.array([outputs_of(run) for run in runs])

    def _changed(self, name: str, index: int, change: float) -> fm.Scene:
        """Return the scene with a change of its start or of an input; that of a physical parameter does not change."""
        given = self.scene
        if name.startswith("initial_"):
            field = name.removeprefix("initial_")
            values = np.array(getattr(given.initial, field))
            values[index] += change
            return replace(given, initial=replace(given.initial, **{field: tuple(values)}))
        if name == "motor_torques":
            torques: Any = given.torque
            values = np.array(torques.values)
            values[:, index] += change
            return replace(given, torque=fm.SampledTorque(torques.times, values.tolist()))
        if name in ("tip_force", "base_acceleration"):
            signals: Any = [fm.Signal(offset=change * (axis == index)) for axis in range(3)]
            return replace(given, **{name: signals})
        return given
