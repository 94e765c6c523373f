"""Least-squares problem of a fit: free parameters in logarithms, residuals of the data, and their Jacobian."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import is_decimal_integer, one_of, value_error, whole_number
from flexman_gym.common.progress import Progress
from flexman_gym.identification.measurement import Filter, SimulatedResponse
from flexman_gym.identification.ringing import Ringing
from flexman_gym.model.dynamics import mass_matrix
from flexman_gym.model.model import Model, build_model
from flexman_gym.scene.arm import Arm
from flexman_gym.simulation.parameters import ARM, PARAMETERS, nominal_parameters, rename_old_keys, varied_arm

WIDEST = 7.0  # largest departure of a logarithm from its start: a factor of 1100
CRITICAL = 0.99  # largest damping ratio of a link
STEP = 1e-3  # of a logarithm, to either side, over which responses are differentiated
SLOW = 2.0 * np.pi  # rad/s, of the usual sizes below
USUAL: dict[str, Callable[[Model, Array], Array | float]] = {  # where the arm says 0, a size to start from
    "payload_mass": lambda model, inertia: 0.1 * sum(link.mass for link in model.arm.links),
    "joint_damping": lambda model, inertia: 0.02 * np.sqrt(model.constants.joint_stiffness * inertia),
    "rotor_inertia": lambda model, inertia: 0.1 * inertia,
    "viscous_friction": lambda model, inertia: 0.02 * SLOW * inertia,
    "coulomb_friction": lambda model, inertia: 0.01 * SLOW**2 * inertia,
    "link_damping": lambda model, inertia: np.full(model.n_joints, 0.01),
}


class _FreeNumber(NamedTuple):
    """A number that is free: a parameter in PARAMETERS, and of which joint or link, from 0; None of the arm."""

    parameter: str
    place: int | None

    def __str__(self) -> str:
        return self.parameter if self.place is None else f"{self.parameter}[{self.place}]"


class FreeParameters:
    """What of an arm is free.

    Attributes:
        asked: the names as they were given, name -> its Numbers.
        numbers: all of them, p.
        arm: that the fit starts from; where it had 0 in place of a free number, it has one of a usual size.
        start: (p,) their values there.
        highest: (p,) by how much their logarithms may grow.
    """

    def __init__(self, arm: Arm, free: str | Sequence[str]) -> None:
        names = [free] if isinstance(free, str) else list(free)
        if not names:
            raise value_error("free", free, f"at least one of {', '.join(PARAMETERS)}")
        model = build_model(arm, 1, flexible_links=False)
        self.asked = {str(name): _numbers(str(name), model) for name in names}
        self.numbers = list(dict.fromkeys(number for some in self.asked.values() for number in some))
        self.arm, self._base = arm, nominal_parameters(model)
        inertia = np.diag(mass_matrix(model, np.zeros(2 * model.n_dof)))[: model.n_joints]
        start = self.of(self._base)
        for i in np.flatnonzero(start == 0.0):
            number = self.numbers[i]
            usual = np.ravel(USUAL[number.parameter](model, inertia))
            start[i] = usual[number.place or 0]
        self.start, self.arm = start, self.changed(start)
        ratios = np.array([number.parameter == "link_damping" for number in self.numbers])
        self.highest = np.where(ratios, np.log(CRITICAL / start), WIDEST)

    def of(self, parameters: Mapping[str, Any]) -> Array:
        """Gives the free numbers (p,) of parameters by name."""
        return np.array([np.ravel(parameters[each.parameter])[each.place or 0] for each in self.numbers], dtype=float)

    def parameters(self, values: Array, rest: float = 1.0) -> dict[str, Array]:
        """Gives parameters of the starting arm by name, `rest` times what they are, but for the free numbers (p,)."""
        result = {each.parameter: rest * np.array(self._base[each.parameter], ndmin=1) for each in self.numbers}
        for number, value in zip(self.numbers, values, strict=True):
            result[number.parameter][number.place or 0] = value
        return {name: each if PARAMETERS[name].of != ARM else each[0] for name, each in result.items()}

    def changed(self, values: Array) -> Arm:
        """Gives the arm with free numbers (p,)."""
        return varied_arm(self.arm, self.parameters(values))

    def lanes(self, model: Model, departures: Array) -> dict[str, Array]:
        """Gives parameters (1 + 2 p, ...) of arms beside a model's.

        Args:
            model: of an arm.
            departures: (p,) of the logarithms from those of this arm, of all; each number is once larger by STEP, and
                once smaller.
        """
        count, nominal = 1 + 2 * len(self.numbers), nominal_parameters(model)
        result = {each.parameter: np.array([nominal[each.parameter]] * count) for each in self.numbers}
        for i, number in enumerate(self.numbers):
            own = np.full(count, departures[i])
            own[1 + 2 * i : 3 + 2 * i] += STEP, -STEP
            result[number.parameter][(slice(None), *(() if number.place is None else (number.place,)))] *= np.exp(own)
        return result


def _numbers(name: str, model: Model) -> list[_FreeNumber]:
    """The numbers of a name, such as joint_stiffness or joint_stiffness[1]."""
    kind, _, place = name.partition("[")
    kind = next(iter(rename_old_keys("free", {kind: None})))
    if PARAMETERS[one_of("free", kind, PARAMETERS)].of == ARM:
        if place:
            raise value_error("free", name, kind)
        return [_FreeNumber(kind, None)]
    sprung = kind in ("joint_stiffness", "joint_damping")
    there = np.flatnonzero(model.constants.motor >= 0).tolist() if sprung else list(range(model.n_joints))
    if place:
        if not (place.endswith("]") and is_decimal_integer(place[:-1])):
            raise value_error("free", name, f"{kind}, or {kind}[0] and so on")
        there = [each for each in there if each == whole_number("free", int(place[:-1]), 0, model.n_joints - 1)]
    if not there:
        raise value_error("free", name, "a parameter that this arm has: the joint is rigid")
    return [_FreeNumber(kind, each) for each in there]


ROUGH = 0.1  # of the rms of a signal: its noise, before a first fit knows better
QUIET = 1e-12  # in any unit: the least noise of a signal, beyond which is rounding
LOST = 1e3  # deviations by which an arm that diverges is off
ROUNDS, PATIENCE = 4, 40  # of estimating the noise and building the model, and evaluations in each
SETTLED = 1e-4  # change of the unknowns in a round that is the last
FINE, ROUNDED, HALVINGS = 0.5, 1e-3, 5  # deviations; of a signal, its least noise here; of the step
EDGE = 1e-3  # from a bound, where a search may start
ORDER = 0.7  # damping ratio of a filter that a record may have left out


class ResidualBlock(NamedTuple):
    """An output of a record, or what was measured of the ringing at a posture.

    Attributes:
        record: its number, -1 of ringing.
        name: of the output.
        measured: (m,).
        sigma: (m,) standard deviations that are assumed.
        known: whether they were given.
        gain, offset: numbers of these among the nuisances, or -1.
        corner: of the corner of a filter that is looked for, or -1.
    """

    record: int
    name: str
    measured: Array
    sigma: Array
    known: bool
    gain: int = -1
    offset: int = -1
    corner: int = -1


class LeastSquaresProblem:
    """Residuals of an arm.

    The unknowns are logarithms of the free numbers over their start (p,), then nuisances: gains and offsets of sensors.

    Attributes:
        free: what is free.
        ringing: what is known of frequencies.
        responses: what is known of motions.
        parts: of the data.
        nuisances: their names.
        start: of all unknowns.
    """

    def __init__(
        self,
        free: FreeParameters,
        ringing: list[Ringing],
        responses: list[SimulatedResponse],
        choice: dict[str, Any],
        corner: str = "",
    ) -> None:
        self.free, self.ringing, self.responses, self.choice = free, ringing, responses, choice
        self.nuisances: list[str] = []
        start = [0.0] * len(free.numbers)
        self.parts = [ResidualBlock(-1, "ringing", each.measured, each.deviations, True) for each in ringing]
        for number, response in enumerate(responses):
            data = response.measurement
            for name, values in data.outputs.items():
                measured = values[data.compared]
                places = [-1, -1, -1]
                wanted = (name in data.gains, name in data.offsets, name == corner)
                labels = (f"gain of {name}", f"offset of {name} in record {number}", f"corner of {name}")
                sizes = (1.0, 0.0, np.log(2.0 * np.pi * 0.02 / data.period))
                for i, (label, size) in enumerate(zip(labels, sizes, strict=True)):
                    if wanted[i] and label not in self.nuisances:
                        self.nuisances.append(label)
                        start.append(float(size))
                    places[i] = self.nuisances.index(label) if wanted[i] else -1
                known = name in data.deviations
                size = data.deviations[name] if known else max(ROUGH * float(np.std(measured)), QUIET)
                self.parts.append(ResidualBlock(number, name, measured, np.full(len(measured), size), known, *places))
        self.start = np.array(start)
        self._last: tuple[Array, Array, Array] | None = None
        self._progress = Progress("evaluations of the fit")
        self._anchor, self._model = self.start, self.model(self.start)

    def model(self, x: Array) -> Model:
        """Gives the model of the arm at unknowns x."""
        return build_model(self.free.changed(self.values(x)), **self.choice)

    def values(self, x: Array) -> Array:
        """Gives the free numbers (p,)."""
        return np.asarray(self.free.start * np.exp(x[: len(self.free.start)]))

    def evaluated(self, x: Array) -> tuple[Array, Array]:
        """Gives residuals (m,) in standard deviations, and their slopes (m, u) by the unknowns."""
        if self._last is None or not np.array_equal(self._last[0], x):
            self._last = (x.copy(), *self._evaluate(x))
            self._progress.count()
        return self._last[1], self._last[2]

    def _evaluate(self, x: Array) -> tuple[Array, Array]:
        p, model = len(self.free.numbers), self._model
        lanes = self.free.lanes(model, (x - self._anchor)[:p])
        ringing = [each.computed(model, lanes, STEP) for each in self.ringing]
        signals = [response.signals(model, lanes) for response in self.responses]
        names = [list(response.measurement.outputs) for response in self.responses]
        residuals, rows = [], []
        for number, part in enumerate(self.parts):
            slopes = np.zeros((len(part.measured), len(x)))
            if part.record < 0:
                computed, slopes[:, :p] = ringing[number]
            else:
                computed = self._shown(x, part, signals[part.record][:, names[part.record].index(part.name)], slopes)
            if np.isfinite(computed).all() and np.isfinite(slopes).all():
                residuals.append((computed - part.measured) / part.sigma)
                rows.append(slopes / part.sigma[:, None])
            else:
                residuals.append(np.full(len(part.measured), LOST))
                rows.append(np.zeros_like(slopes))
        return np.concatenate(residuals), np.vstack(rows)

    def _shown(self, x: Array, part: ResidualBlock, signals: Array, slopes: Array) -> Array:
        """What the sensor of a part shows, of signals (1 + 2 p, T); fills the slopes."""
        p, data = len(self.free.numbers), self.responses[part.record].measurement
        if part.corner >= 0:
            corner, h = x[p + part.corner], 0.01
            over = [_low_pass(corner + sign * h).applied(signals[0], data.period) for sign in (1.0, -1.0)]
            signals = _low_pass(corner).applied(signals, data.period)
        signals = signals[:, data.compared]
        gain = x[p + part.gain] if part.gain >= 0 else 1.0
        slopes[:, :p] = gain * (signals[1::2] - signals[2::2]).T / (2.0 * STEP)
        if part.gain >= 0:
            slopes[:, p + part.gain] = signals[0]
        if part.offset >= 0:
            slopes[:, p + part.offset] = 1.0
        if part.corner >= 0:
            slopes[:, p + part.corner] = gain * ((over[0] - over[1]) / (2.0 * h))[data.compared]
        return np.asarray(gain * signals[0] + (x[p + part.offset] if part.offset >= 0 else 0.0))

    def divided(self, rows: Array) -> list[Array]:
        """Gives what belongs to each part."""
        return np.split(rows, np.cumsum([len(part.measured) for part in self.parts])[:-1])

    def solved(self, x: Array) -> Array:
        """Gives the unknowns nearest to the data, from x on: Gauss-Newton in a region of trust (SciPy).

        Noise that is not known is estimated in turn with them, of one name the same in all records. So is the model.
        """
        from scipy.optimize import least_squares

        low, high = np.full(len(x), -np.inf), np.full(len(x), np.inf)
        low[: len(self.free.numbers)], high[: len(self.free.numbers)] = -WIDEST, self.free.highest
        self._drop_anchor(x)
        x = self._geared(x)
        for _ in range(ROUNDS):
            before = x
            found = least_squares(
                lambda y: self.evaluated(y)[0], np.clip(x, low + EDGE, high - EDGE), lambda y: self.evaluated(y)[1],
                (low, high), max_nfev=PATIENCE, xtol=1e-7, ftol=1e-8, gtol=1e-12,
            )  # fmt: skip
            x = found.x
            self._weigh(x)
            self._drop_anchor(x)
            if np.abs(x - before).max() < SETTLED:
                break
        return np.asarray(x)

    def _drop_anchor(self, x: Array) -> None:
        """Builds the model anew: as long as it stays, modes and modal damping do, and slopes are those of residuals."""
        self._anchor, self._model, self._last = x.copy(), self.model(x), None

    def refined(self, x: Array) -> Array:
        """The unknowns by steps of which half would move no number by more than half a deviation.

        The worst that a difference of the signals does is its norm in deviations.
        """
        nominal = nominal_parameters(self.model(x))
        alone = {"payload_mass": np.array([nominal["payload_mass"]])}
        for _ in range(HALVINGS):
            coarse = False
            for number, response in enumerate(self.responses):
                model, parts = self.model(x), [part for part in self.parts if part.record == number]
                before = response.signals(model, alone)[0]
                response.step /= 2.0
                moved = (response.signals(model, alone)[0] - before)[:, response.measurement.compared]
                sizes = [max(part.sigma[0], ROUNDED * float(np.std(part.measured))) for part in parts]
                fine = all(np.linalg.norm(each) < FINE * size for each, size in zip(moved, sizes, strict=True))
                response.step *= 2.0 if fine else 1.0
                coarse = coarse or not fine
            if not coarse:
                break
            self._last = None
            x = self.solved(x)
        return x

    def _geared(self, x: Array) -> Array:
        """The unknowns with the gains and offsets that suit them best, in which residuals are linear."""
        linear = [len(self.free.numbers) + i for i, name in enumerate(self.nuisances) if not name.startswith("corner")]
        result = x.copy()
        if linear:
            residuals, slopes = self.evaluated(x)
            result[linear] -= np.linalg.lstsq(slopes[:, linear], residuals, rcond=None)[0]
        return np.asarray(result)

    def _weigh(self, x: Array) -> None:
        """Takes the noise of each name from its residuals."""
        divided, pooled = self.divided(self.evaluated(x)[0]), {}
        for part in self.parts:
            if not part.known:
                own = [r * p.sigma for r, p in zip(divided, self.parts, strict=True) if p.name == part.name]
                rms = float(np.sqrt(np.mean(np.concatenate(own) ** 2)))
                pooled[part.name] = max(rms, QUIET)
        self.parts = [
            part if part.known else part._replace(sigma=np.full(len(part.measured), pooled[part.name]))
            for part in self.parts
        ]


def _low_pass(corner: float) -> Filter:
    """A filter by the logarithm of its corner, rad/s."""
    return Filter.low_pass(float(np.exp(np.clip(corner, -20.0, 20.0))) / (2.0 * np.pi), ORDER)
