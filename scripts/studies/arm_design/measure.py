"""Designs of the paper's arm: first frequency and settling time before and after, with gains tuned alike."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from flexman_gym.common.arrays import Vector
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.arm_design import optimise_arm
from flexman_gym.evaluation.metrics import evaluate
from flexman_gym.evaluation.optimisation import tune
from flexman_gym.evaluation.rollout import TEST_SEEDS
from flexman_gym.model.dynamics import frequencies
from flexman_gym.model.model import build_model

ENVIRONMENT, SECTIONS, EPISODES = "FlexRRR-v0", 4, 20
HORIZON = 60.0  # s; longest simulated episode, as the PD of the given arm needs more than 20 s
GIVEN, FREQUENCY, SETTLING = "given", "frequency", "settling"
LINEAR, TUNED = "linear model", "simulation"  # origin of the gains
DESIGNS = {  # name -> metric, kept mass, bounds of the gears
    "first frequency, mass of each link": (FREQUENCY, "links", (1.0, 1.0)),
    "first frequency": (FREQUENCY, "arm", (1.0, 1.0)),
    "settling time, mass of each link": (SETTLING, "links", (1.0, 1.0)),
    "settling time": (SETTLING, "arm", (1.0, 1.0)),
    "settling time, with gears": (SETTLING, "arm", (0.5, 2.0)),
}


@dataclass(frozen=True)
class DesignRow:
    """Arm with gains of one origin, run on the test episodes.

    Attributes:
        design: name in DESIGNS, or GIVEN.
        gains: LINEAR, by the metric "settling" with the thickness fixed, or TUNED, by `flexman optimise gains`.
        frequency: first natural frequency with held motors at zero joint angles, Hz.
        mass: mass of the links, kg.
        linear_time: settling time of the linear model with the gains LINEAR, s.
        settled: share of the episodes that settle, 1.
        settling_time: median settling time, s.
        stiffness: proportional gains, N m/rad.
        damping: derivative gains, N m s/rad.
        gears: factors of the gear ratios.
    """

    design: str
    gains: str
    frequency: float
    mass: float
    linear_time: float
    settled: float
    settling_time: float
    stiffness: str
    damping: str
    gears: str


@dataclass(frozen=True)
class ProfileRow:
    """Thickness of a section as a factor of the given thickness; links and sections are numbered from 1, base to tip."""

    design: str
    link: float
    section: float
    thickness: float


def given_environment() -> Configuration:
    """Return the environment with the corrected area of link 1: a cross-section with the printed area is impossible."""
    arm = {"catalog": "paper_rrr", "link1_area": "corrected"}
    named = Configuration(ENVIRONMENT)
    arm |= {"rotor_inertia": 10.0, "torque_limit": 400.0, "modal_damping_ratio": 0.005}
    return Configuration(ENVIRONMENT, {"arm": arm, "gains": named.pd_gains})


def rows() -> tuple[list[DesignRow], list[ProfileRow]]:
    """Return the rows of all designs and their profiles."""
    given, results, profiles = given_environment(), [], []
    results += design_rows(GIVEN, given, np.ones(3))
    for name, (metric, keep, gears) in DESIGNS.items():
        found = optimise_arm(given, metric, SECTIONS, gears=gears, keep=keep)
        profiles += [
            ProfileRow(name, link, section, factor)
            for link, factors in enumerate(found.thickness, 1)
            for section, factor in enumerate(factors, 1)
        ]
        results += design_rows(name, found.environment, found.gears)
    return results, profiles


def design_rows(name: str, environment: Configuration, gears: Vector) -> Iterator[DesignRow]:
    """Yield the rows of one arm, with gains of both origins."""
    best = optimise_arm(environment, SETTLING, SECTIONS, thickness=(1.0, 1.0))
    frequency = float(frequencies(build_model(environment.arm, environment.elements), lock_joints=True)[0])
    mass = sum(float(link.mass) for link in environment.arm.links)
    for origin, gains in ((LINEAR, best.environment.gains), (TUNED, tune(environment).gains)):
        longer = environment.replace(gains=gains, horizon=HORIZON)
        metrics = evaluate("pd", longer, range(TEST_SEEDS.start, TEST_SEEDS.start + EPISODES))
        yield DesignRow(
            name, origin, frequency, mass, best.after, metrics["settled"], metrics["settling_time"],
            _joined(gains["stiffness"]), _joined(gains["damping"]), _joined(gears),
        )  # fmt: skip


def _joined(values: Vector) -> str:
    return " ".join(f"{value:.4g}" for value in values)
