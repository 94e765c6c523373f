"""Write the numbers of the README and of sentences of pages from stored rows: python scripts/readme.py"""

import argparse
from pathlib import Path

from studies.readme import readme
from studies.sentences import updated
from studies.sources import Sources

ROOT = Path(__file__).parents[1]


def texts(root: Path) -> dict[Path, str]:
    """Return the README and the hand-written pages with numbers from rows: path -> text."""
    sources, path = Sources(root / "docs"), root / "README.md"
    result = {path: readme(path.read_text(encoding="utf-8"), sources, root / "mkdocs.yml")}
    return result | {page: updated(page.read_text(encoding="utf-8"), sources)
                     for page in sorted((root / "docs").rglob("*.md")) if page.name != "changelog.md"}  # fmt: skip


def main() -> int:
    """Write or check the texts; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="only list the texts that differ from their rows")
    options, stale = parser.parse_args(), []
    for path, text in texts(ROOT).items():
        if path.read_text(encoding="utf-8") != text:
            stale.append(path)
            if not options.check:
                path.write_text(text, encoding="utf-8")
    for path in stale:
        print(f"{path.relative_to(ROOT)}: {'differs from its rows' if options.check else 'written'}")
    return int(options.check and bool(stale))


if __name__ == "__main__":
    raise SystemExit(main())
