"""Selection of a small model, an integration method and a long step within a tolerance of the tip position."""

import time as clock
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import instance, positive
from flexman_gym.common.errors import value_error
from flexman_gym.model.dynamics import frequencies, stiffness_matrix
from flexman_gym.model.model import Model
from flexman_gym.scene.scene import Scene
from flexman_gym.simulation.methods import EXPLICIT, METHODS, Method
from flexman_gym.simulation.stability import NEGLIGIBLE_GROWTH, remaining_amplitude, spectral_radii, stability_limit
from flexman_gym.toolbox.fidelity.mesh_search import MeshSearch
from flexman_gym.toolbox.fidelity.model_search import Candidate, CandidateRun, ModelSearch

SAFETY_FACTOR = 0.8  # dimensionless; largest estimated error of the selected simulation / tolerance
COST_TOLERANCE = 1.25  # dimensionless; ratio of two costs up to which they differ by the scatter of the timing only
STEP_MULTIPLES = (10, 8, 5, 4, 3, 2)  # dimensionless; steps to try / output step
# dimensionless; output step / steps to try
STEP_PARTS = (1, 2, 3, 4, 5, 6, 8, 10, 13, 16, 20, 25, 32, 40, 50, 64, 80, 100, 128, 160, 200, 256, 320, 400, 512, 1024)
REPORTED_GROWTH = 0.01  # dimensionless; numerical growth of a mode in 10 s above which it is reported
MAX_GROWTH = 100.0  # dimensionless; largest numerical growth of a mode in the duration of the scene


@dataclass(frozen=True, eq=False)
class Choice:
    """Model, method and step selected by `choose_model`.

    Attributes:
        model: the model, for `simulate`.
        method: name of the integration method, a key of `METHODS`.
        step: step of the method, s.
        estimated_error: largest distance between the tip positions of the selected simulation and of the reference at
            the outputs, plus the error of the reference, m.
        dropped: a text for each omitted part of the model, with its effect.
        report: text with frequencies, step, numerical damping, the effect of each retained component mode, and
            computing cost. The effect is the tip error by the model when this mode alone is omitted as well, measured
            before the last modes were omitted singly, or the estimated tip displacement by the mode. If the mesh was
            selected as well, the report also has the estimated effect of large rotations, which `estimated_error` does
            not include.
        errors: component -> error, m; the components are "mesh", "modes", "foreshortening", "method" and "reference"
            if the mesh was selected as well, else "model" and "reference". They may cancel in part, so that their sum
            exceeds `estimated_error`.
        runs: number of simulations of the scene for the selection.

    Examples:
        >>> choice = fm.choose_model(fm.catalog.paper_scene("rr"), tolerance=0.1)
        >>> choice.method in fm.METHODS, sorted(choice.errors)
        (True, ['model', 'reference'])
        >>> fm.simulate(fm.catalog.paper_scene("rr"), choice.model, choice.method, choice.step).status
        'ok'
    """

    model: Model
    method: str
    step: float
    estimated_error: float
    dropped: tuple[str, ...]
    report: str
    errors: dict[str, float]
    runs: int

    def __repr__(self) -> str:
        omitted = f"{len(self.dropped)} parts left out" if self.dropped else "nothing left out"
        return (
            f"<Choice: {self.method} with steps of {self.step:g} s, estimated error {self.estimated_error:.3g} m\n"
            f"  {self.model.n_dof} coordinates, {omitted}: see dropped and report>"
        )


def choose_model(scene: Scene, tolerance: float, longest_step: float | None = None) -> Choice:
    """Select the model, method and step of lowest computing cost whose tip error in a scene is within a tolerance.

    The error is the distance of the tip position from the tip position of a reference: a converged simulation with the
    finite elements of the scene, all elastic coordinates and foreshortening. It does not include the discretisation
    error of these elements. For a scene with `elements=None` the number of elements is selected as well; the reference
    then has five elements per link, and its discretisation error is estimated from a simulation with one element less
    per link.

    Candidate models omit foreshortening, the springs of all joints, or the component modes with the smallest tip
    displacement in the motion of the reference. Their errors are measured in simulations of the scene. Costs up to
    1.25 times the lowest are regarded as equal; of these models the one with the fewest coordinates is selected. From
    it, single component modes are then omitted, smallest error first, as far as the tolerance allows; the result is
    selected unless it costs more.

    The tolerance holds at the outputs of the scene; with a step longer than the output step it holds after each step
    and, between steps, for cubic interpolation of positions and velocities.

    The selection takes some hundred simulations of the scene, at most one hundred with `elements=None`. Repeated calls
    with the same arguments return the same object from a cache.

    Args:
        scene: the scene.
        tolerance: largest error of the tip position, m.
        longest_step: longest step to try, s; None for ten output steps.

    Returns:
        The selected model, method and step, with the components of the error and a report.

    Raises:
        ValueError: for an invalid scene or tolerance, and if no candidate meets the tolerance, with the smallest error.

    Examples:
        >>> choice = fm.choose_model(fm.catalog.paper_scene("rr"), tolerance=0.01)
        >>> choice.estimated_error < 0.01
        True
    """
    instance("scene", scene, Scene, "a Scene")
    if scene.initial.state is not None:
        raise value_error(
            "scene.initial.state", scene.initial.state, "None: the candidate models have different states"
        )
    longest = np.inf if longest_step is None else positive("longest_step", longest_step, "s")
    return _choose(scene, positive("tolerance", tolerance, "m"), longest)


@lru_cache(maxsize=64)
def _choose(scene: Scene, tolerance: float, longest: float) -> Choice:
    """Return the result of `choose_model` for checked arguments; `longest` is the longest step, s."""
    started = clock.process_time()
    search = MeshSearch(scene, tolerance) if scene.model.elements is None else ModelSearch(scene, tolerance)
    if search.error > search.max_reference_share * tolerance:
        least = 2.0 * search.error / search.max_reference_share
        raise value_error("tolerance", tolerance, f"at least {least:.2g} m, the accuracy of the reference")
    parts = search.contributions()
    trials = [trial for candidate in _candidates(search, parts) for trial in _run_candidate(search, candidate, longest)]
    accurate = [trial for trial in trials if trial.error + search.error <= SAFETY_FACTOR * tolerance]
    if not accurate:
        reached = min(trial.error for trial in trials) if trials else np.inf
        raise value_error(
            "tolerance", tolerance, f"at least {(reached + search.error) / SAFETY_FACTOR:.2g} m, the error reached"
        )
    selected = _cheapest(search, accurate)
    single_errors = search.single_errors(selected.candidate, parts)
    best = _omit_singly(search, selected, single_errors)
    search.refine_reference(best.error)
    run = search.run(*best[:3])
    error, errors = search.tip_error(run) + search.error, search.errors(best.candidate, run)
    dropped = _describe_dropped(search, best.candidate, parts)
    longer = [trial for trial in trials if trial[:2] == selected[:2] and trial.step > selected.step]
    retained = _describe_retained(best.candidate, parts, single_errors)
    report = _write_report(search, best, longer, retained, clock.process_time() - started)
    chosen = search.model(best.candidate), best.method.name, best.step
    return Choice(*chosen, error, dropped, report, errors, search.runs)


def _cheapest(search: ModelSearch, accurate: list[CandidateRun]) -> CandidateRun:
    """Return the smallest of the simulations with similar lowest costs, timed again."""
    cheapest = min(trial.cost for trial in accurate)
    close = [trial for trial in accurate if trial.cost <= 1.5 * cheapest]
    if search.max_timed is not None:
        close = sorted(close, key=lambda trial: trial.cost)[: search.max_timed]
    timed = [(min(search.measure(*trial[:3]).cost for _ in range(3)), trial) for trial in close]
    quickest = min(cost for cost, _ in timed)
    similar = [(_model_size(search, trial), cost, trial) for cost, trial in timed if cost <= COST_TOLERANCE * quickest]
    return min(similar, key=lambda each: each[:2])[2]


def _omit_singly(
    search: ModelSearch, selected: CandidateRun, single_errors: dict[tuple[int, int], float]
) -> CandidateRun:
    """Omit single modes from the selected simulation, smallest error first, if it remains accurate and costs no more.

    Args:
        search: the search.
        selected: the simulation.
        single_errors: (link, mode number) -> tip error (m) by the model without this mode.

    Returns:
        The simulation with the same method and step and fewer modes, or the selected simulation.
    """
    limit, smallest = SAFETY_FACTOR * search.tolerance - search.error, selected
    for mode in sorted(single_errors, key=lambda each: single_errors[each]):
        candidate, has_runs = smallest.candidate.without([mode]), search.runs < search.max_runs_single
        if has_runs and single_errors[mode] <= limit and search.screen(candidate) <= limit:
            trial = search.measure(candidate, *selected[1:3])
            smallest = trial if trial.error <= limit else smallest
    if smallest is selected:
        return selected
    costs = [[search.measure(*each[:3]).cost for each in (smallest, selected)] for _ in range(3)]
    cost, cost_before = np.min(costs, axis=0)
    return smallest if cost <= cost_before else selected


def _model_size(search: ModelSearch, trial: CandidateRun) -> tuple[int, bool]:
    """Return the number of coordinates of the model of a trial, and True if it has foreshortening."""
    return search.model(trial.candidate).n_dof, trial.candidate.stiffening


def _candidates(search: ModelSearch, parts: dict[tuple[int, int], float]) -> list[Candidate]:
    """Return the candidates to simulate, fewest coordinates first; `parts` are `ModelSearch.contributions`."""
    result, stiffest = {search.full}, search.stiffest_modes() if search.has_softer_models else []
    for springs in {search.full.springs, False}:
        for stiffening in {False, search.full.stiffening}:
            start = search.full._replace(springs=springs, stiffening=stiffening)
            for share in search.tolerance_shares:
                limit = share * search.tolerance
                if search.screen(start) <= limit:
                    result.add(search.reduced(start, limit, list(parts)))
            if search.has_softer_models and search.screen(start) <= limit:  # for explicit methods
                softer = search.reduced(start, limit, stiffest)
                result.add(search.reduced(softer, search.tolerance_shares[0] * search.tolerance, list(parts)))
    angles = search.scene.initial.joint_angles

    def fastest(candidate: Candidate) -> float:
        return frequencies(search.model(candidate), angles).max()

    smallest: list[Candidate] = []
    for candidate in sorted(result, key=lambda each: (search.model(each).n_dof, each.stiffening)):
        error = search.screen(candidate)
        speed = fastest(candidate)
        if not any(
            search.screen(other) <= error and other.stiffening <= candidate.stiffening and fastest(other) <= speed
            for other in smallest
        ):
            smallest.append(candidate)
    return smallest


def _run_candidate(search: ModelSearch, candidate: Candidate, longest: float) -> Iterator[CandidateRun]:
    """Simulate a candidate with each method, with shorter steps until the tolerance or the cost limit is reached."""
    modes = frequencies(search.model(candidate), search.scene.initial.joint_angles)
    error_limit = SAFETY_FACTOR * search.tolerance - search.error
    all_steps = np.array([step for step in _admissible_steps(search.scene) if step <= longest * (1.0 + 1e-9)])
    for method in (METHODS[name] for name in search.methods):
        steps = _stable_steps(method, all_steps, modes, search.scene.duration)
        per_step, i = search.estimate_step_cost(candidate, method), search.first_index(method, steps)
        while i < len(steps) and per_step / steps[i] <= 1.2 * search.best and search.runs < search.max_runs:
            trial = search.measure(candidate, method, steps[i])
            per_step, search.last_steps[method.name] = search.step_cost(trial, per_step), trial.step
            yield trial
            if trial.error <= error_limit:
                search.best = min(search.best, trial.cost)
                break
            # The order of the method predicts the step, except from the error of a step far too long.
            factor = 0.5 if not trial.error < 1.0 else max(0.2, (error_limit / trial.error) ** (1.0 / method.order))
            i += max(1, sum(step > 1.15 * factor * trial.step for step in steps[i:]))


def _stable_steps(method: Method, steps: Array, modes: Array, duration: float) -> list[float]:
    """Return the steps (s) at which no mode (Hz) grows beyond MAX_GROWTH by a method within a duration (s)."""
    growth = duration / steps[:, None] * np.log(spectral_radii(method, 2.0 * np.pi * steps[:, None] * modes))
    return [float(step) for step in steps[(growth <= np.log(MAX_GROWTH)).all(axis=1)]]


def _admissible_steps(scene: Scene) -> list[float]:
    """Return the steps (s) to try for a scene that `simulate` accepts, in descending order."""
    rows = len(scene.output_times) - 1
    longer = [scene.output_step * multiple for multiple in STEP_MULTIPLES if rows % multiple == 0]
    return longer + [scene.output_step / parts for parts in STEP_PARTS]


def _describe_dropped(
    search: ModelSearch, candidate: Candidate, parts: dict[tuple[int, int], float]
) -> tuple[str, ...]:
    """Return a text for each part of the full model omitted in a candidate."""
    full, texts = search.full, []
    if full.stiffening and not candidate.stiffening:
        error = search.screen(full._replace(stiffening=False))
        texts.append(f"foreshortening: without it the tip moves by {error:.2g} m")
    if full.springs and not candidate.springs:
        error = search.screen(full._replace(springs=False))
        texts.append(f"springs of the joints: with rigid joints the tip moves by {error:.2g} m")
    model = search.model(full)
    squares = np.diag(stiffness_matrix(model))
    for i, modes in enumerate(full.modes):
        omitted = [mode for mode in modes if mode not in candidate.modes[i]]
        if omitted:
            most = max(parts[i, mode] for mode in omitted)
            lowest = np.sqrt(squares[model.elastic_columns(i)][omitted[0]]) / (2.0 * np.pi)  # unit modal mass
            numbers = "all" if omitted == list(modes) else ", ".join(map(str, omitted))
            texts.append(
                f"link {i + 1}, component modes {numbers} of {len(modes)} (from {lowest:.4g} Hz): each moves the tip by"
                f" at most {most:.2g} m"
            )
    if texts:
        texts[-1] += f"; together all omitted parts move the tip by {search.screen(candidate):.2g} m"
    return tuple(texts)


def _describe_retained(
    candidate: Candidate, parts: dict[tuple[int, int], float], single_errors: dict[tuple[int, int], float]
) -> list[str]:
    """Return a line for each link with the effect of each component mode retained in a candidate."""
    lines = []
    for i, modes in enumerate(candidate.modes):
        screened = [mode for mode in modes if np.isfinite(single_errors.get((i, mode), np.inf))]
        errors = ", ".join(f"{mode}: {single_errors[i, mode]:.2g}" for mode in screened)
        displacements = ", ".join(f"{mode}: {parts[i, mode]:.2g}" for mode in modes if mode not in screened)
        texts = [f"tip error (m) without mode {errors}"] if errors else []
        texts += [f"estimated tip displacement (m) by mode {displacements}"] if displacements else []
        lines += [f"link {i + 1}, {'; '.join(texts)}"] if texts else []
    return lines


def _write_report(
    search: ModelSearch, best: CandidateRun, longer: list[CandidateRun], retained: list[str], seconds: float
) -> str:
    """Return a text with frequencies, step, numerical damping, retained modes and cost of the selected simulation.

    Args:
        search: the search.
        best: the selected simulation.
        longer: simulations with longer steps.
        retained: a line for each link with the effect of its modes.
        seconds: processor time of the selection, s.
    """
    scene, model, full = search.scene, search.model(best.candidate), search.model(search.full)
    modes, all_modes = (frequencies(each, scene.initial.joint_angles)[model.n_joints :] for each in (model, full))
    lines = [f"{model.n_dof} of {full.n_dof} coordinates, {best.method.name} with {best.step:.4g} s"]
    if len(modes):
        lines.append("system frequencies (Hz, motors free): " + ", ".join(f"{each:.4g}" for each in modes))
        lines.append(f"the highest is {modes[-1]:.4g} Hz, with all coordinates {all_modes[-1]:.4g} Hz")
    if best.method.kind == EXPLICIT and len(modes):
        limit = stability_limit(best.method, NEGLIGIBLE_GROWTH) / (2.0 * np.pi * modes[-1])
        lines.append(f"longest stable step: {limit:.3g} s for {best.method.name}")
    if longer:
        rejected = min(longer, key=lambda each: each.step)
        lines.append(f"limit of the step: {rejected.step:.4g} s has an error of {rejected.error:.2g} m")
    growth = [remaining_amplitude(best.method, best.step, frequency) - 1.0 for frequency in modes]
    for i, (frequency, change) in enumerate(zip(modes[:3], growth, strict=False), start=1):
        lines.append(
            f"numerical damping of mode {i} ({frequency:.4g} Hz) over 10 s: {100.0 * change:+.2g} % of amplitude"
        )
    if growth and max(growth) > REPORTED_GROWTH:
        k = int(np.argmax(growth))
        lines.append(
            f"{best.method.name} lets mode {k + 1} ({modes[k]:.4g} Hz) grow by {100.0 * growth[k]:.2g} % in 10 s"
            " without damping"
        )
    lines += [*retained, search.describe_reference()]
    lines.append(
        f"computing time: {best.cost:.2g} s for the scene, {seconds:.3g} s and {search.runs} runs for the choice"
    )
    return "\n".join(lines)
