"""Certificates of the shipped policies: changes that exceed limits, and the texts of the limits."""

import re

import numpy as np
import pytest

from flexman_gym.common.formatting import millimetres
from flexman_gym.evaluation.policy_files import POLICIES, policy_folder, read_policy
from flexman_gym.toolbox.league.certificate_file import exceeded_limits, read_certificate

from oracles.files import ROOT


@pytest.mark.parametrize("name", POLICIES)
def test_the_page_of_policies_has_the_row(name):
    about, text = read_policy(policy_folder(name)).metadata, (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
    lines = [[cell.strip() for cell in line.strip("| ").split(" | ")] for line in text.splitlines()]
    heads = next(cells for cells in lines if cells[0] == "change" and f"`{name}`" in cells)
    column = {cells[0]: cells[heads.index(f"`{name}`")] for cells in lines if len(cells) == len(heads)}
    assert column["recipe"] == f"`{about['recipe']['name']}`"
    assert column["environment"] == f"`{about['league']['environment']}`"
    beyond = [cell for change, cell in column.items() if re.search("settl|vibration", cell)]
    assert len(beyond) == len(exceeded_limits(name))


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
