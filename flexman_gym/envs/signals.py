"""Signals: effects on what passes between an agent and its arms, one class each; `SIGNALS` names them."""

from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import numpy as np

from flexman_gym.arrays import Array, Flags, IntArray
from flexman_gym.checks import non_negative, positive, refusal, whole_number
from flexman_gym.envs.limits import Limits
from flexman_gym.model.model import Model
from flexman_gym.simulation.batch import Batch

Range = tuple[float, float]
BLOCK = 32  # observations whose noise is drawn at once
LONGEST_DELAY = 1000  # control periods
TRUNCATION = 4.0  # standard deviations; noise beyond it is drawn again


@dataclass(frozen=True, eq=False)
class Stage:
    """What effects act on.

    Attributes:
        batch, limits: the arms and their limits.
        bound: (size,) largest magnitude of each number that the sensors give.
        torque_limits: (b, n) N m, which effects may overwrite; `nominal` (n,) is what they are without.
        impulse_gap: s.
    """

    batch: Batch
    limits: Limits
    bound: Array
    torque_limits: Array
    nominal: Array
    impulse_gap: float


class Signal(Protocol):
    """An effect on b arms. A class with `checked`, `shape`, `draw` and at least one of the hooks is one.

    Hooks: `begin(arms, drawn)` after the draws of new episodes of the arms (r,), with what every arm drew (b, ...);
    `bend(arms, states)` changes the states (r, 2 d) that they start from; `act(actions)` returns what reaches the
    motors of actions (b, n); `push(forces, over)` writes forces (b, 3) N on the tips; `observe(observations, arms)`
    returns what is seen of observations (r, size). `growth`, where there is one, is the part by which the bounds of the
    observations grow.
    """

    def __init__(self, stage: Stage, span: Range) -> None: ...

    @staticmethod
    def checked(field: str, value: object) -> float:
        """One end of the range, checked."""
        ...

    @property
    def shape(self) -> tuple[int, ...] | None:
        """Of what an episode draws; None where that is not told."""
        ...

    def draw(self, arm: int, stream: np.random.Generator) -> Any:
        """What the episode of an arm draws: one draw of its stream, the rest from a generator that this draw seeds."""
        ...


class TorqueLimit:
    """Factors > 0 on the torque limits, one for each joint."""

    kind: ClassVar[type] = float

    def __init__(self, stage: Stage, span: Range) -> None:
        self._stage, self._span, self.shape = stage, span, stage.nominal.shape

    @staticmethod
    def checked(field: str, value: object) -> float:
        """A factor > 0."""
        return positive(field, value)

    def draw(self, arm: int, stream: np.random.Generator) -> Array:
        """Torque limits, N m."""
        return stream.uniform(*self._span, self.shape) * self._stage.nominal

    def begin(self, arms: IntArray, drawn: Array) -> None:
        """Sets the limits."""
        self._stage.torque_limits[arms] = drawn[arms]


class SensorNoise:
    """Standard deviation of normal noise on each number of each observation, as a part of its bound.

    A number beyond 4 standard deviations is drawn again. The bounds of the observation space grow by 4 times the
    largest standard deviation; whether an arm leaves its limits is decided without noise.
    """

    kind: ClassVar[type] = float
    shape = ()

    def __init__(self, stage: Stage, span: Range) -> None:
        arms = len(stage.batch.rows)
        self._bound, self._span, self.growth = stage.bound, span, TRUNCATION * span[1]
        self._inner: list[Any] = [None] * arms
        self._noise, self._used = np.zeros((arms, BLOCK, len(stage.bound))), np.zeros(arms, dtype=np.int64)
        self._deviation, self._all = np.zeros((arms, 1)), np.arange(arms)

    @staticmethod
    def checked(field: str, value: object) -> float:
        """A part >= 0."""
        return non_negative(field, value)

    def draw(self, arm: int, stream: np.random.Generator) -> float:
        """The standard deviation."""
        self._inner[arm] = np.random.default_rng(stream.integers(2**63))
        return stream.uniform(*self._span)

    def begin(self, arms: IntArray, drawn: Array) -> None:
        """Noise of the episode before is not used."""
        self._deviation[arms, 0], self._used[arms] = drawn[arms], BLOCK

    def observe(self, observations: Array, arms: IntArray | None) -> Array:
        """Observations (r, size) of the arms (r,), or of all, with noise."""
        arms = self._all if arms is None else arms
        for arm in arms[self._used[arms] == BLOCK].tolist():
            self._noise[arm], self._used[arm] = _normal(self._inner[arm], self._noise.shape[1:]), 0
        noise = self._noise[arms, self._used[arms]]
        self._used[arms] += 1
        return observations + noise * self._deviation[arms] * self._bound


class Delay:
    """Whole control periods by which torques come late; before the first there is none."""

    kind: ClassVar[type] = int
    shape = ()

    def __init__(self, stage: Stage, span: Range) -> None:
        arms, n = stage.torque_limits.shape
        self._span = span
        self._past, self._late = np.zeros((1 + int(span[1]), arms, n)), np.zeros(arms, dtype=np.int64)
        self._now, self._all = 0, np.arange(arms)

    @staticmethod
    def checked(field: str, value: object) -> float:
        """A whole number of periods."""
        return whole_number(field, value, 0, LONGEST_DELAY)

    def draw(self, arm: int, stream: np.random.Generator) -> int:
        """The number of periods."""
        low, high = map(int, self._span)
        return int(stream.integers(low, high + 1))

    def begin(self, arms: IntArray, drawn: Array) -> None:
        """Torques of the episode before do not arrive."""
        self._late[arms] = drawn[arms]
        self._past[:, arms] = 0.0

    def act(self, actions: Array) -> Array:
        """Keeps the actions (b, n) and returns those that reach the motors now."""
        depth = len(self._past)
        self._now = (self._now + 1) % depth
        self._past[self._now] = actions
        return self._past[(self._now - self._late) % depth, self._all]


class InitialVibration:
    """Deflection, m, of the tip of each flexible link at the start, from where the arm is released.

    Its direction across the beam is random, its shape the one that a force on the tip gives. Directions into which the
    model of a link cannot bend are left out.
    """

    kind: ClassVar[type] = float

    def __init__(self, stage: Stage, span: Range) -> None:
        model = self._model = stage.batch.model
        self._flexible, self._span, self.shape = np.diff(model.constants.elastic_start) > 0, span, (model.n_joints, 2)
        field = "Randomisation.initial_vibration"
        if not self._flexible.any():
            raise refusal(field, span, "None: every link of this arm is rigid")
        most = stage.limits.deflection * model.constants.length[self._flexible].min()
        if span[1] > most:
            raise refusal(field, span, f"at most {most:.4g} (m), the limit of the deflection of a link")
        self._shapes = [_bent(model, link) for link in range(model.n_joints)]
        self._drawn = np.zeros((0, *self.shape))

    @staticmethod
    def checked(field: str, value: object) -> float:
        """A length >= 0."""
        return non_negative(field, value)

    def draw(self, arm: int, stream: np.random.Generator) -> Array:
        """(n, 2) m, deflections along y and z of each link's beam frame."""
        n = len(self._flexible)
        size, angle = stream.uniform(*self._span, n), stream.uniform(0.0, 2.0 * np.pi, n)
        return (self._flexible * size * np.array([np.cos(angle), np.sin(angle)])).T

    def begin(self, arms: IntArray, drawn: Array) -> None:
        """Keeps what was drawn."""
        self._drawn = drawn

    def bend(self, arms: IntArray, states: Array) -> None:
        """Deflects the links."""
        for link, shape in enumerate(self._shapes):
            for row, tip in enumerate(self._drawn[arms, link]):
                states[row, self._model.elastic_columns(link)] = shape @ tip


class TipImpulse:
    """Impulses, N s, of random directions, each a force on the tip during one control period, at random times."""

    kind: ClassVar[type] = float
    shape = None

    def __init__(self, stage: Stage, span: Range) -> None:
        self._period, self._gap_time, self._span = stage.batch.control_period, stage.impulse_gap, span
        arms = len(stage.batch.rows)
        self._inner: list[Any] = [None] * arms
        self._wait = np.zeros(arms, dtype=np.int64)

    @staticmethod
    def checked(field: str, value: object) -> float:
        """A size >= 0."""
        return non_negative(field, value)

    def draw(self, arm: int, stream: np.random.Generator) -> None:
        """The time until the first impulse."""
        self._inner[arm] = np.random.default_rng(stream.integers(2**63))
        self._wait[arm] = self._gap(arm)

    def push(self, forces: Array, over: Flags) -> None:
        """Adds the forces during this period; arms whose episode is over wait."""
        self._wait -= 1
        for arm in np.flatnonzero((self._wait <= 0) & ~over).tolist():
            inner = self._inner[arm]
            size, way = inner.uniform(*self._span), inner.normal(size=3)
            forces[arm] += size / self._period * way / np.sqrt(way @ way)
            self._wait[arm] = self._gap(arm)

    def _gap(self, arm: int) -> int:
        """Periods until the next impulse."""
        return int(self._inner[arm].geometric(self._period / self._gap_time))


SIGNALS: dict[str, Any] = {
    "torque_limit": TorqueLimit,
    "sensor_noise": SensorNoise,
    "delay": Delay,
    "initial_vibration": InitialVibration,
    "tip_impulse": TipImpulse,
}


def _normal(random: np.random.Generator, shape: tuple[int, ...]) -> Array:
    """Standard normal numbers within the truncation, by rejection."""
    values = random.standard_normal(shape)
    while (beyond := np.abs(values) > TRUNCATION).any():
        values[beyond] = random.standard_normal(np.count_nonzero(beyond))
    return values


def _bent(model: Model, link: int) -> Array:
    """(k_i, 2) coordinates of a link per metre that a force on its tip deflects it along y and z."""
    constants = model.constants
    start, stop = constants.elastic_start[link : link + 2]
    first, last = constants.square_start[link : link + 2]
    stiffness = constants.stiffness[first:last].reshape(stop - start, stop - start)
    across = constants.tip_translation[start:stop, 1:]
    yielding = np.linalg.solve(stiffness, across)
    return yielding @ np.linalg.pinv(across.T @ yielding)
