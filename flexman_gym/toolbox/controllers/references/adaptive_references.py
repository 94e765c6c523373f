"""References adapted to estimated parameters: slews along straight paths with replanned timing, and given paths."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array, BoolArray, IntArray, pad_rows
from flexman_gym.common.checks import one_of
from flexman_gym.model.friction import friction_torques
from flexman_gym.model.model import Model
from flexman_gym.model.statics import holding_torques, rest_state, static_torques
from flexman_gym.simulation.physical_parameters import varied_model
from flexman_gym.toolbox.controllers.arm_scales import SlewBounds
from flexman_gym.toolbox.controllers.friction_compensation import estimated_friction
from flexman_gym.toolbox.controllers.references.path_parametrisation import (
    PathBounds,
    TimeOptimalMotions,
    average_windows,
    is_time_optimal,
)
from flexman_gym.toolbox.controllers.references.trajectories import (
    QUINTIC,
    TIME_OPTIMAL,
    DeflectionCompensation,
    QuasiStaticDeflection,
    evaluate_polynomials,
    plan_path,
    quintic_coefficients,
)

PATH_POINTS = np.linspace(0.0, 1.0, 11)  # path parameters s at which deflections are tabulated
TYPICAL_ACCELERATION = 0.5  # 1/s^2; second derivative of the path parameter at which deflections are computed
# Durations of slews that are tried: 110 steps of 4.5 %, from 0.2 to 24 s for a slew of 3 s of the arm
FIRST_DURATION, DURATION_FACTOR, DURATION_STEPS, USUAL_SLEW = 0.2, 1.045, 110, 3.0  # s, 1, 1, s
CHECKED_TIMES = np.linspace(0.0, 1.0, 17)[1:-1]  # fractions of a duration at which torques are checked
REST = 0  # index of the layer of a table with the values at equilibrium
ACCELERATION = 1  # index of the layer with the factors of s''
SPEED_SQUARED = 2  # index of the layer with the factors of s'^2
NEWTON_ITERATIONS = 2  # iterations for the corrected end of a path
MAX_CACHED_PATHS = 1000  # tables of 20 kB each
DIFFERENCE_STEP = 0.01  # s; step of central differences for the rates of deflected coordinates


class _PathTables(NamedTuple):
    """Deflections and torques at points of a path with parameter s, for p payloads, in three layers: REST, s'', s'^2.

    Attributes:
        coordinates: (p, 11, 3, d) deviations of the coordinates from the straight path of the motors.
        torques: (p, 11, 3, n) motor torques, N m.
        shortest: shortest duration of the slew, s.
    """

    coordinates: Array
    torques: Array
    shortest: float


def candidate_durations(slew: float) -> Array:
    """Return the durations (k,) that are tried, s, for an arm whose slews take a time of the order of `slew`, s."""
    first = math.floor(math.log(slew / USUAL_SLEW) / math.log(DURATION_FACTOR))
    return FIRST_DURATION * DURATION_FACTOR ** (first + np.arange(DURATION_STEPS, dtype=np.float64))


class SlewReferences:
    """Slews of b arms: path parameter s from 0 to 1, motor angles, deflected coordinates and torques.

    The arm is deflected quasi-statically by inertia and gravity, without vibration. Deflections and torques are
    rest + a(s) s'' + b(s) s'^2, tabulated for one or three payloads, interpolated by a parabola between the payloads,
    and scaled by the estimated stiffness of each arm. Friction is part of the torques for which the timing is planned,
    but not of the feed-forward, see `FrictionCompensation`.

    Args:
        model: model of the arm.
        bounds: bounds of torques, rates and durations.
        payloads: masses of one or three payloads, kg, from the lightest to the heaviest.
        slew: duration of a slew of the arm, s, to which the durations that are tried are in proportion.
        equilibrium: True if `end_in_equilibrium` chooses the ends of the paths; False for a linear approximation by the
            estimated compliance in each `adapt`, whose error grows with the square of the deflection.
        timing: "quintic", or "time-optimal" for the motions of `TimeOptimalMotions` where `is_time_optimal` holds.

    Attributes:
        durations: (k,) durations that are tried, s.
        time_scaling: (b,) time derivative of the clock of each slew, 1; the path parameter is a function of this clock.
        pace_rate: (b,) time derivative of the time scaling, 1/s.
    """

    state_fields: tuple[str, ...] = (
        "start", "displacement", "shift", "coefficients", "start_time", "duration", "_coordinates", "_torques",
        "_compliance", "_friction", "_adapted_coordinates", "_adapted_torques", "time_scaling", "pace_rate",
        "_shortest", "_adapted_shortest", "_begin_time", "_end_coordinates", "_end_torques",
    )  # fmt: skip

    def __init__(
        self,
        model: Model,
        bounds: SlewBounds,
        payloads: Sequence[float],
        slew: float = USUAL_SLEW,
        equilibrium: bool = False,
        timing: str = QUINTIC,
    ) -> None:
        optimal = one_of("timing", timing, (TIME_OPTIMAL, QUINTIC)) == TIME_OPTIMAL
        self._motions = TimeOptimalMotions() if optimal else None
        if optimal:
            self.state_fields = (*self.state_fields, "_motions")
        self.model, self._bounds, self.durations = model, bounds, candidate_durations(slew)
        self._equilibrium = equilibrium
        self._payloads = np.array(payloads, dtype=float)
        self._models = [varied_model(model, payload_mass=mass) for mass in payloads]
        self._compensation = DeflectionCompensation(model)
        self._deflections = [QuasiStaticDeflection(each) for each in self._models]
        n, d, p = model.n_joints, model.n_dof, len(payloads)
        self.start, self.displacement, self.shift = np.zeros((0, n)), np.zeros((0, n)), np.zeros((0, n))
        self._coordinates, self._torques = np.zeros((0, p, 11, 3, d)), np.zeros((0, p, 11, 3, n))
        # interpolated to the estimated payloads
        self._adapted_coordinates, self._adapted_torques = np.zeros((0, 11, 3, d)), np.zeros((0, 11, 3, n))
        self.coefficients, self.start_time, self.duration = np.zeros((0, 6)), np.zeros(0), np.zeros(0)
        self._compliance, self._friction = np.zeros((0, d)), np.zeros((0, 2, n))
        self._shortest, self._adapted_shortest, self._begin_time = np.zeros((0, p)), np.zeros(0), np.zeros(0)
        self.time_scaling, self.pace_rate = np.zeros(0), np.zeros(0)
        self._end_coordinates, self._end_torques = np.zeros((0, d)), np.zeros((0, n))  # changes at the end of a path
        self._cached_paths: dict[tuple[bytes, bytes], list[_PathTables]] = {}
        self._flexible = model.constants.motor >= 0
        self._bent, self._motors = np.flatnonzero(self._flexible), model.motor_columns

    def allocate(self, count: int) -> None:
        """Allocate memory for `count` arms."""
        for name in SlewReferences.state_fields:
            setattr(self, name, pad_rows(getattr(self, name), count))
        if self._motions:
            self._motions.allocate(count)

    def begin(self, arms: IntArray, start: Array, goal: Array) -> None:
        """Start paths of the arms (r,) between motor angles (r, n) rad; `adapt` and `plan_timing` complete them."""
        self.start[arms], self.displacement[arms], self.shift[arms] = start, goal - start, 0.0
        self.time_scaling[arms], self.pace_rate[arms] = 1.0, 0.0
        self._end_coordinates[arms], self._end_torques[arms] = 0.0, 0.0
        for arm, first, last in zip(arms, start, goal, strict=True):
            key = first.tobytes(), last.tobytes()
            if key not in self._cached_paths:
                if len(self._cached_paths) >= MAX_CACHED_PATHS:
                    self._cached_paths.clear()
                self._cached_paths[key] = [self._tabulate(payload, first, last) for payload in range(len(self._models))]
            for payload, tables in enumerate(self._cached_paths[key]):
                self._coordinates[arm, payload], self._torques[arm, payload] = tables.coordinates, tables.torques
                self._shortest[arm, payload] = tables.shortest

    def _tabulate(self, payload: int, start: Array, goal: Array) -> _PathTables:
        """Return the tables of a path between motor angles (n,) rad, for the payload with the given index."""
        model, deflection, displacement = self._models[payload], self._deflections[payload], goal - start
        n, postures = model.n_joints, start + PATH_POINTS[:, None] * displacement
        rests = rest_state(model, postures)[:, : model.n_dof]
        turned = np.where(model.constants.passive, rests[-1, :n] - rests[0, :n], displacement)
        coordinates, torques = np.zeros((11, 3, model.n_dof)), np.zeros((11, 3, n))
        for row, (posture, rest) in enumerate(zip(postures, rests, strict=True)):
            straight = model.at_rest(posture[None])[0, : model.n_dof]
            coordinates[row, REST], torques[row, REST] = rest - straight, holding_torques(model, posture)
            links, zero = rest[:n], np.zeros(n)
            at_rest, static_torque = deflection.at(rest, (links, zero, zero))
            for layer, motion in (
                (ACCELERATION, (links, zero, TYPICAL_ACCELERATION * turned)),
                (SPEED_SQUARED, (links, np.sqrt(TYPICAL_ACCELERATION) * turned, zero)),
            ):
                deflected, torque = deflection.at(rest, motion)
                coordinates[row, layer], torques[row, layer] = (
                    (deflected - at_rest) / TYPICAL_ACCELERATION,
                    (torque - static_torque) / TYPICAL_ACCELERATION,
                )
        return _PathTables(coordinates, torques, self._bounds.shortest(model, goal))

    def adapt(self, arms: IntArray, parameters: Mapping[str, Array]) -> None:
        """Adapt the references of the arms (r,) to estimated parameters (b, ...), see `Estimate`."""
        if not len(arms):
            return
        weights, self._compliance[arms] = _adaptation_factors(self.model, self._payloads, parameters, arms)
        self._friction[arms] = estimated_friction(self.model, parameters, arms)
        for adapted, table in ((self._adapted_coordinates, self._coordinates), (self._adapted_torques, self._torques)):
            adapted[arms] = (weights[:, :, None, None, None] * table[arms]).sum(axis=1)
        self._adapted_shortest[arms] = self._slowness(arms) * (weights * self._shortest[arms]).sum(axis=1)
        if self._equilibrium:
            self._adapted_coordinates[arms, :, REST] += PATH_POINTS[:, None] * self._end_coordinates[arms, None]
            self._adapted_torques[arms, :, REST] += PATH_POINTS[:, None] * self._end_torques[arms, None]
        elif self.model.constants.gravity.any():
            self._correct_goal(arms)

    def _slowness(self, arms: IntArray) -> Array:
        """Return the largest ratios (r,) of periods of modes to those of the nominal arm, for arms (r,)."""
        result: Array = np.sqrt(self._compliance[arms].max(axis=1))
        return result

    def end_in_equilibrium(self, arms: IntArray, parameters: Mapping[str, Array]) -> None:
        """Move the ends of the paths of the arms (r,) to the static equilibrium of arms with the estimated parameters.

        The tip of the equilibrium is the tip at which the nominal arm rests. Deflections and torques at rest change
        along the path in proportion to its parameter. An estimated arm that is too compliant for its weight keeps the
        end that it has. Nothing changes without gravity, without estimates, and for linear ends of paths.
        """
        if not (self._equilibrium and parameters and self.model.constants.gravity.any()):
            return
        d = self.model.n_dof
        for arm in arms:
            goal, estimated = self.start[arm] + self.displacement[arm], estimated_model(self.model, parameters, arm)
            target, end = rest_state(self.model, goal)[:d], goal + self.shift[arm]
            try:
                for _ in range(NEWTON_ITERATIONS):
                    end = end + self._compensation.damped_rotation(target, rest_state(estimated, end)[:d])
                rest = rest_state(estimated, end)[:d]
            except ValueError:
                continue
            sag, torques = rest - estimated.at_rest(end[None])[0, :d], static_torques(estimated, rest)
            self.shift[arm] = end - goal
            for kept, table, value in (
                (self._end_coordinates, self._adapted_coordinates, sag / self._compliance[arm]),
                (self._end_torques, self._adapted_torques, torques),
            ):
                change = value - table[arm, -1, REST]
                kept[arm] += change
                table[arm, :, REST] += PATH_POINTS[:, None] * change

    def _correct_goal(self, arms: IntArray) -> None:
        """Shift the ends of the paths of the arms (r,) so that the tips come to rest where the nominal arm would."""
        model, d = self.model, self.model.n_dof
        for arm in arms:
            goal = self.start[arm] + self.displacement[arm]
            target = rest_state(model, goal)[:d]
            for _ in range(NEWTON_ITERATIONS):
                sag = self._compliance[arm] * self._adapted_coordinates[arm, -1, REST]
                deflected = model.at_rest((goal + self.shift[arm])[None])[0, :d] + sag
                self.shift[arm] += self._compensation.rotation(target, deflected)

    def payloads(self, parameters: Mapping[str, Array], arms: IntArray) -> Array:
        """Return the estimated payloads (r,) of the arms (r,), kg, see `Estimate`; without estimate the nominal one."""
        return _estimated_payloads(self.model, parameters, arms)

    def plan_timing(self, arms: IntArray, times: Array, first: bool) -> None:
        """Plan the remaining motion of the arms (r,) along their paths, as fast as the bounds allow.

        Args:
            arms: (r,) indices of arms whose references have been adapted, see `adapt`.
            times: (r,) present time of each arm, s.
            first: True for a start at rest at the beginning of the paths; False to continue the current motion.
        """
        if not len(arms):
            return
        times = np.asarray(times, dtype=float)
        if first:
            self._begin_time[arms] = times
        if self._motions is None:
            self._plan_quintics(arms, times, first)
        elif first:
            self._choose_timing(arms, times, self._motions)
        else:
            smoothed = self._motions.windows[arms] > 0.0
            self._plan_quintics(arms[~smoothed], times[~smoothed], first)
            arms = arms[smoothed]
            self._motions.replan(arms, times[smoothed] - self.start_time[arms], self._path_bounds(arms))
            self.duration[arms] = self._motions.durations[arms]

    def _choose_timing(self, arms: IntArray, times: Array, motions: TimeOptimalMotions) -> None:
        """Plan the slews of arms (r,) at rest at times (r,), s, time-optimal or quintic, see `is_time_optimal`."""
        motions.windows[arms] = 0.0
        arms = arms[self._plan_quintics(arms, times, True)]
        quintics, modes = self.duration[arms], self._bounds.free * self._slowness(arms)
        motions.start(arms, average_windows(modes, quintics), self._path_bounds(arms))
        faster = is_time_optimal(motions.durations[arms], modes, quintics, self._adapted_shortest[arms])
        motions.windows[arms[~faster]] = 0.0
        chosen = arms[motions.windows[arms] > 0.0]
        self.duration[chosen] = motions.durations[chosen]

    def _path_bounds(self, arms: IntArray) -> PathBounds:
        """Return the bounds of the motions of arms (r,) along their paths."""
        limits = np.broadcast_to(self._bounds.fraction * np.asarray(self._bounds.limits), self.displacement[arms].shape)
        return PathBounds(
            self.model, self._adapted_torques[arms], limits, self.displacement[arms], self._bounds.rates,
            self._friction[arms],
        )  # fmt: skip

    def _plan_quintics(self, arms: IntArray, times: Array, first: bool) -> BoolArray:
        """Plan quintic timings as `plan_timing`; return flags (r,) of slews whose durations are set by the torques."""
        if not len(arms):
            return np.zeros(0, dtype=bool)
        initial = (np.zeros((3, len(arms))) if first else np.array(self.at(times, arms)))[:, :, None]
        candidates = quintic_coefficients(initial[0], initial[1], initial[2], self.durations)
        checked = self.durations[:, None] * CHECKED_TIMES
        progress, speeds, accelerations = evaluate_polynomials(candidates[:, :, None], checked)
        torques = self._interpolate(self._adapted_torques, arms, progress, accelerations, speeds)
        if self._friction[arms].any():
            rates = speeds[..., None] * self.displacement[arms][:, None, None]
            torques += friction_torques(self.model, rates, self._friction[arms][:, None, None])
        ratios = (np.abs(torques) / self._bounds.limits).max(axis=(2, 3)) / self._bounds.fraction
        fastest = (np.abs(self.displacement[arms]) / self._bounds.rates).max(axis=1)  # s, at unit speed
        rate_ratios = fastest[:, None] * np.abs(speeds).max(axis=2)
        elapsed = times - self._begin_time[arms]
        late = elapsed[:, None] + self.durations >= self._adapted_shortest[arms, None]
        possible = late & (rate_ratios <= 1.0)
        chosen = np.where(late, np.maximum(ratios, rate_ratios), np.inf)
        feasible = chosen <= 1.0
        chosen = np.where(feasible.any(axis=1), feasible.argmax(axis=1), chosen.argmin(axis=1))
        rows = np.arange(len(arms))
        self.coefficients[arms] = candidates[rows, chosen]
        self.start_time[arms], self.duration[arms] = times, self.durations[chosen]
        result: BoolArray = feasible.any(axis=1) & (chosen > 0) & possible[rows, chosen - 1]
        return result

    def _interpolate(self, table: Array, arms: IntArray, progress: Array, accelerations: Array, speeds: Array) -> Array:
        """Return rest + a s'' + b s'^2, (r, ..., m), at path parameters (r, ...).

        Axes of the table (b, 11, 3, m): arm, point of the path, layer (REST, s'' or s'^2), and m table entries.
        """
        at = np.minimum(np.maximum(progress, 0.0), 1.0) * (len(PATH_POINTS) - 1)
        low = np.minimum(at.astype(np.int64), len(PATH_POINTS) - 2)
        part, rows = (at - low)[..., None, None], _aligned(arms, progress)
        layers = table[rows, low] * (1.0 - part) + table[rows, low + 1] * part
        return (
            layers[..., REST, :]
            + layers[..., ACCELERATION, :] * accelerations[..., None]
            + layers[..., SPEED_SQUARED, :] * (speeds[..., None] ** 2)
        )

    def at(self, times: Array, arms: IntArray) -> tuple[Array, Array, Array]:
        """Return path parameters, speeds (1/s) and accelerations (1/s^2) of the arms (r,) at times (r, ...) s."""
        if self._motions is None or not (smoothed := self._motions.windows[arms] > 0.0).any():
            return self._quintics(times, arms)
        result = self._quintics(times, arms)
        chosen = arms[smoothed]
        aligned = _aligned(chosen, times)
        motions = self._motions.at(times[smoothed] - self.start_time[aligned], aligned)
        for values, motion in zip(result, motions, strict=True):
            values[smoothed] = motion
        return result

    def _quintics(self, times: Array, arms: IntArray) -> tuple[Array, Array, Array]:
        """Return path parameters, speeds and accelerations of quintics, see `at`."""
        arms = _aligned(arms, times)
        elapsed, coefficients, duration = times - self.start_time[arms], self.coefficients[arms], self.duration[arms]
        # a slew with replanned timing was moving before its start time; central differences need these times too
        earliest = np.where(coefficients[..., 1] != 0.0, -DIFFERENCE_STEP * self.time_scaling[arms], 0.0)
        clipped = np.minimum(np.maximum(elapsed, earliest), duration)
        progress, speed, acceleration = evaluate_polynomials(coefficients, clipped)
        over = elapsed >= duration
        return np.where(over, 1.0, progress), np.where(over, 0.0, speed), np.where(over, 0.0, acceleration)

    def torques(self, times: Array, arms: IntArray) -> Array:
        """Return the feed-forward torques (r, k, n) of the arms (r,) at times (r, k) of unscaled clocks, N m."""
        progress, speed, acceleration = self.at(times, arms)
        return self._interpolate(self._adapted_torques, arms, progress, acceleration, speed)

    def motion(self, times: Array, torque_times: Array, arms: IntArray) -> tuple[Array, Array]:
        """Return the reference states (r, 2 d) and the feed-forward torques without friction (r, n), N m.

        All times are evaluated together: calls with small arrays take as long as the number of calls.

        Args:
            times: (r,) times of the states, s.
            torque_times: (r,) times of the torques, s.
            arms: (r,) indices.
        """
        steps = DIFFERENCE_STEP * self.time_scaling[arms]
        together = np.stack([times - steps, times, times + steps, torque_times], axis=1)
        progress, speed, acceleration = self.at(together, arms)
        pace, pace_rate = self.time_scaling[arms, None], self.pace_rate[arms, None]
        speed, acceleration = speed * pace, acceleration * pace**2 + speed * pace_rate
        coordinates = self._deflected(arms, *(each[:, :3] for each in (progress, speed, acceleration)))
        rates = (coordinates[:, 2] - coordinates[:, 0]) / (2.0 * DIFFERENCE_STEP)
        torques = self._interpolate(self._adapted_torques, arms, progress[:, 3], acceleration[:, 3], speed[:, 3])
        return np.concatenate([coordinates[:, 1], rates], axis=1), torques

    def _deflected(self, arms: IntArray, progress: Array, speeds: Array, accelerations: Array) -> Array:
        """Return the deflected coordinates (r, k, d) of arms (r,) at path parameters (r, k) and their derivatives."""
        deflections = self._interpolate(self._adapted_coordinates, arms, progress, accelerations, speeds)
        result = self._compliance[arms, None] * deflections
        turned = self.displacement[arms] + self.shift[arms]
        angles = self.start[arms, None] + progress[..., None] * turned[:, None]
        result[..., self._motors] += angles
        result[..., self._bent] += angles[..., self._flexible]
        return result


def _aligned(arms: IntArray, values: Array) -> IntArray:
    """Return the indices (r, 1, ...) of arms (r,), which select an entry for each of the values (r, ...)."""
    return arms.reshape(-1, *(1,) * (values.ndim - 1))


def _estimated_payloads(model: Model, parameters: Mapping[str, Array], arms: IntArray) -> Array:
    """Return the estimated payloads (r,) of the arms (r,), kg; the nominal payload if there is no estimate."""
    if "payload_mass" in parameters:
        return parameters["payload_mass"][arms]
    return np.full(len(arms), model.constants.payload_mass[0])


def _adaptation_factors(
    model: Model, nodes: Array, parameters: Mapping[str, Array], arms: IntArray
) -> tuple[Array, Array]:
    """Return the factors by which the references of arms (r,) are adapted to estimated parameters.

    Args:
        model: nominal model of the arm.
        nodes: (p,) payloads for which references are tabulated, kg.
        parameters: name -> (b, ...) estimated physical parameters; a missing name stands for the nominal value.
        arms: (r,) indices.

    Returns:
        Weights (r, p) of the Lagrange interpolation between the payloads; ratios (r, d) of the elastic deflections to
        the deflections of the nominal arm.
    """
    masses = np.clip(_estimated_payloads(model, parameters, arms), nodes[0], nodes[-1])
    weights = np.ones((len(arms), len(nodes)))
    for i, node in enumerate(nodes):
        for other in np.delete(nodes, i):
            weights[:, i] *= (masses - other) / (node - other)
    n, flexible = model.n_joints, model.constants.motor >= 0
    compliance = np.ones((len(arms), model.n_dof))
    if "joint_stiffness" in parameters:
        stiffness = np.where(flexible, parameters["joint_stiffness"][arms], 1.0)
        ratio = np.where(flexible, model.constants.joint_stiffness / stiffness, 1.0)
        compliance[:, :n] = compliance[:, model.motor_columns] = ratio
    if "link_stiffness_factor" in parameters:
        links = np.repeat(np.arange(n), np.diff(model.constants.elastic_start))
        compliance[:, model.n_dof - len(links) :] = 1.0 / parameters["link_stiffness_factor"][arms][:, links]
    return weights, compliance


def estimated_model(model: Model, parameters: Mapping[str, Array], arm: int) -> Model:
    """Return the model of an arm with its estimated payload and stiffness."""
    names = "payload_mass", "joint_stiffness", "link_stiffness_factor"
    return varied_model(model, **{name: parameters[name][arm] for name in names if name in parameters})


class PathReferences:
    """States and torques of b arms along given paths of their motors, planned for each payload, see `plan_path`.

    Args:
        model: model of the arm.
        period: control period, s.
        payloads: masses of one or three payloads, kg, from the lightest to the heaviest.
    """

    state_fields = ("_weights", "_compliance")

    def __init__(self, model: Model, period: float, payloads: Sequence[float]) -> None:
        self.model, self._period, self._payloads = model, period, np.array(payloads, dtype=float)
        self._models = [varied_model(model, payload_mass=mass) for mass in payloads]
        # arm -> states of the undeformed arm, and deviations from them and torques for each payload
        self._plans: dict[int, tuple[Array, Array, Array]] = {}
        self._weights, self._compliance = np.zeros((0, len(payloads))), np.zeros((0, model.n_dof))

    def begin(self, arm: int, path: Array) -> None:
        """Plan the motion of an arm along motor angles (T + 1, n) rad, one row per control period.

        `adapt` must follow before the first call of `at`.
        """
        plans = [plan_path(model, path, self._period) for model in self._models]
        straight = self.model.at_rest(path)
        straight[:, self.model.n_dof :] = np.gradient(straight[:, : self.model.n_dof], self._period, axis=0)
        deflections = np.array([plan.states - straight for plan in plans])
        self._plans[arm] = straight, deflections, np.array([plan.torques for plan in plans])
        for name in self.state_fields:
            setattr(self, name, pad_rows(getattr(self, name), arm + 1))

    def route(self, arm: int, count: int) -> Array:
        """Return at most `count` motor angles (g, n) rad along the path of an arm."""
        path = self._plans[arm][0][:, self.model.motor_columns]
        result: Array = path[np.linspace(0, len(path) - 1, min(count, len(path))).round().astype(int)]
        return result

    def adapt(self, arms: IntArray, parameters: Mapping[str, Array]) -> None:
        """Adapt the references of the arms (r,) to estimated parameters (b, ...), see `Estimate`."""
        if not len(arms):
            return
        self._weights[arms], self._compliance[arms] = _adaptation_factors(self.model, self._payloads, parameters, arms)

    def at(self, times: Array, arms: IntArray) -> tuple[Array, Array]:
        """Return the states (r, 2 d) at times (r,) s, and the torques (r, n) N m of the following period.

        The torques are those of the arms without friction.
        """
        states, torques = [], []
        for period, arm in zip((times / self._period).round().astype(int).tolist(), arms.tolist(), strict=True):
            straight, deflections, forward = self._plans[arm]
            row, weights = min(period, len(straight) - 1), self._weights[arm, :, None]
            deflection = (weights * deflections[:, row]).sum(axis=0) * np.tile(self._compliance[arm], 2)
            states.append(straight[row] + deflection)
            torques.append((weights * forward[:, min(period, forward.shape[1] - 1)]).sum(axis=0))
        return np.array(states), np.array(torques)
