"""Gymnasium environments for training and testing controllers of flexible robot arms."""

from importlib.metadata import PackageNotFoundError, version
from typing import Any, NoReturn

from gymnasium.envs.registration import register

from flexman_gym import control, draw, metrics
from flexman_gym.common.checks import value_error
from flexman_gym.envs import NAMED_ENVIRONMENTS, Limits, Randomisation, Slew
from flexman_gym.envs.config.named_environments import CONDITIONS
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

try:
    __version__ = version("flexman_gym")
except PackageNotFoundError:  # a checkout that is not installed
    __version__ = "0+unknown"


def _refuse_condition(name: str, condition: str, **settings: Any) -> NoReturn:
    """Raise ValueError for an id such as "FlexRRR-v0/delay", which is valid for `rollout` but not for `gym.make`."""
    raise value_error("id", f"{name}/{condition}", f'gym.make("{name}", condition="{condition}")')


for _name in NAMED_ENVIRONMENTS:
    register(
        id=_name,
        entry_point="flexman_gym.envs:FlexManEnv",
        vector_entry_point="flexman_gym.envs:FlexManVectorEnv",
        kwargs={"name": _name},
    )
    for _condition in CONDITIONS if NAMED_ENVIRONMENTS[_name].conditions else ():
        register(
            id=f"{_name}/{_condition}",
            entry_point="flexman_gym:_refuse_condition",
            vector_entry_point="flexman_gym:_refuse_condition",
            kwargs={"name": _name, "condition": _condition},
        )
