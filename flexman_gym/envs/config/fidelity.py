"""Fidelity of an environment: model, method and step chosen for a tolerance."""

from typing import Any

from flexman_gym.common.checks import positive
from flexman_gym.fidelity.choose import Choice, choose_model
from flexman_gym.scene.scene import Initial, ModelChoice, Scene
from flexman_gym.scene.signals import SineTorque

SLEW, SLEW_START = 3.0, 0.4  # s and rad, of the motion for which it chooses


def choose_fidelity(setup: Any) -> Choice:
    """Chooses for a slew: sine torques of the limits from a posture in the middle of the range of the named task."""
    n = setup.arm.n_joints
    start = [SLEW_START * (-1.0) ** i for i in range(n)]
    steps = max(1, round(SLEW / setup.control_period))
    scene = Scene(
        setup.arm,
        ModelChoice(True, 2, spinning_rotors=setup.spinning_rotors, rotary_inertia=setup.rotary_inertia),
        SineTorque(setup.torque_limit, [0.5] * n, [0.0] * n),
        Initial(start, [0.0] * n),
        duration=steps * setup.control_period,
        output_step=setup.control_period,
    )
    tolerance = positive("tolerance", setup.tolerance, "m")
    return choose_model(scene, tolerance, longest_step=setup.control_period)
