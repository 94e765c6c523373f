"""Text of shares of episodes."""

import pytest

from flexman_gym.evaluation.shares import EXAMPLES, intervals_text, share_text
from flexman_gym.metrics import share_interval


@pytest.mark.parametrize(
    ("share", "episodes", "text"), [(1.0, 10, "100 % (72 to 100)"), (0.29, 100, "29 % (21 to 39)")]
)
def test_a_share_has_its_interval(share, episodes, text):
    """0.29 * 100 is 28.999...: counts are rounded."""
    assert share_text(share, episodes) == text


def test_the_sentence_has_the_intervals_of_its_examples():
    text = intervals_text(40)
    for share in EXAMPLES:
        found, low, high = (100.0 * each for each in share_interval(round(40 * share), 40))
        assert f"{low:.0f} to {high:.0f} % for {found:.0f} %" in text
    assert "shares of 40 episodes" in text
