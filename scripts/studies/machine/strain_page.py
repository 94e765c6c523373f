"""Page of the predicted root strain of a real arm."""

from collections.abc import Mapping, Sequence
from itertools import product
from math import ceil

from flexman_gym.common.markdown import markdown_table
from studies.machine.measure import CURRENT
from studies.machine.strain import ALL, ONE_STAGE, StrainRow
from studies.screen import screen

QUESTION = "Which margin of the strain limit does the error of the model need on a real arm?"
ANSWER = """**For one flexible link, a margin of {one:.0%} of the strain limit covers 99.9 % of the errors of held-out
predictions; two links in series need {first:.0%} and {second:.0%}.** An observer helps over 0.1 s at most: the
model errs, not its initial state."""
BODY = """{table}

Error: measured minus predicted strain, as a fraction of the peak of its record. "From rest" is the whole record; other
predictions start from a Kalman filter. One stage: {runs} runs of a Quanser arm, each
predicted with parameters fitted to the other half. Both stages: second half of a record; link 1 as fitted to the runs
of one stage, link 2 to the first half.

- The margin (`Limits.margin` over `Limits.strain`) is the largest 99.9 % quantile. Runs below half of the median peak
  are left out: `{small}`, with {peak:.0f} microstrain, has errors up to {worst:.0%}, since friction stalls the hub.
- Hub angles are given, also in the predicted time. With currents in their place the errors from rest are {driven}
  (99.9 %).
- The log is filtered at 2 Hz; its derivatives give the strain up to 25 Hz. The factor of a gauge is fitted."""
PAIRS = {"RMS, 95 %": ("rms", "most"), "99.9 %, largest": ("nearly_all", "largest")}  # name of a line -> fields


def page(rows: Sequence[StrainRow], files: Mapping[str, str]) -> str:
    """Return the page as Markdown; `files` is the file of the rows with its comment."""
    pooled = {(row.part, row.stage, row.horizon): row for row in rows if row.run == ALL and row.part != CURRENT}
    driven = [f"{row.nearly_all:.0%}" for row in rows if row.run == ALL and row.part == CURRENT]
    gauges = list(dict.fromkeys((part, stage) for part, stage, _ in pooled))
    horizons = list(dict.fromkeys(horizon for *_, horizon in pooled))
    heads = ("records, gauge", "error", *(f"{each:g} s ahead" if each else "from rest" for each in horizons))
    cells: list[Sequence[str]] = []
    for (part, stage), (name, pair) in product(gauges, PAIRS.items()):
        errors = ([getattr(pooled[part, stage, each], one) for one in pair] for each in horizons)
        cells.append((f"{part}, {stage:.0f}", name, *(", ".join(f"{each:.1%}" for each in both) for both in errors)))
    one, first, second = (ceil(100.0 * max(pooled[*gauge, each].nearly_all for each in horizons)) / 100.0
                          for gauge in gauges)  # fmt: skip
    runs = [row for row in rows if row.part == ONE_STAGE and row.run != ALL and not row.horizon]
    least = min(runs, key=lambda row: row.peak)
    body = BODY.format(table="\n".join(markdown_table(heads, cells)), runs=len(runs), small=least.run,
                       peak=1e6 * least.peak, worst=least.largest, driven=" and ".join(driven))  # fmt: skip
    answer = ANSWER.format(one=one, first=first, second=second)
    return screen("Margin of the strain of a real arm", QUESTION, answer, body, files, "strain")
