"""Diagnosis: why a tip is not still on its target after arrival, in shares of what is left of its error."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.control.controller import Controller
from flexman_gym.control.modes import ringing_modes
from flexman_gym.envs.description import Description
from flexman_gym.envs.episodes import Episodes
from flexman_gym.evaluation.entrants import Entrant
from flexman_gym.evaluation.rollout import Rollout, rollout

WINDOW, PERIODS = (
    3.0,
    2.0,
)  # s at the end that are looked at, or so many periods of the slowest mode where that is longer
MOST_WINDOW = 0.5  # of an episode
LEAST = 32  # samples
TONES = 4  # that are looked for
TONE = 0.1  # of what is left beside the offset, that a tone must explain to be one
FED = 0.5  # of the energy that the arm dissipates, from which on the motors keep its motion up
PERIODIC = 0.5  # of the variance of actions, that lies in the tones of the tip where a controller answers these alone
SLOW = 0.5  # of the slowest mode: a slower tone is an arm that has not arrived, and belongs to the offset
NEAR = (0.5, 1.2)  # parts of a mode's frequency, between which a tone is named after it: motors that yield lower it
SLOWEST = 0.75  # cycles of a tone in the window; less is a drift
STILL = 1e-12  # mean square of actions, below which nothing acts
QUIET = 0.05  # of the band of settled tips
FINER = 8  # places of the spectrum for each that the window tells apart

RINGING, CYCLE, OFFSET, NOISE = "ringing", "limit cycle", "offset", "noise"
HELP = {
    RINGING: "shape the command (flexman resonance), slew more slowly, or damp by feedback of the links (lqr, lqg)",
    CYCLE: "lower the gains or the delay: flexman tune finds gains with margins for the delay of the environment",
    OFFSET: "add integral action or the torques that hold the true weight, look for a bias of sensors, or give it time",
    NOISE: "lower the gains, of the rates before all, or filter what they act on: an observer, or better sensors",
}


class Ending(NamedTuple):
    """The end of an episode, T control periods.

    Attributes:
        errors: (T, 3) m, tip less target, at the ends of the periods.
        actions: (T, n) what the motors were asked for, parts of the torque limits.
        torques: (T, n) N m, that acted.
        rates: (T, n) rad/s, of the motors, in the mean of each period.
        loss: (T,) J, dissipated since the start.
        period: s.
        band: m around the target, in which a tip has settled.
    """

    errors: Array
    actions: Array
    torques: Array
    rates: Array
    loss: Array
    period: float
    band: float


@dataclass(frozen=True)
class Diagnosis:
    """What is left of the error of an episode.

    Attributes:
        rms: m, of the error in the window.
        quiet: whether that is so small a part of the band of settled tips that nothing has to help.
        shares: cause -> part of its mean square; they sum to 1.
        tones: ((frequency in Hz, share, cause, name of the mode or ""), ...), the largest first.
    """

    rms: float
    quiet: bool
    shares: Mapping[str, float]
    tones: tuple[tuple[float, float, str, str], ...]

    @property
    def cause(self) -> str:
        """The cause with the largest share."""
        return max(self.shares, key=lambda name: self.shares[name])


def diagnose(
    entrant: str | Entrant | Controller, environment: str | Description, seeds: Sequence[int]
) -> list[Diagnosis]:
    """Says for an episode from each seed what keeps its tip from being still on its target.

    Arguments and errors are those of `rollout`.
    """
    return [split(*each) for each in endings(entrant, environment, seeds)]


def endings(
    entrant: str | Entrant | Controller, environment: str | Description, seeds: Sequence[int]
) -> list[tuple[Ending, dict[str, float]]]:
    """Gives the end of an episode from each seed, and the frequencies (Hz) of the modes at its goal by their names.

    Arguments and errors are those of `rollout`.
    """
    watched = _Watched()
    result = rollout(entrant, environment, seeds, watched.see)
    return [watched.ending(result, arm) for arm in range(len(result.lengths))]


def split(ending: Ending, modes: Mapping[str, float]) -> Diagnosis:
    """Splits the mean square of an error into offset, tones and noise, and says of tones what keeps them up.

    The offset is the mean with an even drift and what is slower than any mode. A tone is a sinusoid whose size changes
    evenly, as that of ringing does while it dies away. What no tone explains is noise. A tone is noise too where
    actions go in no rhythm of the tones; it is a limit cycle where they do, and the motors feed what the arm
    dissipates; else it rings of itself.

    Args:
        ending: of an episode; one of fewer than LEAST periods has no tones.
        modes: frequency (Hz) of each mode, by its name.
    """
    errors, count = ending.errors, len(ending.errors)
    parts = [np.stack([np.ones(count), np.linspace(-1.0, 1.0, count)], axis=1)]
    swing = _power(errors) - _power(*_projected(parts, errors))
    frequencies: list[float] = []
    for _ in range(TONES if count >= LEAST else 0):
        frequency = _strongest(parts, errors, ending.period)
        more = [*parts, _tone(frequency, count, ending.period)]
        if not _power(_projected(more, errors)[-1]) > TONE * swing:
            break
        frequencies, parts = [*frequencies, frequency], more
    powers = np.array([_power(part) for part in _projected(parts, errors)])
    shares = powers / max(_power(errors), np.finfo(float).tiny)
    causes = _causes(ending, parts, shares[1:])
    slow = SLOW * min(modes.values(), default=0.0)
    causes = [OFFSET if each < slow else cause for each, cause in zip(frequencies, causes, strict=True)]
    tones = [
        (frequency, float(share), cause, _named(frequency, modes) if cause == RINGING else "")
        for frequency, share, cause in zip(frequencies, shares[1:], causes, strict=True)
    ]
    sums = dict.fromkeys(HELP, 0.0) | {OFFSET: float(shares[0]), NOISE: max(1.0 - float(shares.sum()), 0.0)}
    for _, share, cause, _ in tones:
        sums[cause] += share
    rms = float(np.sqrt(_power(errors) / count))
    return Diagnosis(rms, rms < QUIET * ending.band, sums, tuple(sorted(tones, key=lambda tone: -tone[1])))


def _causes(ending: Ending, parts: list[Array], shares: Array) -> list[str]:
    """What keeps up each tone."""
    if not len(shares):
        return []
    actions, torques, rates = (_projected(parts, each) for each in (ending.actions, ending.torques, ending.rates))
    asked = _power(ending.actions) - _power(actions[0])
    if asked > STILL * len(ending.actions) and _power(*actions[1:]) < PERIODIC * asked:
        return [NOISE] * len(shares)
    time = ending.period * np.arange(len(ending.loss))
    lost = float(np.polyfit(time, ending.loss, 1)[0]) * len(time)
    limits = FED * max(lost, 0.0) * shares / max(float(shares.sum()), np.finfo(float).tiny)
    fed = [float(np.sum(torque * rate)) for torque, rate in zip(torques[1:], rates[1:], strict=True)]
    return [CYCLE if each > limit else RINGING for each, limit in zip(fed, limits.tolist(), strict=True)]


def _strongest(parts: list[Array], errors: Array, period: float) -> float:
    """The frequency (Hz) of the tone that explains most of what parts leave of errors (T, 3)."""
    from scipy.optimize import minimize_scalar

    count, width = len(errors), 1.0 / (len(errors) * period)
    basis = np.linalg.qr(np.hstack(parts))[0]
    window = np.sin(np.pi * (np.arange(count) + 0.5) / count)[:, None] ** 2
    left = window * (errors - basis @ (basis.T @ errors))
    power = np.sum(np.abs(np.fft.rfft(left, FINER * count, axis=0)) ** 2, axis=1)
    grid = np.fft.rfftfreq(FINER * count, period)
    power[grid < SLOWEST * width] = 0.0  # slower is a drift
    best = grid[power.argmax()]

    def unexplained(frequency: float) -> float:
        return -_power(_projected([*parts, _tone(frequency, count, period)], errors)[-1])

    bounds = (best - 0.25 * width, min(best + 0.25 * width, 0.5 / period))
    return float(minimize_scalar(unexplained, bounds=bounds, method="bounded").x)


def _tone(frequency: float, count: int, period: float) -> Array:
    """Cosine and sine, and both times a line, (count, 4)."""
    phase, line = 2.0 * np.pi * frequency * period * np.arange(count), np.linspace(-1.0, 1.0, count)
    return np.stack([np.cos(phase), np.sin(phase), line * np.cos(phase), line * np.sin(phase)], axis=1)


def _projected(parts: list[Array], values: Array) -> list[Array]:
    """Coordinates of values (T, k) along each of the parts (T, m), which are made orthogonal one after the other."""
    basis = np.linalg.qr(np.hstack(parts))[0]
    return np.split(basis.T @ values, np.cumsum([part.shape[1] for part in parts])[:-1])


def _power(*values: Array) -> float:
    return float(sum(np.sum(each**2) for each in values))


def _named(frequency: float, modes: Mapping[str, float]) -> str:
    """The mode whose frequency is nearest, "" where none is near."""
    near = {name: mode for name, mode in modes.items() if NEAR[0] <= frequency / mode <= NEAR[1]}
    return min(near, key=lambda name: abs(np.log(near[name] / frequency)), default="")


class _Watched:
    """What of an environment a Record does not have: targets, goals, torques, motors and losses, period by period."""

    def __init__(self) -> None:
        self._rows: list[tuple[Array, ...]] = []

    def see(self, episodes: Episodes) -> None:
        """Keeps a period."""
        view, rows = episodes.view, episodes.batch.rows
        if not self._rows:
            self._model, self._goals = episodes.batch.model, view.goal_angles.copy()
        now = (view.target, view.motor_angles, episodes.motors.torques, rows[:, -1])
        self._rows.append(tuple(each.copy() for each in now))

    def ending(self, result: Rollout, arm: int) -> tuple[Ending, dict[str, float]]:
        """The end of an arm's episode, and the frequencies of the modes at its goal."""
        modes = {
            f"mode {number + 1}, motors {'held' if held else 'free'}": float(frequency)
            for held in (True, False)
            for number, frequency in enumerate(ringing_modes(self._model, self._goals[arm], held)[:, 0])
        }
        length, period = int(result.lengths[arm]), result.period
        longest = max(MOST_WINDOW * length * period, WINDOW)
        wanted = min(max(WINDOW, PERIODS / min(modes.values(), default=np.inf)), longest)
        first = max(length - round(wanted / period), 0)
        kept = (np.array([row[i][arm] for row in self._rows[first : length + 1]]) for i in range(4))
        targets, motors, torques, loss = kept
        errors, rates = result.tips[arm, first + 1 : length + 1] - targets[1:], np.diff(motors, axis=0) / period
        return Ending(
            errors, result.actions[arm, first:length], torques[1:], rates, loss[1:], period, result.band
        ), modes
