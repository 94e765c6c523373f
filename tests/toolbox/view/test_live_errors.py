"""Live view: errors of agents pause the page with their message, names and moments that coincide keep all files."""

import threading
import time
from dataclasses import replace

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.__main__ import main
from flexman_gym.evaluation.agents import find_agent
from flexman_gym.toolbox.view.live_session import LiveSession

from oracles.waiting import wait_until

ERRORS = [RuntimeError("CUDA\nerror"), KeyError("goal"), TypeError("no"), OSError(5, "gone"), IndexError("9"),
          ValueError("bad"), ZeroDivisionError("by zero"), AssertionError(), NotImplementedError("x")]  # fmt: skip
TEXTS = ["RuntimeError: CUDA error", "KeyError: 'goal'", "TypeError: no", "[Errno 5] gone", "IndexError: 9", "bad",
         "ZeroDivisionError: by zero", "AssertionError", "NotImplementedError: x"]  # fmt: skip


class Failing:
    """Controller that raises an error at its first action as long as it has one."""

    sensors = ("motor_encoders",)
    error = None

    def reset(self, arms, episode, count):
        pass

    def act(self, readings, applied, active):
        if Failing.error is not None:
            raise Failing.error
        return np.zeros_like(applied)


@pytest.fixture
def message(monkeypatch):
    """Return a function that waits until a session pauses with a message, and returns the message."""
    told, send = threading.Condition(), LiveSession._send_state

    def notify(session):
        send(session)
        with told:
            told.notify_all()

    def wait(session):
        with told:
            assert told.wait_for(lambda: session.paused and session.state()["message"], 60)
        return session.state()["message"]

    monkeypatch.setattr(LiveSession, "_send_state", notify)
    monkeypatch.setattr(Failing, "error", None)
    return wait


@pytest.fixture
def session(tmp_path, monkeypatch, message):
    monkeypatch.chdir(tmp_path)
    with fm.live("FlexOne-v0", Failing()) as made:
        yield made


@pytest.mark.parametrize(("error", "text"), [*zip(ERRORS, TEXTS, strict=True)], ids=[type(e).__name__ for e in ERRORS])
def test_any_error_of_an_agent_pauses_the_page_with_its_message(error, text, session, message):
    """It is paused again if it is started again; after the cure a new episode runs."""
    Failing.error = error
    for again in (False, True):
        if again:
            session.command({"pause": False})
        assert message(session) == f"Failing: {text}" and session._thread.is_alive()
    with pytest.raises(ValueError, match="Failing: "):
        session.command({"step": 1})
    Failing.error = None
    session.command({"again": 0})
    session.command({"step": 5})
    assert session.state()["message"] == "" and len(session._rows[0]) >= 6
    session.command({"pause": False})
    wait_until(lambda: len(session._rows[0]) >= 9)


def test_the_message_names_the_one_of_two_agents_that_fails(tmp_path, monkeypatch, message):
    monkeypatch.chdir(tmp_path)
    with fm.live("FlexOne-v0", ["pd", Failing()]) as session:
        Failing.error = RuntimeError("x")
        assert message(session) == "Failing: RuntimeError: x"


def test_an_error_of_a_new_agent_is_the_answer_and_the_episodes_go_on(session, monkeypatch):
    def fail(*_):
        raise RuntimeError("no weights")

    session.command({"pause": True})
    loops = session._loops
    monkeypatch.setattr(Failing, "reset", fail)
    with pytest.raises(RuntimeError, match="no weights"):
        session.command({"again": 0})
    assert session._loops is loops


def test_an_agent_that_exits_ends_the_session_which_says_so(session):
    Failing.error = SystemExit(0)
    with pytest.raises(RuntimeError, match="the simulation has ended: SystemExit: 0"):
        session.wait()
    with pytest.raises(ValueError, match="the simulation has ended: SystemExit: 0; start a new session"):
        session.command({"again": 0})


@pytest.mark.slow
def test_the_command_of_an_ended_session_fails(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("flexman_gym.commands.load_agent", lambda *_: find_agent(Failing()))
    monkeypatch.setattr(Failing, "error", SystemExit(0))
    assert main(["live", "FlexOne-v0"]) == 1
    assert capsys.readouterr().err.splitlines()[-1] == "the simulation has ended: SystemExit: 0"


def test_saves_within_one_second_and_agents_of_one_name_keep_all_files(tmp_path, monkeypatch):
    """Each file is the episode of its own agent, of its own moment."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(time, "strftime", lambda _: "now")
    strong, weak = replace(find_agent("pd"), name="own"), replace(find_agent("zero"), name="own")
    with fm.live("FlexOne-v0", [strong, weak]) as session:
        session.command({"pause": True})
        session.command({"again": 0})
        assert session._setup.agents == ("own", "own 2")
        saved = []
        for steps in (10, 20):
            session.command({"step": steps})
            saved += session.command({"save": 0})["paths"]
    assert len({*saved}) == 4 and saved[0].startswith("out/live/now/") and saved[2].startswith("out/live/now-2/")
    episodes = [fm.Episode.load(path) for path in saved]
    assert [len(each.time) for each in episodes] == [11, 11, 31, 31]
    assert [bool(each.torques.any()) for each in episodes] == [True, False, True, False]


def test_one_agent_twice_keeps_its_name_and_both_files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with fm.live("FlexOne-v0", ["pd", "pd"]) as session:
        session.command({"step": 3})
        assert session._setup.agents == ("pd", "pd") and len({*session.command({"save": 0})["paths"]}) == 2


@pytest.mark.slow
def test_evaluated_agents_of_one_name_keep_all_files(tmp_path, monkeypatch, capsys):
    """As the policies of two runs whose folders have the same name."""
    load = "flexman_gym.commands.evaluate.load_agent"
    monkeypatch.setattr(load, lambda name, *_: replace(find_agent(name), name="own"))
    given = ["--env", "FlexOne-v0", "--episodes", "2", "--save", str(tmp_path)]
    assert main(["evaluate", "pd", "zero", *given]) == 0
    assert sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*.npz")) == [
        "1/own-9000.npz", "1/own-9001.npz", "2/own-9000.npz", "2/own-9001.npz"]  # fmt: skip
    assert "4 episodes are in" in capsys.readouterr().out
