"""Page of a study, at most one screen, and the index of these pages."""

import re
import textwrap
from collections.abc import Iterable, Mapping
from pathlib import Path

from studies.files import split_made, split_waiting

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

{leading}

Further pages:

{others}
"""
LEADING = ("verification", "machine", "work_precision", "safety", "control", "papers")  # pages with their answer
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
    return "\n\n".join(map(_wrapped, text.split("\n\n"))) + "\n"


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
    """Return the index of pages as Markdown.

    The pages `LEADING` come first, with their first bold sentence, or their first sentence; others have their title.
    """
    found = {path.stem: path for path in pages}
    leading = [_item(found[name], answer=True) for name in LEADING if name in found]
    others = [_item(path, answer=False) for name, path in found.items() if name not in LEADING]
    return INDEX.format(leading="\n".join(leading), others="\n".join(others))


def _item(path: Path, answer: bool) -> str:
    """Return the line of a page: link, the answer on request, and the mark of rows that are no longer current."""
    text = path.read_text(encoding="utf-8")
    title, *paragraphs = text.split("\n\n")
    link = f"[{title.removeprefix('# ').strip()}]({path.name})"
    mark = f" {MARK}" * (WAIT.partition("{")[0] in " ".join(text.split()))
    if not answer:
        return f"- {link}{mark}"
    bold = re.search(r"\*\*(.+?)\*\*", text, re.DOTALL)
    sentence = bold[1] if bold else re.split(r"(?<=\.)\s", paragraphs[0], maxsplit=1)[0]
    return _wrapped(f"- {link}: {sentence.removesuffix('.')}{mark}.")
