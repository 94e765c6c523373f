"""Piecewise: a run under a drive of several pieces, by calls of which none goes over the end of a piece."""

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.checks import WHOLE
from flexman_gym.kernels import layout
from flexman_gym.scene.drive import Pieces
from flexman_gym.simulation.run import Run


class Call(NamedTuple):
    """A part of a run that lies in one piece of the drive.

    Attributes:
        piece: its number.
        row: outputs that have passed before it.
        rows: whole intervals between outputs that it lasts; 0 where it is shorter than one.
        moment: start (s), step (s) and steps in an interval, or in all of it where it is shorter.
        complete: whether an output follows it.
    """

    piece: int
    row: int
    rows: int
    moment: tuple[float, float, int]
    complete: bool


def calls(pieces: Pieces, interval: float, substeps: int, rows: range) -> Iterator[Call]:
    """Divides a run through rows, an interval (s) of so many steps apart, by the pieces of its drive.

    Steps between an output and the end of a piece, or two ends of pieces, are equal, and no longer than the others.
    """
    ends = pieces.moments / interval  # in intervals; those at an output are whole numbers
    whole = np.round(ends)
    ends = np.where(np.abs(ends - whole) <= WHOLE * np.maximum(whole, 1.0), whole, ends)
    for piece, (start, end) in enumerate(pairwise(np.minimum(ends, rows.stop).tolist())):
        now = max(start, float(rows.start))
        while now < end:
            row = math.floor(now)
            many = math.floor(end) - row if now == row else 0
            then = row + many if many else min(end, row + 1.0)
            if many:
                moment = row * interval, interval / substeps, substeps
            else:
                steps = max(1, math.ceil(substeps * (then - now) * (1.0 - WHOLE)))
                moment = now * interval, (then - now) * interval / steps, steps
            yield Call(piece, row, many, moment, then == math.floor(then))
            now = then


def run_pieces(
    run: Run, pieces: Pieces, plan: tuple[float, int], state: Array, rows: Array, outputs: Array, first: int = 0
) -> tuple[int, int, int, tuple[Array, tuple[float, float, int], Array]]:
    """Moves a state and its ledger (2 d + 2,), and fills rows (r, 2 d + 2) and outputs (r, OUTPUTS).

    Args:
        run: what moves it.
        pieces: of the drive.
        plan: time between rows (s), and steps in it.
        state: overwritten as by a `Run`.
        rows: overwritten as by a `Run`.
        outputs: overwritten as by a `Run`.
        first: number of the first of the rows, since the drive began.

    Returns:
        The status, the number of valid rows, that of evaluations, and how the last call began: table, moment and state.
    """
    row, result = np.zeros((1, len(state))), np.zeros((1, layout.OUTPUTS))
    status, valid, evaluations, began = layout.OK, 0, 0, (pieces.table(), (0.0, *plan), state.copy())
    for call in calls(pieces, *plan, range(first, first + len(rows))):
        began, at = (pieces.table(call.piece), call.moment, state.copy()), call.row - first
        some = slice(at, at + call.rows)
        here, there = (rows[some], outputs[some]) if call.rows else (row, result)
        status, good, more = run(began[0], call.moment, state, here, there)
        evaluations += more
        valid = at + good if call.rows or call.complete else valid
        if call.complete and not call.rows and status == layout.OK:
            rows[at], outputs[at] = row[0], result[0]
        if status != layout.OK:
            break
    return status, valid, evaluations, began
