"""Episodes: arms side by side, each in an episode of its own; the core that the environments share."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexman_gym.arrays import Array
from flexman_gym.checks import one_of, refusal, sequence, vector
from flexman_gym.envs.effects import Effects
from flexman_gym.envs.randomisation import TRUNCATION
from flexman_gym.envs.sensors.full import FullState
from flexman_gym.envs.setup import Setup
from flexman_gym.kernels import layout
from flexman_gym.simulation.batch import Batch

Observations = NDArray[np.float32]
Arms = NDArray[np.int64]
Figure = Any  # a number, of one arm, or an array (b,)
OPTIONS = ("start", "posture", "parameters")


class Episodes:
    """b arms with a task, sensors and limits. What it does to an arm depends on no other arm, bit for bit.

    Attributes:
        batch, sensors: the arms and what is seen of them.
        effects: of the randomisation, None without one.
        bound: (size,) float32 largest magnitude of each entry of an observation.
        postures, targets: (b, n) rad and (b, 3) m, the goals.
        seen: (b, size) float32 observations; those of an arm that failed are the last ones within the bounds.
        failures: of the last step, arm -> what happened.
        over: (b,) whether an arm's episode is over, by a failure or because someone else said so.
    """

    def __init__(self, setup: Setup, batch: Batch) -> None:
        self.batch, self.task = batch, setup.task
        arms, joints = len(batch.rows), setup.model.n_joints
        self.sensors = FullState(setup.model, setup.limits, arms)
        noise: tuple[float, float] = (0.0, 0.0)
        self.effects: Effects | None = None
        if setup.randomisation is not None:
            noise = setup.randomisation.sensor_noise or noise
            self.effects = Effects(setup.randomisation, batch, setup.limits, self.sensors.bound, setup.torque_limit)
        self.bound = ((1.0 + TRUNCATION * noise[1]) * self.sensors.bound).astype(np.float32)
        self._energy_alarm = setup.energy_alarm
        self.postures, self.targets = np.zeros((arms, joints)), np.zeros((arms, 3))
        self.seen = np.zeros((arms, len(self.bound)), dtype=np.float32)
        self.failures: dict[int, str] = {}
        self.over = np.ones(arms, dtype=bool)
        self._failed, self._effort = np.zeros(arms, dtype=bool), np.zeros(arms)
        self._torque_limits = np.full((arms, joints), setup.torque_limit)
        self._drive = np.zeros((arms, joints + 6))
        self._torques, self._forces = self._drive[:, :joints], self._drive[:, joints : joints + 3]
        self._magnitude = np.zeros((arms, len(self.bound)))

    def reset(
        self, arms: Arms, randoms: Sequence[np.random.Generator], options: Mapping[str, Any] | None = None
    ) -> None:
        """Starts new episodes of the arms with the indices (r,), each drawn from its own generator.

        Options may set "start" and "posture", (n,) rad for all arms or (b, n) for each, and "parameters" of the arms
        from this episode on: a dict of what `Batch.vary` takes, for all arms or with a leading axis b.

        Raises:
            ValueError: one line with field, value and what is allowed; the episodes of these arms are then over.
        """
        self.over[arms] = True
        drawn = [self.task.draw(random, self.postures.shape[1]) for random in randoms]
        goals = {"start": np.array([each[0] for each in drawn]), "posture": np.array([each[1] for each in drawn])}
        given = self._given(options)
        parameters = {name: values[arms] for name, values in given.pop("parameters", {}).items()}
        if self.effects is not None:
            parameters = self.effects.draw(arms, randoms, parameters)
            if "torque_limit" in self.effects.drawn:
                self._torque_limits[arms] = self.effects.drawn["torque_limit"][arms]
        if parameters:
            self.batch.vary(arms, **parameters)
        goals |= {name: values[arms] for name, values in given.items()}
        self.postures[arms] = goals["posture"]
        self.targets[arms] = self.batch.rigid_tips(self._undeformed(goals["posture"]))
        start = self._undeformed(goals["start"])
        if self.effects is not None:
            self.effects.bend(arms, start)
        self.batch.reset(arms, start)
        self._begin(arms, options)

    def _begin(self, arms: Arms, options: object) -> None:
        """Reads the arms that have just been reset and lets their episodes begin."""
        self._read()
        observations = self.sensors.observations
        for arm in arms:
            if failure := self.sensors.broken(observations[arm]):
                raise refusal("options", options, f"a start and a posture within the limits ({failure})")
        self.failures = {arm: text for arm, text in self.failures.items() if arm not in arms}
        seen = observations[arms]
        self.seen[arms] = seen if self.effects is None else self.effects.disturb(seen, arms)
        self._effort[arms], self._failed[arms], self.over[arms] = 0.0, False, False

    def step(self, actions: Array) -> None:
        """Moves all arms by one control period under actions (b, n), parts of the torque limits.

        An arm whose episode is over has no outcome worth reading before it is reset.
        """
        arriving = actions
        if self.effects is not None:
            arriving = self.effects.delay(actions)
            self.effects.push(self._forces, self.over)
        np.multiply(arriving, self._torque_limits, out=self._torques)
        self.batch.step(self._drive)
        self._effort = np.vecdot(actions, actions)
        self._read()
        if np.count_nonzero(self._failed):
            self.failures, self._failed = {}, np.zeros_like(self._failed)
        observations = self.sensors.observations
        inside = np.abs(observations, out=self._magnitude) <= self.sensors.bound
        seen = observations if self.effects is None else self.effects.disturb(observations)
        if np.count_nonzero(inside) == inside.size and not np.count_nonzero(self.batch.status):
            self.seen[:] = seen
            return
        self._fail(np.flatnonzero(~inside.all(axis=1) | (self.batch.status != layout.OK)))
        good = ~self._failed
        self.seen[good] = seen[good]

    def _fail(self, arms: Arms) -> None:
        for arm in arms[~self.over[arms]].tolist():
            status = self.batch.status[arm]
            broken = self.sensors.broken(self.sensors.observations[arm])
            self.failures[arm] = f"the simulation {layout.STATUS[status]}" if status else broken
        self._failed = np.zeros_like(self._failed)
        self._failed[arms] = self.over[arms] = True

    def figures(self) -> tuple[Array, ...]:
        """What `judge` takes, (b,) each, of the state that the arms are in."""
        batch, sensors = self.batch, self.sensors
        links, joints = batch.outputs[:, layout.LINK_ENERGY], batch.outputs[:, layout.JOINT_ENERGY]
        energies = (links, joints, batch.energy_residual, batch.energy_turnover)
        return sensors.tip_error, sensors.tip_vibration, self._effort, self._failed, *energies

    def judge(
        self, tip_error: Figure, tip_vibration: Figure, effort: Figure, failed: Figure, *energies: Figure
    ) -> tuple[Figure, dict[str, Any]]:
        """Reward and the part of the info that is numbers, from the figures of one arm or arrays (b,) of all."""
        links, joints, residual, turnover = energies
        terms = self.task.reward_terms(tip_error, tip_vibration, effort / self.postures.shape[1], failed)
        return sum(terms.values()), {
            "tip_error": tip_error,
            "tip_vibration": tip_vibration,
            "elastic_energy": links + joints,
            "energy_residual": residual,
            "energy_alarm": abs(residual) > self._energy_alarm * turnover,
            "reward_terms": terms,
        }

    def _read(self) -> None:
        self.sensors.read(self.batch.rows, self.batch.outputs, self.postures, self.targets)

    def _undeformed(self, angles: Array) -> Array:
        """States (r, 2 d) at rest at joint angles (r, n)."""
        model = self.batch.model
        states = np.zeros((len(angles), 2 * model.n_dof))
        states[:, : model.n_joints] = states[:, model.motor_columns] = angles
        return states

    def _given(self, options: Mapping[str, Any] | None) -> dict[str, Any]:
        """The options with a leading axis for the arms."""
        if options is not None and not isinstance(options, dict):
            raise refusal("options", options, f"a dict with {', '.join(OPTIONS[:-1])} or {OPTIONS[-1]}")
        given: dict[str, Any] = {}
        for name, value in (options or {}).items():
            field = f"options[{name!r}]"
            if one_of("options", name, OPTIONS) == "parameters":
                given[name] = self._parameters(field, value)
            else:
                given[name] = self._postures(field, value)
        return given

    def _postures(self, field: str, value: object) -> Array:
        arms, joints = self.postures.shape
        entries = sequence(field, value, "numbers")
        if not entries or not isinstance(entries[0], list | tuple | np.ndarray):
            return np.tile(vector(field, value, joints, "rad"), (arms, 1))
        if len(entries) != arms:
            raise refusal(field, value, f"{joints} numbers (rad), or a list of {arms} such lists, one for each arm")
        return np.array([vector(f"{field}[{i}]", entry, joints, "rad") for i, entry in enumerate(entries)])

    def _parameters(self, field: str, value: object) -> dict[str, Array]:
        nominal = self.batch.nominal
        if not isinstance(value, dict):
            raise refusal(field, value, f"a dict with some of {', '.join(nominal)}")
        given = {}
        for name, values in value.items():
            shape = (len(self.postures), *np.shape(nominal[one_of(field, name, nominal)]))
            try:
                given[name] = np.broadcast_to(values, shape)
            except ValueError:
                raise refusal(f"{field}[{name!r}]", values, f"numbers of the shape {shape}, or {shape[1:]}") from None
        return given


def checked_actions(name: str, value: object, shape: tuple[int, ...], allowed: str) -> Array:
    """The actions as an array of floats; raises ValueError for another shape and for numbers outside -1 to 1."""
    values = np.asarray(value)
    if values.shape == shape and values.dtype.kind in "fiu":
        actions = values.astype(np.float64)
        if np.count_nonzero(np.abs(actions) <= 1.0) == actions.size:
            return actions
    raise refusal(name, value, allowed)
