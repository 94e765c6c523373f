"""Fidelity of an environment: model, integration method and step, as configured or chosen for a tolerance."""

from typing import TYPE_CHECKING, NamedTuple

from flexman_gym.common.checks import positive
from flexman_gym.common.registry import load_entry
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.model.assembled_modes import assembled_modes
from flexman_gym.model.model import Model, build_model
from flexman_gym.scene.scene import Initial, ModelChoice, Scene
from flexman_gym.scene.signals import SineTorque
from flexman_gym.simulation.methods import Method

if TYPE_CHECKING:
    from flexman_gym.toolbox.fidelity.model_selection import Choice

SLEW_DURATION = 3.0  # s; duration of the slew for which fidelity="auto" chooses the model
SLEW_START = 0.4  # rad; magnitude of the joint angles at its start, with alternating signs


class _Fidelity(NamedTuple):
    """Model of an environment, integration method, step (s), and result of fidelity="auto", else None."""

    model: Model
    method: str | Method
    step: float
    choice: "Choice | None"


def resolve_fidelity(configuration: Configuration) -> _Fidelity:
    """Return model, integration method and step of a configuration; for fidelity="auto" by `choose_model`."""
    if configuration.fidelity == "auto":
        choice = _choose_fidelity(configuration)
        return _Fidelity(choice.model, choice.method, choice.step, choice)
    modes = configuration.modes
    if isinstance(modes, str):
        modes = assembled_modes(configuration.arm, configuration.elements, 0.5 / configuration.control_period)
    switches = {name: getattr(configuration, name) for name in ("stiffening", "spinning_rotors", "rotary_inertia")}
    model = build_model(configuration.arm, configuration.elements, modes, **switches)
    return _Fidelity(model, configuration.method, configuration.integration_step, None)


def _choose_fidelity(configuration: Configuration) -> "Choice":
    """Choose a model for a slew with sine torques of 0.5 Hz, whose amplitudes are the torque limits."""
    n, period = configuration.arm.n_joints, configuration.control_period
    scene = Scene(
        configuration.arm,
        ModelChoice(
            True, 2, spinning_rotors=configuration.spinning_rotors, rotary_inertia=configuration.rotary_inertia
        ),
        SineTorque(configuration.torque_limit, [0.5] * n, [0.0] * n),
        Initial([SLEW_START * (-1.0) ** i for i in range(n)], [0.0] * n),
        duration=max(1, round(SLEW_DURATION / period)) * period,
        output_step=period,
    )
    choose_model = load_entry("flexman_gym.toolbox.fidelity.model_selection:choose_model")
    choice: Choice = choose_model(scene, positive("tolerance", configuration.tolerance, "m"), longest_step=period)
    return choice
