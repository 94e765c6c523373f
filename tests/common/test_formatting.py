"""Text of lengths and shares."""

from flexman_gym.common.formatting import millimetres, percent


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
