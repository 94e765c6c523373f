"""Designs of the paper's arm: first frequency and settling time before and after, with gains optimised alike."""

from dataclasses import dataclass

from flexman_gym.common.arrays import Vector
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.metrics import evaluate
from flexman_gym.evaluation.rollouts import TEST_SEEDS
from flexman_gym.model.dynamics import frequencies
from flexman_gym.model.model import build_model
from flexman_gym.toolbox.sensitivity.arm_design import optimise_arm

ENVIRONMENT, SECTIONS, EPISODES = "FlexRRR-v0", 4, 20
HORIZON = 60.0  # s; longest simulated episode, as the PD of the given arm needs more than 20 s
GIVEN, FREQUENCY, SETTLING = "given", "frequency", "settling"
OPTIMISED, NAMED = "optimised", "of the environment"  # origin of the gains
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
        gains: OPTIMISED, by the metric "settling" with the thickness fixed, or NAMED, by `flexman optimise gains`.
        frequency: first natural frequency with held motors at zero joint angles, Hz.
        mass: mass of the links, kg.
        linear_time: settling time of the linear model with these gains, s.
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
    """Thickness of a section / given thickness; links and sections are numbered from 1, base to tip."""

    design: str
    link: float
    section: float
    thickness: float


def given_environment() -> Configuration:
    """Return the environment with the corrected area of link 1: a cross-section with the printed area is impossible.

    All designs have the limits of the named environment, so that settling times alone are compared.
    """
    rotor = {"rotor_inertia": 10.0, "torque_limit": 400.0, "modal_damping_ratio": 0.005}
    arm = {"catalog": "paper_rrr", "link1_area": "corrected", **rotor}
    return Configuration(ENVIRONMENT, {"arm": arm, "settings": "named", "gains": Configuration(ENVIRONMENT).pd_gains})


def rows() -> tuple[list[DesignRow], list[ProfileRow]]:
    """Return the rows of all designs and their profiles."""
    given, profiles = given_environment(), []
    arms: dict[str, tuple[Configuration, Vector]] = {GIVEN: (given, [1.0] * given.arm.n_joints)}
    for name, (metric, keep, bounds) in DESIGNS.items():
        found = optimise_arm(given, metric, SECTIONS, gears=bounds, keep=keep)
        arms[name] = found.environment, found.gears
        profiles += [
            ProfileRow(name, link, section, factor)
            for link, factors in enumerate(found.thickness, 1)
            for section, factor in enumerate(factors, 1)
        ]
    results = []
    for name, (environment, gears) in arms.items():
        best = optimise_arm(environment, SETTLING, SECTIONS, thickness=(1.0, 1.0))
        if name == GIVEN:
            results.append(design_row(name, NAMED, environment, gears, best.before))
        results.append(design_row(name, OPTIMISED, best.environment, gears, best.after))
    return results, profiles


def design_row(name: str, origin: str, environment: Configuration, gears: Vector, linear_time: float) -> DesignRow:
    """Return the row of one arm with the gains of its environment."""
    longer, gains = environment.replace(horizon=HORIZON), environment.pd_gains
    metrics = evaluate("pd", longer, range(TEST_SEEDS.start, TEST_SEEDS.start + EPISODES))
    return DesignRow(
        design=name,
        gains=origin,
        frequency=float(frequencies(build_model(environment.arm, environment.elements), lock_joints=True)[0]),
        mass=sum(float(link.mass) for link in environment.arm.links),
        linear_time=linear_time,
        settled=metrics["settled"],
        settling_time=metrics["settling_time"],
        stiffness=_joined(gains["stiffness"]),
        damping=_joined(gains["damping"]),
        gears=_joined(gears),
    )


def _joined(values: Vector) -> str:
    return " ".join(f"{value:.4g}" for value in values)
