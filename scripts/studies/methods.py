"""Integration methods of the studies, and line colours and markers."""

from collections.abc import Iterable
from typing import Protocol

import numpy as np

from flexman_gym.common.plot_style import LINK_COLOURS
from flexman_gym.simulation.methods import EXPLICIT, METHODS, Method
from flexman_gym.simulation.stability import amplification_factors, spectral_radii


class _MethodRow(Protocol):
    """Row of a study with a method name."""

    @property
    def method(self) -> str:
        """Name from `METHODS`, or of a method of another simulator."""


def fixed_step_methods() -> list[str]:
    """Return the fixed-step methods, which excludes the adaptive reference methods."""
    return [name for name, method in METHODS.items() if not method.adaptive]


def explicit_methods() -> list[str]:
    """Return the explicit fixed-step methods, whose step is limited by the highest natural frequency."""
    return [name for name in fixed_step_methods() if METHODS[name].kind == EXPLICIT]


def implicit_methods() -> list[str]:
    """Return the implicit and linearly implicit fixed-step methods."""
    return [name for name in fixed_step_methods() if METHODS[name].kind != EXPLICIT]


def methods_of(rows: Iterable[_MethodRow]) -> list[str]:
    """Return the methods that occur in the rows, in the order of `METHODS`."""
    known = {row.method for row in rows}
    return [name for name in METHODS if name in known]


def extrapolations_of(rows: Iterable[_MethodRow]) -> list[str]:
    """Return the extrapolation methods that occur in the rows."""
    return [name for name in methods_of(rows) if len(getattr(METHODS[name], "sequence", ())) > 1]


def vibration_factor(method: Method, angle: float) -> complex:
    """Return the amplification factor closest to the exact one, exp(i omega h)."""
    factors = amplification_factors(method, angle)
    factors = np.concatenate([factors, factors.conj()])
    return complex(factors[np.abs(factors - np.exp(1j * angle)).argmin()])


def largest_growth(method: Method) -> tuple[float, float]:
    """Return the largest amplification of an undamped vibration per step, and its omega h (rad)."""
    angles = np.geomspace(1e-3, 1e3, 1501)
    factors = spectral_radii(method, angles)
    return float(factors.max()), float(angles[factors.argmax()])


STYLES = tuple(zip(LINK_COLOURS, "os^DvP", strict=True))  # colour and marker of the lines of a chart


def line_styles(names: Iterable[str]) -> dict[str, dict[str, str]]:
    """Return the colour and the marker of each of at most six lines, as keywords of Matplotlib's `plot`."""
    return {name: {"color": colour, "marker": marker} for name, (colour, marker) in zip(names, STYLES, strict=False)}
