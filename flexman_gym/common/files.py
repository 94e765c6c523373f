"""Files: atomic writes, strict JSON and YAML, and safe reading of arrays."""

import csv
import errno
import io
import itertools
import json
import os
import re
import stat
import struct
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import yaml

from flexman_gym.common.arrays import Vector
from flexman_gym.common.checks import one_of
from flexman_gym.common.errors import MAX_REASON, MappingKeyError, short_path, short_repr

# Possible errors while reading a damaged file of text or arrays.
READ_ERRORS = (
    ValueError, LookupError, TypeError, AttributeError, EOFError, OSError, MemoryError, RecursionError, OverflowError,
    NotImplementedError, SyntaxError, zipfile.BadZipFile, zlib.error, struct.error,
)  # fmt: skip
MAX_TEXT_BYTES = 1_000_000  # bytes of a text file
MAX_UNPACKED_BYTES = 100_000_000  # bytes of all arrays of a file after decompression
CONVERSION = "scripts/convert.py converts old keys"  # end of an error about a key


class _Mapping(list[tuple[Any, Any]]):
    """Pairs of a mapping in the order of the file, which may repeat a key."""


class _Loader(yaml.SafeLoader):
    """YAML loader restricted to the words and numbers of JSON, without anchors, aliases and tags.

    YAML 1.1 would read 1:30 as 90, 010 as 8 and 2e9 as a string, and aliases permit a small file to grow without bound.
    """

    yaml_implicit_resolvers: dict[str, Any] = {}  # noqa: RUF012

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        event = self.peek_event()  # type: ignore[no-untyped-call]
        if isinstance(event, yaml.AliasEvent) or event.anchor or event.tag:
            raise yaml.MarkedYAMLError(None, None, "anchors, aliases and tags are not allowed", event.start_mark)
        return super().compose_node(parent, index)


class _PackageLoader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """YAML loader of the files of this package: the same words and numbers, by the parser of LibYAML if installed."""

    yaml_implicit_resolvers: dict[str, Any] = {}  # noqa: RUF012


class _Dumper(yaml.SafeDumper):
    """YAML dumper that quotes a string wherever `_Loader` or a reader of YAML 1.1 would read another type."""


_NUMBER = r"-?(0|[1-9][0-9]*)"
for _tag, _words, _first in (
    ("null", r"null|~|", ["n", "~", ""]),
    ("bool", r"true|false", ["t", "f"]),
    ("int", _NUMBER, list("-0123456789")),
    ("float", _NUMBER + r"(\.[0-9]+)?([eE][-+]?[0-9]+)?", list("-0123456789")),
):
    for _class in (_Loader, _PackageLoader, _Dumper):
        _class.add_implicit_resolver(f"tag:yaml.org,2002:{_tag}", re.compile(f"^(?:{_words})$"), _first)
for _class in (_Loader, _PackageLoader):
    _class.add_constructor("tag:yaml.org,2002:map", lambda read, node: _Mapping(read.construct_pairs(node, deep=True)))


def regular_file(path: str | Path, most: int | None = MAX_TEXT_BYTES) -> Path:
    """Return a path if it is a regular file, without opening it: reading a device or a pipe may never end.

    Args:
        path: the path.
        most: largest size in bytes; None for any size.

    Raises:
        FileNotFoundError: if the file does not exist.
        ValueError: for a directory, a device, a pipe or a larger file; the message does not name the file.
    """
    try:
        status = os.stat(path)
    except (OSError, ValueError):  # also for a name that is too long or contains a zero byte
        raise FileNotFoundError(f"{short_path(path)}: there is no such file") from None
    if not stat.S_ISREG(status.st_mode):
        raise ValueError("this is a directory, a device or a pipe; give a file")
    if most is not None and status.st_size > most:
        raise ValueError(f"a size of {status.st_size} bytes is not allowed; give at most {most}")
    return Path(path)


@contextmanager
def open_arrays(path: str | Path, packed: bool = False) -> Iterator[Any]:
    """Open a file of arrays (npz) without running any code in it.

    Args:
        path: path of the file.
        packed: True if the arrays may be compressed, with at most 100 MB after decompression.

    Yields:
        Any: The arrays by name.

    Raises:
        FileNotFoundError: if the file does not exist.
        ValueError: for arrays larger than the file; for other damage, any of READ_ERRORS.
    """
    size = regular_file(path, None).stat().st_size
    with zipfile.ZipFile(path) as parts:
        if sum(part.file_size for part in parts.infolist()) > (MAX_UNPACKED_BYTES if packed else size):
            raise ValueError("its arrays are larger than 100 MB" if packed else "its arrays are packed")
    with np.load(path, allow_pickle=False) as result:
        yield result


@contextmanager
def reading(path: str | Path, wrong: str, errors: tuple[type[Exception], ...] = READ_ERRORS) -> Iterator[None]:
    """Raise ValueError with one line for the errors of reading a damaged file; FileNotFoundError is not changed.

    Args:
        path: path of the file.
        wrong: predicate of a damaged file, such as "is not a saved episode".
        errors: errors of reading.
    """
    try:
        yield
    except FileNotFoundError:
        raise
    except errors as error:
        reason = " ".join(str(error).split())[:MAX_REASON] or type(error).__name__
        raise ValueError(f"{short_path(path)}: this {wrong} ({reason}){_conversion(error)}") from None


@contextmanager
def naming(path: str | Path) -> Iterator[None]:
    """Put the path of a file in front of the message of each ValueError about its content."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{short_path(path)}: {error}{_conversion(error)}") from None


def _conversion(error: Exception) -> str:
    """Return the end of the message of an error in a file: for a key, the script that converts old files."""
    return f"; {CONVERSION}" if isinstance(error, MappingKeyError) else ""


def read_data(path: Path, kind: type = dict, of_package: bool = False) -> Any:
    """Read a .json, .yaml or .yml file.

    Args:
        path: path of the file.
        kind: dict for a file with a mapping, list for a file with a list.
        of_package: True for a YAML file of this package, which is parsed six times as fast and may have anchors.

    Raises:
        FileNotFoundError: if the file does not exist.
        ValueError: for another suffix, an irregular file, more than 1 MB, text other than UTF-8, a syntax error,
            another kind, a repeated key and excessive nesting, with a one-line message without the name and the text of
            the file.
    """
    ending = check_suffix(path)
    try:
        text = regular_file(path).read_bytes().decode("utf-8")
    except UnicodeDecodeError as error:
        raise ValueError(f"byte {error.start} is not UTF-8; give UTF-8 text") from None
    try:
        result = _tree("", _parse(text, ending, _PackageLoader if of_package else _Loader))
    except RecursionError:
        raise ValueError("lists or mappings are nested too deeply; give fewer levels") from None
    if not isinstance(result, kind):
        raise ValueError("this is no mapping; give names with their values" if kind is dict else "give a list")
    return result


def parse_yaml(text: str) -> Any:
    """Parse a YAML text under the same restrictions as `read_data`.

    Args:
        text: the text.

    Raises:
        ValueError: for a syntax error, with a one-line message.
        RecursionError: for excessive nesting.
    """
    return _tree("", _parse(text, ".yaml"))


def write_data(path: Path, data: Any) -> None:
    """Write a tree of dicts, lists, strings, numbers, booleans and None to a .json, .yaml or .yml file."""
    if check_suffix(path) == ".json":
        text = json.dumps(data, indent=1) + "\n"
    else:
        text = yaml.dump(data, Dumper=_Dumper, sort_keys=False, default_flow_style=None, width=120)
    write_file(path, text)


def check_suffix(path: Path) -> str:
    """Return the suffix of a JSON or YAML file."""
    return one_of(f"the suffix of {short_path(path, 40)}", path.suffix, (".json", ".yaml", ".yml"))


def _parse(text: str, ending: str, loader: type = _Loader) -> Any:
    """Return the content of a text, with `_Mapping` for every mapping."""
    try:
        if ending == ".json":
            return json.loads(text, object_pairs_hook=_Mapping)
        documents = [each for each in yaml.load_all(text, Loader=loader) if each is not None]  # the last may be empty
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 0
        raise ValueError(f"line {line}: {error.problem}; give valid YAML") from None
    except (yaml.YAMLError, ValueError) as error:
        raise ValueError(f"{' '.join(str(error).split())}; give valid {ending[1:].upper()}") from None
    if len(documents) > 1:
        raise ValueError(f"{len(documents)} documents separated by --- are not allowed; give one")
    return documents[0] if documents else None


def _tree(path: str, data: Any) -> Any:
    """Return data with dicts in place of `_Mapping`; `path` is the field of the data, for errors."""
    if isinstance(data, _Mapping):
        tree: dict[str, Any] = {}
        for key, value in data:
            if not isinstance(key, str) or not key.isidentifier():
                raise ValueError(f"{path or 'the file'}: the key {short_repr(key)} is not allowed; give a name")
            field = f"{path}.{key}" if path else key
            if key in tree:
                raise ValueError(
                    f"{field}: {short_repr(value)} is not allowed; this key was given before; give it once"
                )
            tree[key] = _tree(field, value)
        return tree
    if isinstance(data, list):
        return [_tree(f"{path}[{i}]", entry) for i, entry in enumerate(data)]
    return data


def write_file(path: str | Path, content: str | bytes | Callable[[BinaryIO], Any]) -> None:
    """Write a file at a path of the user, atomically; missing folders are created.

    A link remains, and the file to which it leads is written. A device or a pipe, such as /dev/stdout, is written in
    place.

    Args:
        path: path of the file.
        content: text, which is encoded in UTF-8; bytes; or a function to write the content to an open file.

    Raises:
        OSError: if the file cannot be written; an existing file remains unchanged.
    """
    target = _writable_path(Path(path))
    data = content.encode() if isinstance(content, str) else content
    fill = data if callable(data) else lambda file: file.write(data)
    if target.exists() and not target.is_file():
        with target.open("wb") as file:
            fill(file)
        return
    target.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(target, fill)


def new_folder(path: Path) -> Path:
    """Create a folder at a path, or if it exists at PATH-2, PATH-3 and so on, and return the path of the folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    for number in itertools.count(1):
        folder = path if number == 1 else path.with_name(f"{path.name}-{number}")
        with suppress(FileExistsError):
            folder.mkdir()
            break
    return folder


def check_output(path: str | Path) -> Path:
    """Return the path of an output file after checking that `write_file` can write it, for use before a long run.

    Raises:
        OSError: for a folder, a write-protected file, and a folder in which no file can be created.
    """
    target = _writable_path(Path(path))
    if target.is_file() or not target.exists():
        try:
            tempfile.TemporaryFile(dir=next(each for each in target.parents if each.exists())).close()
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(path)) from None
    return Path(path)


def _writable_path(path: Path) -> Path:
    """Return the path to which links lead; a device or a pipe keeps its path.

    Raises:
        OSError: for a folder and a write-protected file.
    """
    target = path if path.exists() and not path.is_file() else Path(os.path.realpath(path))
    if target.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if target.exists() and not os.access(target, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
    return target


def write_atomically(path: Path, fill: Callable[[BinaryIO], Any]) -> None:
    """Write a file atomically: fill a temporary file, flush it to the disk, and rename it.

    The file has the permissions of the one that it replaces. A link is replaced too, see `write_file`.

    Args:
        path: path of the file.
        fill: function to write the content to the open temporary file.

    Raises:
        OSError: if the file cannot be written; an existing file remains unchanged.
    """
    temporary = path.with_name(f".{path.name}.part")
    try:
        temporary.unlink(missing_ok=True)  # a rest of a killed process, or a link to another file
        with temporary.open("xb") as file:
            with suppress(FileNotFoundError):
                if stat.S_ISREG(mode := os.lstat(path).st_mode):
                    os.fchmod(file.fileno(), stat.S_IMODE(mode))
            fill(file)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except BaseException:  # Ctrl+C too
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise
    _sync(path.parent)


def existing_file(path: Path) -> Path:
    """Return the path of a file of a training run; raise FileNotFoundError with advice if it does not exist."""
    if not os.path.isfile(path):  # False for any invalid name
        raise FileNotFoundError(f"{short_path(path)}: no such file; give a folder that a training run has written")
    return path


def _sync(folder: Path) -> None:
    """Flush the directory entries of a folder to disk, where the file system supports it."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def write_csv(path: str | Path, columns: Mapping[str, Vector]) -> None:
    """Write columns of equal length to a CSV file, with all digits of the numbers.

    Args:
        path: path of the file.
        columns: header, such as "time (s)" -> values (T,).
    """
    table = np.column_stack(list(columns.values()))
    text = io.StringIO(newline="")
    csv.writer(text).writerows([[*columns], *table.tolist()])
    write_file(path, text.getvalue())
