"""Renamed modules and names: the table of release 0.3; old names work with a warning until release 0.4."""

import re
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any, TypeVar, cast

from flexman_gym.common.checks import warn_caller

MODULES = {
    "flexman_agents.algorithm": "flexman_agents.sb3",
    "flexman_agents.memory": "flexman_agents.training",
    "flexman_agents.recipes": "flexman_agents.settings",
    "flexman_gym.control.reference": "flexman_gym.toolbox.controllers.references.trajectories",
    "flexman_gym.control.shaper": "flexman_gym.toolbox.controllers.input_shaping.shapers",
    "flexman_gym.draw.style": "flexman_gym.common.plot_style",
    "flexman_gym.envs.description": "flexman_gym.envs.config.configuration",
    "flexman_gym.envs.scales": "flexman_gym.agent.normalisation",
    "flexman_gym.envs.setup": "flexman_gym.envs.config.configuration",
    "flexman_gym.envs.specification": "flexman_gym.envs.config.specification",
    "flexman_gym.evaluation.entrants": "flexman_gym.evaluation.agents",
    "flexman_gym.evaluation.folder": "flexman_gym.common.run_folder",
    "flexman_gym.evaluation.shipped": "flexman_gym.evaluation.policy_files",
    "flexman_gym.evaluation.tuning": "flexman_gym.toolbox.controllers.tuning",
    "flexman_gym.toolbox.fidelity.choose": "flexman_gym.toolbox.fidelity.model_selection",
    "flexman_gym.simulation.amplification": "flexman_gym.simulation.stability",
    "flexman_gym.simulation.scenes": "flexman_gym.simulation.scene_simulation",
    "flexman_gym.simulation.view": "flexman_gym.envs.view",
}
"""Old module -> present module."""
NAMES = {
    "flexman_agents.callbacks": {"Report": "TrainingReport"},
    "flexman_agents.training": {"take_policy": "policy_state"},
    "flexman_agents.vector": {"Arms": "SB3VecEnv"},
    "flexman_gym.common.run_folder": {"read_data": "read_npz", "write_data": "write_npz"},
    "flexman_gym.control": {
        "Episode": "EpisodeInfo", "Optimised": "OptimisedController", "Shaped": "InputShapedController",
        "Truth": "Oracle",
    },
    "flexman_gym.toolbox.controllers.input_shaping.shapers": {"design": "design_shaper", "residual": "shaper_residual"},
    "flexman_gym.agent.normalisation": {"Scales": "RunningMeanStd"},
    "flexman_gym.envs": {"NAMED": "NAMED_ENVIRONMENTS"},
    "flexman_gym.envs.config.configuration": {"Description": "Configuration", "Setup": "Configuration"},
    "flexman_gym.envs.effects": {"Stage": "EffectContext"},
    "flexman_gym.envs.sensors": {
        "Action": "LastAction", "Command": "GoalCommand", "Fine": "FineScale", "NAMES": "SENSOR_NAMES",
        "Sensors": "SensorArray", "Servo": "ServoErrors", "SETS": "SENSOR_SETS", "State": "ModelState",
    },
    "flexman_gym.evaluation": {
        "Entrant": "AgentSpec", "Figure": "Metric", "FIGURES": "METRICS", "find_entrant": "find_agent",
        "Record": "EpisodeRecord", "table": "metrics_table",
    },
    "flexman_gym.evaluation.agents": {"find_entrant": "find_agent"},
    "flexman_gym.evaluation.policy_files": {"described": "describe_policy"},
    "flexman_gym.metrics": {
        "band_of_move": "move_band", "energy_left": "remaining_energy", "power_above": "high_frequency_power",
        "STAY": "SETTLING_WINDOW", "VIBRATING": "VIBRATION_WINDOW",
    },
    "flexman_gym.simulation.stability": {"amplitude_kept": "remaining_amplitude"},
    "flexman_gym.toolbox.verification.closed_forms": {"bar_eigenvalues": "bar_frequencies"},
}  # fmt: skip
"""Present module -> old name in it -> present name."""
METHODS = {
    "gauss_2_sweeps": "gauss_2", "gauss_3_sweeps": "gauss_3",
    "midpoint_2_sweeps": "midpoint_2", "midpoint_3_sweeps": "midpoint_3",
}  # fmt: skip
"""Old name of an integration method -> present name; the number counts Newton iterations."""
RUN_SETTINGS = {"judge_every": "eval_every", "rounds_kept": "iterations_kept", "value_first": "value_warmup"}
"""Old setting or hyperparameter of a training run, in recipes and settings.json -> present name."""
OPTIONS = {
    "compile": {"abreast": "batch", "one": "single"},
    "export": {"--words": "--description"},
    "live": {"--env": "ENVIRONMENT"},
    "league": {"--entrants": "--agents", "--environments": "--scenarios"},
    "train": {"--judge-every": "--eval-every"},
}
"""Command -> old option or value on its command line -> present one; capitals for an argument without a name."""
REMOVED_OPTIONS = {
    "train": {
        "--engine": "every run is trained with Stable-Baselines3; leave the option out",
        "--runners": "it belonged to RLlib; leave the option out, --jobs runs several seeds at once",
    },
}
"""Command -> option that release 0.3 no longer has -> reason and replacement."""
COMMANDS = {
    "certify": "league --agent", "tune": "optimise gains", "optimise ENVIRONMENT": "optimise slews ENVIRONMENT",
    "resonance": "shape", "enjoy": "live --agent",
}  # fmt: skip
"""Old command -> present command; a word in capitals stands for one that is none of OPTIMISED."""
OPTIMISED = ("slews", "gains", "arm")
"""First words of `flexman optimise`."""
STATE_FIELDS = {
    "_apart": "_perturbations_reduced", "_following": "_paths", "_given_up": "_fallback_active", "_known": "_latest",
    "_looked": "_updated", "_own_coordinates": "_adapted_coordinates", "_own_torques": "_adapted_torques",
    "_pushed": "_filtering", "_residuals": "_detector", "_soft": "_compliance", "_tight": "_holding",
    "ahead": "clock_offset", "begun": "start_time", "lasting": "duration", "numbers": "theta", "pace": "time_scaling",
    "plan": "episode_parameters",
    "quickening": "pace_rate", "shape": "shaping", "wanted": "action", "way": "displacement",
}  # fmt: skip
"""Old field of a saved state -> present field."""
ADDED_ENTRIES = frozenset(
    ("coulomb_rate", "knee_share", "knee_twist", "ripple_torque", "static_excess", "stribeck_rate")
)
"""Constants of an arm that the saved state of a batch of release 0.2 lacks; their present values remain."""
LEAGUE_COLUMNS = {"entrant": "agent", "venue": "scenario"}
"""Old head of a column in the rows of a league -> present head."""
CERTIFICATE_KEYS = {"trials": "rows", "name": "scenario", "machine": "computer"}
"""Old key of a certificate -> present key."""
MEMBERS = {
    "Controller, Observer, ActionMode, Task, Sensor, Effect": {"kept": "state_fields"},
    "Controller.reset": {"reset(arms, episode)": "reset(arms, episode, count)"},
    "Observer": {"wrong": "inconsistent"},
    "ActionMode": {"shown": "observation_sizes", "look": "observe"},
    "Task": {"figures": "metrics"},
    "FlexManEnv, FlexManVectorEnv": {"setup": "configuration"},
    "View": {
        "alone": "single", "heavy": "has_gravity", "places": "slices", "plan": "episode_parameters",
        "reaching": "inverse_kinematics",
    },
    "Rollout": {"about": "metadata"},
    "Simulator": {"keep": "record"},
    "Episode": {"of_trajectory": "from_trajectory"},
    "Standings": {"better": "improvement_probability"},
    "TrainingReport": {"figures": "metrics"},
}  # fmt: skip
"""Class or protocol -> old member -> present member, see `deprecated_members`; users write classes of the protocols."""
ARGUMENTS = {
    "assembled_modes": {"highest": "max_frequency", "share": "energy_fraction"},
    "diagnose": {"entrant": "agent"}, "evaluate": {"entrant": "agent"},
    "move_band": {"part": "fraction"},
    "normalised_scores": {"rewards": "returns", "most": "largest"}, "paired_score": {"rewards": "returns"},
    "remaining_energy": {"of": "reference"},
    "resume": {"judge_every": "eval_every"}, "rollout": {"entrant": "agent", "watch": "callback", "moved": "set_plant"},
    "TrackingLQR": {"law": "timing_law"}, "write_onnx": {"entrant": "agent"},
}  # fmt: skip
"""Function -> old argument -> present argument, see `deprecated_arguments`."""
BASE_ARGUMENTS = {"law": "timing_law"}
"""Old argument of a base controller, in configurations and files -> present argument."""
PARAMETER_KEYS = {"link_stiffness": "link_stiffness_factor"}
"""Old name of a physical parameter in fits, reset options and draws -> present name."""
FORMER_DEFAULT_METHOD = "midpoint_3"  # method of environments in run folders and policies of 0.2 that name none


def complete_environment(data: object) -> None:
    """Add the method to the environment of a run folder or a policy that names none, as written by release 0.2.

    With fidelity="auto" no method is added, since `choose_model` chooses it.
    """
    if isinstance(data, dict) and data.get("fidelity", "default") == "default":
        data.setdefault("method", FORMER_DEFAULT_METHOD)


def current_methods(text: str, warn: bool = False) -> str:
    """Replace old names of integration methods in a text, such as an entry of a stored row or the name of a scenario.

    Args:
        text: name of a method, or a longer text with names of methods.
        warn: issue a DeprecationWarning for each old name; False for files of earlier releases.
    """
    pattern = rf"\b({'|'.join(METHODS)})\b"
    if warn:
        for old in re.findall(pattern, text):
            warn_caller(f"method {old!r} is deprecated; give {METHODS[old]!r}", DeprecationWarning)
    return re.sub(pattern, lambda match: METHODS[match[0]], text)


def rename_keys(
    data: Mapping[str, Any], names: Mapping[str, str], warn: bool = True, field: str = "", nested: bool = True
) -> dict[str, Any]:
    """Return a mapping with present names of keys, by default also in inner mappings.

    Args:
        data: values by present or old name.
        names: old name -> present name.
        warn: issue a DeprecationWarning for each old name.
        field: name of the mapping, for messages.
        nested: rename the keys of inner mappings too.

    Raises:
        ValueError: for a value under both names.
    """
    result, prefix = {}, f"{field}." * bool(field)
    for name, value in data.items():
        if name in names and names[name] in data:
            raise ValueError(f"{prefix}{name}: {value!r} is not allowed; give {names[name]} only, its present name")
        if name in names and warn:
            warn_caller(f"{prefix}{name} is {names[name]} now", DeprecationWarning)
        inner = nested and isinstance(value, dict)
        result[names.get(name, name)] = rename_keys(value, names, warn, field) if inner else value
    return result


def deprecated_names(module: str, old: str = "") -> Callable[[str], Any]:
    """Return the `__getattr__` of a module, which accepts old names with a DeprecationWarning.

    Args:
        module: present module of the names.
        old: old module, for the warning; "" for the present one.

    Returns:
        Function of a name that returns the object with the present name.
    """

    def getattribute(name: str) -> Any:
        present = NAMES.get(module, {}).get(name, name)
        if name.startswith("__") or (present == name and not old):
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        value = getattr(import_module(module), present)
        warnings.warn(f"{old or module}.{name} is {module}.{present} now", DeprecationWarning, stacklevel=2)
        return value

    return getattribute


Function = TypeVar("Function", bound=Callable[..., Any])


def deprecated_arguments(**names: str) -> Callable[[Function], Function]:
    """Return a decorator of a function that still accepts old argument names, with a DeprecationWarning.

    Args:
        names: old name="present name".
    """

    def decorate(function: Function) -> Function:
        @wraps(function)
        def call(*arguments: Any, **keywords: Any) -> Any:
            name = function.__qualname__.removesuffix(".__init__")
            for old in names.keys() & keywords.keys():
                message = f"{name}({old}=...) is deprecated; give {names[old]}=..."
                warnings.warn(message, DeprecationWarning, stacklevel=2)
                keywords[names[old]] = keywords.pop(old)
            return function(*arguments, **keywords)

        return cast(Function, call)

    return decorate


class _OldMember:
    """Old member of a class: returns the present member, with a DeprecationWarning."""

    def __init__(self, old: str, present: str) -> None:
        self._old, self._present = old, present

    def __get__(self, instance: object, kind: type[object]) -> Any:
        warn_caller(f"{kind.__name__}.{self._old} is {kind.__name__}.{self._present} now", DeprecationWarning)
        return getattr(kind if instance is None else instance, self._present)


Class = TypeVar("Class", bound=type[Any])


def deprecated_members(**names: str) -> Callable[[Class], Class]:
    """Return a decorator of a class whose attributes and methods are also found under old names, with a warning.

    Args:
        names: old name="present name".
    """

    def decorate(owner: Class) -> Class:
        for old, present in names.items():
            setattr(owner, old, _OldMember(old, present))
        return owner

    return decorate


class _OldModules(MetaPathFinder, Loader):
    """Finder and loader of old modules, which forward to the present ones."""

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        return ModuleSpec(name, self) if name in MODULES else None

    def exec_module(self, module: ModuleType) -> None:
        module.__dict__["__getattr__"] = deprecated_names(MODULES[module.__name__], module.__name__)


if not any(isinstance(finder, _OldModules) for finder in sys.meta_path):
    sys.meta_path.insert(0, _OldModules())  # before the folder of recipes, which has the name of an old module
