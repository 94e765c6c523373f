"""Sentences of the README and of hand-written pages with numbers that are computed from stored rows."""

import re
from collections.abc import Callable, Sequence
from typing import NamedTuple

import gymnasium as gym
import numpy as np

from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.named_environments import DEFAULT_ID, NAMED_ENVIRONMENTS
from flexman_gym.evaluation.policy_files import POLICIES
from flexman_gym.evaluation.shares import share_text
from flexman_gym.metrics import BAND, VIBRATION_WINDOW
from flexman_gym.model.model import build_model
from flexman_gym.model.vibration import modes
from flexman_gym.scene import catalog
from flexman_gym.toolbox.league.certificate_file import exceeded_limits
from flexman_gym.toolbox.precision.charts import cheapest_equal, ratio_text
from flexman_gym.toolbox.verification.table import FAIL, PASS
from studies.control.page import share_over_arms
from studies.environments.measure import LONG_NAME
from studies.machine.measure import CURRENT
from studies.markdown import number_word
from studies.peers.measure import PAPER
from studies.sources import Sources
from studies.starts.measure import COLD, WHEEL
from studies.starts.page import total

INDEPENDENT = "independent automatic-differentiation code"  # source of rows of the verification
LARGE_ROTATION = "paper FF {} foreshortening, tip within 2 s, m"  # cases of the verification
MICROMETRE = 1e-6  # m
PICTURED = "shaping-flexrrr"  # policy of the first picture, see scripts/pictures.py
SECOND_HUB = CURRENT, "motor_angle_2", "R2"  # row of the comparison with a real arm


class Sentence(NamedTuple):
    """Sentence with numbers that are computed from rows.

    Attributes:
        pattern: regular expression; each group matches a number of the sentence, in any line breaks.
        numbers: function: rows -> text of each group.
    """

    pattern: str
    numbers: Callable[[Sources], Sequence[str]]

    def update(self, text: str, sources: Sources) -> str:
        """Return a text in which each occurrence of the sentence has the numbers of the rows."""
        expression = re.compile(self.pattern.replace(" ", r"\s+"))
        if not expression.search(text):
            return text
        numbers = self.numbers(sources)

        def replaced(match: re.Match[str]) -> str:
            whole, start = match.group(0), match.start()
            for group in range(len(numbers), 0, -1):
                first, last = (at - start for at in match.span(group))
                whole = whole[:first] + numbers[group - 1] + whole[last:]
            return whole

        return expression.sub(replaced, text)


def _verification(sources: Sources) -> tuple[str, str]:
    verdicts = [row.verdict for row in sources.verification]
    return str(verdicts.count(PASS)), str(verdicts.count(PASS) + verdicts.count(FAIL))


def _tip_errors(sources: Sources) -> tuple[str, str]:
    """Return the tip errors with and without foreshortening relative to large rotations, mm."""
    found = {row.case: row.computed for row in sources.verification}
    near, far = (1e3 * found[LARGE_ROTATION.format(each)] for each in ("with", "without"))
    return f"{near:.2g}", f"{far:.2g}"


def _held_out(sources: Sources) -> tuple[str, str]:
    scores = [row.value for row in sources.machine if row.part == "score"]
    return f"{np.median(scores):.2f}", str(len(scores))


def _training_minutes(sources: Sources) -> tuple[str]:
    """Return the CPU time of the recipe of the demonstration, rounded to half minutes."""
    seconds = [
        row.cpu for row in sources.learning if (row.kind, row.name) == ("recipe", "ppo_on_pd_minute") and row.cpu
    ]
    return (f"{round(float(np.median(seconds)) / 30.0) / 2.0:g}",)


def _compile_minutes(sources: Sources) -> tuple[str, str]:
    """Return the CPU time of the first start, in minutes and words, and the mark of its rows."""
    minutes = round(total(sources.starts, COLD, "cpu") / 60.0)
    return "a minute" if minutes == 1 else f"{minutes} minutes", sources.mark("starts.csv")


def _wheel_seconds(sources: Sources) -> tuple[str, str]:
    """Return the time of the first use of a wheel with machine code, s, and the mark of its rows."""
    return f"{total(sources.starts, WHEEL):.0f}", sources.mark("starts.csv")


def _steps(sources: Sources) -> tuple[str, str, str]:
    """Return the steps per CPU second of one arm, of the fastest vector environment on one thread, and their mark."""
    rows = [row for row in sources.benchmark if row.table == "environments" and row.threads == 1]
    one = next(row.cpu for row in rows if row.name == "FlexRRR-v0")
    many = min(row.cpu for row in rows if row.name == "FlexRRR-v0, vector environment")
    one_text, many_text = (f"{float(f'{1.0 / each:.2g}'):,.0f}" for each in (one, many))
    return one_text, many_text, sources.mark("benchmark.csv")


def _pd_settles(sources: Sources) -> tuple[str]:
    """Return the median settling time of the PD in longer episodes, s."""
    return (f"{next(row.settling_time for row in sources.baselines if row.baseline == LONG_NAME):.0f}",)


def _policy_settles(sources: Sources) -> tuple[str]:
    """Return the median settling time of the policy of the first picture, s."""
    return (f"{-sources.standings.settled(PICTURED, DEFAULT_ID)[1]:.2f}",)


def _reach(sources: Sources) -> tuple[str]:
    """Return the reach of the arm of the default environment, m."""
    return (f"{sum(link.length for link in NAMED_ENVIRONMENTS[DEFAULT_ID].arm.links):g}",)


def _slew(sources: Sources) -> tuple[str, str]:
    """Return the tolerance of a slew of the default environment, mm, and the length of an episode, s."""
    return f"{1e3 * BAND * float(_reach(sources)[0]):.3g}", f"{NAMED_ENVIRONMENTS[DEFAULT_ID].horizon:g}"


def window_and_episodes(sources: Sources) -> tuple[str, str]:
    """Return the window of the vibration, s, and the number of test episodes."""
    return f"{VIBRATION_WINDOW:g}", str(len(sources.standings.values("pd", DEFAULT_ID, "reward")))


def _duration(sources: Sources) -> tuple[str]:
    """Return the duration of the comparison with large rotations, s."""
    (case,) = (row.case for row in sources.verification if row.case == LARGE_ROTATION.format("with"))
    return (case.partition("within ")[2].partition(" s")[0],)


def _agreement(sources: Sources) -> tuple[str]:
    """Return an upper bound of the tip distances from the independent code of the same equations, mm."""
    largest = max(row.computed for row in sources.verification
                  if row.source == INDEPENDENT and "distance of the tip, m" in row.case)  # fmt: skip
    if largest >= MICROMETRE:
        raise ValueError(f"tip distance: {largest} m; the sentence is true below {MICROMETRE} m")
    return (f"{1e3 * MICROMETRE:g}",)


def _violations(sources: Sources) -> tuple[str, ...]:
    """Return violations and moves of the safety filter, with known and with uncertain parameters; largest excess, %."""
    conditions = [[row for row in sources.safety if row.condition == name] for name in ("nominal", "uncertain")]
    counts = [sum(getattr(row, name) for row in rows) for rows in conditions for name in ("violations", "moves")]
    largest = max(row.largest for rows in conditions for row in rows)
    if largest <= 0.0:
        raise ValueError(f"largest excess: {largest}; the sentence is true for moves that exceed a limit")
    return (*(f"{count:.0f}" for count in counts), f"{100.0 * largest:.2g}")


def _attacks(sources: Sources) -> tuple[str, ...]:
    """Return what attacks on the safety filter found, in the order of the sentence.

    Violations and moves of the trained attack; largest excess of tracking and of random torques, %; random moves beyond
    2 %, and all of them; largest excess with a pulse, %.
    """
    (attack,) = (row for row in sources.safety if row.agent == "PPO to violate")
    filtered = [row for row in sources.worst_moves if row.safety]
    without_pulse = {row.agent: row for row in filtered if not row.pulse}
    tracking, random = without_pulse["lqr-tracking"], without_pulse["random"]
    pulsed = max(row.excess for row in filtered if row.pulse)
    return (
        f"{attack.violations:.0f}", f"{attack.moves:.0f}", f"{100.0 * tracking.excess:.2g}",
        f"{100.0 * random.excess:.2g}", f"{random.beyond:.0f}", f"{random.evaluations:.0f}", f"{100.0 * pulsed:.2g}",
    )  # fmt: skip


def _second_hub(sources: Sources) -> tuple[str]:
    """Return R2 of the second hub angle, computed from motor currents."""
    (row,) = (row for row in sources.machine if (row.part, row.run, row.what) == SECOND_HUB)
    return (f"{row.value:.2f}",)


def _random_arms(sources: Sources) -> tuple[str, str, str]:
    """Return the number of random arms, the settled share of `adaptive-lqr`, and the arms with at least 90 %."""
    shares = [row.settled for row in sources.control if row.case.startswith("adaptive-lqr, random arm ")]
    return str(len(shares)), share_over_arms(shares), str(sum(share >= 0.9 for share in shares))


def _unmodelled_friction(sources: Sources) -> tuple[str, str]:
    """Return the settled share of `adaptive-lqr` with friction that is in no model, and the number of episodes."""
    (row,) = (row for row in sources.control if row.case == "adaptive-lqr, unmodelled friction")
    return share_text(row.settled, row.episodes), f"{row.episodes:.0f}"


def _in_mujoco(sources: Sources) -> tuple[str, str]:
    """Return the settled episodes of `lab-flexrrr` on the known arm in MuJoCo, and all of them."""
    times = [*sources.standings.values("lab-flexrrr", f"{DEFAULT_ID}@mujoco", "settling_time").values()]
    return str(np.count_nonzero(np.isfinite(times))), str(len(times))


def _default_cost(sources: Sources) -> tuple[str, str, str]:
    """Return error (mm) and cost (ms per s) of the default on the paper's arm, and the relative cost of others."""
    rows = [row for row in sources.peers if row.scene == PAPER]
    equal = cheapest_equal(rows)
    assert equal is not None and rows[0].total_error is not None
    return f"{1e3 * rows[0].total_error:.2g}", f"{1e3 * rows[0].cpu:.2g}", ratio_text(equal, rows[0])


def _exceeded(sources: Sources) -> tuple[str, str]:
    """Return the number of shipped policies that exceed a limit of their certificates, and that of all."""
    return str(sum(bool(exceeded_limits(name)) for name in POLICIES)), str(len(POLICIES))


def _task(sources: Sources) -> tuple[str, str]:
    """Return the first frequency of the default arm with held motors, Hz, and its damping ratio, %."""
    found = modes(build_model(NAMED_ENVIRONMENTS[DEFAULT_ID].arm, elements=2), motors="held")
    return f"{found.frequencies[0]:.2g}", f"{100.0 * found.damping_ratios[0]:.1g}"


def _interface(sources: Sources) -> tuple[str]:
    """Return the size of the observation of the default environment."""
    env = gym.make(DEFAULT_ID)
    return (str(env.observation_space.shape[0]),)  # type: ignore[index]


def _action(sources: Sources) -> tuple[str, str, str]:
    """Return the number of motors of the default environment, their torque limit, N m, and the control rate, Hz."""
    named = Configuration(DEFAULT_ID)
    (limit,) = set(named.torque_limit)
    return str(named.arm.n_joints), f"{limit:g}", f"{1.0 / named.control_period:.0f}"


def _count_of_environments(sources: Sources) -> tuple[str]:
    return (number_word(len(NAMED_ENVIRONMENTS)),)


def _halving(sources: Sources) -> tuple[str, str]:
    """Return the damping ratio of the first mode of the arm with one joint, %, and the periods in which it halves."""
    ratio = modes(build_model(catalog.one_joint(), elements=2), motors="held").damping_ratios[0]
    return f"{100.0 * ratio:.2g}", f"{np.log(2.0) / (2.0 * np.pi * ratio):.0f}"


SENTENCES = (  # with numbers of stored rows
    Sentence(r"(\d+) of (\d+) comparisons", _verification),
    Sentence(r"differs by ([\d.]+) mm, and by ([\d.]+) mm without foreshortening", _tip_errors),
    Sentence(r"explains ([\d.]+) of the variance of the tip deflection \(median of (\d+) held-out runs\)", _held_out),
    Sentence(r"about ([\d.]+) minutes on one core", _training_minutes),
    Sentence(r"\(once, about (a minute|\d+ minutes) of CPU time((?:; waiting for new rows)?)\)", _compile_minutes),
    Sentence(r"first use of such a wheel takes ([\d.]+) s((?:, waiting for new rows)?) \(\[first", _wheel_seconds),
    Sentence(
        r"([\d,]+) control periods per second for one arm and ([\d,]+) for many arms in one call "
        r"\(`gym.make_vec`, \[benchmark\]\(docs/evidence/benchmark.md\)((?:; waiting for new rows)?)\)",
        _steps,
    ),
    Sentence(
        r"moves with the safety filter that exceed a limit: (\d+) of (\d+) moves of the known arm and (\d+) of (\d+) "
        r"with all parameters uncertain, by up to ([\d.]+) %",
        _violations,
    ),
    Sentence(
        r"(\d+) of (\d+) moves of a policy trained to exceed the limits do so. In `unknown-lab` a "
        r"\[search\]\(evidence/safety_worst.csv\) over payload, stiffness, start and goal found at most "
        r"([\d.]+) % above a limit for `lqr-tracking`, ([\d.]+) % for random torques "
        r"\((\d+) of (\d+) tried moves are beyond 2 %\), and ([\d.]+) % with a pulse of force on the tip",
        _attacks,
    ),
    Sentence(
        r"with (\d+) random arms and uncertain parameters `adaptive-lqr` settles ([^)]*\)) of the slews, "
        r"and nine of ten with (\d+) of the arms",
        _random_arms,
    ),
    Sentence(
        r"\*\*Friction in no model\*\* \(`adaptive-lqr`\): with it ([^)]*\)) of (\d+) slews settle",
        _unmodelled_friction,
    ),
    Sentence(
        r"errs by ([\d.]+) mm at ([\d.]+) ms of computing time per simulated second; "
        r"the quickest other simulator as accurate takes ([\d.]+) times as long",
        _default_cost,
    ),
    Sentence(r"the second hub angle of a Quanser arm is not predicted \(R2 (-[\d.]+)", _second_hub),
    Sentence(r"The PD settles after ([\d.]+) s", _pd_settles),
)
DEFINITIONS = (  # numbers of environments, pictures, metrics, verification, certificates and other plants
    Sentence(r"The policy settles after ([\d.]+) s", _policy_settles),
    Sentence(r"first mode at ([\d.]+) Hz\), hardly damped \(([\d.]+) % of critical", _task),
    Sentence(r"observation \| (\d+) numbers", _interface),
    Sentence(r"action \| (\d+) motor torques as fractions of ([\d.]+) N m, (\d+) times per second", _action),
    Sentence(r"(\d+) of (\d+) exceed one of the limits", _exceeded),
    Sentence(r"In MuJoCo `lab-flexrrr` settles in (\d+) of (\d+) episodes of the known arm", _in_mujoco),
    Sentence(r"(\w+) environments, vectorised simulation", _count_of_environments),
    Sentence(
        r"damping ratio of ([\d.]+) %, that of the arm below, the amplitude halves only after (\d+) periods", _halving
    ),
    Sentence(r"agrees to better than a micrometre \(([\d.]+) mm\)", _agreement),
    Sentence(r"within (\d+) s the tip of a large-rotation model", _duration),
    Sentence(r"the tip of the ([\d.]+) m arm of `FlexRRR-v0`", _reach),
    Sentence(r"\(peak to peak in the last ([\d.]+) s\) are medians of (\d+) test episodes", window_and_episodes),
    Sentence(r"within ([\d.]+) mm of its target until the end of the episode of ([\d.]+) s", _slew),
)


def updated(text: str, sources: Sources) -> str:
    """Return a hand-written text with the numbers of its sentences computed from rows."""
    for sentence in (*SENTENCES, *DEFINITIONS):
        text = sentence.update(text, sources)
    return text
