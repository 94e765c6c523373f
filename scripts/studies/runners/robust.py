"""Robust controllers of a published arm, by H-infinity synthesis."""

from studies.robust.measure import RobustRow, rows
from studies.robust.page import page
from studies.study import Study, Table

RUNNER = Study((Table("robust", RobustRow, 4),), lambda _: [rows()], {"robust.md": page})
