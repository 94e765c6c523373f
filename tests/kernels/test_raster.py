"""Rasteriser: coverage, visibility, light, shadow, lines and averages against their formulas."""

import numpy as np
import pytest

from flexman_gym.kernels import raster

SHAPE = 16, 20  # rows and columns of pixels
ROWS, COLUMNS = np.mgrid[: SHAPE[0], : SHAPE[1]] + 0.5  # centres
CORNERS = np.array([[1.0, 1.0], [1.0, 9.0], [13.0, 1.0]])  # column and row; counter-clockwise as rows grow downwards
NEARNESS = np.array([0.1, 0.3, 0.2])
FACES = np.array([[0, 1, 2]])
FAR = np.array([0.0, 0.0, 1e9])  # an eye above


def canvas(samples=1):
    """Return an empty grey canvas."""
    height, width = (samples * each for each in SHAPE)
    colour = np.full((height, width, 3), 100, dtype=np.uint8)
    depth, mask = np.zeros((height, width), dtype=np.float32), np.zeros((height, width), dtype=np.uint8)
    shadow, picture = np.zeros(SHAPE, dtype=np.float32), np.zeros((*SHAPE, 3), dtype=np.uint8)
    box = np.array([1 << 30, -1, 1 << 30, -1])
    return raster.Canvas(colour, depth, mask, colour.copy(), shadow, shadow.copy(), picture, picture.copy(), box)


def screen(nearness=NEARNESS):
    return np.column_stack([CORNERS, np.broadcast_to(nearness, 3)])


def shares():
    """Return the barycentric coordinates (3, rows, columns) of the centres, and whether they are in the triangle."""
    edges = np.linalg.inv(np.column_stack([CORNERS, np.ones(3)]).T)
    parts = np.einsum("ij,jrc->irc", edges, np.stack([COLUMNS, ROWS, np.ones(SHAPE)]))
    return parts, (parts >= 0.0).all(axis=0)


def shaded(normals, colours=(200.0, 100.0, 50.0), eye=FAR):
    """Return the colours of a canvas with one triangle."""
    drawn = canvas()
    every = np.broadcast_to(np.asarray(colours, dtype=float), (3, 3)).copy()
    given = np.broadcast_to(np.asarray(normals, dtype=float), (3, 3)).copy()
    raster.draw_triangles(drawn, screen(), np.zeros((3, 3)), given, every, FACES, np.asarray(eye, dtype=float))
    return drawn.colour


def test_projection_is_that_of_a_pinhole_camera():
    random = np.random.default_rng(0)
    axes, eye = np.linalg.qr(random.normal(size=(3, 3)))[0], random.normal(size=3)
    points, out = eye + random.uniform((-1.0, -1.0, 2.0), (1.0, 1.0, 4.0), (9, 3)) @ axes, np.zeros((9, 3))
    raster.project(points, eye, axes, np.array([50.0, 8.0, 6.0]), out)
    right, up, forward = axes @ (points - eye).T
    assert out == pytest.approx(np.column_stack([8.0 + 50.0 * right / forward, 6.0 - 50.0 * up / forward, 1 / forward]))


def test_a_front_face_covers_the_sample_centres_inside_it():
    drawn, (parts, inside) = canvas(), shares()
    corners, up = screen(), np.tile([0.0, 0.0, 1.0], (3, 1))
    raster.draw_triangles(drawn, corners, np.zeros((3, 3)), up, np.zeros((3, 3)), FACES[:, ::-1].copy(), FAR)
    assert (drawn.depth == 0.0).all() and drawn.box[1] < drawn.box[0], "back faces are not drawn"
    raster.draw_triangles(drawn, corners, np.zeros((3, 3)), up, np.zeros((3, 3)), FACES, FAR)
    assert np.array_equal(drawn.depth > 0.0, inside) and inside.sum() > 40
    assert drawn.depth[inside] == pytest.approx(np.einsum("i,irc->rc", NEARNESS, parts)[inside], rel=1e-6)
    rows, columns = np.nonzero(inside)
    assert (drawn.box[::2] <= (columns.min(), rows.min())).all(), "the box contains all samples drawn"
    assert (drawn.box[1::2] >= (columns.max(), rows.max())).all()


def test_a_triangle_larger_than_the_picture_covers_all_of_it():
    drawn, wide = canvas(), np.column_stack([[-50.0, -50.0, 100.0], [-50.0, 100.0, -50.0], NEARNESS])
    raster.draw_triangles(drawn, wide, np.zeros((3, 3)), np.ones((3, 3)), np.zeros((3, 3)), FACES, FAR)
    assert (drawn.depth > 0.0).all() and drawn.box.tolist() == [0, SHAPE[1] - 1, 0, SHAPE[0] - 1]


@pytest.mark.parametrize("nearest", [0, 1])
def test_the_nearer_triangle_is_visible_in_either_order_of_drawing(nearest):
    drawn, up = canvas(), np.tile([0.0, 0.0, 1.0], (3, 1))
    for i, colour in enumerate(((250.0, 0.0, 0.0), (0.0, 0.0, 250.0))):
        near = 0.5 if i == nearest else 0.4
        raster.draw_triangles(drawn, screen(near), np.zeros((3, 3)), up, np.tile(colour, (3, 1)), FACES, FAR)
    pixel = drawn.colour[3, 3].astype(int)
    assert (pixel[0] > pixel[2]) == (nearest == 0) and drawn.depth[3, 3] == np.float32(0.5)


@pytest.mark.parametrize("angle", [0.0, 0.2, 0.5])
def test_lighting_follows_the_cosine_law_and_the_highlight_its_power(angle):
    """The camera is in the direction of the key light, so the highlight is the cosine to the power of 32."""
    sun, fill = np.array(raster.KEY_DIRECTION), np.array(raster.FILL_DIRECTION)
    sun, direction = sun / np.linalg.norm(sun), 1e9 * sun
    across = np.cross(sun, (0.0, 0.0, 1.0))
    normal, share = np.cos(angle) * sun + np.sin(angle) * across / np.linalg.norm(across), np.cos(angle)
    factor = raster.AMBIENT + raster.SKY * normal[2] + raster.KEY * share + raster.FILL * max(normal @ fill, 0.0)
    expected = factor * np.array([100.0, 50.0, 20.0]) + 255.0 * raster.GLOSS * share**32
    expected -= 80.0 * raster.RIM * (1.0 - share) ** 3
    assert np.abs(shaded(7.0 * normal, (100.0, 50.0, 20.0), direction)[3, 3] - expected).max() < 1.1
    factor = raster.AMBIENT - raster.SKY * sun[2] + raster.FILL * max(-sun @ fill, 0.0)
    away = factor * np.array([100.0, 50.0, 20.0]) - 80.0 * raster.RIM
    assert np.abs(shaded(-sun, (100.0, 50.0, 20.0), direction)[3, 3] - np.maximum(away, 0.0)).max() < 1.1


def test_normals_and_colours_change_linearly_between_the_corners():
    """A sample equals one of a uniform triangle with the interpolated normal and colour."""
    parts, inside = shares()
    normals = np.array([[0.9, 0.0, 0.4], [-0.5, 0.8, 0.3], [0.0, -0.7, 0.7]])
    colours = np.array([[250.0, 0.0, 10.0], [20.0, 200.0, 0.0], [0.0, 30.0, 240.0]])
    smooth = shaded(normals, colours)
    for row, column in np.argwhere(inside)[::7]:
        place = parts[:, row, column]
        flat = shaded(place @ normals, place @ colours)[row, column]
        assert np.abs(smooth[row, column].astype(int) - flat).max() <= 1


def test_coverage_excludes_samples_drawn_before_unless_the_depth_is_ignored():
    (_, inside), drawn, box = shares(), canvas(), np.array([1 << 30, -1, 1 << 30, -1])
    drawn.depth[:4] = 0.1
    raster.mark_coverage(screen(), FACES, drawn.mask, drawn.depth, box)
    assert np.array_equal(drawn.mask == 1, inside & (ROWS > 4.0))
    raster.mark_coverage(screen(), FACES, drawn.shadow, np.zeros((1, 1), dtype=np.float32), box)
    assert np.array_equal(drawn.shadow == 1.0, inside), "a shadow also covers samples drawn before"


def test_a_line_grows_to_full_radius_and_opacity_at_its_last_point():
    """The last of three segments has the full radius and opacity, the others less; a sample is drawn once."""
    drawn, colour, faintest, radius = canvas(), np.array([200.0, 0.0, 150.0]), 0.2, 2.5
    ends = 3.0, 7.0, 11.0, 17.0
    line = np.array([[column, 8.0, 0.5] for column in ends])
    drawn.depth[9, 12:14], drawn.depth[9, 14:16] = 0.6, 0.4  # nearer and farther than the line
    raster.draw_line(drawn, line, radius, faintest, colour)
    expected, hidden, parts = np.full((*SHAPE, 3), 100.0), drawn.depth > 0.5, np.zeros(SHAPE)
    for first, last, share in zip(ends, ends[1:], (1 / 3, 2 / 3, 1.0), strict=False):
        part = faintest + (1.0 - faintest) * share
        near = np.hypot(COLUMNS - np.clip(COLUMNS, first, last), ROWS - 8.0) <= radius * (0.4 + 0.6 * part)
        parts[near & ~hidden] = part
    expected += parts[..., None] * (colour - 100.0)
    assert hidden.sum() == 2 and len(np.unique(parts)) == 4
    assert np.abs(drawn.colour - expected).max() <= 1.0
    assert np.array_equal(drawn.mask == 2, parts > 0.0)


def white_canvas():
    """Return an empty white canvas: its colours show the shadow with the best resolution."""
    drawn = canvas()
    drawn.colour[:] = drawn.back[:] = 255
    return drawn


def assert_shadow(drawn, rows, columns):
    """Assert that the canvas shows the shadow that is the outer product, and that the shadow is cleared."""
    expected = 255.0 * (1.0 - np.outer(rows, columns))
    assert np.abs(drawn.colour - expected[..., None]).max() < 1.0
    assert not drawn.shadow.any()


@pytest.mark.parametrize("radius", [1, 2])
def test_a_shadow_at_one_edge_does_not_appear_at_the_opposite_edge(radius):
    drawn, box = white_canvas(), np.array([0, SHAPE[1] - 1, 0, SHAPE[0] - 1])
    drawn.shadow[-1, -1] = 1.0
    raster.draw_shadow(drawn, box, radius, 1.0)
    means = [np.tri(size, k=radius) * np.tri(size, k=radius).T / (2 * radius + 1) for size in SHAPE]
    assert_shadow(drawn, *(mean @ mean[:, -1] for mean in means))
    assert box.tolist() == [0, SHAPE[1] - 1, 0, SHAPE[0] - 1]


@pytest.mark.parametrize("radius", [1, 2])
def test_a_shadow_is_blurred_by_two_moving_averages(radius):
    """A point becomes a pyramid: two averages over 2 r + 1 pixels give a triangle in each direction."""
    drawn, box = white_canvas(), np.array([9, 9, 7, 7])
    drawn.shadow[7, 9] = 1.0
    raster.draw_shadow(drawn, box, radius, 1.0)
    wide = 2 * radius + 1
    triangles = (np.maximum(wide - np.abs(np.arange(size) - at), 0) / wide**2 for size, at in ((16, 7), (20, 9)))
    assert_shadow(drawn, *triangles)
    assert box.tolist() == [9 - 2 * radius, 9 + 2 * radius, 7 - 2 * radius, 7 + 2 * radius]


def test_a_shadow_darkens_the_empty_scene_once():
    drawn = canvas(2)
    drawn.shadow[3, 4], drawn.shadow[5, 6] = 1.0, 0.5
    raster.draw_shadow(drawn, np.array([4, 6, 3, 5]), 0, 0.3)
    expected = np.full(drawn.colour.shape, 100.0)
    expected[6:8, 8:10], expected[10:12, 12:14] = 70.0, 85.0
    assert np.abs(drawn.colour - expected).max() <= 1.0 and not drawn.shadow.any()
    assert drawn.box.tolist() == [8, 13, 6, 11]


def test_a_pixel_is_the_rounded_mean_of_its_samples():
    """The ghost is blended over samples of its mask only, not over those of a line."""
    drawn = canvas(2)
    drawn.box[:] = 0, 2 * SHAPE[1] - 1, 0, 2 * SHAPE[0] - 1
    drawn.colour[:2, :2, 0] = [[10, 11], [11, 11]]
    drawn.mask[2, 2], drawn.mask[2, 4] = 1, 2
    raster.resolve(drawn, np.array([20.0, 180.0, 100.0]), 0.5)
    assert drawn.picture[0, 0].tolist() == [11, 100, 100]
    assert drawn.picture[1, 1].tolist() == [90, 110, 100], "a quarter of the pixel, by a half"
    drawn.picture[:2, :2] = 100
    assert (drawn.picture == 100).all(), "to the last row and column"
