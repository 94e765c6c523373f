"""flexman_gym: robot arms whose links and joints bend, as Gymnasium environments."""

from importlib.metadata import PackageNotFoundError, version

from gymnasium.envs.registration import register

from flexman_gym import draw, metrics
from flexman_gym.envs import NAMED, Limits, Randomisation, Slew
from flexman_gym.evaluation import evaluate, rollout
from flexman_gym.fidelity import Choice, choose_model
from flexman_gym.model import (
    Model,
    acceleration,
    build_model,
    curvature,
    frequencies,
    holding_torques,
    inverse_dynamics,
    linearize,
    mass_matrix,
    rest_state,
    strain,
    tip_acceleration,
)
from flexman_gym.scene import (
    Arm,
    ConstantTorque,
    Initial,
    Joint,
    Link,
    ModelChoice,
    NonUniformLink,
    Payload,
    Scene,
    Signal,
    SineTorque,
    catalog,
)
from flexman_gym.simulation import METHODS, Simulator, Trajectory, generalised_alpha, simulate, simulate_all

__all__ = [
    "METHODS",
    "Arm",
    "Choice",
    "ConstantTorque",
    "Initial",
    "Joint",
    "Limits",
    "Link",
    "Model",
    "ModelChoice",
    "NonUniformLink",
    "Payload",
    "Randomisation",
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
    "curvature",
    "draw",
    "evaluate",
    "frequencies",
    "generalised_alpha",
    "holding_torques",
    "inverse_dynamics",
    "linearize",
    "mass_matrix",
    "metrics",
    "rest_state",
    "rollout",
    "simulate",
    "simulate_all",
    "strain",
    "tip_acceleration",
]

try:
    __version__ = version("flexman_gym")
except PackageNotFoundError:  # a checkout that is not installed
    __version__ = "0+unknown"

for _name in NAMED:
    register(
        id=_name,
        entry_point="flexman_gym.envs:FlexManEnv",
        vector_entry_point="flexman_gym.envs:FlexManVectorEnv",
        kwargs={"name": _name},
    )
