"""Page of the policy for all arms: random arms beside controllers without training."""

from collections.abc import Mapping, Sequence

import numpy as np

from flexman_gym.common.markdown import markdown_table
from flexman_gym.evaluation.shares import share_text
from flexman_gym.toolbox.controllers.replanned_tracking import PLANNING_TIME
from flexman_gym.toolbox.league.arm_trial import SETTLED
from studies.generalist.measure import AGENTS, ARMS, LAW, NEEDED, PLANNED, POLICY, SEEDS, GeneralistRow
from studies.screen import screen

QUESTION = "Does one policy, trained over random arms, need no training on the arm of a user?"
ANSWER = """**It settles quicker than `{law}`, and as often, on {wins} of {arms} arms that its training has not drawn
({needed} are needed for `flexman arm --try`, which {decision}); `{planned}` does so on {planned_wins}, without any
training.** Shares of arms with 95 % intervals (Wilson): {share} and {planned_share}."""
BODY = """{table}

Time: median over the arms of the ratio of the median settling time to that of `{law}`; short and long slews: below and
above {periods} periods of the first mode, on {short} and {long} arms (a division found after the results).

Each arm has {episodes} episodes with unknown payload and stiffness and the sensors of a laboratory. The policy (recipe
`generalist`, `scripts/studies/generalist/policy`) changes the pace of the slews of `{law}`: its action and its 26
observed numbers are in units of the arm. It was trained on 16 random arms with 1 to 3 joints.

{reason}"""
REASON = """Where it fails: short slews of the law already end as soon as the first mode allows. `{planned}` shapes
every torque, but a plan takes {thinking} s, so that arms with short slews keep those of the law."""
LONG = 1.4  # periods of the first mode; slews of the arms on which the policy pays are longer


def page(rows: Sequence[GeneralistRow], files: Mapping[str, str]) -> str:
    """Return the page as Markdown; `files` is the file of the rows with its comment."""
    heads = ("agent", "quicker than the law, arms", "arms settled to 95 %", "time, short slews", "time, long slews")
    wins, short = wins_of(POLICY, rows), [row for row in rows if row.slew_periods <= LONG]
    long = [row for row in rows if row.slew_periods > LONG]
    cells = [
        (f"`{agent}`", f"{wins_of(agent, short)} of short, {wins_of(agent, long)} of long",
         str(sum(row.settled >= SETTLED for row in rows if row.agent == agent)),
         _ratio(agent, short), _ratio(agent, long))
        for agent in AGENTS
    ]  # fmt: skip
    decision = "takes it" if wins >= NEEDED else "does not take it"
    answer = ANSWER.format(law=LAW, wins=wins, arms=len(ARMS), needed=NEEDED, decision=decision, planned=PLANNED,
                           planned_wins=wins_of(PLANNED, rows), share=share_text(wins / len(ARMS), len(ARMS)),
                           planned_share=share_text(wins_of(PLANNED, rows) / len(ARMS), len(ARMS)))  # fmt: skip
    body = BODY.format(
        table="\n".join(markdown_table(heads, cells)), law=LAW, episodes=len(SEEDS), periods=LONG,
        short=len(short) // len(AGENTS), long=len(long) // len(AGENTS),
        reason=REASON.format(planned=PLANNED, thinking=PLANNING_TIME),
    )  # fmt: skip
    return screen("One policy for all arms", QUESTION, answer, body, files, "generalist")


def wins_of(agent: str, rows: Sequence[GeneralistRow]) -> int:
    """Return the number of arms on which an agent settles as often as the adaptive law, or more, and quicker."""
    found = {(row.arm, row.agent): row for row in rows}
    pairs = [(found[arm, agent], found[arm, LAW]) for arm in {row.arm for row in rows}]
    return sum(each.settled >= law.settled and each.settling_time < law.settling_time for each, law in pairs)


def _ratio(agent: str, rows: Sequence[GeneralistRow]) -> str:
    """Return the median ratio of settling times to those of the adaptive law; "none" where most arms do not settle."""
    law = {row.arm: row.settling_time for row in rows if row.agent == LAW}
    ratios = [row.settling_time / law[row.arm] for row in rows if row.agent == agent]
    median = float(np.median(ratios)) if ratios else np.inf
    return f"{median:.2f}" if np.isfinite(median) else "none"
