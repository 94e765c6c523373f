"""Page of the learning study: recipes, other tasks, robustness and ablations."""

import math
from collections.abc import Callable, Iterable, Sequence
from statistics import median

from flexman_gym.common.markdown import markdown_table
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.metrics import task_metrics
from flexman_gym.evaluation.rollout import SELECTION_SEEDS, TEST_SEEDS, TRAINING_SEEDS_STRIDE
from studies.learning.measure import (
    ABLATED,
    ABLATION_SEEDS,
    ABLATIONS,
    AS_TRAINED,
    EVALUATED_IN,
    FINER,
    FINER_ELEMENTS,
    FINER_STEPS,
    LONG,
    LONGER,
    SEEDS,
    TASKS,
    LearningRow,
)
from studies.markdown import bullets

PAGE = """# Results of the recipes

This page has the results of PPO and SAC with the shipped recipes, over several seeds, on held-out test episodes. Added
to a PD that settles none of the slews, PPO settles nearly all of them after one to two minutes of training on one core;
longer training reduces settling times and tip errors. The fastest policy shapes the reference of a tracking controller,
and a student with the measurements of a laboratory settles nearly every uncertain arm, but later. The policies settle
as often on a finer model. Without the held action, the decreasing learning rate, the sloped reward or the short horizon
every metric is worse.

`python scripts/learning.py` trains the recipes of `agents/recipes`, one run after the other, and rewrites this page and
its rows ([learning.csv](evidence/learning.csv)). Existing runs in `runs/learning` are only evaluated again.

Computed with {computer}. CPU times are those of one core, including updates, environment and evaluation.

All metrics are those of {count} test episodes, seeds {test}, which were not used for any choice.
Runs with evaluations during training keep their best policy on the episodes {selection}; settings were also chosen on
these. Training seeds start at {training}.
A tip has settled if it stays within 0.235 % of the reach around its target for at least the last second.
This is 20 mm for `FlexRRR-v0`. The columns are:

{columns}

## Recipes

Each recipe is evaluated in its training environment, except {elsewhere}.

{recipes}

## Controllers without learning

These controllers are given the model; the linear-quadratic regulators also use its true state.

{controllers}

## Other tasks and arms

Compared are a PD, the policy trained for the task, and a model-based controller.
The metric of tracking and holding tasks is the median RMS error, that of slews the share settled and the median time.
Recipes are medians over the seeds. *Relative to PD* is the metric of the policy divided by that of the PD.

{tasks}

{why}

## Rejected variants

These variants were trained with one seed each and evaluated on the selection seeds, on which `ppo_shaping` takes 2.38 s
and `lab_ppo_shaping` 3.02 s.

{tried}

## Robustness to the model

The same policies were evaluated on a finer model ({elements} elements per link with all coordinates, foreshortening,
and {steps} times as many steps) and on the default model in episodes of {long:g} s.
The cells are settled, time (s), vibration (mm) and error (mm).

{leaning}

## Ablations

The recipe `{ablated}` was trained without one of its settings, {ablation_seeds} seeds each.
The cells are medians over the seeds, with the worst seed in brackets.
If removing a setting changes nothing, the setting is redundant.

{ablations}
"""
TRIED = (
    ("`ppo_shaping` with half the arms and half the actions", "2.38 s, slower on other episodes", 729),
    ("`ppo_shaping` with half the arms and twice the pairs", "2.50 s", 1450),
    ("`ppo_shaping` with half the actions and the sloped reward", "2.42 s", 435),
    ("`ppo_shaping` with half the actions and four times the weight of the goal", "2.40 s", 420),
    ("`ppo_shaping` with half the actions, the sloped reward, torques to 0.01 % of the path", "2.52 s", 435),
    ("`ppo_shaping` with half the actions, the sloped reward, thrice the offsets", "slower at every stage", 300),
    ("`ppo_shaping` with 1.5 times the actions and the sloped reward", "2.58 s", 900),
    ("`ppo_shaping` with 2.5 times the actions and more exploration noise", "2.56 s, with more reward", 1539),
    ("`ppo_shaping` with a regulator of lower gains", "2.52 s", 620),
    (
        "SAC with the actions of `ppo_shaping`",
        "the policy degrades the controller at first: reward 11 instead of 45",
        460,
    ),
    ("`lab_ppo_shaping` with half the arms and half the actions", "3.12 s", 724),
    ("`lab_ppo_shaping` with half the arms, a regulator of lower gains and smaller actions", "3.08 s", 823),
    (
        "`lab_ppo_shaping` with the regulator of higher gains",
        "2.94 s; with friction a third of the episodes fail",
        1245,
    ),
    ("`ppo_on_pd` with learned exploration noise", "100 %, 4.22 s, 0.12 mm", 264),
    ("`lab_student` with a teacher that replans the timing of its slews", "83 % settle", 240),
    ("`lab_student` with episodes of 6 s instead of 9 s", "91 % settle", 240),
    ("PPO on a PD under `unknown-lab`, measurements of 6 actions", "no episode settles, 242 mm", 100),
)
WHY = (
    "In `FlexPlanar-v0` the PD is near the limit of the motors, and no policy halves its settling time.",
    "In `FlexRRR-Gravity-v0` and `FlexPlanar-Hold-v0` a million actions are not enough to halve the metric of the PD.",
    "Under `unknown-lab` a policy shapes the reference of the adaptive LQR for fixed goals. It was trained without "
    "gravity; with gravity the adaptive LQR alone settles more arms.",
    "For moving goals there is no slew to shape, and no policy was trained for planar arms. There the adaptive LQR is "
    "used alone.",
    "PPO on a PD with the measurements of a laboratory settled no slew after half a million actions.",
)
COLUMNS = {
    "settled": "share of episodes that settle",
    "time": "median settling time, infinite for episodes that do not settle, and its bootstrap interval",
    "vibration": "median peak-to-peak motion of the tip in the last 3 s along the worst axis",
    "error": "median distance of the tip from its target in the last second",
    "effort": "mean square of the commanded torques relative to their limits",
    "roughness": "RMS change of the relative torques from period to period; - if not recorded",
    "failed": "share of episodes terminated by a limit",
}


def page(rows: Sequence[LearningRow], computer: str) -> str:
    """Return the page as Markdown."""
    return PAGE.format(
        computer=computer,
        count=len(TEST_SEEDS),
        test=f"{TEST_SEEDS.start} to {TEST_SEEDS.stop - 1}",
        selection=f"{SELECTION_SEEDS.start} to {SELECTION_SEEDS.stop - 1}",
        training=TRAINING_SEEDS_STRIDE,
        columns="\n".join(bullets(f"{name}: {meaning}" for name, meaning in COLUMNS.items())),
        elsewhere=", ".join(f"`{name}` in `{scenario}`" for name, scenario in EVALUATED_IN.items()),
        recipes="\n".join(_recipes(rows)),
        controllers="\n".join(_controllers(rows)),
        tasks="\n".join(_tasks(rows)),
        why="\n".join(WHY),
        tried="\n".join(markdown_table(("variant", "result", "CPU, s"), TRIED)),
        elements=FINER_ELEMENTS,
        steps=FINER_STEPS,
        long=LONG,
        leaning="\n".join(_leaning(rows)),
        ablated=ABLATED,
        ablation_seeds=ABLATION_SEEDS,
        ablations="\n".join(_ablations(rows)),
    )


def _of(rows: Iterable[LearningRow], kind: str, name: str, where: str = AS_TRAINED) -> list[LearningRow]:
    return [row for row in rows if (row.kind, row.name, row.where) == (kind, name, where)]


def _recipes(rows: Sequence[LearningRow]) -> list[str]:
    heads = ("recipe", "seed", "actions", "CPU, s", "actions per second", "in the environment", *FIGURES)
    result = [row for name in SEEDS for row in _of(rows, "recipe", name)]
    return markdown_table(heads, ((row.name, f"{row.seed:.0f}", *_cost(row), *_figures(row)) for row in result))


def _cost(row: LearningRow) -> tuple[str, ...]:
    return f"{row.steps:,.0f}", f"{row.cpu:.0f}", f"{row.rate:,.0f}", "-" if row.share is None else f"{row.share:.0%}"


FIGURES = ("settled", "time, s", "vibration, mm", "error, mm", "reward", "effort", "roughness", "failed")


def _figures(row: LearningRow) -> tuple[str, ...]:
    return (
        f"{row.settled:.0%}",
        f"{_number(row.time)} ({_number(row.time_low)} to {_number(row.time_high)})",
        _number(1e3 * row.vibration),
        _number(1e3 * row.error),
        f"{row.reward:.0f}",
        f"{row.effort:.3f}",
        "-" if row.roughness is None else f"{row.roughness:.3f}",
        f"{row.failed:.0%}",
    )


def _controllers(rows: Sequence[LearningRow]) -> list[str]:
    result = [row for row in rows if row.kind == "controller" and row.where == AS_TRAINED]
    return markdown_table(("controller", *FIGURES), ((row.name, *_figures(row)) for row in result))


def _tasks(rows: Sequence[LearningRow]) -> list[str]:
    lines = []
    for scenario, (learned, law) in TASKS.items():
        own = {name: _of(rows, "task", f"{name}, {scenario}") for name in ("pd", law, learned)}
        own[learned] = own[learned] or _of(rows, "recipe", learned)
        if own["pd"] and own[law]:
            follows = _follows(Configuration.find(scenario))
            pd, best, reached = (_task(own[name], follows) for name in ("pd", law, learned))
            part = f"{reached[1] / pd[1]:.2f}" if own[learned] and math.isfinite(pd[1]) else "-"
            name = f"`{learned}`: {reached[0]}" if own[learned] else "-"
            lines.append((f"`{scenario}`", pd[0], name, part, f"`{law}`: {best[0]}"))
    return markdown_table(("scenario", "PD", "policy", "relative to PD", "model-based"), lines)


def _follows(scenario: Configuration) -> bool:
    """Return whether the task is evaluated by the RMS error (tracking, holding) instead of the settling time."""
    return any(figure.name == "rms_error" for figure in task_metrics(scenario.task))


def _task(rows: Sequence[LearningRow], follows: bool) -> tuple[str, float]:
    """Return the metric of a task as text and number, the median over the seeds."""
    if not rows:
        return "", math.nan
    if follows:
        error = median(row.rms or 0.0 for row in rows)
        return f"{1e3 * error:.3g} mm", error
    time, settled = median(row.time for row in rows), median(row.settled for row in rows)
    return f"{settled:.0%}, {_number(time)} s" if math.isfinite(time) else f"{settled:.0%}", time


def _leaning(rows: Sequence[LearningRow]) -> list[str]:
    cells: dict[tuple[str, str], dict[str, str]] = {}
    for row in rows:
        if row.kind in ("recipe", "controller"):
            seed = "" if row.seed is None else f"{row.seed:.0f}"
            cells.setdefault((row.name, seed), {})[row.where] = _short(row)
    places = (AS_TRAINED, FINER, LONGER)
    lines = ((*key, *(result.get(where, "") for where in places)) for key, result in cells.items())
    return markdown_table(("policy", "seed", *places), lines)


def _short(row: LearningRow) -> str:
    return f"{row.settled:.0%} · {_number(row.time)} · {_number(1e3 * row.vibration)} · {_number(1e3 * row.error)}"


def _ablations(rows: Sequence[LearningRow]) -> list[str]:
    lines = []
    if whole := _of(rows, "recipe", ABLATED)[:ABLATION_SEEDS]:
        lines.append(_line("nothing", "the recipe as it is", whole))
    for name, without in ABLATIONS.items():
        if result := _of(rows, "ablation", name):
            lines.append(_line(without.means, without.instead, result))
    heads = ("without", "instead", "actions", "CPU, s", "settled, %", "time, s", "vibration, mm", "error, mm")
    return markdown_table(heads, lines)


def _line(means: str, instead: str, result: Sequence[LearningRow]) -> tuple[str, ...]:
    cells = [_spread(result, value, worst) for value, worst in SPREADS]
    return means, instead, f"{result[0].steps:,.0f}", f"{median(row.cpu or 0.0 for row in result):.0f}", *cells


SPREADS: tuple[tuple[Callable[[LearningRow], float], Callable[[Iterable[float]], float]], ...] = (
    (lambda row: 100.0 * row.settled, min),
    (lambda row: row.time, max),
    (lambda row: 1e3 * row.vibration, max),
    (lambda row: 1e3 * row.error, max),
)


def _spread(
    rows: Sequence[LearningRow], value: Callable[[LearningRow], float], worst: Callable[[Iterable[float]], float]
) -> str:
    values = [value(row) for row in rows]
    return f"{_number(median(values))} ({_number(worst(values))})"


def _number(value: float) -> str:
    return f"{value:.3g}" if math.isfinite(value) else "-"
