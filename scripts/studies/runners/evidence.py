"""List what is older than the code that it describes, and make or redraw it."""

from argparse import ArgumentParser, Namespace

from flexman_gym.commands import CommandLine
from studies.evidence import CURRENT, ROOT, make, read_record, studies
from studies.screen import index

HEAD = ("study", "rows", "page and chart", "made by", "CPU min")


def arguments(parser: ArgumentParser) -> None:
    """Add the studies and what is done with them."""
    names = list(studies())
    parser.add_argument("study", nargs="*", metavar="STUDY", help=f"studies, from {', '.join(names)}; default: all")
    parser.add_argument("--make", action="store_true", help="make what is not current; after an interruption, go on")
    parser.add_argument("--redraw", action="store_true", help="draw what is not current from the stored rows")


def run(options: Namespace) -> int:
    """Print the state of all studies, or make the named ones.

    Raises:
        ValueError: for an unknown name.
    """
    known = studies()
    if unknown := sorted(set(options.study) - known.keys()):
        raise ValueError(f"study: {unknown[0]} is not allowed; give {', '.join(known)}")
    chosen = [known[name] for name in options.study or known]
    for study in chosen if options.make or options.redraw else ():
        print(f"{study.name}: about {study.minutes:g} min" if options.make else study.name, flush=True)
        make(study, rows=options.make)
        folder = ROOT / "docs" / "evidence"
        pages = (path for path in sorted(folder.glob("*.md")) if path.name != "index.md")
        (folder / "index.md").write_text(index(pages), encoding="utf-8")
    record, lines, left = read_record(), [HEAD], []
    for study in chosen:
        own = record.get(study.name, {})
        state, minutes = study.rows_state(own), own.get("minutes") or study.minutes
        left += [] if state == CURRENT else [minutes]
        drawing = study.drawing_state(own) if study.drawn else ""
        lines.append((study.name, state, drawing, own.get("version", ""), f"{minutes:g}"))
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    for line in lines:
        print("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip())
    print(f"{len(left)} of {len(chosen)} are not current: about {sum(left) / 60:.1f} h of CPU time")
    return 0


RUNNER = CommandLine(arguments, run)
