"""Frequency diagrams: mode shapes, frequencies over the workspace, Campbell diagram, Bode diagram."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.arrays import Array, Vector
from flexman_gym.common.checks import value_error, vector, whole_number
from flexman_gym.draw.frames import POINTS, FramePainter, grid
from flexman_gym.draw.overlay import write_title
from flexman_gym.draw.style import DARK, LIGHT, LINK_COLOURS, MIDDLE, new_figure
from flexman_gym.model.deformation import curves
from flexman_gym.model.dynamics import frequencies
from flexman_gym.model.model import Model, check_model
from flexman_gym.model.statics import rest_state
from flexman_gym.model.vibration import modes, spin_frequencies

AMPLITUDE = 0.08  # of the reach, the largest displacement that is drawn


def draw_mode_shapes(
    model: Model, joint_angles: Vector | None = None, count: int = 6, size: tuple[int, int] = (480, 360)
) -> NDArray[np.uint8]:
    """Draws the lowest modes with held motors (`modes`), each beside the arm at rest, as one picture.

    Amplitudes are alike, a part of the reach, and say nothing; colours are those of the strain, each to its own scale.

    Args:
        model: the arm.
        joint_angles: (n,) rad of the motors, zero by default.
        count: modes at most.
        size: width and height of each of the pictures, pixels.

    Raises:
        ValueError: for what `modes` and a FramePainter refuse, and an arm that does not ring.
    """
    angles = np.zeros(check_model(model).n_joints) if joint_angles is None else joint_angles
    found, rest = modes(model, angles), rest_state(model, angles)
    number = min(whole_number("count", count, 1, 64), len(found))
    if number == 0:
        raise ValueError("model: it has no mode that rings; give an arm with flexible links or joints")
    painter, reach, states = FramePainter(model, size, overlays=False), float(model.constants.length.sum()), []
    still = curves(model, rest, POINTS).positions
    for shape in found.shapes[:number].real:
        small = 1e-4 / np.abs(shape).max()
        away = curves(model, rest + np.append(small * shape, 0.0 * shape), POINTS).positions - still
        moved = np.linalg.norm(away, axis=-1).max()
        states.append(rest + np.append(small * AMPLITUDE * reach / moved * shape, 0.0 * shape))
    shot = painter.shot(curves(model, np.array([rest, *states]), POINTS).positions.reshape(-1, 3))
    frames = []
    for i, state in enumerate(states):
        strains = np.abs(curves(model, state, POINTS).strains[..., :3]).max()
        painter.scale = float(max(2.0 * strains, 1e-12))
        title = f"mode {i + 1}: {found.frequencies[i]:.3g} Hz, damping {100 * found.damping_ratios[i]:.2g} %"
        frames.append(painter.paint(state, shot=shot))
        write_title(frames[-1], title)
    return grid(frames)


GRID_POINTS = 41  # postures along an axis of the map
EXCITATION_ORDERS = (1, 2, 3)  # of the spin rate, which a rotating arm is excited with


def frequency_map(model: Model, path: str | Path, mode: int = 1, span: float = np.pi) -> Path:
    """Draws a natural frequency with held motors over the angles of the last two joints, the others at zero.

    Gravity is left out, as in `frequencies`. An arm of one joint has a line.

    Args:
        model: the arm.
        path: of the picture.
        mode: counted from 1, the lowest.
        span: rad, of the angles either way.

    Raises:
        ImportError: without Matplotlib.
        ValueError: for a mode that does not exist.
    """
    n, path, angles = check_model(model).n_joints, Path(path), np.linspace(-span, span, GRID_POINTS)
    number = whole_number("mode", mode, 1, max(model.n_dof - n, 1)) - 1
    two = min(n, 2)
    places = np.stack(np.meshgrid(*[angles] * two, indexing="ij"), axis=-1).reshape(-1, two)
    postures = np.hstack([np.zeros((len(places), n - two)), places])
    if model.n_dof == n:
        raise value_error("model", "this one", "an arm with flexible links or joints")
    values = frequencies(model, postures, lock_joints=True)[:, number]
    figure = new_figure((6.4, 5.2), 120.0, layout="constrained")
    axes = figure.add_subplot()
    if two == 1:
        axes.plot(np.degrees(angles), values, color=DARK)
        axes.set(xlabel="joint 1 (degrees)", ylabel="frequency (Hz)")
    else:
        table, ends = values.reshape(GRID_POINTS, GRID_POINTS), np.degrees([-span, span] * 2)
        shown = axes.imshow(table.T, origin="lower", extent=ends, cmap="viridis", interpolation="bilinear")
        if np.ptp(table) > 1e-6 * table.max():
            lines = axes.contour(np.degrees(angles), np.degrees(angles), table.T, 8, colors="white", linewidths=0.7)
            axes.clabel(lines, fmt="%.3g", fontsize=8)
        figure.colorbar(shown, label="frequency (Hz)", shrink=0.9)
        axes.set(xlabel=f"joint {n - 1} (degrees)", ylabel=f"joint {n} (degrees)")
    axes.set_title(f"natural frequency {mode}, motors held", fontsize=11)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    return path


def campbell_diagram(model: Model, rates: Vector, path: str | Path, count: int = 6) -> Path:
    """Draws `spin_frequencies` over the spin rate, with the multiples of the rate as rays (Campbell, 1924).

    Args:
        model: the arm; build it with stiffening.
        rates: (r,) rad/s.
        path: of the picture.
        count: frequencies at most.

    Raises:
        ImportError: without Matplotlib.
        ValueError: as of `spin_frequencies`.
    """
    path, turns = Path(path), np.array(vector("rates", rates, unit="rad/s")) / (2 * np.pi)
    values = spin_frequencies(model, rates)[:, :count]
    figure = new_figure((6.8, 5.0), 120.0, layout="constrained")
    axes = figure.add_subplot()
    axes.plot(turns, values, color=DARK, linewidth=1.5)
    top = float(np.nanmax(values)) * 1.08 if np.isfinite(values).any() else 1.0
    for multiple in EXCITATION_ORDERS:
        axes.plot(turns, multiple * turns, "--", color=MIDDLE, linewidth=0.9)
        if multiple * turns[-1] < top:
            axes.annotate(f"{multiple}x", (turns[-1], multiple * turns[-1]), color=MIDDLE, fontsize=9)
    axes.set(xlabel="spin rate (turns a second)", ylabel="frequency (Hz)", ylim=(0.0, top), xlim=(turns[0], turns[-1]))
    words = "" if model.choice.stiffening else ", links without foreshortening"
    axes.set_title(f"Campbell diagram: motors keep their rates{words}", fontsize=11)
    axes.grid(color=LIGHT, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    return path


_Response = NDArray[np.complex128]


class _LoopMargins(NamedTuple):
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


def loop_margins(frequencies: Array, response: _Response) -> _LoopMargins:
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
    return _LoopMargins(*map(float, (gain, gain_frequency, phase, phase_frequency)))


def bode_diagram(frequencies: Array, responses: dict[str, _Response], path: str | Path, title: str = "") -> Path:
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
        found, size = loop_margins(frequencies, response), np.abs(response)
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
