"""Scales: mean and variance of all that was added, in parts, merged, and kept in a file."""

import numpy as np
import pytest

from flexman_gym.agent.network import VARIANCE_OFFSET
from flexman_gym.agent.normalisation import RunningMeanStd

VALUES = np.random.default_rng(0).normal(3.0, [0.1, 2.0, 50.0], (1000, 3))


def scales_of(*parts):
    """Scales that were given parts one after the other."""
    result = RunningMeanStd((3,))
    for part in parts:
        result.add(part)
    return result


def close(one, other):
    """Whether two have the same count, mean and deviation, but for rounding."""
    return (one.count == other.count and one.mean == pytest.approx(other.mean, rel=1e-12)
            and one.deviation == pytest.approx(other.deviation, rel=1e-12))  # fmt: skip


def test_they_are_mean_and_deviation_of_everything():
    whole = scales_of(VALUES)
    assert whole.count == 1000 and whole.mean == pytest.approx(VALUES.mean(axis=0), rel=1e-13)
    assert whole.deviation**2 - VARIANCE_OFFSET == pytest.approx(VALUES.var(axis=0), rel=1e-9)
    assert close(scales_of(VALUES[:1], VALUES[1:10], VALUES[10:10], VALUES[10:]), whole)
    assert close(scales_of(VALUES.reshape(10, 100, 3)), whole)


def test_what_workers_have_seen_is_merged_in_any_order():
    parts = [scales_of(part) for part in np.split(VALUES, [100, 400])]
    for order in ((0, 1, 2), (2, 0, 1)):
        merged = RunningMeanStd((3,))
        for number in order:
            merged.merge(parts[number])
        merged.merge(RunningMeanStd((3,)))
        assert close(merged, scales_of(VALUES))


def test_what_they_scale_has_mean_0_and_deviation_1_and_is_clipped():
    scaled = scales_of(VALUES).apply(VALUES)
    assert scaled.dtype == np.float32
    assert scaled.mean(axis=0) == pytest.approx(np.zeros(3), abs=1e-5)
    assert scaled.std(axis=0) == pytest.approx(np.ones(3), abs=1e-5)
    assert scales_of(VALUES).apply(np.full((1, 3), 1e6), 5.0).tolist() == [[5.0, 5.0, 5.0]]
    assert np.array_equal(RunningMeanStd((3,)).apply(VALUES, 1e3), VALUES.astype(np.float32)), "nothing was added yet"


@pytest.mark.parametrize("shape", [(), (3,)])
def test_a_file_and_a_state_give_the_same_to_the_bit(tmp_path, shape):
    scales = RunningMeanStd(shape)
    scales.add(VALUES)
    scales.save(tmp_path / "scales.npz")
    again, other = RunningMeanStd.load(tmp_path / "scales.npz"), RunningMeanStd(shape)
    other.set_state(scales.get_state())
    for one in (again, other):
        one.add(VALUES[:3])
    scales.add(VALUES[:3])
    for one in (again, other):
        assert one.count == scales.count and one.deviation.tobytes() == scales.deviation.tobytes()
        assert one.mean.tobytes() == scales.mean.tobytes() and one.mean.shape == shape


def test_what_is_no_state_is_refused_in_one_line(tmp_path):
    scales = RunningMeanStd((3,))
    for bad in (None, {}, RunningMeanStd((2,)).get_state(), scales.get_state() | {"count": "many"}):
        with pytest.raises(ValueError) as error:
            scales.set_state(bad)
        assert str(error.value).startswith("scales") and "\n" not in str(error.value)
    (tmp_path / "bad.npz").write_bytes(b"scales")
    with pytest.raises(ValueError, match=r"bad\.npz: this is not a file of RunningMeanStd\.save \("):
        RunningMeanStd.load(tmp_path / "bad.npz")
    with pytest.raises(FileNotFoundError):
        RunningMeanStd.load(tmp_path / "none.npz")
