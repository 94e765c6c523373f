"""Page of the verification table."""

from collections.abc import Sequence

from flexman_gym.common.computer import computer_text
from flexman_gym.common.markdown import markdown_table
from flexman_gym.verification.table import COLUMNS, RULE, VerificationRow, summary

PAGE = """# Verification

{summary} Results of this package are compared with closed forms, published values and independent codes. `make verify`
rewrites this page and fails if a row fails.

{rule}

Computed with {computer}.

{table}
"""


def markdown_page(rows: Sequence[VerificationRow]) -> str:
    """Return the page as Markdown, without a date, so that it changes only with a number."""
    lines = markdown_table(COLUMNS, (row.cells() for row in rows))
    return PAGE.format(summary=summary(rows), rule=RULE, computer=computer_text(), table="\n".join(lines))
