"""Looks: the colours and markers by which charts tell methods apart."""

from typing import NamedTuple

from flexman_gym.draw.style import BLUE, GREEN, ORANGE, RED, SKY
from flexman_gym.simulation.methods import METHODS

TEAL, PINE, PURPLE, PINK, PLUM, BLACK = "#66C2A5", "#004D3A", "#CC79A7", "#EBBAD6", "#6E1F55", "#000000"
COLOURS = (ORANGE, BLUE, SKY, RED, TEAL, GREEN, PINE, PURPLE, PINK, PLUM, BLACK)
MARKERS = "voDs^<>PX*p"  # as many as colours; those who cannot tell the colours apart have them


class Look(NamedTuple):
    """Colour and marker of a line."""

    colour: str
    marker: str


def looks() -> dict[str, Look]:
    """The look of each method, those of fixed steps first.

    When the colours are used up they start again with the markers shifted by one, so that no two methods share both.
    """
    names = sorted(METHODS, key=lambda name: METHODS[name].adaptive)
    return {name: _look(*divmod(i, len(COLOURS))) for i, name in enumerate(names)}


def _look(turn: int, place: int) -> Look:
    return Look(COLOURS[place], MARKERS[(place + turn) % len(MARKERS)])
