"""Choice: how finely the arm of a scene is modelled."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexman_gym.checks import flag, refusal, sequence, store, whole_number

MOST_ELEMENTS = 64


@dataclass(frozen=True)
class ModelChoice:
    """How finely the arm of a scene is modelled; one value for all links or a tuple of one value per link.

    flexible_links   bool; a rigid link has no elastic coordinate
    elements         finite elements of a Link, or of each section of a NonUniformLink; 1 to 64, in a link as a whole
                     too. A link has 6 * elements * number of sections coordinates
    modes            modes kept of a link: how many, those of the lowest frequencies, 0 to its number of coordinates (at
                     most 384), or, in a tuple for all links, a tuple of their numbers, ascending, the lowest being 0:
                     (4, (0, 1, 3), 0) keeps four modes, modes 0, 1 and 3, and none; None keeps every coordinate
    flexible_joints  False makes every joint rigid, whatever its stiffness
    stiffening       foreshortening (geometric stiffening) of the links
    spinning_rotors  a rotor spins as a body in the frame that carries its joint; False neglects that frame's rotation,
                     as the paper does (Eq. 23). Only its inertia about the axis counts. It moves the tip of the paper's
                     arm by 103 mm (everything flexible) and 78 mm (rigid joints) within 2 s
    rotary_inertia   False is the classic Euler-Bernoulli beam: the sections of a link resist no rotation about their
                     transverse axes (Rayleigh's term), in rigid and in elastic motion, only that about the beam axis.
                     It moves the tip of the paper's arm by 7.2 mm (rigid) and 6.9 mm (everything flexible) within 2 s

    Raises ValueError for another type or a number outside its range.
    """

    flexible_links: bool | tuple[bool, ...]
    elements: int | tuple[int, ...]
    modes: int | tuple[int | tuple[int, ...], ...] | None = None
    flexible_joints: bool = True
    stiffening: bool = False
    spinning_rotors: bool = False
    rotary_inertia: bool = True

    def __post_init__(self) -> None:
        store(
            self,
            flexible_links=_one_or_each("ModelChoice.flexible_links", self.flexible_links, flag),
            elements=_one_or_each("ModelChoice.elements", self.elements, whole_number, 1, MOST_ELEMENTS),
            flexible_joints=flag("ModelChoice.flexible_joints", self.flexible_joints),
            stiffening=flag("ModelChoice.stiffening", self.stiffening),
            spinning_rotors=flag("ModelChoice.spinning_rotors", self.spinning_rotors),
            rotary_inertia=flag("ModelChoice.rotary_inertia", self.rotary_inertia),
        )
        if self.modes is not None:
            store(self, modes=_one_or_each("ModelChoice.modes", self.modes, _modes, 6 * MOST_ELEMENTS))


def _one_or_each(name: str, value: object, check: Callable[..., Any], *limits: int) -> Any:
    """Check one value for all links, or a list with one for each link."""
    if not isinstance(value, list | tuple | np.ndarray):
        return check(name, value, *limits)
    entries = sequence(name, value)
    if not entries:
        raise refusal(name, value, "one value, or one for each link")
    return tuple(check(f"{name}[{i}]", entry, *limits) for i, entry in enumerate(entries))


def _modes(name: str, value: object, most: int) -> int | tuple[int, ...]:
    """Check how many modes of a link are kept, or which."""
    if not isinstance(value, list | tuple | np.ndarray):
        return whole_number(name, value, 0, most)
    numbers = tuple(whole_number(f"{name}[{i}]", entry, 0, most - 1) for i, entry in enumerate(sequence(name, value)))
    if not numbers or list(numbers) != sorted({*numbers}):
        raise refusal(name, value, "a number of modes, or mode numbers that ascend, at least one")
    return numbers
