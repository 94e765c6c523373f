"""Live page of an environment that shows itself: every step comes to each browser, in all episodes."""

import base64
import threading
import urllib.error
import urllib.request

import gymnasium as gym
import numpy as np
import pytest

from flexman_gym.toolbox.view.live_page import LivePage

from oracles.browser import one_browser

EVIL = "</title><img src=x onerror=window.harm=1>"
browser = pytest.fixture(one_browser, scope="module")


@pytest.fixture
def human():
    """An environment that shows itself."""
    env = gym.make("FlexOne-v0", render_mode="human", disable_env_checker=True)
    env.reset(seed=5000)
    yield env
    env.close()


def page_of(env):
    return env.unwrapped._rendering.page


def test_every_step_comes_to_whoever_listens(human, capsys):
    human.step(np.ones(1, dtype=np.float32))
    screen, rows = page_of(human), []
    assert screen.url.startswith("http://127.0.0.1:") and human.render() is None
    model = human.unwrapped.simulator.model

    def listen():
        with urllib.request.urlopen(screen.url + "live", timeout=30) as stream:
            while len(rows) < 4:
                line = stream.readline()
                if line.startswith(b"data: ") and not line.startswith(b"data: {"):
                    rows.append(np.frombuffer(base64.b64decode(line[6:]), "<f4"))

    thread = threading.Thread(target=listen)
    thread.start()
    states = []
    while thread.is_alive():
        states.append(human.unwrapped.simulator.state[: model.n_dof].copy())
        human.step(np.ones(1, dtype=np.float32))
    thread.join()
    assert np.array_equal(rows[1][: model.n_dof], states[0].astype("f4")), (
        "after the reset, the step before it listened"
    )
    assert rows[1][-4] == 1.0 and len(rows[0]) == model.n_dof + 3 + 1 + 1 + 3
    with urllib.request.urlopen(screen.url) as page:
        assert b'<script type="application/json" id="data">{"live":true}</script>' in page.read()
    strains = human.unwrapped.episodes.view.root_strains[0]
    assert np.abs(strains).max() > 0.0 == rows[0][-1]
    with pytest.raises(urllib.error.HTTPError, match="404") as refused:
        urllib.request.urlopen(screen.url + "else")
    refused.value.close()  # the answer holds the socket
    assert 0 <= screen.late <= screen.shown


def test_the_address_is_said_once_and_late_steps_at_the_end(human, capfd):
    human.reset(seed=5001)
    human.step(np.zeros(1, dtype=np.float32))
    screen = page_of(human)
    screen.late = 1
    human.close()
    said = capfd.readouterr().err
    assert f"1 of {screen.shown} steps came late" in said and "can be seen" not in said
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(screen.url)


def test_a_page_is_there_before_its_arm(browser, human):
    page = LivePage()
    try:
        browser.open(page.url, "document.getElementById('note').textContent === 'the arm is being built'")
        assert browser.run("return [window.replay === undefined, document.title]") == [True, "flexman_gym"]
        page.begin(human.unwrapped._rendering.scene([EVIL], 0.02)._replace(title=EVIL))
        browser.wait("window.replay !== undefined && document.getElementById('note').textContent === ''")
        assert browser.run("return [document.title, document.getElementById('title').textContent]") == [EVIL, EVIL]
        assert browser.run("return [window.harm ?? null, replay.rows()]") == [None, [0]] and browser.said() == []
    finally:
        page.close()


def test_a_graphics_card_draws_smooth_edges_and_shadows(browser, human):
    """Named like a card, the software of this computer draws as one."""
    name = "const { prototype } = WebGL2RenderingContext, { getParameter } = prototype;"
    name += "prototype.getParameter = function (n) { return n === 0x9246 ? 'card' : getParameter.call(this, n); };"
    script = browser.devtools("Page.addScriptToEvaluateOnNewDocument", source=name)
    human.step(np.ones(1, dtype=np.float32))
    look = "const { stage } = replay; return [stage.coarse, stage.canvas === document.getElementById('gl'),"
    look += "stage.renderer.getContext().getContextAttributes().antialias, stage.renderer.shadowMap.enabled]"
    browser.open(page_of(human).url, "window.replay && replay.frames() > 0")
    assert browser.run(look) == [False, True, True, True]
    browser.devtools("Page.removeScriptToEvaluateOnNewDocument", **script)
    browser.open(page_of(human).url, "window.replay && replay.frames() > 0")
    assert browser.run(look) == [True, True, False, False] and browser.said() == []


@pytest.mark.slow
def test_a_browser_follows_the_arm_through_episodes(browser, human):
    browser.open(page_of(human).url)
    for seed, steps in ((5000, 5), (5001, 7)):  # the numbers tell the episodes apart
        human.reset(seed=seed)
        for _ in range(steps):
            human.step(np.ones(1, dtype=np.float32))
        browser.wait(f"replay.rows()[0] === {steps + 1} && replay.shown()")  # the newest row, reached smoothly
        clock = browser.run("return document.getElementById('clock').textContent")
        assert clock == f"{0.02 * steps:.2f} s"
        tip = human.unwrapped.episodes.view.tip[0]
        assert np.abs(np.array(browser.run("return replay.tips()")[0]) - tip).max() < 1e-6
    assert browser.said() == []
