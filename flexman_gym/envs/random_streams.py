"""Random streams: one generator for each purpose and arm, and truncated normal noise drawn in blocks."""

from collections.abc import Sequence
from typing import Any
from zlib import crc32

import numpy as np

from flexman_gym.common.arrays import Array, IntArray

BLOCK_SIZE = 32  # samples whose noise is drawn at once
TRUNCATION = 4.0  # standard deviations; noise beyond it is drawn again


class RandomStreams:
    """A generator for each name and each of b arms, seeded by the name and the seed of the arm's own generator.

    Nothing is drawn from the arm's own generator, so that a purpose more changes neither the others nor the episode.
    """

    state_fields = ("_streams",)

    def __init__(self, names: Sequence[str], arms: int) -> None:
        self._parents: list[np.random.Generator | None] = [None] * arms
        self._streams: dict[str, list[Any]] = {name: [None] * arms for name in names}

    def of(self, arm: int, random: np.random.Generator) -> dict[str, np.random.Generator]:
        """The generators of an arm by name; they are made anew for another `random` than the last time."""
        if self._parents[arm] is not random:
            self._parents[arm] = random
            for name, streams in self._streams.items():
                streams[arm] = _stream(random, name)
        return {name: streams[arm] for name, streams in self._streams.items()}

    def follow(self, randoms: Sequence[np.random.Generator | None]) -> None:
        """Takes the generators of all arms as those whose streams are in use, after these were given back."""
        self._parents = list(randoms)


class TruncatedNoise:
    """Standard normal numbers, (size,) a sample, for each of b arms; a number beyond TRUNCATION is drawn again."""

    state_fields = ("_inner", "_block", "_used")

    def __init__(self, arms: int, size: int) -> None:
        self._inner: list[Any] = [None] * arms
        self._block, self._used = np.zeros((arms, BLOCK_SIZE, size)), np.zeros(arms, dtype=np.int64)

    def begin(self, arm: int, stream: np.random.Generator) -> None:
        """Starts the noise of an episode by one draw of a stream."""
        self._inner[arm], self._used[arm] = np.random.default_rng(stream.integers(2**63)), BLOCK_SIZE

    def sample(self, arms: IntArray) -> Array:
        """The next numbers (r, size) of the arms (r,)."""
        for arm in arms[self._used[arms] == BLOCK_SIZE].tolist():
            self._block[arm], self._used[arm] = _normal(self._inner[arm], self._block.shape[1:]), 0
        result = self._block[arms, self._used[arms]]
        self._used[arms] += 1
        return result


def _normal(random: np.random.Generator, shape: tuple[int, ...]) -> Array:
    """Standard normal numbers within the truncation, by rejection."""
    values = random.standard_normal(shape)
    while (beyond := np.abs(values) > TRUNCATION).any():
        values[beyond] = random.standard_normal(np.count_nonzero(beyond))
    return values


def _stream(parent: np.random.Generator, name: str) -> np.random.Generator:
    """A generator made from the seed of another and a name."""
    seed: Any = parent.bit_generator.seed_seq
    key = (*seed.spawn_key, crc32(name.encode()))
    return np.random.default_rng(np.random.SeedSequence(seed.entropy, spawn_key=key))
