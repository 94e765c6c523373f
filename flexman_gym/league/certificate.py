"""Certificate of a policy: tests with other physics, parameters, delays and noise, and the worst episodes."""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from flexman_gym.common.checks import value_error
from flexman_gym.common.computer import computer_info
from flexman_gym.common.files import write_atomically
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.named_environments import NAMED
from flexman_gym.evaluation.agent import AgentSpec, design_for, find_agent
from flexman_gym.evaluation.metrics import METRICS
from flexman_gym.evaluation.policy_files import CERTIFICATE, policy_folder, read_policy
from flexman_gym.evaluation.rollout import TEST_SEEDS, EpisodeRecord, rollout
from flexman_gym.league.scenarios import PLANTS, find_plant
from flexman_gym.simulation.integrator import default_step

USUAL, PHYSICS, FAR = 0.95, 0.95, 0.9  # least share of episodes that settle: as trained, otherwise moved, elsewhere
LOUDER, LOUDER_BY = 1.2, 1e-4  # vibration otherwise moved: times that as trained, or so much above it, in m
DRAWS, WORST, FIRST_DRAW, BLOCK = 1000, 5, 50_000, 100  # of the search: episodes, kept ones, seeds, side by side
SHOWN = ("settled", "settling_time", "vibration", "error", "roughness", "failed")
METHOD = "gauss_2_sweeps"  # beside the default, which has another order
FEW = {"mujoco": 8}  # episodes on a plant that takes long
DELAYS, NOISES = (0, 1, 2, 3), (0.001, 0.003)  # control periods, and parts of the ranges of instruments
TOLD, NOT_TOLD = "told", "not told"  # whether the controller is designed for what is changed
BEYOND = 0.25  # of the range of the training, for what was drawn there


class CertificateTrial(NamedTuple):
    """Where a policy is tried: a name, what is other there, and the changes of its environment.

    Attributes:
        kind: "usual", "physics" or "far", the least that has to be reached.
        plant: what moves the arms, see `physical.PLANTS`.
        told: whether the controller of the policy is designed for the changed environment; otherwise it is the one
            for the environment of the policy.
    """

    name: str
    what: str
    kind: str
    changes: Mapping[str, Any]
    plant: str = "usual"
    told: bool = True


def certify(
    name: str, seeds: Sequence[int] = TEST_SEEDS, draws: int = DRAWS, say: Callable[[str], None] = print
) -> Path:
    """Tries a policy and writes what came out beside it, as `certificate.json`; gives the path.

    What fails is under "fails": a policy is recommended where that is empty.

    Args:
        name: of a shipped policy, or the folder of an exported one.
        seeds: of the episodes of each trial.
        draws: episodes of the search for the worst ones.
        say: is told of each trial.

    Raises:
        ValueError: one line, for anything else, and for a task in which nothing settles.
    """
    folder = policy_folder(name)
    if folder is None:
        raise value_error("name", name, "an exported policy, by its name or folder")
    entrant, about = find_agent(name), read_policy(folder).about
    assert entrant.environment is not None
    if "settling_time" not in getattr(entrant.environment.task, "figures", SHOWN):
        raise value_error("name", name, "a policy for a task in which the arm settles")
    rows: list[dict[str, Any]] = []
    usual: list[EpisodeRecord] = []
    played: list[EpisodeRecord] = []
    trained = Configuration.from_plain(about["recipe"]["settings"]["environment"])
    for trial in policy_trials(entrant.environment, trained):
        if trial.told or isinstance((entrant.interface or {}).get("base"), str | dict):  # else the trial before, again
            played = _run_trial(entrant, trial, seeds[: FEW.get(trial.plant)])
        usual = usual or played
        rows.append(_row(trial, played, usual[: len(played)]))
        say(_row_text(rows[-1]))
    search = _search(entrant, draws)
    rows.append(search)
    say(_row_text(search))
    result = {
        "arrays_hash": about["arrays_hash"],
        "machine": computer_info(),
        "seeds": [seeds[0], seeds[-1] + 1],
        "fails": [row["name"] for row in rows if row["fails"]],
        "trials": rows,
    }
    write_atomically(folder / CERTIFICATE, lambda file: file.write((json.dumps(result, indent=1) + "\n").encode()))
    return folder / CERTIFICATE


def policy_trials(environment: Configuration, trained: Configuration) -> list[CertificateTrial]:
    """Gives the trials of a policy for an environment, which was trained in another or the same."""
    setup = environment
    step = (setup.step or default_step(setup.control_period, NAMED[setup.id].longest_step)) / 4.0
    result = [
        CertificateTrial("as trained", "nothing is other", "usual", {}),
        *(CertificateTrial(plant, PLANTS[plant][0], "physics", {}, plant) for plant in ("finer",
        "mujoco") if plant in PLANTS),
        CertificateTrial("method", f"{METHOD} at a quarter of the step", "physics", {"method": METHOD, "step": step}),
    ]  # fmt: skip
    far: list[tuple[str, str, dict[str, Any]]] = []
    for what, drawn in _unseen(environment, trained).items():
        ends = "; ".join(f"{name} {low:.3g} to {high:.3g}" for name, (low, high) in drawn.items())
        far.append((what, ends, _with(environment, drawn)))
    if NAMED[environment.id].conditions and environment.arm == NAMED[environment.id].arm():
        arm = Configuration(environment.id, {"condition": "friction"}).settings["arm"]
        far.append(("friction", "friction of the motors, as of the condition", {"arm": arm}))
    for delay in DELAYS:
        changes = _with(environment, {"delay": (delay, delay)})
        far.append((f"delay {delay}", f"torques come {delay} control periods late", changes))
    for noise in NOISES:
        changes = _with(environment, {"sensor_noise": (noise, noise)})
        far.append((f"noise {noise:g}", f"noise of {noise:g} of the range of each sensor", changes))
    for name, what, changes in far:
        result += [
            CertificateTrial(f"{name} ({words})", what, "far", changes, told=words == TOLD)
            for words in (TOLD, NOT_TOLD)
        ]
    return result


def _row_text(row: Mapping[str, Any]) -> str:
    """Gives a row in words."""
    values = ", ".join(f"{name} {row[name]:.3g}" for name in SHOWN if row[name] is not None)
    said = f"FAILS ({row['fails']})" if row["fails"] else "passes"
    return f"{row['name']:<22}{said}: {values}"


def _unseen(environment: Configuration, trained: Configuration) -> dict[str, dict[str, tuple[float, float]]]:
    """Payload and stiffness that no training drew: the range of the condition, or beyond that of the training."""
    conditions = ("payload", "stiffness") if NAMED[environment.id].conditions else ()
    seen = _drawn(trained)
    result = {}
    for condition in conditions:
        spans = _drawn(Configuration(environment.id, {"condition": condition}))
        for name in spans.keys() & seen.keys():
            low, high = seen[name]
            wide = BEYOND * (high - low)
            spans[name] = (low - wide, low) if condition == "stiffness" else (high, high + wide)
        result[condition] = spans
    return result


def _with(environment: Configuration, drawn: Mapping[str, tuple[float, float]]) -> dict[str, Any]:
    """The randomisation of an environment with other ranges of what is drawn."""
    return {"randomisation": {**_drawn(environment), **{name: list(span) for name, span in drawn.items()}}}


def _drawn(environment: Configuration) -> dict[str, Any]:
    """The ranges of what the episodes of an environment draw."""
    own = environment.randomisation
    return dict(own.given) if own else {}


def _run_trial(entrant: AgentSpec, trial: CertificateTrial, seeds: Sequence[int]) -> list[EpisodeRecord]:
    """Return the episodes of a trial."""
    environment = entrant.environment
    assert environment is not None
    changed = environment.replace(**trial.changes)
    player = entrant if trial.told else design_for(entrant, environment)
    return rollout(player, changed, seeds, moved=find_plant(trial.plant)).records


def _row(trial: CertificateTrial, records: Sequence[EpisodeRecord], usual: Sequence[EpisodeRecord]) -> dict[str, Any]:
    """What came out of a trial, and why it fails, "" where it does not."""
    values = _values(SHOWN, records)
    least = {"usual": USUAL, "physics": PHYSICS, "far": FAR}[trial.kind]
    why = []
    if values["failed"]:
        why.append("an episode ended at a limit")
    if not (values["settled"] or 0.0) >= least:
        why.append(f"less than {least:.0%} settle")
    if trial.kind == "physics":
        before, now = METRICS["vibration"].sum_up(usual), values["vibration"]
        most = max(LOUDER * before, before + LOUDER_BY)
        if now is None or now > most:
            why.append(f"the tip moves by more than {1e3 * most:.2g} mm")
    return {"name": trial.name, "what": trial.what, "episodes": len(records), **values, "fails": ", ".join(why)}


def _search(entrant: AgentSpec, draws: int) -> dict[str, Any]:
    """The worst of so many episodes, those of the lowest reward, to which a failure adds its penalty."""
    assert entrant.environment is not None
    found: list[tuple[float, int]] = []
    records: list[EpisodeRecord] = []
    for first in range(FIRST_DRAW, FIRST_DRAW + draws, BLOCK):
        seeds = range(first, min(first + BLOCK, FIRST_DRAW + draws))
        played = rollout(entrant, entrant.environment, seeds).records
        found += [(METRICS["reward"].of(record), seed) for seed, record in zip(seeds, played, strict=True)]
        records += played
    row = _row(CertificateTrial("search", f"the {WORST} worst of {draws} draws", "usual", {}), records, records)
    worst = {seed: [records[seed - FIRST_DRAW]] for _, seed in sorted(found)[:WORST]}
    row["worst"] = [{"seed": seed, **_values(("reward", *SHOWN[1:]), each)} for seed, each in worst.items()]
    return row


def _values(names: Sequence[str], records: Sequence[EpisodeRecord]) -> dict[str, float | None]:
    """Figures as JSON has them, None for one that is infinite."""
    values = {name: float(METRICS[name].sum_up(records)) for name in names}
    return {name: value if np.isfinite(value) else None for name, value in values.items()}
