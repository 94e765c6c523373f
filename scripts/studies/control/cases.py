"""Cases of the controller study: agent, environment, changes and unmodelled faults."""

import time
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from flexman_gym.agent.base_controllers import make_base
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.config.plant import make_plant
from flexman_gym.envs.episodes import Episodes
from flexman_gym.evaluation.agents import find_agent
from flexman_gym.evaluation.metrics import METRICS
from flexman_gym.evaluation.rollouts import Rollout, rollout
from studies.control.random_arms import random_arm, uncertain_environment

FRICTION_RANGES = {name: [0.5, 1.5] for name in ("viscous_friction_factor", "coulomb_friction_factor")}
FINER = {"elements": 3, "modes": None, "stiffening": True, "step": 0.00125}
CHANGE, WITHIN, LOAD = 4.0, 3.0, 10.0  # payload change: time, s; time to settle again, s; mass, kg
RANDOM_ARMS, RANDOM_EPISODES = 20, 20  # numbers of random arms, and of episodes of each
FEW = 40  # episodes of an extreme or a part
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
        arm: seed of the random arm of the environment, which is drawn when the case runs.
        most: largest number of episodes.
    """

    name: str
    agent: Any
    environment: str
    changes: Mapping[str, Any] = field(default_factory=dict)
    sensor_errors: Mapping[str, float] = field(default_factory=dict)
    unmodelled: bool = False
    load: bool = False
    arm: int | None = None
    most: int = 1000


@dataclass(frozen=True)
class ControlRow:
    """Results of a case over episodes: shares, times in s, lengths in m, CPU time per period and arm in s.

    `again` is the share settled `WITHIN` seconds after the payload change, `followed` the RMS tip error after `LATER`.
    """

    case: str
    episodes: float
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
    arm: dict[str, Any] = Configuration.find("FlexRRR-v0/friction").given["arm"]
    return arm


LAB, RRR, LEARNED = "unknown-lab", "FlexRRR-v0", "lab-flexrrr"
BIASED = {"kind": "adaptive-lqr", "biased": True}
# Ranges of the condition unknown-lab, for the parameters of the condition uncertain
LAB_RANGES = {
    "payload_mass": [0, 20], "joint_stiffness_factor": [0.7, 1.3], "link_stiffness_factor": [0.7, 1.3],
    "viscous_friction_factor": [0, 0], "coulomb_friction_factor": [0, 0], "delay": [1, 1],
    "sensor_noise": [0.001, 0.001], "sensor_bias": [0, 0], "gauge_gain_factor": [1, 1], "dropped_samples": [0, 0],
}  # fmt: skip
FRICTION = ("viscous_friction_factor", "coulomb_friction_factor")
EXTREMES = (  # of the condition uncertain: name of the row, parameters, value
    ("payload 0 kg", ("payload_mass",), 0.0),
    ("payload 25 kg", ("payload_mass",), 25.0),
    ("joint stiffness x 0.5", ("joint_stiffness_factor",), 0.5),
    ("joint stiffness x 1.5", ("joint_stiffness_factor",), 1.5),
    ("link stiffness x 0.5", ("link_stiffness_factor",), 0.5),
    ("link stiffness x 1.5", ("link_stiffness_factor",), 1.5),
    ("friction x 0.5", FRICTION, 0.5),
    ("friction x 1.5", FRICTION, 1.5),
    ("delay 0", ("delay",), 0),
    ("delay 3", ("delay",), 3),
    ("noise 0.3 %", ("sensor_noise",), 0.003),
    ("bias 0.3 %", ("sensor_bias",), 0.003),
    ("1 % of samples lost", ("dropped_samples",), 0.01),
)
STICTION = {"coulomb_rate": 0.001, "stribeck_rate": 0.02}
PARTS: tuple[tuple[str, Mapping[str, float], str, tuple[float, ...]], ...] = (
    # of the condition unmodelled: name of the row, fixed parameters, swept parameter, its values
    ("static excess of friction", STICTION, "static_excess", (0.0, 0.25, 0.5, 1.0)),
    ("backlash in rad", {}, "backlash", (0.001, 0.002, 0.004)),
    ("stiffness at small torques x", {}, "soft_stiffness", (0.7, 0.5, 0.3)),
    ("torque ripple in N m", {}, "ripple_torque", (4.0, 8.0, 16.0, 32.0)),
    ("torque constant x", {}, "torque_limit_factor", (0.95, 0.9, 0.8)),
)
UNMODELLED = ("coulomb_rate", "static_excess", "stribeck_rate", "backlash", "soft_stiffness", "ripple_torque",
              "torque_limit_factor")  # fmt: skip


def _extreme(names: Sequence[str], value: float) -> dict[str, Any]:
    """Return the ranges of unknown-lab with some parameters at a fixed value; biases have either sign."""
    span = [-value, value] if names == ("sensor_bias",) else [value, value]
    return {"randomisation": {**LAB_RANGES, **dict.fromkeys(names, span)}}


def _part(fixed: Mapping[str, float], name: str, value: float) -> dict[str, Any]:
    """Return the ranges of the condition unmodelled with one part only, at a fixed value."""
    alone = {**fixed, name: value}
    return {"randomisation": {key: [alone[key]] * 2 if key in alone else None for key in UNMODELLED}}


CASES = (
    *(ControlCase(f"{who}, {where}", who, f"{RRR}/{where}" if where else RRR)
      for who, where in (("privileged-lqr", "unknown"), ("adaptive-lqr", LAB), ("lqg", LAB), ("pd", LAB),
                         ("lqg", "nominal"), ("lqg", "delay"), ("lqg", "payload"), ("lqg", "stiffness"))),
    ControlCase(f"{LEARNED}, {LAB}", LEARNED, f"{RRR}/{LAB}"),
    *(ControlCase(f"{who}, {what}", who, f"{RRR}/{LAB}", changes) for what, changes in (
        ("delay of 0 to 2 periods", {"randomisation": {"delay": [0, 2]}}),
        ("friction within a half", {"arm": _friction_arm(), "randomisation": FRICTION_RANGES}),
    ) for who in ("adaptive-lqr", LEARNED)),
    *(ControlCase(f"{who}, {where}", who, f"{RRR}/{where}")
      for where in ("uncertain", "unmodelled") for who in ("privileged-lqr", "adaptive-lqr", LEARNED)),
    ControlCase("adaptive-lqr, biased readings", BIASED, f"{RRR}/{LAB}", sensor_errors={"bias": 0.005}),
    ControlCase("adaptive-lqr, finer arm", "adaptive-lqr", f"{RRR}/{LAB}", FINER, unmodelled=True),
    ControlCase("adaptive-lqr, changed payload", "adaptive-lqr", f"{RRR}/{LAB}", load=True),
    *(ControlCase(f"{who}, {task}", who, f"{task}/{LAB}")
      for task in ("FlexPlanar-v0", "FlexRRR-Track-v0", "FlexRRR-Hold-v0", "FlexRRR-Gravity-v0")
      for who in ("privileged-lqr", "adaptive-lqr")),
    *(ControlCase(f"{who}, {task}, {where}", who, f"{task}/{where}") for task in ("FlexPlanar-v0", "FlexRRR-Gravity-v0")
      for where in ("uncertain", "unmodelled") for who in ("privileged-lqr", "adaptive-lqr")),
    *(ControlCase(f"adaptive-lqr, uncertain: {text}", "adaptive-lqr", f"{RRR}/uncertain", _extreme(names, value),
         unmodelled=True, most=FEW) for text, names, value in EXTREMES),
    *(ControlCase(f"adaptive-lqr, unmodelled: {text} {value:g}", "adaptive-lqr", f"{RRR}/unmodelled",
         _part(fixed, name, value), unmodelled=True, most=FEW)
      for text, fixed, name, values in PARTS for value in values),
    ControlCase("adaptive-lqr, three times the noise", "adaptive-lqr", f"{RRR}/{LAB}",
         {"randomisation": {"sensor_noise": [0.003, 0.003]}}),
    ControlCase("adaptive-lqr, unmodelled friction", "adaptive-lqr", f"{RRR}/{LAB}", {"arm": _friction_arm()},
         unmodelled=True),
    ControlCase("adaptive-lqr, unmodelled biases", "adaptive-lqr", f"{RRR}/{LAB}",
         sensor_errors={"bias": 0.005}),
    ControlCase("adaptive-lqr, 20 % of samples lost", "adaptive-lqr", f"{RRR}/{LAB}",
         sensor_errors={"dropped": 0.2}),
    ControlCase("adaptive-lqr, measurements a period late", "adaptive-lqr", f"{RRR}/{LAB}", sensor_errors={"delay": 1}),
    *(ControlCase(f"{who}, random arm {seed}", who, RRR, arm=seed, most=RANDOM_EPISODES)
      for seed in range(RANDOM_ARMS) for who in ("privileged-lqr", "adaptive-lqr")),
)  # fmt: skip


def run_case(case: ControlCase, episodes: int, seed: int) -> ControlRow:
    """Run the episodes of a case and return its row."""
    known = Configuration.find(case.environment)
    settings = deepcopy(known.given)
    changes = case.changes if case.arm is None else uncertain_environment(random_arm(case.arm))
    for name, change in changes.items():
        settings[name] = settings.get(name, {}) | change if name == "randomisation" else change
    environment, setup = Configuration(known.id, settings), known
    base = make_base(case.agent, make_plant(setup, resolve_fidelity(setup).model)) if case.unmodelled else case.agent
    sensors = {"sensors": {"kind": "lab", **case.sensor_errors}} if case.sensor_errors else {}
    found = find_agent(base)
    agent = replace(found, name=case.name, interface={**(found.interface or {}), **sensors})
    started = time.process_time()
    seeds = range(seed, seed + min(episodes, case.most))
    result = rollout(agent, environment, seeds, _loader(setup.control_period, case.load))
    cost = (time.process_time() - started) / float(np.sum(result.lengths))
    values = {metric.name: metric.evaluate(result.records) for metric in METRICS.values()}
    few = {name: values[name] for name in ("settled", "settling_time", "vibration", "error", "failed", "roughness")}
    return ControlRow(
        case.name, len(seeds), **few, followed=_followed(result), again=_again(result) if case.load else None, cost=cost
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
