"""Renamed modules and names: the table of release 0.3, and warnings for the old ones until release 0.4."""

import sys
import warnings
from collections.abc import Callable, Sequence
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

MODULES = {
    "flexman_agents.algorithm": "flexman_agents.sb3",
    "flexman_agents.memory": "flexman_agents.training",
    "flexman_agents.recipes": "flexman_agents.settings",
    "flexman_agents.zoo": "flexman_agents.sb3",
    "flexman_gym.control.reference": "flexman_gym.control.references.trajectories",
    "flexman_gym.control.shaper": "flexman_gym.control.input_shaping.shapers",
    "flexman_gym.envs.description": "flexman_gym.envs.config.configuration",
    "flexman_gym.envs.scales": "flexman_gym.control.normalisation",
    "flexman_gym.envs.setup": "flexman_gym.envs.config.configuration",
    "flexman_gym.envs.specification": "flexman_gym.envs.config.specification",
    "flexman_gym.evaluation.entrants": "flexman_gym.evaluation.agent",
    "flexman_gym.evaluation.folder": "flexman_gym.common.run_folder",
    "flexman_gym.evaluation.shipped": "flexman_gym.evaluation.policy_files",
    "flexman_gym.evaluation.tuning": "flexman_gym.evaluation.optimisation",
    "flexman_gym.simulation.view": "flexman_gym.envs.view",
}
"""Old module -> present module."""
NAMES = {
    "flexman_agents.callbacks": {"Report": "TrainingReport"},
    "flexman_agents.sb3": {"write_zoo": "write_zoo_files", "zoo": "zoo_hyperparameters"},
    "flexman_agents.training": {"take_policy": "policy_state"},
    "flexman_agents.vector": {"Arms": "SB3VecEnv"},
    "flexman_gym.control": {
        "Episode": "EpisodeInfo", "Optimised": "OptimisedController", "Shaped": "InputShapedController",
        "Truth": "Oracle",
    },
    "flexman_gym.control.input_shaping.shapers": {"design": "design_shaper", "residual": "shaper_residual"},
    "flexman_gym.control.normalisation": {"Scales": "RunningMeanStd"},
    "flexman_gym.envs": {"NAMED": "NAMED_ENVIRONMENTS"},
    "flexman_gym.envs.config.configuration": {"Description": "Configuration", "Setup": "Configuration"},
    "flexman_gym.envs.effects": {"Stage": "EffectContext"},
    "flexman_gym.envs.sensors": {
        "Action": "LastAction", "Command": "GoalCommand", "Fine": "FineScale", "NAMES": "SENSOR_NAMES",
        "Sensors": "SensorArray", "Servo": "ServoErrors", "SETS": "SENSOR_SETS", "State": "ModelState",
    },
    "flexman_gym.evaluation": {
        "Entrant": "AgentSpec", "Figure": "Metric", "FIGURES": "METRICS", "find_entrant": "find_agent",
        "Record": "EpisodeRecord", "table": "metrics_table", "Tuned": "TunedGains",
    },
    "flexman_gym.evaluation.agent": {"find_entrant": "find_agent"},
    "flexman_gym.evaluation.policy_files": {"described": "describe_policy"},
    "flexman_gym.metrics": {
        "band_of_move": "move_band", "energy_left": "remaining_energy", "power_above": "high_frequency_power",
        "STAY": "SETTLING_WINDOW", "VIBRATING": "VIBRATION_WINDOW",
    },
    "flexman_gym.simulation.stability": {"amplitude_kept": "remaining_amplitude"},
}  # fmt: skip
"""Present module -> old name in it -> present name."""


def deprecated_names(module: str, old: str = "") -> Callable[[str], Any]:
    """Return the `__getattr__` of a module that still answers to old names, with a DeprecationWarning.

    Args:
        module: present module of the names.
        old: old module, for the warning; "" for the present one.
    """

    def getattribute(name: str) -> Any:
        present = NAMES.get(module, {}).get(name, name)
        if name.startswith("__") or (present == name and not old):
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        value = getattr(import_module(module), present)
        warnings.warn(f"{old or module}.{name} is {module}.{present} now", DeprecationWarning, stacklevel=2)
        return value

    return getattribute


class _OldModules(MetaPathFinder, Loader):
    """Finder of the old modules, which hold nothing but the way to the present ones."""

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        return ModuleSpec(name, self) if name in MODULES else None

    def exec_module(self, module: ModuleType) -> None:
        module.__dict__["__getattr__"] = deprecated_names(MODULES[module.__name__], module.__name__)


if not any(isinstance(finder, _OldModules) for finder in sys.meta_path):
    sys.meta_path.insert(0, _OldModules())  # before the folder of recipes, which has the name of an old module
