"""Places: folders and files that a study is told to write, checked before it computes for minutes."""

import argparse
import os
from pathlib import Path


def folder(text: str) -> Path:
    """Gives a folder that can be written, made where there is none, for `type` of an argument.

    Raises:
        argparse.ArgumentTypeError: one line with what is wrong.
    """
    path = Path(text)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    if not os.access(path, os.W_OK):
        raise argparse.ArgumentTypeError(f"{path} cannot be written; give a folder of yours")
    return path
