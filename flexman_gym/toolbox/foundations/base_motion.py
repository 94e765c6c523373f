"""Prescribed motion of the base of an arm, such as that of a deck in a seaway, and targets that rest in the world."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar

import numpy as np

from flexman_gym.agent.action_modes import ActionMode
from flexman_gym.agent.controller import Controller
from flexman_gym.common.arrays import Array, BoolArray
from flexman_gym.common.checks import non_negative, one_of, positive, set_fields
from flexman_gym.common.errors import value_error
from flexman_gym.envs.sensors.sensor import Entry
from flexman_gym.envs.view import View
from flexman_gym.kernels.foundation import turn_foundation
from flexman_gym.kernels.layout import FOUNDATION, FOUNDATION_DEGREE, FOUNDATION_PART
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.foundation import rotation_matrix

COMPONENTS = 12  # sines of each motion
LOWEST, HIGHEST = 0.6, 2.5  # frequencies of the sines / peak frequency
PEAK_FACTOR = 3.3  # of the JONSWAP spectrum
LARGEST_ANGLE = 0.5  # rad; largest significant amplitude of roll, pitch and yaw
ANGLES, LENGTHS = ("roll", "pitch", "yaw"), ("surge", "sway", "heave")
FRAMES = ("world", "base")  # frames in which a target may rest
SMALLEST_BOUND = 1e-6  # rad, m, and per s and s^2; of the readings of a motion that is zero


class PrescribedMotion(ABC):
    """Base class of the settings of a prescribed motion of the base; an agent does not command it."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the entries of an action: none."""
        return ()

    @property
    def rotates(self) -> bool:
        """True: the base may turn."""
        return True

    @property
    @abstractmethod
    def largest(self) -> Array:
        """Bounds (3, 6) of the motions, their rates and their accelerations."""

    @property
    def range(self) -> float:
        """Largest distance of the base from its origin, m."""
        return float(np.linalg.norm(self.largest[0, :3]))

    def make_mode(self, mode: ActionMode, base: Controller | None) -> ActionMode:
        """Return the action mode itself."""
        return mode

    def make(self, batch: Batch) -> "BaseMotion":
        """Return the motion of the bases of the arms of a batch."""
        return BaseMotion(self, batch)

    @abstractmethod
    def draw(self, random: np.random.Generator) -> Array:
        """Draw the parameters of the motion of an episode."""

    @abstractmethod
    def motion(self, drawn: Array, times: Array) -> tuple[Array, Array, Array]:
        """Return motions (r, 6), m and rad, rates and accelerations at times (r,), s, with parameters (r, ...)."""


@dataclass(frozen=True)
class Sea(PrescribedMotion):
    """Motion of a deck in a seaway, drawn for each episode; an agent does not command it.

    Each motion is a sum of 12 sines of equal energy, whose frequencies divide a JONSWAP spectrum (Hasselmann and
    others, 1973; peak factor 3.3) from 0.6 to 2.5 times the peak frequency, with random phases; see `BaseMotion`.

    Attributes:
        roll, pitch, yaw: significant amplitudes, rad: twice the standard deviation.
        surge, sway, heave: significant amplitudes, m.
        period: peak period, s.
        target: frame in which the target of a task rests, "world" or "base".
    """

    kind: ClassVar[str] = "sea"
    parameter: ClassVar[str] = "sea"
    roll: float = 0.06
    pitch: float = 0.03
    yaw: float = 0.02
    surge: float = 0.1
    sway: float = 0.2
    heave: float = 0.4
    period: float = 8.0
    target: str = "world"

    def __post_init__(self) -> None:
        for name, unit in (*((each, "rad") for each in ANGLES), *((each, "m") for each in LENGTHS)):
            set_fields(self, **{name: non_negative(f"Sea.{name}", getattr(self, name), unit)})
        for name in ANGLES:
            if getattr(self, name) > LARGEST_ANGLE:
                raise value_error(f"Sea.{name}", getattr(self, name), f"a number from 0 to {LARGEST_ANGLE:g} (rad)")
        set_fields(self, period=positive("Sea.period", self.period, "s"))
        one_of("Sea.target", self.target, FRAMES)

    @property
    def amplitudes(self) -> Array:
        """Amplitudes (6,) of the sines of surge, sway, heave (m), roll, pitch and yaw (rad)."""
        return np.array([getattr(self, name) for name in (*LENGTHS, *ANGLES)]) / math.sqrt(2.0 * COMPONENTS)

    @property
    def largest(self) -> Array:
        """Bounds (3, 6) of the motions, their rates and their accelerations."""
        fastest = 2.0 * np.pi * HIGHEST / self.period
        return COMPONENTS * self.amplitudes * np.array([[1.0], [fastest], [fastest**2]])

    def draw(self, random: np.random.Generator) -> Array:
        """Draw frequencies (rad/s) and phases (rad) of the sines of an episode, (6, COMPONENTS, 2)."""
        ratio, share = _spectrum_shares()
        places = (np.arange(COMPONENTS) + random.uniform(size=(6, COMPONENTS))) / COMPONENTS
        frequencies = 2.0 * np.pi / self.period * np.interp(places, share, ratio)
        return np.stack([frequencies, random.uniform(0.0, 2.0 * np.pi, (6, COMPONENTS))], axis=-1)

    def motion(self, drawn: Array, times: Array) -> tuple[Array, Array, Array]:
        """Return motions (r, 6), m and rad, rates and accelerations of sines (r, 6, COMPONENTS, 2) at times (r,), s."""
        rate, size = drawn[..., 0], self.amplitudes[:, None]
        angle = rate * times[:, None, None] + drawn[..., 1]
        sine, cosine = size * np.sin(angle), size * np.cos(angle) * rate
        return sine.sum(axis=2), cosine.sum(axis=2), -(sine * rate * rate).sum(axis=2)


@cache
def _spectrum_shares() -> tuple[Array, Array]:
    """Return frequencies / peak frequency, and the share of the energy of the spectrum below each of them."""
    ratio = np.linspace(LOWEST, HIGHEST, 2001)
    width = np.where(ratio <= 1.0, 0.07, 0.09)
    peak = PEAK_FACTOR ** np.exp(-(((ratio - 1.0) / width) ** 2) / 2.0)
    density = ratio**-5.0 * np.exp(-1.25 * ratio**-4.0) * peak
    share = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) / 2.0)])
    return ratio, share / share[-1]


class BaseMotion:
    """Prescribed motion of the bases of b arms: surge, sway, heave, roll, pitch and yaw.

    The attitude is yaw, then pitch, then roll; surge, sway and heave move the base along the axes of the world. In a
    control period the angular velocity is a cubic polynomial, and the acceleration of the base is constant in the base
    frame. The target of a task is given in the base frame at the start of an episode. It rests in the base frame or in
    the world from then on; then the goal of the motor angles follows it, by the inverse kinematics of the undeformed
    arm.

    Args:
        settings: the motion, a `Sea` or a `base_record.Record`.
        batch: simulated arms, with rotating bases, whose foundation rows are set.

    Attributes:
        accelerations: (b, 3) accelerations of the bases in the present control period, base frame, m/s^2: those in its
            middle.
    """

    state_fields = ("_drawn", "_targets", "_sag")

    def __init__(self, settings: Any, batch: Batch) -> None:
        self.settings, self._batch, arms = settings, batch, len(batch.rows)
        self.moves_goals = settings.target == "world"
        self._gravity = np.array(batch.model.constants.gravity)
        drawn = settings.draw(np.random.default_rng(0))
        self._drawn = np.zeros((arms, *drawn.shape))  # parameters of the motions
        self._targets, self._sag, self.accelerations = np.zeros((arms, 3)), np.zeros((arms, 3)), np.zeros((arms, 3))
        self._series = np.zeros((4, FOUNDATION_PART))

    def draw(self, random: np.random.Generator) -> dict[str, Array]:
        """Draw the parameters of the motion of an episode, by name."""
        return {self.settings.parameter: self.settings.draw(random)}

    def begin(self, arms: Any, parameters: Mapping[str, Array]) -> None:
        """Start episodes of the arms (r,) with parameters (r, ...) as drawn."""
        self._drawn[arms] = parameters[self.settings.parameter]
        self._set(arms, np.zeros(len(arms)))

    def ends(self, parameters: Mapping[str, Array]) -> None:
        """Return None: a prescribed motion has no goal."""

    def motion(self, arms: Any, times: Array) -> tuple[Array, Array, Array]:
        """Return the motions (r, 6), m and rad, of arms, their rates and accelerations at times (r,), s."""
        result: tuple[Array, Array, Array] = self.settings.motion(self._drawn[arms], times)
        return result

    def _set(self, arms: Any, times: Array) -> None:
        """Set accelerations and foundation rows of arms for a control period from times (r,), s, on."""
        period = self._batch.control_period
        start, end = self.motion(arms, times), self.motion(arms, times + period)
        middle, _, acceleration = self.motion(arms, times + 0.5 * period)
        self.accelerations[arms] = _to_base(middle, acceleration[:, :3])
        spin, first, last = _body_rates(*start[:2]), _body_accelerations(*start), _body_accelerations(*end)
        mean = (_body_rates(*end[:2]) - spin) / period
        # the cubic polynomial of the angular velocity with the values and slopes of both ends
        series = np.zeros((len(times), 3, FOUNDATION_DEGREE))
        series[..., 0] = first
        series[..., 1] = 2.0 * (3.0 * mean - 2.0 * first - last) / period
        series[..., 2] = 3.0 * (first + last - 2.0 * mean) / period**2
        rows = np.zeros((len(times), FOUNDATION))
        turn_foundation(_quaternions(start[0]), spin, series, self._gravity, period, rows, self._series)
        self._batch.foundation[arms] = rows

    def move(self, mode: Any, moving: BoolArray) -> None:
        """Set accelerations and foundation rows of the moving arms (b,) for the next control period."""
        arms = np.flatnonzero(moving)
        self._set(arms, self._batch.time[arms])

    def aim(self, view: View, arms: Any) -> None:
        """Store the targets of arms, which rest in the world from now on, the start of an episode."""
        pose = self.motion(arms, np.zeros(len(self._drawn[arms])))[0]
        self._targets[arms] = pose[:, :3] + np.einsum("rij,rj->ri", _attitudes(pose), view.target[arms])
        angles = view.goal_angles[arms]
        self._sag[arms] = view.rest_tips(angles) - view.rigid_tips(angles)

    def follow(self, view: View, arms: Any) -> None:
        """Set the targets of arms that rest in the world, their goals of the motor angles, and the rates of both."""
        if not self.moves_goals:
            return
        pose = self.motion(arms, self._batch.time[arms])[0]
        target, before = _to_base(pose, self._targets[arms] - pose[:, :3]), view.goal_angles[arms]
        pairs = zip(target - self._sag[arms], before, strict=True)
        angles = np.array([view.inverse_kinematics(tip[None], near)[0][0] for tip, near in pairs]).reshape(before.shape)
        view.target_velocity[arms] = (target - view.target[arms]) / view.control_period
        view.goal_rates[arms] = (angles - before) / view.control_period
        view.target[arms], view.goal_angles[arms] = target, angles

    def path(self, parameters: Mapping[str, Array], periods: int, view: View) -> Array:
        """Return the goals of the motor angles (r, T + 1, n), rad, over T control periods of r episodes."""
        times, result = view.control_period * np.arange(periods + 1.0), []
        name = "goal_angles" if "goal_angles" in parameters else "start"
        for drawn, angles in zip(parameters[self.settings.parameter], parameters[name], strict=True):
            pose = self.settings.motion(np.broadcast_to(drawn, (len(times), *drawn.shape)), times)[0]
            rest, rigid = view.rest_tips(angles[None])[0], view.rigid_tips(angles[None])[0]
            world = pose[0, :3] + _attitudes(pose[:1])[0] @ rest
            tips = _to_base(pose, world - pose[:, :3]) - (rest - rigid)
            result.append(view.inverse_kinematics(tips, angles)[0])
        return np.array(result)

    def entries(self) -> list[Entry]:
        """Return the entries of `readings`."""
        pose, rate, acceleration = np.maximum(self.settings.largest, SMALLEST_BOUND)
        return [
            Entry("base_angles", 3, "rad", pose[3:]),
            Entry("base_rates", 3, "rad/s", np.full(3, rate[3:].sum())),
            Entry("base_accelerations", 3, "m/s^2", acceleration[:3]),
        ]

    @property
    def displacements(self) -> Array:
        """Zeros (b, 3): pictures show the arm in the base frame."""
        return np.zeros_like(self._targets)

    @property
    def goals(self) -> Array:
        """Zeros (b, 3), as `displacements`."""
        return np.zeros_like(self._targets)

    @property
    def readings(self) -> Array:
        """Roll, pitch and yaw, rad, angular velocity, base frame, rad/s, and acceleration, world, m/s^2, (b, 9)."""
        pose, rate, acceleration = self.motion(slice(None), self._batch.time)
        return np.hstack([pose[:, 3:], _body_rates(pose, rate), acceleration[:, :3]])


def _quaternions(pose: Array) -> Array:
    """Return the attitudes (r, 4), unit quaternions, scalar first, of poses (r, 6): yaw, then pitch, then roll."""
    (sr, sp, sy), (cr, cp, cy) = np.sin(pose[:, 3:] / 2.0).T, np.cos(pose[:, 3:] / 2.0).T
    return np.column_stack([
        cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    ])  # fmt: skip


def _attitudes(pose: Array) -> Array:
    """Return the rotation matrices (r, 3, 3), base frame to world frame, of poses (r, 6)."""
    return rotation_matrix(_quaternions(pose))


def _to_base(pose: Array, vectors: Array) -> Array:
    """Return vectors (r, 3) of the world frame in the base frames of poses (r, 6)."""
    result: Array = np.einsum("rji,rj->ri", _attitudes(pose), vectors)
    return result


def _body_rates(pose: Array, rate: Array) -> Array:
    """Return the angular velocities (r, 3), base frame, rad/s, of poses (r, 6) and their rates."""
    (sr, sp, _), (cr, cp, _) = np.sin(pose[:, 3:]).T, np.cos(pose[:, 3:]).T
    roll, pitch, yaw = rate[:, 3:].T
    return np.column_stack([roll - yaw * sp, pitch * cr + yaw * cp * sr, yaw * cp * cr - pitch * sr])


def _body_accelerations(pose: Array, rate: Array, acceleration: Array) -> Array:
    """Return the time derivatives (r, 3) of `_body_rates`, rad/s^2."""
    (sr, sp, _), (cr, cp, _) = np.sin(pose[:, 3:]).T, np.cos(pose[:, 3:]).T
    roll, pitch, yaw = rate[:, 3:].T
    tilt = yaw * cp
    return _body_rates(pose, acceleration) + np.column_stack([
        -tilt * pitch, (tilt * cr - pitch * sr) * roll - yaw * sp * pitch * sr,
        -(tilt * sr + pitch * cr) * roll - yaw * sp * pitch * cr,
    ])  # fmt: skip
