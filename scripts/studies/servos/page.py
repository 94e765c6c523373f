"""Page of the servo study: tables and conclusions."""

from collections.abc import Sequence

from flexman_gym.common.markdown import markdown_table
from studies.servos.measure import (
    APART,
    AT_REST,
    BANDWIDTHS,
    DELAYS,
    DURATION,
    ENVIRONMENTS,
    LARGEST,
    METHODS,
    PERIODS,
    SPRINGS,
    FrictionRow,
    ServoRow,
)

SAYS = (
    "The gain limit of a servo is the factor by which its gains may be multiplied before the sampled loop becomes "
    "unstable. Longer control periods and delays reduce it. At the longest periods even the tuned gains are unstable. "
    "The remedy is a shorter period with a held action. Simulations with gains slightly below and above the limits "
    "confirm them."
)
HEAD = (
    "`python scripts/servos.py --folder docs/evidence` rewrites this page and its rows ([servos.csv](servos.csv)). A "
    'servo acts in every control period (`actions="position"` or `"velocity"`), and an agent holds its action for '
    "`action_repeat` of them. Both modes have the same loop: a PD of each motor, a delay of whole periods, and a "
    "drive whose torque lags as a first-order filter (`drive_bandwidth`)."
)
READING = (
    "The tables contain the factor by which both tuned gains of an environment may be multiplied before an eigenvalue "
    "of the sampled loop leaves the unit circle. Below 1 the tuned gains themselves are unstable. The arm is "
    "straight, without gravity, and every link has four modes."
)
LAG = "## Period, delay and drive"
STIFF = "## Stiff springs"
SPRUNG = "The same arms with joint springs 10 and 100 times as stiff, with ideal drives:"
TRIED = (
    "## Check by simulation\n\nFor {count} randomly chosen limits the environments were simulated with "
    "gains {apart:.0%} below and above them. Steps were at most those of the environment, and the methods "
    "{methods} alternated. **Below its limit the arm came to rest in {calm} of {count}, above it "
    "in {calm_above}.** Rest is a final energy of at most half of the largest energy."
)
FRICTION = (
    "## With Coulomb friction\n\nThe arms above have no Coulomb friction. A motor with friction either slides, and "
    "friction does not damp small oscillations, or it sticks. A loop is called stable if it is stable for every "
    "combination of sliding and sticking motors. Random arms of one to three strips with friction, delay and gains "
    "near their limits were simulated for {seconds:g} s, from initial offsets that require 2 to 20 times the friction "
    "torque ([servos_friction.csv](servos_friction.csv)). **Of {stable} loops called stable {calm} came to rest.** "
    "Rest is a vibration of the tip of at most {rest:.0%} of its largest speed. Loops whose slowest vibration decays "
    "more slowly were skipped.\n\nOf {unstable} loops called unstable {moving} still moved. Friction brought the "
    "others to rest from these offsets. Of the unstable loops {mixed} are unstable only while some motors stick. The "
    "linearised smoothed friction at rest classifies {misled} of them as stable, of which {misled_moving} still moved."
)
CONCLUSION = (
    "Without delay and drive lag the tuned gains may be multiplied by at least {least:.3g} at {short:g} ms. At "
    "{long:g} ms the largest factor is {most:.3g}. The tuned gains are unstable in {unstable} of {all} combinations. "
    "Most of these, {delayed}, have a delay. A shorter `control_period` with a larger `action_repeat` increases the "
    "limits."
)
REST = 0.5


def page(computer: str, rows: Sequence[ServoRow], rubbing: Sequence[FrictionRow]) -> str:
    """Return the page as Markdown; `computer` describes the computer of the study."""
    lines = [
        "# Gain limits of servos",
        "",
        SAYS,
        "",
        HEAD,
        "",
        f"Computed with {computer}.",
        "",
        READING,
        "",
        LAG,
        "",
    ]
    for name in ENVIRONMENTS:
        own = [row for row in rows if row.environment == name and row.springs == 1.0]
        columns = [(delay, bandwidth) for bandwidth in BANDWIDTHS for delay in DELAYS if not (delay == 4 and bandwidth)]
        heads = [f"{name}, period", *(_head(*each) for each in columns)]
        lines += [*markdown_table(heads, (_line(own, period, columns) for period in PERIODS)), ""]
    lines += [STIFF, "", SPRUNG, ""]
    heads = ["environment, period", *(f"{springs:g} x, delay {delay}" for springs in SPRINGS for delay in (0, 2))]
    lines += [*markdown_table(heads, (_stiff(rows, name, period) for name in ENVIRONMENTS for period in PERIODS)), ""]
    return "\n".join([*lines, _tried(rows), "", _friction(rubbing), "", "## Conclusion", "", _conclusion(rows)]) + "\n"


def _head(delay: int, bandwidth: float) -> str:
    return f"delay {delay}" + (f", {bandwidth:g} Hz" if bandwidth else "")


def _line(rows: Sequence[ServoRow], period: float, columns: Sequence[tuple[int, float]]) -> list[str]:
    found = {(row.delay, row.bandwidth): row.factor for row in rows if row.period == period}
    return [f"{1e3 * period:g} ms", *(_cell(found[each]) for each in columns)]


def _stiff(rows: Sequence[ServoRow], name: str, period: float) -> list[str]:
    own = [row for row in rows if row.environment == name and row.period == period and not row.bandwidth]
    found = {(row.springs, row.delay): row.factor for row in own}
    return [f"{name}, {1e3 * period:g} ms", *(_cell(found[springs, delay]) for springs in SPRINGS for delay in (0, 2))]


def _cell(factor: float) -> str:
    if factor in (0.0, LARGEST):
        return "none" if factor == 0.0 else f"> {LARGEST:g}"
    text = f"{factor:.3g}"
    return f"**{text}**" if factor < 1.0 else text


def _tried(rows: Sequence[ServoRow]) -> str:
    tried = [row for row in rows if row.below is not None and row.above is not None]
    calm = sum(row.below < REST for row in tried)  # type: ignore[operator]
    calm_above = sum(row.above < REST for row in tried)  # type: ignore[operator]
    return TRIED.format(
        count=len(tried),
        apart=APART,
        methods=" and ".join(f"`{each}`" for each in METHODS),
        calm=calm,
        calm_above=calm_above,
    )


def _friction(rows: Sequence[FrictionRow]) -> str:
    stable, unstable = ([row for row in rows if row.is_stable == wanted] for wanted in (True, False))
    misled = [row for row in unstable if row.smoothed < 1.0]
    return FRICTION.format(
        seconds=DURATION, rest=AT_REST, stable=len(stable), calm=sum(row.left < AT_REST for row in stable),
        unstable=len(unstable), moving=sum(row.left >= AT_REST for row in unstable),
        mixed=sum(row.sliding < 1.0 for row in unstable),
        misled=len(misled), misled_moving=sum(row.left >= AT_REST for row in misled),
    )  # fmt: skip


def _conclusion(rows: Sequence[ServoRow]) -> str:
    plain = [row for row in rows if row.delay == 0 and not row.bandwidth and row.springs == 1.0]
    short, long = min(PERIODS), max(PERIODS)
    bad = [row for row in rows if row.factor < 1.0]
    return CONCLUSION.format(
        short=1e3 * short, long=1e3 * long, all=len(rows), unstable=len(bad), delayed=sum(row.delay > 0 for row in bad),
        least=min(row.factor for row in plain if row.period == short),
        most=max(row.factor for row in plain if row.period == long),
    )  # fmt: skip
