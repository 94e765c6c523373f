"""Calls: how much one call of a kernel does, as Python looks for Ctrl-C only between two of them."""

from collections.abc import Iterator

import numpy as np

from flexman_gym.kernels.layout import Constants

WORK = 1e8  # of one call, in entries of matrices to the power of 3 / 2: a tenth of a second at most
ABREAST = 4  # times as long takes an evaluation of ARMS_ABREAST arms, at most, as one of one arm


def evaluations_of_a_call(constants: Constants) -> int:
    """Gives after how many evaluations of a model's accelerations a call ends or pauses.

    An evaluation costs about as much as the matrices of its links have entries, to the power of 3 / 2.
    """
    sides = np.diff(constants.elastic_start) + 6.0
    return max(1, int(WORK / (sides**3).sum()))


def pieces(count: int, most: int) -> Iterator[tuple[int, int]]:
    """Gives the first and the number of each piece, of at most `most`, of a count."""
    for first in range(0, count, most):
        yield first, min(most, count - first)


def row_pieces(rows: int, substeps: int, most: int) -> Iterator[tuple[int, int, int, int]]:
    """Gives the pieces of a run of `rows` of `substeps` steps each, of at most `most` steps.

    Each is the row from which it starts, how many rows it fills, the steps of each, and how many steps come before it.
    A row of more steps is filled several times, at last with its end.
    """
    for row, many in pieces(rows, max(1, most // substeps)):
        for first, steps in pieces(substeps, most):
            yield row, many, steps, row * substeps + first
