"""Diagnosis of the tip error after arrival: shares of ringing, limit cycle, offset, transient and noise."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.control.controller import Controller
from flexman_gym.control.input_shaping.shapers import excited_modes
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.episodes import Episodes
from flexman_gym.evaluation.agent import AgentSpec
from flexman_gym.evaluation.rollout import Rollout, find_environment, rollout

WINDOW, MIN_MODE_PERIODS = (
    3.0,
    2.0,
)  # s at the end that are looked at, or so many periods of the slowest mode where that is longer
MAX_WINDOW_SHARE = 0.5  # of an episode
MIN_SAMPLES = 32  # samples
MAX_TONES = 4  # that are looked for
MIN_TONE_SHARE = 0.1  # of what is left beside the offset, that a tone must explain to be one
MIN_FED_SHARE = 0.5  # of the energy that the arm dissipates, from which on the motors keep its motion up
MIN_PERIODIC_SHARE = (
    0.5  # of the variance of actions, that lies in the tones of the tip where a controller answers these alone
)
SLOW_FREQUENCY_RATIO = (
    0.5  # part of the slowest mode's frequency; a slower tone with fewer than CYCLES cycles is a transient
)
MIN_CYCLES = 1.9  # cycles in the window, from which on a slow tone is a vibration
MIN_SLOW_TONE_SHARE = (
    0.5  # part of the motion in the second half of the episode that a slow tone explains to lengthen the window
)
MAX_TRANSIENT_RATIO = (
    0.25  # RMS of the slow motion about the mean, as a part of the mean; with more the mean is no offset
)
MODE_FREQUENCY_RATIOS = (
    0.5,
    1.2,
)  # parts of a mode's frequency, between which a tone is named after it: motors that yield lower it
MIN_TONE_CYCLES = 0.75  # cycles of a tone in the window; less is a drift
ZERO_ACTION = 1e-12  # mean square of actions, below which nothing acts
NEGLIGIBLE_RATIO = 0.05  # of the band of settled tips
ZERO_PADDING = 8  # places of the spectrum for each that the window tells apart

RINGING, CYCLE, OFFSET, NOISE = "ringing", "limit cycle", "offset", "noise"
TRANSIENT, FAILED = "transient", "failed"
REMEDIES = {
    RINGING: "shape the command (flexman resonance), slew more slowly, or damp by feedback of the links (lqr, lqg)",
    CYCLE: "lower the gains or the delay: flexman tune finds gains with margins for the delay of the environment",
    OFFSET: "add integral action or the torques that hold the true weight, or look for a bias of sensors",
    TRANSIENT: "give it a longer horizon, which shows what stays, or stiffer and better damped motors (flexman tune)",
    NOISE: "lower the gains, of the rates before all, or filter what they act on: an observer, or better sensors",
    FAILED: "keep the arm within its limits: slower commands, or a controller that holds it (flexman replay shows how)",
}


class EpisodeEnd(NamedTuple):
    """The end of an episode, T control periods.

    Attributes:
        errors: (T, 3) m, tip less target, at the ends of the periods.
        actions: (T, n) what the motors were asked for, parts of the torque limits.
        torques: (T, n) N m, that acted.
        rates: (T, n) rad/s, of the motors, in the mean of each period.
        loss: (T,) J, dissipated since the start.
        period: s.
        band: m around the target, in which a tip has settled.
        failure: "" or what ended the episode.
    """

    errors: Array
    actions: Array
    torques: Array
    rates: Array
    loss: Array
    period: float
    band: float
    failure: str = ""


@dataclass(frozen=True)
class Diagnosis:
    """What is left of the error of an episode.

    Attributes:
        rms: m, of the error in the window.
        quiet: whether that is so small a part of the band of settled tips that nothing has to help.
        shares: cause -> part of its mean square; they sum to 1.
        tones: ((frequency in Hz, share, cause, name of the mode or ""), ...), the largest first.
        failure: "" or what ended the episode, which is then the whole cause.
    """

    rms: float
    quiet: bool
    shares: Mapping[str, float]
    tones: tuple[tuple[float, float, str, str], ...]
    failure: str = ""

    @property
    def cause(self) -> str:
        """The cause with the largest share."""
        return max(self.shares, key=lambda name: self.shares[name])


def diagnose(
    entrant: str | AgentSpec | Controller, environment: str | Configuration, seeds: Sequence[int]
) -> list[Diagnosis]:
    """Diagnose for an episode from each seed what keeps its tip from resting on its target.

    The noise of sensors is told from the other causes by a second run of the same episodes without it: slow noise
    looks like an offset or a sway in a record of a few seconds. Arguments and errors are those of `rollout`.
    """
    found = [split_error(*each) for each in episode_ends(entrant, environment, seeds)]
    quiet = _without_noise(find_environment(environment))
    if quiet is None:
        return found
    return [_attribute_noise(*each) for each in zip(found, diagnose(entrant, quiet, seeds), strict=True)]


def _without_noise(environment: Configuration) -> Configuration | None:
    """Return the environment with "sensor_noise" 0, None where it is 0 already."""
    own = environment.randomisation
    drawn = dict(own.given) if own else {}
    if not np.any(drawn.get("sensor_noise", 0.0)):
        return None
    quiet = {**drawn, "sensor_noise": [0.0, 0.0]}
    return environment.replace(randomisation=quiet)


def _attribute_noise(found: Diagnosis, quiet: Diagnosis) -> Diagnosis:
    """Attribute to noise what an episode has more of than the same episode without noise, and scale the other causes.

    Args:
        found: of the episode with noise.
        quiet: of the episode without it.
    """
    if found.failure or quiet.failure:
        return found
    rest = min((quiet.rms / found.rms) ** 2, 1.0) if found.rms else 1.0
    shares = {cause: rest * share for cause, share in quiet.shares.items()}
    shares[NOISE] += 1.0 - rest
    tones = [(frequency, rest * share, cause, mode) for frequency, share, cause, mode in quiet.tones]
    tones += [tone for tone in found.tones if tone[2] == NOISE]
    return replace(found, shares=shares, tones=tuple(sorted(tones, key=lambda tone: -tone[1])))


def episode_ends(
    entrant: str | AgentSpec | Controller, environment: str | Configuration, seeds: Sequence[int]
) -> list[tuple[EpisodeEnd, dict[str, float]]]:
    """Gives the end of an episode from each seed, and the frequencies (Hz) of the modes at its goal by their names.

    Arguments and errors are those of `rollout`.
    """
    watched = _EndRecorder()
    result = rollout(entrant, environment, seeds, watched.see)
    return [watched.ending(result, arm) for arm in range(len(result.lengths))]


def split_error(ending: EpisodeEnd, modes: Mapping[str, float]) -> Diagnosis:
    """Split the mean square of an error into offset, transient, tones and noise, with the cause of each tone.

    The offset is the mean. A transient is an even drift, and a tone slower than any mode of which the record does not
    hold two cycles; where it is large beside the mean, the mean is a part of it, since the motion has not ended. A tone
    is a sinusoid whose size changes evenly, as that of ringing does while it dies away. What no tone explains is noise.
    A tone is noise too where actions go in no rhythm of the tones; it is a limit cycle where they do, and the motors
    feed what the arm dissipates; else it rings of itself. A failed episode has this one cause.

    Args:
        ending: of an episode; one of fewer than LEAST periods has no tones.
        modes: frequency (Hz) of each mode, by its name.
    """
    errors, count = ending.errors, len(ending.errors)
    rms = float(np.sqrt(_power(errors) / count))
    if ending.failure:
        return Diagnosis(rms, False, dict.fromkeys(REMEDIES, 0.0) | {FAILED: 1.0}, (), ending.failure)
    parts, frequencies = _fit_tones(errors, ending.period)
    coordinates = _project(parts, errors)
    whole = max(_power(errors), np.finfo(float).tiny)
    mean, drift = _power(coordinates[0][:1]) / whole, _power(coordinates[0][1:]) / whole
    shares = np.array([_power(each) for each in coordinates[1:]]) / whole
    slow = min(SLOW_FREQUENCY_RATIO * min(modes.values(), default=0.0), MIN_CYCLES / (count * ending.period))
    causes = [
        TRANSIENT if frequency < slow else cause
        for frequency, cause in zip(frequencies, _tone_causes(ending, parts, shares), strict=True)
    ]
    tones = [
        (frequency, float(share), cause, _nearest_mode(frequency, modes) if cause == RINGING else "")
        for frequency, share, cause in zip(frequencies, shares, causes, strict=True)
    ]
    sums = dict.fromkeys(REMEDIES, 0.0) | {TRANSIENT: drift, NOISE: max(1.0 - mean - drift - float(shares.sum()), 0.0)}
    for _, share, cause, _ in tones:
        sums[cause] += share
    sums[OFFSET if sums[TRANSIENT] <= MAX_TRANSIENT_RATIO**2 * mean else TRANSIENT] += mean
    return Diagnosis(rms, rms < NEGLIGIBLE_RATIO * ending.band, sums, tuple(sorted(tones, key=lambda tone: -tone[1])))


def _fit_tones(errors: Array, period: float) -> tuple[list[Array], list[float]]:
    """Mean and drift (T, 2) and the tones (T, 4) of errors (T, 3), and the frequencies (Hz) of the tones."""
    count = len(errors)
    parts = [np.stack([np.ones(count), np.linspace(-1.0, 1.0, count)], axis=1)]
    swing = _power(errors) - _power(*_project(parts, errors))
    frequencies: list[float] = []
    for _ in range(MAX_TONES if count >= MIN_SAMPLES else 0):
        frequency = _strongest_frequency(parts, errors, period)
        more = [*parts, _tone(frequency, count, period)]
        if not _power(_project(more, errors)[-1]) > MIN_TONE_SHARE * swing:
            break
        frequencies, parts = [*frequencies, frequency], more
    return parts, frequencies


def _slow_tone_frequency(errors: Array, period: float) -> float:
    """The frequency (Hz) of a tone with two cycles in errors (T, 3) that explains most of their motion, else inf."""
    count = len(errors)
    if count < MIN_SAMPLES:
        return np.inf
    level = [np.ones((count, 1))]
    frequency = _strongest_frequency(level, errors, period)
    level_power, tone_power = (_power(each) for each in _project([*level, _tone(frequency, count, period)], errors))
    long = frequency * count * period >= MIN_CYCLES
    return frequency if long and tone_power > MIN_SLOW_TONE_SHARE * (_power(errors) - level_power) else np.inf


def _tone_causes(ending: EpisodeEnd, parts: list[Array], shares: Array) -> list[str]:
    """What keeps up each tone."""
    if not len(shares):
        return []
    actions, torques, rates = (_project(parts, each) for each in (ending.actions, ending.torques, ending.rates))
    asked = _power(ending.actions) - _power(actions[0])
    if asked > ZERO_ACTION * len(ending.actions) and _power(*actions[1:]) < MIN_PERIODIC_SHARE * asked:
        return [NOISE] * len(shares)
    time = ending.period * np.arange(len(ending.loss))
    lost = float(np.polyfit(time, ending.loss, 1)[0]) * len(time)
    limits = MIN_FED_SHARE * max(lost, 0.0) * shares / max(float(shares.sum()), np.finfo(float).tiny)
    fed = [float(np.sum(torque * rate)) for torque, rate in zip(torques[1:], rates[1:], strict=True)]
    return [CYCLE if each > limit else RINGING for each, limit in zip(fed, limits.tolist(), strict=True)]


def _strongest_frequency(parts: list[Array], errors: Array, period: float) -> float:
    """The frequency (Hz) of the tone that explains most of what parts leave of errors (T, 3)."""
    from scipy.optimize import minimize_scalar

    count, width = len(errors), 1.0 / (len(errors) * period)
    basis = np.linalg.qr(np.hstack(parts))[0]
    window = np.sin(np.pi * (np.arange(count) + 0.5) / count)[:, None] ** 2
    left = window * (errors - basis @ (basis.T @ errors))
    power = np.sum(np.abs(np.fft.rfft(left, ZERO_PADDING * count, axis=0)) ** 2, axis=1)
    grid = np.fft.rfftfreq(ZERO_PADDING * count, period)
    power[grid < MIN_TONE_CYCLES * width] = 0.0  # slower is a drift
    best = grid[power.argmax()]

    def unexplained(frequency: float) -> float:
        return -_power(_project([*parts, _tone(frequency, count, period)], errors)[-1])

    bounds = (best - 0.25 * width, min(best + 0.25 * width, 0.5 / period))
    return float(minimize_scalar(unexplained, bounds=bounds, method="bounded").x)


def _tone(frequency: float, count: int, period: float) -> Array:
    """Cosine and sine, and both times a line, (count, 4)."""
    phase, line = 2.0 * np.pi * frequency * period * np.arange(count), np.linspace(-1.0, 1.0, count)
    return np.stack([np.cos(phase), np.sin(phase), line * np.cos(phase), line * np.sin(phase)], axis=1)


def _project(parts: list[Array], values: Array) -> list[Array]:
    """Coordinates of values (T, k) along each of the parts (T, m), which are made orthogonal one after the other."""
    basis = np.linalg.qr(np.hstack(parts))[0]
    return np.split(basis.T @ values, np.cumsum([part.shape[1] for part in parts])[:-1])


def _power(*values: Array) -> float:
    return float(sum(np.sum(each**2) for each in values))


def _nearest_mode(frequency: float, modes: Mapping[str, float]) -> str:
    """The mode whose frequency is nearest, "" where none is near."""
    near = {
        name: mode
        for name, mode in modes.items()
        if MODE_FREQUENCY_RATIOS[0] <= frequency / mode <= MODE_FREQUENCY_RATIOS[1]
    }
    return min(near, key=lambda name: abs(np.log(near[name] / frequency)), default="")


class _EndRecorder:
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

    def ending(self, result: Rollout, arm: int) -> tuple[EpisodeEnd, dict[str, float]]:
        """The end of an arm's episode, and the frequencies of the modes at its goal."""
        modes = {
            f"mode {number + 1}, motors {'held' if held else 'free'}": float(frequency)
            for held in (True, False)
            for number, frequency in enumerate(excited_modes(self._model, self._goals[arm], held)[:, 0])
        }
        length, period = int(result.lengths[arm]), result.period
        longest = max(MAX_WINDOW_SHARE * length * period, WINDOW)
        errors = result.tips[arm, 1 : length + 1] - np.array([row[0][arm] for row in self._rows[1 : length + 1]])
        slowest = min(*modes.values(), _slow_tone_frequency(errors[-round(longest / period) :], period), np.inf)
        wanted = min(max(WINDOW, MIN_MODE_PERIODS / slowest), longest)
        first = max(length - round(wanted / period), 0)
        kept = (np.array([row[i][arm] for row in self._rows[first : length + 1]]) for i in range(4))
        _, motors, torques, loss = kept
        rates, actions = np.diff(motors, axis=0) / period, result.actions[arm, first:length]
        told = (period, result.band, result.failures[arm])
        return EpisodeEnd(errors[first:], actions, torques[1:], rates, loss[1:], *told), modes
