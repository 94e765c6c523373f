"""Convert pages to notebooks and run them: python scripts/notebooks.py --run --folder out/site/tutorials"""

import argparse
import json
import os
import re
import shutil
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

DOCS = Path(__file__).parents[1] / "docs"
PAGES = [DOCS / "concepts.md", *sorted(each for each in (DOCS / "tutorials").glob("*.md") if each.stem != "index")]
BLOCK = re.compile(r"^```(python|sh|text)\n(.*?)^```\n?", re.MULTILINE | re.DOTALL)
PLOT = re.compile(r"^!\[[^\]]*\]\(my_\w+\.png\)\n", re.MULTILINE)  # a notebook shows the plot below its code
TIMEOUT = 3600  # s; longest time of a cell: the training of the first policy takes 100 s of CPU time


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


def notebook(page: str) -> dict[str, Any]:
    """Return a page as a notebook in format 4.5."""
    made: list[dict[str, Any]] = []
    for number, (kind, text) in enumerate(cells(page)):
        own: dict[str, Any] = {"outputs": [], "execution_count": None} if kind == "code" else {}
        lines = text.splitlines(keepends=True)
        made.append({"cell_type": kind, "id": f"cell-{number}", "metadata": {}, "source": lines, **own})
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    return {"cells": made, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}


def executed(page: Path, plots: Path | None) -> dict[str, Any]:
    """Return the notebook of a page with its outputs; copy its plots to a folder, if one is given."""
    import nbformat
    from nbclient import NotebookClient

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shutil.copytree(DOCS / "examples", folder / "docs" / "examples")
        text = json.dumps(notebook(page.read_text(encoding="utf-8")))
        content = nbformat.reads(text, as_version=4)  # type: ignore[no-untyped-call]
        NotebookClient(content, timeout=TIMEOUT, resources={"metadata": {"path": name}}).execute()
        if plots is not None:
            for path in folder.glob("my_*.png"):
                shutil.copy(path, plots)
    return dict(content)


def write(page: Path, folder: Path, run: bool, plots: bool) -> str:
    """Write the notebook of a page to a folder; return a line with its path and time."""
    start = time.perf_counter()
    text = page.read_text(encoding="utf-8")
    content = executed(page, page.parent if plots else None) if run else notebook(text)
    path = folder / f"{page.stem}.ipynb"
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    return f"{path}: {time.perf_counter() - start:.0f} s"


def main() -> None:
    """Write all notebooks."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, default=Path("notebooks"), help="output folder (default: %(default)s)")
    parser.add_argument("--run", action="store_true", help="run the notebooks, so that they contain their outputs")
    parser.add_argument("--plots", action="store_true", help="with --run: write the plots beside the pages")
    parser.add_argument("--jobs", type=int, default=2, help="notebooks that run at once (default: %(default)s)")
    options = parser.parse_args()
    os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])  # for `flexman`
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    options.folder.mkdir(parents=True, exist_ok=True)
    with ThreadPoolExecutor(options.jobs) as pool:
        for line in pool.map(lambda page: write(page, options.folder, options.run, options.plots), PAGES):
            print(line, flush=True)


if __name__ == "__main__":
    main()
