"""Scenarios: environments, conditions, parameter sweeps, and plants simulated by other methods."""

from collections.abc import Callable, Mapping
from importlib.util import find_spec
from typing import Any, NamedTuple

from flexman_gym.common.checks import one_of
from flexman_gym.common.errors import value_error
from flexman_gym.envs.config.conditions import missing_ranges
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.named_environments import DEFAULT_ID, NAMED_ENVIRONMENTS
from flexman_gym.envs.registration import NOMINAL
from flexman_gym.evaluation.agent_spec import INTERFACE
from flexman_gym.evaluation.metrics import task_metrics
from flexman_gym.evaluation.policy_files import policy_folder, read_policy
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.batch_integrators import SequentialIntegrator
from flexman_gym.simulation.external_simulator import ExternalIntegrator, ExternalSimulator, RefinedSimulator
from flexman_gym.simulation.integrator import Integrator, find_method
from flexman_gym.simulation.methods import METHODS

METHOD, TOLERANCE = "dop853", (1e-6, 1e-9)  # adaptive integration method; its relative and absolute local error
ELEMENTS, STEP_DIVISOR = 3, 4  # finite elements for each section of a link; divisor of the usual step


def _set_method_plant(batch: Batch) -> None:
    runs = [Integrator(batch.model, METHODS[METHOD], TOLERANCE, []) for _ in batch.rows]
    batch.replace_integrator(lambda _: SequentialIntegrator(runs, (batch.control_period, 1)))


def check_mujoco() -> None:
    """Raise ValueError if MuJoCo is not installed."""
    if find_spec("mujoco") is None:
        raise value_error("plant", "mujoco", "a plant that is installed (pip install mujoco)")


def _set_mujoco_plant(batch: Batch) -> None:
    check_mujoco()
    from flexman_gym.toolbox.interchange.mujoco import MuJoCoSimulator

    _set_external_plant(batch, MuJoCoSimulator(batch.model, batch.control_period, len(batch.rows)))


def _set_external_plant(batch: Batch, simulator: ExternalSimulator) -> None:
    batch.replace_integrator(lambda integrator: ExternalIntegrator(batch.model, integrator, simulator))


PLANTS: dict[str, tuple[str, Callable[[Batch], None]]] = {
    "usual": ("the simulator of the environment", lambda batch: None),
    "method": (f"the same model, integrated by {METHOD} with adaptive steps", _set_method_plant),
    "finer": (
        f"{ELEMENTS} elements for each link, all coordinates, foreshortening, a step {STEP_DIVISOR} times shorter",
        lambda batch: _set_external_plant(batch, RefinedSimulator(batch, ELEMENTS, STEP_DIVISOR)),
    ),
    "mujoco": ("MuJoCo, each link as 3 rigid bodies connected by springs", _set_mujoco_plant),
}
"""Name -> description, and function that replaces the simulation of the arms: the argument `set_plant` of `rollout`."""

CONDITIONS = (
    "payload", "stiffness", "delay", "random-delay", "friction", "unknown", "unknown-lab", "uncertain", "unmodelled",
)  # fmt: skip
TASKS = ("FlexRRR-Track-v0", "FlexRRR-Hold-v0", "FlexRRR-Gravity-v0", "FlexPlanar-v0")
USUAL_SCENARIOS = (DEFAULT_ID, *(f"{DEFAULT_ID}/{condition}" for condition in CONDITIONS), *TASKS)
LAB_SCENARIO = f"{DEFAULT_ID}/unknown-lab"  # unknown arm with the sensors of a laboratory
PLANT_SCENARIOS = [f"{each}@{plant}" for each in (DEFAULT_ID, LAB_SCENARIO) for plant in PLANTS if plant != "usual"]
GIVEN_NOISE = 0.001  # fraction of the range of a sensor; noise for which controllers are designed in a noise sweep
NOISY = {"randomisation": {"sensor_noise": [GIVEN_NOISE, GIVEN_NOISE]}}  # background of sweeps of sensor errors
GIVEN = "+given"  # suffix of a scenario whose controllers are designed for the changed environment


class _ParameterChange(NamedTuple):
    """Change of an environment in the name of a scenario, such as "delay=3".

    Attributes:
        text: changed quantity and its unit, the label of an axis.
        settings: function from an environment and the text after "=" to the changed settings.
        values: values of a sweep.
        condition: condition of the changed environment if the name of the scenario has an id without a condition.
        background: further settings of the environment, for an id without a condition.
        always_given: True if controllers are always designed for the changed environment.
    """

    text: str
    settings: Callable[[Configuration, str], dict[str, Any]]
    values: tuple[float, ...] = ()
    condition: str = NOMINAL
    background: Mapping[str, Any] = {}
    always_given: bool = False


def _number(text: str) -> int | float:
    return int(text) if text.isdecimal() else float(text)


def _range_settings(*names: str) -> Callable[[Configuration, str], dict[str, Any]]:
    """Return the function `settings` of a change of randomised parameters to "value" or "low:high".

    Of several parameters, those of springs or flexible links that the arm does not have are left out.
    """

    def settings(environment: Configuration, value: str) -> dict[str, Any]:
        own = [name for name in names if name not in missing_ranges(environment.arm)]
        if not own:
            raise value_error("arm", "one of rigid joints and links", "one with a spring or a flexible link")
        low, colon, high = value.partition(":")
        span = [_number(low), _number(high if colon else low)]
        return {"randomisation": {**environment.randomised_ranges, **{name: list(span) for name in own}}}

    return settings


def _friction_settings(environment: Configuration, value: str) -> dict[str, Any]:
    """Return the arm with a multiple of the motor friction in the condition "friction" of its named environment."""
    frictional = Configuration(environment.id, {"condition": "friction"}).to_plain()["arm"]
    factor, plain = _number(value), environment.to_plain(strict=False)["arm"]
    if len(plain["joints"]) != len(frictional["joints"]):
        raise value_error("arm", f"one of {len(plain['joints'])} joints", f"one of {len(frictional['joints'])}")
    scaled = [{name: each[name] * factor for name in ("viscous_friction", "coulomb_friction")}
              | {"coulomb_rate": each["coulomb_rate"]} for each in frictional["joints"]]  # fmt: skip
    joints = [{**own, **each} for own, each in zip(plain["joints"], scaled, strict=True)]
    return {"arm": {**plain, "joints": joints}}


def _method_settings(environment: Configuration, value: str) -> dict[str, Any]:
    """Return an integration method and a quarter of the step (s) of the environment."""
    return {"method": find_method(value).name, "step": environment.integration_step / 4.0}


CHANGES = {
    "payload": _ParameterChange(
        "payload, kg", _range_settings("payload_mass"), (0.0, 5.0, 10.0, 15.0, 20.0, 25.0), "payload"
    ),
    "stiffness": _ParameterChange(
        "stiffness of joints and links relative to the nominal",
        _range_settings("joint_stiffness_factor", "link_stiffness_factor"),
        (0.5, 0.7, 0.85, 1.0, 1.15, 1.3, 1.5),
        "stiffness",
    ),
    "delay": _ParameterChange("delay, control periods", _range_settings("delay"), (0.0, 1.0, 2.0, 3.0), "random-delay"),
    "noise": _ParameterChange(
        "sensor noise relative to the range",
        _range_settings("sensor_noise"),
        (0.0, 0.001, 0.003, 0.01),
        background=NOISY,
    ),
    "period": _ParameterChange(
        "control period, s",
        lambda _, value: {"control_period": _number(value)},
        (0.005, 0.01, 0.02, 0.04),
        always_given=True,
    ),
    "bias": _ParameterChange(
        "largest sensor bias relative to the range",
        lambda environment, value: _range_settings("sensor_bias")(environment, f"-{value}:{value}"),
        (0.0, 0.001, 0.003, 0.005),
        background=NOISY,
        always_given=True,
    ),
    "lost": _ParameterChange(
        "share of lost samples",
        _range_settings("dropped_samples"),
        (0.0, 0.01, 0.03, 0.1),
        background=NOISY,
    ),
    "friction": _ParameterChange(
        "motor friction relative to that of the condition", _friction_settings, (0.0, 0.5, 1.0, 1.5), "friction"
    ),
    "method": _ParameterChange("integration method, at a quarter of the step", _method_settings, always_given=True),
}
SWEEPS = {name: change for name, change in CHANGES.items() if change.values}


class Scenario(NamedTuple):
    """Environment, information given to the agent, and plant.

    Attributes:
        environment: environment of the episodes.
        given: environment for which controllers are designed: the information on the arm given to the agent.
        plant: simulation of the arms, a name in PLANTS.
    """

    environment: Configuration
    given: Configuration
    plant: str = "usual"

    @property
    def has_settling(self) -> bool:
        """True if the goal is at rest, so that the episodes have a settling time."""
        return "settling_time" in {each.name for each in task_metrics(self.environment.task)}

    def given_values(self) -> str:
        """Return the values for which the controllers of a sweep are designed: the value, a range, or nominal."""
        if self.environment == self.given:
            return "the value"
        known, ranges = self.given.randomised_ranges, self.environment.randomised_ranges
        changed = [known.get(name) for name, span in ranges.items() if known.get(name) != span]
        if not changed:
            return "nominal"
        low, high = changed[0] or (0.0, 0.0)
        return f"{low:g}" if low == high else f"{low:g} to {high:g}"


def find_scenario(name: str) -> Scenario:
    """Return the scenario of a name: ENVIRONMENT[/CHANGE=VALUE[+given]][@PLANT].

    ENVIRONMENT is an id, an id and a condition, a file, or the name or folder of a policy for the environment of its
    training. CHANGE is one of CHANGES; VALUE is a number or, for a randomised parameter, a range "low:high".
    Controllers are designed for ENVIRONMENT without the change; with "+given" they are designed for the changed
    environment. For an id without a condition, the condition of CHANGE is used: "FlexRRR-v0/delay=3" is a change of
    "FlexRRR-v0/random-delay", and "FlexRRR-v0/nominal/delay=3" is a change of the nominal environment. PLANT is one of
    PLANTS, the simulations of the arm.

    Args:
        name: name of the scenario.

    Raises:
        ValueError, FileNotFoundError: for an unknown environment.
    """
    name, at, plant = name.partition("@")
    if at:
        return find_scenario(name)._replace(plant=one_of("plant", plant, PLANTS))
    where, _, tail = name.removesuffix(GIVEN).rpartition("/")
    parameter, equals, value = tail.partition("=")
    if not equals:
        environment = _find_environment(name)
        return Scenario(environment, environment)
    change = CHANGES[one_of("sweep", parameter, CHANGES)]
    base = _find_environment(f"{where}/{change.condition}" if where in NAMED_ENVIRONMENTS else where)
    if where in NAMED_ENVIRONMENTS:
        base = base.replace(**change.background)
    try:
        settings = change.settings(base, value)
    except ValueError as error:
        if " is not allowed" in str(error):
            raise
        raise value_error("sweep", name, f"a number after {parameter}=") from None
    changed = base.replace(**settings)
    return Scenario(changed, changed if change.always_given or name.endswith(GIVEN) else base)


def _find_environment(name: str) -> Configuration:
    """Return the environment of a policy, an id, an id and a condition, or a file, without settings of the agent."""
    if folder := policy_folder(name):
        whole = Configuration.from_plain(read_policy(folder).metadata["environment"])
    else:
        whole = Configuration.find(name.removesuffix(f"/{NOMINAL}"))
    return whole.without(INTERFACE)


def change_name(scenario: str) -> str:
    """Return the change in the name of a scenario, such as "delay=3" or "@mujoco", without "+given"."""
    where, at, plant = scenario.partition("@")
    return at + plant or where.rpartition("/")[2].removesuffix(GIVEN)
