"""Page of the verification table: rows by kind of source, and the distance of the tip from other codes."""

from collections.abc import Mapping, Sequence

import numpy as np

from flexman_gym.common.markdown import markdown_table
from flexman_gym.toolbox.verification.table import PASS, SHOWN, VerificationRow
from studies.screen import screen

KINDS = {
    "identity": "conservation of energy and momentum", "published": "published values", "code": "independent codes",
    "closed": "closed forms and textbooks",
}  # fmt: skip
SOURCES = {  # word in the source of a row -> key of KINDS; closed forms have none of these words
    "identity": "identity", "Wright": "published", "De Luca": "published", "Gifu": "published", "NASA": "published",
    "independent": "code",
}  # fmt: skip
SAME, TIP = "automatic-differentiation", "largest distance of the tip, m"
WITH, WITHOUT = (f"paper FF {each} foreshortening, tip within 2 s, m" for each in ("with", "without"))
ANSWER = """**{passed} of {judged} rows with a tolerance pass.** {far}"""
FAR = """An independent code with the same equations of motion yields the same tip positions within {same:.2g}
micrometres. A code for large rotations, which does not assume small deflections, differs by {with_:.2g} mm within 2 s,
and by {without:.2g} mm from the model without foreshortening."""
BODY = """{table}

The error of a row is relative to the expected value, or absolute if this is 0. Another {shown} rows have no tolerance:
they state how far an option of the model moves the tip. `make verify` runs the table and fails if a row fails."""


def page(rows: Sequence[VerificationRow], files: Mapping[str, str]) -> str:
    """Return the page as Markdown; `files` is the file of the rows with its comment."""
    judged = [row for row in rows if row.verdict != SHOWN]
    cells = []
    for kind, name in KINDS.items():
        own = [row for row in judged if _kind(row) == kind]
        cells.append((name, len(own), sum(row.verdict == PASS for row in own), _median(own)))
    table = "\n".join(markdown_table(("source", "rows", "pass", "median error"), cells))
    answer = ANSWER.format(passed=sum(row.verdict == PASS for row in judged), judged=len(judged), far=_far(rows))
    return screen(
        "Verification", "Does the simulator compute what closed forms, published values and independent codes give?",
        answer, BODY.format(table=table, shown=len(rows) - len(judged)), files, "verification",
    )  # fmt: skip


def _kind(row: VerificationRow) -> str:
    return next((kind for word, kind in SOURCES.items() if word in row.source), "closed")


def _median(rows: Sequence[VerificationRow]) -> str:
    return f"{np.median([row.error for row in rows]):.1e}" if rows else ""


def _far(rows: Sequence[VerificationRow]) -> str:
    """Return the sentences on tip positions of other codes; empty without the long motions."""
    known = {row.case: row.computed for row in rows}
    if WITH not in known:
        return ""
    same = max(row.computed for row in rows if SAME in row.source and row.case.endswith(TIP))
    return FAR.format(same=1e6 * same, with_=1e3 * known[WITH], without=1e3 * known[WITHOUT])
