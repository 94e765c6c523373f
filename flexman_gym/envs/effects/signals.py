"""Effects on signals: torque limits, errors of sensors, delay, vibration at the start, tip forces, base motion."""

from typing import Any, ClassVar

import numpy as np

from flexman_gym.common.arrays import Array, BoolArray, IntArray
from flexman_gym.common.checks import finite, non_negative, positive, whole_number
from flexman_gym.common.errors import value_error
from flexman_gym.common.registry import Registry
from flexman_gym.envs.effects.effect import EffectContext, Range
from flexman_gym.envs.random_streams import TruncatedNoise
from flexman_gym.model.dynamics import frequencies
from flexman_gym.model.model import Model


class _TorqueLimit:
    """Factors > 0 on the torque limits, one for each joint."""

    factor: ClassVar[bool] = True

    def __init__(self, context: EffectContext, span: Range) -> None:
        self._context, self._span, self.shape = context, span, context.nominal.shape

    checked = staticmethod(positive)

    def draw(self, arm: int, stream: np.random.Generator) -> Array:
        """Draw the torque limits (n,), N m."""
        return stream.uniform(*self._span, self.shape) * self._context.nominal

    def begin(self, arms: IntArray, drawn: Array) -> None:
        """Set the torque limits."""
        self._context.torque_limits[arms] = drawn[arms]


class _SensorNoise:
    """Normal noise on each measured quantity in each control period; its standard deviation is a fraction of the range.

    The noise is truncated at 4 standard deviations, and measurements saturate at the range. Goals have no noise. All
    sensors and the base controller read the same noisy measurements, from which errors and other derived quantities are
    computed. Limits are compared with the true state.
    """

    state_fields = ("_noise", "_deviation")
    shape = ()

    def __init__(self, context: EffectContext, span: Range) -> None:
        arms = len(context.batch.rows)
        self._bound, self._span = context.bound, span
        self._noise, self._deviation = TruncatedNoise(arms, len(context.bound)), np.zeros((arms, 1))

    @staticmethod
    def checked(field: str, value: object) -> float:
        """Return a fraction from 0 to 1."""
        part = non_negative(field, value)
        if part > 1.0:
            raise value_error(field, value, "a fraction from 0 to 1 of the range")
        return part

    def draw(self, arm: int, stream: np.random.Generator) -> float:
        """Draw the standard deviation as a fraction of the range."""
        self._noise.begin(arm, stream)
        return stream.uniform(*self._span)

    def begin(self, arms: IntArray, drawn: Array) -> None:
        """Set the standard deviations of new episodes."""
        self._deviation[arms, 0] = drawn[arms]

    def measure(self, values: Array, arms: IntArray) -> Array:
        """Return the values (r, size) of the arms (r,) with noise."""
        return values + self._noise.sample(arms) * self._deviation[arms] * self._bound


class _ConstantError:
    """Error of sensors that is drawn at the start of an episode and stays constant.

    Args:
        span: range of the numbers.
        shape: shape of the numbers of an arm.
    """

    def __init__(self, span: Range, shape: tuple[int, ...]) -> None:
        self._span, self.shape, self._drawn = span, shape, np.zeros((0, *shape))

    def draw(self, arm: int, stream: np.random.Generator) -> Array:
        """Draw the numbers of an arm, with the shape `shape`."""
        return stream.uniform(*self._span, self.shape)

    def begin(self, arms: IntArray, drawn: Array) -> None:
        """Store the drawn numbers (b, ...) of all arms."""
        self._drawn = drawn


class _SensorBias(_ConstantError):
    """Bias of each measured quantity, a fraction of its range."""

    def __init__(self, context: EffectContext, span: Range) -> None:
        super().__init__(span, context.bound.shape)
        self._bound = context.bound

    @staticmethod
    def checked(field: str, value: object) -> float:
        """Return a fraction from -1 to 1."""
        part = finite(field, value)
        if abs(part) > 1.0:
            raise value_error(field, value, "a fraction from -1 to 1 of the range")
        return part

    def measure(self, values: Array, arms: IntArray) -> Array:
        """Return the values (r, size) of the arms (r,) with biases."""
        return values + self._drawn[arms] * self._bound


class _GaugeGain(_ConstantError):
    """Factors > 0 on the root strains: gain errors of the strain gauges, three of each link."""

    factor: ClassVar[bool] = True

    def __init__(self, context: EffectContext, span: Range) -> None:
        super().__init__(span, (3 * len(context.nominal),))
        self._gauges = context.gauges

    checked = staticmethod(positive)

    def measure(self, values: Array, arms: IntArray) -> Array:
        """Return the values (r, size) of the arms (r,) with scaled root strains."""
        if not len(self._gauges):
            return values
        result = values.copy()
        result[:, self._gauges] *= self._drawn[arms]
        return result


class _DroppedSamples:
    """Lost samples: with a probability each sensor repeats its previous sample, in all its quantities, for a period.

    The first sample of an episode is never lost.
    """

    state_fields = ("_noise", "_held", "_first", "_probability")
    shape = ()

    def __init__(self, context: EffectContext, span: Range) -> None:
        arms, size = len(context.batch.rows), len(context.bound)
        self._instruments, self._span = context.instruments, span
        self._noise = TruncatedNoise(arms, 1 + int(context.instruments.max(initial=0)))
        self._held, self._first, self._probability = np.zeros((arms, size)), np.ones(arms, bool), np.zeros((arms, 1))

    @staticmethod
    def checked(field: str, value: object) -> float:
        """Return a probability below 1."""
        part = non_negative(field, value)
        if part >= 1.0:
            raise value_error(field, value, "a probability from 0 to below 1")
        return part

    def draw(self, arm: int, stream: np.random.Generator) -> float:
        """Draw the probability."""
        self._noise.begin(arm, stream)
        return stream.uniform(*self._span)

    def begin(self, arms: IntArray, drawn: Array) -> None:
        """Set the probabilities of new episodes."""
        self._probability[arms, 0], self._first[arms] = drawn[arms], True

    def measure(self, values: Array, arms: IntArray) -> Array:
        """Return the values (r, size) of the arms (r,), those of lost samples replaced by the previous ones."""
        lost = TruncatedNoise.uniform(self._noise.sample(arms)) < self._probability[arms]
        lost &= ~self._first[arms, None]
        result = np.where(lost[:, self._instruments], self._held[arms], values)
        self._held[arms], self._first[arms] = result, False
        return result


MAX_DELAY = 1000  # control periods; largest delay, which bounds the memory of its buffer


class _Delay:
    """Delay of the commanded torques, a whole number of control periods; torques are zero until the first arrives."""

    kind: ClassVar[type] = int
    state_fields = ("_past", "_late", "_now")
    shape = ()

    def __init__(self, context: EffectContext, span: Range) -> None:
        arms, n = context.torque_limits.shape
        self._span = span
        self._past, self._late = np.zeros((1 + int(span[1]), arms, n)), np.zeros(arms, dtype=np.int64)
        self._now, self._all = 0, np.arange(arms)

    @staticmethod
    def checked(field: str, value: object) -> float:
        """Return a whole number of control periods."""
        return whole_number(field, value, 0, MAX_DELAY)

    def draw(self, arm: int, stream: np.random.Generator) -> int:
        """Draw the delay in control periods."""
        low, high = map(int, self._span)
        return int(stream.integers(low, high + 1))

    def begin(self, arms: IntArray, drawn: Array) -> None:
        """Set the delay and clear the buffer of earlier torques."""
        self._late[arms] = drawn[arms]
        self._past[:, arms] = 0.0

    def motor_actions(self, actions: Array) -> Array:
        """Store commanded torques (b, n), fractions of the limits, and return the delayed torques (b, n)."""
        depth = len(self._past)
        self._now = (self._now + 1) % depth
        self._past[self._now] = actions
        return self._past[(self._now - self._late) % depth, self._all]


class _InitialVibration:
    """Static deflection, m, of the tip of each flexible link at the start of an episode, from which it is released.

    The deflection is that under a tip force of random direction across the beam. The force would cause the drawn
    deflection in the most compliant direction of the link; in stiffer directions it causes a smaller deflection, and in
    a direction without elastic coordinates none.
    """

    def __init__(self, context: EffectContext, span: Range) -> None:
        model = self._model = context.batch.model
        self._flexible, self._span, self.shape = np.diff(model.constants.elastic_start) > 0, span, (model.n_joints, 2)
        field = "Randomisation.initial_vibration"
        if not self._flexible.any():
            raise value_error(field, span, "None: every link of this arm is rigid")
        most = context.limits.deflection * model.constants.length[self._flexible].min()
        if span[1] > most:
            raise value_error(field, span, f"at most {most:.4g} (m), the limit of the deflection of a link")
        self._shapes = [static_shape(model, link) for link in range(model.n_joints)]
        self._compliances = np.array([_relative_compliance(model, link) for link in range(model.n_joints)])
        self._drawn = np.zeros((0, *self.shape))

    checked = staticmethod(non_negative)

    def draw(self, arm: int, stream: np.random.Generator) -> Array:
        """Draw the deflections (n, 2), m, along y and z of the beam frame of each link."""
        n = len(self._flexible)
        size, angle = stream.uniform(*self._span, n), stream.uniform(0.0, 2.0 * np.pi, n)
        forces = (self._flexible * size * np.array([np.cos(angle), np.sin(angle)])).T
        return np.einsum("nij,nj->ni", self._compliances, forces)

    def begin(self, arms: IntArray, drawn: Array) -> None:
        """Store the drawn deflections."""
        self._drawn = drawn

    def change_start(self, arms: IntArray, states: Array) -> None:
        """Deflect the links in the initial states."""
        for link, shape in enumerate(self._shapes):
            for row, tip in enumerate(self._drawn[arms, link]):
                states[row, self._model.elastic_columns(link)] = shape @ tip


def _relative_compliance(model: Model, link: int) -> Array:
    """Return the compliance matrix (2, 2) of the tip of a link along y and z, divided by its spectral norm."""
    jacobian, response = _tip_flexibility(model, link)
    compliance = jacobian.T @ response
    largest = np.linalg.norm(compliance, 2)
    return compliance / largest if largest > 0.0 else compliance


def static_shape(model: Model, link: int) -> Array:
    """Return elastic coordinates (k_i, 2) of a link under static tip forces, per metre of deflection along y and z."""
    jacobian, response = _tip_flexibility(model, link)
    return response @ np.linalg.pinv(jacobian.T @ response)


def _tip_flexibility(model: Model, link: int) -> tuple[Array, Array]:
    """Return the transposed Jacobian of the tip along y and z, and the elastic coordinates per newton of tip force.

    Both arrays have the shape (k_i, 2) for the k_i elastic coordinates of a link.
    """
    constants = model.constants
    start, stop = constants.elastic_start[link : link + 2]
    first, last = constants.square_start[link : link + 2]
    stiffness = constants.stiffness[first:last].reshape(stop - start, stop - start)
    jacobian = constants.tip_translation[start:stop, 1:]
    return jacobian, np.asarray(np.linalg.solve(stiffness, jacobian), dtype=np.float64)


class _TipImpulse:
    """Impulses, N s, at random times; each is a force at the tip, of random direction, during one control period."""

    state_fields = ("_inner", "_wait")
    shape = None

    def __init__(self, context: EffectContext, span: Range) -> None:
        self._period, self._gap_time, self._span = context.batch.control_period, context.impulse_gap, span
        arms = len(context.batch.rows)
        self._inner: list[Any] = [None] * arms
        self._wait = np.zeros(arms, dtype=np.int64)

    checked = staticmethod(non_negative)

    def draw(self, arm: int, stream: np.random.Generator) -> None:
        """Draw the time until the first impulse."""
        self._inner[arm] = np.random.default_rng(stream.integers(2**63))
        self._wait[arm] = self._gap(arm)

    def add_tip_forces(self, forces: Array, over: BoolArray) -> None:
        """Add the forces of this control period; impulses of arms without a running episode are postponed."""
        self._wait -= 1
        for arm in np.flatnonzero((self._wait <= 0) & ~over).tolist():
            inner = self._inner[arm]
            size, direction = inner.uniform(*self._span), inner.normal(size=3)
            forces[arm] += size / self._period * direction / np.sqrt(direction @ direction)
            self._wait[arm] = self._gap(arm)

    def _gap(self, arm: int) -> int:
        """Return the number of control periods until the next impulse."""
        return int(self._inner[arm].geometric(self._period / self._gap_time))


class _TipLoad:
    """Force, N, at the tip with a random direction, constant until it changes at random times.

    The first force acts from the start of the episode. The mean time between two changes is `impulse_gap`.
    """

    state_fields = ("_inner", "_wait", "_forces")
    shape = None

    def __init__(self, context: EffectContext, span: Range) -> None:
        self._probability, self._span = context.batch.control_period / context.impulse_gap, span
        arms = len(context.batch.rows)
        self._inner: list[Any] = [None] * arms
        self._wait, self._forces = np.zeros(arms, dtype=np.int64), np.zeros((arms, 3))

    checked = staticmethod(non_negative)

    def draw(self, arm: int, stream: np.random.Generator) -> None:
        """Seed the generator of the loads of an episode."""
        self._inner[arm], self._wait[arm] = np.random.default_rng(stream.integers(2**63)), 0

    def add_tip_forces(self, forces: Array, over: BoolArray) -> None:
        """Change the loads that are due, and add all loads."""
        for arm in np.flatnonzero((self._wait <= 0) & ~over).tolist():
            inner = self._inner[arm]
            size, direction = inner.uniform(*self._span), inner.normal(size=3)
            self._forces[arm] = size * direction / np.sqrt(direction @ direction)
            self._wait[arm] = inner.geometric(self._probability)
        self._wait -= 1
        forces += self._forces * ~over[:, None]


MIN_FREQUENCY_RATIO, MAX_FREQUENCY_RATIO = 0.3, 3.0  # frequency of the base motion / first frequency, motors locked
RIGID_FREQUENCY = 1.0  # Hz; used in place of the first natural frequency for a rigid arm


class _BaseSway:
    """Sinusoidal acceleration of the base, m/s^2, with random amplitude, direction, frequency and phase.

    The frequency is 0.3 to 3 times the first natural frequency of the arm at zero angles with locked motors, drawn
    uniformly on a logarithmic scale.
    """

    state_fields = ("_sway",)
    shape = ()

    def __init__(self, context: EffectContext, span: Range) -> None:
        self._batch, self._span = context.batch, span
        first = frequencies(context.batch.model, lock_joints=True)[:1]
        self._first = float(first[0]) if len(first) else RIGID_FREQUENCY
        self._sway = np.zeros((len(context.batch.rows), 5))  # acceleration (3,), m/s^2; frequency, Hz; phase, rad

    checked = staticmethod(non_negative)

    def draw(self, arm: int, stream: np.random.Generator) -> float:
        """Draw direction, frequency and phase, and return the drawn amplitude."""
        inner = np.random.default_rng(stream.integers(2**63))
        direction, amplitude = inner.normal(size=3), float(inner.uniform(*self._span))
        frequency = self._first * np.exp(inner.uniform(np.log(MIN_FREQUENCY_RATIO), np.log(MAX_FREQUENCY_RATIO)))
        phase = inner.uniform(0.0, 2.0 * np.pi)
        self._sway[arm] = *(direction / np.sqrt(direction @ direction)), frequency, phase
        return amplitude

    def begin(self, arms: IntArray, drawn: Array) -> None:
        """Scale the directions by the amplitudes."""
        self._sway[arms, :3] *= drawn[arms][:, None]

    def add_base_accelerations(self, accelerations: Array, over: BoolArray) -> None:
        """Add the accelerations at the midpoint of this control period."""
        time = self._batch.time + 0.5 * self._batch.control_period
        size = np.sin(2.0 * np.pi * self._sway[:, 3] * time + self._sway[:, 4])
        accelerations += self._sway[:, :3] * (size * ~over)[:, None]


SIGNALS: Registry[Any] = Registry(
    "effect",
    {
        "torque_limit": _TorqueLimit,
        "gauge_gain": _GaugeGain,
        "sensor_noise": _SensorNoise,
        "sensor_bias": _SensorBias,
        "dropped_samples": _DroppedSamples,
        "delay": _Delay,
        "initial_vibration": _InitialVibration,
        "tip_impulse": _TipImpulse,
        "tip_load": _TipLoad,
        "base_sway": _BaseSway,
    },
)
"""Effects on signals: name -> class."""
