"""Page of the study of derivatives: deviations from differences by kind of parameter, exceptions, and costs."""

from collections.abc import Mapping, Sequence

import numpy as np

from flexman_gym.common.markdown import markdown_table
from studies.derivatives.costs import DIFFERENCES, GAINS, JACOBIANS, PERIOD, ROLLED, SEVEN, CostRow
from studies.derivatives.differences import LARGEST, allowed
from studies.derivatives.dimensions import NOMINAL
from studies.derivatives.measure import EPISODES, HIGH, LOW, DerivativeRow
from studies.screen import screen

KINDS = {  # line of the table -> parameters; all others are gains and actions
    "payload, rotor inertia": ("payload_mass", "rotor_inertia"),
    "joint stiffness and damping": ("joint_stiffness", "joint_damping"),
    "friction": ("viscous_friction", "coulomb_friction", "coulomb_rate", "static_excess", "stribeck_rate"),
    "backlash, pieces, ripple": ("backlash", "soft_stiffness", "ripple_torque"),
    "link stiffness and damping": ("link_stiffness_factor", "link_damping"),
    "initial state, inputs": ("initial_joint_angles", "initial_joint_rates", "motor_torques", "tip_force",
                              "base_acceleration"),
    "dimensions, materials": tuple(dict.fromkeys(name.partition("[")[0] for name in NOMINAL)),
}  # fmt: skip
OTHERS = "gains, actions"
HEADS = ("parameters", "rows", "worst difference", "its estimate", "remainder", "exceptions", "equal values")
QUESTION = "Are the derivatives of `fm.sensitivities` exact, and what do they cost?"
ANSWER = """**{accurate} of {count} derivatives agree with differences to {largest:g} or three error estimates of the
differences, and {smooth} have a Taylor remainder of second order.** Of these, {close} agree to {largest:g}. The values
of {equal} have the bits of a simulation without derivatives."""
BODY = """{table}

Each row has one parameter, method and effect. The difference to Richardson-extrapolated central differences is relative
to the largest derivative of an output; the table has the row and output nearest to the limit. The remainder is the
range of its orders over two decades of the change, without exceptions.

{texts}"""
BACKLASH = "A change moves the twist past a knee of the spring, where the second derivative jumps"
VIBRATION = "The tip vibration, a length, has a kink at the start at rest, where its derivative is set to 0"
EXCEPTION = "- Orders outside {low} to {high}: {names}. {reason}."
COSTS = """- Seven derivatives of a motion cost {seven:.3g} simulations, differences {differences:.3g}. A and B of a
  control period cost {jacobians:.3g} periods, differences {periods:.3g}. Derivatives of an episode by six gains cost
  {gains:.3g} episodes."""


def page(rows: Sequence[DerivativeRow], costs: Sequence[CostRow], files: Mapping[str, str]) -> str:
    """Return the page as Markdown; `files` are the files of both kinds of rows with their comments."""
    kinds = {kind: [row for row in rows if _kind(row) == kind] for kind in (*KINDS, OTHERS)}
    counts = {
        "count": len(rows), "accurate": sum(row.is_accurate for row in rows),
        "close": sum(row.difference <= LARGEST for row in rows),
        "smooth": sum(row.is_smooth for row in rows), "equal": sum(row.equal == "yes" for row in rows),
    }  # fmt: skip
    table = markdown_table(HEADS, (_cells(kind, members) for kind, members in kinds.items()))
    texts = [*_exceptions(rows), _costs(costs)]
    body = BODY.format(table="\n".join(table), texts="\n".join(texts))
    return screen("Exact derivatives", QUESTION, ANSWER.format(largest=LARGEST, **counts), body, files, "derivatives")


def _kind(row: DerivativeRow) -> str:
    name = row.parameter.partition("[")[0]
    return next((kind for kind, names in KINDS.items() if name in names), OTHERS)


def _cells(kind: str, rows: Sequence[DerivativeRow]) -> tuple[object, ...]:
    """Return the cells of a kind of parameters."""
    worst = max(rows, key=lambda row: row.difference / float(allowed(np.array(row.error))))
    smooth = [row for row in rows if row.is_smooth]
    low, high = min(row.order_low for row in smooth), max(row.order_high for row in smooth)
    equal = sum(row.equal == "yes" for row in rows)
    return (kind, len(rows), f"{worst.difference:.1e}", f"{worst.error:.1e}", f"{low:.2f} to {high:.2f}",
            len(rows) - len(smooth), equal)  # fmt: skip


def _exceptions(rows: Sequence[DerivativeRow]) -> list[str]:
    """Return a line for each reason of a remainder of another order, and one for rows that are not accurate."""
    named: dict[str, list[str]] = {}
    for row in rows:
        if not row.is_smooth:
            of_rest = row.effect in EPISODES and row.parameter.startswith("initial_joint_rates")
            reason = BACKLASH if "backlash" in row.effect else VIBRATION if of_rest else "Without an explanation"
            named.setdefault(reason, []).append(f"`{row.parameter}` with {row.method} ({row.effect})")
    result = [
        EXCEPTION.format(low=LOW, high=HIGH, names=_merged(names), reason=reason) for reason, names in named.items()
    ]
    wrong = [f"`{row.parameter}` with {row.method} ({row.effect})" for row in rows if not row.is_accurate]
    return [*result, *([f"- Larger deviations: {', '.join(wrong)}."] if wrong else [])]


def _merged(names: Sequence[str]) -> str:
    """Return up to two names, or the parameters and the number of rows."""
    parameters = dict.fromkeys(name.partition(" ")[0] for name in names)
    return ", ".join(names) if len(names) < 3 else f"{', '.join(parameters)} in {len(names)} rows"


def _costs(costs: Sequence[CostRow]) -> str:
    ratios = {row.name: row.times_median for row in costs}
    return COSTS.format(
        seven=ratios[SEVEN], differences=ratios[DIFFERENCES.format(ROLLED)],
        jacobians=ratios[JACOBIANS], periods=ratios[DIFFERENCES.format(PERIOD)],
        gains=ratios[GAINS],
    )  # fmt: skip
