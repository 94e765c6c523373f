"""Acting: how actions of an agent, and the base beside it, become what motors are asked for."""

from collections.abc import Mapping
from functools import partial

import numpy as np

from flexman_gym.common.arrays import Array, Flags, IntArray
from flexman_gym.control.actions import make_action_mode
from flexman_gym.control.controller import EpisodeInfo
from flexman_gym.envs.active_effects import ActiveEffects
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.specification import make_base_controller, make_plant
from flexman_gym.envs.sight import Sight
from flexman_gym.envs.tasks.task import goal_path
from flexman_gym.envs.view import View
from flexman_gym.model.model import Model


class Acting:
    """The base of b arms and the mode of the actions beside it.

    Attributes:
        plant: what controllers are told of the arms.
        base: the controller that acts beside the agent, None without one.
        mode: what the actions of the agent mean.
    """

    kept = ("base", "mode")

    def __init__(self, setup: Configuration, model: Model) -> None:
        self._task, self._longest = setup.task, setup.longest
        self.base = make_base_controller(setup, model)
        self.plant = make_plant(setup, model)
        self.mode = make_action_mode(setup.actions, self.plant, self.base)

    def begin(
        self, arms: IntArray, plan: Mapping[str, Array], posture: Array, view: View, effects: ActiveEffects | None
    ) -> None:
        """Tells of start and first goal of new episodes of arms (r,), and of the path of a goal that moves.

        Args:
            arms: (r,).
            plan: name -> (r, ...) of these episodes.
            posture: (r, n) of the first goal, rad.
            view: of all arms.
            effects: which know what the episodes drew; None for nothing.
        """
        path = partial(goal_path, self._task, plan, self._longest, view) if self._task.moves else None
        drawn = {name: values[arms] for name, values in effects.drawn.items()} if effects else {}
        self.mode.reset(arms, EpisodeInfo(plan["start"], posture, view.control_period, path, drawn))

    def asked(self, actions: Array, sight: Sight, view: View, playing: Flags) -> Array:
        """Gives what motors (b, n) are asked for under actions (b, k), parts of the torque limits."""
        readings = sight.readings if self.mode.sensors else {}
        return np.asarray(self.mode.act(actions, readings, view.action.copy(), playing))

    def look(self, sight: Sight, view: View, playing: Flags) -> None:
        """Lets the agent see what the mode shows of the arms (b,) that are playing."""
        if getattr(self.mode, "shown", None):
            sight.show(self.mode.look(sight.readings, view.action.copy(), playing))  # type: ignore[attr-defined]
