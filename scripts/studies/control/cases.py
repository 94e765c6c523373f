"""Cases of the controller study: agent, environment, changes and unmodelled faults."""

import time
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from flexman_gym.control.base_controllers import make_base
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.config.specification import make_plant
from flexman_gym.envs.episodes import Episodes
from flexman_gym.evaluation.agent import find_agent
from flexman_gym.evaluation.metrics import METRICS
from flexman_gym.evaluation.rollout import Rollout, rollout

FRICTION_RANGES = {name: [0.5, 1.5] for name in ("viscous_friction_factor", "coulomb_friction_factor")}
FINER = {"elements": 3, "modes": None, "stiffening": True, "step": 0.00125}
CHANGE, WITHIN, LOAD = 4.0, 3.0, 10.0  # payload change: time, s; time to settle again, s; mass, kg
LATER = 2.0  # s; start of the RMS tip error in tracking and holding tasks


@dataclass(frozen=True)
class ControlCase:
    """Case of the study: an agent in an environment.

    Attributes:
        name: name of the row.
        agent: name of an agent, or a mapping as for the keyword `base`.
        environment: environment id, optionally with a condition ("id/condition").
        changes: changed settings of the environment; entries of its randomisation are merged.
        sensor_errors: errors of the instruments that are not given to the agent.
        unmodelled: design the agent for the environment without the changes.
        load: change the payload during the episode.
    """

    name: str
    agent: Any
    environment: str
    changes: Mapping[str, Any] = field(default_factory=dict)
    sensor_errors: Mapping[str, float] = field(default_factory=dict)
    unmodelled: bool = False
    load: bool = False


@dataclass(frozen=True)
class ControlRow:
    """Results of a case: shares, times in s, lengths in m, CPU time per period and arm in s.

    `again` is the share settled `WITHIN` seconds after the payload change, `followed` the RMS tip error after `LATER`.
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


def _friction_arm() -> dict[str, Any]:
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
        ("friction within a half", {"arm": _friction_arm(), "randomisation": FRICTION_RANGES}),
    ) for who in ("adaptive-lqr", LEARNED)),
    ControlCase("adaptive-lqr, biased readings", BIASED, f"{RRR}/{LAB}", sensor_errors={"bias": 0.005}),
    ControlCase("adaptive-lqr, a finer arm", "adaptive-lqr", f"{RRR}/{LAB}", FINER, unmodelled=True),
    ControlCase("adaptive-lqr, a load that changes", "adaptive-lqr", f"{RRR}/{LAB}", load=True),
    *(ControlCase(f"{who}, {task}", who, f"{task}/{LAB}")
      for task in ("FlexPlanar-v0", "FlexRRR-Track-v0", "FlexRRR-Hold-v0", "FlexRRR-Gravity-v0")
      for who in ("privileged-lqr", "adaptive-lqr")),
    ControlCase("adaptive-lqr, noise three times as large", "adaptive-lqr", f"{RRR}/{LAB}",
         {"randomisation": {"sensor_noise": [0.003, 0.003]}}),
    ControlCase("adaptive-lqr, friction it knows nothing of", "adaptive-lqr", f"{RRR}/{LAB}", {"arm": _friction_arm()},
         unmodelled=True),
    ControlCase("adaptive-lqr, biases it knows nothing of", "adaptive-lqr", f"{RRR}/{LAB}",
         sensor_errors={"bias": 0.005}),
    ControlCase("adaptive-lqr, a fifth of the samples lost", "adaptive-lqr", f"{RRR}/{LAB}",
         sensor_errors={"dropped": 0.2}),
    ControlCase("adaptive-lqr, readings a period late", "adaptive-lqr", f"{RRR}/{LAB}", sensor_errors={"delay": 1}),
)  # fmt: skip


def run_case(case: ControlCase, episodes: int, seed: int) -> ControlRow:
    """Run the episodes of a case and return its row."""
    known = Configuration.find(case.environment)
    settings = deepcopy(known.settings)
    for name, change in case.changes.items():
        settings[name] = settings[name] | change if name == "randomisation" else change
    environment, setup = Configuration(known.id, settings), known
    base = make_base(case.agent, make_plant(setup, resolve_fidelity(setup).model)) if case.unmodelled else case.agent
    sensors = {"sensors": {"kind": "lab", **case.sensor_errors}} if case.sensor_errors else {}
    found = find_agent(base)
    agent = replace(found, name=case.name, interface={**(found.interface or {}), **sensors})
    started = time.process_time()
    result = rollout(agent, environment, range(seed, seed + episodes), _loader(setup.control_period, case.load))
    cost = (time.process_time() - started) / float(np.sum(result.lengths))
    values = {metric.name: metric.evaluate(result.records) for metric in METRICS.values()}
    few = {name: values[name] for name in ("settled", "settling_time", "vibration", "error", "failed", "roughness")}
    return ControlRow(
        case.name, **few, followed=_followed(result), again=_again(result) if case.load else None, cost=cost
    )


def _loader(period: float, load: bool) -> Callable[[Episodes], None]:
    """Return a callback that changes the payload of each arm by +LOAD (light arms) or -LOAD at the time CHANGE."""
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
