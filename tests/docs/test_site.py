"""Tests of the site: navigation, API entries of public names, links, equations."""

import importlib
import json
import os
import re
import shutil
import subprocess
import types
from collections import Counter
from pathlib import Path

import pytest
import yaml

import flexman_gym as fm

from oracles.files import ROOT

DOCS = ROOT / "docs"
FILES = [*sorted(DOCS.rglob("*.md")), ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
PAGES = {str(path.relative_to(ROOT)): path.read_text(encoding="utf-8") for path in FILES}
BLOCK = re.compile(r"^(```+).*?^\1$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)\s]+)\)")
ENTRY = re.compile(r"^::: (\S+)", re.MULTILINE)
EQUATION = re.compile(r"\$\$(.*?)\$\$|(?<![\\$\w])\$([^\s$][^$]*?)\$(?![\d$])", re.DOTALL)
ENTRIES = [entry for text in PAGES.values() for entry in ENTRY.findall(text)]
MEMBERS = re.compile(r"^::: (\S+)\n    options:\n(?:      .*\n)*?      members: \[(.*)\]$", re.MULTILINE)
MODULES = {f"flexman_agents.{path.stem}" for path in (ROOT / "agents").glob("[!_]*.py")}
NAMED_DIFFERENTLY = {"envs": "environments", "common": "agent"}  # folder -> page
PUBLIC = (
    "control",
    "draw",
    "envs",
    "envs.effects",
    "envs.sensors",
    "envs.tasks",
    "evaluation",
    "metrics",
    "scene.catalog",
)


def prose(text):
    """Return a page without code blocks and code spans."""
    return re.sub(r"`[^`\n]*`", "`", BLOCK.sub("", text))


def anchors(text):
    """Return the anchors of a page: headings as in Python-Markdown and on forges, and API entries."""
    headings = re.findall(r"^#+ (.*)$", BLOCK.sub("", text), re.MULTILINE)
    words = (re.sub(r"[^\w\s-]", "", each.replace("`", "")).strip().lower() for each in headings)
    return {re.sub(r"[\s]+", "-", each) for each in words} | set(ENTRY.findall(text))


def wrong_links(page, texts=PAGES):
    """Yield the links and images of a page that lead nowhere or outside the site folder."""
    for target in LINK.findall(prose(texts[page])):
        if "://" in target:
            continue
        address, _, anchor = target.partition("#")
        path = Path(os.path.normpath((ROOT / page).parent / address)) if address else ROOT / page
        inside = not page.startswith("docs/") or DOCS in path.parents
        known = texts.get(str(path.relative_to(ROOT))) if inside and ROOT in path.parents else None
        if not inside or not path.exists() or (anchor and (known is None or anchor not in anchors(known))):
            yield target


def test_every_page_has_its_place():
    def pages(node):
        parts = node.values() if isinstance(node, dict) else node if isinstance(node, list) else ()
        return [node] if isinstance(node, str) else [page for part in parts for page in pages(part)]

    settings = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
    shown, there = pages(settings["nav"]), {page[5:] for page in PAGES if page.startswith("docs/")}
    assert len(shown) == len(set(shown)) and set(shown) <= there
    assert there - set(shown) == set() and not any("exclude: true" in PAGES[f"docs/{page}"] for page in there)
    assert settings["extra"]["release"] == fm.__version__
    local = settings["extra_css"] + settings["extra_javascript"] + settings["extra"]["polyfills"]
    local += [settings["theme"]["logo"], settings["theme"]["favicon"]]
    assert settings["theme"]["font"] is False and all((DOCS / path).is_file() for path in local)


@pytest.mark.parametrize("page", PAGES)
def test_links_and_pictures_lead_somewhere(page):
    assert list(wrong_links(page)) == []


PICTURES = {".gif", ".jpg", ".png", ".svg"}


def unused(pictures, texts):
    """Return the paths of the pictures that no text shows, by Markdown, HTML or a style."""
    used = {target for text in texts for target in re.findall(r"[\w.-]+\.(?:gif|jpg|png|svg)\b", text)}
    return [picture for picture in pictures if picture.name not in used]


def test_every_picture_is_shown():
    texts = [*(prose(text) for text in PAGES.values()), (ROOT / "mkdocs.yml").read_text(encoding="utf-8")]
    own = [path for path in DOCS.rglob("*") if path.suffix in PICTURES and "katex" not in path.parts]
    assert len(own) > 40 and unused(own, texts) == []


def test_unused_pictures_are_found():
    text = prose("![a](b/c.png)\n`savefig('d.png')`\n```python\nfigure.savefig('d.png')\n```\n")
    assert unused([Path("b/c.png"), Path("d.png")], [text]) == [Path("d.png")]


FOLDERS = ("docs", "scripts", "tests", "agents", "flexman_gym")
FILE_NAME = re.compile(rf"(?<![\w./-])(?:{'|'.join(FOLDERS)})/[\w./-]+\.(?:md|py|csv|yaml|yml|js|json|npz|svg|png)\b")


def missing_files(text):
    """Return the names of files of the repository in a text without such a file; a name in capitals is a pattern."""
    names = (name for name in FILE_NAME.findall(text) if not re.search(r"/[A-Z]+\.", name))
    return {name for name in names if not (ROOT / name).exists()}


def test_files_that_pages_and_sources_name_exist():
    """Tests name files that they make; they are not read."""
    sources = [path for folder in FOLDERS if folder != "tests" for path in (ROOT / folder).rglob("*.py")]
    for path in [*FILES, *sources, *(ROOT / "flexman_gym").rglob("*.yaml"), ROOT / "mkdocs.yml"]:
        assert missing_files(path.read_text(encoding="utf-8")) == set(), path


def test_missing_files_are_found():
    text = "`docs/no_page.md`, `docs/theory.md`, own/docs/no.md, agents/recipes/NAME.yaml and tests/nothing/test_no.py."
    assert missing_files(text) == {"docs/no_page.md", "tests/nothing/test_no.py"}


def test_wrong_links_are_found():
    texts = {"docs/index.md": "# One `two`, three\n[a](no.md) ![b](live.gif) [c](#one-two-three) [d](#four) `[e](f)`\n"
             "[g](../README.md) [h](theory.md#a-link) [i](theory.md#nothing) [j](https://nowhere)\n",
             "docs/theory.md": PAGES["docs/theory.md"]}  # fmt: skip
    assert list(wrong_links("docs/index.md", texts)) == ["no.md", "#four", "../README.md", "theory.md#nothing"]


def found(entry):
    """Return the Python object of an entry of the API."""
    parts = entry.split(".")
    for count in range(len(parts) - 1, 0, -1):
        try:
            value = importlib.import_module(".".join(parts[:count]))
        except ModuleNotFoundError:
            continue
        for part in parts[count:]:
            value = getattr(value, part)
        return value
    raise LookupError(entry)


def key(value, name):
    """Return the identity of an object: classes and functions themselves, other values by name."""
    return (value.__module__, value.__qualname__) if isinstance(value, type | types.FunctionType) else name


def test_names_that_pages_mention_are_there():
    """Check names of the form `fm.name`, in code too."""
    names = {name for text in PAGES.values() for name in re.findall(r"\bfm\.(\w+(?:\.[a-z_]\w*)?)", text)}
    assert len(names) >= 40
    for name in names:
        first, _, second = name.partition(".")
        value = getattr(fm, first)
        assert not second or not isinstance(value, types.ModuleType | type) or hasattr(value, second), name


def test_every_public_name_has_one_entry():
    said = Counter(key(found(entry), entry.rpartition(".")[2]) for entry in ENTRIES)
    packages = [fm, *(importlib.import_module(f"flexman_gym.{name}") for name in PUBLIC)]
    names = {(name, id(package)): getattr(package, name) for package in packages for name in package.__all__}
    wanted = {key(value, name) for (name, _), value in names.items()
              if not isinstance(value, types.ModuleType) and name != "__version__"}  # fmt: skip
    assert wanted - said.keys() == set()
    assert {name: count for name, count in said.items() if count > 1} == {}
    assert {entry.rpartition(".")[0] for entry in ENTRIES} >= MODULES


def test_an_entry_is_on_the_page_of_its_folder():
    """Functions and classes know their module; constants do not."""
    wrong = {}
    for page, text in PAGES.items():
        for entry in ENTRY.findall(text):
            value = found(entry)
            if not isinstance(value, type | types.FunctionType):
                continue
            package, folder, room, *_ = [*value.__module__.split("."), ""]
            folder = "agents" if package == "flexman_agents" else room if folder == "toolbox" else folder
            if page != f"docs/api/{NAMED_DIFFERENTLY.get(folder, folder)}.md":
                wrong[entry] = page
    assert wrong == {}


def test_members_of_entries_are_there_with_their_docstrings():
    """A misspelt member would be left out without a message."""
    named = [(found(entry), names.split(", ")) for text in PAGES.values() for entry, names in MEMBERS.findall(text)]
    assert len(named) >= 40
    for owner, names in named:
        assert [name for name in names if not getattr(getattr(owner, name, None), "__doc__", None)] == [], owner


@pytest.mark.slow
def test_entries_are_read_as_python_reads_them(tmp_path, caplog):
    """Check that each entry exists with its docstring, is no module of the same name, and is parsed without errors."""
    griffe = pytest.importorskip("griffe")
    (tmp_path / "flexman_agents").symlink_to(ROOT / "agents")
    loader = griffe.GriffeLoader(search_paths=[str(ROOT), str(tmp_path)])
    left = [loader.load("flexman_gym"), loader.load("flexman_agents")]
    for entry in ENTRIES:
        read = loader.modules_collection[entry]
        read = read.final_target if read.is_alias else read
        assert read.kind.value != "module" and read.docstring, entry
        assert read.name == entry.rpartition(".")[2]
    with caplog.at_level("WARNING", "griffe"):
        while left:
            each = left.pop()
            left += [member for member in each.members.values() if not member.is_alias]
            if each.docstring:
                each.docstring.parse("google")
    kernels = re.compile(r"flexman_gym/kernels/.*No type or annotation")  # Numba infers the types of compiled functions
    assert [message for message in caplog.messages if not kernels.search(message)] == []


def test_equations_are_read_by_what_draws_them():
    if shutil.which("node") is None:
        pytest.skip("node is not installed (npm)")
    texts = [(page, one or two) for page, text in PAGES.items() for one, two in EQUATION.findall(prose(text))]
    assert len(texts) >= 40
    script = """
        const katex = require(process.argv[1]);
        for (const [page, text] of JSON.parse(require("fs").readFileSync(0)))
            try { katex.renderToString(text, { throwOnError: true, strict: "error" }); }
            catch (error) { console.log(page, text, error.message); }
    """
    command = ["node", "-e", script, str(DOCS / "assets" / "katex" / "katex.min.js")]
    done = subprocess.run(command, input=json.dumps(texts), capture_output=True, text=True, check=True)
    assert done.stdout == ""
