"""Gymnasium environments for training and testing controllers of flexible robot arms."""

from typing import TYPE_CHECKING, Any

from flexman_gym.common.lazy import lazy_names
from flexman_gym.envs.registration import register_environments

if TYPE_CHECKING:
    __version__: str
    from flexman_gym import control, draw, metrics
    from flexman_gym.envs import Limits, Randomisation, Slew
    from flexman_gym.evaluation import evaluate, live, rollout, sensitivities, tune
    from flexman_gym.evaluation.machine.machine import Machine
    from flexman_gym.fidelity import Choice, choose_model
    from flexman_gym.identification import Filter, Fit, Measurement, Ringing, fit
    from flexman_gym.model import (
        Model,
        acceleration,
        build_model,
        curvature,
        curves,
        damping_matrix,
        frequencies,
        holding_torques,
        inverse_dynamics,
        mass_matrix,
        modes,
        rest_state,
        stiffness_matrix,
        strain,
        tip_acceleration,
    )
    from flexman_gym.scene import (
        Arm,
        ConstantTorque,
        Initial,
        Joint,
        Link,
        LumpedMass,
        ModelChoice,
        Motor,
        NonUniformLink,
        Payload,
        SampledAngles,
        SampledSignal,
        SampledTorque,
        Scene,
        Signal,
        SineTorque,
        catalog,
    )
    from flexman_gym.simulation import (
        METHODS,
        Episode,
        Simulator,
        Trajectory,
        generalised_alpha,
        linearize,
        simulate,
        simulate_all,
    )

__all__ = [
    "METHODS",
    "Arm",
    "Choice",
    "ConstantTorque",
    "Episode",
    "Filter",
    "Fit",
    "Initial",
    "Joint",
    "Limits",
    "Link",
    "LumpedMass",
    "Machine",
    "Measurement",
    "Model",
    "ModelChoice",
    "Motor",
    "NonUniformLink",
    "Payload",
    "Randomisation",
    "Ringing",
    "SampledAngles",
    "SampledSignal",
    "SampledTorque",
    "Scene",
    "Signal",
    "Simulator",
    "SineTorque",
    "Slew",
    "Trajectory",
    "__version__",
    "acceleration",
    "build_model",
    "catalog",
    "choose_model",
    "control",
    "curvature",
    "curves",
    "damping_matrix",
    "draw",
    "evaluate",
    "fit",
    "frequencies",
    "generalised_alpha",
    "holding_torques",
    "inverse_dynamics",
    "linearize",
    "live",
    "mass_matrix",
    "metrics",
    "modes",
    "rest_state",
    "rollout",
    "sensitivities",
    "simulate",
    "simulate_all",
    "stiffness_matrix",
    "strain",
    "tip_acceleration",
    "tune",
]

_find, __dir__ = lazy_names(__name__)


def __getattr__(name: str) -> Any:
    """Return a public name, imported at its first use, or the version."""
    if name != "__version__":
        return _find(name)
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("flexman_gym")
    except PackageNotFoundError:  # a checkout that is not installed
        return "0+unknown"


register_environments()
