"""Change: one place in the sources that is made wrong on purpose, and the tests that should notice."""

from dataclasses import dataclass
from pathlib import Path


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
