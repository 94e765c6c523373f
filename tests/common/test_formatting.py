"""Text of numbers, lengths, shares and tables, and JSON."""

import json
from pathlib import Path

import numpy as np
import pytest

from flexman_gym.common.formatting import json_text, millimetres, number_text, percent, text_table


def test_lengths_are_in_millimetres_as_far_as_they_count():
    lengths = {
        1.09e-9: "below 0.01 mm",
        9.9e-6: "below 0.01 mm",
        6.6e-5: "0.066 mm",
        1.234e-3: "1.2 mm",
        0.0994: "99 mm",
        0.0996: "100 mm",
        0.2814: "281 mm",
    }
    assert {length: millimetres(length) for length in lengths} == lengths


def test_a_share_stands_before_the_bounds_of_its_interval():
    assert percent(0.514) == "51 %" and percent(1.0, 0.963, 1.0) == "100 % (96 to 100)"


def test_only_exact_shares_are_none_or_all():
    assert percent(0.0, 0.0, 0.0038) == "0 % (0 to 0.4)" and percent(0.9984, 0.9949, 1.0) == "99.8 % (99 to 100)"


@pytest.mark.parametrize(("value", "digits", "text"), [
    (4.657, 3, "4.66"), (4.657, 2, "4.7"), (123.4, 2, "123"), (0.01234, 3, "0.012"),
    (-0.0001, 3, "0"), (np.inf, 2, "-"),
])  # fmt: skip
def test_numbers_have_the_digits_that_are_asked_for(value, digits, text):
    assert number_text(value, digits) == text


def test_json_has_every_bit_of_a_number_and_null_for_what_is_not_finite():
    data = {"array": np.array([0.1, np.inf]), 3: (np.float64(1.0 / 3.0), float("nan")), "path": Path("a/b"),
            "flags": [True, None, np.bool_(False)], "count": np.int64(7)}  # fmt: skip
    assert json.loads(json_text(data)) == {
        "array": [0.1, None], "3": [1.0 / 3.0, None], "path": "a/b", "flags": [True, None, False], "count": 7,
    }  # fmt: skip


def test_a_table_wider_than_a_line_goes_on_below_with_its_first_column():
    lines = text_table(["agent", "a", "bbbbbbbb", "c"], [["pd", "1", "2", "333333"], ["lqr", "44", "5", "6"]], width=20)
    assert lines == [
        "agent   a  bbbbbbbb", "pd      1         2", "lqr    44         5", "", "agent       c", "pd     333333",
        "lqr         6",
    ]  # fmt: skip
    assert len(text_table(["agent", "a", "bbb"], [["pd", "1", "2"]], width=13)) == 2, "of 13 characters, and no more"
    assert len(text_table(["agent", "a", "bbb"], [["pd", "1", "2"]], width=12)) == 5
    assert text_table(["agent", "b" * 30], [["pd", "1"]], width=20) == ["agent  " + "b" * 30, "pd" + " " * 34 + "1"]
