"""Designs of the paper's arm whose thickness is optimised."""

from studies.arm_design.measure import DesignRow, ProfileRow, rows
from studies.arm_design.page import draw, page
from studies.study import Study, Table

RUNNER = Study(
    tables=(Table("arm_design", DesignRow), Table("arm_design_profiles", ProfileRow)),
    measure=lambda _: rows(),
    pages={"arm_design.md": page},
    charts=lambda folder, _, profiles: draw(profiles, folder),
)
