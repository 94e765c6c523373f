"""Tests of the notebooks of the tutorials: text, code and outputs are those of their pages."""

import json
import os
import re
import sys
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import addresses
import notebooks as converter
import pytest
import yaml

from oracles.files import ROOT

TUTORIALS = {page.stem: page for page in converter.PAGES}
NOTEBOOKS = {path.stem: json.loads(path.read_text(encoding="utf-8")) for path in converter.FOLDER.glob("*.ipynb")}
MAX_SIZE = 2_000_000  # bytes of all notebooks


def without_outputs(notebook):
    """Return a notebook without its outputs."""
    empty = {"outputs": [], "execution_count": None}
    cells = [cell | empty if cell["cell_type"] == "code" else cell for cell in notebook["cells"]]
    return notebook | {"cells": cells}


def wrong_prints(page, notebook):
    """Return the code of the cells that do not print what the page shows below them."""
    shown = [
        said if following == "text" else None
        for (language, _), (following, said) in pairwise(
            [*converter.BLOCK.findall(page.read_text(encoding="utf-8")), ("", "")]
        )
        if language in ("python", "sh")
    ]
    run = [cell for cell in converter.code(notebook) if "google.colab" not in "".join(cell["source"])]
    printed = ["".join("".join(each.get("text", "")) for each in cell["outputs"]) for cell in run]
    return [
        "".join(cell["source"])
        for cell, text, said in zip(run, printed, shown, strict=True)
        if said is not None and text != said
    ]


def test_every_tutorial_has_its_notebook_in_the_list():
    listed = (converter.FOLDER / "index.md").read_text(encoding="utf-8")
    assert NOTEBOOKS.keys() == TUTORIALS.keys() and len(NOTEBOOKS) >= 8
    for name, page in TUTORIALS.items():
        assert f"({name}.ipynb)" in listed and f"{name}.ipynb)" in page.read_text(encoding="utf-8")
    assert sum(path.stat().st_size for path in converter.FOLDER.glob("*.ipynb")) < MAX_SIZE


@pytest.mark.parametrize("name", TUTORIALS)
def test_a_notebook_is_its_page_and_shows_what_it_prints(name):
    """After an edit of a page `make notebooks` writes its notebook, and runs it if its code has changed."""
    expected = converter.notebook(TUTORIALS[name], addresses.read().repository)
    assert without_outputs(NOTEBOOKS[name]) == expected
    assert wrong_prints(TUTORIALS[name], NOTEBOOKS[name]) == []
    code = converter.code(NOTEBOOKS[name])
    assert all(cell["execution_count"] for cell in code) and str(ROOT) not in json.dumps(code)
    figures = [cell for cell in code if "plt.subplots" in "".join(cell["source"])]
    assert all("image/png" in json.dumps(cell["outputs"]) for cell in figures)


@pytest.mark.parametrize("name", TUTORIALS)
def test_the_cells_of_a_notebook_are_its_page(name):
    """Put together again, the cells are the page but for what its blocks print."""
    text = TUTORIALS[name].read_text(encoding="utf-8")
    written, pieces, prints = [], converter.PLOT.sub("", text).split("```"), False
    for fence, piece in enumerate(pieces):  # every other piece is a block
        prints = fence % 2 == 1 and piece.startswith("text\n")
        if piece.startswith("sh\n") and fence % 2:
            piece = "".join(f"!{line}\n" for line in piece.splitlines()[1:])
        written += [] if prints else piece.removeprefix("python").split()
    cells = converter.cells(text)
    assert " ".join(part for _, part in cells).replace("```", " ").split() == written
    code = [part for kind, part in cells if kind == "code"]
    assert len(code) == len([piece for piece in pieces[1::2] if piece.startswith(("python\n", "sh\n"))])
    for part in code:
        if not part.startswith("!"):
            compile(part, name, "exec")


@pytest.mark.slow
@pytest.mark.parametrize("name", TUTORIALS)
def test_a_notebook_runs_and_prints_what_its_page_says(name, tmp_path, monkeypatch):
    pytest.importorskip("nbclient")
    pytest.importorskip("stable_baselines3")
    monkeypatch.setenv("PATH", os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]))
    content = converter.notebook(TUTORIALS[name])
    converter.execute(content, tmp_path)
    assert wrong_prints(TUTORIALS[name], content) == []
    shown = set(re.findall(r"\((my_\w+\.png)\)", TUTORIALS[name].read_text(encoding="utf-8")))
    assert shown <= {path.name for path in tmp_path.iterdir()}


def test_outputs_are_kept_while_the_code_is_the_same(tmp_path):
    page = tmp_path / "fit.md"
    for old, new in (("```python\n", "```python\nprint(0)\n"), ("\n\n", "\n\nWords. ")):
        page.write_text(TUTORIALS["fit"].read_text(encoding="utf-8").replace(old, new, 1), encoding="utf-8")
        same_code = new == "\n\nWords. "
        assert converter.copy_outputs(NOTEBOOKS["fit"], converter.notebook(page)) == same_code


def test_links_of_a_notebook_lead_somewhere():
    for name, notebook in NOTEBOOKS.items():
        text = "".join("".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "markdown")
        for target in re.findall(r"\]\(([^)#\s]+)", re.sub(r"`[^`\n]*`", "`", text)):
            assert "://" in target or (converter.FOLDER / target).exists(), (name, target)


def test_a_notebook_on_colab_installs_the_package_first():
    address = "https://github.com/owner/name"
    first, *others = converter.notebook(TUTORIALS["fit"], address)["cells"]
    assert f"git clone --quiet --depth 1 {address} " in "".join(first["source"])
    plain = converter.notebook(TUTORIALS["fit"])["cells"]
    assert [cell["source"] for cell in others] == [cell["source"] for cell in plain]


def colab_link(url, content, address):
    """Return what the theme shows above a page: a link to Google Colab, or nothing."""
    jinja2 = pytest.importorskip("jinja2")
    text = (ROOT / "scripts" / "web" / "theme" / "partials" / "actions.html").read_text(encoding="utf-8")
    page, config = SimpleNamespace(url=url, content=content), SimpleNamespace(repo_url=address)
    return jinja2.Template(text).render(page=page, config=config).strip()


def test_pages_with_a_notebook_link_to_colab_once_there_is_a_repository():
    settings = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
    assert settings["repo_url"] == addresses.read().repository  # of the theme, and of the notebooks
    there, content = "https://github.com/owner/name", '<a href="fit.ipynb">notebook</a>'
    link = colab_link("tutorials/fit.html", content, there)
    assert 'href="https://colab.research.google.com/github/owner/name/blob/main/docs/tutorials/fit.ipynb"' in link
    assert "docs/tutorials/fit.ipynb" in colab_link("fit.html", content, there)  # such as concepts.html
    for other in (("tutorials/fit.html", content, ""), ("tutorials/fidelity.html", content, there),
                  ("tutorials/fit.html", content, "https://example.org/owner/name")):  # fmt: skip
        assert colab_link(*other) == ""


def test_a_notebook_is_valid():
    validate = pytest.importorskip("nbformat").validate
    for each in NOTEBOOKS.values():
        validate(each)
