"""Frames: what is in them lies where a camera sees it, has the colours of its strain, and is the same again."""

import subprocess
import sys

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.common.plot_style import rgb
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.toolbox.view.frames import (
    BOUNDARY,
    GHOST,
    GHOST_SHARE,
    PAYLOAD,
    TARGET,
    TIP,
    FramePainter,
    arm_frame,
    grid,
    limiting_strains,
)
from flexman_gym.toolbox.view.mesh import CYLINDER, RING, SPHERE, boundaries, section_outlines, tube_surfaces
from flexman_gym.toolbox.view.overlay import WARNING, Caption, font_size, strain_colours, write_text

ARM = fm.catalog.paper_rrr()
MODEL = fm.build_model(ARM, modes=4)
BENT = MODEL.initial_state((0.4, 0.5, -0.8))
BENT[MODEL.elastic_columns(1)] = 2.0
TARGET_AT = (5.0, 1.0, 2.0)
CAPTION = Caption("title", 1.0, 0.1, 0.5, np.array([0.5, -0.5, 1.0]))
ONE = fm.build_model(fm.catalog.one_link())


@pytest.fixture(scope="module")
def painter():
    return FramePainter(MODEL, (320, 240), overlays=False)


def hue(picture, place, colour, radius=2):
    """How near to a hue the pixels around a column and a row are, as a cosine of colours less their grey."""
    column, row = np.rint(place).astype(int)
    part = (
        picture[row - radius : row + radius + 1, column - radius : column + radius + 1].astype(float).mean(axis=(0, 1))
    )
    one, other = part - part.mean(), rgb(colour) - rgb(colour).mean()
    return one @ other / (np.linalg.norm(one) * np.linalg.norm(other) + 1e-9)


def force(load, model=ONE):
    """The state of a clamped link under forces and moments (6,) at its tip."""
    columns, state = model.elastic_columns(0), np.zeros(2 * model.n_dof)
    inner = fm.stiffness_matrix(model)[columns, columns]
    state[columns] = np.linalg.solve(inner, model.bases[0][-6:].T @ np.array(load))
    return state


def test_a_frame_has_its_size_and_is_the_same_from_another_painter_and_after_others(painter):
    shot = painter.shot()
    first = painter.paint(BENT, TARGET_AT, shot=shot)
    assert (
        first.shape == (240, 320, 3) and first.dtype == np.uint8 and len(np.unique(first.reshape(-1, 3), axis=0)) > 99
    )
    kept = first.copy()
    for state, target in ((BENT, None), (MODEL.initial_state((0.0, 0.0, 0.0)), TARGET_AT)):
        assert (painter.paint(state, target) != first).any()
    painter.paint(BENT, shot=painter.shot([TARGET_AT]))
    assert np.array_equal(first, kept), "a later frame wrote into an earlier one"
    assert np.array_equal(painter.paint(BENT, TARGET_AT, shot=shot), first)
    other = FramePainter(MODEL, (320, 240), overlays=False)
    assert np.array_equal(other.paint(BENT, TARGET_AT), first), "all that it can reach, as above"


def test_target_tip_and_ghost_are_where_a_pinhole_sees_them(painter):
    shot = painter.shot()
    picture, empty = painter.paint(BENT, TARGET_AT, shot=shot), shot.plain
    assert hue(picture, shot.camera.project(np.array(TARGET_AT)), TARGET) > 0.95
    tip = shot.camera.project(fm.curves(MODEL, BENT, 2).positions[-1, -1])
    assert picture[tuple(np.rint(tip[::-1]).astype(int))].mean() < 2.5 * rgb(TIP).mean() < empty.min()
    ghost = fm.curves(MODEL, MODEL.initial_state((0.4, 0.5, -0.8)), 9).positions[1, 4]
    column, row = np.rint(shot.camera.project(ghost)).astype(int)
    patch = slice(row - 2, row + 3), slice(column - 2, column + 3)
    full = empty[patch] + GHOST_SHARE * (rgb(GHOST) - empty[patch])
    assert np.abs(picture[patch] - full).max(axis=2).min() < 2.0, "a pixel that the ghost covers wholly"
    column, row = np.rint(shot.camera.project(np.array([*TARGET_AT[:2], 0.5 * (TARGET_AT[2] + shot.floor)]))).astype(
        int
    )
    below = np.s_[row - 1 : row + 2, column - 1 : column + 2]
    change = np.abs(picture[below].astype(int) - painter.paint(BENT, shot=shot)[below])
    assert change.max() > 10, "a line from the target to the floor"


@pytest.mark.parametrize("gain", [1.0, 3.0])
def test_the_tip_is_drawn_where_the_gain_puts_it(gain):
    painter = FramePainter(MODEL, (320, 240), gain=gain, overlays=False)
    shot = painter.shot()
    picture, there = painter.paint(BENT, shot=shot), fm.curves(MODEL, BENT, 2, gain).positions[-1, -1]
    column, row = np.rint(shot.camera.project(there)).astype(int)
    assert picture[row, column].mean() < 90.0
    other = shot.camera.project(fm.curves(MODEL, BENT, 2, gain**2 + 1.0).positions[-1, -1])
    assert np.linalg.norm(other - (column, row)) > 8, "far enough apart to tell"
    column, row = np.rint(other).astype(int)
    assert picture[row, column].mean() > 120.0


def twisted():
    """A state whose second joint is wound up by 0.1 rad, and whose links are straight."""
    state = MODEL.initial_state((0.4, 0.5, -0.8))
    state[1] -= 0.1
    return state


def test_joints_are_wound_up_at_true_scale_unless_a_second_gain_is_given():
    drawn = []
    for gain in (1.0, 10.0, (10.0, 3.0)):
        painter = FramePainter(MODEL, (320, 240), gain=gain, overlays=False)
        drawn.append(painter.shot())
        picture, turned = painter.paint(twisted(), shot=drawn[-1]), 3.0 if isinstance(gain, tuple) else 1.0
        there = drawn[-1].camera.project(fm.curves(MODEL, twisted(), 2, 1.0, turned).positions[-1, -1])
        assert picture[tuple(np.rint(there[::-1]).astype(int))].max() < 120.0, gain
    same = [FramePainter(MODEL, (320, 240), gain=gain, overlays=False).paint(BENT) for gain in (4.0, (4.0, 9.0))]
    assert np.array_equal(*same), "no joint is wound up"


@pytest.mark.parametrize("name", ["FlexRRR-v0", "FlexPlanar-v0", "FlexQuanser-v0"])
def test_the_arm_its_base_and_target_leave_the_margins_of_the_text_free(name):
    """At gain 5 too: what differs from the background lies between the texts."""
    model = resolve_fidelity(Configuration.find(name)).model
    n = model.n_joints
    states = np.array([fm.rest_state(model, angles) for angles in (np.zeros(n), np.full(n, 0.7))])
    texts, bare = (FramePainter(model, gain=5.0, overlays=each, shadow=False) for each in (True, False))
    bent = fm.curves(model, states, 9, 5.0, 1.0)
    target = bent.positions[1, -1, -1]
    shot = texts.shot(bent.positions.reshape(-1, 3))
    above, below = (np.array([1.0, -1.0]) * Caption.margins(360)[2:] * 360 + (0, 360)).astype(int)
    for state in states:
        rows = np.flatnonzero((bare.paint(state, target, shot=shot) != shot.plain).any(axis=(1, 2)))
        assert above - 2 <= rows.min() and rows.max() <= below + 2, "a disc in perspective is a little larger"
        written = (texts.paint(state, target, CAPTION, shot=shot) != bare.paint(state, target, shot=shot)).any(axis=2)
        assert not written[above:below].any() and written.any()


def test_the_axes_of_the_base_point_right_away_and_up(painter):
    camera = painter.shot().camera
    origin, x, y, z = camera.project(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]]))
    assert x[0] > origin[0] and y[0] > origin[0] and y[1] < origin[1] and z[1] < origin[1] - 1
    assert z[0] == pytest.approx(origin[0], abs=1.0)
    centre, seen = np.array([3.0, -2.0, 1.0]), camera.axes @ (np.array([3.0, -2.0, 1.0]) - camera.eye)
    assert camera.project(centre) == pytest.approx(camera.lens[1:] + camera.lens[0] * seen[:2] / seen[2] * (1, -1))
    assert np.linalg.det(camera.axes) == pytest.approx(-1.0), "right, up and forward are left-handed"


@pytest.mark.parametrize("size", [(480, 360), (333, 217), (200, 500)])
def test_all_points_are_between_the_edges_and_two_of_them_touch(size):
    points = np.random.default_rng(0).normal(size=(40, 3)) * (3.0, 1.0, 2.0)
    painter = FramePainter(MODEL, size, (30.0, 20.0), overlays=False)
    camera, floor = painter.camera(points)
    discs = np.concatenate([points + turn * painter._largest_radius() * axis
                            for axis in camera.axes[:2] for turn in (-1.0, 1.0)])  # fmt: skip
    parts = camera.project(np.vstack([discs, np.zeros(3), [0.0, 0.0, floor]])) / size
    assert floor < points[:, 2].min() and (parts > 0.06 - 1e-9).all() and (parts < 0.94 + 1e-9).all()
    assert ((parts.min(axis=0) < 0.065) & (parts.max(axis=0) > 0.935)).any()
    nearer = painter.camera(points)[0].eye, FramePainter(MODEL, size, (30.0, 20.0, 2.0)).camera(points)[0].eye
    assert np.linalg.norm(nearer[1] - points.mean(axis=0)) < 0.75 * np.linalg.norm(nearer[0] - points.mean(axis=0))


# Surfaces and their colours


def test_surfaces_are_closed_and_point_outwards():
    straight = fm.curves(ONE, np.zeros(2 * ONE.n_dof), 5)
    links, _ = tube_surfaces(straight, section_outlines(ONE, 5))
    for points, normals, faces in (links, CYLINDER, SPHERE, RING):
        a, b, c = (points[faces[:, k]] for k in range(3))
        across = np.cross(b - a, c - a)
        assert (a * across).sum() / 6 > 0.0 and np.allclose(across.sum(axis=0), 0.0, atol=1e-12), "a volume, no hole"
        outward = np.linalg.norm(across, axis=1) > 1e-9
        smooth = normals[faces[outward]].sum(axis=1)
        assert (np.sign((smooth * across[outward]).sum(axis=1)) >= 0).mean() > 0.95


def test_sections_turn_with_the_twist_and_show_the_strain_of_bending():
    """-y v'' + z (-w'') at the true edge of the section, and y turns towards z under a positive moment."""
    sections, link = section_outlines(ONE, 5), fm.catalog.one_link().links[0]
    state = force([0.0, 7.0, 0.0, 0.0, 0.0, 0.0])
    tubes, strain = tube_surfaces(fm.curves(ONE, state, 5), sections)
    edge = np.abs(sections[0].gauges[..., 0]).max()
    expected = 7.0 * link.length * edge / (link.youngs_modulus * link.second_moment_z)
    root = strain.reshape(5, -1)[0]
    assert root.max() == pytest.approx(expected) and root.min() == pytest.approx(-expected)
    assert tubes.points.reshape(5, -1, 3)[0, root.argmin(), 1] > 0.0, "bent to +y, compressed there"
    twisted, _ = tube_surfaces(fm.curves(ONE, force([0, 0, 0, 30.0, 0, 0]), 5, 20.0), sections)
    first, last = twisted.points.reshape(5, -1, 3)[[0, -1], :, 1:]
    assert (first[:, 0] * last[:, 1] - first[:, 1] * last[:, 0] > 0.0).all(), "counter-clockwise about +x"


def test_colours_run_from_blue_over_grey_to_red_with_the_scale_at_their_ends():
    ends = strain_colours(np.array([-2.0, -1.0, 0.0, 1.0, 2.0]))
    assert np.array_equal(ends[0], ends[1]) and np.array_equal(ends[3], ends[4])
    assert ends[1, 2] > 180 > ends[1, 0] and ends[3, 0] > 180 > ends[3, 2] and np.ptp(ends[2]) < 10
    half = strain_colours(np.array([0.5]))[0]
    assert half == pytest.approx((ends[2] + ends[3]) / 2)


@pytest.mark.parametrize(("sign", "colour"), [(1.0, "#c0202c"), (-1.0, "#2f57c8")])
def test_the_side_that_is_stretched_is_red(sign, colour):
    """From in front the side at -y is seen: a force to +y stretches it; at the scale the colour is full."""
    painter = FramePainter(ONE, (320, 240), (-90.0, 0.0), overlays=False)
    link, edge = fm.catalog.one_link().links[0], np.abs(section_outlines(ONE, 2)[0].gauges[..., 0]).max()
    load = painter.scale * link.youngs_modulus * link.second_moment_z / (edge * link.length)
    state, shot = force([0.0, sign * load, 0.0, 0.0, 0.0, 0.0]), painter.shot()
    picture = painter.paint(state, shot=shot)
    root, tip = shot.camera.project(fm.curves(ONE, state, 9).positions[0, [2, 7]])
    assert hue(picture, root, colour, 1) > 0.97
    strong, weak = (np.ptp(picture[tuple(np.rint(place[::-1]).astype(int))].astype(float)) for place in (root, tip))
    assert strong > 30.0 and strong > 2.0 * weak, "less strain towards the tip"


def test_the_scale_ends_at_the_strain_of_half_a_torque_limit_at_the_root():
    """Surface strain of a bent beam: half of the thickness times moment over E I."""
    link = fm.Link.strip(0.5, 0.04, 0.002, "y")
    limit = 2.0 * 1e-3 * 0.999 * link.youngs_modulus * 0.04 * 0.002**3 / 12.0 / 0.001
    arm = fm.Arm([link], [fm.Joint((0.0, 0.0, 1.0), rotor_inertia=1.0, torque_limit=limit)])
    assert FramePainter(fm.build_model(arm)).scale == pytest.approx(1e-3)


REGIONS = {
    "half_space": ((0.0, 3.0, 4.0), 10.0),
    "box": ((-100.0, -2.0, -100.0), (3.0, 100.0, 100.0)),
    "sphere": ((4.0, 0.0, 0.0), 3.0),
}


@pytest.mark.parametrize("shape", REGIONS)
def test_boundaries_of_a_workspace_lie_on_it_within_the_reach_and_are_drawn_there(shape, painter):
    region = {shape: REGIONS[shape]}
    lines = boundaries([region], painter.reach)
    limits = fm.Limits(workspace=[region])
    depths = limits.depths(np.concatenate(lines))
    assert np.abs(depths).max() < 1e-12 and max(np.linalg.norm(line, axis=1).max() for line in lines) < 8.5 + 1e-5
    assert (np.ptp(np.concatenate(lines), axis=0) > 5.9).all(), "seen from every side"
    gaps = [np.linalg.norm(np.diff(line, axis=0), axis=1).max() for line in lines]
    assert max(gaps) < 2.5 and boundaries([{"half_space": ((0.0, 0.0, 1.0), 9.0)}], 8.5) == []
    shown = FramePainter(MODEL, (320, 240), overlays=False, shadow=False)
    shown.workspace = limits.workspace
    shot = shown.shot()
    picture, plain = shown.paint(BENT, shot=shot), painter.paint(BENT, shot=painter.shot())
    places = shot.camera.project(np.concatenate(lines))
    inside = places[((places > 4) & (places < np.array([316, 236]))).all(axis=1)]
    assert np.mean([hue(picture, place, BOUNDARY) > 0.9 for place in inside]) > 0.8
    assert np.mean([hue(plain, place, BOUNDARY) > 0.9 for place in inside]) < 0.1


def test_a_limit_at_the_gauges_is_a_strain_at_the_surface():
    """Radius / radius of gyration: 2 for a round rod, the root of 3 for a strip; each link has its own colours."""
    rod, strip = fm.Link.rod(1.0, 0.01), fm.Link.strip(1.0, 0.04, 0.005)
    model = fm.build_model(fm.Arm([rod, strip], [fm.Joint((0.0, 0.0, 1.0))] * 2), 1)
    assert limiting_strains(model, (1e-3, 2e-3)) == pytest.approx((2e-3, 2e-3 * 3.0**0.5))
    painters = [FramePainter(MODEL, (320, 240), overlays=False) for _ in range(3)]
    painters[1].scale, painters[2].scale = np.full(3, painters[0].scale), np.array([1e3, 1e3, 1e3])
    first, second, third = (each.paint(BENT) for each in painters)
    assert np.array_equal(first, second) and (first != third).any()


def test_the_overlay_shows_the_strain_over_its_limit_in_red_above_it():
    reds = []
    for strain in (None, 0.99, 1.01):
        picture = np.full((360, 480, 3), 255, dtype=np.uint8)
        Caption(strain=strain).draw(picture, (1.0, 1.0), 0.0, 1.0)
        reds.append((picture[300:] == rgb(WARNING)).all(axis=2).any())
    assert reds == [False, False, True]


@pytest.mark.parametrize("mass", [3000.0, 24000.0])
def test_a_payload_is_a_ball_of_steel_of_its_mass(mass):
    """4/3 pi r^3 times the density, about the place where it is held."""
    model = fm.build_model(fm.catalog.paper_rrr(payload=fm.Payload(mass, offset=(0.3, 0.0, 0.1))), modes=2)
    painter = FramePainter(model, (64, 48), overlays=False)
    state = model.initial_state((0.4, 0.5, -0.8))
    painter.paint(state)
    bent = fm.curves(model, state, 2)
    parts = painter._parts(bent.positions, bent.frames, None, np.zeros(3))
    (ball,) = [mesh for mesh, colour in parts if colour == PAYLOAD]
    centre = bent.positions[-1, -1] + bent.frames[-1, -1] @ np.array([0.3, 0.0, 0.1])
    radii = np.linalg.norm(ball.points - centre, axis=1)
    assert 7800.0 * 4.0 / 3.0 * np.pi * radii**3 == pytest.approx(mass)


def test_a_shadow_lies_on_the_floor_and_the_arm_over_it(painter):
    shot = painter.shot()
    flat, up = (painter.paint(MODEL.initial_state(angles), shot=shot) for angles in ((0.0, 0.0, 0.0), (0.0, 1.4, 0.0)))
    darker = [(frame.astype(int) - shot.plain).sum(axis=2) < -30 for frame in (flat, up)]
    assert darker[0].sum() > 500 and (darker[0] != darker[1]).sum() > 300


# Numbers over the picture


def test_overlays_say_time_error_torques_and_a_gain_and_can_be_left_out():
    plain, spoken = (FramePainter(MODEL, (320, 240), None, 2.0, overlays) for overlays in (False, True))
    shot = spoken.shot()
    assert np.array_equal(plain.paint(BENT, shot=shot), plain.paint(BENT, caption=Caption("a", 1.0, 0.1), shot=shot))
    bare = spoken.paint(BENT, shot=shot)
    for caption in (Caption("title"), Caption(time=1.0), Caption(error=0.01), Caption(reward=0.5)):
        changed = (spoken.paint(BENT, caption=caption, shot=shot) != bare).any(axis=2)
        assert changed.any() and not changed[60:].any(), "above"
    up, down = (spoken.paint(BENT, caption=Caption(torques=np.array([t, 0, 0])), shot=shot) for t in (0.9, -0.9))
    rows = np.flatnonzero((up != down).any(axis=(1, 2)))
    assert rows.min() > 120 and (up != down).any(axis=(0, 2)).nonzero()[0].min() > 200, "below, at the right"
    assert (bare != FramePainter(MODEL, (320, 240)).paint(spoken.model.initial_state(np.zeros(3)), shot=shot)).any()


def test_letters_have_shapes_and_unknown_ones_are_question_marks():
    def written(text):
        picture = np.full((20, 60, 3), 255, dtype=np.uint8)
        size = font_size(len(picture))
        write_text(picture, text, (size, size // 2), size)
        return picture

    def width(text):
        return np.flatnonzero((written(text) < 255).any(axis=(0, 2))).max()

    assert written("8").min() < 60 and width("ab") > width("a")
    assert np.array_equal(written("\N{SNOWMAN}"), written("?")) and (written("") == 255).all()


def test_a_grid_has_every_frame_in_its_place():
    frames = [np.full((4, 6, 3), value, dtype=np.uint8) for value in range(5)]
    result = grid(frames)
    assert result.shape == (8, 18, 3)
    assert result[0, ::6, 0].tolist() == [0, 1, 2] and result[4, ::6, 0].tolist() == [3, 4, 255]
    for wrong in ([], [frames[0], frames[0][1:]]):
        with pytest.raises(ValueError, match=r"^frames: "):
            grid(wrong)


@pytest.mark.slow
def test_frames_need_no_matplotlib():
    script = "import sys; sys.modules['matplotlib'] = sys.modules['PIL'] = None\n" \
             "import flexman_gym as fm; m = fm.build_model(fm.catalog.one_link())\n" \
             "print(fm.draw.arm_frame(m, m.initial_state([0.1])).shape)"  # fmt: skip
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "(360, 480, 3)"


def test_bad_input_is_refused_in_one_line(painter):
    for field, attempt in {
        "state": lambda: painter.paint(BENT[:-1]),
        "state[0]": lambda: painter.paint(np.full(len(BENT), np.nan)),
        "target": lambda: painter.paint(BENT, (1.0, 2.0)),
        "trail": lambda: painter.paint(BENT, trail=np.zeros((4, 2))),
        "size": lambda: FramePainter(MODEL, 480),
        "size[1]": lambda: FramePainter(MODEL, (480, 0)),
        "camera": lambda: FramePainter(MODEL, camera=(1.0,)),
        "camera[1]": lambda: FramePainter(MODEL, camera=(1.0, 90.0)),
        "camera[2]": lambda: FramePainter(MODEL, camera=(1.0, 80.0, 0.0)),
        "gain": lambda: FramePainter(MODEL, gain=-1.0),
        "gain[1]": lambda: FramePainter(MODEL, gain=(1.0, -1.0)),
        "overlays": lambda: FramePainter(MODEL, overlays=1),
        "model": lambda: arm_frame(ARM, BENT),
    }.items():
        with pytest.raises(ValueError) as error:
            attempt()
        assert str(error.value).startswith(f"{field}: ") and "\n" not in str(error.value)
