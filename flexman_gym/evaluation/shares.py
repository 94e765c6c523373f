"""Text of shares of episodes with their 95 % intervals."""

from flexman_gym.common.formatting import percent, percent_number
from flexman_gym.metrics import share_interval

EXAMPLES = (1.0, 0.9, 0.5)  # shares whose intervals a caption states


def share_text(share: float, episodes: float) -> str:
    """Return a share of a number of episodes in percent, with its interval in brackets."""
    return percent(*share_interval(round(share * episodes), round(episodes)))


def intervals_text(episodes: int) -> str:
    """Return a sentence with the intervals of typical shares of a number of episodes, for the caption of a table."""
    found = (share_interval(round(share * episodes), episodes) for share in EXAMPLES)
    texts = ", ".join(f"{percent_number(low)} to {percent_number(high)} % for {percent_number(share)} %"
                      for share, low, high in found)  # fmt: skip
    return f"95 % intervals (Wilson) of shares of {episodes} episodes: {texts}."
