"""Effects: what a randomisation draws for each of many arms, and does to them."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexman_gym.arrays import Array
from flexman_gym.checks import refusal
from flexman_gym.envs.randomisation import EFFECTS, TRUNCATION, Randomisation
from flexman_gym.envs.sensors.full import Limits
from flexman_gym.model.model import Model
from flexman_gym.simulation.batch import Batch

BLOCK = 32  # observations whose noise is drawn at once
PHYSICAL = ("payload_mass", "joint_stiffness", "link_stiffness", "rotor_inertia", "joint_damping")
Arms = NDArray[np.int64]
Flags = NDArray[np.bool_]


class Effects:
    """The effects of a randomisation on b arms.

    An effect's stream of an arm is made from the arm's generator without drawing from it. It gives one draw an episode;
    what happens within an episode comes from a generator that this draw seeds.

    Attributes:
        drawn: effect -> values (b, ...) of the episodes that the arms are in: payload_mass (kg), joint_stiffness
            (N m/rad), link_stiffness (factors), rotor_inertia (kg m^2), joint_damping (N m s/rad), torque_limit (N m),
            sensor_noise, delay (periods) and initial_vibration (b, n, 2), m along y and z of each link's beam frame.
            Impulses are drawn on the way and are not in it. A new dict of new arrays after every reset.

    Raises:
        ValueError: for an effect that the model or the limits leave no room for.
    """

    def __init__(
        self, randomisation: Randomisation, batch: Batch, limits: Limits, bound: Array, torque_limit: float
    ) -> None:
        self._randomisation, self._batch, self._bound = randomisation, batch, bound
        self._on = randomisation.effects
        arms, n = len(batch.rows), batch.model.n_joints
        self._check(batch.model, limits)
        self._nominal = batch.nominal | {"torque_limit": np.full(n, torque_limit)}
        self._parents: list[np.random.Generator | None] = [None] * arms
        self._streams: dict[str, list[Any]] = {name: [None] * arms for name in self._on}
        self._shapes = [_bent(batch.model, link) for link in range(n)]
        shapes = {"payload_mass": (), "sensor_noise": (), "delay": (), "initial_vibration": (n, 2)}
        self.drawn: dict[str, NDArray[Any]] = {
            name: np.zeros((arms, *shapes.get(name, (n,))), dtype=int if name == "delay" else float)
            for name in self._on
            if name != "tip_impulse"
        }
        self._inner: dict[str, list[Any]] = {name: [None] * arms for name in ("sensor_noise", "tip_impulse")}
        self._noise, self._used = np.zeros((arms, BLOCK, len(bound))), np.zeros(arms, dtype=np.int64)
        self._deviation = np.zeros((arms, 1))
        depth = 1 + int((randomisation.delay or (0, 0))[1])
        self._past, self._late = np.zeros((depth, arms, n)), np.zeros(arms, dtype=np.int64)
        self._now, self._all = 0, np.arange(arms)
        self._wait, self._impulse = np.zeros(arms, dtype=np.int64), randomisation.tip_impulse or (0.0, 0.0)

    def _check(self, model: Model, limits: Limits) -> None:
        flexible_links = np.diff(model.constants.elastic_start) > 0
        for name in self._on:
            field, value = f"Randomisation.{name}", getattr(self._randomisation, name)
            if name in ("joint_stiffness", "joint_damping") and not model.n_motors:
                raise refusal(field, value, "None: every joint of this arm is rigid")
            if name in ("link_stiffness", "initial_vibration") and not flexible_links.any():
                raise refusal(field, value, "None: every link of this arm is rigid")
            most = limits.deflection * model.constants.length[flexible_links].min(initial=np.inf)
            if name == "initial_vibration" and value[1] > most:
                raise refusal(field, value, f"at most {most:.4g} (m), the limit of the deflection of a link")
        gap, period = self._randomisation.impulse_gap, self._batch.control_period
        if gap < period:
            raise refusal("Randomisation.impulse_gap", gap, f"at least the control period, {period} s")

    def draw(self, arms: Arms, randoms: Sequence[np.random.Generator], given: Mapping[str, Array]) -> dict[str, Array]:
        """Draws for new episodes of the arms (r,); returns the physical parameters that differ, for `Batch.vary`.

        `given` parameters (r, ...) take the place of drawn ones, which are drawn all the same.
        """
        self.drawn = {name: values.copy() for name, values in self.drawn.items()}
        for row, (arm, random) in enumerate(zip(arms.tolist(), randoms, strict=True)):
            if self._parents[arm] is not random:
                self._parents[arm] = random
                for name in self._on:
                    self._streams[name][arm] = _stream(random, EFFECTS.index(name))
            for name in self._on:
                value = self._value(name, arm, self._streams[name][arm])
                if name in self.drawn:
                    self.drawn[name][arm] = given[name][row] if name in given else value
        if "delay" in self.drawn:
            self._late[arms] = self.drawn["delay"][arms]
            self._past[:, arms] = 0.0
        if "sensor_noise" in self.drawn:
            self._deviation[arms, 0] = self.drawn["sensor_noise"][arms]
            self._used[arms] = BLOCK
        return {name: self.drawn[name][arms] for name in PHYSICAL if name in self.drawn} | dict(given)

    def _value(self, name: str, arm: int, stream: np.random.Generator) -> Any:
        """The value that an arm's episode draws of an effect."""
        low, high = getattr(self._randomisation, name)
        n = self._batch.model.n_joints
        if name in self._inner:
            self._inner[name][arm] = inner = np.random.default_rng(stream.integers(2**63))
        if name == "tip_impulse":
            self._wait[arm] = self._gap(inner)
            return None
        if name == "delay":
            return stream.integers(low, high + 1)
        if name == "initial_vibration":
            size, angle = stream.uniform(low, high, n), stream.uniform(0.0, 2.0 * np.pi, n)
            flexible = np.diff(self._batch.model.constants.elastic_start) > 0
            return (flexible * size * np.array([np.cos(angle), np.sin(angle)])).T
        if name in ("payload_mass", "sensor_noise"):
            return stream.uniform(low, high)
        values = stream.uniform(low, high, n)
        if name == "joint_damping":
            return np.where(self._batch.model.constants.motor >= 0, values, self._nominal[name])
        if name == "joint_stiffness":
            values = np.where(self._batch.model.constants.motor >= 0, values, 1.0)
        return values * self._nominal[name]

    def of(self, arm: int) -> dict[str, Any]:
        """What the episode of one arm drew, plain numbers and arrays that are the caller's."""
        drawn = {name: values[arm] for name, values in self.drawn.items()}
        return {name: value.item() if value.ndim == 0 else value.copy() for name, value in drawn.items()}

    def bend(self, arms: Arms, states: Array) -> None:
        """Deflects the links of arms (r,) in their states (r, 2 d) as their episodes drew it."""
        if "initial_vibration" in self.drawn:
            for link, shape in enumerate(self._shapes):
                for row, tip in enumerate(self.drawn["initial_vibration"][arms, link]):
                    states[row, self._batch.model.elastic_columns(link)] = shape @ tip

    def delay(self, actions: Array) -> Array:
        """Keeps the actions (b, n) and returns those that reach the motors now."""
        if "delay" not in self.drawn:
            return actions
        depth = len(self._past)
        self._now = (self._now + 1) % depth
        self._past[self._now] = actions
        return self._past[(self._now - self._late) % depth, self._all]

    def push(self, forces: Array, over: Flags) -> None:
        """Writes the forces (b, 3) N on the tips during this period; arms whose episode is over wait."""
        if "tip_impulse" not in self._on:
            return
        forces[:] = 0.0
        self._wait -= 1
        for arm in np.flatnonzero((self._wait <= 0) & ~over).tolist():
            inner = self._inner["tip_impulse"][arm]
            size, way = inner.uniform(*self._impulse), inner.normal(size=3)
            forces[arm] = size / self._batch.control_period * way / np.sqrt(way @ way)
            self._wait[arm] = self._gap(inner)

    def disturb(self, observations: Array, arms: Arms | None = None) -> Array:
        """The observations (r, size) of the arms (r,), or of all, with noise."""
        if "sensor_noise" not in self.drawn:
            return observations
        arms = self._all if arms is None else arms
        for arm in arms[self._used[arms] == BLOCK].tolist():
            self._noise[arm], self._used[arm] = _normal(self._inner["sensor_noise"][arm], self._noise.shape[1:]), 0
        noise = self._noise[arms, self._used[arms]]
        self._used[arms] += 1
        return observations + noise * self._deviation[arms] * self._bound

    def _gap(self, random: np.random.Generator) -> int:
        """Periods until the next impulse."""
        return int(random.geometric(self._batch.control_period / self._randomisation.impulse_gap))


def _stream(parent: np.random.Generator, index: int) -> np.random.Generator:
    """A generator made from the seed of another."""
    seed: Any = parent.bit_generator.seed_seq
    return np.random.default_rng(np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, index)))


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
