"""Numbers of the README and of hand-written pages, computed from the stored rows."""

import re
from collections.abc import Callable, Iterable, Sequence
from functools import cache, cached_property
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
import yaml

from flexman_gym.common.formatting import millimetres
from flexman_gym.common.markdown import markdown_table
from flexman_gym.envs.config.named_environments import DEFAULT_ID, NAMED_ENVIRONMENTS
from flexman_gym.evaluation.agent_info import describe_agent
from flexman_gym.evaluation.metrics import METRICS
from flexman_gym.evaluation.policy_files import POLICIES
from flexman_gym.evaluation.shares import intervals_text, share_text
from flexman_gym.metrics import BAND, VIBRATION_WINDOW
from flexman_gym.model.model import build_model
from flexman_gym.model.vibration import modes
from flexman_gym.scene import catalog
from flexman_gym.toolbox.league.certificate_file import exceeded_limits
from flexman_gym.toolbox.league.standings import Standings
from flexman_gym.toolbox.precision.charts import cheapest_equal
from flexman_gym.toolbox.precision.runs import PrecisionRow
from flexman_gym.toolbox.verification.table import FAIL, PASS, VerificationRow
from studies.benchmark.measure import BenchmarkRow
from studies.control.cases import ControlRow
from studies.control.page import share_over_arms
from studies.environments.measure import LONG_NAME, Baseline
from studies.environments.overview import environments
from studies.files import read_comment, read_rows, split_waiting
from studies.learning.measure import LearningRow
from studies.machine.measure import CURRENT, FitRow
from studies.markdown import number_word
from studies.peers.measure import PAPER
from studies.results import Results
from studies.safety.measure import SafetyRow
from studies.starts.measure import COLD, WHEEL, StartRow
from studies.starts.page import total

Kind = TypeVar("Kind")
UNKNOWN = f"{DEFAULT_ID}/unknown"  # scenario with unknown payload and stiffness, and a delay
BOUNDS = ("zero", "random")  # agents of the league that are no controllers
MARKERS = "<!-- {name} -->", "<!-- end of {name} -->"  # lines above and below a generated part of the README
# information of `describe_agent` -> words of the README; a training is no information about the arm
INFORMATION = {
    "true state": "true state",
    "true parameters": "true parameters",
    "model": "nominal model",
    "structure of the model": "structure of the model",
    "data sheets": "data sheets",
    "payload class": "class of the payload",
    "its episodes": "the episodes in advance",
}
INDEPENDENT = "independent automatic-differentiation code"  # source of rows of the verification
LARGE_ROTATION = "paper FF {} foreshortening, tip within 2 s, m"  # cases of the verification
MICROMETRE = 1e-6  # m
SECOND_HUB = CURRENT, "motor_angle_2", "R2"  # row of the comparison with a real arm
MOTOR_CONTROLLERS = ("pd", "pd-shaped")  # they read motor angles only
POLICY = "a policy trained by "  # first words of the description of a policy
TITLES = {
    "adaptive-lqr": "adaptive LQR that tracks a slew",
    "adaptive-planned": "adaptive LQR, slews optimised in motion",
    "lqg": "Kalman filter and LQR that tracks a slew",
    "lqr": "LQR at the target",
    "lqr-tracking": "LQR that tracks a slew",
    "mpc": "model predictive control",
    "optimised": "fastest slews found by optimisation",
    "pd": "PD of the motors, tuned",
    "pd-torque": "PD with joint-torque feedback",
    "pd-shaped": "the PD with input shaping (ZVD)",
    "planned": "LQR, slews optimised before they start",
    "privileged-lqr": "LQR that tracks a slew",
    "privileged-planned": "LQR, slews optimised in motion",
}


class Sources:
    """Stored rows of the documentation.

    Args:
        docs: folder of the documentation; the rows may be in any folder below it.

    Attributes:
        docs: folder of the documentation.
    """

    def __init__(self, docs: Path) -> None:
        self.docs = docs

    def path(self, name: str) -> Path:
        """Return the path of the file with a name.

        Raises:
            FileNotFoundError: without such a file.
        """
        found = sorted(self.docs.rglob(name))
        if not found:
            raise FileNotFoundError(f"{name}: no such file below {self.docs}")
        return found[0]

    def rows(self, name: str, kind: type[Kind]) -> list[Kind]:
        """Return the rows of a CSV file as instances of a dataclass."""
        return read_rows(self.path(name), kind)

    def mark(self, name: str) -> str:
        """Return the end of a clause with a number of a CSV file whose rows wait for new ones; "" for other files."""
        return "; waiting for new rows" * bool(split_waiting(read_comment(self.path(name)))[1])

    @cached_property
    def results(self) -> Results:
        """Results of agents without training, as on all pages."""
        return Results(self.docs)

    @cached_property
    def standings(self) -> Standings:
        """Comparison of the agents of the league."""
        return self.results.standings

    @cached_property
    def baselines(self) -> list[Baseline]:
        """Results of baselines in environments that the league does not have."""
        return self.rows("baselines.csv", Baseline)

    @cached_property
    def safety(self) -> list[SafetyRow]:
        """Moves with the safety filter."""
        return self.rows("safety.csv", SafetyRow)

    @cached_property
    def learning(self) -> list[LearningRow]:
        """Results of training and of the baselines."""
        return self.rows("learning.csv", LearningRow)

    @cached_property
    def starts(self) -> list[StartRow]:
        """Times of a first use."""
        return self.rows("starts.csv", StartRow)

    @cached_property
    def benchmark(self) -> list[BenchmarkRow]:
        """Computing times."""
        return self.rows("benchmark.csv", BenchmarkRow)

    @cached_property
    def control(self) -> list[ControlRow]:
        """Results of controllers of uncertain arms."""
        return self.rows("control.csv", ControlRow)

    @cached_property
    def peers(self) -> list[PrecisionRow]:
        """Errors and costs of our methods and of other simulators."""
        return self.rows("peers.csv", PrecisionRow)

    @cached_property
    def machine(self) -> list[FitRow]:
        """Comparison with measurements of a real arm."""
        return self.rows("machine.csv", FitRow)

    @cached_property
    def verification(self) -> list[VerificationRow]:
        """Comparisons of the verification."""
        return self.rows("verification.csv", VerificationRow)


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


def _reach(sources: Sources) -> tuple[str]:
    """Return the reach of the arm of the default environment, m."""
    return (f"{sum(link.length for link in NAMED_ENVIRONMENTS[DEFAULT_ID].arm.links):g}",)


def _slew(sources: Sources) -> tuple[str, str]:
    """Return the tolerance of a slew of the default environment, mm, and the length of an episode, s."""
    return f"{1e3 * BAND * float(_reach(sources)[0]):.3g}", f"{NAMED_ENVIRONMENTS[DEFAULT_ID].horizon:g}"


def _medians(sources: Sources) -> tuple[str, str]:
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
    """Return violations, moves and largest excess (%) of the safety filter with known and with uncertain parameters."""
    result: list[str] = []
    for condition in ("nominal", "uncertain"):
        rows = [row for row in sources.safety if row.condition == condition]
        counts = (sum(getattr(row, name) for row in rows) for name in ("violations", "moves"))
        result += [f"{count:.0f}" for count in counts] + [f"{100.0 * max(row.largest for row in rows):.2g}"]
    return tuple(result)


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
    return f"{1e3 * rows[0].total_error:.2g}", f"{1e3 * rows[0].cpu:.2g}", f"{equal.cpu / rows[0].cpu:.2g}"


def _exceeded(sources: Sources) -> tuple[str, str]:
    """Return the number of shipped policies that exceed a limit of their certificates, and that of all."""
    return str(sum(bool(exceeded_limits(name)) for name in POLICIES)), str(len(POLICIES))


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
        r"(\d+) of (\d+) moves of the known arm, by up to ([\d.]+) %, "
        r"and (\d+) of (\d+) with all parameters uncertain, by up to ([\d.]+) %",
        _violations,
    ),
    Sentence(
        r"with (\d+) random arms and uncertain parameters `adaptive-lqr` settles ([^)]*\)) of the slews, "
        r"and at least 90 % with (\d+) of the arms",
        _random_arms,
    ),
    Sentence(r"\*\*Friction in no model\*\*: with it ([^)]*\)) of (\d+) slews settle", _unmodelled_friction),
    Sentence(
        r"errs by ([\d.]+) mm at ([\d.]+) ms of computing time per simulated second; "
        r"the quickest other simulator as accurate takes ([\d.]+) times as long",
        _default_cost,
    ),
    Sentence(r"the second hub angle of a Quanser arm is not predicted \(R2 (-[\d.]+)", _second_hub),
    Sentence(r"The PD settles after ([\d.]+) s", _pd_settles),
)
DEFINITIONS = (  # with numbers of environments, metrics, cases of the verification, certificates and other plants
    Sentence(r"(\d+) of (\d+) exceed one of the limits", _exceeded),
    Sentence(r"In MuJoCo `lab-flexrrr` settles in (\d+) of (\d+) episodes of the known arm", _in_mujoco),
    Sentence(r"(\w+) environments, vectorised simulation", _count_of_environments),
    Sentence(
        r"damping ratio of ([\d.]+) %, that of the arm below, the amplitude halves only after (\d+) periods", _halving
    ),
    Sentence(r"agrees to better than a micrometre \(([\d.]+) mm\)", _agreement),
    Sentence(r"within (\d+) s the tip of a large-rotation model", _duration),
    Sentence(r"the tip of the ([\d.]+) m arm of `FlexRRR-v0`", _reach),
    Sentence(r"\(peak to peak in the last ([\d.]+) s\) are medians of (\d+) test episodes", _medians),
    Sentence(r"within ([\d.]+) mm of its target until the end of the episode of ([\d.]+) s", _slew),
)


@cache
def _information(agent: str) -> tuple[str, tuple[str, ...], bool]:
    """Return the description of an agent, its information, and whether it does without oracle information."""
    info = describe_agent(agent)
    return info.description, info.information, info.realisable


def updated(text: str, sources: Sources) -> str:
    """Return a hand-written text with the numbers of its sentences computed from rows."""
    for sentence in (*SENTENCES, *DEFINITIONS):
        text = sentence.update(text, sources)
    return text


def replaced_part(text: str, name: str, lines: Iterable[str]) -> str:
    """Return a page with new lines between the markers of a generated part; ValueError without these markers."""
    above, below = (marker.format(name=name) for marker in MARKERS)
    head, first, rest = text.partition(above)
    _, last, tail = rest.partition(below)
    if not (first and last):
        raise ValueError(f"no lines {above} and {below}")
    return "\n".join([head + above, *lines, below + tail])


def readme(text: str, sources: Sources, settings: Path) -> str:
    """Return the README with its generated parts and the numbers of its sentences.

    Args:
        text: the README.
        sources: stored rows.
        settings: mkdocs.yml, with the address of the repository, the DOI and the badges.

    Returns:
        The README.

    Raises:
        ValueError: if the markers of a generated part are missing.
    """
    parts = {
        "badges": badges(yaml.safe_load(settings.read_text(encoding="utf-8"))),
        "results": [*results(sources.standings), "", intervals_text(int(_medians(sources)[1]))],
        "environments": environments(),
    }
    for name, lines in parts.items():
        text = replaced_part(text, name, lines)
    return updated(text, sources)


def badges(settings: dict[str, Any]) -> list[str]:
    """Return the line with badges, repository and DOI; no line while all these settings are empty."""
    extra = settings.get("extra") or {}
    address, doi = settings.get("repo_url") or "", extra.get("doi") or ""
    shown = [f"![badge]({each})" for each in extra.get("badges") or ()]
    shown += [f"[Repository]({address})"] if address else []
    shown += [f"[DOI {doi}](https://doi.org/{doi})"] if doi else []
    return [" ".join(shown)] if shown else []


def results(standings: Standings) -> list[str]:
    """Return the table of the agents in the default environment, with known and with unknown parameters.

    Agents without oracle information come first, then the agents with the largest share and the shortest time of
    settling for unknown parameters. An agent without rows in one of the two scenarios has no row.
    """
    agents = [each for each in dict.fromkeys(agent for _, agent, _ in standings.results.cells)
              if each not in BOUNDS and not standings.why(each, DEFAULT_ID) + standings.why(each, UNKNOWN)]  # fmt: skip
    agents.sort(key=lambda each: (_information(each)[2], standings.settled(each, UNKNOWN)), reverse=True)
    heads = ("agent", "given", "known arm: settled", "vibration", "unknown arm: settled", "vibration")
    return markdown_table(heads, ([f"`{each}`: {title(each)}", given(each), *_cells(standings, each, DEFAULT_ID),
                                   *_cells(standings, each, UNKNOWN)] for each in agents))  # fmt: skip


def title(agent: str) -> str:
    """Return the kind of an agent: method of the training and base controller for a policy."""
    description = _information(agent)[0]
    trained, _, base = description.removeprefix(POLICY).partition(", with the base controller ")
    if description.startswith(POLICY):
        return f"{trained} on `{base}`" if base else trained
    return TITLES.get(agent) or description.partition(",")[0]


def given(agent: str) -> str:
    """Return the information that an agent is given: its sensors first."""
    information = _information(agent)[1]
    names = [each for each in INFORMATION if each in information]
    if "true parameters" in names:
        names.remove("model")  # its parameters are the true ones
    sensors = "laboratory sensors" if information and agent not in MOTOR_CONTROLLERS else "motor angles"
    return ", ".join([*([] if "true state" in names else [sensors]), *(INFORMATION[each] for each in names)])


def _cells(standings: Standings, agent: str, scenario: str) -> Iterable[str]:
    """Return share of settled episodes with the median settling time, and the median vibration."""
    values = np.array([*standings.values(agent, scenario, "vibration").values()])
    return standings.settling_text(agent, scenario), millimetres(METRICS["vibration"].aggregate(values))
