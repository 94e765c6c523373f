"""Page of the learning study: results of the recipes, limits of the shipped policies, ablations."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import median
from string import Template
from textwrap import fill
from typing import Any

from flexman_agents.settings import find_recipe
from flexman_gym.common.formatting import millimetres
from flexman_gym.common.markdown import markdown_table
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.evaluation.agent_info import describe_agent, information_kind, policy_information
from flexman_gym.evaluation.policy_files import POLICIES, policy_folder, read_policy
from flexman_gym.evaluation.rollouts import TEST_SEEDS
from flexman_gym.evaluation.shares import intervals_text
from flexman_gym.toolbox.league import certificate
from flexman_gym.toolbox.league.certificate_file import read_certificate
from flexman_gym.toolbox.league.scenarios import change_name
from studies.environments.measure import Baseline
from studies.files import split_waiting
from studies.learning.algorithms import AlgorithmRow
from studies.learning.algorithms_page import comparison, references
from studies.learning.measure import (
    ABLATED,
    ABLATION_SEEDS,
    ABLATIONS,
    AS_TRAINED,
    FINER,
    FINER_ELEMENTS,
    FINER_STEPS,
    LONG,
    LONGER,
    SEEDS,
    TASKS,
    LearningRow,
    environment,
)
from studies.markdown import bullets
from studies.results import Results

TEMPLATE = Path(__file__).parent / "results.md"  # string.Template
CHANGE_NAMES = {  # end of the name of a scenario -> row of the table of policies
    "@finer": "finer model", "@mujoco": "arm in MuJoCo", "payload": "payload, kg", "stiffness": "stiffness, factor",
    "friction=1": "friction", "seeds": "further episodes",
}  # fmt: skip
REACH = 8.5  # m; reach for which the page gives the limits of vibration
SLEWS = {  # environment -> controllers without learning, recipes
    "FlexRRR-v0": (("pd", "lqr", "lqr-tracking"),
                   ("ppo_on_pd_minute", "ppo_on_pd", "sac_on_pd", "ppo_alone", "ppo_shaping")),
    "FlexRRR-v0/unknown-lab": (("adaptive-lqr",), ("lab_student", "lab_ppo_shaping")),
    "FlexPlanar-v0": (("pd", "lqr-tracking"), ("planar_ppo_on_pd",)),
    "FlexRRR-Gravity-v0": (("pd", "lqr-tracking"), ("gravity_ppo_on_pd",)),
}  # fmt: skip
MOVING = tuple(
    scenario for scenario in TASKS if ("-Track-" in scenario or "-Hold-" in scenario) and "/" not in scenario
)


def page(rows: Sequence[LearningRow], computer: str, results: Results, compared: Sequence[AlgorithmRow]) -> str:
    """Return the page as Markdown.

    Args:
        rows: rows of the recipes, controllers and tasks.
        computer: computer of these rows.
        results: results of controllers, as on the other pages.
        compared: rows of the comparison of algorithms.
    """
    rows = [_known(row, results) for row in rows]
    return Template(TEMPLATE.read_text(encoding="utf-8")).substitute(
        opening=_opening(rows),
        count=len(TEST_SEEDS),
        intervals=intervals_text(len(TEST_SEEDS)),
        test=f"{TEST_SEEDS.start} to {TEST_SEEDS.stop - 1}",
        slews=_body(7, _slews(rows)),
        footnote=_footnote(results.long),
        algorithms=fill(f"{comparison(compared)} {references(compared)}", 118),
        robustness=_robustness(rows),
        moving=_body(4, _moving(rows)),
        min_settled=f"{100 * certificate.MIN_SETTLED:.0f}",
        ratio=certificate.MAX_SETTLING_RATIO,
        vibration=f"{1e3 * certificate.MAX_VIBRATION * REACH:.3g}",
        increase=f"{1e3 * certificate.MAX_VIBRATION_INCREASE * REACH:.3g}",
        draws=certificate.SEARCH_EPISODES,
        names=" | ".join(f"`{name}`" for name in POLICIES),
        policies=_body(1 + len(POLICIES), _policies()),
        counts=_counts(),
        waiting=_waiting(),
        ablated=ABLATED,
        ablation_seeds=ABLATION_SEEDS,
        ablations="\n".join(bullets(_ablations(rows))),
        long=f"{LONG:g}",
        computer=computer,
    )


def _body(columns: int, rows: Iterable[Iterable[object]]) -> str:
    """Return the lines of a table below its header, which is in the template."""
    return "\n".join(markdown_table(["---"] * columns, rows)[1:])


def _of(rows: Iterable[LearningRow], kind: str, name: str, where: str = AS_TRAINED) -> list[LearningRow]:
    return [row for row in rows if (row.kind, row.name, row.where) == (kind, name, where)]


def _known(row: LearningRow, results: Results) -> LearningRow:
    """Return the row of a controller with the numbers that all pages have; other rows as they are."""
    agent, _, scenario = row.name.partition(", ")
    known = results.find(agent, scenario) if scenario and row.where == AS_TRAINED else None
    if known is None:
        return row
    return replace(row, settled=known.settled, time=known.settling_time, vibration=known.vibration, rms=known.rms_error,
                   failed=known.failed)  # fmt: skip


def _controller(rows: Sequence[LearningRow], name: str, scenario: str, where: str = AS_TRAINED) -> list[LearningRow]:
    """Return the row of a controller without learning."""
    return _of(rows, "controller", f"{name}, {scenario}", where) or _of(rows, "task", f"{name}, {scenario}", where)


def _opening(rows: Sequence[LearningRow]) -> str:
    """Return the first sentences, with the numbers of the rows."""
    (pd,) = _controller(rows, "pd", "FlexRRR-v0")
    minute, more, shaped, lab = (
        _of(rows, "recipe", name) for name in (ABLATED, "ppo_on_pd", "ppo_shaping", "lab_ppo_shaping")
    )
    return fill(
        f"Added to a PD that settles {100 * pd.settled:.0f} % of the slews of `FlexRRR-v0` in time, PPO settles "
        f"{_range(minute, _settled)} % after {_range(minute, _minutes)} minutes of training on one core, and "
        f"{_range(more, _settled)} % within {_range(more, _time)} s (median) after {_range(more, _minutes)} minutes. "
        f"The fastest policy changes the reference of a tracking controller, and settles in {_range(shaped, _time)} s. "
        f"With the measurements of a laboratory and an unknown arm, a policy of this kind settles "
        f"{_range(lab, _settled)} % in {_range(lab, _time)} s.",
        118,
    )


def _settled(row: LearningRow) -> str:
    return f"{100 * row.settled:.0f}"


def _time(row: LearningRow) -> str:
    return f"{row.time:.2f}" if math.isfinite(row.time) else "-"


def _minutes(row: LearningRow) -> str:
    return "-" if row.cpu is None else f"{row.cpu / 60:.1f}"


def _vibration(row: LearningRow) -> str:
    return millimetres(row.vibration).removesuffix(" mm")


def _range(rows: Sequence[LearningRow], text: Callable[[LearningRow], str]) -> str:
    """Return the smallest and the largest value of the rows."""
    texts = sorted(map(text, rows), key=_sortable)
    return texts[0] if texts[0] == texts[-1] else f"{texts[0]} to {texts[-1]}"


def _sortable(text: str) -> float:
    return float(text.removeprefix("below ")) if text != "-" else math.inf


def _spread(rows: Sequence[LearningRow], text: Callable[[LearningRow], str]) -> str:
    """Return the median of the rows, and their range in brackets if it is not a single value."""
    texts, span = sorted(map(text, rows), key=_sortable), _range(rows, text)
    middle = texts[len(texts) // 2]
    return middle if span == middle else f"{middle} ({span})"


def _slews(rows: Sequence[LearningRow]) -> list[tuple[str, ...]]:
    """Return the rows of the table of slews."""
    lines = []
    for scenario, (controllers, recipes) in SLEWS.items():
        found = [(name, _controller(rows, name, scenario), describe_agent(name).information) for name in controllers]
        for name in recipes:
            settings = find_recipe(name)
            needed = policy_information(settings.environment, settings.base_in_use)
            found.append((name, _of(rows, "recipe", name), needed))
        for name, result, needed in found:
            if result:
                count = f" ({len(result)})" if len(result) > 1 else ""
                settled, *cells = (_spread(result, text) for text in (_settled, _time, _vibration, _minutes))
                lines.append((f"`{name}`{count}", scenario, information_kind(needed), f"{settled} %", *cells))
    return lines


def _footnote(long: Baseline) -> str:
    """Return when the PD settles in episodes that last longer."""
    horizon = NAMED_ENVIRONMENTS["FlexRRR-v0"].horizon
    return fill(
        f"The PD needs more than the {horizon:g} s of an episode of `FlexRRR-v0`: in episodes of {LONG:g} s it settles "
        f"{100 * long.settled:.0f} %, half of them after {long.settling_time:.1f} s.",
        118,
    )


def _robustness(rows: Sequence[LearningRow]) -> str:
    """Return the largest changes of the results of recipes for slews on a finer model and in longer episodes."""
    sentences = []
    finer = f"On a finer model ({FINER_ELEMENTS} elements per link, all coordinates, {FINER_STEPS} times as many steps)"
    names = [
        name for name in SEEDS if environment(name) not in MOVING and name not in ("lab_ppo_shaping", "lab_student")
    ]
    for where, place in ((FINER, finer), (LONGER, f"in episodes of {LONG:g} s")):
        pairs = [pair for name in names
                 for pair in zip(_of(rows, "recipe", name), _of(rows, "recipe", name, where), strict=True)]  # fmt: skip
        share = max(100 * abs(own.settled - other.settled) for own, other in pairs)
        time = max(abs(own.time - other.time) for own, other in pairs)
        change = f"changes by at most {time:.2g} s" if time else "does not change"
        share_text = f"the settled share changes by at most {share:.0f} % of the episodes"
        sentences.append(f"{place} {share_text}, the median settling time {change}")
    return fill(f"{'; '.join(sentences)} (all recipes for slews with the true state).", 118)


def _moving(rows: Sequence[LearningRow]) -> list[tuple[str, ...]]:
    """Return the rows of the table of moving goals, with the information that is not measured on hardware."""
    lines: list[tuple[str, ...]] = []
    for scenario in MOVING:
        learned, law = TASKS[scenario]
        own = _of(rows, "recipe", learned) or _of(rows, "task", f"{learned}, {scenario}")
        cells = [(f"`{learned}`: ", own), ("", _controller(rows, "pd", scenario)),
                 (f"`{law}`: ", _controller(rows, law, scenario))]  # fmt: skip
        policy, pd, best = (f"{name}{millimetres(median(row.rms or 0.0 for row in found))}" for name, found in cells)
        lines.append((f"`{scenario}`", pd, policy, best))
    return lines


def _policies() -> list[tuple[str, ...]]:
    """Return the rows of the table of shipped policies: recipe, environment, and the outcome of each change."""
    about = [read_policy(_folder(name)).metadata for name in POLICIES]
    outcomes = [_outcomes(name) for name in POLICIES]
    changes = dict.fromkeys(change for each in outcomes for change in each)
    return [
        ("recipe", *(f"`{each['recipe']['name']}`" for each in about)),
        ("environment", *(f"`{each['league']['environment']}`" for each in about)),
        *((CHANGE_NAMES.get(change, change.replace("=", " ")), *(each.get(change, "-") for each in outcomes))
          for change in changes),
    ]  # fmt: skip


def _outcomes(name: str) -> dict[str, str]:
    """Return change -> "yes" within the limits, otherwise the first value beyond a limit; ranges stand before it."""
    first, *changed = _certificate(name)["rows"]
    limit = f" (limit {certificate.MIN_SETTLED:.0%})"  # the same for all
    outcomes = {}
    for row in changed:
        if not certificate.is_counted(row["scenario"]):
            continue
        same_seeds = row["seeds"][0] == first["seeds"][0] or "@" in row["scenario"]
        change = change_name(row["scenario"]) if same_seeds else "seeds"
        parameter, _, value = change.partition("=")
        outcome = str(row["fails"]).partition(", ")[0].removesuffix(limit) if row["fails"] else "yes"
        if ":" in value:
            change, outcome = parameter, f"{value.replace(':', ' to ')}: {outcome}"
        outcomes[change] = outcome
    return outcomes


def _counts() -> str:
    """Return the numbers of episodes of the certificates."""
    counts: dict[int, set[str]] = {}
    for name in POLICIES:
        for row in _certificate(name)["rows"]:
            plant = row["scenario"].partition("@")[2]
            counts.setdefault(row["seeds"][1] - row["seeds"][0], set()).add(CHANGE_NAMES.get(f"@{plant}", ""))
    few = {count: plants for count, plants in counts.items() if "" not in plants}
    usual = min(count for count in counts if count not in few)
    exceptions = "; ".join(f"{', '.join(sorted(plants))} {count}" for count, plants in sorted(few.items()))
    return f"{usual} test episodes for each change{f' ({exceptions})' if exceptions else ''}"


def _waiting() -> str:
    """Return the policies whose certificates wait for new rows; "" if there are none."""
    waits = ((name, split_waiting(_certificate(name)["computer"].get("flexman_gym", ""))[1]) for name in POLICIES)
    reasons = [f"*Waiting for new rows: `{name}`, as {reason}.*\n\n" for name, reason in waits if reason]
    return "".join(fill(each, 118, replace_whitespace=False) + "\n\n" for each in reasons)


def _folder(name: str) -> Path:
    """Return the folder of a shipped policy."""
    folder = policy_folder(name)
    assert folder is not None
    return folder


def _certificate(name: str) -> dict[str, Any]:
    """Return the certificate of a shipped policy."""
    result = read_certificate(_folder(name))
    assert result is not None
    return result


def _ablations(rows: Sequence[LearningRow]) -> list[str]:
    """Return a line for the whole recipe and for each ablation."""
    whole = _of(rows, "recipe", ABLATED)[:ABLATION_SEEDS]
    lines = [f"the whole recipe: {_line(whole)}"] if whole else []
    for name, without in ABLATIONS.items():
        if result := _of(rows, "ablation", name):
            lines.append(f"without {without.means} ({without.instead}): {_line(result)}")
    return [fill(line, 116, subsequent_indent="  ") for line in lines]


def _line(rows: Sequence[LearningRow]) -> str:
    """Return the medians over the seeds."""
    settled, time, vibration = (median(values) for values in zip(
        *((100 * row.settled, row.time, 1e3 * row.vibration) for row in rows), strict=True))  # fmt: skip
    return f"{settled:.0f} % settle, {time:.2f} s, vibration {vibration:.2g} mm"
