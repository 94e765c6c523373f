"""Hostile files that every reader of the library must reject at once with a one-line error.

`PYTHONPATH=tests python -m oracles.hostile` prints the time until each is rejected.
"""

import io
import os
import resource
import struct
import sys
import tempfile
import time
import zipfile
from pathlib import Path

import numpy as np

import flexman_gym as fm
from flexman_gym.agent.normalisation import RunningMeanStd
from flexman_gym.common.run_folder import read_npz
from flexman_gym.common.time_series import read_time_series
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.agent_info import training_seconds
from flexman_gym.evaluation.agents import find_agent
from flexman_gym.evaluation.policy_files import ARRAYS, METADATA, read_policy
from flexman_gym.simulation.episode import Episode
from flexman_gym.toolbox.controllers.references.optimised_slews import SlewTable
from flexman_gym.toolbox.league.certificate_file import CERTIFICATE
from flexman_gym.toolbox.league.certificate_file import read_certificate as read_certificate
from flexman_gym.toolbox.league.rows import LeagueRows
from flexman_gym.toolbox.view.learning_curves import read_progress

from oracles import shipped
from oracles.fuzz import bounded

SECONDS = 5.0  # of CPU time until a file is refused; before, some took minutes or did not end
SECRET = "root:x:0:0:root:/root:/bin/bash"  # the first line of a file that somebody else must not see
READERS = {  # name of the file -> what reads it, of its path
    "scene.yaml": fm.Scene.load,
    "environment.yaml": Configuration.load,
    "arm.json": lambda path: Configuration.from_plain({"arm": path.name}, path.parent),
    "record.csv": read_time_series,
    "episode.npz": Episode.load,
    "table.npz": SlewTable.load,
    "scales.npz": RunningMeanStd.load,
    "newest.npz": read_npz,
    "settings.json": lambda path: find_agent(str(path.parent)),
    METADATA: lambda path: read_policy(path.parent),
    ARRAYS: lambda path: read_policy(with_about(path.parent)),
    CERTIFICATE: lambda path: read_certificate(with_about(path.parent)),
    "cells.csv": lambda path: LeagueRows.load(with_rows(path.parent)),
    "rows.csv": lambda path: LeagueRows.load(with_cells(path.parent)),
    "progress.csv": lambda path: read_progress(path.parent),
    "progress-1.csv": lambda path: training_seconds(str(path.parent)),
}


def with_about(folder):
    """Create a folder with given policy metadata."""
    (folder / METADATA).write_bytes(shipped.files()[METADATA])
    return folder


def with_cells(folder):
    """Create a folder with the cells of a league."""
    (folder / "cells.csv").write_text("key,agent,scenario,first,end,action,design,why\n")
    return folder


def with_rows(folder):
    """Create a folder with the rows of a league."""
    (folder / "rows.csv").write_text("key,agent,scenario,seed\n")
    return folder


def pipe(path):
    """Create a pipe without a writer."""
    os.mkfifo(path)


def device(path):
    """Create a link to an endless device."""
    path.symlink_to("/dev/zero")


def large(path):
    """Create a sparse file above the size limit of text files."""
    path.touch()
    os.truncate(path, 2**40)


SPECIAL = {"pipe": pipe, "device": device, "directory": Path.mkdir, "larger than the disk": large}


def archive(name, head, stored):
    """Create a zip file whose array header promises more data than stored."""
    out, numbers = io.BytesIO(), io.BytesIO()
    np.lib.format.write_array_header_1_0(numbers, {"descr": "<f8", "fortran_order": False, "shape": head})
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED if stored else zipfile.ZIP_STORED, compresslevel=1) as file:
        file.writestr(f"{name}.npy", numbers.getvalue() + bytes(stored))
    return out.getvalue()


def cut(content):
    """Create a zip file with its directory declared far beyond the end."""
    return content[:-6] + struct.pack("<IH", 2**32 - 2, 0)


NESTED = b"[" * 5_000
LONG = 10_000
CONTENTS = {  # reader and what is wrong -> a content
    ("record.csv", "a head of spaces"): lambda: b" " * LONG + b"\n0,1\n",
    ("record.csv", "a head of brackets"): lambda: b"(" * LONG + b"[ " * LONG + b"\n0,1\n",
    ("record.csv", "a line without end"): lambda: b"time (s),a (m)\n" + b"1," * 4_000_000,
    ("record.csv", "a first line without end"): lambda: b"a (m)," * 2_000_000,
    ("record.csv", "too many rows"): lambda: b"time (s),a (m)\n" + b"0,1\n" * 2_000_000,
    ("record.csv", "rows of nothing"): lambda: b"time (s),a (m)\n" + b"\n" * 10_000_000,
    ("record.csv", "an open quote"): lambda: b'time (s),a (m)\n"' + b"0,1\n" * 900_000,
    ("record.csv", "no table"): lambda: SECRET.encode() + b"\n",
    ("record.csv", "no text"): lambda: bytes(range(256)),
    ("scene.yaml", "nested"): lambda: NESTED,
    ("scene.yaml", "no scene"): lambda: SECRET.encode() + b"\n",
    ("environment.yaml", "nested"): lambda: b"{a: " * 100_000,
    ("arm.json", "nested"): lambda: NESTED,
    ("arm.json", "a number without end"): lambda: b'{"links": ' + b"9" * 900_000 + b"}",
    ("settings.json", "nested"): lambda: NESTED,
    ("settings.json", "a number without end"): lambda: b"9" * 900_000,
    ("settings.json", "larger than any settings"): lambda: b"[" + b"0," * 1_000_000 + b"0]",
    ("settings.json", "no settings"): lambda: SECRET.encode() + b"\n",
    (CERTIFICATE, "without its keys"): lambda: b"{}",
    (CERTIFICATE, "a list"): lambda: b"[]",
    (CERTIFICATE, "no certificate"): lambda: SECRET.encode() + b"\n",
    (ARRAYS, "a header without end"): lambda: struct.pack("<Q", 2**62) + b"{}",
    (METADATA, "nested"): lambda: NESTED,
    ("rows.csv", "empty"): lambda: b"",
    ("rows.csv", "no table"): lambda: SECRET.encode() + b"\n",
    ("rows.csv", "a first line without end"): lambda: b"key," * 1_000_000,
    ("cells.csv", "empty"): lambda: b"",
    ("cells.csv", "no table"): lambda: SECRET.encode() + b"\n",
    ("progress.csv", "too many rows"): lambda: b"a,b\n" + b"1,2\n" * 2_000_000,
    ("progress.csv", "no text"): lambda: b"\xff" * 1000,
} | {
    (name, what): content
    for name in ("episode.npz", "table.npz", "scales.npz", "newest.npz")
    for what, content in {
        "a giant array": lambda: archive("about", (2**50,), 0),
        "a packed array": lambda: archive("about", (14 * 10**6,), 112 * 10**6),
        "an archive that was cut": lambda: cut(archive("about", (1,), 0)),
        "noise": lambda: np.random.default_rng(0).bytes(1000),
        "no archive": lambda: SECRET.encode() + b"\n",
    }.items()
}  # fmt: skip


def line_of(name, path):
    """Return the error message of a reader for a path, and the CPU time (s)."""
    begun = time.process_time()
    try:
        with bounded(10.0 * SECONDS):
            READERS[name](path)
        line = ""
    except (ValueError, FileNotFoundError) as error:
        line = str(error)
    return line, time.process_time() - begun


def cases():
    """Yield reader, defect, and function that creates the file."""
    for name in [name for name in READERS if name != CERTIFICATE]:  # a policy without one has none
        for what, make in SPECIAL.items():
            yield name, what, make
    for (name, what), content in CONTENTS.items():
        yield name, what, lambda path, content=content: path.write_bytes(content())


def main():
    """Print time and message of each case."""
    resource.setrlimit(resource.RLIMIT_DATA, (4 * 2**30, 4 * 2**30))
    for name, what, make in cases():
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / name
            make(path)
            try:
                line, seconds = line_of(name, path)
            except BaseException as error:  # no refusal, which is what this is to find
                line, seconds = f"{type(error).__name__}: {error}", float("nan")
        print(f"{name:<20} {what:<26} {seconds:7.3f} s  {line[:150]!r}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
