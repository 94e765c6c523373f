"""Effects on signals: torque limits, noise, delay, initial vibration, impulses, loads and base motion."""

from typing import Any, ClassVar

import numpy as np

from flexman_gym.common.arrays import Array, BoolArray, IntArray
from flexman_gym.common.checks import non_negative, positive, value_error, whole_number
from flexman_gym.envs.effects.effect import EffectContext, Range
from flexman_gym.envs.random_streams import TruncatedNoise
from flexman_gym.model.dynamics import frequencies
from flexman_gym.model.model import Model


class _TorqueLimit:
    """Factors > 0 on the torque limits, one for each joint."""

    kind: ClassVar[type] = float
    factor: ClassVar[bool] = True

    def __init__(self, stage: EffectContext, span: Range) -> None:
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


class _SensorNoise:
    """Standard deviation of normal noise on each measured quantity in each control period, as a part of its range.

    A number beyond 4 standard deviations is drawn again, one beyond the range is cut off there. Goals are not measured.
    What is derived from measurements, such as errors and nearness, is as uncertain as they are. All sensors, and a
    base, see the same measurements. Whether an arm leaves its limits is decided without noise.
    """

    kind: ClassVar[type] = float
    state_fields = ("_noise", "_deviation")
    shape = ()

    def __init__(self, stage: EffectContext, span: Range) -> None:
        arms = len(stage.batch.rows)
        self._bound, self._span = stage.bound, span
        self._noise, self._deviation = TruncatedNoise(arms, len(stage.bound)), np.zeros((arms, 1))

    @staticmethod
    def checked(field: str, value: object) -> float:
        """A part from 0 to 1."""
        part = non_negative(field, value)
        if part > 1.0:
            raise value_error(field, value, "a part from 0 to 1 of the range")
        return part

    def draw(self, arm: int, stream: np.random.Generator) -> float:
        """The standard deviation."""
        self._noise.begin(arm, stream)
        return stream.uniform(*self._span)

    def begin(self, arms: IntArray, drawn: Array) -> None:
        """Takes the deviations of new episodes."""
        self._deviation[arms, 0] = drawn[arms]

    def measure(self, values: Array, arms: IntArray) -> Array:
        """Measured values (r, size) of the arms (r,) with noise."""
        return values + self._noise.sample(arms) * self._deviation[arms] * self._bound


MAX_DELAY = 1000  # control periods


class _Delay:
    """Whole control periods by which torques come late; before the first there is none."""

    kind: ClassVar[type] = int
    state_fields = ("_past", "_late", "_now")
    shape = ()

    def __init__(self, stage: EffectContext, span: Range) -> None:
        arms, n = stage.torque_limits.shape
        self._span = span
        self._past, self._late = np.zeros((1 + int(span[1]), arms, n)), np.zeros(arms, dtype=np.int64)
        self._now, self._all = 0, np.arange(arms)

    @staticmethod
    def checked(field: str, value: object) -> float:
        """A whole number of periods."""
        return whole_number(field, value, 0, MAX_DELAY)

    def draw(self, arm: int, stream: np.random.Generator) -> int:
        """The number of periods."""
        low, high = map(int, self._span)
        return int(stream.integers(low, high + 1))

    def begin(self, arms: IntArray, drawn: Array) -> None:
        """Torques of the episode before do not arrive."""
        self._late[arms] = drawn[arms]
        self._past[:, arms] = 0.0

    def motor_actions(self, actions: Array) -> Array:
        """Keeps the actions (b, n) and returns those that reach the motors now."""
        depth = len(self._past)
        self._now = (self._now + 1) % depth
        self._past[self._now] = actions
        return self._past[(self._now - self._late) % depth, self._all]


class _InitialVibration:
    """Deflection, m, of the tip of each flexible link at the start, from where the arm is released.

    A force of random direction across the beam bends the link. It is as large as deflects the tip by so much in the
    direction in which the link bends most. A tip is therefore deflected less in a stiffer direction, and not at all in
    one into which the model of the link cannot bend.
    """

    kind: ClassVar[type] = float

    def __init__(self, stage: EffectContext, span: Range) -> None:
        model = self._model = stage.batch.model
        self._flexible, self._span, self.shape = np.diff(model.constants.elastic_start) > 0, span, (model.n_joints, 2)
        field = "Randomisation.initial_vibration"
        if not self._flexible.any():
            raise value_error(field, span, "None: every link of this arm is rigid")
        most = stage.limits.deflection * model.constants.length[self._flexible].min()
        if span[1] > most:
            raise value_error(field, span, f"at most {most:.4g} (m), the limit of the deflection of a link")
        self._shapes = [static_shape(model, link) for link in range(model.n_joints)]
        self._ways = np.array([_relative_compliance(model, link) for link in range(model.n_joints)])
        self._drawn = np.zeros((0, *self.shape))

    @staticmethod
    def checked(field: str, value: object) -> float:
        """A length >= 0."""
        return non_negative(field, value)

    def draw(self, arm: int, stream: np.random.Generator) -> Array:
        """(n, 2) m, deflections along y and z of each link's beam frame."""
        n = len(self._flexible)
        size, angle = stream.uniform(*self._span, n), stream.uniform(0.0, 2.0 * np.pi, n)
        forces = (self._flexible * size * np.array([np.cos(angle), np.sin(angle)])).T
        return np.einsum("nij,nj->ni", self._ways, forces)

    def begin(self, arms: IntArray, drawn: Array) -> None:
        """Keeps what was drawn."""
        self._drawn = drawn

    def change_start(self, arms: IntArray, states: Array) -> None:
        """Deflects the links."""
        for link, shape in enumerate(self._shapes):
            for row, tip in enumerate(self._drawn[arms, link]):
                states[row, self._model.elastic_columns(link)] = shape @ tip


def _relative_compliance(model: Model, link: int) -> Array:
    """(2, 2) deflection of a link's tip along y and z by forces along them, as a part of the largest."""
    across, yielding = _tip_flexibility(model, link)
    compliance = across.T @ yielding
    largest = np.linalg.norm(compliance, 2)
    return compliance / largest if largest > 0.0 else compliance


def static_shape(model: Model, link: int) -> Array:
    """(k_i, 2) coordinates of a link per metre that a force on its tip deflects it along y and z."""
    across, yielding = _tip_flexibility(model, link)
    return yielding @ np.linalg.pinv(across.T @ yielding)


def _tip_flexibility(model: Model, link: int) -> tuple[Array, Array]:
    """Both (k_i, 2): how coordinates move the tip along y and z, and how forces on it move them."""
    constants = model.constants
    start, stop = constants.elastic_start[link : link + 2]
    first, last = constants.square_start[link : link + 2]
    stiffness = constants.stiffness[first:last].reshape(stop - start, stop - start)
    across = constants.tip_translation[start:stop, 1:]
    return across, np.asarray(np.linalg.solve(stiffness, across), dtype=np.float64)


class _TipImpulse:
    """Impulses, N s, of random directions, each a force on the tip during one control period, at random times."""

    kind: ClassVar[type] = float
    state_fields = ("_inner", "_wait")
    shape = None

    def __init__(self, stage: EffectContext, span: Range) -> None:
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

    def add_tip_forces(self, forces: Array, over: BoolArray) -> None:
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


class TipLoad:
    """Forces, N, on the tip that stay until the next change of load, of random directions and at random times.

    The first one acts from the start of the episode on. The mean time between two of them is `impulse_gap`.
    """

    kind: ClassVar[type] = float
    state_fields = ("_inner", "_wait", "_forces")
    shape = None

    def __init__(self, stage: EffectContext, span: Range) -> None:
        self._share, self._span = stage.batch.control_period / stage.impulse_gap, span
        arms = len(stage.batch.rows)
        self._inner: list[Any] = [None] * arms
        self._wait, self._forces = np.zeros(arms, dtype=np.int64), np.zeros((arms, 3))

    @staticmethod
    def checked(field: str, value: object) -> float:
        """A size >= 0."""
        return non_negative(field, value)

    def draw(self, arm: int, stream: np.random.Generator) -> None:
        """The generator of the loads of an episode."""
        self._inner[arm], self._wait[arm] = np.random.default_rng(stream.integers(2**63)), 0

    def add_tip_forces(self, forces: Array, over: BoolArray) -> None:
        """Adds the loads; those whose time has come change first."""
        for arm in np.flatnonzero((self._wait <= 0) & ~over).tolist():
            inner = self._inner[arm]
            size, way = inner.uniform(*self._span), inner.normal(size=3)
            self._forces[arm] = size * way / np.sqrt(way @ way)
            self._wait[arm] = inner.geometric(self._share)
        self._wait -= 1
        forces += self._forces * ~over[:, None]


MIN_FREQUENCY_RATIO, MAX_FREQUENCY_RATIO = 0.3, 3.0  # times the first mode of the arm with its motors held
RIGID_FREQUENCY = 1.0  # Hz, in place of the first mode of an arm that does not bend


class _BaseSway:
    """Amplitude, m/s^2, of a sine by which the base is accelerated; direction, frequency and phase are random.

    The frequency is between 0.3 and 3 times that of the first mode of the arm at zero angles with its motors held,
    evenly on a logarithmic scale.
    """

    kind: ClassVar[type] = float
    state_fields = ("_sway",)
    shape = ()

    def __init__(self, stage: EffectContext, span: Range) -> None:
        self._batch, self._span = stage.batch, span
        first = frequencies(stage.batch.model, lock_joints=True)[:1]
        self._first = float(first[0]) if len(first) else RIGID_FREQUENCY
        self._sway = np.zeros((len(stage.batch.rows), 5))  # acceleration (3,), Hz and rad

    @staticmethod
    def checked(field: str, value: object) -> float:
        """An amplitude >= 0."""
        return non_negative(field, value)

    def draw(self, arm: int, stream: np.random.Generator) -> float:
        """The amplitude; its generator gives the rest."""
        inner = np.random.default_rng(stream.integers(2**63))
        way, amplitude = inner.normal(size=3), float(inner.uniform(*self._span))
        frequency = self._first * np.exp(inner.uniform(np.log(MIN_FREQUENCY_RATIO), np.log(MAX_FREQUENCY_RATIO)))
        self._sway[arm] = *(way / np.sqrt(way @ way)), frequency, inner.uniform(0.0, 2.0 * np.pi)
        return amplitude

    def begin(self, arms: IntArray, drawn: Array) -> None:
        """Makes the directions as long as the amplitudes."""
        self._sway[arms, :3] *= drawn[arms][:, None]

    def add_base_accelerations(self, accelerations: Array, over: BoolArray) -> None:
        """Adds the accelerations in the middle of this period."""
        time = self._batch.time + 0.5 * self._batch.control_period
        size = np.sin(2.0 * np.pi * self._sway[:, 3] * time + self._sway[:, 4])
        accelerations += self._sway[:, :3] * (size * ~over)[:, None]


SIGNALS: dict[str, Any] = {
    "torque_limit": _TorqueLimit,
    "sensor_noise": _SensorNoise,
    "delay": _Delay,
    "initial_vibration": _InitialVibration,
    "tip_impulse": _TipImpulse,
    "tip_load": TipLoad,
    "base_sway": _BaseSway,
}
"""Effects on signals: attribute of a `Randomisation` -> class."""
