"""Arrays and JSON of a policy: arrays survive the file to the bit, and a damaged file is refused in one line."""

import json

import numpy as np
import pytest

from flexman_gym.evaluation import policy_files
from flexman_gym.evaluation.policy_files import MAX_BYTES, _parse_json, _read_tensors, _write_tensors

from oracles.assertions import refusal

ARRAYS = {
    "a.weight": np.arange(6, dtype=np.float32).reshape(2, 3) / 7.0,
    "b": np.array([np.pi, -0.0, 5e-324]),
    "nothing": np.zeros((0, 4)),
    "transposed": np.arange(6.0).reshape(2, 3).T,
    "strided": np.arange(6.0)[::2],
}


def packed(header, numbers=b""):
    """A file of a header, as text or as a mapping, and bytes after it."""
    text = (header if isinstance(header, str) else json.dumps(header)).encode()
    return len(text).to_bytes(8, "little") + text + numbers


def entry(first, last, shape, dtype="F32"):
    """What a header says of an array."""
    return {"dtype": dtype, "shape": shape, "data_offsets": [first, last]}


def test_arrays_come_back_to_the_bit(tmp_path):
    _write_tensors(tmp_path / "a", ARRAYS)
    content = (tmp_path / "a").read_bytes()
    result = _read_tensors(content)
    assert result.keys() == ARRAYS.keys()
    for name, array in ARRAYS.items():
        assert result[name].dtype == array.dtype and result[name].shape == array.shape
        assert result[name].tobytes() == array.tobytes()
    start = 8 + int.from_bytes(content[:8], "little")
    assert start % 8 == 0 and len(content) - start == 6 * 4 + 12 * 8


def test_the_file_is_the_one_that_the_format_describes():
    """By hand, from the description of safetensors: a length of 8 bytes, JSON that may end in spaces, and numbers."""
    numbers = np.array([1.5, -2.0], dtype="<f4").tobytes()
    content = packed('{"x":{"dtype":"F32","shape":[2],"data_offsets":[0,8]}}  ', numbers)
    assert _read_tensors(content)["x"].tolist() == [1.5, -2.0]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "header too small"),
        (bytes(MAX_BYTES + 1), f"file: '{MAX_BYTES + 1} bytes'"),
        ((100).to_bytes(8, "little") + b"{}", "invalid header length"),
        ((2**62).to_bytes(8, "little") + b"{}", "header too large"),
        (packed("[]"), "invalid JSON in header"),
        (packed({"x": entry(0, 4, [1])}), "not fully covered"),
        (packed({"x": entry(0, 4, [2])}, bytes(4)), "invalid shape, data type, or offset"),
        (packed({"x": entry(4, 0, [1])}, bytes(4)), "invalid offset for tensor `x`"),
        (packed({"x": entry(0, 4, [1])}, bytes(8)), "not fully covered"),
        (packed({"x": entry(4, 8, [1])}, bytes(8)), "invalid offset for tensor `x`"),
        (packed({"x": entry(0, 8, [2]), "y": entry(4, 8, [1])}, bytes(8)), "invalid offset for tensor `y`"),
        (packed({"x": entry(0, 8, [1], "I64")}, bytes(8)), "x.dtype: 'int64'"),
        (packed({"x": entry(0, 2, [1], "F16")}, bytes(2)), "x.dtype: 'float16'"),
        (packed({"x": entry(0, 2, [1], "BF16")}, bytes(2)), "dtype: 'BF16'"),
        (packed({"x": entry(0, 4, [True])}, bytes(4)), "invalid type: boolean"),
        (packed({"x": entry(0, 4, [-1, -1])}, bytes(4)), "invalid value: integer"),
        (packed({"x": entry(0, 4, [10**30])}, bytes(4)), "invalid type: floating point"),
        (packed({"x": entry(0, 0, [0, 2**62, 2**62])}), "array is too big"),
        (packed({"x": entry(0, 4, [1] * 100)}, bytes(4)), "maximum supported dimension"),
        (packed({"x": entry(0.0, 4, [1])}, bytes(4)), "invalid type: floating point"),
        (packed({"a\nb\x07": entry(4, 8, [1])}, bytes(8)), "invalid offset for tensor"),
        (packed('{"x": 1, "x": 2}'), "invalid type: integer"),
        (packed('{"x": NaN}'), "expected value"),
        (packed("[" * 100_000), "invalid JSON in header"),
        (b"\x04" + bytes(7) + b"\xff\xfe{}", "invalid UTF-8 in header"),
    ],
)
def test_a_file_that_says_something_else_is_refused(content, said):
    assert said in refusal(_read_tensors, content)


def test_other_members_of_a_header_do_not_change_the_arrays():
    header = {"__metadata__": {"format": "np"}, "x": {**entry(0, 4, [1]), "code": "1"}}
    result = _read_tensors(packed(header, np.float32(3.0).tobytes()))
    assert result.keys() == {"x"} and result["x"].tolist() == [3.0]


def test_arrays_of_other_numbers_are_not_written(tmp_path):
    for wrong in (np.zeros(2, dtype=int), np.array(["a"]), np.zeros(2, dtype=np.float16)):
        assert refusal(_write_tensors, tmp_path / "a", {"x": wrong}).startswith("x.dtype: ")
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize("name", policy_files.POLICIES)
def test_shipped_policies_are_written_with_the_same_bytes(name, tmp_path):
    content = (policy_files.policy_folder(name) / policy_files.ARRAYS).read_bytes()
    _write_tensors(tmp_path / "a", _read_tensors(content))
    assert (tmp_path / "a").read_bytes() == content


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (b'{"x": 1, "x": 2}', "a key is repeated"),
        (b'{"x": NaN}', "NaN is no JSON number"),
        (b'{"x": -Infinity}', "-Infinity is no JSON number"),
        (b"[" * 100_000, "too deeply"),
        (b"{", "Expecting property name"),
    ],
)
def test_broken_json_is_refused(text, said):
    assert said in refusal(_parse_json, text)
