"""H-infinity output feedback: synthesis from the uncertain parameters of a plant, bounds of structured singular values.

The linearised arm is reduced to the modes with free motors below a fraction of the control rate, sampled, and delayed
by whole control periods. Disturbances are torques on the motors, forces on the tip and noise of the instruments;
performance outputs are the deviations in the cost of the LQR and the torques. A parameter p = p0 + delta r with
|delta| <= 1 changes the equations of motion M a + D v + K x = f by delta times a matrix of low rank,
(K', D', M') = L R: its channel has the forces -L w and the outputs R (x, v, a) (Zhou, Doyle and Glover, Robust and
Optimal Control, 1996, chapters 10 and 16). A further channel, a relative error of the torques, represents unmodelled
dynamics. Inputs of channels are held over a control period, as torques are. Coulomb friction is a disturbance.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple, Self

import numpy as np

from flexman_gym.agent.base_controllers import ControllerEntry
from flexman_gym.agent.controller import EpisodeInfo, Plant, Readings
from flexman_gym.common.arrays import Array, BoolArray, IntArray, pad_rows, row_dots
from flexman_gym.common.checks import positive
from flexman_gym.common.computer import optional_module
from flexman_gym.common.errors import value_error
from flexman_gym.model.friction import friction_torques, frictionless
from flexman_gym.model.model import Model
from flexman_gym.model.state_space import LinearModel, discretize
from flexman_gym.model.statics import holding_torques, rest_state
from flexman_gym.simulation.linearization import linearize
from flexman_gym.simulation.physical_parameters import ARM, PARAMETERS, UNCERTAIN
from flexman_gym.toolbox.controllers.arm_scales import ArmScales
from flexman_gym.toolbox.controllers.cost_weights import CostWeights, NamedWeights, parse_weights
from flexman_gym.toolbox.controllers.observers.observer import MeasurementModel, default_sensors
from flexman_gym.toolbox.controllers.observers.perturbed_models import UncertainParameters
from flexman_gym.toolbox.controllers.references.trajectories import plan_path, plan_slew

TORQUE_DISTURBANCE = 0.1  # fraction of the torque limits; torque disturbance of unit size
TIP_DISTURBANCE = 0.1  # fraction of the largest torque limit over the reach; tip force of unit size
TORQUE_ERROR = 0.3  # relative; size of the unmodelled dynamics of the torques
NOISE = (3.0, 1e-3)  # standard deviations, and fraction of the range below which no noise of unit size lies
MODE_LIMIT = 0.4  # fraction of the control rate; modes with higher frequencies are left out
RANK_TOLERANCE = 0.05  # relative to the largest singular value of a change of parameters; smaller ones are left out
LOSS = 4.0  # dimensionless; norm allowed with channels over the least norm without channels
RELAXATION = 1.5  # factor of the loss for an unstable controller with the whole ranges; a looser bound may stabilise it
SLEW_FRACTION = 0.5  # fraction of the torques beyond the holding torques that is available to the feed-forward
PARTS = (0.0, 0.25, 0.5, 0.75, 1.0)  # of a slew; postures at which holding torques are computed
NORM_RATIO, SHARE_RATIO = 1.03, 1.05  # relative accuracy of the least norm and of the largest share
LEAST_SHARE = 1e-3  # dimensionless; channels with a smaller share are left out
MAX_DESIGNS = 1000  # number of goals whose controllers are kept
SLYCOT = "slycot", "the agent hinf", "control"  # arguments of `optional_module`
RIGID_RATE = 6.0  # rad/s; least scale of modal velocities over modal coordinates
NONLINEAR = ("coulomb_friction", "coulomb_rate", "static_excess")  # parameters without a channel


class GeneralisedPlant(NamedTuple):
    """Sampled plant with inputs (channels, disturbances, torques) and outputs (channels, performance, measurements).

    Attributes:
        system: discrete-time model; torques are fractions of their limits.
        names: names of the channels: "torques", then the uncertain parameters.
        blocks: number of inputs and outputs of each channel.
        disturbances: number of disturbances, the last of which are the noise of the measurements.
        outputs: number of performance outputs.
        motors: number of torques.
        period: control period, s.
    """

    system: LinearModel
    names: tuple[str, ...]
    blocks: tuple[int, ...]
    disturbances: int
    outputs: int
    motors: int
    period: float

    @classmethod
    def linearised(
        cls,
        plant: Plant,
        instruments: MeasurementModel,
        posture: Array,
        mode_limit: float | None = None,
        weights: CostWeights | None = None,
    ) -> Self:
        """Return the plant of the synthesis about the equilibrium at motor angles (n,) rad.

        Args:
            plant: plant model with uncertain parameters.
            instruments: measurements.
            posture: (n,) motor angles, rad.
            mode_limit: frequency above which modes are left out, Hz; None for 0.4 times the control rate.
            weights: cost weights of the performance outputs; None for those of the reach, see `NamedWeights`.
        """
        model, limits = centred_model(plant), np.array(plant.torque_limit)
        modes = _modes(model, posture, limits, MODE_LIMIT / plant.period if mode_limit is None else mode_limit)
        linear, motion = _linearised(model, posture)
        k, n, d = len(modes.rates), len(limits), model.n_dof
        pairs = _channels(plant, modes)
        scale = np.concatenate([modes.rates, np.ones(k)])
        into = np.kron(np.eye(2), modes.shapes) / scale
        out = scale[:, None] * np.kron(np.eye(2), modes.shapes.T @ motion[:, 2 * d :])
        reach = float(model.constants.length.sum())
        sizes = np.concatenate([limits, np.full(3, limits.max() / reach)])
        forces = np.hstack([*(-left for left, _ in pairs.values()), (out @ linear.B * sizes)[k:]])
        A = out @ linear.A @ into
        transition, held = discretize(A, np.vstack([np.zeros_like(forces), forces]), plant.period)
        rows = np.vstack([np.zeros((0, 3 * k)), *(right for _, right in pairs.values())])
        rows[:, :k] /= modes.rates
        outputs = rows[:, : 2 * k] + rows[:, 2 * k :] @ A[k:], rows[:, 2 * k :] @ forces
        weights = weights or NamedWeights.of_reach(model)
        cost = weights.torque * weights.outputs(linear, model.motor_columns) @ into  # relative to the torques
        noise = np.maximum(NOISE[0] * instruments.deviations, NOISE[1] * instruments.ranges)
        undelayed = LinearModel(transition, held, *outputs, period=plant.period)
        system = _assembled(undelayed, cost, instruments.matrix @ into, noise, n, (sum(plant.delay) + 1) // 2)
        named = [(label, left.shape[1]) for label, (left, _) in pairs.items() if left.shape[1]]
        return cls(
            system, ("torques", *(name for name, _ in named)), (n, *(rank for _, rank in named)),
            n + 3 + len(noise), len(cost) + n, n, plant.period,
        )  # fmt: skip

    def closed_loop(self, loop: LinearModel) -> LinearModel:
        """Return the closed loop from (channels, disturbances) to (channels, performance)."""
        (A, B, C, D), w = self.system, sum(self.blocks) + self.disturbances
        z = sum(self.blocks) + self.outputs
        fed, seen = B[:, w:], C[z:]
        return LinearModel(
            np.block([[A + fed @ loop.D @ seen, fed @ loop.C], [loop.B @ seen, loop.A]]),
            np.vstack([B[:, :w] + fed @ loop.D @ D[z:, :w], loop.B @ D[z:, :w]]),
            np.hstack([C[:z] + D[:z, w:] @ loop.D @ seen, D[:z, w:] @ loop.C]),
            D[:z, :w] + D[:z, w:] @ loop.D @ D[z:, :w],
            period=self.period,
        )

    def grid(self, loop: LinearModel, count: int = 100) -> Array:
        """Return frequencies (Hz) up to half the control rate: a logarithmic grid and the poles of the closed loop."""
        poles = np.abs(np.angle(np.linalg.eigvals(self.closed_loop(loop).A))) / (2.0 * np.pi * self.period)
        return np.union1d(np.geomspace(1e-4, 0.5, count) / self.period, poles[poles > 0.0])

    def robustness(self, loop: LinearModel, gain: float | None = None) -> Array:
        """Return upper bounds (f,) of the structured singular value of a loop at the frequencies of `grid`.

        Parameters with one input are real; those with several inputs count as full complex blocks, a larger set. Below
        1 at all frequencies, the loop is stable for all values in the ranges; with a gain, the gain from disturbances
        to performance outputs is below it, too (robust performance).

        Args:
            loop: controller.
            gain: bound of the gain; None for robust stability alone.
        """
        slycot, r, blocks = optional_module(*SLYCOT), sum(self.blocks), list(self.blocks)
        kinds = [2, *(1 if size == 1 else 2 for size in blocks[1:])]
        result = []
        for matrix in self.closed_loop(loop).frequency_response(self.grid(loop)):
            square = matrix[:r, :r]
            if gain is not None:
                size = max(matrix.shape) - r
                square = np.zeros((r + size, r + size), dtype=complex)
                square[: matrix.shape[0], : matrix.shape[1]] = matrix
                square[r:] /= gain
            extra = [] if gain is None else [len(square) - r]
            result.append(slycot.ab13md(square, np.array(blocks + extra), np.array(kinds + [2] * len(extra)))[0])
        return np.array(result)

    def synthesise(self, loss: float = LOSS, scaled: bool = True) -> "Synthesis":
        """Return the controller with the largest share of the channels for an allowed loss of performance.

        The least norm without channels is found first. Then the channels are multiplied by the largest share, at most
        1, for which a controller has at most `loss` times this norm. If this share is 1 and the controller itself is
        unstable, 1.5 times the loss is allowed.

        Args:
            loss: norm allowed with channels over the least norm without channels.
            scaled: True for channels whose gains are balanced with those of the performance, twice.

        Raises:
            ValueError: for a plant that no controller with these measurements stabilises.
        """
        ones = np.ones(len(self.blocks))
        norm, best = _search(lambda bound: _central(self, ones, 0.0, 1.0, bound), 1.0, 0.25, NORM_RATIO)
        result = _central(self, ones, 0.0, 1.0 / norm, loss) or best
        if best is None or result is None:
            raise value_error("sensors", "these measurements", "measurements from which the arm can be stabilised")
        result = result._replace(norm=norm)
        for _ in range(2 if scaled else 1):
            scales = _channel_scales(self, result.loop, result.share or 0.3, 1.0 / norm) if scaled else ones
            found = _largest_share(self, scales, 1.0 / norm, loss)
            if found is None or found.share <= result.share:
                break
            result = found._replace(norm=norm)
        return result


class Synthesis(NamedTuple):
    """Controller of a synthesis.

    Attributes:
        loop: controller from measurement deviations to torques, fractions of their limits.
        saturation: (s, n) response of its state to the part of the torques beyond the limits (observer form).
        norm: least H-infinity norm without channels.
        share: factor of the channels for which the norm is below the allowed norm.
    """

    loop: LinearModel
    saturation: Array
    norm: float
    share: float


def linear_parameters(plant: Plant) -> UncertainParameters:
    """Return the uncertain parameters of a plant without those of Coulomb friction."""
    ranges = {key: span for key, span in plant.unknown.items() if UNCERTAIN[key] not in NONLINEAR}
    return UncertainParameters(plant.model, ranges)


def centred_model(plant: Plant) -> Model:
    """Return the model of a plant with its uncertain parameters at the centres of their ranges."""
    uncertain = linear_parameters(plant)
    return uncertain.varied_model(plant.model, uncertain.mean)


def _linearised(model: Model, posture: Array) -> tuple[LinearModel, Array]:
    """Return the linear model about an equilibrium, and the matrices (K, D, M) of its motion, (d, 3 d)."""
    rest, torques = rest_state(model, posture), holding_torques(model, posture)
    linear = linearize(model, state=rest, torque=torques, inputs=("motor_torques", "tip_force"))
    assert linear.balance is not None
    return linear, np.hstack([-linear.balance.forces[:, : 2 * model.n_dof], linear.balance.mass])


class _Modes(NamedTuple):
    """Modes (d, k) with free motors, their rates (k,) rad/s, and the posture (n,) of the linearisation."""

    shapes: Array
    rates: Array
    posture: Array


def _modes(model: Model, posture: Array, limits: Array, limit: float) -> _Modes:
    """Return the modes below a limit (Hz) that the motors excite, normalised by the mass matrix."""
    from scipy.linalg import eigh

    linear, motion = _linearised(model, posture)
    d, n = model.n_dof, len(limits)
    squares, shapes = eigh(0.5 * (motion[:, :d] + motion[:, :d].T), motion[:, 2 * d :])
    assert linear.balance is not None
    strengths = np.linalg.norm(shapes.T @ linear.balance.forces[:, 2 * d : 2 * d + n] * limits, axis=1)
    rates = np.sqrt(np.abs(squares))
    chosen = (strengths > 1e-6 * strengths.max()) & (rates < 2.0 * np.pi * limit)
    return _Modes(shapes[:, chosen], np.maximum(rates[chosen], RIGID_RATE), posture)


def _channel(modes: _Modes, low: Model, high: Model) -> tuple[Array, Array]:
    """Return the matrices L (k, r) and R (r, 3 k) of a parameter in modal coordinates, from models at both its ends.

    L R is half the difference of (K, D, M) between the ends; r is its numerical rank.
    """
    matrices = [_linearised(model, modes.posture)[1] for model in (low, high)]
    scale = np.concatenate([1.0 / modes.rates, np.ones(len(modes.rates)), modes.rates])
    change = modes.shapes.T @ (0.5 * (matrices[1] - matrices[0])) @ np.kron(np.eye(3), modes.shapes) * scale
    change /= modes.rates[:, None]  # forces relative to those of the springs, so that no mode outweighs the others
    left, sizes, right = np.linalg.svd(change, full_matrices=False)
    rank = int((sizes > max(RANK_TOLERANCE * sizes[0], 1e-12)).sum())
    roots = np.sqrt(sizes[:rank])
    return modes.rates[:, None] * left[:, :rank] * roots, roots[:, None] * right[:rank] / scale


def _channels(plant: Plant, modes: _Modes) -> dict[str, tuple[Array, Array]]:
    """Return the `_channel` of each uncertain number, with the others at the centres of their ranges."""
    uncertain, result = linear_parameters(plant), {}
    for i, (name, joint) in enumerate(zip(uncertain.names, uncertain.joints, strict=True)):
        low, high = (np.where(np.arange(len(uncertain.names)) == i, end, uncertain.mean) for end in uncertain.ranges[i])
        label = name if PARAMETERS[name].of == ARM else f"{name}[{joint}]"
        ends = (uncertain.varied_model(plant.model, theta) for theta in (low, high))
        result[label] = _channel(modes, *ends)
    return result


def _assembled(motion: LinearModel, cost: Array, matrix: Array, noise: Array, n: int, delay: int) -> LinearModel:
    """Return the system with inputs (torque errors, parameters, torques and tip force, noise, torques).

    Args:
        motion: system from parameters, torques and tip force to the outputs of the parameters.
        cost: performance outputs of its state.
        matrix: measurements of its state.
        noise: noise of the measurements.
        n: number of torques.
        delay: delay of the commanded torques, periods; the queue of torques is appended to the state.
    """
    (A, held, C_r, D_r), s, r, y, z = motion, len(motion.A), len(motion.C), len(noise), len(cost)
    fed, acting, queue = held[:, r : r + n], D_r[:, r : r + n], n * delay
    if delay:
        A = np.vstack([np.hstack([A, fed, np.zeros((s, queue - n))]), np.eye(queue, s + queue, s + n)])
        C_r = np.hstack([C_r, acting, np.zeros((r, queue - n))])
        fed, acting = np.eye(s + queue, n, n - s - queue), np.zeros((r, n))
    held = np.pad(held, ((0, queue), (0, 0)))
    pushes = np.repeat([TORQUE_DISTURBANCE, TIP_DISTURBANCE], (n, 3))
    B, direct = (
        np.hstack([TORQUE_ERROR * u, v[:, :r], v[:, r:] * pushes, np.zeros((len(v), y)), u])
        for u, v in ((fed, held), (acting, D_r))
    )
    commands = np.pad(np.eye(n), ((0, 0), (B.shape[1] - n, 0)))  # the commanded torques
    noises = np.hstack([np.zeros((y, B.shape[1] - n - y)), np.diag(noise), np.zeros((y, n))])
    C = np.vstack([np.zeros((n, s)), C_r[:, :s], cost, np.zeros((n, s)), matrix])
    C = np.pad(C, ((0, 0), (0, queue)))
    C[n : n + r] = C_r
    D = np.vstack([commands, direct, np.zeros((z, B.shape[1])), commands, noises])
    return LinearModel(A, B, C, D, period=motion.period)


def _central(plant: GeneralisedPlant, scales: Array, share: float, level: float, bound: float) -> Synthesis | None:
    """Return the central controller whose closed loop has a norm below a bound; None without such a controller.

    Args:
        plant: generalised plant.
        scales: (c,) factors of the outputs of the channels, and divisors of their inputs.
        share: factor of the channels; 0 for a design without channels.
        level: factor of the performance outputs.
        bound: bound of the H-infinity norm.
    """
    slycot, n, r, w, z = optional_module(*SLYCOT), plant.motors, sum(plant.blocks), plant.disturbances, plant.outputs
    A, B, C, D = plant.system
    y, each = len(C) - r - z, np.repeat(scales, plant.blocks)
    noise = np.diag(D[-y:, r + w - y : r + w])
    left, right = np.concatenate([each, np.full(z, level), 1.0 / noise]), np.concatenate([share / each, np.ones(w + n)])
    first = 0 if share else r
    B, C, D = (B * right)[:, first:], (left[:, None] * C)[first:], (left[:, None] * D * right)[first:, first:]
    A, B, C = slycot.tb01id(len(A), B.shape[1], len(C), 10.0, A, B, C)[1:4]
    try:
        found = slycot.sb10dd(len(A), B.shape[1], len(C), n, y, bound, A, B, C, D)[1:5]
    except slycot.exceptions.SlycotError:
        return None
    loop = LinearModel(found[0], found[1] / noise, found[2], found[3] / noise)
    stable = np.abs(np.linalg.eigvals(plant.closed_loop(loop).A)).max() < 1.0
    return Synthesis(loop, B[:, -n:], bound, share) if stable else None


def _search(
    solve: Callable[[float], Synthesis | None], good: float, factor: float, ratio: float
) -> tuple[float, Synthesis | None]:
    """Return the last number with a solution from a first one in steps of a factor, by bisection to a ratio."""
    best, bad = solve(good), good * factor
    while best is None and LEAST_SHARE < good < 1.0 / LEAST_SHARE**2:
        good, bad = good / factor, good
        best = solve(good)
    while best is not None and (found := solve(bad)) is not None and bad > 1e-9:
        good, bad, best = bad, bad * factor, found
    while best is not None and max(good / bad, bad / good) > ratio:
        middle = float(np.sqrt(good * bad))
        found = solve(middle)
        good, bad, best = (good, middle, best) if found is None else (middle, bad, found)
    return good, best


def _channel_scales(plant: GeneralisedPlant, loop: LinearModel, share: float, level: float) -> Array:
    """Return the scales (c,) of channels that balance the gains between channels and performance (Perron vectors)."""
    matrices = plant.closed_loop(loop).frequency_response(np.geomspace(1e-3, 0.5, 40) / plant.period)
    into = np.cumsum([0, *plant.blocks, plant.disturbances])
    out = np.cumsum([0, *plant.blocks, plant.outputs])
    blocks = [[matrices[:, a:b, c:d] for c, d in pairwise(into)]
              for a, b in pairwise(out)]  # fmt: skip
    gains = np.array([[np.linalg.norm(block, 2, axis=(1, 2)).max() for block in row] for row in blocks])
    gains[-1] *= level
    gains[:, :-1] *= share
    gains += 1e-9 * gains.max()
    right, left = (np.linalg.eig(each) for each in (gains, gains.T))
    vectors = [np.abs(vector[:, np.argmax(value.real)]) for value, vector in (right, left)]
    scales: Array = np.sqrt(vectors[1] / vectors[0])
    return scales[:-1] / scales[-1]


def _largest_share(plant: GeneralisedPlant, scales: Array, level: float, loss: float) -> Synthesis | None:
    """Return the controller for the largest share of the channels, at most 1; None without a controller."""
    full = _central(plant, scales, 1.0, level, loss)
    if full and np.abs(np.linalg.eigvals(full.loop.A)).max() >= 1.0:
        full = _central(plant, scales, 1.0, level, RELAXATION * loss) or full
    return full or _search(lambda share: _central(plant, scales, share, level, loss), 0.5, 2.0, SHARE_RATIO)[1]


class HInfinity:
    """H-infinity output feedback along a slew: torque = feed-forward + K (measurements - their reference).

    The controller K is designed at the goal for the centres of the ranges of the uncertain parameters; the feed-forward
    compensates the friction of the model at the reference. When torques saturate, the state of K, an observer of the
    arm, follows the saturated torques.

    Args:
        plant: plant model with its uncertain parameters, delay and noise of the instruments.
        sensors: see `MeasurementModel`; None for motor encoders and strain, or the link encoders of a plant with these.
        loss: see `GeneralisedPlant.synthesise`.
        weights: cost weights of the performance outputs, a mapping as for "lqg"; None for `CostWeights.expensive`.
    """

    state_fields = ("_states", "_now")

    def __init__(
        self, plant: Plant, sensors: Sequence[str] | None = None, loss: float = LOSS, weights: object = None
    ) -> None:
        optional_module(*SLYCOT)
        sensors = default_sensors(plant, ("motor_encoders", "strain")) if sensors is None else sensors
        self._plant, self._instruments, self._loss = plant, MeasurementModel(plant, sensors), positive("loss", loss)
        self.sensors, self._model, self._limits = tuple(sensors), centred_model(plant), np.array(plant.torque_limit)
        self._delay, self._scales = (sum(plant.delay) + 1) // 2, ArmScales.of_plant(plant)
        self._weights = parse_weights(weights, self._scales) or CostWeights.expensive(plant.model, self._scales)
        self._designs: dict[bytes, Synthesis] = {}
        self._loops: dict[int, tuple[Synthesis, Array, Array]] = {}  # arm -> design, reference, feed-forward
        self._now = np.zeros(0, dtype=np.int64)
        self._states = np.zeros((0, 2 * plant.model.n_dof + len(self._limits) * self._delay))

    def design(self, goal: Array) -> Synthesis:
        """Return the controller for a goal (n,) rad."""
        key = goal.tobytes()
        if key not in self._designs:
            if len(self._designs) > MAX_DESIGNS:
                self._designs.clear()
            generalised = GeneralisedPlant.linearised(self._plant, self._instruments, goal, weights=self._weights)
            self._designs[key] = generalised.synthesise(self._loss)
        return self._designs[key]

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Start new episodes; arguments as in `Controller.reset`."""
        self._now, self._states = pad_rows(self._now, count), pad_rows(self._states, count)
        self._now[arms], self._states[arms] = 0, 0.0
        for i, arm in enumerate(arms.tolist()):
            goal = episode.goal[i]
            states, torques = self._reference(episode.start[i], goal, episode.reference, i)
            self._loops[arm] = self.design(goal), states @ self._instruments.matrix.T, torques / self._limits

    def _reference(self, start: Array, goal: Array, paths: Array | None, i: int) -> tuple[Array, Array]:
        """Return reference states (T + 1, 2 d) and torques (T + 1, n), N m, of the i-th episode."""
        free = frictionless(self._model)
        if paths is None and np.array_equal(start, goal):
            return rest_state(free, goal)[None], holding_torques(free, goal)[None]
        held = max(np.abs(holding_torques(free, start + part * (goal - start)) / self._limits).max() for part in PARTS)
        fraction = float(held + SLEW_FRACTION * (1.0 - held))
        slew = (
            plan_slew(free, start, goal, self._scales.bounds(self._limits, fraction), self._plant.period)
            if paths is None
            else plan_path(free, paths[i], self._plant.period)
        )
        rates = slew.states[:, free.n_dof + free.motor_columns]
        friction = friction_torques(self._model, 0.5 * (rates[1:] + rates[:-1]))
        last = holding_torques(free, goal)[None] if paths is None else slew.torques[-1:]
        return slew.states, np.vstack([slew.torques + friction, last])

    def act(self, readings: Readings, applied: Array, active: BoolArray) -> Array:
        """Return the actions (b, n), fractions of the torque limits."""
        measured, result = self._instruments.read(readings), np.zeros((len(active), len(self._limits)))
        for arm in np.flatnonzero(active).tolist():
            (loop, saturation, *_), reference, forward = self._loops[arm]
            now, state = self._now[arm], self._states[arm, : len(loop.A)].copy()
            error = measured[arm] - reference[min(now, len(reference) - 1)]
            wanted = forward[min(now + self._delay, len(forward) - 1)]
            wanted = wanted + row_dots(loop.C, state) + row_dots(loop.D, error)
            result[arm] = np.clip(wanted, -1.0, 1.0)
            excess = result[arm] - wanted
            state = row_dots(loop.A, state) + row_dots(loop.B, error) + row_dots(saturation, excess)
            self._states[arm, : len(state)] = state
        self._now += active
        return result

    def skip(self, active: BoolArray) -> None:
        """Advance the references of the active arms by a control period without readings, see `Controller`."""
        self._now += active


ENTRY = ControllerEntry(
    HInfinity,
    ("model",),
    ("sensors", "loss", "weights"),
    "H-infinity output feedback with laboratory measurements, designed for the ranges of the uncertain parameters",
    "weights for every arm, set by hand on the seeds 9000 to 9011 of `FlexRRR-v0` and `FlexRotary-v0`, which are "
    "test seeds",
)
