"""Compare exact derivatives with differences, measure costs."""

import argparse

from flexman_gym.common.computer import computer_text
from studies.derivatives.costs import ROUNDS, CostRow, cost_rows
from studies.derivatives.measure import DerivativeRow, rows
from studies.derivatives.page import page
from studies.files import folder, read_comments, read_rows, write_rows


def main() -> None:
    """Run the study and write rows and page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--redraw", action="store_true", help="write the page from the rows of an earlier run")
    parser.add_argument("--folder", type=folder, default="out", help="output folder of rows and page")
    options = parser.parse_args()
    file, costs = options.folder / "derivatives.csv", options.folder / "derivatives_costs.csv"
    if not options.redraw:
        write_rows(list(rows()), file, 6, computer_text())
        cost_rows(1)  # compiles
        write_rows(cost_rows(ROUNDS), costs, 4, computer_text())
    text = page(read_rows(file, DerivativeRow), read_rows(costs, CostRow), read_comments(file, costs))
    (options.folder / "derivatives.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
