"""Page of the study of robust control: bounds, random plants and a simulated move."""

from collections.abc import Mapping, Sequence

from flexman_gym.common.markdown import markdown_table
from studies.robust.measure import LOSS, MOVED, PLANTS, RobustRow
from studies.screen import screen

QUESTION = "Does an H-infinity controller keep its guarantee for all payloads and frictions in their ranges?"
ANSWER = """**Yes: all {plants} random plants are stable, with gains of at most {largest:.2f}; the bound is
{bound:.2f}.** The channels need scales: without them mu is {unscaled:.2f}, and {unstable:.0%} of the plants are
unstable."""
BODY = """{table}

Arm of Gu, Petkov and Konstantinov (2005): payload 0.25 kg +-40 %, friction of the hub +-20 %, error of the torques
30 %; encoder and strain gauges at 500 Hz. Sensors and weights of the book differ, so that norms do not compare.

- mu: upper bound of the structured singular value, below 1 for robust stability.
- bound: of the gain from disturbances to performance outputs. Robust performance at the gain that the design allows,
  {allowed:.2f}, is {proven}.
- largest: peak gain of {plants} random plants, sampled exactly with all modes and without errors of the torques.
- settling: of the tip to 2 %, for all of {moved} simulated random plants, in the move of the book, 15 degrees in 1 s.

The design without ranges has the error of the torques alone. It is robust, too, with a bound of {ignored:.2f}, but
its plants have gains up to {ignored_largest:.2f}. The guarantees hold for the linear model within the torque limits."""


def page(rows: Sequence[RobustRow], files: Mapping[str, str]) -> str:
    """Return the page as Markdown; `files` is the file of the rows with its comment."""
    heads = ("controller", "share", "mu", "bound", "largest", "stable", "settling, s")
    cells = [(row.controller, *map(_cell, (row.share, row.robustness, row.bound, row.largest, row.stable)),
              "none" if row.settling > 3.0 else f"{row.settling:.2f}") for row in rows]  # fmt: skip
    named = {row.controller: row for row in rows}
    scaled, unscaled = named["scaled channels"], named["channels"]
    ignored = named["ranges ignored"]
    assert unscaled.stable is not None and scaled.norm is not None and scaled.bound is not None
    proven = "proven" if scaled.bound <= LOSS * scaled.norm else "not proven"
    answer = ANSWER.format(plants=PLANTS, largest=scaled.largest, bound=scaled.bound, unscaled=unscaled.robustness,
                           unstable=1.0 - unscaled.stable)  # fmt: skip
    body = BODY.format(table="\n".join(markdown_table(heads, cells)), plants=PLANTS, moved=MOVED, ignored=ignored.bound,
                       allowed=LOSS * scaled.norm, proven=proven, ignored_largest=ignored.largest)  # fmt: skip
    return screen("Robust control of a published arm", QUESTION, answer, body, files, "robust")


def _cell(value: float | None) -> str:
    return "" if value is None else "none" if value == float("inf") else f"{value:.3g}"
