"""Predicted strains, compared with the gauges of a real arm."""

from itertools import chain

from studies.machine.strain import StrainRow, one_stage, two_stages
from studies.machine.strain_page import page
from studies.study import Study, Table

RUNNER = Study((Table("strain", StrainRow, 4),), lambda _: [chain(one_stage(), two_stages())], {"strain.md": page})
