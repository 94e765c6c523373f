"""Replay: the page holds the episodes, moves them as the package does, asks nobody, and runs no text as code."""

import base64
import json
import re
import shutil
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import flexman_gym as fm
from flexman_gym.simulation.episode import Episode
from flexman_gym.toolbox.view.comparison import VISIBLE_SAG
from flexman_gym.toolbox.view.frames import FramePainter, limiting_strains
from flexman_gym.toolbox.view.mesh import section_outlines
from flexman_gym.toolbox.view.overlay import strain_colours
from flexman_gym.toolbox.view.replay import replay_page

from oracles.browser import MISSING, Browser, one_browser
from oracles.files import ROOT
from oracles.sags import largest_sag

EVIL = "</script><script>window.harm = 1</script><img src=x onerror=window.harm=2>&<!--"
ROWS = 101


def episode(name="pd", stiffening=False, rows=ROWS, seed=0):
    """Arms that wave about, with readings."""
    model = fm.build_model(fm.catalog.paper_rrr(joint_stiffness=5000.0), 1, modes=4, stiffening=stiffening)
    random, time = np.random.default_rng(seed), 0.02 * np.arange(rows)
    states = np.sin(
        np.outer(time, random.uniform(0.5, 3.0, 2 * model.n_dof)) + random.uniform(0.0, 6.0, 2 * model.n_dof)
    )
    states[:, model.n_joints + model.n_motors :] *= 0.5
    states[:, model.motor_columns] = states[:, : model.n_joints] + 0.02
    tips = fm.curves(model, states, 2).positions[:, -1, -1]
    actions = random.uniform(-1.0, 1.0, (rows - 1, 3))
    targets = np.tile(tips[-1], (rows, 1))
    told = Episode.metadata(model, name=name, seed=5000, environment="FlexRRR-v0", units={})
    readings = {"motor_angles": states[:, model.motor_columns], "tip": tips}
    errors = np.linalg.norm(tips - targets, axis=1)
    return Episode(time, states, tips, targets, errors, actions, 400.0 * actions, np.ones(rows - 1), readings, told)


def embedded(page):
    """The data in a page."""
    return json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)[1])


def test_the_page_holds_what_was_recorded_and_text_is_text():
    one = episode(EVIL)
    page = replay_page([one, episode("lqr", seed=1)], EVIL)
    assert page.count("<script") == 2 == page.count("</script>") and "<img" not in page.split("<script")[0]
    data = embedded(page)
    assert data["runs"][0]["name"] == EVIL and len(data["arms"]) == 1, "both are of one arm"
    x = np.frombuffer(base64.b64decode(data["runs"][0]["x"]), "<f4").reshape(ROWS, -1)
    assert np.array_equal(x, one.states[:, : one.model.n_dof].astype("f4"))
    for reading, (name, values) in zip(data["runs"][0]["readings"], one.readings.items(), strict=True):
        steps = np.frombuffer(base64.b64decode(reading["values"]), "<i2").reshape(values.shape)
        assert reading["name"] == name
        assert steps * reading["scale"] + reading["middle"] == pytest.approx(values, abs=np.ptp(values) * 2e-5)
    assert not re.search(r'(src|href)="?http', page.replace(data["runs"][0]["name"], ""))


def readings(run, links=3, width=1):
    """The curves of a run's readings as the script of the page makes them, by name."""
    script = "import { Run } from './runs.js'; import { readFileSync } from 'fs';"
    script += f"const run = new Run(JSON.parse(readFileSync(0)), {{ width: {width}, links: Array({links}) }});"
    script += "console.log(JSON.stringify(Object.fromEntries(run.readings.map(each => [each.name, "
    script += "Array.from({ length: each.size }, (_, c) => run.reading(each.name, c))]))));"
    command = ["node", "--input-type=module", "-e", script]
    done = subprocess.run(command, input=json.dumps(run), cwd=ROOT / "scripts" / "web", capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed (npm)")
@pytest.mark.filterwarnings("error")
def test_a_reading_that_is_not_finite_is_a_gap_in_its_curve():
    """The rest of the curve keeps its scale, also where finite numbers are as large as there are."""
    one = episode()
    angles, tip = (one.readings[name].copy() for name in ("motor_angles", "tip"))
    angles[3, 0], angles[5, 0], angles[7, 0], tip[:, 1], tip[:2, 2] = (
        np.inf,
        -np.inf,
        np.nan,
        np.nan,
        (1.7e308, -1.7e308),
    )
    data = embedded(replay_page([replace(one, readings={"motor_angles": angles, "tip": tip})]))["runs"][0]
    for name, values in (("motor_angles", angles), ("tip", tip)):
        for curve, expected in zip(readings(data, width=one.model.n_dof)[name], values.T, strict=True):
            known = np.isfinite(expected)
            assert [each is None for each in curve] == (~known).tolist()
            least, most = (expected[known].min(), expected[known].max()) if known.any() else (0.0, 0.0)
            assert [each for each in curve if each is not None] == pytest.approx(
                expected[known], rel=0.0, abs=1e-4 * (most / 2 - least / 2) + 1e-12)  # fmt: skip


def test_torques_targets_and_errors_stand_in_the_row_of_their_time():
    """The torque of a period stands where it begins, and that of the last one at its end, too."""
    one = episode()
    (run,) = embedded(replay_page([one]))["runs"]
    target, error, torque = (
        np.frombuffer(base64.b64decode(run[name]), "<f4").reshape(ROWS, -1) for name in ("target", "error", "torque")
    )
    assert np.array_equal(torque[:-1], one.actions.astype("f4")) and np.array_equal(torque[-1], torque[-2])
    assert np.array_equal(target, one.targets.astype("f4")) and np.array_equal(error[:, 0], one.errors.astype("f4"))
    assert run["dt"] == pytest.approx(0.02) and run["rows"] == ROWS


def test_a_reading_takes_all_steps_of_two_bytes():
    """From the least number of each column to the largest; a number is off by half a step at most."""
    one = episode()
    for reading, values in zip(embedded(replay_page([one]))["runs"][0]["readings"], one.readings.values(), strict=True):
        steps = np.frombuffer(base64.b64decode(reading["values"]), "<i2").reshape(values.shape)
        assert (steps.max(axis=0) == 2**15 - 1).all() and (steps.min(axis=0) == 1 - 2**15).all()
        off = np.abs(steps * reading["scale"] + reading["middle"] - values)
        assert (off <= 0.5001 * np.ptp(values, axis=0) / (2**16 - 2)).all()


def limited(*limits):
    """An episode with limits of the strains of the links and two violations."""
    one = episode()
    about = {"limits": {"strain": limits}, "violations": [[0.4, 0.4, 0.01], [1.0, 1.5, 0.25]]}
    return replace(one, about=one.about | about)


def test_colours_end_at_the_limits_of_the_strains():
    pages = [
        replay_page(each) for each in ([limited(1e-4, 2e-4, 1e-4)], [episode()], [episode(), limited(1e-4, 2e-4, 1e-4)])
    ]
    scales = embedded(pages[0])["runs"][0]["scales"]
    assert scales == pytest.approx(limiting_strains(episode().model, (1e-4, 2e-4, 1e-4)))
    assert "scales" not in embedded(pages[1])["runs"][0] and embedded(pages[1])["runs"][0]["violations"] == []
    limit, computed, both = (embedded(page)["stage"]["ends"] for page in pages)
    assert limit == "limit" and both == f"{computed} or limit"
    strain = embedded(pages[1])["stage"]["strain"]
    assert computed in (f"{1e6 * strain:g} µε", f"{1e2 * strain:g} %") and strain > 0.0


def test_the_time_line_marks_violations(browser, tmp_path):
    """From 1 to 1.5 of 2 s a mark covers the second half of the line up to its third quarter."""
    (tmp_path / "page.html").write_text(replay_page([limited(1e3, 1e-12, 1e3)]), encoding="utf-8")
    browser.open((tmp_path / "page.html").as_uri())
    script = "const whole = document.getElementById('marks').getBoundingClientRect();"
    script += "return [...document.getElementById('marks').children].map(each => each.getBoundingClientRect())"
    script += ".map(box => [box.left, box.right].map(x => (x - whole.left) / whole.width))"
    first, second = browser.run(script)
    assert first[0] == pytest.approx(0.2, abs=1e-3) and second == pytest.approx([0.5, 0.75], abs=1e-3)
    texts = []
    for time in (0.9, 1.0, 1.25, 1.6):
        browser.run("replay.seek(arguments[0])", time)
        texts.append(browser.run("return document.getElementById('labels').innerText"))
    assert ["beyond a limit by up to 25 %" in text for text in texts] == [False, True, True, False]
    hues = np.ptp(np.reshape(browser.run("return replay.colours()[0]"), (3, -1, 3)), axis=2)
    assert hues[[0, 2]].max() < 0.1 < np.median(hues[1]), "only the second link is at its limit"


def test_every_run_moves_its_own_arm():
    page = embedded(replay_page([episode(), episode("stiff", stiffening=True), episode("again")]))
    assert len(page["arms"]) == 2 and [run["arm"] for run in page["runs"]] == [0, 1, 0]


def drawn_tip(arm, q, gain, twist):
    """The tip (3,) by what a page holds of an arm: rotations and shapes of one link after the other."""
    turned, origin = Rotation.identity(), np.zeros(3)
    for i, link in enumerate(arm["links"]):
        motor, elastic = q[link["motor"]], q[slice(*link["elastic"])]
        rows, slopes = (
            np.frombuffer(base64.b64decode(link[name]), "<f4").reshape(-1, each, len(elastic)) @ elastic
            for name, each in (("rows", 10), ("slopes", 2))
        )
        turned *= Rotation.from_matrix(np.reshape(link["mount"], (3, 3)))
        turned *= Rotation.from_rotvec((motor + twist * (q[i] - motor)) * np.array(link["axis"]))
        place = gain * rows[-1, :3] + (link["length"] - gain**2 * (slopes[: link["before"][-1]] ** 2).sum(), 0.0, 0.0)
        origin, turned = origin + turned.apply(place), turned * Rotation.from_rotvec(gain * rows[-1, 3:6])
    return origin


@pytest.mark.parametrize("stiffening", [False, True])
def test_a_page_holds_all_that_places_the_tip(stiffening):
    """With joints that wind up, axes that lie across one another, and foreshortening; three times enlarged, too."""
    one, random = episode(stiffening=stiffening), np.random.default_rng(0)
    model, (page,) = one.model, embedded(replay_page([one]))["arms"]
    for gain, twist in ((1.0, 1.0), (3.0, 3.0), (3.0, 1.0)):
        state = 0.1 * random.normal(size=2 * model.n_dof)
        tip = fm.curves(model, state, 2, gain, twist).positions[-1, -1]
        assert drawn_tip(page, state, gain, twist) == pytest.approx(tip, abs=1e-5)


def test_a_page_begins_at_a_gain_that_shows_the_deflection():
    """A link is drawn with a sag of at most an eighth of its length, and magnified at most 100 times."""
    one, gains = episode(), {}
    for size in (1e-6, 0.1, 0.05, 0.3, 10.0):
        states = one.states.copy()
        states[:, one.model.n_joints + one.model.n_motors : one.model.n_dof] *= size
        bent = replace(one, states=states)
        gain = gains[size] = embedded(replay_page([bent]))["stage"]["gain"]
        sag = gain * largest_sag(bent)
        assert sag <= VISIBLE_SAG or gain == 1.0
        assert sag > VISIBLE_SAG / 2.6 or gain in (1.0, 100.0), "the next step would be too large"
    assert gains[1e-6] == 100.0 and gains[10.0] == 1.0 and len(set(gains.values())) > 3
    assert embedded(replay_page([one, replace(one, states=states)]))["stage"]["gain"] == 1.0, "the smallest of all"


def test_floor_and_colours_are_chosen_by_all_episodes():
    """An arm that does not bend changes no colour, whichever place it has, and nothing goes below the floor."""
    bent = episode()
    straight = replace(bent, states=np.zeros_like(bent.states))
    alone, first, last = (embedded(replay_page(each))["stage"] for each in ([bent], [bent, straight], [straight, bent]))
    assert alone["strain"] == first["strain"] == last["strain"] > 0.0
    assert alone["floor"] < min(bent.tips[:, 2].min(), bent.targets[:, 2].min(), 0.0)
    assert alone["floor"] > bent.tips[:, 2].min() - alone["reach"]


def test_colours_reach_to_what_happens_in_half_of_an_episode():
    one = episode()
    states = np.tile(one.states[ROWS // 3], (ROWS, 1))
    half = np.where((np.arange(ROWS) < ROWS // 2)[:, None], 0.0, states)
    whole, part = (embedded(replay_page([replace(one, states=each)]))["stage"]["strain"] for each in (states, half))
    assert whole == part > 0.0


def test_targets_are_seen_from_where_a_picture_is_seen():
    one = episode()
    far = replace(one, targets=np.tile([0.0, 30.0, 40.0], (ROWS, 1)))
    stage = embedded(replay_page([far]))["stage"]
    assert np.abs(np.array(stage["points"]) - (0.0, 30.0, 40.0)).sum(axis=1).min() < 1e-5
    assert stage["distance"] > np.hypot(30.0, 40.0)
    eye, forward = stage["towards"], FramePainter(one.model, (16, 16)).shot().camera.axes[2]
    assert eye == pytest.approx(-forward)


def test_a_page_holds_the_outlines_of_the_links():
    one = episode()
    (arm,) = embedded(replay_page([one]))["arms"]
    for link, section in zip(arm["links"], section_outlines(one.model, 24), strict=True):
        for name, values in section._asdict().items():
            assert np.array_equal(np.frombuffer(base64.b64decode(link[name]), "<f4"), values.astype("f4").ravel()), name


def test_a_run_says_why_it_ended():
    one = episode()
    failed = replace(one, about={**one.about, "failure": "joint 2"})
    assert [run["note"] for run in embedded(replay_page([one, failed]))["runs"]] == ["over", "joint 2"]


def test_ten_seconds_of_two_controllers_are_a_megabyte_at_most():
    pages = [replay_page([episode(rows=rows), episode("lqr", rows=rows, seed=1)]) for rows in (101, 501)]
    assert len(pages[1].encode()) < 1e6 and len(pages[1]) > len(pages[0]) + 1e5


def test_runs_of_one_name_are_numbered_and_a_scene_needs_no_task():
    names = [run["name"] for run in embedded(replay_page([episode(), episode(seed=1)]))["runs"]]
    assert names == ["pd 1", "pd 2"]
    bare = episode()
    for each in (bare.targets, bare.errors, bare.actions):
        each[:] = np.nan
    assert embedded(replay_page([replace(bare, readings={})]))["runs"][0]["readings"] == []
    for wrong in ([], [bare] * 9):
        with pytest.raises(ValueError, match=r"^episodes: .* give 1 to 8 of them$"):
            replay_page(wrong)


@pytest.mark.slow
def test_the_command_writes_a_page_and_says_what_is_wrong(tmp_path):
    command = [sys.executable, "-m", "flexman_gym", "replay"]
    paths = [episode(name).save(tmp_path / f"{name}.npz") for name in ("pd", "lqr")]
    page = tmp_path / "new" / "page.html"
    done = subprocess.run([*command, *map(str, paths), "--out", str(page)], capture_output=True, text=True, check=True)
    assert done.stdout.startswith(f"{page}: ") and [run["name"] for run in embedded(page.read_text())["runs"]] == [
        "pd", "lqr",
    ]  # fmt: skip


def test_numbers_are_packed_little_endian():
    one = episode()
    (run,) = embedded(replay_page([replace(one, errors=np.ones_like(one.errors))]))["runs"]
    assert base64.b64decode(run["error"]) == ROWS * b"\0\0\x80\x3f"


@pytest.mark.skipif(
    not (ROOT / "scripts" / "web" / "node_modules").is_dir(),
    reason="scripts/web/node_modules is not installed (npm ci)",
)
def test_the_bundle_is_what_its_sources_say():
    done = subprocess.run([sys.executable, ROOT / "scripts" / "bundle.py", "--check"], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "up to date\n"), done.stderr


# In a browser


browser = pytest.fixture(one_browser, scope="module")


def test_the_page_draws_moves_and_asks_nobody(browser, tmp_path):
    episodes = [episode(EVIL), episode("stiff", stiffening=True, seed=1)]
    (tmp_path / "page.html").write_text(replay_page(episodes, EVIL))
    browser.open(f"file://{tmp_path / 'page.html'}")
    assert browser.run("return document.getElementById('gaintext').textContent") == "true scale", "of arms that wave"
    for row in (0, 37, 100):
        browser.run("replay.seek(arguments[0])", 0.02 * row)
        tips = np.array([each.tips[row] for each in episodes])
        assert np.abs(browser.run("return replay.tips()") - tips).max() < 1e-6
        assert np.abs(browser.run("return replay.drawn()") - tips).max() < 1e-6
    browser.press("time", 0.5)
    there = float(browser.run("return document.getElementById('time').value"))
    assert 0.9 < there < 1.1 and browser.run("return document.getElementById('clock').textContent") == f"{there:.2f} s"
    browser.press("gain", 0.6)
    gain = 10 ** float(browser.run("return document.getElementById('gain').value"))
    assert gain > 3.0
    for drawn, each in zip(browser.run("return replay.drawn()"), episodes, strict=True):
        between = np.array([np.interp(there, each.time, column) for column in each.states.T])
        assert drawn == pytest.approx(
            fm.curves(each.model, between, 2, gain, 1.0).positions[-1, -1], abs=2e-6 * gain**2
        )
    browser.press("twist", 0.5)
    twist = 10 ** float(browser.run("return document.getElementById('twist').value"))
    said = browser.run("return document.getElementById('gaintext').textContent")
    assert 2.0 < twist < 5.0 and "link deflection" in said and "joint twist" in said and "true tip" in said
    for drawn, each in zip(browser.run("return replay.drawn()"), episodes, strict=True):
        between = np.array([np.interp(there, each.time, column) for column in each.states.T])
        tip = fm.curves(each.model, between, 2, gain, twist).positions[-1, -1]
        assert drawn == pytest.approx(tip, abs=2e-6 * (gain**2 + twist))
    assert browser.run("return window.harm") is None and browser.run("return document.title") == EVIL
    assert browser.run("return performance.getEntriesByType('resource').length") == 0
    assert browser.said() == []
    assert shutil.which("chromium") and len(base64.b64decode(browser.picture())) > 20_000


def test_a_page_begins_with_its_gain_and_fits_a_phone(browser, tmp_path):
    """390 pixels wide: nothing sticks out, and the arms have half of the height of the screen."""
    one = episode()
    states = one.states.copy()
    states[:, one.model.n_joints + one.model.n_motors : one.model.n_dof] *= 0.01
    (tmp_path / "page.html").write_text(replay_page([replace(one, states=states)]))
    browser.size(390, 800)
    browser.open(f"file://{tmp_path / 'page.html'}")
    gain = embedded((tmp_path / "page.html").read_text())["stage"]["gain"]
    said = browser.run("return document.getElementById('gaintext').textContent")
    assert gain > 1.0 and f"link deflection \N{MULTIPLICATION SIGN} {gain:g};" in said
    wide, high = browser.run(
        "return [document.documentElement.scrollWidth, document.getElementById('gl').clientHeight]"
    )
    assert wide <= 390 and high > 350
    plots = browser.run("return [...document.querySelectorAll('.plot')].map(each => each.clientHeight)")
    assert len(plots) == 3 and min(plots) > 120
    browser.size(1280, 720)


def test_a_legend_explains_ghost_and_colours(browser, tmp_path):
    """Within a phone's screen, in the colours of the links; a part that is not drawn is not explained."""
    page = replay_page([episode(), limited(1e-12, 1e-12, 1e-12)])
    (tmp_path / "page.html").write_text(page, encoding="utf-8")
    strain = embedded(page)["stage"]["ends"]
    browser.size(390, 800)
    browser.open((tmp_path / "page.html").as_uri())
    shown = "return [...document.querySelectorAll('#legend div')].filter(each => each.offsetHeight)"
    words = browser.run(f"{shown}.map(each => each.innerText.replace(/\\s+/g, ' '))")
    assert words[1:] == ["transparent: rigid arm, same motor angles",
        f"strain of the surface of the links \N{MINUS SIGN}{strain} compression tension +{strain}"]  # fmt: skip
    stage, *boxes = browser.run(
        "return [...document.querySelectorAll('#stage, #legend div')].map(each => each.getBoundingClientRect())"
    )
    assert all(stage["left"] < box["left"] and box["right"] < stage["right"] for box in boxes)
    assert all(stage["top"] < box["top"] and box["bottom"] < stage["bottom"] for box in boxes)
    bar = browser.run("return getComputedStyle(document.querySelector('#bar i')).backgroundImage")
    ends = np.array(re.findall(r"rgb\((\d+), (\d+), (\d+)\)", bar), dtype=float) / 255
    assert ends[[0, -1]] == pytest.approx(strain_colours(np.array([-1.0, 1.0])) / 255, abs=1e-9)
    linear = np.reshape(browser.run("return replay.colours()[1]"), (-1, 3))
    drawn = np.where(linear < 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)
    for end in ends[[0, -1]]:
        assert np.abs(drawn - end).max(axis=1).min() < 1e-3, "everywhere beyond the limit, on one side or the other"
    for name in ("ghost", "strain"):
        browser.run("document.getElementById(arguments[0]).click()", name)
    assert browser.run(f"{shown}.length") == 1
    browser.size(1280, 720)


@pytest.mark.slow
def test_charts_and_scene_follow_the_colour_scheme(browser, tmp_path):
    """They look as if the page had been opened in this scheme, though the charts are drawn all the time."""
    (tmp_path / "page.html").write_text(replay_page([episode()]), encoding="utf-8")
    look = "replay.stage.draw(replay.views, 1, 1); for (const each of replay.plots) each.u.redraw(false, false);"
    look += (
        "return Promise.resolve().then(() => [...document.querySelectorAll('canvas')].map(each => each.toDataURL()))"
    )
    opened = {}
    for scheme in ("dark", "light"):
        browser.scheme(scheme)
        browser.open((tmp_path / "page.html").as_uri())
        browser.run("replay.seek(1)")
        opened[scheme] = browser.run(look)
    assert len(opened["light"]) == 4 and all(a != b for a, b in zip(*opened.values(), strict=True))
    browser.run("setInterval(() => replay.plots.forEach(each => each.u.redraw(false, false)), 1)")
    for scheme in ("dark", "light"):
        sky = browser.run("return getComputedStyle(document.getElementById('stage')).backgroundColor")
        browser.scheme(scheme)
        browser.wait(f"getComputedStyle(document.getElementById('stage')).backgroundColor !== '{sky}'")
        browser.run("return new Promise(requestAnimationFrame)")
        assert browser.run(look) == opened[scheme], scheme


@pytest.mark.slow
def test_without_webgl_the_page_says_so_and_has_its_curves(tmp_path):
    if MISSING:
        pytest.skip(MISSING)
    (tmp_path / "page.html").write_text(replay_page([episode()]))
    browser = Browser("--disable-gpu", "--disable-3d-apis")
    try:
        browser.open(f"file://{tmp_path / 'page.html'}")
        assert browser.run("return [document.getElementById('sorry').hidden, replay.drawn().length]") == [False, 0]
        assert browser.run("return document.querySelectorAll('.uplot canvas').length") == 3
    finally:
        browser.close()
