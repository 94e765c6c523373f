"""Page of the servo study: the gain limits of one arm, and their check by simulation."""

from collections.abc import Mapping, Sequence

from flexman_gym.common.markdown import markdown_table
from studies.screen import screen
from studies.servos.measure import APART, AT_REST, DELAYS, LARGEST, PERIODS, FrictionRow, ServoRow

ARM = "FlexRRR-v0"  # environment of the table
REST = 0.5  # final energy relative to the largest energy, below which a simulated arm is at rest
QUESTION = "How large may the gains of a joint servo be at a given control period and delay?"
ANSWER = """**With the tuned gains of `{arm}` a delay of {delay} period is stable up to a control period of
{longest:g} ms.** A shorter `control_period` with a larger `action_repeat` increases the limit."""
BODY = """{table}

The table has the gain margin: the factor of both tuned gains at which an eigenvalue of the sampled loop leaves the
unit circle, for the straight arm with four modes per link. Below 1 (bold) the tuned gains themselves are unstable.
`toolbox.controllers.margins` reports 1 for every unstable loop.

- In simulations at {apart:.0%} below and above {count} of the limits, {calm} arms came to rest below and
  {calm_above} above.
- With Coulomb friction a loop is called stable if it is stable for every combination of sticking motors. Of {stable}
  such loops {at_rest} came to rest, to {rest:.0%} of the largest speed of the tip.

[servos.csv](servos.csv) has two more arms, drives with a bandwidth, and stiffer springs."""


def page(rows: Sequence[ServoRow], rubbing: Sequence[FrictionRow], files: Mapping[str, str]) -> str:
    """Return the page as Markdown; `files` are the files of both kinds of rows with their comments."""
    own = {(row.period, row.delay): row.factor for row in rows
           if row.environment == ARM and row.springs == 1.0 and not row.bandwidth}  # fmt: skip
    heads = ("control period", *(f"delay {delay}" for delay in DELAYS))
    cells = [(f"{1e3 * period:g} ms", *(_cell(own[period, delay]) for delay in DELAYS)) for period in PERIODS]
    tried = [(row.below, row.above) for row in rows if row.below is not None and row.above is not None]
    stable = [row for row in rubbing if row.is_stable]
    numbers = {
        "count": len(tried), "calm": sum(below < REST for below, _ in tried),
        "calm_above": sum(above < REST for _, above in tried),
        "stable": len(stable), "at_rest": sum(row.left < AT_REST for row in stable),
    }  # fmt: skip
    table = "\n".join(markdown_table(heads, cells))
    longest = max(period for period in PERIODS if own[period, 1] >= 1.0)
    answer = ANSWER.format(arm=ARM, delay=1, longest=1e3 * longest)
    body = BODY.format(table=table, apart=APART, rest=AT_REST, **numbers)
    return screen("Gain limits of servos", QUESTION, answer, body, files, "servos")


def _cell(factor: float) -> str:
    if factor in (0.0, LARGEST):
        return "none" if factor == 0.0 else f"> {LARGEST:g}"
    return f"{factor:.3g}" if factor >= 1.0 else f"**{factor:.3g}**"
