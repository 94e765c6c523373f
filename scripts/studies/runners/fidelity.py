"""Evaluate the accuracy, error estimates and cost of the models chosen by `choose_model`."""

import argparse
from pathlib import Path

from flexman_gym.common.computer import computer_text
from flexman_gym.common.parallel import Workers, parallel_map
from flexman_gym.envs.vector_env import compile_kernels
from studies.fidelity.measure import SCENES, FidelityRow, rows_of
from studies.fidelity.page import page
from studies.files import folder, read_comments, read_rows, write_rows

DIGITS = 9


def main() -> None:
    """Run the study and write rows and page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--redraw", action="store_true", help="write the page from the rows of an earlier run")
    parser.add_argument("--kept", type=Path, help="folder of finished cells, from which an interrupted study resumes")
    Workers.arguments(parser)
    parser.add_argument("folder", nargs="?", type=folder, default="docs/evidence", help="output folder")
    options = parser.parse_args()
    files = {file: make() for file, make in SCENES.items()}
    for file, cases in files.items() if not options.redraw else ():
        done = parallel_map(
            rows_of, [(file, name) for name in cases], Workers.of(options), options.kept, compile_kernels
        )
        result = [FidelityRow(**row) for rows in done for row in rows]
        print(*result, sep="\n", flush=True)
        write_rows(result, options.folder / file, DIGITS, computer_text())
    paths = [options.folder / file for file in files]
    given, opened = (read_rows(path, FidelityRow) for path in paths)
    text = page(given, opened, read_comments(*paths))
    (options.folder / "fidelity.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
