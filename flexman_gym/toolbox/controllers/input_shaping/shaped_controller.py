"""Controller with an input shaper for its command."""

from collections.abc import Iterable, Mapping
from functools import reduce
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from flexman_gym.agent.base_controllers import ControllerEntry
from flexman_gym.agent.controller import Controller, EpisodeInfo, Plant, Readings, checked_controller
from flexman_gym.agent.pd import make_pd
from flexman_gym.common.arrays import Array, BoolArray, IntArray, Vector, pad_rows
from flexman_gym.common.checks import non_negative, sample_count, sequence, vector, whole_number
from flexman_gym.common.errors import value_error
from flexman_gym.model.model import Model, check_model
from flexman_gym.model.statics import rest_state, rest_tips
from flexman_gym.toolbox.controllers.excited_modes import excited_modes, travel_modes
from flexman_gym.toolbox.controllers.input_shaping.shaped_travel import ShapedTravel
from flexman_gym.toolbox.controllers.input_shaping.shapers import (
    DEFAULT_TOLERANCE,
    Shaper,
    convolve_samples,
    design_shaper,
)
from flexman_gym.toolbox.controllers.lqr import LQR
from flexman_gym.toolbox.controllers.references.trajectories import QUINTIC, TIMINGS

MAX_MODES = 2  # largest number of shaped modes
REST_PERIODS = 40  # control periods at the goal at the end of a command, so that splines through it end at rest
ANGLE_QUANTITIES, RATE_QUANTITIES = ("angle_errors", "angle_command"), ("goal_rates", "rate_command")
TIP_QUANTITIES, TIP_RATE_QUANTITIES = ("target_error", "tip_command"), ("tip_velocity_command",)
SHIFTED_QUANTITIES = (*ANGLE_QUANTITIES, *RATE_QUANTITIES, *TIP_QUANTITIES, *TIP_RATE_QUANTITIES)
# readings of the goal that cannot be shaped
REFUSED_QUANTITIES = ("target_nearness", "fine_angle_errors", "fine_target_error", "preview")


class InputShapedController:
    """Controller whose goal command is convolved with the impulses of an input shaper, to avoid residual vibration.

    The command is a step from start to goal, a minimum-jerk motion, or the path of a moving goal. The inner controller
    receives the shaped command as `EpisodeInfo.reference` and in its readings of the goal: angle_errors, goal_rates,
    angle_command, rate_command, target_error, tip_command, tip_velocity_command. An LQR regulates the state about the
    equilibrium of its fixed goal; to make it follow the command, its readings of the state are shifted by the
    equilibrium state of the goal minus the equilibrium state of the command. A TrackingLQR requires a duration, since
    no arm follows a step.

    Shaping prevents vibration due to the command, not due to disturbances. The shaper is designed for the modes with
    held motors; with low controller gains the closed loop has different modes.

    Args:
        inner: any Controller.
        model: model of the arm, for its modes and tip positions.
        shaper: name in `SHAPERS`.
        modes: number of shaped modes, 1 or 2, from the lowest; or one or two pairs of frequency (Hz) and damping ratio.
        places: path parameters, from 0 at the start to 1 at the goal, of the postures over which modes are averaged.
        duration: duration of the minimum-jerk motion before shaping, s; 0 for a step.
        tolerance: residual vibration tolerated by EI shapers, as a fraction.
    """

    state_fields = ("_now", "inner")
    c_program = "flexman_gym.toolbox.deployment.c_programs:shaped_program"

    def __init__(
        self,
        inner: Controller,
        model: Model,
        shaper: str = "zvd",
        modes: int | Array | list[tuple[float, float]] = 1,
        places: Vector = (1.0,),
        duration: float = 0.0,
        tolerance: float = DEFAULT_TOLERANCE,
    ) -> None:
        self.inner, self.model = checked_controller("InputShapedController.inner", inner), check_model(model)
        self.sensors = inner.sensors
        given = self._given_modes = _parse_modes(modes) if isinstance(modes, list | tuple | np.ndarray) else None
        self._count = whole_number("InputShapedController.modes", modes, 1, MAX_MODES) if given is None else len(given)
        self.places = vector("InputShapedController.places", places)
        self.duration = non_negative("InputShapedController.duration", duration, "s")
        if not all(0.0 <= place <= 1.0 for place in self.places):
            raise value_error("InputShapedController.places", places, "numbers from 0 to 1")
        for frequency, ratio in [(1.0, 0.0)] if given is None else given.tolist():
            design_shaper(shaper, frequency, ratio, tolerance)  # checks the arguments
        self.shaper, self.tolerance = shaper, tolerance
        self._travel: ShapedTravel | None = None
        self._commands: list[_Command] = []
        self._now = np.zeros(0, dtype=np.int64)

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Compute the shaped commands of new episodes, and start the inner controller; see `Controller.reset`."""
        self._now = pad_rows(self._now, count)
        self._now[arms] = 0
        for row, arm in enumerate(arms.tolist()):
            start, goal = episode.start[row], episode.goal[row]
            path = None if episode.reference is None else episode.reference[row]
            command = self._shape(start, goal, episode.period, path)
            self._commands += [command] * (arm + 1 - len(self._commands))
            self._commands[arm] = command
            self.inner.reset(np.array([arm]), EpisodeInfo(start[None], goal[None], episode.period, command.path), count)
            if self._travel is not None and episode.travel is not None:
                self._travel.begin(arm, goal, episode.travel[row], episode.period)

    def act(self, readings: Readings, applied: Array, active: BoolArray) -> NDArray[Any]:
        """Return the actions (b, n) of the inner controller for the shaped command; arguments as in `Controller.act`.

        Raises:
            ValueError: for a reading of the goal that cannot be shaped.
        """
        shaped = self._shaped(readings)
        self._now += active
        return self.inner.act(shaped, applied, active)

    def shape_travel(self, foundation: Any) -> Self:
        """Shape the motion of a foundation, `foundations.travel.Travel`, too; None for a fixed one. Returns itself."""
        self._travel = None if foundation is None else ShapedTravel(foundation, self._travel_shaper)
        return self

    def travel(self, readings: Readings, active: BoolArray) -> Array:
        """Return the commanded velocities (b, 1) of the foundations as fractions of the largest, see FoundationMode."""
        assert self._travel is not None
        return self._travel.commands(readings, self._now)

    def _travel_shaper(self, posture: Array, axis: Vector) -> Shaper:
        """Return the shaper for the modes at a posture (n,), rad, that a travel along an axis (3,) excites."""
        modes = self._given_modes
        if modes is None:
            modes = travel_modes(self.model, posture, axis)[: self._count, :2]
        return self._of_modes(modes)

    def skip(self, active: BoolArray) -> None:
        """Advance the commands of the active arms by a control period without readings, see `Controller`."""
        self._now += active
        if hasattr(self.inner, "skip"):
            self.inner.skip(active)

    def prepare(self, applied: Array, active: BoolArray) -> None:
        """Prepare the next action of the inner controller, see `Controller`."""
        if hasattr(self.inner, "prepare"):
            self.inner.prepare(applied, active)

    @property
    def estimates(self) -> Mapping[str, Array]:
        """Estimates of the inner controller, name -> (b, ...)."""
        return getattr(self.inner, "estimates", {})

    @property
    def gain_units(self) -> Mapping[str, str]:
        """Units of the gains of the inner controller, by name, see `Controller`."""
        return getattr(self.inner, "gain_units", {})

    @property
    def gravity_model(self) -> Model | None:
        """Model whose weight the inner controller compensates; None without."""
        return getattr(self.inner, "gravity_model", None)

    def derivatives(self, readings: Readings, changes: Readings) -> tuple[Array, Array]:
        """Return the actions (1, n) of an arm and their derivatives (p, n), see `Controller`."""
        result: tuple[Array, Array] = self.inner.derivatives(self._shaped(readings), changes)  # type: ignore[attr-defined]
        return result

    def move_tables(self, names: Iterable[str]) -> dict[str, Array]:
        """Return what is added to readings in each control period of the present move of a single arm.

        Args:
            names: names of readings; a reading that is not shaped is omitted.

        Returns:
            Name -> (K, size).
        """
        return {name: self._commands[0].offset(name) for name in names if self._is_shifted(name)}

    def _is_shifted(self, name: str) -> bool:
        """Return True for readings that are shifted by the command; raise ValueError for those that cannot be."""
        if name in REFUSED_QUANTITIES:
            allowed = f"one that reads none of {REFUSED_QUANTITIES}"
            raise value_error("InputShapedController.inner", f"a controller that reads {name}", allowed)
        return name in SHIFTED_QUANTITIES or (name == "state" and type(self.inner) is LQR)

    def _shaped(self, readings: Readings) -> Readings:
        """Return the readings for the shaped command of this period."""
        shaped = dict(readings)
        for name, values in readings.items():
            if self._is_shifted(name):
                commands = zip(self._commands, self._now.tolist(), strict=True)
                shaped[name] = values + np.array([each.offset(name)[min(now, each.last)] for each, now in commands])
        return shaped

    def combined(self, postures: Array) -> Shaper:
        """Return the shaper for all shaped modes; the modes are averaged over postures (p, n) rad."""
        modes = self._given_modes
        if modes is None:
            found = [excited_modes(self.model, posture)[: self._count, :2] for posture in postures]
            modes = np.mean([each[: min(map(len, found))] for each in found], axis=0)
        return self._of_modes(modes)

    def _of_modes(self, modes: Array) -> Shaper:
        """Return the shaper for modes (k, 2): frequencies (Hz) and damping ratios."""
        if not len(modes):
            raise value_error("InputShapedController.modes", self._count, "modes of a flexible arm: this arm has none")
        shapers = [design_shaper(self.shaper, each, ratio, self.tolerance) for each, ratio in modes.tolist()]
        return reduce(Shaper.convolve, shapers)

    def _shape(self, start: Array, goal: Array, period: float, path: Array | None) -> "_Command":
        """Return the shaped command of one arm, for a path (T + 1, n) rad or from start to goal, (n,) rad each."""
        if path is None:
            count = sample_count("control_period", period, self.duration) + 1
            times = period * np.arange(count, dtype=np.float64)
            progress = TIMINGS[QUINTIC].at(times / self.duration)[0] if self.duration else np.ones(count)
            plain, before = start + progress[:, None] * (goal - start), start
            postures = start + np.array(self.places)[:, None] * (goal - start)
        else:
            plain, before = path, path[0]
            postures = path[np.rint(np.array(self.places) * (len(path) - 1)).astype(int)]
        without_motors = self.model.constants.passive.all()
        fractions = np.ones(1) if without_motors else self.combined(postures).sample(period)
        if path is None:
            plain = np.vstack([plain, np.repeat(goal[None], len(fractions) + REST_PERIODS, axis=0)])
        rates = np.diff(plain, axis=0, prepend=plain[:1]) / period
        goals = np.broadcast_to(goal, plain.shape) if path is None else path
        goal_rates = np.zeros_like(rates) if path is None else rates
        shaped, shaped_rates = before + convolve_samples(fractions, plain - before), convolve_samples(fractions, rates)
        return _Command(self.model, period, shaped, shaped_rates, goals, goal_rates)


class _Command:
    """Shaped command of one arm, angles (K, n) rad and rates, and its differences from the goal, (K, n) each."""

    def __init__(
        self, model: Model, period: float, angles: Array, rates: Array, goals: Array, goal_rates: Array
    ) -> None:
        self.angles, self.last = angles, len(angles) - 1
        self._model, self._period, self._goals = model, period, goals
        self._offsets: dict[str, Array] = dict.fromkeys(ANGLE_QUANTITIES, angles - goals)
        self._offsets |= dict.fromkeys(RATE_QUANTITIES, rates - goal_rates)

    def path(self) -> Array:
        """Return the shaped motor angles (1, K, n) rad, in the form of `EpisodeInfo.reference`."""
        return self.angles[None]

    def offset(self, name: str) -> Array:
        """Return the offset (K, size) of a reading; offsets of states and tips are computed on first use."""
        if name == "state" and name not in self._offsets:
            self._offsets[name] = rest_state(self._model, self._goals[:1]) - rest_state(self._model, self.angles)
        elif name not in self._offsets:
            tips = rest_tips(self._model, self.angles) - rest_tips(self._model, self._goals)
            rates = np.diff(tips, axis=0, prepend=tips[:1]) / self._period
            self._offsets |= dict.fromkeys(TIP_QUANTITIES, tips) | dict.fromkeys(TIP_RATE_QUANTITIES, rates)
        return self._offsets[name]


def _parse_modes(value: object) -> Array:
    """Return checked modes (k, 2): frequencies (Hz) and damping ratios."""
    pairs = sequence("InputShapedController.modes", value, "pairs of frequency (Hz) and damping ratio")
    if not 1 <= len(pairs) <= MAX_MODES:
        raise value_error(
            "InputShapedController.modes", value, f"1 to {MAX_MODES} pairs of frequency (Hz) and damping ratio"
        )
    return np.array([vector(f"InputShapedController.modes[{i}]", pair, 2) for i, pair in enumerate(pairs)])


def _make(plant: Plant, **given: Any) -> InputShapedController:
    gains = {name: given.pop(name) for name in ("stiffness", "damping") if name in given}
    return InputShapedController(make_pd(plant, **gains), plant.model, **given).shape_travel(plant.foundation)


ENTRY = ControllerEntry(
    _make,
    ("model",),
    ("stiffness", "damping", "shaper", "modes", "places", "duration"),
    "the PD with an input shaper (ZVD) for the lowest mode of the nominal arm",
    "that of the PD",
    passive="all",
)
