"""Tensors: arrays go into a file and come back, and a file that says something else is refused in one line."""

import json

import numpy as np
import pytest

from flexman_gym.common.safetensors import MAX_BYTES, read_tensors, write_tensors

from oracles.assertions import refusal

ARRAYS = {
    "a.weight": np.arange(6, dtype=np.float32).reshape(2, 3) / 7.0,
    "b": np.array([np.pi, -0.0, 5e-324]),
    "nothing": np.zeros((0, 4)),
}


def packed(header, numbers=b""):
    """A file of a header, as text or as a mapping, and bytes after it."""
    text = (header if isinstance(header, str) else json.dumps(header)).encode()
    return len(text).to_bytes(8, "little") + text + numbers


def entry(first, last, shape, dtype="F32"):
    """What a header says of an array."""
    return {"dtype": dtype, "shape": shape, "data_offsets": [first, last]}


def test_arrays_come_back_to_the_bit(tmp_path):
    write_tensors(tmp_path / "a", ARRAYS)
    content = (tmp_path / "a").read_bytes()
    result = read_tensors(content)
    assert result.keys() == ARRAYS.keys()
    for name, array in ARRAYS.items():
        assert result[name].dtype == array.dtype and result[name].shape == array.shape
        assert result[name].tobytes() == array.tobytes()
    start = 8 + int.from_bytes(content[:8], "little")
    assert start % 8 == 0 and len(content) - start == 6 * 4 + 3 * 8


def test_the_file_is_the_one_that_the_format_describes():
    """By hand, from the description of safetensors: a length of 8 bytes, JSON that may end in spaces, and numbers."""
    numbers = np.array([1.5, -2.0], dtype="<f4").tobytes()
    content = packed('{"x":{"dtype":"F32","shape":[2],"data_offsets":[0,8]}}  ', numbers)
    assert read_tensors(content)["x"].tolist() == [1.5, -2.0]


def test_others_read_it(tmp_path):
    safetensors = pytest.importorskip("safetensors.numpy")
    write_tensors(tmp_path / "a", ARRAYS)
    result = safetensors.load_file(tmp_path / "a")
    assert all(np.array_equal(result[name], array) for name, array in ARRAYS.items())


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "file: '0 bytes'"),
        (bytes(MAX_BYTES + 1), f"file: '{MAX_BYTES + 1} bytes'"),
        ((100).to_bytes(8, "little") + b"{}", "header: '100 bytes'"),
        (packed("[]"), "header: 'list'"),
        (packed({"x": entry(0, 4, [1])}), "x.data_offsets"),
        (packed({"x": entry(0, 4, [2])}, bytes(4)), "x.data_offsets"),
        (packed({"x": entry(4, 0, [1])}, bytes(4)), "x.data_offsets"),
        (packed({"x": entry(0, 4, [1])}, bytes(8)), "data_offsets"),
        (packed({"x": entry(4, 8, [1])}, bytes(8)), "data_offsets"),
        (packed({"x": entry(0, 8, [2]), "y": entry(4, 8, [1])}, bytes(8)), "data_offsets"),
        (packed({"x": entry(0, 8, [1], "I64")}, bytes(8)), "x.dtype"),
        (packed({"x": entry(0, 4, [True])}, bytes(4)), "x.shape"),
        (packed({"x": entry(0, 4, [-1, -1])}, bytes(4)), "x.shape"),
        (packed({"x": entry(0, 4, [10**30])}, bytes(4)), "x.shape"),
        (packed({"x": entry(0.0, 4, [1])}, bytes(4)), "x.data_offsets"),
        (packed({"x": {**entry(0, 4, [1]), "code": "1"}}, bytes(4)), "x: "),
        (packed('{"x": 1, "x": 2}'), "a key stands there twice"),
        (packed('{"x": NaN}'), "NaN is no number of JSON"),
        (packed("[" * 100_000), "too deep"),
    ],
)  # fmt: skip
def test_a_file_that_says_something_else_is_refused(content, said):
    assert said in refusal(read_tensors, content)


def test_arrays_of_other_numbers_are_not_written(tmp_path):
    for wrong in (np.zeros(2, dtype=int), np.array(["a"]), np.zeros(2, dtype=np.float16)):
        assert refusal(write_tensors, tmp_path / "a", {"x": wrong}).startswith("x: ")
    assert not (tmp_path / "a").exists()
