"""Tests of the published pages against their rows; test_learning.py has that of the learning page."""

import pytest

from flexman_gym.toolbox.verification.table import VerificationRow
from studies.arm_design.measure import DesignRow, ProfileRow
from studies.arm_design.page import page as arm_design_page
from studies.benchmark.endurance import EnduranceRow
from studies.benchmark.measure import BenchmarkRow
from studies.benchmark.page import page as benchmark_page
from studies.control.cases import ControlRow
from studies.control.page import page as control_page
from studies.derivatives.costs import CostRow
from studies.derivatives.measure import DerivativeRow
from studies.derivatives.page import page as derivatives_page
from studies.drive.measure import FaultRow, LoopRow, RoundTripRow, UndisturbedRow
from studies.drive.page import page as drive_page
from studies.faults import Fault
from studies.faults import page as faults_page
from studies.fidelity.measure import FidelityRow
from studies.fidelity.page import page as fidelity_page
from studies.files import read_comment, read_comments, read_rows
from studies.machine.measure import FitRow
from studies.machine.page import page as machine_page
from studies.machine.strain import StrainRow
from studies.machine.strain_page import page as strain_page
from studies.peers.measure import Decay
from studies.peers.page import page as peers_page
from studies.planted.measure import Planted
from studies.planted.page import page as planted_page
from studies.precision.measure import Floor, PrecisionRow
from studies.precision.page import page as precision_page
from studies.readme import replaced_part
from studies.results import Results
from studies.ringdown.measure import PERIOD, Errors, RingDownRow
from studies.ringdown.page import accuracy_page
from studies.ringdown.page import page as ringdown_page
from studies.robust.measure import RobustRow
from studies.robust.page import page as robust_page
from studies.safety.learning import LearningRow
from studies.safety.measure import SafetyRow
from studies.safety.page import cells as safety_cells
from studies.safety.page import page as safety_page
from studies.screen import HIDDEN, index
from studies.servos.measure import FrictionRow, ServoRow
from studies.servos.page import page as servos_page
from studies.stability.measure import StabilityRow
from studies.stability.page import page as stability_page
from studies.verification.page import page as verification_page

from oracles.files import ROOT

DOCS, EVIDENCE = ROOT / "docs", ROOT / "docs" / "evidence"
DEFAULT = "midpoint_corrected_3", PERIOD / 3  # method and step, s
PAGES = {
    "control": (ControlRow, lambda rows, computer: control_page(rows, Results())),
}
SCREENS = {  # page -> function of its rows, and files and types of the rows
    "accuracy": (accuracy_page, {"accuracy": Errors}),
    "arm_design": (arm_design_page, {"arm_design": DesignRow, "arm_design_profiles": ProfileRow}),
    "benchmark": (benchmark_page, {"benchmark": BenchmarkRow, "endurance": EnduranceRow}),
    "derivatives": (derivatives_page, {"derivatives": DerivativeRow, "derivatives_costs": CostRow}),
    "drive": (
        drive_page,
        {"drive": LoopRow, "drive_faults": FaultRow, "drive_undisturbed": UndisturbedRow, "drive_fits": RoundTripRow},
    ),
    "faults": (faults_page, {"faults": Fault}),
    "fidelity": (fidelity_page, {"fidelity": FidelityRow, "fidelity_open": FidelityRow}),
    "machine": (machine_page, {"machine": FitRow}),
    "peers": (peers_page, {"peers": PrecisionRow, "peers_damping": Decay}),
    "planted": (planted_page, {"planted": Planted}),
    "ring_down": (lambda rows, files: ringdown_page(rows, DEFAULT, files), {"ring_down": RingDownRow}),
    "robust": (robust_page, {"robust": RobustRow}),
    "safety": (safety_page, {"safety": SafetyRow, "safety_learning": LearningRow}),
    "servos": (servos_page, {"servos": ServoRow, "servos_friction": FrictionRow}),
    "stability": (stability_page, {"stability": StabilityRow}),
    "strain": (strain_page, {"strain": StrainRow}),
    "verification": (verification_page, {"verification": VerificationRow}),
    "work_precision": (precision_page, {"work_precision": PrecisionRow, "work_precision_truths": Floor}),
}
WORDS, TABLE_ROWS, CHARTS = 250, 8, 1  # limits of a page of one screen


@pytest.mark.parametrize("name", SCREENS)
def test_a_page_of_evidence_is_made_of_its_rows_and_fits_a_screen(name):
    page, files = SCREENS[name]
    paths = [EVIDENCE / f"{file}.csv" for file in files]
    text = page(
        *(read_rows(path, kind) for path, kind in zip(paths, files.values(), strict=True)), read_comments(*paths)
    )
    assert (EVIDENCE / f"{name}.md").read_text(encoding="utf-8") == text
    assert text.startswith(HIDDEN) and "flexman_gym 0." in " ".join(text.split())
    table = [line for line in text.splitlines() if line.startswith("|")]
    prose = text.removeprefix(HIDDEN).replace("\n".join(table), "")
    assert len(prose.split()) <= WORDS and len(table) <= 2 + TABLE_ROWS and text.count("](") - CHARTS <= 8
    assert prose.count("![") <= CHARTS and max(len(line) for line in prose.splitlines() if line[:2] != "![") <= 120


def test_the_index_has_the_sentence_of_every_page():
    published = (EVIDENCE / "index.md").read_text(encoding="utf-8")
    assert published == index(path for path in sorted(EVIDENCE.glob("*.md")) if path.name != "index.md")
    assert all(f"]({name}.md): " in published for name in SCREENS)


@pytest.mark.slow
@pytest.mark.parametrize("name", PAGES)
def test_a_published_page_is_made_of_its_rows(name):
    kind, page = PAGES[name]
    text = page(read_rows(EVIDENCE / f"{name}.csv", kind), read_comment(EVIDENCE / f"{name}.csv"))
    assert (EVIDENCE / f"{name}.md").read_text(encoding="utf-8") == text


def test_the_page_on_safety_has_the_table_of_its_rows():
    text = (DOCS / "safety.md").read_text(encoding="utf-8")
    assert replaced_part(text, "cells", safety_cells(read_rows(EVIDENCE / "safety.csv", SafetyRow))) == text
