"""Diagnosis of the remaining tip error at the end of an episode: ringing, limit cycle, offset, transient, noise."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from flexman_gym.agent.controller import Controller
from flexman_gym.common.arrays import Array
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.episodes import Episodes
from flexman_gym.evaluation.agent_spec import AgentSpec
from flexman_gym.evaluation.rollouts import Rollout, rollout
from flexman_gym.model.dynamics import damping_matrix
from flexman_gym.model.model import Model
from flexman_gym.simulation.episode import Episode
from flexman_gym.toolbox.controllers.excited_modes import excited_modes

WINDOW = 3.0  # s; default length of the window, the analysed end of an episode
MIN_MODE_PERIODS = 2.0  # periods of the slowest mode; smallest length of the window
MAX_WINDOW_SHARE = 0.5  # fraction of an episode; largest length of the window, if longer than WINDOW
MIN_SAMPLES = 32  # control periods in the window; with fewer no tone is fitted
MAX_TONES = 4  # largest number of fitted tones
MIN_TONE_SHARE = 0.1  # smallest contribution of a tone to the mean square error without offset and drift
MIN_FED_SHARE = 0.5  # smallest energy supplied by the motors in a limit cycle, as a fraction of the dissipated energy
MIN_PERIODIC_SHARE = 0.5  # smallest fraction of the variance of the actions at the tones of the tip; below it is noise
SLOW_FREQUENCY_RATIO = 0.5  # fraction of the lowest frequency of the modes, below which a tone is slow
MIN_CYCLES = 1.9  # cycles in the window; a slow tone with fewer cycles is a transient
MIN_SLOW_TONE_SHARE = 0.5  # smallest contribution to the mean square for which a slow tone lengthens the window
MAX_TRANSIENT_RATIO = 0.25  # RMS of the transient / mean error, above which the mean error is part of the transient
MODE_FREQUENCY_RATIOS = (0.5, 1.2)  # range of frequency of a tone / frequency of its mode; compliant motors lower it
MIN_TONE_CYCLES = 0.75  # cycles of a tone in the window; slower motion is a drift
ZERO_ACTION = 1e-12  # mean square of the actions; smaller actions are regarded as zero
NEGLIGIBLE_RATIO = 0.05  # RMS error / band of settled tips, below which the error needs no remedy
ZERO_PADDING = 8  # length of the zero-padded signal of a spectrum / length of the signal

RINGING, CYCLE, OFFSET, NOISE = "ringing", "limit cycle", "offset", "noise"
TRANSIENT, FAILED = "transient", "failed"
REMEDIES = {
    RINGING: "shape the command (flexman shape), slew more slowly, or damp by feedback of the links (lqr, lqg)",
    CYCLE: "lower the gains or the delay: flexman optimise gains finds gains with margins for the largest delay",
    OFFSET: "add integral action or torques of the true weight, check sensors for a bias, or train a policy longer",
    TRANSIENT: "simulate a longer horizon, or use stiffer and better damped motors (flexman optimise gains)",
    NOISE: "lower the gains, above all those of the rates, or filter the measurements: an observer, or better sensors",
    FAILED: "keep the arm within its limits by slower commands or another controller (flexman replay shows the motion)",
}
TRAINING_REMEDIES = {  # for a trained policy, whose base controller and reward were those of its training
    RINGING: "train on a base controller that damps (base: lqr or lqg), or weigh tip_vibration more (reward)",
    CYCLE: "train with the delay and the friction of the evaluation (randomisation), or on a base with smaller gains",
    OFFSET: 'train longer, with reward="distance", which still changes at errors of millimetres, or on adaptive-lqr',
    TRANSIENT: "train with the horizon of the evaluation, or on a base controller that arrives sooner",
    NOISE: "train with the noise of the evaluation (randomisation) and a history, or on a base with an observer (lqg)",
    FAILED: "train on such starts and goals, or with a larger failure_penalty (flexman replay shows the motion)",
}


SIGNALS = ("errors", "actions", "torques", "rates", "loss")  # arrays of an _EpisodeEnd


class _EpisodeEnd(NamedTuple):
    """Signals of the last T control periods of an episode.

    Attributes:
        errors: (T, 3) position of the tip minus its target at the end of each period, m.
        actions: (T, n) commanded motor torques as fractions of the torque limits.
        torques: (T, n) applied motor torques, N m.
        rates: (T, n) mean motor rates in each period, rad/s.
        loss: (T,) energy dissipated since the start, J.
        period: control period, s.
        band: distance from the target within which a tip counts as settled, m.
        failure: cause of a failure, which terminated the episode; "" without a failure.
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
    """Causes of the remaining tip error of an episode.

    A tone is a sinusoidal component of the error, whose amplitude changes linearly with time.

    Attributes:
        rms: root mean square of the tip error in the window at the end of the episode, m.
        negligible: True if the error is too small for a remedy, compared with the band within which tips count as
            settled.
        shares: cause -> fraction of the mean square error; the fractions sum to 1.
        tones: frequency (Hz), fraction of the mean square error, cause, and name of the mode or "" of each tone, the
            largest tone first.
        failure: cause of a failure, which is then the only cause reported; "" without a failure.
    """

    rms: float
    negligible: bool
    shares: Mapping[str, float]
    tones: tuple[tuple[float, float, str, str], ...]
    failure: str = ""

    @property
    def cause(self) -> str:
        """Cause of the largest fraction of the mean square error."""
        return max(self.shares, key=lambda name: self.shares[name])


def diagnose(
    agent: str | AgentSpec | Controller, environment: str | Configuration, seeds: Sequence[int]
) -> list[Diagnosis]:
    """Diagnose the remaining tip error of one episode for each seed; arguments and errors as in `rollout`.

    In a few seconds slow noise cannot be distinguished from an offset or a slow vibration. With sensor noise, the same
    episodes are therefore simulated a second time without noise.
    """
    found = [_split_error(*each) for each in _episode_ends(agent, environment, seeds)]
    quiet = _without_noise(Configuration.find(environment))
    if quiet is None:
        return found
    return [_attribute_noise(*each) for each in zip(found, diagnose(agent, quiet, seeds), strict=True)]


def _without_noise(environment: Configuration) -> Configuration | None:
    """Return the environment without "sensor_noise"; None for an environment without noise."""
    ranges = dict(environment.randomisation.given) if environment.randomisation else {}
    if not np.any(ranges.get("sensor_noise", 0.0)):
        return None
    return environment.replace(randomisation={**ranges, "sensor_noise": [0.0, 0.0]})


def _attribute_noise(found: Diagnosis, quiet: Diagnosis) -> Diagnosis:
    """Return the diagnosis of an episode in which the additional error with noise is attributed to noise.

    Args:
        found: diagnosis of the episode with noise.
        quiet: diagnosis of the same episode without noise, whose fractions are scaled.
    """
    if found.failure or quiet.failure:
        return found
    rest = min((quiet.rms / found.rms) ** 2, 1.0) if found.rms else 1.0
    shares = {cause: rest * share for cause, share in quiet.shares.items()}
    shares[NOISE] += 1.0 - rest
    tones = [(frequency, rest * share, cause, mode) for frequency, share, cause, mode in quiet.tones]
    tones += [tone for tone in found.tones if tone[2] == NOISE]
    return replace(found, shares=shares, tones=tuple(sorted(tones, key=lambda tone: -tone[1])))


def _episode_ends(
    agent: str | AgentSpec | Controller, environment: str | Configuration, seeds: Sequence[int]
) -> list[tuple[_EpisodeEnd, dict[str, float]]]:
    """Return for each seed the end of an episode, and mode -> frequency (Hz) at the goal posture.

    Arguments and errors as in `rollout`.
    """
    recorder = _EndRecorder()
    result = rollout(agent, environment, seeds, recorder.record)
    return [recorder.episode_end(result, arm) for arm in range(len(result.lengths))]


def _split_error(end: _EpisodeEnd, modes: Mapping[str, float]) -> Diagnosis:
    """Split the mean square of the tip error into offset, transient, tones and noise, with the cause of each tone.

    - The offset is the mean error.
    - A transient is a linear drift, or a tone slower than all modes with fewer than two cycles in the window. If the
      transient is large, the mean error is a part of it, since the motion has not ended.
    - A tone is a sinusoid whose amplitude changes linearly, as in a decaying vibration. Its cause is a limit cycle if
      the actions contain its frequency and the motors supply the dissipated energy. Its cause is noise if the actions
      are large at frequencies other than those of the tones. Otherwise its cause is ringing.
    - The remaining error is noise.
    - For a failed episode the failure is the only cause reported.

    Args:
        end: end of an episode; with fewer than MIN_SAMPLES control periods no tone is fitted.
        modes: name of a mode -> frequency, Hz.
    """
    errors, count = end.errors, len(end.errors)
    rms = float(np.sqrt(_power(errors) / count))
    if end.failure:
        return Diagnosis(rms, False, dict.fromkeys(REMEDIES, 0.0) | {FAILED: 1.0}, (), end.failure)
    parts, frequencies = _fit_tones(errors, end.period)
    coordinates = _project(parts, errors)
    total = max(_power(errors), np.finfo(float).tiny)
    mean, drift = _power(coordinates[0][:1]) / total, _power(coordinates[0][1:]) / total
    shares = np.array([_power(each) for each in coordinates[1:]]) / total
    slow = min(SLOW_FREQUENCY_RATIO * min(modes.values(), default=0.0), MIN_CYCLES / (count * end.period))
    causes = [
        TRANSIENT if frequency < slow else cause
        for frequency, cause in zip(frequencies, _tone_causes(end, parts, shares), strict=True)
    ]
    tones = [
        (frequency, float(share), cause, _nearest_mode(frequency, modes) if cause == RINGING else "")
        for frequency, share, cause in zip(frequencies, shares, causes, strict=True)
    ]
    sums = dict.fromkeys(REMEDIES, 0.0) | {TRANSIENT: drift, NOISE: max(1.0 - mean - drift - float(shares.sum()), 0.0)}
    for _, share, cause, _ in tones:
        sums[cause] += share
    sums[OFFSET if sums[TRANSIENT] <= MAX_TRANSIENT_RATIO**2 * mean else TRANSIENT] += mean
    negligible = rms < NEGLIGIBLE_RATIO * end.band
    return Diagnosis(rms, negligible, sums, tuple(sorted(tones, key=lambda tone: -tone[1])))


def _fit_tones(errors: Array, period: float) -> tuple[list[Array], list[float]]:
    """Return basis functions of mean and drift (T, 2) and of each tone (T, 4), and the frequencies (Hz) of the tones.

    Args:
        errors: (T, 3) m.
        period: sampling period, s.
    """
    count = len(errors)
    parts = [np.stack([np.ones(count), np.linspace(-1.0, 1.0, count)], axis=1)]
    motion = _power(errors) - _power(*_project(parts, errors))
    frequencies: list[float] = []
    for _ in range(MAX_TONES if count >= MIN_SAMPLES else 0):
        frequency = _strongest_frequency(parts, errors, period)
        more = [*parts, _tone(frequency, count, period)]
        if not _power(_project(more, errors)[-1]) > MIN_TONE_SHARE * motion:
            break
        frequencies, parts = [*frequencies, frequency], more
    return parts, frequencies


def _slow_tone_frequency(errors: Array, period: float) -> float:
    """Return the frequency, Hz, of a tone of MIN_CYCLES or more that dominates the errors (T, 3), else infinity."""
    count = len(errors)
    if count < MIN_SAMPLES:
        return np.inf
    mean = [np.ones((count, 1))]
    frequency = _strongest_frequency(mean, errors, period)
    mean_power, tone_power = (_power(each) for each in _project([*mean, _tone(frequency, count, period)], errors))
    periodic = frequency * count * period >= MIN_CYCLES
    return frequency if periodic and tone_power > MIN_SLOW_TONE_SHARE * (_power(errors) - mean_power) else np.inf


def _tone_causes(end: _EpisodeEnd, parts: list[Array], shares: Array) -> list[str]:
    """Return the cause of each tone, ringing, limit cycle or noise, from its basis functions and its share."""
    if not len(shares):
        return []
    actions, torques, rates = (_project(parts, each) for each in (end.actions, end.torques, end.rates))
    commanded = _power(end.actions) - _power(actions[0])
    if commanded > ZERO_ACTION * len(end.actions) and _power(*actions[1:]) < MIN_PERIODIC_SHARE * commanded:
        return [NOISE] * len(shares)
    time = end.period * np.arange(len(end.loss))
    dissipated = float(np.polyfit(time, end.loss, 1)[0]) * len(time)  # W, a sum over the periods as `supplied`
    limits = MIN_FED_SHARE * max(dissipated, 0.0) * shares / max(float(shares.sum()), np.finfo(float).tiny)
    supplied = [float(np.sum(torque * rate)) for torque, rate in zip(torques[1:], rates[1:], strict=True)]
    return [CYCLE if each > limit else RINGING for each, limit in zip(supplied, limits.tolist(), strict=True)]


def _strongest_frequency(parts: list[Array], errors: Array, period: float) -> float:
    """Return the frequency, Hz, of the strongest tone in the part of errors (T, 3) orthogonal to basis functions."""
    from scipy.optimize import minimize_scalar

    count, width = len(errors), 1.0 / (len(errors) * period)
    basis = np.linalg.qr(np.hstack(parts))[0]
    window = np.sin(np.pi * (np.arange(count) + 0.5) / count)[:, None] ** 2
    remainder = window * (errors - basis @ (basis.T @ errors))
    power = np.sum(np.abs(np.fft.rfft(remainder, ZERO_PADDING * count, axis=0)) ** 2, axis=1)
    grid = np.fft.rfftfreq(ZERO_PADDING * count, period)
    power[grid < MIN_TONE_CYCLES * width] = 0.0
    best = grid[power.argmax()]

    def negative_power(frequency: float) -> float:
        return -_power(_project([*parts, _tone(frequency, count, period)], errors)[-1])

    bounds = (best - 0.25 * width, min(best + 0.25 * width, 0.5 / period))
    return float(minimize_scalar(negative_power, bounds=bounds, method="bounded").x)


def _tone(frequency: float, count: int, period: float) -> Array:
    """Return the basis functions (count, 4) of a tone: cosine and sine, without and with a factor linear in time."""
    phase, ramp = 2.0 * np.pi * frequency * period * np.arange(count), np.linspace(-1.0, 1.0, count)
    return np.stack([np.cos(phase), np.sin(phase), ramp * np.cos(phase), ramp * np.sin(phase)], axis=1)


def _project(parts: list[Array], values: Array) -> list[Array]:
    """Return the coordinates of values (T, k) in an orthonormal basis of the parts (T, m), one array for each part."""
    basis = np.linalg.qr(np.hstack(parts))[0]
    return np.split(basis.T @ values, np.cumsum([part.shape[1] for part in parts])[:-1])


def _power(*values: Array) -> float:
    """Return the sum of the squares of all values."""
    return float(sum(np.sum(each**2) for each in values))


def _nearest_mode(frequency: float, modes: Mapping[str, float]) -> str:
    """Return the name of the mode nearest to a frequency, Hz; "" if no mode is within MODE_FREQUENCY_RATIOS."""
    low, high = MODE_FREQUENCY_RATIOS
    near = {name: mode for name, mode in modes.items() if low <= frequency / mode <= high}
    return min(near, key=lambda name: abs(np.log(near[name] / frequency)), default="")


class _EndRecorder:
    """Recorder of targets, motor angles, torques and dissipated energy in each control period."""

    def __init__(self) -> None:
        self._rows: list[tuple[Array, ...]] = []

    def record(self, episodes: Episodes) -> None:
        """Record a control period."""
        view, rows = episodes.view, episodes.batch.rows
        if not self._rows:
            self._model, self._goals = episodes.batch.model, view.goal_angles.copy()
        now = (view.target, view.motor_angles, episodes.motors.torques, rows[:, -1])
        self._rows.append(tuple(each.copy() for each in now))

    def episode_end(self, result: Rollout, arm: int) -> tuple[_EpisodeEnd, dict[str, float]]:
        """Return the end of the episode of an arm, and mode -> frequency (Hz) at its goal posture."""
        length = int(result.lengths[arm])
        targets, motors, torques, loss = (np.array([row[i][arm] for row in self._rows[: length + 1]]) for i in range(4))
        errors, rates = result.tips[arm, : length + 1] - targets, np.diff(motors, axis=0) / result.period
        signals = errors[1:], result.actions[arm, :length], torques[1:], rates, loss[1:]
        whole = _EpisodeEnd(*signals, result.period, result.band, result.failures[arm])
        return _last_part(whole, self._model, self._goals[arm])


def diagnose_log(episode: Episode) -> Diagnosis:
    """Diagnose the remaining tip error of a saved episode, such as a log of `flexman drive`.

    The dissipated energy is that of the damping of the model, without Coulomb friction.

    Args:
        episode: episode with targets, at least one control period long.
    """
    model, period = episode.model, episode.period
    motors, speeds = episode.states[:, model.motor_columns], episode.states[1:, model.n_dof :]
    loss = period * np.cumsum(np.sum(speeds @ damping_matrix(model) * speeds, axis=1))
    signals = (episode.tips - episode.targets)[1:], episode.actions, episode.torques, np.diff(motors, axis=0) / period
    whole = _EpisodeEnd(*signals, loss, period, episode.band, episode.about.get("failure", ""))
    return _split_error(*_last_part(whole, model, motors[-1]))


def _last_part(whole: _EpisodeEnd, model: Model, goal: Array) -> tuple[_EpisodeEnd, dict[str, float]]:
    """Return the window at the end of a whole episode, and mode -> frequency (Hz) at its goal posture (n,), rad."""
    modes = {
        f"mode {number + 1}, motors {'held' if held else 'free'}": float(frequency)
        for held in (True, False)
        for number, frequency in enumerate(excited_modes(model, goal, held)[:, 0])
    }
    length, period = len(whole.errors), whole.period
    longest = max(MAX_WINDOW_SHARE * length * period, WINDOW)
    slowest = min(*modes.values(), _slow_tone_frequency(whole.errors[-round(longest / period) :], period), np.inf)
    window = min(max(WINDOW, MIN_MODE_PERIODS / slowest), longest)
    first = max(length - round(window / period), 0)
    return whole._replace(**{name: getattr(whole, name)[first:] for name in SIGNALS}), modes
