"""Arrays and JSON of a policy: arrays survive the file to the bit, and a damaged file is refused in one line."""

import hashlib
import json
import shutil

import numpy as np
import pytest
from safetensors.numpy import load

from flexman_gym.evaluation import policy_files
from flexman_gym.evaluation.policy_files import MAX_BYTES, METADATA, POLICIES, policy_folder, read_policy, write_policy

from oracles.assertions import refusal

SHIPPED = policy_folder(POLICIES[0])


def packed(header, numbers=b""):
    """A file of a header, as text or as a mapping, and bytes after it."""
    text = (header if isinstance(header, str) else json.dumps(header)).encode()
    return len(text).to_bytes(8, "little") + text + numbers


def entry(first, last, shape, dtype="F32"):
    """What a header says of an array."""
    return {"dtype": dtype, "shape": shape, "data_offsets": [first, last]}


def policy_with(folder, content):
    """Write the first shipped policy with another content of its arrays, and their hash, to a folder."""
    shutil.copytree(SHIPPED, folder, dirs_exist_ok=True)
    (folder / policy_files.ARRAYS).write_bytes(content)
    about = json.loads((folder / METADATA).read_text()) | {"arrays_hash": hashlib.sha256(content).hexdigest()}
    (folder / METADATA).write_text(json.dumps(about))
    return folder


@pytest.mark.parametrize(("end", "metadata"), [("  ", {}), ("", {"__metadata__": {"format": "np"}})])
def test_the_file_is_the_one_that_the_format_describes(end, metadata, tmp_path):
    """By hand, from the description of safetensors: a length of 8 bytes, JSON that may end in spaces, and numbers.

    Metadata and further members of an entry do not change the arrays.
    """
    arrays = load((SHIPPED / policy_files.ARRAYS).read_bytes())
    header, numbers = dict(metadata), b""
    for name, array in arrays.items():
        first, numbers = len(numbers), numbers + array.tobytes()
        kind = {"float32": "F32", "float64": "F64"}[array.dtype.name]
        header[name] = {**entry(first, len(numbers), [*array.shape], kind), **({"code": "1"} if metadata else {})}
    network = read_policy(policy_with(tmp_path, packed(json.dumps(header) + end, numbers))).network
    observations = arrays["check.observations"]
    assert np.array_equal(network(observations), read_policy(SHIPPED).network(observations))


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "header too small"),
        (bytes(MAX_BYTES + 1), f"at most {MAX_BYTES}"),
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
def test_a_file_that_says_something_else_is_refused(content, said, tmp_path):
    assert said in refusal(read_policy, policy_with(tmp_path, content))


@pytest.mark.parametrize("name", POLICIES)
def test_shipped_policies_are_written_with_the_same_bytes(name, tmp_path):
    """Whatever the order of the numbers of their arrays in memory; arrays of other numbers are not written."""
    content = (policy_folder(name) / policy_files.ARRAYS).read_bytes()
    arrays = {key: np.asfortranarray(array) for key, array in load(content).items()}
    about = json.loads((policy_folder(name) / METADATA).read_text())
    for wrong in (np.zeros(2, dtype=int), np.array(["a"]), np.zeros(2, dtype=np.float16)):
        assert refusal(write_policy, tmp_path / "a", about, arrays | {"x": wrong}).startswith("x.dtype: ")
    assert not (tmp_path / "a" / policy_files.ARRAYS).exists()
    write_policy(tmp_path / "a", about, arrays)
    assert (tmp_path / "a" / policy_files.ARRAYS).read_bytes() == content


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
def test_broken_json_is_refused(text, said, tmp_path):
    (tmp_path / METADATA).write_bytes(text)
    assert said in refusal(read_policy, tmp_path)
