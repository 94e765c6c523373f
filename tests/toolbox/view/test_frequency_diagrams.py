"""Pictures people expect: what they show are the numbers of the model, the loop, the runs and the episodes."""

from dataclasses import replace

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.model.vibration import rotating_frequencies
from flexman_gym.simulation.episode import Episode
from flexman_gym.toolbox.controllers.margins import margins, sampled_loops
from flexman_gym.toolbox.view import frequency_diagrams
from flexman_gym.toolbox.view.comparison import side_by_side
from flexman_gym.toolbox.view.frequency_diagrams import (
    bode_diagram,
    campbell_diagram,
    draw_mode_shapes,
    frequency_map,
)
from flexman_gym.toolbox.view.video import write_picture

from oracles.chains import slender_link

PLANAR = fm.build_model(fm.catalog.planar_2r(joint_stiffness=50.0), elements=1)


@pytest.fixture
def drawn(monkeypatch):
    """The figures that a room draws."""
    made = []

    def watch(room):
        new_figure = room.new_figure
        monkeypatch.setattr(
            room, "new_figure", lambda *given, **more: made.append(new_figure(*given, **more)) or made[-1]
        )
        return made

    return watch


def test_modes_are_side_by_side_and_each_is_another():
    picture = draw_mode_shapes(PLANAR, (0.3, 0.4), 3, (160, 120))
    assert picture.shape == (240, 320, 3) and (picture[120:, 160:] == 255).all()
    cells = [picture[:120, :160], picture[:120, 160:], picture[120:, :160]]
    assert all((one != other).any() for one in cells for other in cells if one is not other)
    with pytest.raises(ValueError, match=r"^model: it has no vibration mode"):
        draw_mode_shapes(fm.build_model(fm.catalog.planar_2r(), flexible_links=False, flexible_joints=False))


def test_the_map_has_the_frequency_of_each_posture(drawn, tmp_path, monkeypatch):
    monkeypatch.setattr(frequency_diagrams, "GRID_POINTS", 5)
    made = drawn(frequency_diagrams)
    frequency_map(PLANAR, tmp_path / "new" / "map.png", mode=2, span=1.0)
    (image,) = made[0].axes[0].images
    table = np.asarray(image.get_array()).T
    assert table[1, 4] == pytest.approx(fm.frequencies(PLANAR, (-0.5, 1.0), lock_joints=True)[1])
    with pytest.raises(ValueError, match=r"^mode: "):
        frequency_map(PLANAR, tmp_path / "a.png", mode=99)


@pytest.mark.parametrize("modes", [8, None])
def test_a_spinning_cantilever_stiffens_as_southwell_says(drawn, tmp_path, modes):
    """f^2 = f0^2 + 1.193 (rate / 2 pi)^2 out of the plane, less the square of the rate in it (Southwell, 1921)."""
    link = slender_link(1.0, 1.0, 1.0)
    round_link = replace(link, second_moment_y=link.second_moment_z)
    arm = fm.Arm([round_link], [fm.Joint((0.0, 0.0, 1.0), rotor_inertia=1.0)])
    model, rates = fm.build_model(arm, elements=4, modes=modes, stiffening=True), np.array([0.0, 1.0, 2.0])
    still, *spun = rotating_frequencies(model, rates)[:, :2]
    assert still == pytest.approx([3.516 / (2 * np.pi)] * 2, rel=1e-3)
    for rate, (inside, outside) in zip(rates[1:] / (2 * np.pi), spun, strict=True):
        assert (outside**2 - still[1] ** 2) / rate**2 == pytest.approx(1.193, abs=0.03)
        assert outside**2 - inside**2 == pytest.approx(rate**2, rel=0.03)
    made = drawn(frequency_diagrams)
    campbell_diagram(model, rates, tmp_path / "campbell.png", count=2)
    lines = made[0].axes[0].get_lines()
    assert lines[1].get_ydata() == pytest.approx(np.append(still[1], [each[1] for each in spun]))
    assert lines[3].get_ydata() == pytest.approx(2 * rates / (2 * np.pi)), "twice the rate"


def test_an_opened_loop_has_the_determinants_and_margins_of_the_closed_one():
    """1 + L = det(z - closed) / det(z - closed but for this motor)."""
    period, gains = 0.01, (np.array([40.0, 20.0]), np.array([4.0, 1.0]))
    loop, places = sampled_loops(PLANAR, (0.1, 0.5), period, 1)[0], np.array([0.5, 3.0, 20.0])
    responses = loop.open_loop_responses(*gains, places, period)
    for motor in range(2):
        gain = np.zeros((2, len(loop.transition)))
        gain[np.arange(2), loop.motors], gain[np.arange(2), loop.rates] = gains
        others = gain * (np.arange(2) != motor)[:, None]
        for place, response in zip(places, responses[motor], strict=True):
            z = np.exp(2j * np.pi * place * period) * np.eye(len(gain[0]))
            closed, opened = (np.linalg.slogdet(z - loop.transition + loop.inputs @ each) for each in (gain, others))
            expected = closed[0] / opened[0] * np.exp(closed[1] - opened[1])
            assert 1.0 + response == pytest.approx(expected, rel=1e-6)


def marked_margins(figure):
    """Return gain margin, its frequency (Hz), phase margin (degrees) and its frequency, as marked in a Bode diagram."""
    result = []
    for axes in figure.axes:
        marks = [line.get_xydata()[0] for line in axes.lines if line.get_marker() == "o"]
        result.append(np.reshape(marks, (-1, 2)).T)
    (gain_places, sizes), (phase_places, angles) = result
    return 1.0 / sizes, gain_places, abs(180.0 - abs((angles + 180.0) % 360.0 - 180.0)), phase_places


@pytest.mark.slow
def test_the_margins_of_the_diagram_are_at_least_those_of_the_pd_that_was_tuned(drawn, tmp_path):
    """Those take the least of one motor and of all of them."""
    setup = Configuration.from_keywords({"name": "FlexRRR-v0"})
    model, gains, period = resolve_fidelity(setup).model, setup.pd_gains, setup.control_period
    loop, fine = sampled_loops(model, (0.0, 0.3, -0.5), period)[0], np.geomspace(0.01, 0.5 / period, 1500)
    chosen = gains["stiffness"], gains["damping"]
    found, least = loop.open_loop_responses(*chosen, fine, period), margins([loop], *chosen)
    figures = drawn(frequency_diagrams)
    bode_diagram(fine, {str(motor): response for motor, response in enumerate(found)}, tmp_path / "bode.png")
    gains, _, phases, _ = marked_margins(figures[0])
    assert least.gain >= 2.0 and least.phase >= 30.0
    assert gains.min() > 0.99 * least.gain and phases.min() > least.phase - 0.5


@pytest.mark.slow
def test_crossings_of_an_integrator_with_two_lags_are_its_closed_form(drawn, tmp_path):
    """L = k / (s (s + 1)^2): the phase is -180 degrees at 1 rad/s, where the gain is k / 2."""
    places = np.geomspace(0.001, 10.0, 4000)
    s = 2j * np.pi * places
    response = 0.5 / (s * (s + 1.0) ** 2)
    figures = drawn(frequency_diagrams)
    path = bode_diagram(places, {"one": response}, tmp_path / "new" / "bode.png", "a loop")
    (gain,), (gain_place,), (phase,), (phase_place,) = marked_margins(figures[0])
    assert (gain, gain_place) == pytest.approx((4.0, 1 / (2 * np.pi)), rel=1e-4)
    place = 2j * np.pi * phase_place
    there = 0.5 / (place * (place + 1.0) ** 2)
    assert abs(there) == pytest.approx(1.0, rel=1e-4)
    assert phase == pytest.approx(180.0 + np.degrees(np.angle(there)), abs=0.01)
    assert path.stat().st_size > 10_000
    bode_diagram(places, {"small": 0.1 + 0.0 * s}, path)
    assert all(len(each) == 0 for each in marked_margins(figures[1]))


def test_episodes_side_by_side_share_the_camera_and_stay_at_their_ends():
    scene = fm.Scene(
        PLANAR.arm, PLANAR.choice, fm.ConstantTorque((2.0, 0.0)), fm.Initial((0.1, 0.2), (0.0, 0.0)), 0.4, 0.1
    )
    one = Episode.from_trajectory(fm.simulate(scene), "push")
    frames = side_by_side([one, one], size=(240, 120), rate=10.0, hold=0.3)
    assert len(frames) == 5 + 3 and frames[0].shape == (120, 240, 3)
    for frame in frames:
        assert np.array_equal(frame[40:100, :120], frame[40:100, 120:])
    assert all(np.array_equal(frame, frames[4]) for frame in frames[5:])
    assert (frames[0] != frames[-1]).any()
    with pytest.raises(ValueError, match=r"^episodes: "):
        side_by_side([])


def test_a_picture_is_a_png_with_its_pixels(tmp_path):
    image = pytest.importorskip("PIL.Image")
    frame = np.random.default_rng(0).integers(0, 256, (7, 5, 3)).astype(np.uint8)
    with image.open(write_picture(frame, tmp_path / "new" / "a.png")) as read:
        assert np.array_equal(np.asarray(read), frame)


def test_the_gain_margin_of_a_delayed_sampled_loop_is_at_its_nyquist_frequency(drawn, tmp_path):
    """L = k / z is real there, -k; a rounding error of its imaginary part may have either sign."""
    places, period = np.geomspace(0.1, 50.0, 400), 0.01
    figures = drawn(frequency_diagrams)
    response = 0.4 * np.exp(-2j * np.pi * places * period)
    response[-1] = complex(-0.4, np.copysign(1e-17, response[-2].imag))
    bode_diagram(places, {"one": response}, tmp_path / "bode.png")
    (gain,), (place,), *_ = marked_margins(figures[0])
    assert (gain, place) == pytest.approx((2.5, 50.0))
