"""Cases: who acts on which arm, and what of it nobody told him."""

import time
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.config.specification import make_controller
from flexman_gym.envs.episodes import Episodes
from flexman_gym.evaluation.agent import find_agent
from flexman_gym.evaluation.metrics import METRICS
from flexman_gym.evaluation.rollout import Rollout, rollout

RUBBED = {name: [0.5, 1.5] for name in ("viscous_friction_factor", "coulomb_friction_factor")}
FINER = {"elements": 3, "modes": None, "stiffening": True, "step": 0.00125}
CHANGE, WITHIN, LOAD = 4.0, 3.0, 10.0  # s, s and kg, of a load that changes on the way
LATER = 2.0  # s, after which the error of a tip that follows counts


@dataclass(frozen=True)
class ControlCase:
    """Case of the study: an agent in an environment.

    Attributes:
        name: of the row.
        entrant: a name, or a mapping as `base` takes it.
        environment: an id, or an id and a condition.
        changes: of the settings of that environment, of its randomisation inside.
        flaws: of the instruments, which nobody is told.
        surprise: whether the controller knows the environment without the changes.
        load: whether the payload changes on the way.
    """

    name: str
    entrant: Any
    environment: str
    changes: Mapping[str, Any] = field(default_factory=dict)
    flaws: Mapping[str, float] = field(default_factory=dict)
    surprise: bool = False
    load: bool = False


@dataclass(frozen=True)
class ControlRow:
    """Results of a case: shares, times in s, lengths in m, CPU time per period and arm in s.

    `again` is the share settled `WITHIN` after a load has changed; `followed` the RMS error after LATER.
    """

    case: str
    settled: float
    settling_time: float
    vibration: float
    error: float
    failed: float
    roughness: float
    followed: float
    again: float | None
    cost: float


def _rubbing() -> dict[str, Any]:
    arm: dict[str, Any] = Configuration.find("FlexRRR-v0/friction").settings["arm"]
    return arm


LAB, RRR, LEARNED = "unknown-lab", "FlexRRR-v0", "lab-flexrrr"
BIASED = {"kind": "adaptive-lqr", "biased": True}
CASES = (
    *(ControlCase(f"{who}, {where}", who, f"{RRR}/{where}" if where else RRR)
      for who, where in (("privileged-lqr", "unknown"), ("adaptive-lqr", LAB), ("lqg", LAB), ("pd", LAB),
                         ("lqg", "nominal"), ("lqg", "delay"), ("lqg", "payload"), ("lqg", "stiffness"))),
    ControlCase(f"{LEARNED}, {LAB}", LEARNED, f"{RRR}/{LAB}"),
    *(ControlCase(f"{who}, {what}", who, f"{RRR}/{LAB}", changes) for what, changes in (
        ("delay of 0 to 2 periods", {"randomisation": {"delay": [0, 2]}}),
        ("friction within a half", {"arm": _rubbing(), "randomisation": RUBBED}),
    ) for who in ("adaptive-lqr", LEARNED)),
    ControlCase("adaptive-lqr, biased readings", BIASED, f"{RRR}/{LAB}", flaws={"bias": 0.005}),
    ControlCase("adaptive-lqr, a finer arm", "adaptive-lqr", f"{RRR}/{LAB}", FINER, surprise=True),
    ControlCase("adaptive-lqr, a load that changes", "adaptive-lqr", f"{RRR}/{LAB}", load=True),
    *(ControlCase(f"{who}, {task}", who, f"{task}/{LAB}")
      for task in ("FlexPlanar-v0", "FlexRRR-Track-v0", "FlexRRR-Hold-v0", "FlexRRR-Gravity-v0")
      for who in ("privileged-lqr", "adaptive-lqr")),
    ControlCase("adaptive-lqr, noise three times as large", "adaptive-lqr", f"{RRR}/{LAB}",
         {"randomisation": {"sensor_noise": [0.003, 0.003]}}),
    ControlCase("adaptive-lqr, friction it knows nothing of", "adaptive-lqr", f"{RRR}/{LAB}", {"arm": _rubbing()},
         surprise=True),
    ControlCase("adaptive-lqr, biases it knows nothing of", "adaptive-lqr", f"{RRR}/{LAB}", flaws={"bias": 0.005}),
    ControlCase("adaptive-lqr, a fifth of the samples lost", "adaptive-lqr", f"{RRR}/{LAB}", flaws={"dropped": 0.2}),
    ControlCase("adaptive-lqr, readings a period late", "adaptive-lqr", f"{RRR}/{LAB}", flaws={"delay": 1}),
)  # fmt: skip


def played(case: ControlCase, episodes: int, seed: int) -> ControlRow:
    """Run the episodes of a case."""
    known = Configuration.find(case.environment)
    settings = deepcopy(known.settings)
    for name, change in case.changes.items():
        settings[name] = settings[name] | change if name == "randomisation" else change
    environment, setup = Configuration(known.id, settings), known
    base = make_controller(setup, case.entrant, resolve_fidelity(setup).model) if case.surprise else case.entrant
    flawed = {"sensors": {"kind": "lab", **case.flaws}} if case.flaws else {}
    found = find_agent(base)
    entrant = replace(found, name=case.name, interface={**(found.interface or {}), **flawed})
    started = time.process_time()
    result = rollout(entrant, environment, range(seed, seed + episodes), _loader(setup.control_period, case.load))
    cost = (time.process_time() - started) / float(np.sum(result.lengths))
    values = {metric.name: metric.evaluate(result.records) for metric in METRICS.values()}
    few = {name: values[name] for name in ("settled", "settling_time", "vibration", "error", "failed", "roughness")}
    return ControlRow(
        case.name, **few, followed=_followed(result), again=_again(result) if case.load else None, cost=cost
    )


def _loader(period: float, load: bool) -> Callable[[Episodes], None]:
    """Change the payload of each arm by LOAD after CHANGE, up where it is light."""
    passed = [0]

    def watch(episodes: Episodes) -> None:
        passed[0] += 1
        if load and passed[0] == round(CHANGE / period) + 1:
            assert episodes.effects is not None
            mass = episodes.effects.drawn["payload_mass"]
            episodes.batch.vary(np.arange(len(mass)), payload_mass=np.where(mass < LOAD, mass + LOAD, mass - LOAD))

    return watch


def _followed(result: Rollout) -> float:
    return float(np.sqrt(np.nanmean(result.errors[:, round(LATER / result.period) :] ** 2)))


def _again(result: Rollout) -> float:
    last = round((CHANGE + WITHIN) / result.period)
    well: Sequence[bool] = [
        not record.failure and bool((record.errors[last:] < record.band).all()) for record in result.records
    ]
    return float(np.mean(well))
