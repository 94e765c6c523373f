"""Live page in Chromium: every control does what it is named for, charts show the physics, names stay text."""

import base64
import shutil
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.evaluation.policy_files import FOLDER
from flexman_gym.simulation.physical_parameters import varied_model

from oracles.browser import one_browser

EVIL = "<img src=x onerror=window.harm=1>"
READY = "window.replay && replay.views[0].tip.position.length() > 0 && replay.controls.state.values"
browser = pytest.fixture(one_browser, scope="module")


@pytest.fixture
def page(browser, tmp_path, monkeypatch):
    """Return a function that opens the page of a session in an empty folder, and returns the session."""
    monkeypatch.chdir(tmp_path)
    opened = []

    def open_one(*arguments):
        opened.append(fm.live(*arguments))
        browser.open(opened[-1].url, READY)
        return opened[-1]

    yield open_one
    for each in opened:
        each.close()
    assert browser.run("return window.harm") is None
    assert [line for line in browser.said() if "ERR_CONNECTION_REFUSED" not in line and "Bad Request" not in line] == []


def choose(browser, name, value, event="change"):
    """Set an input or a select of the page as a person does."""
    browser.run(
        "const each = document.querySelector(`#controls [name='${arguments[0]}'], #${arguments[0]}`);"
        "each.value = arguments[1]; for (const kind of ['input', arguments[2]])"
        "each.dispatchEvent(new Event(kind, { bubbles: true }));",
        name,
        value,
        event,
    )


def click(browser, name):
    browser.run("document.querySelector(`#controls [name='${arguments[0]}'], #${arguments[0]}`).click()", name)


def place(browser, name, view=0):
    """Return the pixel (x, y) at which the tip or the target of an arm is drawn."""
    return browser.run(
        "const { views, stage } = replay, { position } = views[arguments[1]][arguments[0]];"
        "const at = position.clone().project(stage.camera);"
        "const box = stage.canvas.getBoundingClientRect(), w = box.width / views.length;"
        "return [box.left + (arguments[1] + (at.x + 1) / 2) * w, box.top + (1 - at.y) / 2 * box.height]",
        name,
        view,
    )


def pause(browser):
    """Stop the time, and wait until the page shows the newest state."""
    click(browser, "play")
    browser.wait("replay.controls.state.paused && replay.shown()")


def step(browser, count):
    """Simulate control periods, and wait until the page shows them."""
    rows = browser.run("return replay.rows()[0]") + count
    browser.run("replay.controls.post({ step: arguments[0] })", count)
    browser.wait(f"replay.rows()[0] === {rows} && replay.shown()")


def push(browser, way, view=0):
    """Pull the tip with the mouse, in pixels, for ten control periods."""
    browser.wait("replay.shown()")
    browser.drag(place(browser, "tip", view), way, lambda: step(browser, 10))
    browser.run("return replay.controls.sent")


def test_a_softer_joint_rings_at_the_frequency_of_the_model_in_the_chart(browser, page):
    """The tip is pushed with the mouse; motors turn freely. The modes are those of an arm with a changed joint."""
    session = page("FlexOne-v0", "zero")
    model, measured = session._loops[0].episodes.batch.model, []
    pause(browser)
    for factor in (1.0, 10.0**-0.6):
        choose(browser, "joint_stiffness", np.log10(factor))
        browser.wait(f"Math.abs(replay.controls.state.values.joint_stiffness - {factor}) < 1e-9")
        browser.wait("replay.rows()[0] === 1")
        push(browser, (12, -12))
        step(browser, 240)
        browser.wait("replay.plots[2].u.data[0].at(-1) > replay.runs[0].last - 1e-6")
        times, strains = np.array(browser.run("return [0, 1].map(c => Array.from(replay.plots[2].u.data[c]))"))[
            :, -230:
        ]
        stiffness = factor * model.constants.joint_stiffness
        modes = fm.modes(varied_model(model, joint_stiffness=stiffness), motors="free").frequencies
        expected = modes[modes > 0.1][0]
        measured.append(fm.Ringing.estimate(times, strains).frequencies[0])
        assert measured[-1] == pytest.approx(expected, rel=0.02)
        (begin, name, force), (end, _, none) = session._events[0].rows
        assert (begin, name, end) == (0, "force", 10) and np.linalg.norm(force) > 0.01 and none == [0.0, 0.0, 0.0]
    assert measured[1] < 0.8 * measured[0]


def test_two_agents_move_beside_each_other_to_a_dragged_target(browser, page):
    session = page("FlexRRR-v0", "pd")
    choose(browser, "beside it", "lqr-tracking")
    browser.wait(f"{READY} && replay.runs.length === 2")
    pause(browser)
    before, target = place(browser, "target"), session._loops[0].episodes.view.target[0].copy()
    choose(browser, "grab", "target")
    browser.drag(before, (-30, -20))
    choose(browser, "grab", "push")
    browser.wait("!replay.views[0].aim && replay.rows()[0] > 0")
    views = [loop.episodes.view for loop in session._loops]
    moved = views[0].target[0] - target
    assert np.array_equal(views[0].target, views[1].target) and 0.05 < np.linalg.norm(moved) < 4.0
    step(browser, 1)
    assert np.linalg.norm(np.subtract(place(browser, "target"), before) - (-30, -20)) < 6.0
    assert browser.run("return replay.runs.map(run => run.name)") == ["pd", "lqr-tracking"]
    push(browser, (0, -25), view=1)
    assert session._events[0].rows == session._events[1].rows != []


def test_the_copied_code_gives_the_saved_episode(browser, page):
    session = page("FlexOne-v0", "pd")
    choose(browser, "delay", 1)
    browser.wait("replay.controls.state.values.delay === 1 && replay.rows()[0] > 2")
    choose(browser, "stiffness", 0.3, "input")
    browser.wait("Math.abs(replay.controls.state.gains.stiffness - 10 ** 0.3) < 1e-9")
    pause(browser)
    push(browser, (20, 10))
    click(browser, "save")
    browser.wait("replay.controls.state.message.startsWith('saved')")
    said = browser.run("return document.getElementById('note').textContent")
    click(browser, "code")
    browser.wait("document.querySelector('#controls textarea').value")
    names = {}
    exec(browser.run("return document.querySelector('#controls textarea').value"), names)
    saved = fm.Episode.load(said.split()[-1])
    assert np.array_equal(saved.states, names["episode"].states) and len(saved.time) == len(session._rows[0])
    assert {row[1] for row in session._events[0].rows} == {"gains", "force"}


def test_the_remaining_controls(browser, page):
    session = page("FlexOne-v0", "zero")
    choose(browser, "speed", "0.25")
    browser.wait("replay.controls.state.speed === 0.25")
    pause(browser)
    rows = browser.run("return replay.rows()[0]")
    click(browser, "step")
    browser.wait(f"replay.rows()[0] === {rows + 1}")
    click(browser, "next")
    browser.wait("replay.controls.state.seed === 9001 && replay.rows()[0] < 3")
    click(browser, "step")
    browser.wait("replay.rows()[0] > 1")
    click(browser, "again")
    browser.wait("replay.rows()[0] === 1")
    assert session.state()["seed"] == 9001
    choose(browser, "reading", browser.run("return document.getElementById('reading').value"))
    browser.press("gain", 0.9)
    assert float(browser.run("return document.getElementById('gain').value")) > 1.5
    choose(browser, "environment", "FlexRRR-v0")
    browser.wait(f"{READY} && document.title === 'FlexRRR-v0'")
    choose(browser, "condition", "friction")
    browser.wait(f"{READY} && document.title === 'FlexRRR-v0/friction'")
    assert "coulomb_friction" in browser.run("return Object.keys(replay.controls.sliders).join()")
    choose(browser, "agent", "ppo-flexplanar")
    browser.wait("document.getElementById('note').textContent.includes('ppo-flexplanar')")
    choose(browser, "agent", "pd")
    browser.wait(f"{READY} && replay.runs[0].name === 'pd'")


class Failing:
    """Controller that fails as long as it is told to."""

    sensors = ("motor_encoders",)
    fails = True

    def reset(self, arms, episode, count):
        pass

    def act(self, readings, applied, active):
        if Failing.fails:
            raise RuntimeError(EVIL)
        return np.zeros_like(applied)


def test_the_error_of_an_agent_is_on_the_page_and_a_new_episode_runs(browser, page, monkeypatch):
    monkeypatch.setattr(Failing, "fails", True)
    page("FlexOne-v0", Failing())
    browser.wait("document.getElementById('note').textContent.startsWith('Failing: RuntimeError: ')")
    assert browser.run("return [replay.controls.state.paused, replay.rows()]") == [True, [1]]
    monkeypatch.setattr(Failing, "fails", False)
    click(browser, "again")
    browser.wait("document.getElementById('note').textContent === '' && replay.rows()[0] === 1")
    click(browser, "play")
    browser.wait("replay.rows()[0] > 5")


def test_a_page_of_this_computer_shows_it_in_a_frame(browser, page, monkeypatch):
    """As a notebook does: the page in the frame receives the events."""
    session = page("FlexOne-v0", "zero")
    browser.open("about:blank", "true")
    text = f"<!doctype html><title>notebook</title>{session._repr_html_()}".encode()
    handler = type("Notebook", (BaseHTTPRequestHandler,), {"do_GET": lambda each: answer(each, text)})
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as notebook:
        threading.Thread(target=notebook.serve_forever, daemon=True).start()
        opened = threading.Event()
        monkeypatch.setattr(session._page, "stream", lambda write: opened.set())
        browser.open(f"http://127.0.0.1:{notebook.server_address[1]}/", "document.title === 'notebook'")
        assert opened.wait(60)
        notebook.shutdown()


def answer(request, text):
    """Answer a request with a page."""
    request.send_response(200)
    request.send_header("Content-Type", "text/html")
    request.end_headers()
    request.wfile.write(text)


@pytest.mark.parametrize("width", [390, 1280])
def test_it_fits_the_screen_and_a_folder_runs_no_script(width, browser, page, tmp_path):
    shutil.copytree(FOLDER / "ppo-flexrrr", tmp_path / "runs" / EVIL)
    browser.size(width, 720)
    page("FlexRRR-v0", f"runs/{EVIL}")
    browser.wait("replay.rows()[0] > 5")
    assert browser.run("return document.documentElement.scrollWidth") <= width
    assert f"runs/{EVIL}" in browser.run("return document.querySelector('.label b').textContent")
    labels = browser.run(
        "return [...document.querySelectorAll('#controls input')].map(each => each.labels[0].innerText)"
    )
    assert len(labels) > 5 and all(label.strip() for label in labels)
    click(browser, "save")
    browser.wait("replay.controls.state.message.startsWith('saved')")
    assert browser.run("return document.querySelectorAll('img').length") == 0
    assert len(base64.b64decode(browser.picture())) > 20_000
    browser.size(1280, 720)
