"""Gymnasium environments for training and testing controllers of flexible robot arms."""

from typing import TYPE_CHECKING, Any

from flexman_gym.common.lazy import lazy_names
from flexman_gym.envs.registration import register_environments

if TYPE_CHECKING:
    __version__: str
    from flexman_gym import control, draw, metrics
    from flexman_gym.common.registry import register
    from flexman_gym.envs.config.arm_description import describe
    from flexman_gym.envs.config.randomisation import Randomisation
    from flexman_gym.envs.limits import Limits
    from flexman_gym.envs.tasks import Slew
    from flexman_gym.evaluation.metrics import evaluate
    from flexman_gym.evaluation.rollouts import rollout
    from flexman_gym.model.deformation import curvature, curves, strain
    from flexman_gym.model.dynamics import (
        acceleration,
        damping_matrix,
        frequencies,
        inverse_dynamics,
        mass_matrix,
        stiffness_matrix,
        tip_acceleration,
    )
    from flexman_gym.model.model import Model, build_model
    from flexman_gym.model.statics import holding_torques, rest_state
    from flexman_gym.model.vibration import modes
    from flexman_gym.scene import catalog
    from flexman_gym.scene.arm import Arm
    from flexman_gym.scene.joint import Joint, Motor
    from flexman_gym.scene.link import Link, NonUniformLink
    from flexman_gym.scene.rigid_body import LumpedMass, Payload
    from flexman_gym.scene.scene import Initial, ModelChoice, Scene
    from flexman_gym.scene.signals import (
        ConstantTorque,
        SampledAngles,
        SampledSignal,
        SampledTorque,
        Signal,
        SineTorque,
    )
    from flexman_gym.simulation.episode import Episode
    from flexman_gym.simulation.linearization import linearize
    from flexman_gym.simulation.methods import METHODS, generalised_alpha
    from flexman_gym.simulation.scene_simulation import simulate, simulate_all
    from flexman_gym.simulation.simulator import Simulator
    from flexman_gym.simulation.trajectory import Trajectory
    from flexman_gym.toolbox.controllers.tuning import tune
    from flexman_gym.toolbox.deployment.machine.machine import Machine
    from flexman_gym.toolbox.fidelity.model_selection import Choice, choose_model
    from flexman_gym.toolbox.identification.fitting import Fit, fit
    from flexman_gym.toolbox.identification.measurement import Filter, Measurement
    from flexman_gym.toolbox.identification.ringing import Ringing
    from flexman_gym.toolbox.sensitivity.episode_sensitivities import sensitivities
    from flexman_gym.toolbox.view.live_session import live

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
    "describe",
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
    "register",
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
