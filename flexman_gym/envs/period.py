"""Control period of b arms: actions, motors, motion, goals, measurements, and ends of episodes.

A single arm without Python code in its control period is advanced by a kernel with equal results to the bit, see
`CompiledPeriod`; `toolbox.sensitivity` has the derivatives of a control period.
"""

from typing import TYPE_CHECKING

import numpy as np

from flexman_gym.common.arrays import BoolArray
from flexman_gym.kernels import control_period as kernels

if TYPE_CHECKING:
    from flexman_gym.envs.episodes import Episodes


def advance(episodes: "Episodes", moving: BoolArray) -> bool:
    """Simulate arms for one control period.

    Args:
        episodes: episodes of b arms.
        moving: (b,) flags of the arms that move; `episodes.every` for all arms.

    Returns:
        True if a command of a moving arm ends with this control period.
    """
    view, motors, effects, agent = episodes.view, episodes.motors, episodes.effects, episodes.agent
    arms = None if moving is episodes.every else moving
    actions = np.ascontiguousarray(agent.torques(episodes.readings, view.action.copy(), ~episodes.over))
    foundation = episodes.foundation
    last = bool(agent.due(moving).any())
    arriving = actions
    if foundation is not None:
        motors.accelerations[:] = 0.0
    if effects is not None:
        arriving = np.ascontiguousarray(effects.motor_actions(actions))
        effects.disturb(motors.pushes, motors.forces, motors.accelerations, episodes.over)
    if foundation is not None:
        foundation.move(agent.mode, moving)
        motors.accelerations += foundation.accelerations
    arriving = motors.lagged(arriving)
    kernels.apply_actions(actions, arriving, motors.limits, moving, motors.drive, view.action, view.effort)
    episodes.batch.step(motors.drive, arms)
    if episodes.task.moves:
        _move_goals(episodes, slice(None) if arms is None else arms)
    elif foundation is not None:
        foundation.follow(view, slice(None) if arms is None else arms)
    view.read()
    episodes.clear_cache()
    episodes.measurements.sample(None if arms is None else np.flatnonzero(arms))
    _end_episodes(episodes, moving, last)
    if episodes.callback is not None:
        episodes.callback()
    return last


def _move_goals(episodes: "Episodes", arms: BoolArray | slice) -> None:
    """Set the goals of arms at the current time and their rates."""
    view = episodes.view
    goal = episodes.task.goal(view.episode_parameters, episodes.batch.time, view)
    view.target_velocity[arms] = (goal.target[arms] - view.target[arms]) / view.control_period
    view.goal_rates[arms] = (goal.angles[arms] - view.goal_angles[arms]) / view.control_period
    view.target[arms], view.goal_angles[arms] = goal.target[arms], goal.angles[arms]


def _end_episodes(episodes: "Episodes", moving: BoolArray, last: bool) -> None:
    """End the episodes of moving arms (b,) that exceeded their limits or reached the horizon.

    After the last control period of a command the observations are compared with their bounds as well.
    """
    view, sensors = episodes.view, episodes.sensors
    if moving is episodes.every and np.count_nonzero(view.failed):
        episodes.failures, view.failed = {}, np.zeros_like(view.failed)
    observations, bound = np.zeros((len(moving), 0)), np.zeros(0)
    if last:
        observations, bound = episodes.measurements.read(), sensors.bound
    flagged = kernels.flag_violations(
        view.motion, episodes.motion_limits, observations, bound, episodes.batch.status, episodes.violated
    )
    if flagged + _charge(episodes, moving):
        episodes.fail(np.flatnonzero(episodes.violated & moving))
    if kernels.count_episode_periods(episodes.ages, moving, episodes.max_periods, episodes.truncated):
        episodes.over |= episodes.truncated


def _charge(episodes: "Episodes", moving: BoolArray) -> int:
    """Add violations by moving arms (b,) to the cost; flag and count the arms whose episodes they end."""
    limits = episodes.limits
    if not limits.recorded:
        return 0
    episodes.excess = limits.excess(episodes.view)
    beyond: BoolArray = moving & (episodes.excess > 0.0)
    if limits.on_violation != "record":
        episodes.cost += beyond
    if limits.on_violation != "end":
        return 0
    episodes.violated |= beyond
    return int(np.count_nonzero(beyond))
