"""Completion of command lines: scripts of the shells, and words that bash finds with its script."""

import shutil
import subprocess
import sys

import pytest

from flexman_gym.__main__ import COMMAND_GROUPS, main

SHELLS = ("bash", "zsh", "fish")
COMPLETE = (
    'source "$1"; COMP_WORDS=("${@:2}"); COMP_CWORD=$(($# - 2)); _shtab_flexman; printf "%s\\n" "${COMPREPLY[@]}"'
)


@pytest.fixture(scope="module")
def scripts(tmp_path_factory):
    """Return the files of the scripts by shell."""
    pytest.importorskip("stable_baselines3")
    pytest.importorskip("shtab")
    folder = tmp_path_factory.mktemp("completion")
    for shell in SHELLS:
        with (folder / shell).open("w") as file:
            words = [sys.executable, "-m", "flexman_gym", "--print-completion", shell]
            subprocess.run(words, stdout=file, check=True)
    return {shell: folder / shell for shell in SHELLS}


@pytest.mark.slow
@pytest.mark.parametrize(("words", "found"), [
    (["eval"], {"evaluate"}), (["optimise", ""], {"slews", "gains", "arm"}), 
    (["evaluate", "lqr"], {"lqr", "lqr-tracking"}), (["evaluate", "pd", "--js"], {"--json"}),
    (["evaluate", "pd", "--env", "FlexRRR-T"], {"FlexRRR-Track-v0"}),
    (["simulate", "paper_f"], {"paper_fr", "paper_ff"}), (["train", "planar_ppo"], {"planar_ppo_on_pd"}),
    (["evaluate", "runs/fi"], {"runs/first"}), (["draw", "camp"], {"campbell"}),
], ids=lambda given: " ".join(sorted(given) if isinstance(given, set) else given))  # fmt: skip
def test_bash_completes(words, found, scripts, tmp_path):
    (tmp_path / "runs" / "first").mkdir(parents=True)
    command = ["bash", "-c", COMPLETE, "bash", str(scripts["bash"]), "flexman", *words]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=True)
    assert {*done.stdout.split()} == found, done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("shell", SHELLS)
def test_script_has_all_commands_and_is_read_by_its_shell(shell, scripts):
    text = scripts[shell].read_text()
    assert all(name in text for names in COMMAND_GROUPS.values() for name in names)
    assert "privileged-lqr" in text and "FlexRRR-Track-v0" in text and "__main__" not in text
    if shutil.which(shell):
        subprocess.run([shell, "-n", str(scripts[shell])], check=True)


def test_without_its_package_the_extra_is_named(monkeypatch, capsys):
    pytest.importorskip("stable_baselines3")
    monkeypatch.setitem(sys.modules, "shtab", None)
    assert main(["--print-completion", "bash"]) == 2
    assert capsys.readouterr().err == "completion needs shtab: pip install 'flexman_gym[train]'\n"
