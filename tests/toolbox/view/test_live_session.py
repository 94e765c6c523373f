"""Live view: controls act as the library does, code repeats episodes to the bit, only the own page is answered."""

import http.client
import json
import re
import shutil
import signal
import subprocess
import sys
import threading
import urllib.error
import urllib.parse
import urllib.request

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.__main__ import main
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.evaluation.policy_files import FOLDER
from flexman_gym.evaluation.rollouts import RolloutLoop
from flexman_gym.toolbox.view.live_page import LivePage
from flexman_gym.toolbox.view.live_session import Events

EVIL = "<img src=x onerror=window.harm=1>"


@pytest.fixture
def open_live(tmp_path, monkeypatch):
    """Return a function that opens a paused session in an empty folder; all are closed after the test."""
    monkeypatch.chdir(tmp_path)
    opened = []

    def open_one(*arguments, **settings):
        opened.append(fm.live(*arguments, **settings))
        opened[-1].command({"pause": True})
        return opened[-1]

    yield open_one
    for each in opened:
        each.close()


def saved_and_repeated(session):
    """Return pairs of saved episodes and those of the copied code."""
    paths, code = session.command({"save": 1})["paths"], session.command({"code": 1})["code"]
    head, *blocks = code.split("\nenv = ")
    for path, block in zip(paths, blocks, strict=True):
        names = {}
        exec(f"{head}\nenv = {block}", names)
        yield fm.Episode.load(path), names["episode"]


def assert_equal(episode, other):
    for name in ("states", "targets", "errors", "actions", "torques", "rewards"):
        assert np.array_equal(getattr(episode, name), getattr(other, name)), name


@pytest.mark.parametrize(("environment", "agents"), [
    ("FlexOne-v0", ["pd", "pd-shaped"]), ("FlexRRR-v0/unknown", ["ppo-flexrrr"]), ("FlexPlanar-Hold-v0", ["lqr"]),
    ("FlexRotary-v0/friction", ["pd"]), ("FlexRRR-Track-v0", ["pd"]),
])  # fmt: skip
def test_the_code_repeats_the_episode_to_the_bit(environment, agents, open_live):
    """With sliders, noise, delay, pushes and gains while it runs, for policies and under drawn disturbances."""
    session = open_live(environment, agents)
    session.command({"values": {"payload_mass": 0.01, "sensor_noise": 0.2, "delay": 1}})
    session.command({"step": 20})
    session.command({"push": [0.1, 0.2, 0.3]})
    session.command({"step": 7})
    session.command({"push": [0.0, 0.0, 0.0]})
    if "pd" in agents:
        session.command({"gains": {"stiffness": 1.5}})
        session.command({"gains": {"stiffness": 1.2, "damping": 0.8}})
    session.command({"step": 20})
    for episode, repeated in saved_and_repeated(session):
        rows = len(episode.time)
        assert rows >= 48 and episode.about["failure"] == ""
        assert rows == len(repeated.time) or "Track" in environment
        for name in ("states", "errors", "torques"):
            assert np.array_equal(getattr(episode, name), getattr(repeated, name)[: len(getattr(episode, name))]), name
        still = fm.rollout(episode.name, environment, [9000]).episode(0)
        assert not np.array_equal(episode.states, still.states[:rows]), "the controls did something"


def test_a_file_and_further_settings_are_in_the_code(open_live, tmp_path):
    (tmp_path / "long.yaml").write_text("id: FlexOne-v0\ncontrol_period: 0.01\n")
    session = open_live("long.yaml", seed=3, action_repeat=2)
    session.command({"step": 10})
    for episode, repeated in saved_and_repeated(session):
        assert_equal(episode, repeated)
        assert episode.period == 0.01 and episode.about["seed"] == 3


def test_a_push_is_a_force_at_the_tip_beside_those_of_effects():
    """One newton from the fourth control period on, added to the drawn impulses and loads of the task hold."""
    force, forces = [0.0, 1.0, 0.0], {}
    for name, events in (("pushed", Events([(3, "force", force)])), ("still", Events())):
        loop = RolloutLoop("lqr", "FlexPlanar-Hold-v0", [9000], events)
        forces[name] = [(loop.step(), loop.episodes.batch._drive[0, 2:5].copy())[1] for _ in range(6)]
    differences = np.array(forces["pushed"]) - forces["still"]
    assert np.abs(differences[:3]).max() == 0.0 and differences[3:] == pytest.approx(np.tile(force, (3, 1)))
    assert np.abs(forces["still"]).max() > 0.0


def test_a_push_accelerates_the_tip_of_an_arm_at_rest():
    """By the first control period the work of the force is the energy of the arm."""
    loop = RolloutLoop("zero", "FlexOne-v0", [0], Events([(0, "force", [0.3, 0.4, 0.0])]))
    before = loop.episodes.view.tip[0].copy()
    loop.step()
    view = loop.episodes.view
    work, energy = (view.tip[0] - before) @ [0.3, 0.4, 0.0], loop.episodes.batch.rows[0, -2]
    assert energy == pytest.approx(work, rel=1e-2) and work > 0.0


def test_events_of_an_agent_without_a_pd_or_with_wrong_numbers_are_refused():
    for agent, row, words in (("lqr", (0, "gains", {"stiffness": [1.0]}), "give them to an agent with a PD"),
                              ("pd", (0, "force", [0.0, 1.0]), "force: "), ("pd", (0, "wind", 1.0), "event: 'wind'"),
                              ("pd", (0, "gains", {"stiffness": [1.0, 2.0]}), "gains.stiffness: ")):  # fmt: skip
        with pytest.raises(ValueError, match=re.escape(words)):
            fm.rollout(agent, "FlexOne-v0", [0], Events([row]))


def test_sliders_set_the_parameters_of_the_arm(open_live):
    session = open_live("FlexOne-v0")
    model = session._loops[0].episodes.batch.model
    before = fm.modes(model).frequencies[0]
    session.command({"values": {"joint_stiffness": 0.25, "payload_mass": 0.1, "joint_damping": 0.1}})
    state = session.state()["values"]
    assert (state["joint_stiffness"], state["payload_mass"], state["joint_damping"]) == (0.25, 0.1, 0.1)
    constants = session._loops[0].episodes.batch.integrator(0).constants
    assert constants.joint_stiffness[0] == 0.25 * model.constants.joint_stiffness[0]
    assert constants.payload_mass[0] == 0.1
    added = constants.joint_damping[0] - model.constants.joint_damping[0]
    first = 2.0 * np.pi * fm.frequencies(model, lock_joints=True)[0]
    assert added * first / (2.0 * model.constants.joint_stiffness[0]) == pytest.approx(0.1), "a damping ratio"
    assert fm.modes(model).frequencies[0] == before, "the model of the agents is that of before"


def test_gains_are_factors_on_the_tuned_ones_and_act_at_once(open_live):
    session = open_live("FlexOne-v0", ["pd-shaped", "lqr"])
    session.command({"step": 5})
    loops, tuned = list(session._loops), NAMED_ENVIRONMENTS["FlexOne-v0"].pd
    session.command({"gains": {"stiffness": 0.5}})
    controller = loops[0].episodes.base.inner
    assert session._loops == loops and controller.stiffness == pytest.approx(0.5 * np.array(tuned["stiffness"]))
    assert controller.damping == pytest.approx(tuned["damping"]) and session._events[1].rows == []
    session.command({"again": 0})
    assert session._loops[0].episodes.base.inner.stiffness == controller.stiffness, "they remain"


def test_sliders_begin_where_the_condition_drew_them(open_live):
    session = open_live("FlexRRR-v0/unknown")
    drawn = session._loops[0].episodes.effects.drawn_for(0)
    values, nominal = session.state()["values"], session._loops[0].episodes.batch.nominal
    assert values["payload_mass"] == drawn["payload_mass"] > 0.0 and values["delay"] == 1
    assert values["joint_stiffness"] == pytest.approx(np.mean(drawn["joint_stiffness"] / nominal["joint_stiffness"]))


def test_a_dragged_target_is_the_nearest_that_the_arm_reaches(open_live):
    """From the present posture; an arm with one joint moves its tip on a circle."""
    session = open_live("FlexOne-v0")
    session.command({"step": 30})
    posture = session._loops[0].episodes.view.motor_angles[0, 0]
    session.command({"target": [3.0, 4.0, 0.5]})
    view = session._loops[0].episodes.view
    assert view.target[0] / view.reach == pytest.approx([0.6, 0.8, 0.0], abs=1e-4)
    assert view.motor_angles[0, 0] == posture and session._loops[0].episodes.batch.time[0] == 0.0
    session.command({"again": 0})
    assert session._loops[0].episodes.view.target[0] / view.reach == pytest.approx([0.6, 0.8, 0.0], abs=1e-4)
    session.command({"again": 1})
    assert session.state()["seed"] == 9001
    with pytest.raises(ValueError, match="whose target does not move"):
        open_live("FlexRRR-Track-v0").command({"target": [1.0, 1.0, 1.0]})


def test_an_episode_ends_and_starts_again(open_live):
    session = open_live("FlexRRR-Hold-v0", "zero")
    while not session._loops[0].over:
        session.command({"step": 1000})
    assert session.paused and session.state()["message"].startswith("zero: ")
    session.command({"pause": False})
    assert session._loops[0].episodes.batch.time[0] < 1.0
    with session._lock:
        session.command({"again": 0})
        with pytest.raises(ValueError, match="no control period yet"):
            session.command({"save": 0})


def post(session, body, path="control", **headers):
    """Return status and answer of a request of the page, with changed headers."""
    _, place, folder, *_ = urllib.parse.urlsplit(session.url)
    connection = http.client.HTTPConnection(place, timeout=30)
    headers = {"Host": place, "Origin": f"http://{place}", "Content-Type": "application/json"} | {
        name.replace("_", "-"): value for name, value in headers.items()
    }
    connection.request("POST" if body is not None else "GET", folder + path, body, headers)
    answer = connection.getresponse()
    return answer.status, answer.read().decode()


def test_only_the_page_itself_is_answered(open_live):
    """Neither another site in the same browser, nor a name that leads to this computer, nor a form."""
    session = open_live("FlexOne-v0")
    order = json.dumps({"speed": 0.1})
    for headers in ({"Origin": "http://evil.example"}, {"Host": "evil.example:80"}, {"Origin": "null"},
                    {"Host": "evil.example:80", "Origin": "http://evil.example:80"}):  # fmt: skip
        assert post(session, order, **headers)[0] == 403
    assert post(session, order, Content_Type="text/plain")[0] == 404 == post(session, order, path="else")[0]
    assert session.state()["speed"] == 1.0
    for path in ("", "live"):
        assert post(session, None, path, Host="evil.example:80")[0] == 403
    assert post(session, order) == (200, "{}") and session.state()["speed"] == 0.1
    assert session.url.startswith("http://127.0.0.1:")


WRONG = ["", "{", "[]", "1", '"a"', "{}", '{"a": 1}', '{"speed": 1, "pause": true}', '{"speed": NaN}', '{"speed": 7}',
         '{"push": [1, 2]}', '{"push": [1e400, 0, 0]}', '{"push": "abc"}', '{"values": {"payload_mass": -1}}',
         '{"values": {"mass": 1}}', '{"values": []}', '{"gains": {"stiffness": 1e9}}', '{"agents": []}',
         '{"agents": ["nobody"]}', '{"agents": ["ppo-flexplanar"]}', '{"agents": ["pd", "pd", "pd"]}', '{"step": 0}',
         '{"environment": "FlexOne-v9"}', '{"target": [null, 1, 2]}', '{"again": 2}', '{"pause": 1}',
         "[" * 5000]  # fmt: skip


@pytest.mark.parametrize("body", WRONG, ids=range(len(WRONG)))
def test_a_wrong_message_is_answered_in_a_line_and_changes_nothing(body, open_live):
    session = open_live("FlexOne-v0")
    before, loops, setup = session.state(), session._loops, session._setup
    status, answer = post(session, body)
    error = json.loads(answer)["error"]
    assert status == 400 and error and "\n" not in error
    assert session.state() == before and session._loops is loops and session._setup is setup
    session.command({"step": 1})
    assert post(session, None, "")[0] == 200


def data_of(address):
    """Return the data of a live page at an address."""
    with urllib.request.urlopen(f"{address}live", timeout=120) as stream:
        while stream.readline() != b"event: begin\n":
            pass
        return json.loads(stream.readline().removeprefix(b"data: "))


def test_names_of_folders_stay_text(open_live, tmp_path):
    shutil.copytree(FOLDER / "ppo-flexrrr", tmp_path / "runs" / EVIL)
    session = open_live("FlexRRR-v0", f"runs/{EVIL}")
    page = post(session, None, "")[1]
    assert "<img" not in page and page.count("<script") == 2 == page.count("</script>")
    assert data_of(session.url)["runs"][0]["name"] == f"runs/{EVIL}"
    session.command({"step": 5})
    for episode, repeated in saved_and_repeated(session):
        assert_equal(episode, repeated)


def test_the_command_shows_the_page_until_it_is_stopped(capsys):
    command = [sys.executable, "-m", "flexman_gym", "live", "FlexOne-v0", "--agent", "zero", "--agent", "pd"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    address = process.stderr.readline().split()[-1]
    assert data_of(address)["controls"]["chosen"] == ["zero", "pd"]
    process.send_signal(signal.SIGINT)
    assert process.wait(60) == 0
    process.stderr.close()
    assert main(["live", "FlexOne-v9", "--agent", "pd"]) == 2
    assert "environment: FlexOne-v9 does not exist; give the path of a file, or one of " in capsys.readouterr().err


LOST = """
import ctypes, signal, sys
from flexman_gym.__main__ import main
from flexman_gym.toolbox.view.live_page import LivePage

interrupt, show = ctypes.CFUNCTYPE(None)(lambda: signal.raise_signal(signal.SIGINT)), LivePage.show
LivePage.show = lambda *given: (interrupt(), show(*given))
sys.exit(main(["live", "FlexOne-v0"]))
"""


def test_an_interrupt_in_a_callback_of_c_code_stops_the_command():
    done = subprocess.run([sys.executable, "-c", LOST], stderr=subprocess.PIPE, text=True, timeout=60)
    assert done.returncode == 0 and "ignored" in done.stderr and "KeyboardInterrupt" in done.stderr


def test_an_interrupted_start_closes_the_page(monkeypatch):
    pages, running = [], threading.active_count()

    def interrupt(page, rows):
        pages.append(page)
        raise KeyboardInterrupt

    monkeypatch.setattr(LivePage, "show", interrupt)
    with pytest.raises(KeyboardInterrupt):
        fm.live("FlexOne-v0")
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(pages[0].url)
    assert threading.active_count() == running


def test_a_notebook_shows_the_page_and_an_unknown_agent_is_refused(open_live):
    session = open_live("FlexOne-v0", ["zero", "random"])
    assert f'<iframe src="{session.url}"' in session._repr_html_()
    with pytest.raises(ValueError, match="nobody does not exist"):
        fm.live("FlexOne-v0", "nobody")
    for wrong, words in (({"agents": []}, "agents: "), ({"port": 70000}, "port: 70000"), ({"seed": -1}, "seed: -1"),
                         ({"gravity": 0}, "gravity: ")):  # fmt: skip
        with pytest.raises(ValueError, match=words):
            fm.live("FlexOne-v0", **wrong)
