"""Addresses of the project in the files that show them, and the checks before a publication."""

import re
import subprocess
import tomllib
import zipfile
from pathlib import Path

import addresses
import publishable
import pytest
import yaml
from addresses import Addresses, Author

ROOT = Path(__file__).parents[2]
GIVEN = Addresses(
    "https://a.example/b",
    "https://site.example",
    (Author("Ada", "Lovelace", "https://orcid.org/0000-0001-2345-6789"), Author("Emmy", "Noether")),
    "10.5281/zenodo.1",
    ("https://a.example/c.svg",),
)


@pytest.fixture
def copies(tmp_path):
    """Return a folder with copies of the files that show addresses."""
    for name in ("pyproject.toml", "CITATION.cff", "mkdocs.yml", "README.md", "docs/releases.md", "CHANGELOG.md"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text((ROOT / name).read_text(encoding="utf-8"), encoding="utf-8")
    return tmp_path


def test_files_show_the_addresses_of_the_settings():
    assert addresses.write(ROOT, addresses.read(), check=True) == [], "run python scripts/addresses.py"


def test_addresses_are_shown_in_all_files_and_empty_ones_in_none(copies):
    addresses.write(copies, Addresses())
    before = {path: path.read_text(encoding="utf-8") for path in copies.rglob("*.*")}
    assert len(addresses.write(copies, GIVEN)) == 5 and addresses.write(copies, GIVEN, check=True) == []
    project = tomllib.loads((copies / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert project["urls"] == {
        "Documentation": GIVEN.site, "Repository": GIVEN.repository, "Issues": f"{GIVEN.repository}/issues",
    }  # fmt: skip
    assert [each["name"] for each in project["authors"]] == ["Ada Lovelace", "Emmy Noether"]
    cited = yaml.safe_load((copies / "CITATION.cff").read_text(encoding="utf-8"))
    assert (cited["doi"], cited["repository-code"], cited["url"]) == (GIVEN.doi, GIVEN.repository, GIVEN.site)
    assert cited["authors"][0] == {"given-names": "Ada", "family-names": "Lovelace", "orcid": GIVEN.authors[0].orcid}
    site = yaml.safe_load((copies / "mkdocs.yml").read_text(encoding="utf-8"))
    assert (site["repo_url"], site["site_url"], site["extra"]["doi"]) == (GIVEN.repository, GIVEN.site, GIVEN.doi)
    assert site["extra"]["badges"] == [*GIVEN.badges]
    entry = (copies / "docs" / "releases.md").read_text(encoding="utf-8")
    assert "author  = {Lovelace, Ada and Noether, Emmy}" in entry and f"doi     = {{{GIVEN.doi}}}" in entry
    badges = (copies / "README.md").read_text(encoding="utf-8").partition("<!-- badges -->\n")[2].splitlines()[0]
    assert badges == "![badge](https://a.example/c.svg) [Documentation](https://site.example) " \
        "[Repository](https://a.example/b) [DOI 10.5281/zenodo.1](https://doi.org/10.5281/zenodo.1)"  # fmt: skip
    addresses.write(copies, Addresses())
    assert before == {path: path.read_text(encoding="utf-8") for path in copies.rglob("*.*")}


def test_links_of_the_readme_are_absolute_where_the_repository_has_an_address(copies):
    for each in (GIVEN, GIVEN._replace(repository="https://moved.example/b")):
        addresses.write(copies, each)
        links = re.findall(r"\]\(([^)\s]+)", (copies / "README.md").read_text(encoding="utf-8"))
        assert links and all(link.startswith(("https://", "#")) for link in links)
        inside = [link for link in links if "/main/" in link]
        assert inside and all(link.startswith(f"{each.repository}/") for link in inside)
        assert all((ROOT / link.partition("/main/")[2].partition("#")[0]).exists() for link in inside)
        assert f"{each.repository}/raw/main/docs/side_by_side.gif" in inside


def test_a_date_of_the_changelog_is_the_date_of_the_citation(copies):
    version = tomllib.loads((copies / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    (copies / "CHANGELOG.md").write_text(f"# Changes\n\n## {version} (2026-12-24)\n", encoding="utf-8")
    addresses.write(copies, GIVEN)
    assert "date-released: '2026-12-24'" in (copies / "CITATION.cff").read_text(encoding="utf-8")
    assert "year    = {2026}" in (copies / "docs" / "releases.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("repo: x", "repo is no key of addresses.yaml"),
        ("repository: a.example/b", "repository: a.example/b does not have the form"),
        ("doi: https://doi.org/10.1/x", "doi: "),
        ("authors: [{name: Ada}]", "each needs given and family"),
    ],
)
def test_a_wrong_address_is_refused(text, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        addresses.load(text)


def test_a_publication_lists_empty_addresses_with_their_consequence():
    lines = publishable.empty_addresses(Addresses())
    assert [line.partition(" ")[0] for line in lines] == list(Addresses._fields)
    assert publishable.empty_addresses(GIVEN) == []


def wheel(path, files):
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return path


def test_a_wheel_with_foreign_files_is_refused(tmp_path):
    good = {
        "flexman_gym/__init__.py": "", "flexman_gym/policies/a/policy.json": "{}",
        "flexman_gym/kernels/machine_code/v3/a.bin": "x", "flexman_gym-1.dist-info/METADATA": "Name: a\n",
    }  # fmt: skip
    assert publishable.contents(wheel(tmp_path / "a.whl", good), ROOT) == []
    bad = {
        "tests/test_a.py": "",
        "flexman_gym/data/foreign.csv": "",
        "flexman_gym/path.py": f"'{ROOT}/x'",
        "flexman_gym/large.py": "x" * (publishable.LARGEST + 1),
    }
    lines = publishable.contents(wheel(tmp_path / "b.whl", good | bad), ROOT)
    assert [line.partition(":")[0] for line in lines] == list(bad)
    assert [line.partition(": ")[2] for line in publishable.metadata(tmp_path / "a.whl")] == [
        f"no {field}" for field in publishable.FIELDS if field != "Name"
    ]


def test_shipped_data_have_a_licence_text():
    assert publishable.licence_texts(ROOT) == []


def test_a_licence_without_text_and_an_entry_without_file_are_found(tmp_path, monkeypatch):
    table = tmp_path / "licences.yaml"
    monkeypatch.setattr(publishable, "LICENCES", table)
    (tmp_path / "data.csv").write_text("1\n")
    subprocess.run(["git", "init", "-q"], cwd=tmp_path, check=True)
    subprocess.run(["git", "add", "data.csv"], cwd=tmp_path, check=True)
    table.write_text("- {files: [data.csv], owner: Ada, licence: MIT, text: LICENSE}\n")
    assert publishable.licence_texts(tmp_path) == ["LICENSE: no licence of Ada"]
    (tmp_path / "LICENSE").write_text("Copyright Ada\n")
    assert publishable.licence_texts(tmp_path) == []
    (tmp_path / "data.csv").rename(tmp_path / "other.csv")
    subprocess.run(["git", "add", "-A"], cwd=tmp_path, check=True)
    assert publishable.licence_texts(tmp_path) == ["licences.yaml: no file data.csv"]


@pytest.mark.slow
def test_the_wheel_of_the_checkout_lacks_nothing_but_addresses_and_a_date():
    _, lines = publishable.findings(None)
    assert [line for line in lines if not line.startswith("CHANGELOG.md")] == []
