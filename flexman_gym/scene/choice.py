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

    Within 2 s, spinning rotors move the tip of the paper's arm by 103 mm with everything flexible and by 78 mm with
    rigid joints. Rotary inertia moves it by 7.2 mm with everything rigid and by 6.9 mm with everything flexible.

    Attributes:
        flexible_links: whether links bend; a rigid link has no elastic coordinate.
        elements: finite elements of a Link, or of each section of a NonUniformLink, 1 to 64; a link as a whole has at
            most 64. A link has 6 * elements * number of sections coordinates. None leaves them to `choose_model`.
        modes: modes kept of a link; None keeps every coordinate. A number keeps so many of the lowest frequencies, 0 to
            the number of coordinates (at most 384). In a tuple for all links, a tuple gives the ascending numbers of
            the modes, the lowest being 0: (4, (0, 1, 3), 0) keeps four modes of the first link, modes 0, 1 and 3 of the
            second and none of the third.
        flexible_joints: False makes every joint rigid, whatever its stiffness.
        stiffening: foreshortening (geometric stiffening) of the links.
        spinning_rotors: a rotor spins as a body in the frame that carries its joint; only its inertia about the axis
            counts. False neglects the rotation of that frame, as the paper does (Eq. 23).
        rotary_inertia: the sections of a link resist rotation about their transverse axes (Rayleigh's term). False is
            the classic Euler-Bernoulli beam: in rigid and in elastic motion its sections resist rotation about the beam
            axis only.

    Raises:
        ValueError: for another type or a number outside its range.
    """

    flexible_links: bool | tuple[bool, ...]
    elements: int | tuple[int, ...] | None
    modes: int | tuple[int | tuple[int, ...], ...] | None = None
    flexible_joints: bool = True
    stiffening: bool = False
    spinning_rotors: bool = False
    rotary_inertia: bool = True

    def __post_init__(self) -> None:
        store(
            self,
            flexible_links=_one_or_each("ModelChoice.flexible_links", self.flexible_links, flag),
            flexible_joints=flag("ModelChoice.flexible_joints", self.flexible_joints),
            stiffening=flag("ModelChoice.stiffening", self.stiffening),
            spinning_rotors=flag("ModelChoice.spinning_rotors", self.spinning_rotors),
            rotary_inertia=flag("ModelChoice.rotary_inertia", self.rotary_inertia),
        )
        if self.elements is not None:
            elements = _one_or_each("ModelChoice.elements", self.elements, whole_number, 1, MOST_ELEMENTS)
            store(self, elements=elements)
        if self.modes is not None:
            store(self, modes=_one_or_each("ModelChoice.modes", self.modes, _modes, 6 * MOST_ELEMENTS))


def _one_or_each(name: str, value: object, check: Callable[..., Any], *limits: int) -> Any:
    """Checks one value for all links, or a list with one for each link."""
    if not isinstance(value, list | tuple | np.ndarray):
        return check(name, value, *limits)
    entries = sequence(name, value)
    if not entries:
        raise refusal(name, value, "one value, or one for each link")
    return tuple(check(f"{name}[{i}]", entry, *limits) for i, entry in enumerate(entries))


def _modes(name: str, value: object, most: int) -> int | tuple[int, ...]:
    """Checks a number of modes, or their numbers."""
    if not isinstance(value, list | tuple | np.ndarray):
        return whole_number(name, value, 0, most)
    numbers = tuple(whole_number(f"{name}[{i}]", entry, 0, most - 1) for i, entry in enumerate(sequence(name, value)))
    if not numbers or list(numbers) != sorted({*numbers}):
        raise refusal(name, value, "a number of modes, or mode numbers that ascend, at least one")
    return numbers
