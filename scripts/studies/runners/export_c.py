"""Time a step of controllers that are exported as C, as root."""

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

from flexman_gym.common.markdown import markdown_table
from studies.evidence import ROOT
from studies.export_c import AGENTS, StepRow, conditions, measure
from studies.files import folder, read_comment, read_rows, write_rows
from studies.readme import replaced_part

PAGE = ROOT / "docs" / "own_controller.md"  # has a table of the rows


def table(rows: list[StepRow], comment: str) -> list[str]:
    """Return the lines of the table of the page."""
    head = ("agent", "median, us", "99.9 %, us", "longest, us", "longest, CPU time, us", "code, kB", "state, bytes")
    cells = [(f"`{row.agent}`", f"{row.median:.2f}", f"{row.most:.2f}", f"{row.longest:.0f}", f"{row.cpu_longest:.0f}",
              f"{row.code / 1e3:.1f}", f"{row.state:.0f}") for row in rows]  # fmt: skip
    return ["", *markdown_table(head, cells), "", f"Processor: {comment}.", ""]


def main() -> None:
    """Run the study and write rows and table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=folder, default="out", help="output folder of the rows")
    parser.add_argument("--redraw", action="store_true", help="write the table from the rows of an earlier run")
    options = parser.parse_args()
    file = options.folder / "export_c.csv"
    if not options.redraw:
        with TemporaryDirectory() as place:
            rows = [measure(agent, Path(place) / agent) for agent in AGENTS]
        write_rows(rows, file, 4, conditions())
    lines = table(read_rows(file, StepRow), read_comment(file))
    PAGE.write_text(replaced_part(PAGE.read_text(encoding="utf-8"), "steps", lines), encoding="utf-8")


if __name__ == "__main__":
    main()
