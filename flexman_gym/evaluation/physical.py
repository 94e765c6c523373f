"""Physical: whoever acts, on other simulations of the same arms: another method, a finer model, and MuJoCo.

Who plays is made for the environment as it is, and reads it through the same sensors; something else moves the arms. So
nobody does well by leaning on the errors of one simulator.
"""

from collections.abc import Callable, Sequence
from importlib.util import find_spec

from flexman_gym.checks import one_of, refusal
from flexman_gym.control.controller import Controller
from flexman_gym.envs.description import Description
from flexman_gym.evaluation.entrants import Entrant
from flexman_gym.evaluation.figures import FIGURES
from flexman_gym.evaluation.rollout import rollout
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.methods import METHODS
from flexman_gym.simulation.one_by_one import OneByOne
from flexman_gym.simulation.replica import Double, Finer, Replica
from flexman_gym.simulation.run import Run

METHOD, TOLERANCE = "dop853", (1e-6, 1e-9)  # it chooses its steps, relative and absolute local error
ELEMENTS, PARTS = 3, 4  # of a section; of the usual step


def _by_method(batch: Batch) -> None:
    runs = [Run(batch.model, METHODS[METHOD], TOLERANCE, []) for _ in batch.rows]
    batch.hand_over(lambda _: OneByOne(runs, (batch.control_period, 1)))


def _by_finer(batch: Batch) -> None:
    _by_double(batch, Finer(batch, ELEMENTS, PARTS))


def _by_mujoco(batch: Batch) -> None:
    if find_spec("mujoco") is None:
        raise refusal("plant", "mujoco", "a plant that is installed (pip install mujoco)")
    from flexman_gym.simulation.mujoco import MuJoCo

    _by_double(batch, MuJoCo(batch.model, batch.control_period, len(batch.rows)))


def _by_double(batch: Batch, double: Double) -> None:
    batch.hand_over(lambda mover: Replica(batch.model, mover, double))


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


def physical_check(
    entrant: str | Entrant | Controller,
    environment: str | Description,
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
        result[plant] = {name: figure.sum_up(records) for name, figure in FIGURES.items()}
    return result
