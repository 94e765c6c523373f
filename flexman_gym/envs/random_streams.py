"""Random streams: separate generators for each effect and sensor of each arm, and truncated normal noise."""

from collections.abc import Sequence
from typing import Any
from zlib import crc32

import numpy as np

from flexman_gym.common.arrays import Array, IntArray

BLOCK_SIZE = 32  # samples of noise drawn at once
TRUNCATION = 4.0  # standard deviations; largest magnitude of the noise


class RandomStreams:
    """Random generators, one per arm and name of an effect or sensor, seeded by this name and the seed of the arm.

    Nothing is drawn from the generator of the arm, which draws start and goal of an episode. Adding a name therefore
    changes neither the other streams nor start and goal.
    """

    state_fields = ("_streams",)

    def __init__(self, names: Sequence[str], arms: int) -> None:
        self._parents: list[np.random.Generator | None] = [None] * arms
        self._streams: dict[str, list[Any]] = {name: [None] * arms for name in names}

    def generators(self, arm: int, random: np.random.Generator) -> dict[str, np.random.Generator]:
        """Return the generators of an arm by name; they are made again if the arm's own generator is a new object."""
        if self._parents[arm] is not random:
            self._parents[arm] = random
            for name, streams in self._streams.items():
                streams[arm] = _stream(random, name)
        return {name: streams[arm] for name, streams in self._streams.items()}

    def set_generators(self, randoms: Sequence[np.random.Generator | None]) -> None:
        """Set the generators of the arms after a restored state, so that the restored streams are not made again."""
        self._parents = list(randoms)


class TruncatedNoise:
    """Standard normal numbers (size,) per sample for each of b arms, truncated at TRUNCATION by rejection."""

    state_fields = ("_inner", "_block", "_used")

    def __init__(self, arms: int, size: int) -> None:
        self._inner: list[Any] = [None] * arms
        self._block, self._used = np.zeros((arms, BLOCK_SIZE, size)), np.zeros(arms, dtype=np.int64)

    def begin(self, arm: int, stream: np.random.Generator) -> None:
        """Seed the noise of an episode of an arm by one draw from a stream."""
        self._inner[arm], self._used[arm] = np.random.default_rng(stream.integers(2**63)), BLOCK_SIZE

    def sample(self, arms: IntArray) -> Array:
        """Return the next numbers (r, size) of the arms (r,)."""
        for arm in arms[self._used[arms] == BLOCK_SIZE].tolist():
            self._block[arm], self._used[arm] = _normal(self._inner[arm], self._block.shape[1:]), 0
        result = self._block[arms, self._used[arms]]
        self._used[arms] += 1
        return result

    @staticmethod
    def uniform(normal: Array) -> Array:
        """Map standard normal numbers to uniform numbers in [0, 1] by the normal distribution function."""
        from scipy.special import ndtr

        result: Array = ndtr(normal)
        return result


def _normal(random: np.random.Generator, shape: tuple[int, ...]) -> Array:
    """Return standard normal numbers of magnitude up to TRUNCATION, by rejection."""
    values = random.standard_normal(shape)
    while (rejected := np.abs(values) > TRUNCATION).any():
        values[rejected] = random.standard_normal(np.count_nonzero(rejected))
    return values


def _stream(parent: np.random.Generator, name: str) -> np.random.Generator:
    """Return a generator seeded by the seed of a parent generator and a name."""
    seed: Any = parent.bit_generator.seed_seq
    key = (*seed.spawn_key, crc32(name.encode()))
    return np.random.default_rng(np.random.SeedSequence(seed.entropy, spawn_key=key))
