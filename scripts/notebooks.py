"""Notebooks of the tutorials, with their outputs: python scripts/notebooks.py

A notebook has the text and the code of its page. Stored outputs are kept while the code is the same; a notebook with
new code is run again.
"""

import argparse
import json
import os
import re
import shutil
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import addresses

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
FOLDER = DOCS / "tutorials"
PAGES = [
    DOCS / "concepts.md",
    DOCS / "exercises.md",
    *sorted(each for each in FOLDER.glob("*.md") if each.stem != "index"),
]
BLOCK = re.compile(r"^```(python|sh|text)\n(.*?)^```\n?", re.MULTILINE | re.DOTALL)
PLOT = re.compile(r"^!\[[^\]]*\]\(my_\w+\.png\)\n", re.MULTILINE)  # a notebook shows the plot below its code
LINK = re.compile(r"\]\((?!https?:|#)(?=[^)]+\))")  # beginning of a link to a file
TIMEOUT = 3600  # s; longest time of a cell: the training of the first policy takes 100 s of CPU time
COLAB = """\
import sys

if "google.colab" in sys.modules:  # install the package on this computer of Google
    !git clone --quiet --depth 1 {address} checkout
    %cd checkout
    !pip install --quiet '.[train,render]'"""
"""Code of the first cell; `address` is that of the repository."""


def cells(page: str) -> list[tuple[str, str]]:
    """Return kind ("markdown" or "code") and text of each cell of a page, without plots and printed output."""
    result, end, page = [], 0, PLOT.sub("", page)
    for block in BLOCK.finditer(page):
        language, text = block.groups()
        result.append(("markdown", page[end : block.start()].strip("\n")))
        if language == "sh":
            text = "".join(f"!{line}\n" for line in text.splitlines())
        if language != "text":
            result.append(("code", text.rstrip("\n")))
        end = block.end()
    result.append(("markdown", page[end:].strip("\n")))
    return [cell for cell in result if cell[1]]


def notebook(page: Path, address: str = "") -> dict[str, Any]:
    """Return a page as a notebook without outputs, in format 4.5.

    Args:
        page: path of the page; links of a page outside the folder of the notebooks are changed to lead from there.
        address: address of the repository that the notebook installs on Google Colab; "" for none.
    """
    parts = [("code", COLAB.format(address=address))] if address else []
    parts += cells(page.read_text(encoding="utf-8"))
    there = os.path.relpath(page.parent, FOLDER)
    made: list[dict[str, Any]] = []
    for number, (kind, source) in enumerate(parts):
        if kind == "markdown" and there != ".":
            source = LINK.sub(f"]({there}/", source)
        own: dict[str, Any] = {"outputs": [], "execution_count": None} if kind == "code" else {}
        lines = source.splitlines(keepends=True)
        made.append({"cell_type": kind, "id": f"cell-{number}", "metadata": {}, "source": lines, **own})
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    return {"cells": made, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}


def code(content: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the cells of code of a notebook."""
    return [cell for cell in content["cells"] if cell["cell_type"] == "code"]


def copy_outputs(source: dict[str, Any], target: dict[str, Any]) -> bool:
    """Copy the outputs of a notebook to another one; return False, without a copy, if their code differs.

    Standard error, with progress and warnings, is left out.
    """
    pairs = list(zip(code(source), code(target), strict=False))
    same = len(code(source)) == len(code(target)) and all(
        "".join(a["source"]) == "".join(b["source"]) for a, b in pairs
    )
    for done, cell in pairs if same else ():
        cell["execution_count"] = done["execution_count"]
        cell["outputs"] = [each for each in done["outputs"] if each.get("name") != "stderr"]
        for each in cell["outputs"]:
            if "text" in each:  # the lines of commands end as on a terminal
                each["text"] = [line.replace("\r\n", "\n") for line in each["text"]]
    return same


def execute(content: dict[str, Any], plots: Path | None = None) -> None:
    """Run a notebook in a temporary folder and store the outputs in its cells.

    Args:
        content: the notebook.
        plots: folder to which its plots are copied; None for no copy.
    """
    import nbformat
    from nbclient import NotebookClient

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shutil.copytree(DOCS / "examples", folder / "docs" / "examples")
        run = nbformat.reads(json.dumps(content), as_version=4)  # type: ignore[no-untyped-call]
        where: Any = {"metadata": {"path": name}}
        client = NotebookClient(run, resources=where, timeout=TIMEOUT, record_timing=False, coalesce_streams=True)
        client.execute()
        if plots is not None:
            for path in folder.glob("my_*.png"):
                shutil.copy(path, plots)
    copy_outputs(json.loads(nbformat.writes(run)), content)  # type: ignore[no-untyped-call]


def write(page: Path, run: bool, plots: bool) -> None:
    """Write the notebook of a page and print its path, with the time of a run.

    Args:
        page: path of the page.
        run: run the notebook even if the stored one has the same code.
        plots: copy the plots of a run beside the page.
    """
    start, path = time.perf_counter(), FOLDER / f"{page.stem}.ipynb"
    content = notebook(page, addresses.read().repository)
    stored = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {"cells": []}
    kept = not run and copy_outputs(stored, content)
    if not kept:
        execute(content, page.parent if plots else None)
    path.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    print(f"{path.relative_to(ROOT)}: " + ("same code" if kept else f"{time.perf_counter() - start:.0f} s"), flush=True)


def main() -> None:
    """Write all notebooks."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", help="names of notebooks, such as fit (default: all)")
    parser.add_argument("--run", action="store_true", help="run notebooks with the same code too")
    parser.add_argument("--plots", action="store_true", help="write the plots of a run beside the pages")
    options = parser.parse_args()
    os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])  # for `flexman`
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    for page in PAGES:
        if not options.names or page.stem in options.names:
            write(page, options.run, options.plots)


if __name__ == "__main__":
    main()
