"""Action mode of reference shaping in units of the arm: one policy for arms of any size and number of joints."""

from collections.abc import Mapping

import numpy as np

from flexman_gym.agent.action_modes import ActionModeEntry
from flexman_gym.agent.controller import Controller, EpisodeInfo, Plant, Readings
from flexman_gym.common.arrays import Array, BoolArray, IntArray, pad_rows
from flexman_gym.common.checks import non_negative, one_of
from flexman_gym.common.errors import value_error
from flexman_gym.envs.config.conditions import usual_payload
from flexman_gym.model.dynamics import tip_jacobian
from flexman_gym.model.statics import rest_state
from flexman_gym.toolbox.controllers.arm_scales import ArmScales
from flexman_gym.toolbox.controllers.observers.observer import Estimate
from flexman_gym.toolbox.controllers.reference_shaping import ReferenceShaping, ShapingLimits
from flexman_gym.toolbox.controllers.shaping_mode import ReferenceShapingMode

UNITS = ("joint", "arm")
ACTIONS_PER_SLEW = 16  # actions in a slew of the arm, each held for a whole number of control periods
SCALING_TIMES_PER_SLEW = 65  # slew / time constant of the time scaling: that of FlexRRR-v0 with its gain of 0.35
LOOK_AHEAD = np.array([0.0, 1.0, 2.0, 4.0]) / ACTIONS_PER_SLEW  # slews; times from now of the observed torques
DEPARTURE, RATE = 0.003, 0.03  # fractions of the reach, and per slew; tip departures with an arcsinh of 0.88
MAX_LOG_RATIO = 5.0  # bound of the observed logarithm of the torque ratio, which is infinite for a rigid arm


def action_periods(plant: Plant) -> int:
    """Return the number of control periods in an action of the mode."""
    return max(1, round(_scales(plant).slew / plant.period / ACTIONS_PER_SLEW))


def _scales(plant: Plant) -> ArmScales:
    return ArmScales.of(plant.model, plant.torque_scales, plant.rate_limit)


class ArmShapingMode(ReferenceShapingMode):
    """Action mode of the time scaling of the base reference, with observed quantities in units of the arm.

    Units are the slew of the arm (`ArmScales.slew`), its reach, its torque limits and its usual payload. Names and
    sizes do not depend on the arm, so that a policy acts on any arm. An action is held for 1 / ACTIONS_PER_SLEW of the
    slew; commands between are ignored.

    The observed quantities are
        clock        path parameter, its first and second derivative, remaining and whole duration, time scaling
        tip          arcsinh of departures from the reference along and across the motion of the tip on arrival, and
                     of their rates; the tip is that of the linear model at the goal
        torques      largest fractions of the limits over the motors: feed-forward at LOOK_AHEAD and at the goal, and
                     applied torques
        parameters   estimated payload, and means of the stiffness factors of joints and links
        deviations   their standard deviations
        arm          logarithm of the torque ratio, period of the vibration, control period
        action       last action

    Args:
        plant: plant model.
        base: OutputFeedback with an observer and a tracking law.
        **authority: "pace", and "offset" and "torque" of 0, see `ShapingLimits`.
    """

    state_fields = ("_ages", "_jacobians", "_directions", "_observed")

    def __init__(self, plant: Plant, base: Controller | None, **authority: object) -> None:
        for name in ("offset", "torque", "fading"):
            if value := non_negative(f"actions.{name}", authority.pop(name, 0.0)):
                raise value_error(f"actions.{name}", value, "0 with units: arm, whose only action is the pace")
        self._scales, self._hold = _scales(plant), action_periods(plant)
        self._reach = float(plant.model.constants.length.sum())
        self._payload = usual_payload(plant.model.arm)
        super().__init__(plant, base, offset=0.0, torque=0.0, fading=0.0, **authority)
        self._ages = np.zeros(0, dtype=np.int64)
        self._jacobians, self._directions = np.zeros((0, 3, plant.model.n_dof)), np.zeros((0, 3))

    def _make_shaping(self, limits: ShapingLimits) -> ReferenceShaping:
        gain = 1.0 - np.exp(-SCALING_TIMES_PER_SLEW * self._plant.period / self._scales.slew)
        return ReferenceShaping(self._law.slews, self._law.limits, self._plant.period, limits, gain)

    def _sizes(self) -> Mapping[str, int]:
        sizes = {"clock": 6, "tip": 4, "torques": len(LOOK_AHEAD) + 2}
        return sizes | {"parameters": 3, "deviations": 3, "arm": 3, "action": 1}

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Start new episodes; arguments as in `ReferenceShapingMode.reset`."""
        super().reset(arms, episode, count)
        for name in self.state_fields:
            setattr(self, name, pad_rows(getattr(self, name), count))
        self._ages[arms], model = 0, self._plant.model
        for arm, start, goal in zip(arms.tolist(), episode.start, episode.goal, strict=True):
            jacobian = tip_jacobian(model, rest_state(model, goal)[: model.n_dof])
            motion = jacobian @ model.at_rest((goal - start)[None])[0, : model.n_dof]
            self._jacobians[arm], self._directions[arm] = jacobian, motion / (np.linalg.norm(motion) or 1.0)

    def act(self, actions: Array, readings: Readings, applied: Array, active: BoolArray) -> Array:
        """Return the commanded torques (b, n) as fractions of the torque limits."""
        arms = np.flatnonzero(self._due(active))
        self._shaping.action[arms[:, None], self._columns] = actions[arms]
        self._ages += active
        return self._base.act(readings, applied, active)

    def _due(self, active: BoolArray) -> BoolArray:
        """Return the flags (b,) of the active arms whose next action begins in this control period."""
        result: BoolArray = active & (self._ages % self._hold == 0)
        return result

    def observe(self, readings: Readings, applied: Array, active: BoolArray) -> Array:
        """Return the observed quantities (b, size), updated for the active arms (b,) whose next action begins."""
        return super().observe(readings, applied, self._due(active))

    def _parts(self, estimate: Estimate, applied: Array, arms: IntArray) -> dict[str, Array]:
        law, slews, slew, limits = self._law, self._law.slews, self._scales.slew, self._law.limits
        times = law.clock(estimate, arms)
        progress, speed, acceleration = slews.at(times, arms)
        end = slews.start_time[arms] + slews.duration[arms]
        clock = [progress, speed * slew, acceleration * slew**2, np.maximum(end - times, 0.0) / slew, end / slew,
                 slews.time_scaling[arms]]  # fmt: skip
        ahead = np.concatenate([times[:, None] + LOOK_AHEAD * slew, end[:, None]], axis=1)
        torques = (np.abs(slews.torques(ahead, arms)) / limits).max(axis=2)
        return {
            "clock": np.stack(clock, axis=1),
            "tip": self._departures(estimate.states[arms] - law.reference(estimate, arms), arms),
            "torques": np.concatenate([torques, np.abs(applied[arms]).max(axis=1)[:, None]], axis=1),
            "parameters": self._means(self._parameters(estimate, arms)),
            "deviations": self._means(self._deviations(arms)),
            "arm": np.tile(self._facts(), (len(arms), 1)),
            "action": self._shaping.action[arms][:, self._columns],
        }

    def _departures(self, states: Array, arms: IntArray) -> Array:
        """Return arcsinh of the departures (r, 4) of the tip from departures of the states (r, 2 d)."""
        d, result = self._plant.model.n_dof, []
        scales = self._reach * DEPARTURE, self._reach * RATE / self._scales.slew
        for coordinates, scale in zip((states[:, :d], states[:, d:]), scales, strict=True):
            tips = (self._jacobians[arms] * coordinates[:, None]).sum(axis=2) / scale
            along = (tips * self._directions[arms]).sum(axis=1)
            across = tips - along[:, None] * self._directions[arms]
            result += [along, np.sqrt((across**2).sum(axis=1))]
        return np.arcsinh(np.stack(result, axis=1))

    def _means(self, parameters: Array) -> Array:
        """Return payload / usual payload and means over joints and links (r, 3) of parameters (r, 1 + 2 n)."""
        n = self.joints
        return np.stack([parameters[:, 0] / self._payload, parameters[:, 1 : 1 + n].mean(axis=1),
                         parameters[:, 1 + n :].mean(axis=1)], axis=1)  # fmt: skip

    def _facts(self) -> Array:
        """Return the facts (3,) of the arm."""
        scales = self._scales
        ratio = np.clip(np.log(scales.torque_ratio), -MAX_LOG_RATIO, MAX_LOG_RATIO)
        return np.array([ratio, scales.vibration / scales.slew, ACTIONS_PER_SLEW * self._plant.period / scales.slew])


def _make(plant: Plant, base: Controller | None, units: object = "joint", **authority: object) -> ReferenceShapingMode:
    """Make the mode of reference shaping with observed quantities of the joints or in units of the arm."""
    kind = ArmShapingMode if one_of("actions.units", units, UNITS) == "arm" else ReferenceShapingMode
    return kind(plant, base, **authority)


ENTRY = ActionModeEntry(_make, (*ShapingLimits._fields, "units"))
