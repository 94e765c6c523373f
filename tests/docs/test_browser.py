"""Tests of the built site in a browser: search, equations, and no network requests, opened from disk."""

import shutil
import subprocess
import sys

import pytest
import yaml

from oracles.browser import one_browser
from oracles.files import ROOT

AWAY = (
    "return performance.getEntriesByType('resource').map(each => each.name).filter(each => !each.startsWith('file:'))"
)


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


def test_pages_ask_nobody_and_their_equations_are_drawn(site, browser):
    for page, least in (("index", 0), ("theory", 40), ("api/simulation", 1)):
        browser.open(f"file://{site / page}.html", "document.readyState === 'complete'")
        browser.wait("document.querySelectorAll('.arithmatex:not(:has(.katex))').length === 0")
        assert browser.run("return document.querySelectorAll('.katex').length") >= least
        assert browser.run("return document.querySelectorAll('.katex-error').length") == 0
        assert browser.run("return [...document.fonts].filter(each => each.status === 'error').length") == 0
        assert browser.run(AWAY) == [] and browser.said() == []


def test_the_search_finds_a_word(site, browser):
    browser.open(f"file://{site / 'index.html'}", "document.querySelector('.md-search__button')")
    browser.run("document.querySelector('.md-search__button').click()")
    inside = "[...document.querySelectorAll('*')].flatMap(each => [...each.shadowRoot?.querySelectorAll('%s') ?? []])"
    browser.wait(f"{inside % 'input'}.length === 1")
    browser.write("foreshortening")
    browser.wait(f"{inside % 'a'}.some(each => /theory.html.*#foreshortening$/.test(each.href))")
    assert browser.run(AWAY) == [] and browser.said() == []
