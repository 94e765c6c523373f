"""Live: what an environment does is seen on a page of this machine alone while it goes on, or in a window."""

import base64
import sys
import threading
import urllib.error
import urllib.request

import gymnasium as gym
import numpy as np
import pytest

import flexman_gym  # noqa: F401  registers the environments
from flexman_gym.draw.window import Window

from oracles.browser import MISSING, Browser


@pytest.fixture
def human(monkeypatch):
    """An environment that shows itself where there is no display."""
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
    env = gym.make("FlexOne-v0", render_mode="human", disable_env_checker=True)
    env.reset(seed=5000)
    yield env
    env.close()


def page_of(env):
    return env.unwrapped._rendering.screen


def test_every_step_comes_to_whoever_listens(human, capsys):
    human.step(np.ones(1, dtype=np.float32))
    screen, rows = page_of(human), []
    assert screen.address.startswith("http://127.0.0.1:") and human.render() is None
    model = human.unwrapped.simulator.model

    def listen():
        with urllib.request.urlopen(screen.address + "live", timeout=30) as stream:
            while len(rows) < 4:
                line = stream.readline()
                if line.startswith(b"data: A") or len(line) > 20:
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
    assert rows[1][-1] == 1.0 and len(rows[0]) == model.n_dof + 3 + 1 + 1
    with urllib.request.urlopen(screen.address) as page:
        assert b'"live":true' in page.read()
    with pytest.raises(urllib.error.HTTPError, match="404"):
        urllib.request.urlopen(screen.address + "else")
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
        urllib.request.urlopen(screen.address)


def test_a_browser_follows_the_arm_through_episodes(human):
    if MISSING:
        pytest.skip(MISSING)
    browser = Browser()
    try:
        browser.open(page_of(human).address)
        for seed in (5000, 5001):
            human.reset(seed=seed)
            for _ in range(5):
                human.step(np.ones(1, dtype=np.float32))
            browser.wait("replay.rows()[0] === 6")
            tip = human.unwrapped.episodes.view.tip[0]
            assert np.abs(np.array(browser.run("return replay.tips()")[0]) - tip).max() < 1e-6
        assert browser.said() == []
    finally:
        browser.close()


def test_a_window_shows_what_it_is_given(monkeypatch):
    pygame = pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    window, picture = Window((48, 36), "arm", 0.001), np.zeros((36, 48, 3), dtype=np.uint8)
    picture[10, 20] = 200, 100, 50
    window.show(picture)
    assert tuple(pygame.display.get_surface().get_at((20, 10)))[:3] == (200, 100, 50)
    assert tuple(pygame.display.get_surface().get_at((10, 20)))[:3] == (0, 0, 0) and window.shown == 1
    window.close()
    assert "pygame" in sys.modules
