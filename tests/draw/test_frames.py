"""Draw: the lines of an arm end where the simulator puts its tip, and pictures show what they are given."""

import sys

import numpy as np
import pytest
from matplotlib.image import imread

from flexman_gym.draw import frames
from flexman_gym.draw.figures import paper_figures
from flexman_gym.draw.frames import AZIMUTH, DISTANCE, ELEVATION, FramePainter, arm_frame, arm_lines
from flexman_gym.draw.style import BLUE, LIGHT, ORANGE, RED
from flexman_gym.model.model import build_model
from flexman_gym.scene import catalog
from flexman_gym.scene.arm import Arm, Joint
from flexman_gym.scene.choice import ModelChoice
from flexman_gym.scene.drive import ConstantTorque
from flexman_gym.scene.scene import Initial, Scene
from flexman_gym.simulation.scenes import simulate
from flexman_gym.simulation.simulator import Simulator

ARM = catalog.paper_rrr()
ANGLES = (0.4, 0.5, -0.8)
SHADOW, GHOST = "#c9ccd2", "#6b7280"


def trajectory(flexible_links, flexible_joints, output_step=0.01, arm=ARM):
    n = arm.n_joints
    choice = ModelChoice(flexible_links, 1, flexible_joints=flexible_joints)
    start = Initial((0.0,) * n, (0.0,) * n)
    return simulate(Scene(arm, choice, ConstantTorque((400.0,) * n), start, 0.05, output_step), method="rk4", step=1e-5)


@pytest.fixture(scope="module")
def cases():
    return [trajectory(False, False), trajectory(True, False), trajectory(True, True)]


@pytest.mark.parametrize("modes", [None, 4, 0])
@pytest.mark.parametrize("elements", [1, 3])
@pytest.mark.parametrize("stiffening", [False, True])
def test_the_lines_of_a_deformed_arm_end_at_its_tip(stiffening, elements, modes):
    model = build_model(ARM, elements=elements, modes=modes, stiffening=stiffening)
    simulator = Simulator(model)
    state = simulator.state.copy()
    state[: model.n_dof] = np.random.default_rng(1).normal(0.0, 0.1, model.n_dof)
    simulator.reset(state=state)
    lines = arm_lines(model, state)
    assert np.allclose(lines[-1, -1], simulator.tip, rtol=0.0, atol=1e-12)
    assert np.array_equal(lines[1:, 0], lines[:-1, -1])


def test_the_lines_follow_a_simulation(cases):
    model = build_model(ARM, elements=1)
    for state, tip in zip(cases[2].states, cases[2].tip, strict=True):
        assert np.allclose(arm_lines(model, state)[-1, -1], tip, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("flexible", [True, False, (False, True, False)])
def test_the_lines_of_an_undeformed_arm_are_straight(flexible):
    model = build_model(ARM, flexible_links=flexible)
    points = 7
    lines = arm_lines(model, model.initial_state(ANGLES), points)
    assert lines.shape == (3, points, 3)
    for line, link in zip(lines, ARM.links, strict=True):
        along = np.linspace(0.0, 1.0, points)[:, None]
        assert np.allclose(line, line[0] + along * (line[-1] - line[0]), rtol=0.0, atol=1e-13)
        assert np.linalg.norm(line[-1] - line[0]) == pytest.approx(link.length, rel=1e-13)


def test_a_tip_load_bends_a_link_into_the_cubic_of_a_cantilever():
    """w(x) = w(L) (3 (x/L)^2 - (x/L)^3) / 2, on a mesh of any number of elements."""
    arm = catalog.one_link()
    model = build_model(arm, elements=3)
    stiffness = model.constants.stiffness[: 18 * 18].reshape(18, 18)
    load = np.zeros(18)
    load[13] = 1.0  # v of the last node
    state = model.initial_state([0.0])
    state[model.elastic_columns(0)] = np.linalg.solve(stiffness, load)
    x, y, z = arm_lines(model, state, points=20)[0].T
    link, along = arm.links[0], np.linspace(0.0, 1.0, 20)
    sag = link.length**3 / (3.0 * link.youngs_modulus * link.second_moment_z)
    assert np.allclose(y, sag * (3.0 * along**2 - along**3) / 2.0, rtol=1e-9, atol=0.0)
    assert np.allclose(x, link.length * along) and np.allclose(z, 0.0)


def test_a_bent_link_that_shortens_keeps_its_length_all_the_way_along_the_line():
    """Its points stay as far apart as they were, to the fourth order of the slope."""
    model, points = build_model(catalog.one_link(), elements=3, modes=1, stiffening=True), 200
    state = model.initial_state([0.0])
    state[model.elastic_columns(0)] = 1.0
    state[model.elastic_columns(0)] = 0.1 * model.constants.length[0] / arm_lines(model, state)[0, -1, 1]
    (line,) = arm_lines(model, state, points)
    apart = np.linalg.norm(np.diff(line, axis=0), axis=1) * (points - 1) / model.constants.length[0]
    assert abs(line[-1, 1]) > 0.09 * model.constants.length[0] and apart == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("size", [(480, 360), (333, 217), (200, 500)])
def test_a_frame_has_the_size_asked_for_and_is_not_blank(size):
    model = build_model(ARM, modes=2)
    frame = arm_frame(model, model.initial_state(ANGLES), (5.0, 1.0, 2.0), size)
    assert frame.shape == (size[1], size[0], 3) and frame.dtype == np.uint8
    assert len(np.unique(frame.reshape(-1, 3), axis=0)) > 20


def test_a_painter_shows_state_and_target_and_forgets_the_last_frame():
    model = build_model(ARM, modes=2)
    painter = FramePainter(model)
    straight, raised = model.initial_state((0.0, 0.0, 0.0)), model.initial_state(ANGLES)
    bent = straight.copy()
    bent[model.elastic_columns(1)] = 0.5
    first = painter.paint(straight)
    kept = first.copy()
    for other in (painter.paint(raised), painter.paint(bent), painter.paint(straight, (5.0, 1.0, 2.0))):
        assert (other != first).any()
    assert np.array_equal(first, kept), "a later frame wrote into an earlier one"
    assert np.array_equal(painter.paint(straight), first)


def test_nothing_of_the_arm_is_cut_off_above_the_ground():
    """A border of the picture stays white, but for the note in the corner, wherever the arm points."""
    model = build_model(ARM, modes=0)
    painter = FramePainter(model)
    for turn in np.linspace(0.0, 2 * np.pi, 9):
        for angles in ((turn, 0.0, 0.0), (turn, np.pi / 2, 0.0), (turn, np.pi / 4, 0.0)):
            frame = painter.paint(model.initial_state(angles))
            assert (frame[:3] == 255).all() and (frame[:, :3] == 255).all() and (frame[:, -3:] == 255).all()


def test_bad_input_is_refused_in_one_line():
    model = build_model(ARM, modes=0)
    state = model.initial_state(ANGLES)
    painter = FramePainter(model)
    for field, attempt in {
        "state": lambda: painter.paint(state[:-1]),
        "state[0]": lambda: painter.paint(np.full(len(state), np.nan)),
        "target": lambda: painter.paint(state, (1.0, 2.0)),
        "points": lambda: arm_lines(model, state, 1),
        "size": lambda: FramePainter(model, 480),
        "size[1]": lambda: FramePainter(model, (480, 0)),
    }.items():
        with pytest.raises(ValueError) as error:
            attempt()
        assert str(error.value).startswith(f"{field}: ") and "\n" not in str(error.value)


def test_paper_figures_are_written(cases, tmp_path):
    paths = paper_figures(*cases, tmp_path / "new" / "folder")
    assert [path.name for path in paths] == [f"figure_{i:02d}.png" for i in range(6, 12)] + ["paper_figures.png"]
    for path in paths:
        picture = imread(path)
        assert min(picture.shape[:2]) > 300 and len(np.unique(picture)) > 20


def test_paper_figures_refuse_what_does_not_fit_together(cases, tmp_path):
    rigid, links, both = cases
    with pytest.raises(ValueError, match=r"^flexible_both\.time: .*output times of the rigid case$"):
        paper_figures(rigid, links, trajectory(True, True, output_step=0.025), tmp_path)
    planar = trajectory(False, False, arm=catalog.planar_2r())
    with pytest.raises(ValueError, match=r"^flexible_links\.joint_angles: .*; give 3 joints"):
        paper_figures(planar, links, both, tmp_path)
    assert not list(tmp_path.iterdir())


def test_without_matplotlib_one_line_names_the_extra(cases, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    for attempt in (lambda: FramePainter(build_model(ARM, modes=0)), lambda: paper_figures(*cases, tmp_path)):
        with pytest.raises(ImportError, match=r"^pictures need Matplotlib: pip install 'flexman_gym\[render\]'$"):
            attempt()


# What is seen


def of_colour(frame, text):
    """Where a frame (height, width, 3) has exactly a colour such as "#0072b2"."""
    return (frame == [int(text[i : i + 2], 16) for i in (1, 3, 5)]).all(axis=2)


def folded(angle):
    """A frame of two links in one plane with the camera: the first to the right, the second turned by an angle."""
    link, right = catalog.one_link().links[0], np.array([-np.sin(AZIMUTH), np.cos(AZIMUTH), 0.0])
    along, across = np.cos(ELEVATION) * np.cos(AZIMUTH), np.cos(ELEVATION) * np.sin(AZIMUTH)
    towards = np.array([along, across, np.sin(ELEVATION)])
    first = np.array([right, [-right[1], right[0], 0.0], [0.0, 0.0, 1.0]])  # axes of the first link, as rows
    arm = Arm([link, link], [Joint((0.0, 0.0, 1.0), 1.0), Joint(first @ np.cross(right, towards), 1.0)])
    model = build_model(arm, flexible_links=False)
    return arm_frame(model, model.initial_state((np.arctan2(right[1], right[0]), angle)))


@pytest.mark.parametrize(("angle", "above", "below"), [(np.pi - 0.4, ORANGE, BLUE), (0.4 - np.pi, BLUE, ORANGE)])
def test_where_two_links_overlap_the_nearer_one_is_on_top(angle, above, below):
    """The second, orange one comes back over the first, blue one, nearer to the camera or farther from it."""
    frame = folded(angle)
    assert of_colour(frame, above).sum() > 300 > 30 > of_colour(frame, below).sum()


def test_the_shadow_lies_on_the_ground_below_the_arm():
    """That of a raised link lies where a lying one would, as long as the cosine says; one that points up has none."""
    model = build_model(catalog.one_link((0.0, -1.0, 0.0)), flexible_links=False)
    flat, raised, upright = (arm_frame(model, model.initial_state((angle,))) for angle in (0.0, 1.0, np.pi / 2))
    shadow, lying = of_colour(raised, SHADOW), (flat != upright).any(axis=2)
    assert shadow.sum() > 200 and not (shadow & ~lying).any()
    columns, whole = np.flatnonzero(shadow.any(axis=0)), np.flatnonzero(of_colour(flat, BLUE).any(axis=0))
    assert np.ptp(columns) == pytest.approx(np.cos(1.0) * np.ptp(whole), rel=0.15), "seen from somewhat nearer"
    link = np.argwhere(of_colour(raised, BLUE))
    assert link[link[:, 1] == columns[-1], 0].max() < np.flatnonzero(shadow[:, columns[-1]]).min(), "the link is above"
    assert not of_colour(upright, SHADOW).any()


def seen(places, reach):
    """Where rays from a camera to places (p, 3) go through the plane of the base that the camera looks at."""
    right, along = np.array([-np.sin(AZIMUTH), np.cos(AZIMUTH), 0.0]), np.array([np.cos(AZIMUTH), np.sin(AZIMUTH), 0.0])
    towards = np.cos(ELEVATION) * along + np.sin(ELEVATION) * np.array([0.0, 0.0, 1.0])
    camera = DISTANCE * reach * towards
    rays = np.asarray(places) - camera
    hits = camera - rays * (DISTANCE * reach / (rays @ towards))[:, None]
    return np.column_stack([hits @ right, hits @ np.cross(towards, right)])


@pytest.fixture
def axes(monkeypatch):
    """Gives the axes of a painter."""
    made, new_figure = [], frames.new_figure
    monkeypatch.setattr(frames, "new_figure", lambda *given: made.append(new_figure(*given)) or made[-1])

    def painted(*given):
        FramePainter(build_model(ARM, modes=1)).paint(*given)
        return made[-1].axes[0]

    return painted


def curves(axes, colour):
    """What the lines without markers of a colour show, in the order in which they were drawn."""
    lines = [line for line in axes.get_lines() if line.get_color() == colour and line.get_marker() == "None"]
    return [np.column_stack(line.get_data()) for line in lines]


def test_the_thin_line_is_the_rigid_arm_at_the_motor_angles_as_a_camera_sees_it(axes):
    """Joints are elsewhere, as far as springs are wound up."""
    model = build_model(ARM, modes=1)
    state = model.initial_state((0.0, 0.0, 0.0))
    state[model.motor_columns] = ANGLES
    places = arm_lines(model, model.initial_state(ANGLES), points=2).reshape(-1, 3)
    (result,) = curves(axes(state), GHOST)
    assert result == pytest.approx(seen(places, model.constants.length.sum()), abs=1e-9)


def test_a_line_hangs_from_the_target_to_the_ground_below_it(axes):
    model = build_model(ARM, modes=1)
    result = curves(axes(model.initial_state(ANGLES), (3.0, 1.0, 2.0)), RED)[0]
    assert result == pytest.approx(seen([(3.0, 1.0, 2.0), (3.0, 1.0, 0.0)], model.constants.length.sum()), abs=1e-9)


def test_circles_and_axes_are_where_the_picture_says(axes):
    model = build_model(ARM, modes=1)
    reach, result = model.constants.length.sum(), axes(model.initial_state(ANGLES))
    said = {text.get_text(): np.array(text.get_position()) for text in result.texts}
    (note,) = (text for text in said if text.startswith("circles every "))
    radii = float(note.split()[2]) * np.arange(1, 10)
    radii = radii[radii < reach]
    drawn = curves(result, LIGHT)
    assert len(drawn) == len(radii) + 2 > 4
    for radius, circle in zip(radii, drawn, strict=False):
        turn = np.linspace(0.0, 2 * np.pi, len(circle))
        places = radius * np.column_stack([np.cos(turn), np.sin(turn), 0.0 * turn])
        assert circle == pytest.approx(seen(places, reach), abs=1e-9)
    ends = seen([(reach, 0.0, 0.0), (0.0, reach, 0.0)], reach)
    assert [np.linalg.norm(ends - said[name], axis=1).argmin() for name in "xy"] == [0, 1]
