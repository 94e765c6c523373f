"""Pickled files with a digest of their content, so that a damaged file counts as missing."""

import hashlib
import pickle
from pathlib import Path
from typing import IO, Any

DIGEST_SIZE = hashlib.sha256().digest_size  # bytes; size of the digest at the beginning of a file


def read_checked(path: str | Path) -> Any:
    """Return the content of a file; raise OSError for a file that is missing or damaged."""
    content = Path(path).read_bytes()
    if hashlib.sha256(content[DIGEST_SIZE:]).digest() != content[:DIGEST_SIZE]:
        raise OSError(f"{path} is damaged")
    return pickle.loads(content[DIGEST_SIZE:])


def write_checked(file: IO[bytes], pickled: bytes) -> None:
    """Write pickled content after its digest."""
    file.write(hashlib.sha256(pickled).digest() + pickled)
