"""Tests of the age of evidence: what counts as a change of the code, and what is made again."""

import ast
import json
import subprocess
from dataclasses import replace

import pytest

import flexman_gym as fm
from studies.evidence import (
    CURRENT,
    MISSING,
    RECORD,
    ROOT,
    STALE,
    UNKNOWN,
    EvidenceStudy,
    hash_of,
    make,
    read_record,
    studies,
)
from studies.files import read_comment

CODE = '"""Docstring."""\n\nFACTOR = 2.0  # of nothing\n\n\ndef double(x):\n    """Double."""\n    return FACTOR * x\n'
COMMAND = 'open("rows.csv", "a").write("row\\n")\n'
KNOWN = studies()


@pytest.fixture
def study(tmp_path):
    """Return a study in its own root, with a code file, and a command that appends a row."""
    (tmp_path / "code").mkdir()
    (tmp_path / "code" / "double.py").write_text(CODE)
    (tmp_path / "write.py").write_text(COMMAND)
    (tmp_path / RECORD).parent.mkdir(parents=True)
    (tmp_path / RECORD).write_text("{}")
    return EvidenceStudy("study", ["code"], ["rows.csv"], ["write.py"], 1.0)


def rows(root):
    """Return the number of rows that were written."""
    return (root / "rows.csv").read_text().count("row") if (root / "rows.csv").exists() else 0


def state(study, root):
    """Return the state of the rows."""
    return study.rows_state(read_record(root).get(study.name, {}), root)


@pytest.mark.parametrize(
    ("old", "new", "changed"),
    [
        ("return FACTOR * x", "return FACTOR + x", True),
        ("FACTOR = 2.0", "FACTOR = 2.5", True),
        ("# of nothing", "# another comment", False),
        ('"""Double."""', '"""Return twice the number.\n\n    In two lines.\n    """', False),
        ("\n\n\ndef", "\n\ndef", False),
    ],
)
def test_only_a_change_of_code_makes_rows_stale(study, tmp_path, old, new, changed):
    make(study, tmp_path)
    assert state(study, tmp_path) == CURRENT
    assert CODE.count(old) == 1
    (tmp_path / "code" / "double.py").write_text(CODE.replace(old, new))
    assert state(study, tmp_path) == (STALE if changed else CURRENT)


def test_a_new_a_renamed_and_a_data_file_are_changes(study, tmp_path):
    make(study, tmp_path)
    (tmp_path / "code" / "data.csv").write_text("1\n")
    with_data = hash_of(study.code, tmp_path)
    assert state(study, tmp_path) == STALE
    (tmp_path / "code" / "data.csv").write_text("2\n")
    assert hash_of(study.code, tmp_path) != with_data
    (tmp_path / "code" / "data.csv").unlink()
    assert state(study, tmp_path) == CURRENT
    (tmp_path / "code" / "double.py").rename(tmp_path / "code" / "twice.py")
    assert state(study, tmp_path) == STALE


def test_rows_without_a_record_are_unknown_and_absent_rows_missing(study, tmp_path):
    assert state(study, tmp_path) == MISSING
    (tmp_path / "rows.csv").write_text("")
    assert state(study, tmp_path) == UNKNOWN


def test_what_is_made_is_not_made_again_and_what_failed_is(study, tmp_path):
    (tmp_path / "write.py").write_text(COMMAND + 'raise SystemExit("interrupted")\n')
    with pytest.raises(subprocess.CalledProcessError):
        make(study, tmp_path)
    assert state(study, tmp_path) == UNKNOWN and read_record(tmp_path) == {}
    (tmp_path / "write.py").write_text(COMMAND)
    for _ in range(2):
        make(study, tmp_path)
        assert rows(tmp_path) == 2 and state(study, tmp_path) == CURRENT
    assert read_record(tmp_path)["study"]["version"] == fm.__version__
    (tmp_path / "code" / "double.py").write_text(CODE.replace("2.0", "3.0"))
    make(study, tmp_path)
    assert rows(tmp_path) == 3


def test_a_change_of_the_drawing_draws_and_keeps_the_rows(study, tmp_path):
    drawn = replace(study, drawing=["draw.py"], drawn=["page.md"], redraw="draw.py")
    (tmp_path / "draw.py").write_text('open("page.md", "a").write("page")\n')
    (tmp_path / "write.py").write_text(COMMAND + 'open("page.md", "a").write("page")\n')
    make(drawn, tmp_path)
    make(drawn, tmp_path)
    assert (rows(tmp_path), (tmp_path / "page.md").read_text()) == (1, "page")
    (tmp_path / "draw.py").write_text('open("page.md", "a").write("PAGE")\n')
    assert drawn.drawing_state(read_record(tmp_path)["study"], tmp_path) == STALE
    make(drawn, tmp_path)
    assert (rows(tmp_path), (tmp_path / "page.md").read_text()) == (1, "pagePAGE")
    assert drawn.drawing_state(read_record(tmp_path)["study"], tmp_path) == CURRENT


def test_pages_are_drawn_from_rows_whose_code_has_changed(study, tmp_path):
    """The rows keep their record, or remain without one."""
    drawn = replace(study, drawing=["draw.py"], drawn=["page.md"], redraw="draw.py")
    (tmp_path / "draw.py").write_text('open("page.md", "a").write("page")\n')
    (tmp_path / "rows.csv").write_text("row\n")
    make(drawn, tmp_path, rows=False)
    assert (rows(tmp_path), (tmp_path / "page.md").read_text(), state(drawn, tmp_path)) == (1, "page", UNKNOWN)
    make(drawn, tmp_path)
    (tmp_path / "code" / "double.py").write_text(CODE.replace("2.0", "3.0"))
    (tmp_path / "draw.py").write_text('open("page.md", "a").write("PAGE")\n')
    make(drawn, tmp_path, rows=False)
    assert (rows(tmp_path), (tmp_path / "page.md").read_text(), state(drawn, tmp_path)) == (2, "pagePAGE", STALE)
    assert drawn.drawing_state(read_record(tmp_path)["study"], tmp_path) == CURRENT


@pytest.mark.parametrize("name", KNOWN)
def test_files_and_commands_of_a_study_exist(name):
    study = KNOWN[name]
    for pattern in (*study.code, *study.rows, *study.drawing, *study.drawn):
        assert any(ROOT.glob(pattern)), pattern
    for command in (*study.commands, study.redraw):
        program, *words = command.split(" ")
        file = f"scripts/studies/runners/{words[0]}.py" if program == "studies" else program
        assert program in ("", "flexman") or (ROOT / file).is_file(), command


OTHER = {"common", "draw"}  # packages of flexman_gym with files, processes and plots, which do not change numbers
DRAWING = {"charts", "files", "markdown", "screen", "page"}  # modules of studies that do not change numbers


def imported(file):
    """Return the modules that a Python file imports, with names that may be modules."""
    nodes = [node for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))) if isinstance(node, ast.ImportFrom)]
    return {name for node in nodes for name in (node.module, *(f"{node.module}.{each.name}" for each in node.names))}


@pytest.mark.parametrize("name", KNOWN)
def test_the_code_of_a_study_includes_what_it_imports(name):
    paths = [path for pattern in KNOWN[name].code for path in ROOT.glob(pattern)]
    code = {each for path in paths for each in (path.rglob("*.py") if path.is_dir() else [path])}
    folders = {path.relative_to(ROOT).parts[1] for path in code if path.parts[len(ROOT.parts)] == "flexman_gym"}
    for file in (each for each in code if each.suffix == ".py" and ROOT / "scripts" in each.parents):
        modules = [module.split(".") for module in imported(file)]
        assert {each[1] for each in modules if each[0] == "flexman_gym" and len(each) > 2} <= folders | OTHER, file
        used = {ROOT.joinpath("scripts", *each).with_suffix(".py") for each in modules if each[0] == "studies"}
        assert {each for each in used if each.exists() and each.stem not in DRAWING} <= code, file


def test_the_record_has_the_versions_of_the_rows():
    record = json.loads((ROOT / RECORD).read_text(encoding="utf-8"))
    assert record.keys() == KNOWN.keys()
    for name, study in KNOWN.items():
        for path in (path for pattern in study.rows for path in ROOT.glob(pattern) if path.suffix == ".csv"):
            if "flexman_gym" in (comment := read_comment(path)):
                assert f"flexman_gym {record[name]['version']}" in comment, path
