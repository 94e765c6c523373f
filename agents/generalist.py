"""Environments of random arms over which one policy is trained, in units of each arm."""

from flexman_agents.drawn_arms import draw_arm
from flexman_gym.common.errors import value_error
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.config.plant import make_plant
from flexman_gym.envs.config.randomisation import Randomisation
from flexman_gym.simulation.physical_parameters import PARAMETERS
from flexman_gym.toolbox.controllers.arm_shaping_mode import ACTIONS_PER_SLEW, action_periods
from flexman_gym.toolbox.league.arm_trial import unknown_settings

FIRST_ARM = 1_000_000  # seed of the first arm of a training; tests have seeds from 2,000,000 on
SLEWS = 2.0  # slews in an episode of the training


def arm_environments(environment: Configuration, arms: int) -> list[Configuration]:
    """Return the environments of random arms with unknown payload and stiffness, without delay and noise.

    An episode has SLEWS slews of the arm, and an action lasts 1 / ACTIONS_PER_SLEW of a slew.

    Args:
        environment: settings of the task and the agent, whose actions are in units of the arm.
        arms: number of arms, drawn with the seeds from FIRST_ARM on.

    Raises:
        ValueError: for actions that depend on the number of joints.
    """
    actions = environment.actions
    if not isinstance(actions, dict) or actions.get("units") != "arm":
        raise value_error("actions", actions, "{kind: shaping, units: arm} for a training over random arms")
    return [_environment(environment, FIRST_ARM + i) for i in range(arms)]


def _environment(environment: Configuration, seed: int) -> Configuration:
    """Return the environment of an arm, given its seed."""
    own = environment.without(("control_period", "horizon", "limits", "slew_time", "gains")).replace(arm=draw_arm(seed))
    ranges = unknown_settings(own)["randomisation"]
    own = own.replace(randomisation={name: span for name, span in ranges.items() if _is_physical(name)})
    periods = action_periods(make_plant(own, resolve_fidelity(own).model))
    horizon = SLEWS * ACTIONS_PER_SLEW * periods * own.control_period
    return own.replace(action_repeat=periods, horizon=float(f"{horizon:.9g}"))


def _is_physical(name: str) -> bool:
    """Return True for a range of a physical parameter of the arm."""
    return name in {Randomisation.range_name(each) for each in PARAMETERS}
