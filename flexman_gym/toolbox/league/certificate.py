"""Certificate: robustness report of an agent under changed physics, parameters, delays and noise, with a verdict.

The limits are set in advance: they depend on the length of the arm and, for the settling time and for other simulations
of the arm, on the episodes in the environment of the training. A change of the arm counts for the verdict if the
controller is given the changed range, as an engineer knows the payloads, delays and sensors of a machine. Changes that
are not given are run as well; they show how robust the controller is, and do not count.
"""

import json
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from flexman_gym.common.computer import computer_info
from flexman_gym.common.errors import value_error
from flexman_gym.common.files import check_output, write_atomically
from flexman_gym.common.formatting import millimetres
from flexman_gym.common.parallel import Workers
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.envs.registration import NOMINAL
from flexman_gym.envs.tasks import plain_task
from flexman_gym.evaluation.agent_spec import INTERFACE
from flexman_gym.evaluation.agents import find_agent
from flexman_gym.evaluation.metrics import LIMIT_METRICS, METRICS, task_metrics
from flexman_gym.evaluation.policy_files import policy_folder, read_policy
from flexman_gym.evaluation.rollouts import TEST_SEEDS
from flexman_gym.toolbox.league.certificate_file import CERTIFICATE
from flexman_gym.toolbox.league.rows import LIMITED, VALUES, EpisodeRow, run_league
from flexman_gym.toolbox.league.scenarios import CHANGES, GIVEN, PLANTS, check_mujoco, find_scenario
from flexman_gym.toolbox.league.worst_case import worst_case

FOLDER = Path("out/certificates")  # rows of the scenarios, in a folder for each policy
MIN_SETTLED = 0.95  # required share of settled episodes
MAX_SETTLING_RATIO = 1.3  # largest median settling time / that in the environment of the training
MAX_VIBRATION = 5e-3 / 8.5  # fraction of the reach; largest median vibration, 5 mm for the arm of 8.5 m
MAX_VIBRATION_INCREASE = 1e-3 / 8.5  # fraction of the reach; largest increase of the median vibration on another plant
SEARCH_EPISODES, SEARCH_SEED = (
    1000,
    50_000,
)  # number and first seed of the episodes searched for the worst ones
LISTED_EPISODES = 5  # number of the worst episodes in the certificate
METRIC_NAMES = ("settled", "settling_time", "vibration", "error", "roughness", "failed")
METHOD = "gauss_2"  # integration method of a different order than the default method
OTHER_PLANTS = {"finer": len(TEST_SEEDS), "mujoco": 8}  # plant -> largest number of episodes
DELAYS, NOISES = (0, 1, 2, 3), (0.001, 0.003)  # control periods; fractions of the ranges of the sensors
RANGE_EXTENSION = 0.25  # extension of a range beyond the range of the training, as a fraction of the range


def certify(
    name: str, seeds: range = TEST_SEEDS, draws: int = SEARCH_EPISODES, folder: Path = FOLDER, jobs: Workers | int = 1,
    log: Callable[[str], None] = print,
) -> Path:  # fmt: skip
    """Run a policy in the scenarios of its certificate and write `certificate.json` to its folder; return the path.

    The entry "rows" has the metrics of each scenario, and under "fails" of a row its values beyond a limit, with the
    limits. The entry "fails" has the names of the scenarios that count and exceed a limit, with their seeds. All
    scenarios count but for changes without "+given", where the controller is designed for the environment before the
    change. In the last row, the search for the worst episodes, "worst" has the worst random episodes, and "worst_case"
    the physical parameters, start and goal with the largest final error found by gradient ascent, see `worst_case`. The
    entry "left_out" has the scenario of MuJoCo, and the reason, for an arm that MuJoCo cannot simulate.

    Limits of each scenario: at least 95 % of the episodes settle; no episode ends at a limit of the environment, or
    exceeds a recorded limit (the row then has the LIMIT_METRICS, such as the largest excess); the median settling time
    is at most 1.3 times that in the environment of the training; the median vibration (peak to peak) is at most 5 mm
    for a reach of 8.5 m, in proportion to the reach, and on the plants "finer" and "mujoco" at most 1 mm larger than in
    the environment of the training, in the same proportion.

    Args:
        name: name of a shipped policy, or folder of an exported policy.
        seeds: seeds of the episodes of each scenario.
        draws: number of episodes of the search for the worst episodes.
        folder: folder of the rows, with a subfolder for each policy; stored rows are not computed again.
        jobs: see `run_league`.
        log: function of one line of text for each scenario.

    Raises:
        ValueError: for anything other than an exported policy, and for a task without the metric "settling_time".
    """
    path = policy_folder(name)
    if path is None:
        raise value_error("agent", name, "an exported policy, by its name or folder (flexman export policy)")
    check_output(path / CERTIFICATE)
    about, environment = read_policy(path).metadata, _environment_name(name)
    task = find_scenario(environment).environment.task
    if "settling_time" not in {metric.name for metric in task_metrics(task)}:
        raise value_error("name", name, "a policy for a task with the metric settling_time")
    runs = [(each, seeds[: OTHER_PLANTS.get(each.partition("@")[2])]) for each in _certificate_scenarios(name)]
    runs.append((environment, range(SEARCH_SEED, SEARCH_SEED + draws)))
    reach = sum(link.length for link in find_scenario(environment).environment.arm.links)
    result: list[dict[str, Any]] = []
    reference: list[EpisodeRow] = []
    left_out: dict[str, str] = {}
    for scenario, each in runs:
        rows, reason = _run(name, scenario, each, folder / path.name, jobs)
        if reason:
            left_out[scenario] = reason
            log(f"left out: {reason}")
            continue
        reference = reference or rows
        result.append(_certificate_row(scenario, each, rows, reference[: len(rows)], reach))
        log(_row_text(result[-1]))
    result[-1]["worst"] = _worst_episodes(rows)
    result[-1]["worst_case"] = worst_case(name, find_scenario(environment).environment, SEARCH_SEED)
    about = {
        "arrays_hash": about["arrays_hash"],
        "computer": computer_info(),
        "fails": _failed_scenarios(result),
        "rows": result,
    } | ({"left_out": left_out} if left_out else {})
    write_atomically(path / CERTIFICATE, lambda file: file.write((json.dumps(about, indent=1) + "\n").encode()))
    return path / CERTIFICATE


def _certificate_scenarios(name: str) -> list[str]:
    """Return the names of the scenarios of a policy: its environment, other simulations of it, and changed arms."""
    check_mujoco()  # one of the plants; before the episodes of the others
    about, where = read_policy(policy_folder(name) or Path(name)).metadata, _environment_name(name)
    environment = find_scenario(where).environment
    trained = Configuration.from_plain(about["recipe"]["settings"]["environment"])
    changes = _changes_beyond_training(environment, trained)
    if NAMED_ENVIRONMENTS[environment.id].conditions and environment.arm == NAMED_ENVIRONMENTS[environment.id].arm:
        changes.append("friction=1")
    changes += [*(f"delay={delay}" for delay in DELAYS), *(f"noise={noise:g}" for noise in NOISES)]
    # With a change, an id alone stands for the condition of the change.
    base = f"{where}/{NOMINAL}" if where in NAMED_ENVIRONMENTS else where
    physics = [*(f"{where}@{plant}" for plant in OTHER_PLANTS if plant in PLANTS), f"{base}/method={METHOD}"]
    return [where, *physics, *(f"{base}/{change}{given}" for change in changes for given in (GIVEN, ""))]


def _environment_name(name: str) -> str:
    """Return the named environment for which a policy was exported; the policy itself for any other environment.

    Gains of a PD controller, the reward and the method may differ: a policy has its own gains, nothing is trained here,
    and a named environment has the default method of this release.
    """
    agent, about = find_agent(name), read_policy(policy_folder(name) or Path(name)).metadata
    assert agent.environment is not None
    named = about["league"].get("environment", agent.environment.id)
    same = named.partition("/")[0] in NAMED_ENVIRONMENTS and _is_same_motion(
        agent.environment, find_scenario(named).environment
    )
    return str(named) if same else name


def _certificate_row(
    scenario: str, seeds: range, rows: Sequence[EpisodeRow], reference: Sequence[EpisodeRow], reach: float
) -> dict[str, Any]:
    """Return name, seeds and metrics of a scenario, and under "fails" its values beyond a limit with limits, as text.

    Args:
        scenario: name of the scenario.
        seeds: seeds of the rows.
        rows: rows of the scenario.
        reference: rows of the same seeds in the environment of the policy.
        reach: sum of the lengths of the links, m.
    """
    now, trained = _aggregates(METRIC_NAMES, rows), _aggregates(METRIC_NAMES, reference)
    limited = _aggregates(LIMITED, rows)
    reasons = []
    if not now["settled"] >= MIN_SETTLED:
        reasons.append(f"{now['settled']:.0%} settle (limit {MIN_SETTLED:.0%})")
    if now["failed"]:
        reasons.append(f"{now['failed']:.0%} end at a limit of the environment")
    if now["settling_time"] > (limit := MAX_SETTLING_RATIO * trained["settling_time"]):
        reasons.append(f"settling in {now['settling_time']:.2f} s (limit {limit:.2f} s)")
    limit = MAX_VIBRATION * reach
    if "@" in scenario:
        limit = min(limit, trained["vibration"] + MAX_VIBRATION_INCREASE * reach)
    if now["vibration"] > limit:
        reasons.append(f"vibration {millimetres(now['vibration'])} (limit {millimetres(limit)})")
    if limited["excess"] > 0.0:
        reasons.append(f"{100.0 * limited['excess']:.2g} % beyond the limits of the environment")
    now |= {name: value for name, value in limited.items() if not np.isnan(value)}
    return {"scenario": scenario, "seeds": [seeds.start, seeds.stop], **_plain(now), "fails": ", ".join(reasons)}


def is_counted(scenario: str) -> bool:
    """Return True if a scenario counts for the verdict: the controller is designed for the environment in it."""
    change, equals, value = scenario.rpartition("/")[2].partition("=")
    return not equals or value.endswith(GIVEN) or CHANGES[change].always_given


def _failed_scenarios(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Return the names of the scenarios that count and fail, with their seeds where these differ from the first."""
    first = rows[0]["seeds"][0]
    return [
        row["scenario"] + (f" on seeds {row['seeds'][0]} to {row['seeds'][1] - 1}" if row["seeds"][0] != first else "")
        for row in rows
        if row["fails"] and is_counted(row["scenario"])
    ]


def _run(name: str, scenario: str, seeds: range, folder: Path, jobs: Workers | int) -> tuple[list[EpisodeRow], str]:
    """Return the rows of a policy in a scenario; [] and the reason if MuJoCo cannot simulate the arm."""
    results = run_league([name], [scenario], seeds, folder, jobs, lambda line: None)
    for cell in results.cells.values():
        if cell.why and cell.scenario == scenario:
            reason = f"{scenario}: {cell.why}"
            if scenario.endswith("@mujoco") and find_spec("mujoco") is not None:
                return [], reason
            raise ValueError(reason)
    return [results.rows[scenario, name, seed] for seed in seeds], ""


def _is_same_motion(one: Configuration, two: Configuration) -> bool:
    """Return True if two environments simulate the same motion; agent, gains, reward and method may differ."""
    others = (*INTERFACE, "gains", "reward", "task", "method")
    tasks = [{**plain_task(each.task), "reward": None} for each in (one, two)]
    return one.without(others) == two.without(others) and tasks[0] == tasks[1]


def _changes_beyond_training(environment: Configuration, trained: Configuration) -> list[str]:
    """Return changes of payload and stiffness beyond the ranges of the training, such as "payload=20:25".

    A parameter that the training randomised gets the range next to its range in the training, any other parameter the
    range of its condition for the arm, if it has the springs or flexible links of the condition.
    """
    trained_ranges, result = trained.randomised_ranges, []
    for condition in ("payload", "stiffness") if NAMED_ENVIRONMENTS[environment.id].conditions else ():
        settings = {"arm": environment.arm, "condition": condition}
        spans = Configuration(environment.id, settings).randomised_ranges
        if not spans:
            continue
        ranges = [trained_ranges[name] for name in spans if name in trained_ranges]
        low, high = next(iter(spans.values()))
        if ranges:
            low, high = min(low for low, _ in ranges), max(high for _, high in ranges)
            wide = RANGE_EXTENSION * (high - low)
            low, high = (low - wide, low) if condition == "stiffness" else (high, high + wide)
        result.append(f"{condition}={low:g}:{high:g}")
    return result


def _row_text(row: dict[str, Any]) -> str:
    """Return the result of a scenario as a line of text."""
    names = (*METRIC_NAMES, *LIMITED)
    values = ", ".join(f"{name} {row[name]:.3g}" for name in names if row.get(name) is not None)
    reasons = f" ({row['fails']})" if row["fails"] else ""
    verdict = (
        ("beyond its limits" if reasons else "within its limits") if is_counted(row["scenario"]) else "does not count"
    )
    return f"{row['scenario']:<42} {verdict}{reasons}: {values}"


def _worst_episodes(rows: Sequence[EpisodeRow]) -> list[dict[str, Any]]:
    """Return the metrics of the episodes with the lowest return; a failure lowers the return by its penalty."""
    at = VALUES.index("reward")
    worst = sorted(rows, key=lambda row: (row.values[at], row.seed))[:LISTED_EPISODES]
    return [{"seed": row.seed, **_plain(_aggregates(("reward", *METRIC_NAMES[1:]), [row]))} for row in worst]


def _aggregates(names: Sequence[str], rows: Sequence[EpisodeRow]) -> dict[str, float]:
    """Return the metrics over all rows by name."""
    values = {name: np.array([row.values[VALUES.index(name)] for row in rows]) for name in names}
    metrics = {**METRICS} | {each.name: each for each in LIMIT_METRICS}
    return {name: float(metrics[name].aggregate(values[name])) for name in names}


def _plain(metrics: dict[str, float]) -> dict[str, float | None]:
    """Return metrics with None for an infinite value, which JSON cannot represent."""
    return {name: value if np.isfinite(value) else None for name, value in metrics.items()}
