"""Tests of the published pages against their rows; test_learning.py has that of the learning page."""

import pytest

from studies.control.cases import ControlRow
from studies.control.page import page as control_page
from studies.fidelity.measure import FidelityRow
from studies.fidelity.page import page as fidelity_page
from studies.files import read_comment, read_rows
from studies.machine.measure import FitRow
from studies.machine.page import page as machine_page
from studies.ringdown.measure import PERIOD, RingDownRow
from studies.ringdown.page import page as ringdown_page
from studies.servos.measure import FrictionRow, ServoRow
from studies.servos.page import page as servos_page
from studies.stability.measure import StabilityRow
from studies.stability.page import page as stability_page

from oracles.files import ROOT

DOCS = ROOT / "docs"
DEFAULT = "midpoint_corrected_3", PERIOD / 3  # method and step, s
PAGES = {
    "control": (ControlRow, lambda rows, computer: control_page(rows)),
    "fidelity": (FidelityRow, lambda rows, computer: fidelity_page(rows, more("fidelity_open", FidelityRow))),
    "machine": (FitRow, machine_page),
    "ring_down": (RingDownRow, lambda rows, computer: ringdown_page(rows, computer, DEFAULT)),
    "servos": (ServoRow, lambda rows, computer: servos_page(computer, rows, more("servos_friction", FrictionRow))),
    "stability": (StabilityRow, lambda rows, computer: stability_page(computer, rows)),
}


def published(name):
    """Return the path of a published file."""
    return DOCS / "evidence" / name if name.startswith("control") else DOCS / name


def more(name, kind):
    """Read the rows of a published file."""
    return read_rows(published(f"{name}.csv"), kind)


@pytest.mark.parametrize("name", PAGES)
def test_a_published_page_is_made_of_its_rows(name):
    kind, page = PAGES[name]
    text = page(more(name, kind), read_comment(published(f"{name}.csv")))
    assert published(f"{name}.md").read_text(encoding="utf-8") == text
