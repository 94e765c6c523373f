"""Plant: what a controller is made for, as an engineer knows it."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

from flexman_gym.arrays import Array, Vector
from flexman_gym.model.model import Model
from flexman_gym.simulation.families import Method
from flexman_gym.simulation.methods import DEFAULT

Gains = Mapping[str, Vector]


class Plant(NamedTuple):
    """What a controller is made for.

    Attributes:
        model: of the arm, as the base knows it.
        torque_limit: (n,) N m.
        period: of control, s.
        gains: makes "stiffness" (N m/rad) and "damping" (N m s/rad) that were tuned for the arm, (n,) each.
        unknown: name -> (low, high) of the physical parameters that differ from arm to arm, see
            `simulation.parameters.PARAMETERS`; parts of the nominal value where the table there says factor.
        delay: fewest and most whole control periods by which torques come late.
        moved: method and step (s) by which the arm is simulated.
        push: N, how large forces on the tip may be that nobody tells.
        measured: gives, name -> (2, size), the range of each quantity that instruments measure and the standard
            deviation of their noise, in its unit.
        bandwidth: Hz, of drives that follow what they are asked for as a first-order lag; None for such that do so at
            once.
    """

    model: Model
    torque_limit: tuple[float, ...]
    period: float
    gains: Callable[[], Gains]
    unknown: Mapping[str, tuple[float, float]] = {}
    delay: tuple[int, int] = (0, 0)
    moved: tuple[str | Method, float | str] = (DEFAULT, "auto")
    push: float = 0.0
    measured: Callable[[], Mapping[str, Array]] = dict
    bandwidth: float | None = None
