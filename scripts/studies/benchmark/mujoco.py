"""MuJoCo's rollout: many arms of rigid pieces per call, at the longest stable step."""

from dataclasses import replace

import mujoco  # type: ignore[import-not-found, import-untyped, unused-ignore]
import numpy as np
from mujoco import rollout

from flexman_gym.common.arrays import Array
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.toolbox.interchange.mjcf import to_mjcf
from flexman_gym.toolbox.precision.peers.mujoco import sane_error
from studies.stopwatch import Timer, timer

PIECES, FINEST, SEARCH_PERIODS = (
    4,
    1024,
    100,
)  # pieces per link; steps per control period of the reference; control periods of the search


class MujocoArms:
    """Arms of rigid pieces connected by springs, equivalent to the environment's arm except for modal damping."""

    def __init__(self, setup: Configuration, arms: int, parts: int) -> None:
        arm = replace(setup.arm, modal_damping_ratio=0.0)
        text = to_mjcf(arm, PIECES, "Euler", setup.control_period / parts)
        self.model = mujoco.MjModel.from_xml_string(text)
        self._data, self._parts = mujoco.MjData(self.model), parts
        mujoco.set_mju_user_warning(lambda message: None)  # else it writes a file about every divergence
        full = mujoco.mjtState.mjSTATE_FULLPHYSICS
        start = np.zeros(mujoco.mj_stateSize(self.model, full))
        mujoco.mj_getState(self.model, self._data, start, full)
        self._start, self._torque_limit = np.tile(start, (arms, 1)), np.array(setup.torque_limit)

    def run(self, actions: Array) -> Array:
        """Return the states (periods, b, size) after each control period from rest, under actions (periods, b, n)."""
        states, result = self._start, []
        for action in actions:
            control = np.repeat(self._torque_limit * action[:, None], self._parts, axis=1)
            states = rollout.rollout(self.model, self._data, states, control)[0][:, -1]
            result.append(states)
        return np.array(result)

    def diverged(self, states: Array) -> bool:
        """Return whether MuJoCo reset an arm, visible by the time (first state entry) being too early."""
        reached = len(states) * self._parts * self.model.opt.timestep
        return not np.allclose(states[-1, :, 0], reached, rtol=1e-6, atol=0.0)

    def tips(self, states: Array) -> Array:
        """Return the tip position (m) of each state."""
        result = []
        for state in states:
            mujoco.mj_setState(self.model, self._data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
            mujoco.mj_kinematics(self.model, self._data)
            result.append(self._data.site_xpos[0].copy())
        return np.array(result)


def longest_step(setup: Configuration) -> int:
    """Return the smallest number of steps per control period with which random torques move the tip correctly."""
    actions = _actions(SEARCH_PERIODS, 1, setup.arm.n_joints)

    def tips(parts: int) -> Array:
        arms = MujocoArms(setup, 1, parts)
        states = arms.run(actions)
        return np.full(3, np.nan) if arms.diverged(states) else arms.tips(states[:, 0])

    reference, diverges, stable = tips(FINEST), 1, FINEST
    while stable - diverges > 1:
        between = (diverges + stable) // 2
        if np.abs(tips(between) - reference).max() < sane_error(setup.arm):
            stable = between
        else:
            diverges = between
    return stable


def control_periods(setup: Configuration, arms: int, periods: int, parts: int) -> Timer:
    """Return a timer of control periods of arms that start at rest, under random torques."""
    side_by_side, actions = MujocoArms(setup, arms, parts), _actions(periods, arms, setup.arm.n_joints)
    assert not side_by_side.diverged(side_by_side.run(actions)), "the step is too long"
    return timer(lambda: side_by_side.run(actions), arms * periods)


def _actions(*shape: int) -> Array:
    return np.random.default_rng(0).uniform(-1.0, 1.0, shape)
