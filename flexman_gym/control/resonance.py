"""Resonance: how an arm rings over its postures and payloads, and what each shaper leaves of that."""

from collections.abc import Sequence
from dataclasses import replace
from functools import reduce
from typing import NamedTuple

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.control.modes import ringing_modes
from flexman_gym.control.shaper import SHAPERS, Shaper, both, design, residual
from flexman_gym.model.model import Model
from flexman_gym.simulation.parameters import varied_constants

LEFT = 5.0  # % of a mode, up to which a shaper bears an error of frequency
SLACK = 1.02  # of that: EI shapers leave just so much by design, and with damping a little more beside it
BOUND = 10.0  # % of the tip's vibration, that a recommended shaper leaves at worst
LOOKED_AT = 3  # lowest modes
FURTHEST, FINEST = 0.9, 0.0005  # part of a frequency, of the errors that are tried


class Case(NamedTuple):
    """A posture (n,) rad and a payload (kg), with the modes (k, 3) of held and of free motors, see `ringing_modes`."""

    posture: Array
    payload: float
    held: Array
    free: Array


class Answer(NamedTuple):
    """A shaper for the lowest mode or the lowest two of a case, and what it leaves of all cases.

    Attributes:
        name: of the shaper.
        modes: how many of the lowest it is designed for.
        delay: s, from its first impulse to its last.
        borne: errors (low, high) of all frequencies, as parts of them, up to which it leaves at most LEFT of each mode.
        left: (cases, k) % of each mode.
        tip: (cases,) % of the tip's vibration after a step of the motors, modes added up as if they met in phase.
    """

    name: str
    modes: int
    delay: float
    borne: tuple[float, float]
    left: Array
    tip: Array


def find_cases(model: Model, postures: Array, payloads: Sequence[float]) -> list[Case]:
    """Finds the lowest modes for each of the postures (p, n) rad with each of the payloads (kg)."""
    result = []
    for payload in payloads:
        loaded = with_payload(model, payload)
        for posture in postures:
            modes = (ringing_modes(loaded, posture, held)[:LOOKED_AT] for held in (True, False))
            result.append(Case(posture, float(payload), *modes))
    return result


def with_payload(model: Model, mass: float) -> Model:
    """Gives a model with the same coordinates and a payload of another mass (kg), its inertia in proportion."""
    rows = varied_constants(model, 1, {"payload_mass": [mass]})
    return replace(model, constants=model.constants._replace(**{name: values[0] for name, values in rows.items()}))


def middle_case(cases: Sequence[Case]) -> Case:
    """Gives the case whose lowest frequency with held motors is in the middle of all."""
    return sorted(cases, key=lambda case: float(case.held[0, 0]))[len(cases) // 2]


def find_answers(cases: Sequence[Case]) -> list[Answer]:
    """Finds what each shaper, for one mode and for two, leaves of all cases, where it is designed for the middle one.

    Args:
        cases: all with at least one mode of held motors.
    """
    middle = middle_case(cases).held
    counts = [count for count in (1, 2) if count <= len(middle)]
    return [_answer(name, middle[:count], cases) for count in counts for name in SHAPERS]


def recommended(answers: Sequence[Answer]) -> Answer | None:
    """Gives the answer of the least delay that leaves at most BOUND of the tip's vibration in every case, or None."""
    good = [answer for answer in answers if answer.tip.max() <= BOUND]
    return min(good, key=lambda answer: answer.delay, default=None)


def _answer(name: str, modes: Array, cases: Sequence[Case]) -> Answer:
    shaper = reduce(both, [design(name, frequency, ratio) for frequency, ratio, _ in modes.tolist()])
    most = min(len(case.held) for case in cases)
    left, tips = [], []
    for case in cases:
        each = np.array([float(residual(shaper, frequency, ratio)) for frequency, ratio, _ in case.held.tolist()])
        left.append(each[:most])
        tips.append(float(each @ case.held[:, 2] / case.held[:, 2].sum()))
    delay = float(shaper.times[-1])
    return Answer(name, len(modes), delay, borne_errors(shaper, modes), np.array(left), np.array(tips))


def borne_errors(shaper: Shaper, modes: Array) -> tuple[float, float]:
    """Gives how much lower and higher all of the modes (k, 3) may be together, as parts, see `Answer.borne`."""
    steps = np.arange(0.0, FURTHEST, FINEST)
    result = []
    for sign in (-1.0, 1.0):
        left = [residual(shaper, frequency * (1.0 + sign * steps), ratio) for frequency, ratio, _ in modes.tolist()]
        over = np.append((np.array(left) > SLACK * LEFT).any(axis=0), True)
        result.append(sign * FINEST * max(int(np.argmax(over)) - 1, 0))
    return result[0], result[1]
