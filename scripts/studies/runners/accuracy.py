"""Errors of the default method and of similar ones, on many arms."""

from studies.ringdown.measure import Errors, errors_of_default
from studies.ringdown.page import accuracy_page
from studies.study import QUICK, Study, Table

ARMS, FEW = 300, 2  # arms of each motion, and with --quick

RUNNER = Study(
    tables=(Table("accuracy", Errors, 3),),
    measure=lambda options: [errors_of_default(FEW if options.quick else ARMS)],
    pages={"accuracy.md": accuracy_page},
    options=QUICK,
)
