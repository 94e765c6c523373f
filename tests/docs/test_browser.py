"""Tests of the site in Chromium: search from a disk, wide tables, length of pages, equations, pictures, replay."""

import base64
import io
import re
import shutil
import subprocess
import sys
import time

import numpy as np
import pytest
import site_counts
import yaml
from PIL import Image

from oracles.browser import one_browser
from oracles.files import ROOT

pytestmark = pytest.mark.slow

AWAY = (
    "return performance.getEntriesByType('resource').map(each => each.name).filter(each => !each.startsWith('file:'))"
)
INSIDE = "[...document.querySelectorAll('*')].flatMap(each => [...each.shadowRoot?.querySelectorAll('%s') ?? []])"
READING = [page for tab in site_counts.counts().values() for page in tab if not page.startswith(site_counts.REFERENCE)]
SCREEN, SCREENS = 900, 8  # pixels; longest page in screens of 1280 x 900


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Return the folder of a strictly built site."""
    pytest.importorskip("zensical")
    folder = tmp_path_factory.mktemp("site")
    for name in ("mkdocs.yml", "CHANGELOG.md"):
        shutil.copy(ROOT / name, folder)
    for name in ("docs", "scripts/web"):
        shutil.copytree(ROOT / name, folder / name)
    (folder / "build" / "site").mkdir(parents=True)
    for name, place in (("flexman_gym", "flexman_gym"), ("flexman_agents", "agents")):
        (folder / "build" / "site" / name).symlink_to(ROOT / place)
    command = [sys.executable, "-m", "zensical", "build", "--strict"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0 and "griffe" not in done.stdout + done.stderr, done.stdout + done.stderr
    return folder / yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))["site_dir"]


browser = pytest.fixture(one_browser, scope="module")


def test_pages_ask_nobody_and_their_equations_are_drawn(browser, site):
    for page, least in (("index", 0), ("theory", 40), ("integration", 10), ("api/model", 1)):
        browser.open(f"file://{site / page}.html", "document.readyState === 'complete'")
        browser.wait("document.querySelectorAll('.arithmatex:not(:has(.katex))').length === 0")
        assert browser.run("return document.querySelectorAll('.katex').length") >= least
        assert browser.run("return document.querySelectorAll('.katex-error').length") == 0
        assert browser.run("return [...document.fonts].filter(each => each.status === 'error').length") == 0
        assert browser.run(AWAY) == [] and browser.said() == []


WANTED = {  # words -> pages, of which one is among the first two hits
    "how to install": {"start.html#how-to-install"},
    "input shaping": {"control_room.html#input-shaping"},
    "settled": {"concepts.html#settled-settling-time-and-vibration"},
    "payload": {
        "own_arm.html#links-joints-and-payload", "tutorials/unknown_arms.html#randomise-payload-stiffness-and-delay",
    },
    "reward": {"own_task.html#reward"},
    "urdf": {"own_arm.html#from-a-urdf"},
    "macos": {"concepts.html#supported-systems", "start.html#how-to-install"},
    "simulink": {"control_room.html#matlab-simulink-and-python-control"},
    "noise": {"own_task.html#sensor-noise-and-other-errors"},
    "friction": {"own_arm.html#friction-backlash-and-torque-ripple", "control_room.html#friction-in-the-loop"},
    "foreshortening": {"theory.html#foreshortening"},
    "reproduce the paper": {"the_paper.html#reproduce-the-paper-figures-6-to-11"},
    "figure 6": {
        "the_paper.html#reproduce-the-paper-figures-6-to-11", "the_paper.html#figures-6-to-11-as-computed-here",
    },
    "equation 23": {"the_paper.html#equations-22-and-23-a-flexible-joint"},
    # sentences, whose words no section has together
    "known weaknesses": {"where_it_fails.html"},
    "limitations": {"where_it_fails.html"},
    "is my policy good": {"learn.html#is-my-policy-good"},
    "why does the tip ring": {"concepts.html#why-a-flexible-arm-rings"},
    "which method": {"advice.html#which-method-and-step"},
    "how much faster than MuJoCo": {"questions.html#how-much-faster-is-it-than-mujoco-at-equal-accuracy"},
    "why does the PD settle 0 %": {"questions.html#why-does-the-pd-of-flexrrr-v0-settle-0"},
    "strain limits while learning": {"own_task.html#limits-that-protect-the-arm", "safety.html"},
    "CAD file": {"questions.html#can-i-import-a-cad-file-step-stl"},
    "ONNX C UDP real-time": {"c_code.html"},
    "Windows macOS Python versions": {"concepts.html#supported-systems", "start.html#how-to-install"},
}  # fmt: skip


def search(browser, site, words):
    """Type words into the search of the home page."""
    browser.open(f"file://{site / 'index.html'}", "document.querySelector('.md-search__button')")
    browser.run("document.querySelector('.md-search__button').click()")
    browser.wait(f"{INSIDE % 'input'}.length === 1")
    browser.write(words)


@pytest.mark.parametrize("words", WANTED)
def test_the_search_finds_the_page_among_the_first_two_hits(words, browser, site):
    search(browser, site, words)
    first = f"{INSIDE % 'a'}.slice(0, 2).map(each => each.href.replace(/[?][^#]*/, ''))"
    found = " || ".join(f"each.endsWith('/{page}')" for page in WANTED[words])
    browser.wait(f"{first}.some(each => {found})", 20)
    assert browser.run(AWAY) == [] and browser.said() == []


@pytest.mark.parametrize("words", ["wandb", "colab", "keras", "excel keras"])
def test_the_search_finds_nothing_for_words_that_no_page_has(words, browser, site):
    """The search of the theme would find pages with words that differ by two letters, 511 for "wandb"."""
    search(browser, site, words)
    time.sleep(2.0)  # after the results of the last letter
    assert browser.run(f"return {INSIDE % '[role=status]'}.map(each => each.textContent)") == ["No results"]
    assert browser.run(f"return {INSIDE % '[role=option]'}.length") == 0 and browser.said() == []


@pytest.mark.parametrize("words", ["randomization", "vibraton", "stifness"])
def test_the_search_finds_words_with_one_wrong_letter(words, browser, site):
    search(browser, site, words)
    browser.wait(f"{INSIDE % '[role=option]'}.length > 0", 20)


def test_the_search_has_one_entry_for_each_public_name(site):
    entries = [each.partition("#")[2] for each in site_counts.search_entries(site) if each.startswith("api/")]
    names = [entry for page in (ROOT / "docs" / "api").glob("*.md")
             for entry in re.findall(r"^::: (\S+)", page.read_text(encoding="utf-8"), re.MULTILINE)]  # fmt: skip
    assert sorted(each for each in entries if each.startswith("flexman_")) == sorted(names)
    assert len(entries) < 1.3 * len(names) and site_counts.api_words(site) < 37_000


def test_pages_of_evidence_have_a_tab_and_their_neighbours(browser, site):
    browser.open(f"file://{site / 'evidence/peers.html'}", "document.readyState === 'complete'")
    active = "return [...document.querySelectorAll('.md-tabs__item--active')].map(each => each.innerText.trim())"
    assert browser.run(active) == ["Evidence"]
    links = "return [...document.querySelectorAll('%s')].map(each => each.getAttribute('href'))"
    assert browser.run(links % ".md-footer__link") == ["./work_precision.html", "./accuracy.html"]
    assert {"./verification.html", "./faults.html"} <= set(browser.run(links % ".md-nav--primary a"))


def test_no_page_to_read_is_longer_than_eight_screens(browser, site):
    browser.run("window.resizeTo(1280, 900)")
    heights = {}
    for page in READING:
        browser.open(f"file://{site / page}.html", "document.readyState === 'complete'")
        browser.wait("document.querySelectorAll('.arithmatex:not(:has(.katex))').length === 0")
        heights[page] = browser.run("return document.querySelector('article').scrollHeight") / SCREEN
    longest = max(heights, key=heights.get)
    print(f"longest page: {longest}, {heights[longest]:.1f} screens")
    assert {page: height for page, height in heights.items() if height > SCREENS} == {}


def test_pages_that_teach_have_most_of_the_words():
    assert site_counts.share(site_counts.counts()) >= 0.55


def test_a_wide_table_scrolls_beside_its_first_column(browser, site):
    browser.open(f"file://{site / 'environments/keywords.html'}", "document.readyState === 'complete'")
    browser.run("document.querySelector('article').style.width = '300px'")
    moved = """
        const wrap = document.querySelector('.md-typeset__scrollwrap'), cell = wrap.querySelector('tbody td');
        const before = cell.getBoundingClientRect().left, next = cell.nextElementSibling.getBoundingClientRect().left;
        wrap.scrollLeft = 80;
        return [wrap.scrollWidth > wrap.clientWidth, Math.abs(cell.getBoundingClientRect().left - before),
                next - cell.nextElementSibling.getBoundingClientRect().left];
    """
    wider, first, others = browser.run(moved)
    assert wider and first < 40 < others and browser.said() == []


@pytest.mark.parametrize("width", [390, 1280])
def test_names_in_tables_are_not_broken_within_a_word(width, browser, site):
    browser.size(width, 844)
    for page in ("results", "league/league", "control_room", "environments/keywords", "evidence/control"):
        browser.open(f"file://{site / page}.html", "document.readyState === 'complete'")
        broken = """
            return [...document.querySelectorAll('td code')]
                .filter(each => each.getClientRects().length > each.textContent.trim().split(/[\\s-]+/).length)
                .map(each => each.textContent);
        """
        assert browser.run("return document.querySelectorAll('td code').length") > 5 and browser.run(broken) == []
    browser.size(1280, 720)


def test_the_experiment_works_on_a_phone_and_with_keys(browser, site):
    """Check width, names with units, colours of both schemes, and a slider moved by a key, at 390 pixels."""
    browser.size(390, 844)
    browser.open(f"file://{site / 'concepts.html'}", "document.querySelector('#ringing canvas')")
    widths = "return [document.documentElement, document.querySelector('#ringing')].map(each => each.scrollWidth)"
    assert max(browser.run(widths)) <= 390
    inputs = browser.run(
        "return [...document.querySelectorAll('#ringing input')].map("
        "each => [each.labels[0].innerText, each.type, each.getAttribute('aria-valuetext')])"
    )
    assert all(label.strip() and (kind != "range" or value.split()[1:]) for label, kind, value in inputs)
    assert inputs[5][2] == "0.05 kg"
    said = "return document.querySelector('#ringing [role=status]').textContent"
    before = browser.run(said)
    browser.run("document.querySelector('#ringing [name=payload]').focus()")
    browser.write("\ue014")  # arrow to the right
    assert browser.run(said) != before
    colours = set()
    for scheme in ("default", "slate"):
        browser.run(f"document.body.setAttribute('data-md-color-scheme', '{scheme}')")
        colours.add(
            browser.run("return getComputedStyle(document.querySelector('.ringing')).getPropertyValue('--tip')")
        )
    assert len(colours) == 2 and browser.run(AWAY) == [] and browser.said() == []
    browser.size(1280, 720)


PICTURES = {  # page -> its pictures
    "index": ("side_by_side.gif", "live.gif", "speed_accuracy.svg"), "concepts": ("my_modes.png",),
    "environments/index": ("FlexRRR-v0.gif",), "environments/FlexRRR": ("FlexRRR-v0.svg",),
    "league/league": ("league.svg", "sweeps.svg"), "results": ("learning_FlexRRR-v0.svg",),
    "the_paper": ("paper_figures.png",), "theory": ("theory.svg",),
}  # fmt: skip
WHITE = 235  # of 255; brightness of a sheet of paper


def screenshot(browser, name):
    """Return the brightness (h, w), 0 to 255, of a picture of the page on the screen."""
    browser.run(f"window.shown = document.querySelector('img[src*=\"{name}\"]'); shown.scrollIntoView()")
    browser.wait("shown.complete && shown.naturalWidth")
    browser.run("scrollBy(0, -80)")  # below the header
    box = browser.run("const b = shown.getBoundingClientRect(); return [b.left, b.top, b.right, b.bottom]")
    page = Image.open(io.BytesIO(base64.b64decode(browser.picture()))).convert("L")
    return np.asarray(page.crop(tuple(map(round, (*box[:3], min(box[3], page.height))))))


@pytest.mark.parametrize("page", PICTURES)
def test_pictures_are_no_white_sheets_on_a_dark_page_and_fit_a_phone(page, browser, site):
    for width, height in ((390, 844), (1280, 900)):
        browser.size(width, height)
        browser.open(f"file://{site / page}.html", "document.readyState === 'complete'")
        for name in PICTURES[page]:
            if page == "league/league" and width == 390:
                continue  # tables are in their places
            shares = []
            for scheme in ("default", "slate"):
                browser.run(f"document.body.setAttribute('data-md-color-scheme', '{scheme}')")
                shares.append((screenshot(browser, name) > WHITE).mean())
            assert shares[0] > 0.2 and shares[1] < 0.05, (name, width, shares)
            assert browser.run("return shown.getBoundingClientRect().right") <= width, (name, width)
        assert browser.run("return document.documentElement.scrollWidth") <= width
    browser.size(1280, 720)


def test_the_map_of_the_league_has_its_own_size_and_is_a_table_on_a_phone(browser, site):
    browser.open(f"file://{site / 'league/league'}.html", "document.readyState === 'complete'")
    shown = "return ['.wide img', '.narrow table'].map(each => document.querySelector(each).checkVisibility())"
    for width, expected in ((1280, [True, False]), (390, [False, True])):
        browser.size(width, 900)
        assert browser.run(shown) == expected
    browser.size(1280, 900)
    browser.wait("document.querySelector('.wide img').naturalWidth")
    scale = "const map = document.querySelector('.wide img'); return map.clientWidth / map.naturalWidth"
    assert browser.run(scale) > 0.95
    browser.size(1280, 720)


def test_the_charts_of_the_embedded_replay_are_legible(browser, site):
    """Each has a height for its labels, and all parts are in the window or reached by scrolling, also on a phone."""
    for width, height in ((1280, 900), (390, 844)):
        browser.size(width, height)
        browser.open(f"file://{site / 'environments/index'}.html", "document.readyState === 'complete'")
        browser.size(*browser.run("const f = document.querySelector('iframe'); return [f.clientWidth, f.clientHeight]"))
        browser.open(f"file://{site / 'replay'}.html")
        browser.wait("document.querySelectorAll('.u-over').length === 3")
        heights, sides = browser.run("""
            const plots = [...document.querySelectorAll('aside .plot')];
            return [plots.map(each => each.querySelector('.u-over').clientHeight),
                    plots.map(each => each.getBoundingClientRect().right)]""")
        assert min(heights) >= 60 and heights[0] >= 90, heights
        assert max(sides) <= browser.run("return innerWidth")
        first = "return document.querySelector('aside .plot').getBoundingClientRect().bottom <= innerHeight"
        assert browser.run(first), "the chart of the tip error is on the screen"
    browser.size(1280, 720)
