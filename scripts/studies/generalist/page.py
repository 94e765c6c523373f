"""Page of the policy for all arms: random arms beside controllers without training."""

from collections.abc import Mapping, Sequence
from math import isfinite

import numpy as np

from flexman_gym.common.markdown import markdown_table
from flexman_gym.toolbox.controllers.replanned_tracking import PLANNING_TIME
from studies.generalist.measure import AGENTS, ARMS, LAW, NEEDED, PLANNED, POLICY, SEEDS, GeneralistRow
from studies.screen import screen

QUESTION = "Does one policy, trained over random arms, need no training on the arm of a user?"
ANSWER = """**It settles quicker than `{law}`, and as often, on {wins} of {arms} arms that its training has not drawn
({needed} are needed for `flexman arm --try`, which {decision}); `{planned}` does so on {planned_wins}, without any
training.**"""
BODY = """{table}

A cell is the share of settled episodes and the median settling time in units of that of `{law}` on the arm. In the
median over the arms `generalist` takes {policy_ratio:.2f} of the time of `{law}`, `{planned}` {planned_ratio:.2f}.

Each arm has {episodes} episodes with unknown payload and stiffness, a delay of one period and the sensors of a
laboratory. The policy (recipe `generalist`, `scripts/studies/generalist/policy`) changes the pace of the slews of
`{law}`: its only action, and its observation of 26 numbers, are in units of slew, reach, torque limits and usual
payload, so that it acts on any arm. It was trained on 16 random arms with 1 to 3 joints.

{reason}"""
REASON = """Where it fails: it beats the law on {long_wins} of {long} arms whose slews last more than {periods}
periods of the first mode, and on {short_wins} of the {short} others (a division found after the results). The slews of
those already end as soon as the first mode allows. `{planned}` shapes every torque, but a plan takes {thinking} s, so
that arms with short slews keep those of the law."""
LONG = 1.4  # periods of the first mode; slews of the arms on which the policy pays are longer


def page(rows: Sequence[GeneralistRow], files: Mapping[str, str]) -> str:
    """Return the page as Markdown; `files` is the file of the rows with its comment."""
    found = {(int(row.arm), row.agent): row for row in rows}
    heads = ("arm", "joints, reach", f"`{LAW}`", *(f"`{agent}`" for agent in AGENTS if agent != LAW))
    cells = [_cells(arm, found) for arm in ARMS]
    wins = wins_of(POLICY, rows)
    decision = "takes it" if wins >= NEEDED else "does not take it"
    answer = ANSWER.format(law=LAW, wins=wins, arms=len(ARMS), needed=NEEDED, decision=decision, planned=PLANNED,
                           planned_wins=wins_of(PLANNED, rows))  # fmt: skip
    body = BODY.format(
        table="\n".join(markdown_table(heads, cells)), law=LAW, planned=PLANNED, episodes=len(SEEDS),
        policy_ratio=_ratio(POLICY, found), planned_ratio=_ratio(PLANNED, found),
        reason=_reason(rows),
    )  # fmt: skip
    return screen("One policy for all arms", QUESTION, answer, body, files, "generalist")


def wins_of(agent: str, rows: Sequence[GeneralistRow]) -> int:
    """Return the number of arms on which an agent settles as often as the adaptive law, or more, and quicker."""
    found = {(row.arm, row.agent): row for row in rows}
    pairs = [(found[arm, agent], found[arm, LAW]) for arm in {row.arm for row in rows}]
    return sum(each.settled >= law.settled and each.settling_time < law.settling_time for each, law in pairs)


def _reason(rows: Sequence[GeneralistRow]) -> str:
    """Return the paragraph on the arms on which the policy fails."""
    parts = [[row for row in rows if (row.slew_periods > LONG) == flag] for flag in (True, False)]
    (long, long_wins), (short, short_wins) = ((len(part) // len(AGENTS), wins_of(POLICY, part)) for part in parts)
    return REASON.format(planned=PLANNED, periods=LONG, long=long, long_wins=long_wins, short=short,
                         short_wins=short_wins, thinking=PLANNING_TIME)  # fmt: skip


def _cells(arm: int, found: Mapping[tuple[int, str], GeneralistRow]) -> list[str]:
    law = found[arm, LAW]
    own = [str(arm), f"{law.joints:.0f}, {law.reach:.2g} m", f"{law.settled:.0%}, {law.settling_time:.3g} s"]
    return own + [_cell(found[arm, agent], law) for agent in AGENTS if agent != LAW]


def _cell(row: GeneralistRow, law: GeneralistRow) -> str:
    ratio = row.settling_time / law.settling_time
    return f"{row.settled:.0%}, {ratio:.2f}" if isfinite(ratio) else f"{row.settled:.0%}"


def _ratio(agent: str, found: Mapping[tuple[int, str], GeneralistRow]) -> float:
    return float(np.median([found[arm, agent].settling_time / found[arm, LAW].settling_time for arm in ARMS]))
