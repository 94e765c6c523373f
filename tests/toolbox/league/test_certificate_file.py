"""Certificates of the shipped policies: changes that exceed limits, and the texts of the limits."""

import numpy as np
import pytest

from flexman_gym.common.formatting import millimetres
from flexman_gym.evaluation.policy_files import POLICIES, policy_folder, read_policy
from flexman_gym.toolbox.league.certificate_file import exceeded_limits, read_certificate
from studies.learning.page import CHANGE_NAMES

from oracles.files import ROOT


@pytest.mark.parametrize("name", POLICIES)
def test_the_page_of_policies_has_the_row(name):
    about, text = read_policy(policy_folder(name)).metadata, (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
    table = text.partition("| change | ")[2].partition("\n\n")[0].splitlines()
    heads, _, *lines = [[cell.strip() for cell in line.strip("| ").split(" | ")] for line in table]
    column = {change: cells[heads.index(f"`{name}`")] for change, *cells in lines}
    assert column["recipe"] == f"`{about['recipe']['name']}`"
    assert column["environment"] == f"`{about['league']['environment']}`"
    failed = {}
    for change, _ in exceeded_limits(name):
        parameter, _, values = change.partition("=")
        prefix = f"{values.replace(':', ' to ')}: " if ":" in values else ""
        change = parameter if prefix else change
        failed[CHANGE_NAMES.get(change, change.replace("=", " "))] = prefix
    outcomes = {change: cell for change, cell in column.items() if change not in ("recipe", "environment")}
    assert failed.keys() <= outcomes.keys()
    for change, cell in outcomes.items():
        within = cell == "-" or cell.endswith("yes")
        assert within != (change in failed) and cell.startswith(failed.get(change, "")), change


@pytest.mark.parametrize("name", POLICIES)
def test_a_certificate_has_the_texts_of_its_rows(name):
    """Values beyond a limit, from the metrics of the row and of the first row, in seconds, millimetres and percent."""
    first, *rows = read_certificate(policy_folder(name))["rows"]
    assert not first["fails"]
    for row in rows:
        found = dict(part.split(" (limit ") if "(" in part else (part, "") for part in row["fails"].split(", ") if part)
        assert (f"{row['settled']:.0%} settle" in found) == (row["settled"] < 0.95)
        assert any("end at a limit" in text for text in found) == (row["failed"] > 0.0)
        time, vibration = (np.inf if row[name] is None else row[name] for name in ("settling_time", "vibration"))
        if "@" not in row["scenario"]:  # whose limits are those of fewer episodes
            assert (f"settling in {time:.2f} s" in found) == (time > 1.3 * first["settling_time"])
            limit = 5e-3 if "RRR" in row["scenario"] else 5e-3 / 8.5  # of reaches of 8.5 m and 1 m
            assert (f"vibration {millimetres(vibration)}" in found) == (vibration > limit), row
