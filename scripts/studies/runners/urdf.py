"""Arms read from URDF files, compared with Pinocchio; needs the packages pin and example-robot-data."""

import sys
from argparse import Namespace
from functools import cache

from flexman_gym.common.computer import computer_text
from studies.study import Study, Table
from studies.urdf.measure import UrdfRow, measured

known = cache(measured)


def comment(options: Namespace) -> str:
    """Return the computer and the versions of both packages."""
    return ", ".join([computer_text(), *(f"{name} {version}" for name, version in known(options.python)[1].items())])


RUNNER = Study(
    tables=(Table("urdf", UrdfRow, 2),),
    measure=lambda options: [known(options.python)[0]],
    options={"--python": {"default": sys.executable, "help": "interpreter with pin and example-robot-data"}},
    comment=comment,
)
