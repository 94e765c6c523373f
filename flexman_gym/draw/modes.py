"""Modes: the shapes in which an arm rings at a posture, side by side."""

import numpy as np
from numpy.typing import NDArray

from flexman_gym.arrays import Vector
from flexman_gym.checks import whole_number
from flexman_gym.draw.frames import POINTS, FramePainter, grid
from flexman_gym.draw.overlay import letter_size, write
from flexman_gym.model.curves import curves
from flexman_gym.model.model import Model, checked_model
from flexman_gym.model.statics import rest_state
from flexman_gym.model.vibration import modes

AMPLITUDE = 0.08  # of the reach, the largest displacement that is drawn


def mode_pictures(
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
    angles = np.zeros(checked_model(model).n_joints) if joint_angles is None else joint_angles
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
        letters = letter_size(size[1])
        write(frames[-1], title, (letters, letters // 2), letters)
    return grid(frames)
