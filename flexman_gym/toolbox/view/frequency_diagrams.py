"""Frequency diagrams: mode shapes, frequencies over the workspace, Campbell diagram, Bode diagram."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.arrays import Array, Vector
from flexman_gym.common.checks import vector, whole_number
from flexman_gym.common.errors import value_error
from flexman_gym.common.plot_style import DARK, LIGHT, LINK_COLOURS, MIDDLE, new_figure, save_figure
from flexman_gym.model.deformation import curves
from flexman_gym.model.dynamics import frequencies
from flexman_gym.model.model import Model, check_model
from flexman_gym.model.vibration import modes, rotating_frequencies
from flexman_gym.toolbox.view.frames import POINTS, FramePainter, grid
from flexman_gym.toolbox.view.overlay import font_size, write_text

AMPLITUDE = 0.08  # dimensionless; largest displacement in the picture of a mode as a fraction of the reach


def draw_mode_shapes(
    model: Model, joint_angles: Vector | None = None, count: int = 6, size: tuple[int, int] = (480, 360)
) -> NDArray[np.uint8]:
    """Draw the lowest modes with held motors in one picture, each as the arm at rest plus the mode shape.

    The largest displacement is the same for all modes. Colours show the strain, with a separate scale for each mode.

    Args:
        model: model of the arm.
        joint_angles: motor angles (n,), rad; None for zero. See `fm.modes`.
        count: largest number of modes.
        size: width and height of the picture of one mode, pixels.

    Returns:
        Pixels (height, width, 3), uint8, of the pictures of the modes in a grid.

    Raises:
        ValueError: for an arm without vibration modes.
    """
    angles = np.zeros(check_model(model).n_joints) if joint_angles is None else joint_angles
    found = modes(model, angles)
    number = min(whole_number("count", count, 1, 64), len(found))
    if number == 0:
        raise ValueError("model: it has no vibration mode; give an arm with flexible links or joints")
    painter, reach, states = FramePainter(model, size, overlays=False), float(model.constants.length.sum()), []
    straight = model.initial_state(angles)  # the shapes are drawn without the sag under gravity
    positions = curves(model, straight, POINTS).positions
    for shape in found.shapes[:number].real:
        small = 1e-4 / np.abs(shape).max()
        away = curves(model, straight + np.append(small * shape, 0.0 * shape), POINTS).positions - positions
        largest = np.linalg.norm(away, axis=-1).max()
        states.append(straight + np.append(small * AMPLITUDE * reach / largest * shape, 0.0 * shape))
    shot = painter.shot(curves(model, np.array([straight, *states]), POINTS).positions.reshape(-1, 3))
    frames, letters = [], font_size(size[1])
    for i, state in enumerate(states):
        strains = np.abs(curves(model, state, POINTS).strains[..., :3]).max()
        painter.scale = float(max(2.0 * strains, 1e-12))
        title = f"mode {i + 1}: {found.frequencies[i]:.3g} Hz, damping {100 * found.damping_ratios[i]:.2g} %"
        frames.append(painter.paint(state, shot=shot))
        write_text(frames[-1], title, (letters, letters // 2), letters)
    return grid(frames)


GRID_POINTS = 41  # number of angles along each axis of a frequency map
EXCITATION_ORDERS = (1, 2, 3)  # multiples of the spin rate that excite a rotating arm


def frequency_map(model: Model, path: str | Path, mode: int = 1, span: float = np.pi) -> Path:
    """Plot a natural frequency with held motors over the angles of the last two joints; return the path.

    All other joint angles are zero, and gravity is ignored, as in `fm.frequencies`. For an arm with one joint, the plot
    is a curve.

    Args:
        model: model of the arm.
        path: path of the picture.
        mode: number of the mode; 1 is the lowest.
        span: largest joint angle in both directions, rad.

    Raises:
        ImportError: without Matplotlib.
        ValueError: for a mode that does not exist, and for a rigid arm.
    """
    n, path, angles = check_model(model).n_joints, Path(path), np.linspace(-span, span, GRID_POINTS)
    number = whole_number("mode", mode, 1, max(model.n_dof - n, 1)) - 1
    varied = min(n, 2)
    last = np.stack(np.meshgrid(*[angles] * varied, indexing="ij"), axis=-1).reshape(-1, varied)
    postures = np.hstack([np.zeros((len(last), n - varied)), last])
    if model.n_dof == n:
        raise value_error("model", "this one", "an arm with flexible links or joints")
    values = frequencies(model, postures, lock_joints=True)[:, number]
    figure = new_figure((6.4, 5.2), 120.0, layout="constrained")
    axes = figure.add_subplot()
    if varied == 1:
        axes.plot(np.degrees(angles), values, color=DARK)
        axes.set(xlabel="joint 1 (degrees)", ylabel="frequency (Hz)")
    else:
        table, ends = values.reshape(GRID_POINTS, GRID_POINTS), np.degrees([-span, span] * 2)
        image = axes.imshow(table.T, origin="lower", extent=ends, cmap="viridis", interpolation="bilinear")
        if np.ptp(table) > 1e-6 * table.max():
            lines = axes.contour(np.degrees(angles), np.degrees(angles), table.T, 8, colors="white", linewidths=0.7)
            axes.clabel(lines, fmt="%.3g", fontsize=8)
        figure.colorbar(image, label="frequency (Hz)", shrink=0.9)
        axes.set(xlabel=f"joint {n - 1} (degrees)", ylabel=f"joint {n} (degrees)")
    axes.set_title(f"natural frequency {mode}, motors held", fontsize=11)
    save_figure(figure, path)
    return path


def campbell_diagram(model: Model, rates: Vector, path: str | Path, count: int = 6) -> Path:
    """Plot natural frequencies over the spin rate, with multiples of the rate (Campbell, 1924); return the path.

    Args:
        model: model of the arm; it should include stiffening, see `model.vibration.rotating_frequencies`.
        rates: spin rates (r,), rad/s.
        path: path of the picture.
        count: largest number of frequencies.

    Raises:
        ImportError: without Matplotlib.
    """
    path, spins = Path(path), np.array(vector("rates", rates, unit="rad/s")) / (2 * np.pi)
    values = rotating_frequencies(model, rates)[:, :count]
    figure = new_figure((6.8, 5.0), 120.0, layout="constrained")
    axes = figure.add_subplot()
    axes.plot(spins, values, color=DARK, linewidth=1.5)
    top = float(np.nanmax(values)) * 1.08 if np.isfinite(values).any() else 1.0
    for multiple in EXCITATION_ORDERS:
        axes.plot(spins, multiple * spins, "--", color=MIDDLE, linewidth=0.9)
        if multiple * spins[-1] < top:
            axes.annotate(f"{multiple}x", (spins[-1], multiple * spins[-1]), color=MIDDLE, fontsize=9)
    axes.set(
        xlabel="spin rate (turns per second)", ylabel="frequency (Hz)", ylim=(0.0, top), xlim=(spins[0], spins[-1])
    )
    words = "" if model.choice.stiffening else ", links without foreshortening"
    axes.set_title(f"Campbell diagram: motors at constant rates{words}", fontsize=11)
    axes.grid(color=LIGHT, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    save_figure(figure, path)
    return path


REAL = 1e-9  # imaginary part / magnitude of a real response, such as that of a sampled loop at its Nyquist frequency
_Response = NDArray[np.complex128]


class _LoopMargins(NamedTuple):
    """Stability margins of an open loop, from its frequency response; nan without a crossing.

    Attributes:
        gain: gain margin: smallest factor > 1 by which the loop gain may grow.
        gain_frequency: phase crossover frequency, Hz.
        phase: smallest phase margin, degrees.
        phase_frequency: gain crossover frequency, Hz.
    """

    gain: float
    gain_frequency: float
    phase: float
    phase_frequency: float


def _loop_margins(frequencies: Array, response: _Response) -> _LoopMargins:
    """Return the margins of a response (f,) at frequencies (f,), Hz, by linear interpolation."""
    response = np.where(np.abs(response.imag) < REAL * np.abs(response), response.real, response)
    gain, gain_frequency, phase, phase_frequency = np.nan, np.nan, np.nan, np.nan
    for i in np.flatnonzero(np.diff(np.sign(response.imag)) != 0):
        part = response.imag[i] / (response.imag[i] - response.imag[i + 1])
        real = response.real[i] + part * (response.real[i + 1] - response.real[i])
        if -1.0 < real < 0.0 and not -1.0 / real >= gain:
            gain, gain_frequency = -1.0 / real, frequencies[i] + part * (frequencies[i + 1] - frequencies[i])
    size = np.abs(response) - 1.0
    for i in np.flatnonzero(np.diff(np.sign(size)) != 0):
        part = size[i] / (size[i] - size[i + 1])
        margin = abs(180.0 - abs(np.degrees(np.angle(response[i] + part * (response[i + 1] - response[i])))))
        if not margin >= phase:
            phase, phase_frequency = margin, frequencies[i] + part * (frequencies[i + 1] - frequencies[i])
    return _LoopMargins(*map(float, (gain, gain_frequency, phase, phase_frequency)))


def bode_diagram(frequencies: Array, responses: dict[str, _Response], path: str | Path, title: str = "") -> Path:
    """Plot gain and phase of open loops over frequency with their stability margins; return the path.

    Args:
        frequencies: frequencies (f,), Hz, ascending.
        responses: name of a loop -> its complex frequency response (f,).
        path: path of the picture.
        title: title of the picture.

    Raises:
        ImportError: without Matplotlib.
    """
    path, figure = Path(path), new_figure((7.6, 6.0), 120.0, layout="constrained")
    gain, phase = figure.subplots(2, 1, sharex=True)
    for (name, response), colour in zip(responses.items(), LINK_COLOURS, strict=False):
        found, size = _loop_margins(frequencies, response), np.abs(response)
        angle = np.degrees(np.unwrap(np.angle(response)))
        label = f"{name}: gain margin {found.gain:.3g}, phase margin {found.phase:.3g}°".replace("nan°", "none")
        gain.loglog(frequencies, size, color=colour, label=label.replace("nan", "none"))
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
    save_figure(figure, path)
    return path
