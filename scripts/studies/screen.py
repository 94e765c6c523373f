"""Page of a study, at most one screen, and the index of these pages."""

import re
import textwrap
from collections.abc import Iterable, Mapping
from pathlib import Path

from studies.files import split_made, split_waiting

HIDDEN = "---\nsearch:\n  exclude: true\n---\n\n"  # front matter that keeps a page out of the search
PAGE = """# {title}

{question}

{answer}

{body}

Rows: {rows}, computed with {computer}. `make evidence STUDY={study}` computes them again and rewrites this page."""
WAIT = "*Waiting for new rows: {}.*"
INDEX = """# Evidence

Each page answers one question on one screen: a chart or a table, the sentence that it supports, the version that
computed the rows, and a link to the rows. `make evidence` lists the rows that are older than the code they describe.
Numbers that are known to have changed since are marked *waiting for new rows*, here and on every other page.

{items}
"""
MARK = "(waiting for new rows)"  # after a number on another page whose rows are no longer current
WIDTH, PICTURE_WIDTH = 120, 640  # characters of a line; pixels


def screen(title: str, question: str, answer: str, body: str, rows: Mapping[str, str], study: str) -> str:
    """Return a page as Markdown.

    Args:
        title: heading.
        question: question of the study.
        answer: paragraph with the answer, whose most important sentence is bold.
        body: picture, table and remarks.
        rows: file of rows -> its comment, see `files.read_comment`; files with equal comments are listed together.
        study: name of the study in `evidence.yaml`.
    """
    links = " and ".join(f"[{file}]({file})" for file in rows)
    parts = [split_waiting(comment) for comment in rows.values()]
    made = (split_made(each) for each, _ in parts)
    computer = "; ".join(dict.fromkeys(f"{each}, {date}" if date else each for each, date in made))
    reasons = dict.fromkeys(reason for _, reason in parts if reason)
    answer = "\n\n".join([answer, *map(WAIT.format, reasons)])
    text = PAGE.format(title=title, question=question, answer=answer, body=body.strip("\n"), rows=links,
                       computer=computer, study=study)  # fmt: skip
    return HIDDEN + "\n\n".join(map(_wrapped, text.split("\n\n"))) + "\n"


def _wrapped(block: str) -> str:
    """Wrap the lines of a paragraph or list; tables, pictures and headings stay as they are."""
    if block.startswith(("|", "![", "#")):
        return block
    items = re.split(r"\n(?=- )", block)
    return "\n".join(
        textwrap.fill(" ".join(item.split()), WIDTH, subsequent_indent="  " * item.startswith("- "),
                      break_long_words=False, break_on_hyphens=False) for item in items
    )  # fmt: skip


def picture(description: str, file: str) -> str:
    """Return the Markdown of a picture, in a width that leaves room for the text on the same screen."""
    return f'![{description}]({file}){{ width="{PICTURE_WIDTH}" }}'


def index(pages: Iterable[Path]) -> str:
    """Return the index of pages as Markdown: the title and the first bold sentence, or the first sentence, of each."""
    return INDEX.format(items="\n".join(_item(path) for path in pages))


def _item(path: Path) -> str:
    text = path.read_text(encoding="utf-8").removeprefix(HIDDEN)
    title, *paragraphs = text.split("\n\n")
    bold = re.search(r"\*\*(.+?)\*\*", text, re.DOTALL)
    sentence = bold[1] if bold else re.split(r"(?<=\.)\s", paragraphs[0], maxsplit=1)[0]
    if WAIT.partition("{")[0] in " ".join(text.split()):
        sentence = f"{sentence.removesuffix('.')} {MARK}."
    return _wrapped(f"- [{title.removeprefix('# ').strip()}]({path.name}): {sentence}")
