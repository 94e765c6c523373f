"""Scenery: the empty scene of a picture, a floor with a grid under a bright sky."""

import numpy as np

from flexman_gym.kernels.compile import kernel


@kernel
def lay_floor(back, eye, axes, lens, floor, reach, step):
    """Fills back (h, w, 3) with a bright sky and a floor at the height `floor`, m, that fades at the reach, m.

    Its grid has lines every `step` m, the two through the base darker. A line gets as wide as a sample where it would
    be thinner, and fainter in its place.
    """
    height, width = back.shape[0], back.shape[1]
    for row in range(height):
        up = (lens[2] - row - 0.5) / lens[0]
        bright = min(max(1.0 - 1.1 * (row + 0.5) / height, 0.0), 1.0)
        for column in range(width):
            across = (column + 0.5 - lens[1]) / lens[0]
            fall = across * axes[0, 2] + up * axes[1, 2] + axes[2, 2]
            solid = line = axis = 0.0
            if fall * (floor - eye[2]) > 0.0:
                far = (floor - eye[2]) / fall
                x = eye[0] + far * (across * axes[0, 0] + up * axes[1, 0] + axes[2, 0])
                y = eye[1] + far * (across * axes[0, 1] + up * axes[1, 1] + axes[2, 1])
                solid = min(max(1.75 - np.sqrt(x * x + y * y) / (1.25 * reach), 0.0), 1.0)
                solid = solid * solid * (3.0 - 2.0 * solid)
                thick = far / lens[0] * (0.9 + 0.35 / abs(fall))
                for place in (x, y):
                    apart = abs(place / step + 0.5 - np.floor(place / step + 0.5) - 0.5) * step
                    line = max(line, min(max(1.4 - apart / thick, 0.0), 1.0))
                    axis = max(axis, min(max(1.6 - abs(place) / (1.3 * thick), 0.0), 1.0))
            for c in range(3):
                sky = (222.0, 229.0, 238.0)[c] + bright * (255.0 - (222.0, 229.0, 238.0)[c])
                ground = (243.0, 246.0, 249.0)[c] - line * (46.0, 40.0, 32.0)[c] - axis * 40.0
                back[row, column, c] = np.uint8(sky + solid * (ground - sky))
