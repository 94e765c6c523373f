"""Duration of a step of controllers that are exported as C; as root, for real-time priority, with gcc."""

from argparse import Namespace
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from flexman_gym.common.markdown import markdown_table
from studies.evidence import ROOT
from studies.export_c import AGENTS, StepRow, conditions, measure
from studies.files import split_made
from studies.markdown import replaced_part
from studies.study import Study, Table

PAGE = ROOT / "docs" / "c_code.md"  # has a table of the rows
HEADS = ("agent", "median, us", "99.9 %, us", "longest, us", "longest, CPU time, us", "code, kB", "state, bytes")


def table(rows: Sequence[StepRow], files: Mapping[str, str]) -> list[str]:
    """Return the lines of the table of the page."""
    cells = [(f"`{row.agent}`", f"{row.median:.2f}", f"{row.most:.2f}", f"{row.longest:.0f}", f"{row.cpu_longest:.0f}",
              f"{row.code / 1e3:.1f}", f"{row.state:.0f}") for row in rows]  # fmt: skip
    computers = ", ".join(split_made(comment)[0] for comment in files.values())
    return ["", *markdown_table(HEADS, cells), "", f"Measured with {computers}.", ""]


def steps(options: Namespace) -> Iterator[StepRow]:
    """Yield the row of each agent."""
    with TemporaryDirectory() as place:
        for agent in AGENTS:
            yield measure(agent, Path(place) / agent)


RUNNER = Study(
    tables=(Table("export_c", StepRow, 4),),
    measure=lambda options: [steps(options)],
    pages={str(PAGE): lambda rows, files: replaced_part(PAGE.read_text(encoding="utf-8"), "steps", table(rows, files))},
    comment=lambda _: conditions(),
)
