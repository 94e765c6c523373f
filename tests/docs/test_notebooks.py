"""Notebooks: they hold the prose and run the code of their tutorials, which tests run as pages."""

import json
import subprocess
import sys

import pytest

from oracles.files import ROOT

TUTORIALS = sorted((ROOT / "docs" / "tutorials").glob("*.md"))


@pytest.fixture(scope="module")
def notebooks(tmp_path_factory):
    """The notebooks by name, as the script writes them."""
    folder = tmp_path_factory.mktemp("notebooks")
    subprocess.run([sys.executable, ROOT / "scripts" / "notebooks.py", "--folder", folder], check=True)
    return {path.stem: json.loads(path.read_text(encoding="utf-8")) for path in folder.glob("*.ipynb")}


def test_there_is_one_for_each_tutorial(notebooks):
    assert notebooks.keys() == {page.stem for page in TUTORIALS} and len(notebooks) >= 7


@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_a_notebook_is_its_page(page, notebooks):
    """Put together again, the cells are the page but for what its blocks print."""
    written, pieces, prints = [], page.read_text(encoding="utf-8").split("```"), False
    for fence, piece in enumerate(pieces):  # every other piece is a block
        prints = fence % 2 == 1 and piece.startswith("text\n")
        if piece.startswith("sh\n") and fence % 2:
            piece = "".join(f"!{line}\n" for line in piece.splitlines()[1:])
        written += [] if prints else piece.removeprefix("python").split()
    cells = [("".join(cell["source"]), cell["cell_type"]) for cell in notebooks[page.stem]["cells"]]
    assert " ".join(text for text, _ in cells).replace("```", " ").split() == written
    code = [text for text, kind in cells if kind == "code"]
    assert len(code) == len([piece for piece in pieces[1::2] if piece.startswith(("python\n", "sh\n"))])
    for text in code:
        if not text.startswith("!"):
            compile(text, page.name, "exec")


def test_a_notebook_is_valid(notebooks):
    validate = pytest.importorskip("nbformat").validate
    for each in notebooks.values():
        validate(each)
