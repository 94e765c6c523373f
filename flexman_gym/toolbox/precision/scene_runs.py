"""Runs of a scene for a chart of error against computing time: reference, models, methods, steps, other simulators."""

import importlib
from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from flexman_gym.envs.config.arm_settings import LONGEST_PERIOD, PERIODS_PER_VIBRATION, SHORTEST_PERIOD
from flexman_gym.envs.config.named_environments import DEFAULT_ID, NAMED_ENVIRONMENTS
from flexman_gym.model.assembled_modes import assembled_modes
from flexman_gym.model.model import Model, build_model
from flexman_gym.model.vibration import modes
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.scene import MAX_ELEMENTS, Scene
from flexman_gym.simulation.integrator import default_step
from flexman_gym.simulation.methods import DEFAULT_METHOD
from flexman_gym.simulation.scene_simulation import simulate
from flexman_gym.toolbox.precision.runs import OK, PrecisionRow, PrecisionScene, ReferenceSolution, Timer

COMPARED = (DEFAULT_METHOD, "midpoint_corrected_2", "midpoint_3", "gauss_2", "gauss_3", "extrapolated_euler_5", "ros2")
RIGID_METHODS = (DEFAULT_METHOD, "rk4")
RIGID, RIGID_LINKS, DEFAULT = "rigid", "rigid links, flexible joints", "modes of the default"
PLAIN, SHORTENED = "2 elements a link", "2 elements a link, foreshortening"
HALVINGS = 6  # number of times that the longest step, two output steps, is halved
PATIENCE = 1.0  # s; a method and model with a run of this CPU time gets no finer step
FINEST, COARSER = 4, 3  # elements of a link in the reference, and in the model that estimates its error
REFERENCE_METHOD, REFERENCE_PARTS, MOST_PARTS = "gauss_3", 10, 640  # method; steps per output step, first and largest
CONVERGED = 0.1  # largest change by a halved step / error of the mesh
MODULES = {"MuJoCo": "mujoco", "Exudyn": "exudyn", "Pinocchio": "pinocchio"}  # simulator -> module in `peers`


class DefaultRun(NamedTuple):
    """Model, method and step that the environments use for an arm.

    Attributes:
        model: component modes that vibrations below half the control rate need.
        method: name of the method.
        step: s.
    """

    model: Model
    method: str
    step: float


@lru_cache(maxsize=8)
def default_run(scene: Scene) -> DefaultRun:
    """Return model, method and step of an environment with the arm of a scene.

    The control period is a fraction of the period of the first vibration, see `envs.config.arm_settings`. The step is
    the longest up to that of the environment that divides the output step, or is a multiple of it.
    """
    held = modes(build_model(scene.arm, elements=2)).frequencies
    shortest = 1.0 / (PERIODS_PER_VIBRATION * held[0]) if len(held) else LONGEST_PERIOD
    period = min(max(shortest, SHORTEST_PERIOD), LONGEST_PERIOD)
    model = build_model(scene.arm, 2, assembled_modes(scene.arm, 2, 0.5 / period))
    longest = default_step(period, NAMED_ENVIRONMENTS[DEFAULT_ID].longest_step)
    if longest <= scene.output_step:
        return DefaultRun(model, DEFAULT_METHOD, default_step(scene.output_step, longest))
    multiple = int(longest / scene.output_step + 1e-9)
    return DefaultRun(model, DEFAULT_METHOD, multiple * scene.output_step)


def scene_models(scene: Scene) -> dict[str, Model]:
    """Return the models of a scene by name, from rigid links to all elastic coordinates with foreshortening."""
    elastic = any(joint.stiffness is not None for joint in scene.arm.joints)
    flexible = any(link.flexible for link in scene.arm.links)
    result = {RIGID: build_model(scene.arm, flexible_links=False, flexible_joints=False)}
    if elastic and flexible:
        result[RIGID_LINKS] = build_model(scene.arm, flexible_links=False)
    result[DEFAULT] = default_run(scene).model
    if flexible:
        result[PLAIN] = build_model(scene.arm, 2)
        result[SHORTENED] = build_model(scene.arm, 2, stiffening=True)
    return result


def finest_solution(scene: Scene) -> ReferenceSolution:
    """Return the motion of the tip by a fine mesh with foreshortening, with an estimate of its error.

    The estimate is the distance from a mesh with one element of a link less. The step is halved until its effect is
    a tenth of that.

    Raises:
        RuntimeError: if a run fails, or the shortest step has a larger effect.
    """
    fine, coarse = (_mesh(scene.arm, count) for count in (FINEST, COARSER))
    parts = REFERENCE_PARTS
    runs = [simulate(scene, model, REFERENCE_METHOD, scene.output_step / parts) for model in (fine, coarse)]
    while all(run.status == OK for run in runs) and parts < MOST_PARTS:
        parts *= 2
        finer = simulate(scene, fine, REFERENCE_METHOD, scene.output_step / parts)
        change, mesh = (float(np.linalg.norm(runs[0].tip - run.tip, axis=1).max()) for run in (finer, runs[1]))
        runs[0] = finer
        if change <= max(CONVERGED * mesh, 1e-9):
            floor = max(mesh, change, float(np.finfo(float).eps))
            return ReferenceSolution(finer.tip, floor, f"{FINEST} elements a link, foreshortening, {REFERENCE_METHOD}")
    raise RuntimeError(f"the reference does not converge: {', '.join(run.status for run in runs)}; shorten the motion")


def _mesh(arm: Arm, elements: int) -> Model:
    """Return the model with a number of elements of each section of a link, and foreshortening."""
    counts = tuple(max(1, min(elements, MAX_ELEMENTS // len(link.sections))) for link in arm.links)
    return build_model(arm, counts, stiffening=any(link.flexible for link in arm.links))


def precision_scene(scene: Scene, name: str) -> PrecisionScene:
    """Return a scene with its models and its reference."""
    return PrecisionScene(name, scene, scene_models(scene), finest_solution(scene), {}, scene.note)


def our_rows(
    result: PrecisionScene, methods: Sequence[str] = (), longest_step: float | None = None
) -> Iterator[PrecisionRow]:
    """Yield a row for each model, method and step; the default of the environments first.

    Args:
        result: scene with its models and reference.
        methods: methods of fixed steps; empty for `COMPARED`, and `RIGID_METHODS` for models without elastic
            coordinates.
        longest_step: step that is halved `HALVINGS` times, s; None for two output steps.
    """
    first = default_run(result.scene)
    yield result.row(DEFAULT, first.method, first.step)
    for model, built in result.models.items():
        for method in methods or (COMPARED if built.n_elastic else RIGID_METHODS):
            for row in result.ladder(model, method, _steps(result.scene, longest_step), PATIENCE):
                if (row.model, row.method, row.step) != (DEFAULT, first.method, first.step):
                    yield row


def _steps(scene: Scene, longest: float | None) -> list[float]:
    """Return the steps (s): the longest and its halves; two output steps only if they divide the duration."""
    if longest is None:
        even = round(scene.duration / scene.output_step) % 2 == 0
        longest = scene.output_step * (2 if even else 1)
    return [longest * 0.5**power for power in range(HALVINGS + 1)]


def peer_timers(result: PrecisionScene) -> tuple[list[Timer], list[str]]:
    """Return timers of the runs of the installed simulators, and a line for each simulator that is left out."""
    timers: list[Timer] = []
    lines = []
    for name, module in MODULES.items():
        try:
            timers += importlib.import_module(f"flexman_gym.toolbox.precision.peers.{module}").runs(result)
        except ModuleNotFoundError:
            lines.append(f"{name} is not installed, so it is left out: pip install 'flexman_gym[peers]'")
        except ValueError as error:
            lines.append(f"{name} is left out: {str(error).splitlines()[0]}")
    return timers, lines
