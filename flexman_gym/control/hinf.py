"""H-infinity control: synthesis from the uncertain parameters of a plant, robustness by structured singular values.

The linearised arm is reduced to its lowest modes with free motors and sampled; torques are delayed by whole control
periods. Disturbances are torques on the motors and noise of the instruments. Performance outputs are the torques and
the deviations in the cost of the LQR. A parameter p = p0 + delta r, |delta| <= 1, changes the equations of motion
M a + D v + K x = f by delta times a matrix of low rank, (K', D', M') = L R: its channel has the forces -L w and the
outputs R (x, v, a) (Zhou, Doyle and Glover, Robust and Optimal Control, 1996, chapters 10 and 16). Inputs of channels
are held over a control period, as torques are. The bilinear transformation w = 2 (z - 1) / (T (z + 1)) preserves the
H-infinity norm, so that the controller of the sampled plant follows from the formulas in continuous time.
"""

from collections.abc import Sequence
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array, BoolArray, IntArray, pad_rows, row_dots
from flexman_gym.common.checks import value_error
from flexman_gym.control.controller import EpisodeInfo, Plant, Readings
from flexman_gym.control.friction_compensation import COMPENSATION_FACTOR, frictionless, friction_torques, friction_coefficients
from flexman_gym.control.lqr import CostWeights, default_weights, performance_outputs
from flexman_gym.control.observers.observer import MeasurementModel
from flexman_gym.control.references.trajectories import plan_slew
from flexman_gym.model.linearization import linearize
from flexman_gym.model.model import Model
from flexman_gym.model.state_space import LinearModel, discretize
from flexman_gym.model.statics import holding_torques, rest_state
from flexman_gym.simulation.parameters import PARAMETERS, UNCERTAIN, varied_model

NONLINEAR = ("coulomb_friction", "coulomb_rate", "static_excess")
RIGID = 6.0  # rad/s; scale of the rates of rigid modes
STRENGTH = 1e-6


class Loop(NamedTuple):
    A: Array
    B: Array
    C: Array
    D: Array
    E: Array  # response to the part of the torques beyond the limits


class Channel(NamedTuple):
    name: str
    forces: Array
    motion: Array


class Design(NamedTuple):
    A: Array
    B: Array
    C: Array
    D: Array
    blocks: tuple[int, ...]
    sizes: tuple[int, int, int, int, int]
    names: tuple[str, ...]


def ranges(plant):
    result = []
    for key, (low, high) in plant.unknown.items():
        name = UNCERTAIN[key]
        parameter = PARAMETERS[name]
        if name in NONLINEAR:
            continue
        nominal = np.array(parameter.nominal(plant.model), dtype=float)
        if nominal.ndim == 0:
            scale = float(nominal) if parameter.factor else 1.0
            result.append((name, None, low * scale, high * scale))
            continue
        for part in np.flatnonzero(~parameter.fixed(plant.model)).tolist():
            scale = float(nominal[part]) if parameter.factor else 1.0
            if scale:
                result.append((name, part, low * scale, high * scale))
    return result


def centred_model(plant):
    values = {}
    for name, part, low, high in ranges(plant):
        nominal = np.array(PARAMETERS[name].nominal(plant.model), dtype=float)
        values.setdefault(name, nominal)
        values[name][() if part is None else (part,)] = 0.5 * (low + high)
    return varied_model(plant.model, **values) if values else plant.model


def _linear(model, posture):
    return linearize(model, state=rest_state(model, posture), torque=holding_torques(model, posture), inputs=("motor_torques", "tip_force"))


def _motion(model, posture):
    balance = _linear(model, posture).balance
    return np.hstack([-balance.forces[:, : 2 * model.n_dof], balance.mass])


def basis(model, posture, limits, bandwidth):
    linear = _linear(model, posture)
    d = model.n_dof
    from scipy.linalg import eigh
    stiffness = -linear.balance.forces[:, :d]
    squares, modes = eigh(0.5 * (stiffness + stiffness.T), linear.balance.mass)
    strengths = np.linalg.norm(modes.T @ (linear.balance.forces[:, 2 * d : 2 * d + len(limits)] * limits), axis=1)
    rates = np.sqrt(np.abs(squares))
    chosen = (strengths > STRENGTH * strengths.max()) & (rates < 2 * np.pi * bandwidth)
    return linear, modes[:, chosen], np.maximum(rates[chosen], RIGID)


def channels_of(plant, model, posture, modes, rates, tolerance):
    result = []
    k = len(rates)
    scale = np.concatenate([1 / rates, np.ones(k), rates])
    wide = np.kron(np.eye(3), modes)
    for name, part, low, high in ranges(plant):
        ends = []
        for value in (low, high):
            values = np.array(PARAMETERS[name].nominal(model), dtype=float)
            values[() if part is None else (part,)] = value
            ends.append(_motion(varied_model(model, **{name: values}), posture))
        change = modes.T @ (0.5 * (ends[1] - ends[0])) @ wide * scale
        left, sizes, right = np.linalg.svd(change, full_matrices=False)
        rank = int((sizes > tolerance * sizes[0]).sum()) if sizes[0] > 1e-9 else 0
        roots = np.sqrt(sizes[:rank])
        if rank:
            result.append(Channel(name if part is None else f"{name}[{part}]", left[:, :rank] * roots, roots[:, None] * right[:rank] / scale))
    return result


def design_plant(plant, instruments, posture, bandwidth, weights, disturbance=0.1, floor=1e-3, tolerance=0.05, torque=1.0, tip=0.1):
    limits, n = np.array(plant.torque_limit), len(plant.torque_limit)
    model = centred_model(plant)
    linear, modes, rates = basis(model, posture, limits, bandwidth)
    k, d, y = len(rates), model.n_dof, len(instruments.ranges)
    channels = channels_of(plant, model, posture, modes, rates, tolerance)
    into, out = np.kron(np.eye(2), modes), np.kron(np.eye(2), modes.T @ linear.balance.mass)
    scale = np.concatenate([rates, np.ones(k)])
    A = scale[:, None] * (out @ linear.A @ into) / scale
    reach = float(model.constants.length.sum())
    pushes = np.concatenate([np.full(n, disturbance), np.full(3, tip / disturbance * disturbance)])
    torques = scale[:, None] * (out @ linear.B * np.concatenate([limits, np.full(3, limits.max() / reach)]))
    r = sum(c.forces.shape[1] for c in channels)
    forces = np.hstack([np.zeros((k, 0)), *(-c.forces for c in channels)])
    rows = np.vstack([np.zeros((0, 3 * k)), *(c.motion for c in channels)]) / np.concatenate([rates, np.ones(k), np.ones(k)])
    direct = np.vstack([np.zeros((2 * k, r + n + 3)), np.hstack([forces, torques[k:]])])
    motion = np.vstack([np.eye(2 * k), A[k:]])
    transition, held = discretize(A, np.hstack([np.vstack([np.zeros((k, r)), forces]), torques]), plant.period)
    cost = performance_outputs(linear, model.motor_columns, weights) @ into / scale
    delay = (sum(plant.delay) + 1) // 2
    size = 2 * k + n * delay
    full, B_u = np.zeros((size, size)), np.zeros((size, n))
    full[: 2 * k, : 2 * k] = transition
    acting = rows @ direct[:, r:]
    z = len(cost)
    q = n + 3; B = np.zeros((size, r + q + y + n)); C = np.zeros((r + z + n + y, size)); D = np.zeros((len(C), B.shape[1]))
    if delay:
        late = slice(2 * k, 2 * k + n)
        full[: 2 * k, late] = held[:, r : r + n]
        full[2 * k : size - n, 2 * k + n :] = np.eye(n * (delay - 1))
        B[size - n :, -n:] = np.eye(n)
        C[:r, late] = acting[:, :n]
    else:
        B[: 2 * k, -n:] = held[:, r : r + n]
        D[:r, -n:] = acting[:, :n]
    B[: 2 * k, :r] = held[:, :r]
    B[: 2 * k, r : r + q] = pushes * held[:, r:]
    C[:r, : 2 * k] = rows @ motion
    D[:r, :r], D[:r, r : r + q] = rows @ direct[:, :r], pushes * acting
    C[r : r + z, : 2 * k] = cost
    D[r + z : r + z + n, -n:] = torque * np.eye(n)
    C[-y:, : 2 * k] = (instruments.matrix @ into / scale) 
    D[-y:, r + q : r + q + y] = np.diag(np.maximum(instruments.deviations, floor * instruments.ranges))
    return Design(full, B, C, D, tuple(c.forces.shape[1] for c in channels), (r, q + y, n, z + n, y), tuple(c.name for c in channels))


def _slycot() -> ModuleType:
    try:
        import slycot
    except ImportError:
        raise ImportError("the agent hinf needs slycot: pip install 'flexman-gym[control]'") from None
    return slycot


def synthesise(design, scales=None, level=1.0, beta=1.0, margin=1.1):
    slycot = _slycot()
    r, w, n, z, y = design.sizes
    each = np.repeat(np.ones(len(design.blocks)) if scales is None else scales, design.blocks)
    left, right = np.ones(r + z + y), np.ones(r + w + n)
    left[:r], right[:r], left[r : r + z] = each, beta / each, level
    noise = np.diag(design.D[-y:, r + w - y : r + w])
    left[-y:] = 1 / noise
    A, B, C, D = design.A, design.B * right, left[:, None] * design.C, left[:, None] * design.D * right
    _, A, B, C, change = slycot.tb01id(len(A), B.shape[1], len(C), 10.0, A, B, C)

    def solve(gamma):
        try:
            K = slycot.sb10dd(len(A), B.shape[1], len(C), n, y, gamma, A, B, C, D)[1:5]
        except slycot.exceptions.SlycotError:
            return None
        loop = Loop(K[0], K[1] / noise, K[2], K[3] / noise, B[:, -n:])
        return loop if abs(np.linalg.eigvals(closed(design, loop)[0])).max() < 1 else None
    high = 1.0
    while solve(high) is None:
        high *= 2
        if high > 1e4: return None
    low = high
    while solve(low / 2) is not None:
        low /= 2
        high = low
    low /= 2
    while high / low > 1.03:
        middle = np.sqrt(high * low)
        low, high = (low, middle) if solve(middle) is not None else (middle, high)
    best = solve(margin * high) or solve(high)
    return best, high


def closed(design, K):
    """Closed loop from (channels, disturbances) to (channels, performance) in discrete time."""
    r, w, n, z, y = design.sizes
    A, B1, B2 = design.A, design.B[:, : r + w], design.B[:, r + w :]
    C1, C2 = design.C[: r + z], design.C[r + z :]
    D11, D12, D21 = design.D[: r + z, : r + w], design.D[: r + z, r + w :], design.D[r + z :, : r + w]
    return (np.block([[A + B2 @ K.D @ C2, B2 @ K.C], [K.B @ C2, K.A]]), np.vstack([B1 + B2 @ K.D @ D21, K.B @ D21]),
            np.hstack([C1 + D12 @ K.D @ C2, D12 @ K.C]), D11 + D12 @ K.D @ D21)


def response(system, period, frequencies):
    A, B, C, D = system
    z = np.exp(2j * np.pi * np.asarray(frequencies) * period)
    return C @ np.linalg.solve(z[:, None, None] * np.eye(len(A)) - A, B + 0j * z[:, None, None]) + D


def mu_bounds(matrices, blocks, performance=False, complex_only=False, sizes=None):
    slycot = _slycot()
    r = sum(blocks)
    out = []
    x = None
    itype = [1 if b == 1 and not complex_only else 2 for b in blocks]
    nb = list(blocks)
    for M in matrices:
        if performance:
            p = max(M.shape[0] - r, M.shape[1] - r)
            Z = np.zeros((r + p, r + p), complex); Z[: M.shape[0], : M.shape[1]] = M
            nbl, it = nb + [p], itype + [2]
        else:
            Z, nbl, it = M[:r, :r], nb, itype
        out.append(slycot.ab13md(np.asfortranarray(Z), np.array(nbl), np.array(it))[0] if len(Z) > 1 or it[0] == 2 else (abs(Z[0,0]) if abs(Z[0,0].imag) < 1e-9 * abs(Z[0, 0]) else 0.0))
    return np.array(out)


class HInfinity:
    state_fields = ("_states", "_now")

    def __init__(self, plant, sensors=("motor_encoders", "strain"), bandwidth=None, level=1.0, beta=1.0, disturbance=0.1, floor=1e-3, torque=1.0, tip=0.1, fraction=0.8, margin=1.1, tolerance=0.05, iterations=0):
        self._plant, self._limits = plant, np.array(plant.torque_limit)
        self._instruments = MeasurementModel(plant, sensors)
        self.sensors = tuple(sensors)
        self._o = dict(bandwidth=bandwidth, disturbance=disturbance, floor=floor, torque=torque, tip=tip, tolerance=tolerance)
        self._s = dict(level=level, beta=beta, margin=margin)
        self._fraction = fraction
        self._model = centred_model(plant)
        self._loops, self._slews = [], []
        self._now = np.zeros(0, dtype=np.int64)
        self._states = np.zeros((0, 0))
        self.norms = []

    def reset(self, arms, episode, count):
        self._now = pad_rows(self._now, count)
        while len(self._loops) < count:
            self._loops.append(None); self._slews.append(None)
        for arm, first, last in zip(arms, episode.start, episode.goal, strict=True):
            d = design_plant(self._plant, self._instruments, last, weights=default_weights(self._model), **self._o)
            found = synthesise(d, **self._s)
            assert found is not None
            K, g = found
            self.norms.append(g)
            self._loops[arm] = K
            free = frictionless(self._model)
            s = plan_slew(free, first, last, self._limits, self._fraction, self._plant.period)
            rates = s.states[:, self._model.n_dof + self._model.motor_columns]
            coefficients = friction_coefficients(self._model, {}, np.zeros(1, dtype=int))[0]
            torques = s.torques + friction_torques(self._model, coefficients, 0.5 * (rates[1:] + rates[:-1]))
            torques = np.vstack([torques, holding_torques(self._model, last)])
            self._slews[arm] = (s.states @ self._instruments.matrix.T, torques)
            if self._states.shape[1] < len(K.A):
                self._states = np.pad(self._states, ((0, 0), (0, len(K.A) - self._states.shape[1])))
            self._states = pad_rows(self._states, count)
            self._states[arm] = 0.0
            self._now[arm] = 0

    def act(self, readings, applied, active):
        y = self._instruments.read(readings)
        result = np.zeros((len(active), len(self._limits)))
        lead = (sum(self._plant.delay) + 1) // 2
        for arm in np.flatnonzero(active):
            K = self._loops[arm]
            reference, torques = self._slews[arm]
            k = self._now[arm]
            error = y[arm] - reference[min(k, len(reference) - 1)]
            x = self._states[arm, : len(K.A)]
            u = K.C @ x + K.D @ error
            ff = torques[min(k + lead, len(torques) - 1)] / self._limits
            result[arm] = np.clip(ff + u, -1, 1)
            self._states[arm, : len(K.A)] = K.A @ x + K.B @ error + K.E @ (result[arm] - ff - u)
            self._now[arm] += 1
        return result
