"""Pages: what they show runs and prints what they say, and every link leads somewhere."""

import contextlib
import io
import re
import shlex
import shutil
import subprocess
import sys

import pytest

from oracles.files import ROOT

PAGES = ("own_task", "own_sensors", "own_arm", "own_controller", "training")
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)\s]+)\)")
STEPS = {"--steps": "512", "--envs": "2", "--episodes": "2", "--judge-every": "256"}  # in place of those of the page


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    """A folder with what a page uses of the repository."""
    (tmp_path / "docs").mkdir()
    shutil.copytree(ROOT / "docs" / "examples", tmp_path / "docs" / "examples")
    (tmp_path / "scripts").symlink_to(ROOT / "scripts")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def blocks(page):
    """Languages and texts of the blocks of a page."""
    return BLOCK.findall((ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8"))


def run(code, page, names):
    """Runs a block; gives what it printed."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(code, f"docs/{page}.md", "exec"), names)
    return printed.getvalue()


@pytest.mark.parametrize("page", PAGES)
def test_the_examples_of_a_page_run_and_print_what_it_says(page, checkout):
    if page in ("own_controller", "training"):
        pytest.importorskip("stable_baselines3")
    names = {"__name__": "page"}
    found = [*blocks(page), ("", "")]
    assert [language for language, _ in found].count("python") >= 2
    for (language, code), (following, said) in zip(found, found[1:], strict=False):
        if language == "python":
            printed = run(code, page, names)
            if following == "text":
                assert printed == said
    assert {path.name for path in checkout.iterdir()} <= {"docs", "scripts", "my_arm.json", "runs"}


def test_the_commands_of_the_page_about_training_run(checkout):
    pytest.importorskip("stable_baselines3")
    lines = [line for language, text in blocks("training") if language == "sh" for line in text.splitlines()]
    commands = [shlex.split(line, comments=True) for line in lines]
    assert len(commands) >= 4
    for command in commands:
        if command[0] != "python":
            continue
        for option, value in STEPS.items():
            if option in command:
                command[command.index(option) + 1] = value
        if "--envs" not in command and "scripts/train.py" in command:
            command += ["--envs", STEPS["--envs"]]
        done = subprocess.run([sys.executable, *command[1:]], capture_output=True, text=True, timeout=120)
        assert done.returncode == 0, (command, done.stderr)


def test_the_file_of_the_four_link_arm_is_used_and_all_files_of_the_folder_are():
    pages = "".join((ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8") for page in PAGES)
    pages += (ROOT / "README.md").read_text(encoding="utf-8") + "paper_ff.yaml"
    for path in (ROOT / "docs" / "examples").iterdir():
        assert path.name in pages, path


@pytest.mark.parametrize("page", ["README.md", *sorted(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md"))])
def test_links_and_pictures_lead_somewhere(page):
    text = BLOCK.sub("", (ROOT / page).read_text(encoding="utf-8"))
    for target in LINK.findall(text):
        if "://" not in target and not target.startswith("#"):
            assert ((ROOT / page).parent / target.partition("#")[0]).exists(), target
