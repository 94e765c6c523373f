"""Write addresses, authors, DOI and version of the project into the files that show them:

    python scripts/addresses.py [--check]

The values are those of scripts/addresses.yaml; the version is that of pyproject.toml. Empty values are shown nowhere.
"""

import argparse
import re
import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from studies.markdown import replaced_part

ROOT = Path(__file__).parents[1]
SETTINGS = Path(__file__).with_suffix(".yaml")
PATTERNS = {"repository": r"https://\S+[^/\s]", "site": r"https://\S+", "doi": r"10\.\d{4,}/\S+"}
TITLE = "flexman_gym: robot arms whose links and joints bend, as Gymnasium environments"
CONTRIBUTORS = "flexman_gym contributors"  # author without named authors
LINK = re.compile(r"(!?\[[^\]]*\]\()(?:https://[^)\s]+?/(?:blob|raw)/main/)?(?!https?:|#|mailto:)([^)\s]+\))")


class Author(NamedTuple):
    """Author of the software.

    Attributes:
        given: given names.
        family: family name.
        orcid: address of the identifier of the author, or "".
    """

    given: str
    family: str
    orcid: str = ""


class Addresses(NamedTuple):
    """Values of `scripts/addresses.yaml`; empty ones are "" or ().

    Attributes:
        repository: address of the repository.
        site: address of the documentation.
        authors: authors in the order of a citation.
        doi: digital object identifier.
        badges: addresses of pictures.
    """

    repository: str = ""
    site: str = ""
    authors: tuple[Author, ...] = ()
    doi: str = ""
    badges: tuple[str, ...] = ()


def load(text: str) -> Addresses:
    """Return the addresses of a YAML text.

    Raises:
        ValueError: for an unknown key or a value of a wrong form; the message names both.
    """
    data = yaml.safe_load(text) or {}
    if unknown := sorted(set(data) - set(Addresses._fields)):
        raise ValueError(f"{unknown[0]} is no key of addresses.yaml; these are {', '.join(Addresses._fields)}")
    for key, pattern in PATTERNS.items():
        value = data.get(key) or ""
        if value and not re.fullmatch(pattern, value):
            raise ValueError(f"{key}: {value} does not have the form {pattern}")
    try:
        authors = tuple(Author(**each) for each in data.get("authors") or ())
    except TypeError:
        raise ValueError(f"authors: {data['authors']}; each needs given and family, and may have orcid") from None
    plain = {key: data.get(key) or "" for key in PATTERNS}
    return Addresses(**plain, authors=authors, badges=tuple(data.get("badges") or ()))


def read() -> Addresses:
    """Return the addresses of the project; ValueError as `load`."""
    return load(SETTINGS.read_text(encoding="utf-8"))


def pyproject(text: str, addresses: Addresses) -> str:
    """Return pyproject.toml with the authors and the table [project.urls]."""
    names = [f"{each.given} {each.family}" for each in addresses.authors] or [CONTRIBUTORS]
    authors = ", ".join(f'{{ name = "{name}" }}' for name in names)
    text = re.sub(r"(?m)^authors = .*$", lambda _: f"authors = [{authors}]", text)
    text = re.sub(r"\[project\.urls\]\n(?:.+\n)*\n", "", text)
    urls = {"Documentation": addresses.site}
    if addresses.repository:
        urls |= {"Repository": addresses.repository, "Issues": f"{addresses.repository}/issues"}
    lines = "".join(f'{key} = "{value}"\n' for key, value in urls.items() if value)
    table = f"[project.urls]\n{lines}\n" if lines else ""
    return text.replace("[project.scripts]\n", f"{table}[project.scripts]\n")


def citation(_: str, addresses: Addresses, version: str, released: str) -> str:
    """Return CITATION.cff.

    Args:
        addresses: addresses and authors.
        version: version of the software.
        released: date of its release, or "" before the release.
    """
    people: list[dict[str, str]] = []
    for each in addresses.authors:
        orcid = {"orcid": each.orcid} if each.orcid else {}
        people.append({"given-names": each.given, "family-names": each.family} | orcid)
    data = {
        "cff-version": "1.2.0",
        "message": "If you use this software, please cite it as below.",
        "type": "software",
        "title": TITLE,
        "version": version,
        "date-released": released,
        "authors": people or [{"name": CONTRIBUTORS}],
        "license": "MIT",
        "repository-code": addresses.repository,
        "url": addresses.site,
        "doi": addresses.doi,
    }
    shown = {key: value for key, value in data.items() if value}
    return yaml.safe_dump(shown, sort_keys=False, width=120, allow_unicode=True)


def mkdocs(text: str, addresses: Addresses, version: str) -> str:
    """Return mkdocs.yml with the address of the repository, the version, the DOI and the badges."""
    badges = ", ".join(f'"{each}"' for each in addresses.badges)
    shown = {"repo_url": f'"{addresses.repository}"', "site_url": f'"{addresses.site}"', "release": version,
             "doi": f'"{addresses.doi}"', "badges": f"[{badges}]"}  # fmt: skip
    for key, value in shown.items():
        line = re.compile(rf"^( *{key}: ).*?(  #.*)?$", re.MULTILINE)
        text = line.sub(rf"\g<1>{value}\g<2>", text)
    return text


def readme(text: str, addresses: Addresses) -> str:
    """Return the README with badges; its links are absolute where the repository has an address.

    A package index shows the README without the files beside it.
    """
    line = [f"![badge]({each})" for each in addresses.badges]
    line += [f"[Documentation]({addresses.site})"] if addresses.site else []
    line += [f"[Repository]({addresses.repository})"] if addresses.repository else []
    line += [f"[DOI {addresses.doi}](https://doi.org/{addresses.doi})"] if addresses.doi else []
    text = LINK.sub(r"\1\2", text)
    if addresses.repository:
        text = LINK.sub(lambda found: f"{found[1]}{addresses.repository}/{_view(found[1])}/main/{found[2]}", text)
    return replaced_part(text, "badges", [" ".join(line)] if line else [])


def _view(opening: str) -> str:
    """Return the view of a file that a link needs: `raw` for a picture, else `blob`."""
    return "raw" if opening.startswith("!") else "blob"


def releases(text: str, addresses: Addresses, version: str, released: str) -> str:
    """Return the page of releases with version and BibTeX entry."""
    authors = " and ".join(f"{each.family}, {each.given}" for each in addresses.authors)
    fields = {
        "title": f"{{{TITLE}}}",
        "author": f"{{{authors}}}" if authors else "{{" + CONTRIBUTORS.replace("_", "\\_") + "}}",
        "year": f"{{{released[:4]}}}" * bool(released),
        "version": f"{{{version}}}",
        "license": "{MIT}",
        "url": f"{{{addresses.repository}}}" * bool(addresses.repository),
        "doi": f"{{{addresses.doi}}}" * bool(addresses.doi),
    }
    shown = [f"  {key:<7} = {value}" for key, value in fields.items() if value]
    entry = "\n".join(["@software{flexman_gym,", ",\n".join(shown), "}"])
    text = re.sub(r"@software\{flexman_gym,\n.*?\n\}", lambda _: entry, text, flags=re.DOTALL)
    return re.sub(r"(version of the code is \*\*)[^*]+", rf"\g<1>{version}", text)


def released(changelog: str, version: str) -> str:
    """Return the date of a version in the changelog; "" before its release."""
    found = re.search(rf"(?m)^## {re.escape(version)} \((\d{{4}}-\d\d-\d\d)\)$", changelog)
    return found[1] if found else ""


def texts(root: Path, addresses: Addresses) -> dict[Path, str]:
    """Return the files that show the addresses: path -> text."""
    version = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    date = released((root / "CHANGELOG.md").read_text(encoding="utf-8"), version)
    writers: dict[str, tuple[Callable[..., str], Sequence[Any]]] = {
        "pyproject.toml": (pyproject, ()),
        "CITATION.cff": (citation, (version, date)),
        "mkdocs.yml": (mkdocs, (version,)),
        "README.md": (readme, ()),
        "docs/releases.md": (releases, (version, date)),
    }
    return {root / name: write((root / name).read_text(encoding="utf-8"), addresses, *further)
            for name, (write, further) in writers.items()}  # fmt: skip


def write(root: Path, addresses: Addresses, check: bool = False) -> list[str]:
    """Write the files that show the addresses, or only compare them; return the names of those that differ."""
    differing = []
    for path, text in texts(root, addresses).items():
        if path.read_text(encoding="utf-8") != text:
            differing.append(str(path.relative_to(root)))
            if not check:
                path.write_text(text, encoding="utf-8")
    return differing


def main() -> int:
    """Write or check the files; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="only list the files that differ")
    check = parser.parse_args().check
    differing = write(ROOT, read(), check)
    for name in differing:
        print(f"{name}: {'differs from addresses.yaml' if check else 'written'}")
    return int(check and bool(differing))


if __name__ == "__main__":
    raise SystemExit(main())
