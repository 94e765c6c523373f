"""Tests of the age of evidence: what is noticed, what is made again, what a release refuses, what a page says."""

import json
import os
import shutil
import subprocess
from dataclasses import replace

import pytest

import flexman_gym as fm
from studies.evidence import (
    CURRENT,
    MISSING,
    RECORDS,
    ROOT,
    STALE,
    TRACES,
    UNKNOWN,
    Checkout,
    EvidenceStudy,
    make,
    studies,
)
from studies.files import MADE, add_code, made_comment, read_comment, split_made, today
from studies.staleness import described, insert_notes, note, release_faults

NUMBERS = "FACTOR = 2.0\n\n\ndef double(x):\n    return FACTOR * x\n"
COMMAND = """from pathlib import Path

from numbers_ import double

def main():
    Path("rows.csv").exists() and Path("rows.csv").read_text()
    with open("rows.csv", "a") as file:
        file.write(f"# computer, flexman_gym 0.2.0; made 2026-10-02, 1 row\\nx\\n{double(1.0)}\\n")

main()
"""
DRAW = 'text = open("rows.csv").read()\nopen("docs/page.md", "a").write("page")\n'
KNOWN = studies()


@pytest.fixture
def study(tmp_path):
    """Return a study in its own root, with a code file, and a command that appends a row."""
    (tmp_path / "numbers_.py").write_text(NUMBERS)
    (tmp_path / "write.py").write_text(COMMAND)
    (tmp_path / "draw.py").write_text(DRAW)
    (tmp_path / "docs").mkdir()
    return EvidenceStudy("study", ["rows.csv"], 1.0, ["write.py"])


def rows(root):
    """Return the number of rows that were written."""
    return (root / "rows.csv").read_text().count("\nx\n") if (root / "rows.csv").exists() else 0


def state(study, root):
    """Return the state of the rows."""
    return Checkout(root, ()).rows_age(study).state


def edit(path, old, new):
    """Replace a text of a file."""
    assert path.read_text().count(old) == 1
    path.write_text(path.read_text().replace(old, new))


@pytest.mark.slow
def test_what_is_made_is_not_made_again_and_what_failed_is(study, tmp_path):
    assert state(study, tmp_path) == MISSING
    edit(tmp_path / "write.py", "\nmain()\n", "\nmain()\nraise SystemExit('interrupted')\n")
    with pytest.raises(subprocess.CalledProcessError):
        make(study, tmp_path, neutral=())
    assert state(study, tmp_path) == UNKNOWN and not (tmp_path / RECORDS).exists()
    edit(tmp_path / "write.py", "raise SystemExit('interrupted')\n", "")
    for _ in range(2):
        make(study, tmp_path, neutral=())
        assert rows(tmp_path) == 2 and state(study, tmp_path) == CURRENT
    edit(tmp_path / "numbers_.py", "2.0", "3.0")
    age = Checkout(tmp_path, ()).rows_age(study)
    assert age == (STALE, ["numbers_.py FACTOR"]) and described(age) == "older than its code: numbers_.py FACTOR"
    make(study, tmp_path, neutral=())
    assert rows(tmp_path) == 3 and state(study, tmp_path) == CURRENT


@pytest.mark.slow
def test_rows_have_version_date_number_and_hash(study, tmp_path):
    make(study, tmp_path, neutral=())
    known = json.loads((tmp_path / RECORDS / "study.json").read_text())
    assert known["version"] == fm.__version__ and known["date"] == today() and known["minutes"] >= 0.0
    assert read_comment(tmp_path / "rows.csv").endswith(f"made 2026-10-02, 1 row, code {known['code']}")
    edit(tmp_path / "numbers_.py", "2.0", "3.0")
    (tmp_path / "rows.csv").unlink()
    make(study, tmp_path, neutral=())
    assert json.loads((tmp_path / RECORDS / "study.json").read_text())["code"] != known["code"]


@pytest.mark.slow
def test_an_interrupted_run_keeps_what_its_first_part_used_and_its_time(study, tmp_path):
    """The second session computes only what is missing, here nothing that calls `double`."""
    (tmp_path / "write.py").write_text(
        "import os\nfrom numbers_ import double\n\n"
        'if not os.path.exists("out/part"):\n    double(1.0)\n    open("out/part", "w").close()\n    os._exit(1)\n'
        'open("rows.csv", "w").write("x\\n")\n'
    )
    with pytest.raises(subprocess.CalledProcessError):
        make(study, tmp_path, neutral=())
    (trace,) = (tmp_path / TRACES).glob("trace-study-*")
    trace.write_text(trace.read_text() + "seconds\t120.0\t\t\n")
    make(study, tmp_path, neutral=())
    assert json.loads((tmp_path / RECORDS / "study.json").read_text())["minutes"] >= 2.0
    edit(tmp_path / "numbers_.py", "FACTOR * x", "FACTOR + x")
    assert Checkout(tmp_path, ()).rows_age(study) == (STALE, ["numbers_.py double"])


@pytest.mark.slow
def test_a_study_that_runs_what_is_missing_is_built_anew_in_a_folder_of_its_code(study, tmp_path):
    (tmp_path / "write.py").write_text(
        "import sys\nfrom pathlib import Path\nfrom numbers_ import double\n\n"
        'file = Path(sys.argv[1], "rows.csv")\nfile.parent.mkdir(parents=True, exist_ok=True)\n'
        "file.exists() or file.write_text(str(double(1.0)))\n"
    )
    built = replace(study, rows=["docs/rows.csv"], commands=["write.py out/{hash}"], built="out/{hash}")
    for factor in ("2.0", "3.0"):
        (tmp_path / "numbers_.py").write_text(NUMBERS.replace("2.0", factor))
        (tmp_path / "agents").mkdir(exist_ok=True)
        (tmp_path / "agents" / "code.yaml").write_text(factor)
        make(built, tmp_path, neutral=())
        assert (tmp_path / "docs" / "rows.csv").read_text() == factor and state(built, tmp_path) == CURRENT


@pytest.mark.slow
def test_a_change_of_the_drawing_or_of_the_rows_draws_and_keeps_the_rows(study, tmp_path):
    drawn = replace(study, drawn=["docs/page.md"], redraw="draw.py")
    (tmp_path / "docs" / "page.md").write_text("")
    for _ in range(2):
        make(drawn, tmp_path, neutral=())
        assert (rows(tmp_path), (tmp_path / "docs" / "page.md").read_text()) == (1, "page")
    edit(tmp_path / "draw.py", '"page"', '"PAGE"')
    (tmp_path / "rows.csv").write_text((tmp_path / "rows.csv").read_text() + "1\n")
    assert Checkout(tmp_path, ()).drawing_age(drawn) == (STALE, ["rows.csv"])
    make(drawn, tmp_path, neutral=())
    assert (rows(tmp_path), (tmp_path / "docs" / "page.md").read_text()) == (1, "pagePAGE")
    assert Checkout(tmp_path, ()).drawing_age(drawn).state == CURRENT


@pytest.mark.slow
def test_pages_are_drawn_from_rows_whose_code_has_changed(study, tmp_path):
    """The rows keep their record, or remain without one."""
    drawn = replace(study, drawn=["docs/page.md"], redraw="draw.py")
    (tmp_path / "docs" / "page.md").write_text("")
    (tmp_path / "rows.csv").write_text("x\n")
    make(drawn, tmp_path, rows=False, neutral=())
    assert ((tmp_path / "docs" / "page.md").read_text(), state(drawn, tmp_path)) == ("page", UNKNOWN)
    make(drawn, tmp_path, neutral=())
    edit(tmp_path / "numbers_.py", "2.0", "3.0")
    make(drawn, tmp_path, rows=False, neutral=())
    assert (rows(tmp_path), state(drawn, tmp_path)) == (1, STALE)
    assert Checkout(tmp_path, ()).drawing_age(drawn).state == CURRENT


@pytest.mark.slow
def test_code_of_processes_without_a_trace_is_hashed_whole(study, tmp_path):
    (tmp_path / "unseen.py").write_text("A = 1\n")
    whole = replace(study, code=["unseen.py"])
    make(whole, tmp_path, neutral=())
    edit(tmp_path / "unseen.py", "1", "1  # a comment")
    assert state(whole, tmp_path) == CURRENT
    edit(tmp_path / "unseen.py", "1 ", "2 ")
    assert Checkout(tmp_path, ()).rows_age(whole) == (STALE, ["unseen.py"])


@pytest.mark.slow
def test_rows_with_a_digest_each_are_older_than_their_code_one_by_one(study, tmp_path, monkeypatch):
    single = replace(study, outdated="studies.planted.measure:outdated", minutes=7.0)
    monkeypatch.setattr("studies.planted.measure.outdated", lambda root: [])
    copy = '[path.read_text() for path in Path("docs").rglob("*.*")]'
    edit(tmp_path / "write.py", "def main():\n", f"def main():\n    {copy}\n")
    for page in ("a page", "another page"):
        (tmp_path / "docs" / "page.md").write_text(page)
        make(single, tmp_path, neutral=())
        assert rows(tmp_path) == 1, "pages and records of makings are no inputs of rows with digests"
    assert state(single, tmp_path) == CURRENT and Checkout(tmp_path, ()).minutes(single) == 7.0
    monkeypatch.setattr("studies.planted.measure.outdated", lambda root: [f"{root.name}: 3 errors"])
    assert Checkout(tmp_path, ()).rows_age(single) == (STALE, [f"{tmp_path.name}: 3 errors"])


@pytest.mark.slow
def test_a_page_that_is_older_than_its_code_says_so_at_its_top(study, tmp_path):
    drawn, site = replace(study, drawn=["docs/page.md"], redraw="draw.py"), tmp_path / "site"
    (tmp_path / "docs" / "page.md").write_text("")
    site.mkdir()
    html = "<nav></nav><h1>Title</h1>\n<p>Answer.</p><h1>Part</h1>"
    (site / "page.html").write_text(html)
    make(drawn, tmp_path, neutral=())
    assert insert_notes(Checkout(tmp_path, ()), [drawn], site) == [] and (site / "page.html").read_text() == html
    edit(tmp_path / "numbers_.py", "FACTOR * x", "FACTOR + x")
    since = f"version {fm.__version__} of {today()}"
    text = f"These rows are older than the code: numbers_.py double changed since {since}."
    assert insert_notes(Checkout(tmp_path, ()), [drawn], site) == [f"page.html: {text}"]
    marked = f'<nav></nav><h1>Title</h1>\n<p class="old"><em>{text}</em></p>\n<p>Answer.</p><h1>Part</h1>'
    assert (site / "page.html").read_text() == marked
    (tmp_path / RECORDS / "study.json").unlink()
    expected = (
        "Measured numbers of this page are of version 0.2.0 and may be older than the code: no record of it was kept "
        "when they were made."
    )
    assert note(Checkout(tmp_path, ()), drawn) == expected


@pytest.mark.slow
def test_a_release_refuses_old_rows_of_readme_and_home_and_very_old_rows_of_other_pages(study, tmp_path, monkeypatch):
    (tmp_path / "scripts").mkdir()
    (tmp_path / "readme.py").write_text('open("rows.csv").read()\n')
    other = EvidenceStudy("other", ["other.csv"], 1.0, ["write.py"])
    (tmp_path / "other.csv").write_text("# computer, flexman_gym 0.2.0\nx\n")
    monkeypatch.setattr(fm, "__version__", "0.3.0")
    make(study, tmp_path, neutral=())
    assert release_faults(Checkout(tmp_path, ()), [study, other]) == []
    edit(tmp_path / "numbers_.py", "2.0", "3.0")
    (tmp_path / "other.csv").write_text("# computer, flexman_gym 0.1.0\nx\n")
    assert release_faults(Checkout(tmp_path, ()), [study, other]) == [
        "study, of README or home: older than its code: numbers_.py FACTOR",
        "other: rows of version 0.1.0, more than one version old",
    ]


def test_wheels_of_a_release_are_not_built_with_old_numbers(tmp_path):
    (tmp_path / "scripts").mkdir()
    shutil.copy(ROOT / "scripts" / "wheels.sh", tmp_path / "scripts")
    python = tmp_path / ".venv" / "bin" / "python"
    python.parent.mkdir(parents=True)
    command = [tmp_path / "scripts" / "wheels.sh", "wheels", "false"]  # `false` is no Python: a build stops there
    for old, trial, built in ((1, "", False), (1, "1", True), (0, "", True)):
        python.write_text(f'#!/bin/sh\n[ "$*" = "-m studies evidence --release" ] && exit {old}\nexit 2\n')
        python.chmod(0o755)
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, env=os.environ | {"TRIAL": trial})
        assert done.returncode == 1 and ("TRIAL=1 builds wheels" in done.stderr) == (not built)
        assert (tmp_path / "wheels").exists() == built
        shutil.rmtree(tmp_path / "wheels", ignore_errors=True)


def test_a_comment_has_the_computer_the_date_the_number_of_rows_and_the_hash(tmp_path):
    comment = made_comment("processor A, flexman_gym 0.2.0", "2026-11-30", 12)
    assert comment == "processor A, flexman_gym 0.2.0; made 2026-11-30, 12 rows"
    assert split_made(comment) == ("processor A, flexman_gym 0.2.0", "2026-11-30")
    assert split_made("processor A") == ("processor A", "")
    for first, expected in ((comment, f"{comment}, code b"), ("processor A", "processor A")):
        (tmp_path / "rows.csv").write_text(f"# {first}\nx\n1\n")
        for code in ("a", "b"):
            add_code(tmp_path / "rows.csv", code)
        assert (tmp_path / "rows.csv").read_text() == f"# {expected}\nx\n1\n"


@pytest.mark.evidence
@pytest.mark.parametrize("name", KNOWN)
def test_files_and_commands_of_a_study_exist(name):
    study = KNOWN[name]
    for pattern in (*study.code, *study.rows, *study.drawn):
        assert any(ROOT.glob(pattern)), pattern
    for command in (*study.commands, study.redraw):
        program, *words = command.split(" ")
        file = f"scripts/studies/runners/{words[0]}.py" if program == "studies" else program
        assert program in ("", "flexman") or (ROOT / file).is_file(), command


@pytest.mark.evidence
def test_files_that_change_no_result_exist():
    assert all((ROOT / path).is_file() for path in Checkout().neutral)


@pytest.mark.evidence
def test_records_are_small_and_those_of_studies_within_their_budgets():
    paths = {path.stem: path for path in (ROOT / RECORDS).glob("*.json")}
    assert paths.keys() <= KNOWN.keys() and sum(path.stat().st_size for path in paths.values()) < 1_500_000
    for name, study in KNOWN.items():
        assert study.budget is None or Checkout().minutes(study) <= study.budget, name


@pytest.mark.evidence
@pytest.mark.parametrize("name", KNOWN)
def test_a_record_has_version_and_hash_of_the_rows(name):
    record = Checkout().record(name)
    for path in (path for pattern in KNOWN[name].rows for path in ROOT.glob(pattern) if path.suffix == ".csv"):
        if "code" in record and MADE in (comment := read_comment(path)):
            assert comment.endswith(f", code {record['code']}") and f"flexman_gym {record['version']}" in comment
