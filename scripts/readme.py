"""Write the numbers of the README and of sentences of pages from stored rows: python scripts/readme.py"""

import argparse
from collections.abc import Collection
from pathlib import Path

from studies.readme import readme
from studies.sentences import updated
from studies.sources import Sources

ROOT = Path(__file__).parents[1]


def texts(root: Path, only: Collection[Path] = ()) -> dict[Path, str]:
    """Return the README and the hand-written pages, or only some of them, with numbers from rows: path -> text."""
    sources, first, result = Sources(root / "docs"), root / "README.md", {}
    for path in (first, *sorted((root / "docs").rglob("*.md"))):
        if path.name != "changelog.md" and (not only or path in only):
            text = path.read_text(encoding="utf-8")
            result[path] = readme(text, sources) if path == first else updated(text, sources)
    return result


def main() -> int:
    """Write or check the texts; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="only list the texts that differ from their rows")
    parser.add_argument("--only", nargs="+", default=[], metavar="FILE", help="files, such as README.md docs/index.md")
    options, stale = parser.parse_args(), []
    for path, text in texts(ROOT, [ROOT / each for each in options.only]).items():
        if path.read_text(encoding="utf-8") != text:
            stale.append(path)
            if not options.check:
                path.write_text(text, encoding="utf-8")
    for path in stale:
        print(f"{path.relative_to(ROOT)}: {'differs from its rows' if options.check else 'written'}")
    return int(options.check and bool(stale))


if __name__ == "__main__":
    raise SystemExit(main())
