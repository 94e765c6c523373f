"""Scenarios: environments, conditions, parameter sweeps, and plants simulated by other methods."""

from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from typing import Any, NamedTuple

from flexman_gym.common.checks import one_of, value_error
from flexman_gym.control.controller import Controller
from flexman_gym.envs.config.conditions import NOMINAL
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.named_environments import DEFAULT
from flexman_gym.evaluation.agent import AgentSpec, split_interface
from flexman_gym.evaluation.metrics import METRICS
from flexman_gym.evaluation.rollout import rollout
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.batch_integrators import SequentialIntegrator
from flexman_gym.simulation.integrator import Integrator
from flexman_gym.simulation.methods import METHODS
from flexman_gym.simulation.resimulation import ExternalIntegrator, ExternalSimulator, RefinedSimulator

METHOD, TOLERANCE = "dop853", (1e-6, 1e-9)  # it chooses its steps, relative and absolute local error
ELEMENTS, PARTS = 3, 4  # of a section; of the usual step


def _by_method(batch: Batch) -> None:
    runs = [Integrator(batch.model, METHODS[METHOD], TOLERANCE, []) for _ in batch.rows]
    batch.replace_integrator(lambda _: SequentialIntegrator(runs, (batch.control_period, 1)))


def _by_finer(batch: Batch) -> None:
    _by_double(batch, RefinedSimulator(batch, ELEMENTS, PARTS))


def _by_mujoco(batch: Batch) -> None:
    if find_spec("mujoco") is None:
        raise value_error("plant", "mujoco", "a plant that is installed (pip install mujoco)")
    from flexman_gym.simulation.mujoco import MuJoCoSimulator

    _by_double(batch, MuJoCoSimulator(batch.model, batch.control_period, len(batch.rows)))


def _by_double(batch: Batch, double: ExternalSimulator) -> None:
    batch.replace_integrator(lambda mover: ExternalIntegrator(batch.model, mover, double))


PLANTS: dict[str, tuple[str, Callable[[Batch], None]]] = {
    "usual": ("the simulator as it is", lambda batch: None),
    "method": (f"the same model, moved by {METHOD}, which chooses its steps", _by_method),
    "finer": (f"{ELEMENTS} elements a link, all coordinates, foreshortening, steps {PARTS} times as short", _by_finer),
    "mujoco": ("MuJoCo, every link 3 rigid pieces between springs", _by_mujoco),
}


def find_plant(name: str) -> Callable[[Batch], None]:
    """Gives what lets a plant of PLANTS move the arms of a batch; `rollout` takes it as `moved`.

    Raises:
        ValueError: for another name.
    """
    return PLANTS[one_of("plant", name, PLANTS)][1]


def evaluate_on_plants(
    entrant: str | AgentSpec | Controller,
    environment: str | Configuration,
    seeds: Sequence[int],
    plants: Sequence[str] = tuple(PLANTS),
) -> dict[str, dict[str, float]]:
    """Gives every figure of FIGURES, as `evaluate` does, for each of the plants: plant -> name -> number.

    Args:
        entrant: see `rollout`.
        environment: see `rollout`.
        seeds: see `rollout`.
        plants: names in PLANTS.

    Raises:
        FileNotFoundError, ValueError: one line, also for "mujoco" where it is not installed.
    """
    result = {}
    for plant in plants:
        records = rollout(entrant, environment, seeds, moved=find_plant(plant)).records
        result[plant] = {name: figure.sum_up(records) for name, figure in METRICS.items()}
    return result


CONDITIONS = ("payload", "stiffness", "delay", "random-delay", "friction", "unknown", "unknown-lab")
TASKS = ("FlexRRR-Track-v0", "FlexRRR-Hold-v0", "FlexRRR-Gravity-v0", "FlexPlanar-v0")
USUAL_SCENARIOS = (DEFAULT, *(f"{DEFAULT}/{condition}" for condition in CONDITIONS), *TASKS)
LAB_SCENARIO = f"{DEFAULT}/unknown-lab"  # where an arm is as a laboratory has it
CHECKED = (DEFAULT, LAB_SCENARIO)  # on other plants too, see `physical`
KNOWN_NOISE = 0.001  # of the ranges, which controllers are told in the sweep of noise


class _ParameterSweep(NamedTuple):
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
    "payload": _ParameterSweep("payload, kg", (0.0, 5.0, 10.0, 15.0, 20.0, 25.0), _drawn("payload_mass"), "payload"),
    "stiffness": _ParameterSweep("stiffness of joints and links, parts of the nominal one", (0.5, 0.7, 0.85, 1.0,
        1.15, 1.3, 1.5),
                       _drawn("joint_stiffness_factor", "link_stiffness_factor"), "stiffness"),
    "delay": _ParameterSweep("delay, control periods", (0.0, 1.0, 2.0, 3.0), _drawn("delay"), "random-delay"),
    "noise": _ParameterSweep("noise of sensors, parts of their ranges", (0.0, 0.001, 0.003, 0.01),
        _drawn("sensor_noise"),
                   told=_drawn("sensor_noise")(KNOWN_NOISE)),
    "period": _ParameterSweep("control period, s", (0.005, 0.01, 0.02, 0.04), lambda value: {"control_period": value},
        told=None),
}  # fmt: skip


class Scenario(NamedTuple):
    """Where episodes are played, the environment that controllers are made for, and the plant that moves its arms."""

    environment: Configuration
    told: Configuration
    plant: str = "usual"


def find_scenario(name: str) -> Scenario:
    """Gives the venue of an environment, of a value of a sweep such as "FlexRRR-v0/payload=25", or "FlexRRR-v0@mujoco".

    Raises:
        FileNotFoundError, ValueError: one line with what is wrong and what is allowed.
    """
    name, at, plant = name.partition("@")
    if at:
        return find_scenario(name)._replace(plant=one_of("plant", plant, PLANTS))
    id, _, tail = name.rpartition("/")
    sweep, equals, value = tail.partition("=")
    if not equals:
        described = split_interface(Configuration.find(name))[0]
        return Scenario(described, described)
    swept = SWEEPS[one_of("sweep", sweep, SWEEPS)]
    try:
        played = swept.setting(int(value) if value.isdecimal() else float(value))
    except ValueError:
        raise value_error("sweep", name, f"a number after {sweep}=") from None
    told = split_interface(Configuration(id, {"condition": swept.condition}))[0].settings
    heard = played if swept.told is None else swept.told
    environment, known = (Configuration.from_plain({"id": id, **told, **each}) for each in (played, heard))
    return Scenario(environment, known)


def sweep_scenarios(id: str, sweep: str) -> list[str]:
    """Gives the names of the venues of a sweep of an environment.

    Raises:
        ValueError: for another sweep.
    """
    return [f"{id}/{sweep}={value:g}" for value in SWEEPS[one_of("sweep", sweep, SWEEPS)].values]


def plant_scenarios() -> list[str]:
    """Gives the names of the venues of the physical check."""
    return [f"{venue}@{plant}" for venue in CHECKED for plant in PLANTS if plant != "usual"]
