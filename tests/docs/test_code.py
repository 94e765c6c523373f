"""Tests of the code in pages and README: it runs and prints the shown output."""

import argparse
import contextlib
import doctest
import importlib
import io
import re
import shlex
import shutil
import sys
from itertools import pairwise

import gymnasium as gym
import keywords
import pytest

import flexman_gym as fm
from flexman_gym.__main__ import COMMAND_GROUPS, main
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.scene.serialization import find_arm
from flexman_gym.toolbox.deployment.machine import simulated

from oracles.commands import use_less_episodes, with_less_work
from oracles.files import ROOT
from oracles.machines import FakeSimulatedMachine

BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
DOCS, README = ROOT / "docs", (ROOT / "README.md").read_text(encoding="utf-8")
TEXTS = {str(path.relative_to(DOCS))[:-3]: path.read_text(encoding="utf-8") for path in sorted(DOCS.rglob("*.md"))}
PAGES = [page for page, text in TEXTS.items() if "python" in [language for language, _ in BLOCK.findall(text)]]
LESS_IN_PYTHON = (
    (r"STEPS = [\d_]+", "STEPS = 256"), (r"circles\(\d+\)", "circles(4)"), (r'-v0", 256', '-v0", 4'),
    (r"horizon=2.0", "horizon=0.4"), (r"n_eval_episodes=10", "n_eval_episodes=2"),
)  # fmt: skip


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    """Return a folder with the repository files used by the pages."""
    (tmp_path / "docs").mkdir()
    shutil.copytree(ROOT / "docs" / "examples", tmp_path / "docs" / "examples")
    (tmp_path / "scripts").symlink_to(ROOT / "scripts")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    return tmp_path


def blocks(page):
    """Return languages and texts of the code blocks of a page."""
    return BLOCK.findall(TEXTS[page])


def run(code, page, names):
    """Run a Python block and return its output."""
    for pattern, less in LESS_IN_PYTHON:
        code = re.sub(pattern, less, code)
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(code, f"docs/{page}.md", "exec"), names)
    return printed.getvalue()


def run_commands(lines, less=True):
    """Run the commands of a block, with less work if `less`; return the output of the last. Videos become GIFs."""
    printed = io.StringIO()
    for words in map(shlex.split, lines.replace(".mp4", ".gif").splitlines()):
        assert words[0] == "flexman", words
        with contextlib.redirect_stdout(printed := io.StringIO()):
            assert main(with_less_work(words[1:]) if less else words[1:]) == 0, words
    return printed.getvalue()


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_a_page_runs_and_prints_what_it_says(page, checkout, monkeypatch):
    if any(
        words in text for _, text in blocks(page) for words in ("stable_baselines3", "flexman_agents", "flexman train")
    ):
        pytest.importorskip("stable_baselines3")
        use_less_episodes(monkeypatch)
    if any("matplotlib" in text or "flexman draw" in text for _, text in blocks(page)):
        pytest.importorskip("matplotlib").use("Agg")
    if any("control.hinf" in text for _, text in blocks(page)):
        pytest.importorskip("slycot")
    monkeypatch.setattr(simulated, "SimulatedMachine", FakeSimulatedMachine)
    names, result = {"__name__": "page"}, blocks(page)
    for (language, text), (following, said) in pairwise([*result, ("", "")]):
        if language == "sh":
            printed = run_commands(text, less=following != "text")
        if language == "python":
            printed = run(text, page, names)
        if language in ("sh", "python"):
            assert following != "text" or printed == said
    assert all(path.name in ("docs", "scripts", "runs") or path.stem.startswith("my_") for path in checkout.iterdir())


@pytest.mark.slow
def test_the_readme_runs_without_the_checkout(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (code,) = (text for language, text in BLOCK.findall(README) if language == "python")
    assert "'settled': 1.0" in run(code, "README", {"__name__": "page"})
    assert len([line for line in code.splitlines() if line]) <= 8


COMMANDS = [line.partition("#")[0] for _, text in BLOCK.findall(README) for line in text.splitlines()
            if line.startswith("flexman ")]  # fmt: skip


@pytest.mark.parametrize("line", COMMANDS)
def test_commands_of_the_readme_take_these_arguments(line):
    pytest.importorskip("stable_baselines3")
    _, command, *words = shlex.split(line)
    parser = argparse.ArgumentParser()
    importlib.import_module(f"flexman_gym.commands.{command}").COMMAND.arguments(parser)
    parser.parse_args(words)


def test_the_table_of_commands_is_that_of_their_parsers():
    page = (DOCS / keywords.COMMANDS_PAGE).read_text(encoding="utf-8")
    assert keywords.commands_page(page) == page and page.count("| `") >= len(sum(COMMAND_GROUPS.values(), ()))


def test_targets_of_make_are_there():
    targets = re.findall(r"`make (\w+)`", README)
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert {"demo", "test"} <= {*targets} and all(f"\n{target}:" in makefile for target in targets)


def test_the_examples_are_those_of_the_pages():
    described = Configuration.load(ROOT / "docs" / "examples" / "four_link_arm.yaml")
    assert described.arm.n_joints == 4
    shown = {page: [text for _, text in blocks(page)] for page in PAGES}
    assert (ROOT / "docs" / "examples" / "planar_payload.yaml").read_text(encoding="utf-8") in shown["training"]
    strips = find_arm(str(ROOT / "docs" / "examples" / "strip_arm.yaml"))
    assert strips.n_joints == 2 and all(joint.motor for joint in strips.joints)
    (feedback,) = [text for text in shown["own_controller"] if "class StrainFeedback" in text]
    file = (ROOT / "docs" / "examples" / "strain_feedback.py").read_text(encoding="utf-8")
    assert feedback.partition("class")[2] == file.partition("class")[2].partition("\n\n\ndef make")[0] + "\n"
    _, _, circle = (ROOT / "docs" / "examples" / "circle.py").read_text(encoding="utf-8").partition("TURN")
    assert shown["own_task"][0].endswith(circle)


def test_every_file_among_the_examples_is_shown_somewhere():
    pages = "".join(TEXTS.values()) + README
    for path in (ROOT / "docs" / "examples").iterdir():
        assert path.name in pages, path


# What people type most; every other name may have an example.
USUAL = {
    "Arm", "FlexManEnv", "Joint", "Link", "Motor", "Payload", "SampledTorque", "Scene", "Simulator", "acceleration",
    "Fit", "Model", "choose_model", "curves", "evaluate", "frequencies", "linearize", "mass_matrix", "modes",
    "paper_rrr", "rollout", "simulate",
}  # fmt: skip
PUBLIC = {name: getattr(fm, name) for name in fm.__all__} | vars(fm.catalog) | {"FlexManEnv": FlexManEnv}
FOUND = {
    name: [each for each in doctest.DocTestFinder(exclude_empty=True).find(value, name) if each.examples]
    for name, value in PUBLIC.items()
    if callable(value)
}


def test_the_usual_names_have_examples():
    assert {name for name, examples in FOUND.items() if examples} >= USUAL


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(name for name, examples in FOUND.items() if examples))
def test_examples_run_and_give_what_they_say(name):
    for each in FOUND[name]:
        each.globs = {"fm": fm, "gym": gym}
        said = []
        result = doctest.DocTestRunner(optionflags=doctest.FAIL_FAST).run(each, out=said.append)
        assert result.attempted and not result.failed, "".join(said)


def test_the_page_of_keywords_is_that_of_the_table():
    assert (ROOT / "docs" / keywords.KEYWORDS_PAGE).read_text(encoding="utf-8") == keywords.keywords_page()
