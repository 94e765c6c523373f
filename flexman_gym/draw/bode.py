"""Bode: gain and phase of a loop over frequency, with its margins."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from flexman_gym.arrays import Array
from flexman_gym.draw.style import DARK, LIGHT, LINK_COLOURS, MIDDLE, new_figure

Response = NDArray[np.complex128]


class Crossings(NamedTuple):
    """Where a response comes nearest to -1 along the axes of its diagram; nan where it does not cross.

    Attributes:
        gain: factor > 1 by which the loop may grow until its phase is -180 degrees at a gain of 1.
        gain_frequency: of that, Hz.
        phase: degrees that are left to -180 where the gain is 1, the least of them.
        phase_frequency: of that, Hz.
    """

    gain: float
    gain_frequency: float
    phase: float
    phase_frequency: float


def crossings(frequencies: Array, response: Response) -> Crossings:
    """Gives the margins of a response (f,) at frequencies (f,) in Hz, linear between them."""
    gain, gain_frequency, phase, phase_frequency = np.nan, np.nan, np.nan, np.nan
    for i in np.flatnonzero(np.diff(np.sign(response.imag)) != 0):
        part = response.imag[i] / (response.imag[i] - response.imag[i + 1])
        real = response.real[i] + part * (response.real[i + 1] - response.real[i])
        if -1.0 < real < 0.0 and not -1.0 / real >= gain:
            gain, gain_frequency = -1.0 / real, frequencies[i] + part * (frequencies[i + 1] - frequencies[i])
    size = np.abs(response) - 1.0
    for i in np.flatnonzero(np.diff(np.sign(size)) != 0):
        part = size[i] / (size[i] - size[i + 1])
        left = abs(180.0 - abs(np.degrees(np.angle(response[i] + part * (response[i + 1] - response[i])))))
        if not left >= phase:
            phase, phase_frequency = left, frequencies[i] + part * (frequencies[i + 1] - frequencies[i])
    return Crossings(*map(float, (gain, gain_frequency, phase, phase_frequency)))


def bode_diagram(frequencies: Array, responses: dict[str, Response], path: str | Path, title: str = "") -> Path:
    """Draws gain and phase of loops, and marks their margins.

    Args:
        frequencies: (f,) Hz, ascending.
        responses: name of a loop -> (f,).
        path: of the picture.
        title: of the picture.

    Raises:
        ImportError: without Matplotlib.
    """
    path, figure = Path(path), new_figure((7.6, 6.0), 120.0, layout="constrained")
    gain, phase = figure.subplots(2, 1, sharex=True)
    for (name, response), colour in zip(responses.items(), LINK_COLOURS, strict=False):
        found, size = crossings(frequencies, response), np.abs(response)
        angle = np.degrees(np.unwrap(np.angle(response)))
        said = f"{name}: gain margin {found.gain:.3g}, phase margin {found.phase:.3g}°".replace("nan°", "none")
        gain.loglog(frequencies, size, color=colour, label=said.replace("nan", "none"))
        phase.semilogx(frequencies, angle, color=colour)
        for axes, place, values in ((gain, found.gain_frequency, size), (phase, found.phase_frequency, angle)):
            if np.isfinite(place):
                axes.plot(place, np.interp(place, frequencies, values), "o", color=colour, markersize=5)
    gain.axhline(1.0, color=MIDDLE, linewidth=0.9)
    low, high = phase.get_ylim()
    for turn in np.arange(np.floor(low / 360.0), np.ceil(high / 360.0) + 1.0):
        if low < 360.0 * turn - 180.0 < high:
            phase.axhline(360.0 * turn - 180.0, color=MIDDLE, linewidth=0.9)
    gain.set(ylabel="gain")
    phase.set(ylabel="phase (degrees)", xlabel="frequency (Hz)", xlim=(frequencies[0], frequencies[-1]))
    for axes in (gain, phase):
        axes.grid(color=LIGHT, linewidth=0.6)
        axes.spines[["top", "right"]].set_visible(False)
    gain.set_title(title, fontsize=11, color=DARK)
    figure.legend(*gain.get_legend_handles_labels(), loc="outside lower center", frameon=False, fontsize=9)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    return path
