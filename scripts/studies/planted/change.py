"""Change: one place in the sources that is made wrong on purpose, and the tests that should notice."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

PACKAGE = "flexman_gym/"


@dataclass(frozen=True)
class Change:
    """A planted error.

    Attributes:
        room: of the table, such as "kernels".
        error: what is wrong, in words.
        file: path from the root of the checkout.
        old, new: the text that is replaced, which stands in the file once, and what takes its place.
        tests: files or tests, paths from the root, the quickest first.
        equivalent: why no test can notice; "" where one should.
    """

    room: str
    error: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]
    equivalent: str = ""

    def applied(self, root: Path) -> str:
        """Gives the text of its file in a checkout, changed.

        Raises:
            ValueError: where the old text does not stand in the file exactly once.
        """
        path = root / self.file
        text = path.read_text(encoding="utf-8") if path.is_file() else ""
        if (count := text.count(self.old)) != 1:
            raise ValueError(f"{self.file}: {self.old!r} stands there {count} times, not once ({self.error})")
        return text.replace(self.old, self.new)


def changes(room: str, file: str, tests: str, *entries: tuple[str, ...]) -> Iterable[Change]:
    """Gives the changes of one file of a room that the same tests should notice.

    Args:
        room: its name.
        file: path from the package, or from the root where it begins with "agents".
        tests: paths from the folder of the tests, with spaces between them.
        entries: error, old and new text, and for an equivalent change the reason.
    """
    path = file if file.startswith("agents") else PACKAGE + file
    where = tuple(f"tests/{test}" for test in tests.split())
    for error, old, new, *reason in entries:
        yield Change(room, error, path, old, new, where, *reason)
