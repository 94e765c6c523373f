"""List what is older than the code that it describes, and make it."""

import argparse
import sys

from studies.evidence import CURRENT, ROOT, make, read_record, studies
from studies.screen import index

HEAD = ("study", "rows", "page and chart", "made by", "CPU min")


def main() -> int:
    """Print the state of all studies, or make the named ones; return 2 for an unknown name."""
    known = studies()
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("study", nargs="*", help=f"studies, from {', '.join(known)}; default: all")
    parser.add_argument("--make", action="store_true", help="make what is not current; after an interruption, go on")
    parser.add_argument("--redraw", action="store_true", help="draw what is not current from the stored rows")
    options = parser.parse_args()
    if unknown := sorted(set(options.study) - known.keys()):
        print(f"study: {unknown[0]} is not allowed; give {', '.join(known)}", file=sys.stderr)
        return 2
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


if __name__ == "__main__":
    sys.exit(main())
