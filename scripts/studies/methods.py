"""Methods that a study compares, with their colours and markers."""

from collections.abc import Iterable
from typing import NamedTuple, Protocol

import numpy as np

from flexman_gym.draw.style import BLUE, GREEN, ORANGE, RED, SKY
from flexman_gym.simulation.methods import EXPLICIT, METHODS, Method
from flexman_gym.simulation.stability import amplification_factors, spectral_radii


class _MethodRow(Protocol):
    """A row of a study that knows its method."""

    @property
    def method(self) -> str:
        """A name from `METHODS`, or that of another code."""


def fixed_step_methods() -> list[str]:
    """Those that take steps of a given length: all but the reference methods, by which a study judges the others."""
    return [name for name, method in METHODS.items() if not method.adaptive]


def explicit_methods() -> list[str]:
    """Those of them whose step the highest natural frequency limits."""
    return [name for name in fixed_step_methods() if METHODS[name].kind == EXPLICIT]


def implicit_methods() -> list[str]:
    """Those of them that are not explicit: implicit and linearly implicit ones."""
    return [name for name in fixed_step_methods() if METHODS[name].kind != EXPLICIT]


def methods_of(rows: Iterable[_MethodRow]) -> list[str]:
    """Those that these rows are about."""
    known = {row.method for row in rows}
    return [name for name in METHODS if name in known]


def extrapolations_of(rows: Iterable[_MethodRow]) -> list[str]:
    """Those of them that extrapolate another method."""
    return [name for name in methods_of(rows) if len(getattr(METHODS[name], "sequence", ())) > 1]


def vibration_factor(method: Method, angle: float) -> complex:
    """Return the factor of the vibration itself: the factor closest to the exact one, exp(i omega h)."""
    factors = amplification_factors(method, angle)
    factors = np.concatenate([factors, factors.conj()])
    return complex(factors[np.abs(factors - np.exp(1j * angle)).argmin()])


def largest_growth(method: Method) -> tuple[float, float]:
    """Return the largest factor by which a step multiplies an undamped vibration, and its omega h (rad)."""
    angles = np.geomspace(1e-3, 1e3, 1501)
    factors = spectral_radii(method, angles)
    return float(factors.max()), float(angles[factors.argmax()])


TEAL, PINE, PURPLE, PINK, PLUM, BLACK = "#66C2A5", "#004D3A", "#CC79A7", "#EBBAD6", "#6E1F55", "#000000"
COLOURS = (ORANGE, BLUE, SKY, RED, TEAL, GREEN, PINE, PURPLE, PINK, PLUM, BLACK)
MARKERS = "voDs^<>PX*p"  # as many as colours; those who cannot tell the colours apart have them


class _Look(NamedTuple):
    """Colour and marker of a line."""

    colour: str
    marker: str


def looks() -> dict[str, _Look]:
    """The look of each method, those of fixed steps first.

    When the colours are used up they start again with the markers shifted by one, so that no two methods share both.
    """
    names = sorted(METHODS, key=lambda name: METHODS[name].adaptive)
    return {name: _look(*divmod(i, len(COLOURS))) for i, name in enumerate(names)}


def _look(turn: int, place: int) -> _Look:
    return _Look(COLOURS[place], MARKERS[(place + turn) % len(MARKERS)])
