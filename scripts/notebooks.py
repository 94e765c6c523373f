"""Convert the tutorials to notebooks: each Python block and each command becomes a code cell."""

import argparse
import json
import re
from pathlib import Path
from typing import Any

TUTORIALS = Path(__file__).parents[1] / "docs" / "tutorials"
BLOCK = re.compile(r"^```(python|sh|text)\n(.*?)^```\n?", re.MULTILINE | re.DOTALL)


def cells(page: str) -> list[tuple[str, str]]:
    """Return kind ("markdown" or "code") and text of each cell of a page, without the printed output of its code."""
    result, end = [], 0
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


def main() -> None:
    """Write all notebooks."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, default=Path("notebooks"), help="output folder")
    folder = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    for page in sorted(TUTORIALS.glob("*.md")):
        path = folder / f"{page.stem}.ipynb"
        path.write_text(json.dumps(notebook(page.read_text(encoding="utf-8")), indent=1) + "\n", encoding="utf-8")
        print(path)


if __name__ == "__main__":
    main()
