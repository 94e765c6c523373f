"""Venues: where a league is played: named environments, their conditions, sweeps of one number, and other plants."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from flexman_gym.checks import one_of, refusal
from flexman_gym.envs.catalog import DEFAULT
from flexman_gym.envs.description import NOMINAL, Description
from flexman_gym.evaluation.entrants import parted
from flexman_gym.evaluation.physical import PLANTS

CONDITIONS = ("payload", "stiffness", "delay", "random-delay", "friction", "unknown", "unknown-lab")
TASKS = ("FlexRRR-Track-v0", "FlexRRR-Hold-v0", "FlexRRR-Gravity-v0", "FlexPlanar-v0")
USUAL = (DEFAULT, *(f"{DEFAULT}/{condition}" for condition in CONDITIONS), *TASKS)
ASKED = f"{DEFAULT}/unknown-lab"  # where an arm is as a laboratory has it
CHECKED = (DEFAULT, ASKED)  # on other plants too, see `physical`
KNOWN_NOISE = 0.001  # of the ranges, which controllers are told in the sweep of noise


class Sweep(NamedTuple):
    """A number that is changed over a range, beyond what controllers are told.

    Attributes:
        what: of an axis.
        values: that are played.
        setting: gives the settings that are played, for a value.
        condition: whose settings these change.
        told: what controllers are told instead; None for the truth.
    """

    what: str
    values: tuple[float, ...]
    setting: Callable[[float], dict[str, Any]]
    condition: str = NOMINAL
    told: Mapping[str, Any] | None = {}


def _drawn(*names: str) -> Callable[[float], dict[str, Any]]:
    return lambda value: {"randomisation": {name: [value, value] for name in names}}


SWEEPS = {
    "payload": Sweep("payload, kg", (0.0, 5.0, 10.0, 15.0, 20.0, 25.0), _drawn("payload_mass"), "payload"),
    "stiffness": Sweep("stiffness of joints and links, parts of the nominal one", (0.5, 0.7, 0.85, 1.0, 1.15, 1.3, 1.5),
                       _drawn("joint_stiffness_factor", "link_stiffness_factor"), "stiffness"),
    "delay": Sweep("delay, control periods", (0.0, 1.0, 2.0, 3.0), _drawn("delay"), "random-delay"),
    "noise": Sweep("noise of sensors, parts of their ranges", (0.0, 0.001, 0.003, 0.01), _drawn("sensor_noise"),
                   told=_drawn("sensor_noise")(KNOWN_NOISE)),
    "period": Sweep("control period, s", (0.005, 0.01, 0.02, 0.04), lambda value: {"control_period": value}, told=None),
}  # fmt: skip


class Venue(NamedTuple):
    """Where episodes are played, the environment that controllers are made for, and the plant that moves its arms."""

    environment: Description
    told: Description
    plant: str = "usual"


def find_venue(name: str) -> Venue:
    """Gives the venue of an environment, of a value of a sweep such as "FlexRRR-v0/payload=25", or "FlexRRR-v0@mujoco".

    Raises:
        FileNotFoundError, ValueError: one line with what is wrong and what is allowed.
    """
    name, at, plant = name.partition("@")
    if at:
        return find_venue(name)._replace(plant=one_of("plant", plant, PLANTS))
    id, _, tail = name.rpartition("/")
    sweep, equals, value = tail.partition("=")
    if not equals:
        described = parted(Description.find(name))[0]
        return Venue(described, described)
    swept = SWEEPS[one_of("sweep", sweep, SWEEPS)]
    try:
        played = swept.setting(int(value) if value.isdecimal() else float(value))
    except ValueError:
        raise refusal("sweep", name, f"a number after {sweep}=") from None
    told = parted(Description.under(id, swept.condition))[0].whole_settings()
    heard = played if swept.told is None else swept.told
    environment, known = (Description.from_dict({"id": id, **told, **each}) for each in (played, heard))
    return Venue(environment, known)


def sweep_names(id: str, sweep: str) -> list[str]:
    """Gives the names of the venues of a sweep of an environment.

    Raises:
        ValueError: for another sweep.
    """
    return [f"{id}/{sweep}={value:g}" for value in SWEEPS[one_of("sweep", sweep, SWEEPS)].values]


def physical_names() -> list[str]:
    """Gives the names of the venues of the physical check."""
    return [f"{venue}@{plant}" for venue in CHECKED for plant in PLANTS if plant != "usual"]
