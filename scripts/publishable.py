"""List what a publication still lacks: python scripts/publishable.py [--wheel FILE]

Empty addresses, files that differ from them, versions, the section of the changelog, metadata and long description of a
wheel, its contents, and licences of shipped data. Without --wheel it builds the wheel and the source archive.
"""

import argparse
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from collections.abc import Iterator, Sequence
from email.parser import BytesParser
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import addresses
import yaml

ROOT = Path(__file__).parents[1]
LICENCES = Path(__file__).with_name("licences.yaml")
SOURCE = (".py", ".yaml", ".md")  # files under the licence of the project
LARGEST = 2_000_000  # bytes; largest file of a wheel
EMPTY = {
    "repository": "no link to code and issues in metadata, README and site; links of the README are relative, so that "
    "a package index shows neither its pictures nor its pages; notebooks have no link that opens them online",
    "site": "no link to the documentation in metadata and README",
    "authors": "cited as contributors without names",
    "doi": "no identifier in README, site and citation",
    "badges": "none shown",
}
FIELDS = ("Name", "Version", "Summary", "License-Expression", "Requires-Python", "Keywords", "Description-Content-Type")


def empty_addresses(given: addresses.Addresses) -> list[str]:
    """Return a line for each address that is empty, with the consequence."""
    return [f"{key} is empty: {EMPTY[key]}" for key, value in given._asdict().items() if not value]


def differing_files(root: Path, given: addresses.Addresses) -> list[str]:
    """Return a line for each file that differs from the addresses or the version of pyproject.toml."""
    names = addresses.write(root, given, check=True)
    return [
        f"{name} differs from scripts/addresses.yaml or the version: run python scripts/addresses.py" for name in names
    ]


def changelog(root: Path) -> list[str]:
    """Return a line if the changelog has no dated section of the version."""
    version = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    dated = addresses.released((root / "CHANGELOG.md").read_text(encoding="utf-8"), version)
    return [] if dated else [f"CHANGELOG.md has no section '## {version} (YYYY-MM-DD)'"]


def metadata(wheel: Path) -> list[str]:
    """Return a line for each field of the metadata that a wheel lacks."""
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (each for each in archive.namelist() if each.endswith(".dist-info/METADATA"))
        found = BytesParser().parsebytes(archive.read(name))
    return [f"metadata: no {each}" for each in FIELDS if not found.get(each)]


def contents(wheel: Path, root: Path) -> list[str]:
    """Return a line for each file of a wheel that should not be in it, or has no licence.

    Args:
        wheel: built wheel.
        root: checkout; its path must not occur in a file.
    """
    lines = []
    with zipfile.ZipFile(wheel) as archive:
        for entry in archive.infolist():
            name = entry.filename
            folder = name.split("/")[0]
            if not (folder in ("flexman_gym", "flexman_agents") or folder.endswith(".dist-info")):
                lines.append(f"{name}: belongs to no package of the project")
            if entry.file_size > LARGEST and "/machine_code/" not in name:
                lines.append(f"{name}: {entry.file_size} bytes, at most {LARGEST} are allowed")
            if "__pycache__" in name or str(root).encode() in archive.read(name):
                lines.append(f"{name}: made on this computer, with its path or its cache")
            if not (folder.endswith(".dist-info") or name.endswith(SOURCE) or "/machine_code/" in name or owners(name)):
                lines.append(f"{name}: no licence in scripts/licences.yaml")
    return lines


def owners(name: str) -> list[dict[str, Any]]:
    """Return the entries of the table of licences for a file."""
    table = yaml.safe_load(LICENCES.read_text(encoding="utf-8"))
    return [entry for entry in table if any(fnmatch(name, each) for each in (*entry["files"], entry["text"]))]


def licence_texts(root: Path) -> list[str]:
    """Return a line for each entry of the table of licences whose text is missing, or that matches no file."""
    lines, files = [], [str(each.relative_to(root)) for each in tracked(root)]
    for entry in yaml.safe_load(LICENCES.read_text(encoding="utf-8")):
        text = root / entry["text"]
        if not (text.is_file() and entry["owner"] in text.read_text(encoding="utf-8")):
            lines.append(f"{entry['text']}: no licence of {entry['owner']}")
        unused = [each for each in entry["files"] if not any(fnmatch(name, each) for name in files)]
        lines += [f"licences.yaml: no file {each}" for each in unused]
    return lines


def tracked(root: Path) -> Iterator[Path]:
    """Yield the files of the checkout that are under version control."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=root, capture_output=True, text=True, check=True).stdout
    yield from (root / each for each in listed.split("\0") if each)


def build(folder: Path) -> list[Path]:
    """Build the source archive and from it the wheel into a folder; return both."""
    pip = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", str(folder)]
    code = f"from setuptools import build_meta; build_meta.build_sdist({str(folder)!r})"
    subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    (archive,) = folder.glob("*.tar.gz")
    subprocess.run([*pip, str(archive)], check=True)
    return [archive, *folder.glob("*.whl")]


def long_description(files: Sequence[Path]) -> list[str]:
    """Return the messages of `twine check --strict`, which renders the long description."""
    command = [sys.executable, "-m", "twine", "check", "--strict", *map(str, files)]
    done = subprocess.run(command, capture_output=True, text=True)
    return (
        [] if done.returncode == 0 else [f"twine: {each}" for each in (done.stdout + done.stderr).splitlines() if each]
    )


def findings(wheel: Path | None) -> tuple[list[str], list[str]]:
    """Return the empty addresses, and the lines that prevent a publication.

    Args:
        wheel: a built wheel, or None to build it.
    """
    given = addresses.read()
    lines = [*differing_files(ROOT, given), *changelog(ROOT), *licence_texts(ROOT)]
    with tempfile.TemporaryDirectory() as folder:
        files = [wheel] if wheel else build(Path(folder))
        lines += [*metadata(files[-1]), *contents(files[-1], ROOT), *long_description(files)]
    return empty_addresses(given), lines


def main() -> int:
    """Print the findings; return 1 if there are any."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--wheel", type=Path, help="a built wheel, in place of a new one")
    empty, wrong = findings(parser.parse_args().wheel)
    for heading, lines in (("Empty (scripts/addresses.yaml)", empty), ("To be mended", wrong)):
        print(f"{heading}:", *(f"  {each}" for each in lines or ["nothing"]), sep="\n")
    return int(bool(empty or wrong))


if __name__ == "__main__":
    raise SystemExit(main())
