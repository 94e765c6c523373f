"""List what is older than the code that it describes, and make or redraw it."""

from argparse import ArgumentParser, Namespace
from collections.abc import Iterable
from pathlib import Path

from flexman_gym.commands import CommandLine
from studies.evidence import CURRENT, ROOT, UNKNOWN, Checkout, EvidenceStudy, make, studies
from studies.screen import index
from studies.staleness import described, insert_notes, release_faults


def arguments(parser: ArgumentParser) -> None:
    """Add the studies and what is done with them."""
    names = list(studies())
    parser.add_argument("study", nargs="*", metavar="STUDY", help=f"studies, from {', '.join(names)}; default: all")
    parser.add_argument("--make", action="store_true", help="make what is not current; after an interruption, go on")
    parser.add_argument("--redraw", action="store_true", help="draw what is not current from the stored rows")
    parser.add_argument("--release", action="store_true", help="fail if a release would have numbers of old rows")
    parser.add_argument("--notes", type=Path, metavar="FOLDER", help="mark old pages of a built site")


def run(options: Namespace) -> int:
    """Print the studies that are not current, or make the named ones.

    Raises:
        ValueError: for an unknown name.
    """
    known = studies()
    if unknown := sorted(set(options.study) - known.keys()):
        raise ValueError(f"study: {unknown[0]} is not allowed; give {', '.join(known)}")
    chosen = [known[name] for name in options.study or known]
    if options.release:
        return _check_release(known.values())
    if options.notes:
        print("\n".join(insert_notes(Checkout(), chosen, options.notes)))
        return 0
    for study in chosen if options.make or options.redraw else ():
        print(f"{study.name}: about {study.minutes:g} min" if options.make else study.name, flush=True)
        make(study, rows=options.make)
        folder = ROOT / "docs" / "evidence"
        pages = (path for path in sorted(folder.glob("*.md")) if path.name != "index.md")
        (folder / "index.md").write_text(index(pages), encoding="utf-8")
    _print_list(Checkout(), chosen)
    return 0


def _print_list(checkout: Checkout, chosen: list[EvidenceStudy]) -> None:
    """Print a line for each study whose rows or drawings are not current, and the CPU time that they take."""
    left = []
    for study in sorted(chosen, key=lambda each: checkout.rows_age(each).state == UNKNOWN):
        rows, minutes = checkout.rows_age(study), checkout.minutes(study)
        drawing = checkout.drawing_age(study) if study.drawn else None
        if rows.state != CURRENT:
            left.append(minutes)
            print(f"{study.name:16} {minutes:4g} min  {described(rows)}")
        elif drawing and drawing.state not in (CURRENT, UNKNOWN):
            print(f"{study.name:16}    0 min  page: {described(drawing)}")
    print(f"{len(left)} of {len(chosen)} are not current: about {sum(left) / 60:.1f} h of CPU time")


def _check_release(known: Iterable[EvidenceStudy]) -> int:
    """Print the rows that are too old for a release, and return the exit status."""
    faults = release_faults(Checkout(), known)
    print("\n".join(faults) or "the numbers of README and home are current")
    return int(bool(faults))


RUNNER = CommandLine(arguments, run)
