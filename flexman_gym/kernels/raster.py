"""Rasteriser with depth buffer, two lights, shadow, floor grid and antialiasing.

Shapes are drawn to samples, several per pixel, which are averaged at the end. Only the box around the shapes of the
last frame is redrawn. Results are reproducible to the bit, as the order of all operations is fixed.
"""

from typing import NamedTuple

import numpy as np

from flexman_gym.kernels.compile import inner, kernel

AMBIENT, SKY, KEY, FILL = 0.36, 0.10, 0.62, 0.22  # intensities: ambient, from above, key light, fill light
GLOSS, RIM = 0.35, 0.16  # dimensionless; strengths of the highlight and of the darker silhouette edge
KEY_DIRECTION, FILL_DIRECTION = (-0.2933, -0.4609, 0.8376), (0.8491, 0.4717, 0.2358)  # unit vectors to the lights
SHADOW_THRESHOLD = 0.003  # dimensionless; opacity below which a shadow is invisible and not drawn


class Canvas(NamedTuple):
    """Memory of a picture of H x W pixels with s x s samples each.

    Attributes:
        colour: (s H, s W, 3) uint8 samples.
        depth: (s H, s W) float32, inverse distance along the view direction; 0 for the background.
        mask: (s H, s W) uint8; 1 for samples of the translucent rigid arm (ghost), 2 for samples of lines.
        back: (s H, s W, 3) uint8 samples of the empty scene.
        shadow: (H, W) float32 intensity of the shadow, 0 to 1.
        scratch: (H, W) float32, for intermediate results.
        picture: (H, W, 3) uint8 result.
        plain: (H, W, 3) uint8 picture of the empty scene.
        box: (4,) first and last column, first and last row of the samples drawn; empty if last < first.
    """

    colour: np.ndarray
    depth: np.ndarray
    mask: np.ndarray
    back: np.ndarray
    shadow: np.ndarray
    scratch: np.ndarray
    picture: np.ndarray
    plain: np.ndarray
    box: np.ndarray


@kernel
def project(points, eye, axes, lens, out):
    """Set out (p, 3) to column and row (samples) and inverse distance along the view direction (1/m) of points.

    Args:
        points: (p, 3) base frame, m.
        eye: (3,) position of the camera, m.
        axes: (3, 3) right, up and forward direction of the camera, by rows.
        lens: (3,) focal length and centre, in samples.
        out: overwritten.
    """
    for i in range(len(points)):
        a, b, c = points[i, 0] - eye[0], points[i, 1] - eye[1], points[i, 2] - eye[2]
        x = axes[0, 0] * a + axes[0, 1] * b + axes[0, 2] * c
        y = axes[1, 0] * a + axes[1, 1] * b + axes[1, 2] * c
        near = 1.0 / max(axes[2, 0] * a + axes[2, 1] * b + axes[2, 2] * c, 1e-6)
        out[i, 0], out[i, 1], out[i, 2] = lens[1] + lens[0] * x * near, lens[2] - lens[0] * y * near, near


@inner
def _bounds(low_x, high_x, low_y, high_y, box, height, width):
    """Return first and last column, first and last row that a shape can cover; enlarge the box to contain them."""
    left, right = max(int(np.floor(low_x)), 0), min(int(np.ceil(high_x)), width - 1)
    top, bottom = max(int(np.floor(low_y)), 0), min(int(np.ceil(high_y)), height - 1)
    if left <= right and top <= bottom:
        box[0], box[1] = min(box[0], left), max(box[1], right)
        box[2], box[3] = min(box[2], top), max(box[3], bottom)
    return left, right, top, bottom


@inner
def _luminance(n0, n1, n2, e0, e1, e2):
    """Return the factor of the surface colour and the added highlight, for a normal n and a view direction e."""
    scale = 1.0 / np.sqrt(n0 * n0 + n1 * n1 + n2 * n2 + 1e-30)
    n0, n1, n2 = n0 * scale, n1 * scale, n2 * scale
    scale = 1.0 / np.sqrt(e0 * e0 + e1 * e1 + e2 * e2 + 1e-30)
    e0, e1, e2 = e0 * scale, e1 * scale, e2 * scale
    factor = AMBIENT + SKY * n2 + KEY * max(n0 * KEY_DIRECTION[0] + n1 * KEY_DIRECTION[1] + n2 * KEY_DIRECTION[2], 0.0)
    factor += FILL * max(n0 * FILL_DIRECTION[0] + n1 * FILL_DIRECTION[1] + n2 * FILL_DIRECTION[2], 0.0)
    h0, h1, h2 = e0 + KEY_DIRECTION[0], e1 + KEY_DIRECTION[1], e2 + KEY_DIRECTION[2]
    scale = 1.0 / np.sqrt(h0 * h0 + h1 * h1 + h2 * h2 + 1e-30)
    highlight = max((n0 * h0 + n1 * h1 + n2 * h2) * scale, 0.0)
    highlight *= highlight
    highlight *= highlight
    highlight *= highlight
    highlight *= highlight
    highlight *= highlight  # to the power of 32
    edge = 1.0 - max(n0 * e0 + n1 * e1 + n2 * e2, 0.0)
    return factor, 255.0 * GLOSS * highlight - 80.0 * RIM * edge * edge * edge


@kernel
def draw_triangles(canvas, screen, points, normals, colours, faces, eye):
    """Draw the triangles whose front faces the camera.

    Args:
        canvas: overwritten.
        screen: (p, 3) projected points, see `project`.
        points: (p, 3) m, base frame.
        normals: (p, 3) surface normals at the points, interpolated linearly.
        colours: (p, 3) colours at the points, 0 to 255, interpolated linearly.
        faces: (f, 3) indices of points.
        eye: (3,) position of the camera, m.
    """
    height, width = canvas.depth.shape
    for t in range(len(faces)):
        i, j, k = faces[t, 0], faces[t, 1], faces[t, 2]
        x0, y0, x1, y1, x2, y2 = screen[i, 0], screen[i, 1], screen[j, 0], screen[j, 1], screen[k, 0], screen[k, 1]
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if not area < 0.0:  # back face: rows increase downwards
            continue
        whole = 1.0 / area
        left, right, top, bottom = _bounds(
            min(x0, x1, x2), max(x0, x1, x2), min(y0, y1, y2), max(y0, y1, y2), canvas.box, height, width
        )
        for row in range(top, bottom + 1):
            y = row + 0.5
            for column in range(left, right + 1):
                x = column + 0.5
                u = ((x1 - x) * (y2 - y) - (x2 - x) * (y1 - y)) * whole
                v = ((x2 - x) * (y0 - y) - (x0 - x) * (y2 - y)) * whole
                w = 1.0 - u - v
                if u < 0.0 or v < 0.0 or w < 0.0:
                    continue
                inverse_distance = np.float32(u * screen[i, 2] + v * screen[j, 2] + w * screen[k, 2])
                if inverse_distance <= canvas.depth[row, column]:
                    continue
                canvas.depth[row, column] = inverse_distance
                factor, highlight = _luminance(
                    u * normals[i, 0] + v * normals[j, 0] + w * normals[k, 0],
                    u * normals[i, 1] + v * normals[j, 1] + w * normals[k, 1],
                    u * normals[i, 2] + v * normals[j, 2] + w * normals[k, 2],
                    eye[0] - (u * points[i, 0] + v * points[j, 0] + w * points[k, 0]),
                    eye[1] - (u * points[i, 1] + v * points[j, 1] + w * points[k, 1]),
                    eye[2] - (u * points[i, 2] + v * points[j, 2] + w * points[k, 2]),
                )
                for c in range(3):
                    value = (u * colours[i, c] + v * colours[j, c] + w * colours[k, c]) * factor + highlight
                    canvas.colour[row, column, c] = np.uint8(min(max(value, 0.0), 255.0))


@kernel
def mark_coverage(screen, faces, mask, depth, box):
    """Set mask to 1 where triangles cover an empty sample, or with a depth of size 1 any sample; enlarge the box."""
    height, width = mask.shape
    everywhere = depth.size == 1
    for t in range(len(faces)):
        i, j, k = faces[t, 0], faces[t, 1], faces[t, 2]
        x0, y0, x1, y1, x2, y2 = screen[i, 0], screen[i, 1], screen[j, 0], screen[j, 1], screen[k, 0], screen[k, 1]
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if not area < 0.0:
            continue
        whole = 1.0 / area
        left, right, top, bottom = _bounds(
            min(x0, x1, x2), max(x0, x1, x2), min(y0, y1, y2), max(y0, y1, y2), box, height, width
        )
        for row in range(top, bottom + 1):
            y = row + 0.5
            for column in range(left, right + 1):
                if mask[row, column] > 0 or not (everywhere or depth[row, column] == 0.0):
                    continue
                x = column + 0.5
                u = ((x1 - x) * (y2 - y) - (x2 - x) * (y1 - y)) * whole
                v = ((x2 - x) * (y0 - y) - (x0 - x) * (y2 - y)) * whole
                if u >= 0.0 and v >= 0.0 and u + v <= 1.0:
                    mask[row, column] = 1


@kernel
def draw_line(canvas, screen, radius, faintest, colour):
    """Draw a line that grows from faint and thin at its first point to full strength at its last point.

    Samples behind other shapes are not drawn, and each sample is drawn once.

    Args:
        canvas: overwritten.
        screen: (p, 3) projected points.
        radius: half the line width at the last point, in samples.
        faintest: opacity at the first point, 0 to 1.
        colour: (3,) 0 to 255.
    """
    height, width = canvas.depth.shape
    last = len(screen) - 1
    for t in range(last - 1, -1, -1):
        x0, y0, x1, y1 = screen[t, 0], screen[t, 1], screen[t + 1, 0], screen[t + 1, 1]
        dx, dy = x1 - x0, y1 - y0
        part = faintest + (1.0 - faintest) * (t + 1.0) / last
        line_radius = radius * (0.4 + 0.6 * part)
        left, right, top, bottom = _bounds(
            min(x0, x1) - line_radius,
            max(x0, x1) + line_radius,
            min(y0, y1) - line_radius,
            max(y0, y1) + line_radius,
            canvas.box,
            height,
            width,
        )
        for row in range(top, bottom + 1):
            for column in range(left, right + 1):
                along = ((column + 0.5 - x0) * dx + (row + 0.5 - y0) * dy) / (dx * dx + dy * dy + 1e-12)
                along = min(max(along, 0.0), 1.0)
                ex, ey = column + 0.5 - x0 - along * dx, row + 0.5 - y0 - along * dy
                inverse_distance = np.float32(screen[t, 2] + along * (screen[t + 1, 2] - screen[t, 2]))
                if ex * ex + ey * ey > line_radius * line_radius or inverse_distance < canvas.depth[row, column]:
                    continue
                if canvas.mask[row, column] == 0:
                    canvas.mask[row, column] = 2
                    for c in range(3):
                        old = canvas.colour[row, column, c]
                        canvas.colour[row, column, c] = np.uint8(old + part * (colour[c] - old))


@inner
def _blur_shadow(shadow, scratch, box, radius):
    """Blur the shadow (H, W) in a box (4,) by two moving averages over 2 radius + 1 pixels in each direction."""
    height, width = shadow.shape
    box[0], box[1] = max(box[0] - 2 * radius, 0), min(box[1] + 2 * radius, width - 1)
    box[2], box[3] = max(box[2] - 2 * radius, 0), min(box[3] + 2 * radius, height - 1)
    left, right, top, bottom = box[0], box[1], box[2], box[3]
    part = 1.0 / (2 * radius + 1)
    for _ in range(2):
        for row in range(top, bottom + 1):
            for column in range(left, right + 1):
                total = 0.0
                for other in range(max(column - radius, left), min(column + radius, right) + 1):
                    total += shadow[row, other]
                scratch[row, column] = total * part
        for row in range(top, bottom + 1):
            for column in range(left, right + 1):
                total = 0.0
                for other in range(max(row - radius, top), min(row + radius, bottom) + 1):
                    total += scratch[other, column]
                shadow[row, column] = total * part


@inner
def _darken(canvas, box, darkness):
    """Darken the empty scene by the shadow in a box (4,) of pixels, and clear the shadow."""
    samples = len(canvas.depth) // len(canvas.shadow)
    for row in range(box[2], box[3] + 1):
        for column in range(box[0], box[1] + 1):
            opacity = darkness * canvas.shadow[row, column]
            canvas.shadow[row, column] = 0.0
            if opacity <= SHADOW_THRESHOLD:
                continue
            for y in range(row * samples, (row + 1) * samples):
                for x in range(column * samples, (column + 1) * samples):
                    for c in range(3):
                        canvas.colour[y, x, c] = np.uint8(canvas.back[y, x, c] * (1.0 - opacity))
    left, right, top, bottom = (
        box[0] * samples,
        (box[1] + 1) * samples - 1,
        box[2] * samples,
        (box[3] + 1) * samples - 1,
    )
    canvas.box[0], canvas.box[1] = min(canvas.box[0], left), max(canvas.box[1], right)
    canvas.box[2], canvas.box[3] = min(canvas.box[2], top), max(canvas.box[3], bottom)


@kernel
def draw_shadow(canvas, box, radius, darkness):
    """Blur the shadow in a box (4,) of pixels, darken the empty scene by it, and clear the shadow.

    Args:
        canvas: overwritten.
        box: first and last column, first and last row; enlarged by the blur.
        radius: pixels; each of two moving averages covers 2 radius + 1 pixels in each direction.
        darkness: opacity of a full shadow, 0 to 1.
    """
    _blur_shadow(canvas.shadow, canvas.scratch, box, radius)
    _darken(canvas, box, darkness)


@kernel
def resolve(canvas, ghost, opacity):
    """Average the samples in the box to pixels; blend the colour `ghost` (3,) over samples of mask 1."""
    samples = len(canvas.depth) // len(canvas.shadow)
    height, width = canvas.shadow.shape
    for row in range(canvas.box[2] // samples, min(canvas.box[3] // samples + 1, height)):
        for column in range(canvas.box[0] // samples, min(canvas.box[1] // samples + 1, width)):
            for c in range(3):
                total = 0.0
                for y in range(row * samples, (row + 1) * samples):
                    for x in range(column * samples, (column + 1) * samples):
                        value = float(canvas.colour[y, x, c])
                        if canvas.mask[y, x] == 1:
                            value += opacity * (ghost[c] - value)
                        total += value
                canvas.picture[row, column, c] = np.uint8(total / (samples * samples) + 0.5)


@kernel
def draw_floor(back, eye, axes, lens, floor, reach, step):
    """Draw a bright sky and a floor with a grid to back (h, w, 3).

    Grid lines narrower than a sample are drawn one sample wide and fainter; the two through the base are darker.

    Args:
        back: overwritten.
        eye: (3,) position of the camera, m.
        axes: (3, 3) right, up and forward direction of the camera, by rows.
        lens: (3,) focal length and centre, in samples.
        floor: z coordinate of the floor, m.
        reach: distance from the base at which the floor fades out, m.
        step: distance of the grid lines, m.
    """
    height, width = back.shape[0], back.shape[1]
    for row in range(height):
        up = (lens[2] - row - 0.5) / lens[0]
        bright = min(max(1.0 - 1.1 * (row + 0.5) / height, 0.0), 1.0)
        for column in range(width):
            across = (column + 0.5 - lens[1]) / lens[0]
            slope = across * axes[0, 2] + up * axes[1, 2] + axes[2, 2]
            solid = line = axis = 0.0
            if slope * (floor - eye[2]) > 0.0:
                distance = (floor - eye[2]) / slope
                x = eye[0] + distance * (across * axes[0, 0] + up * axes[1, 0] + axes[2, 0])
                y = eye[1] + distance * (across * axes[0, 1] + up * axes[1, 1] + axes[2, 1])
                solid = min(max(1.75 - np.sqrt(x * x + y * y) / (1.25 * reach), 0.0), 1.0)
                solid = solid * solid * (3.0 - 2.0 * solid)
                line_width = distance / lens[0] * (0.9 + 0.35 / abs(slope))
                for coordinate in (x, y):
                    line_distance = abs(coordinate / step + 0.5 - np.floor(coordinate / step + 0.5) - 0.5) * step
                    line = max(line, min(max(1.4 - line_distance / line_width, 0.0), 1.0))
                    axis = max(axis, min(max(1.6 - abs(coordinate) / (1.3 * line_width), 0.0), 1.0))
            for c in range(3):
                sky = (222.0, 229.0, 238.0)[c] + bright * (255.0 - (222.0, 229.0, 238.0)[c])
                ground = (243.0, 246.0, 249.0)[c] - line * (46.0, 40.0, 32.0)[c] - axis * 40.0
                back[row, column, c] = np.uint8(sky + solid * (ground - sky))
