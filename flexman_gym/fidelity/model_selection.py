"""Selection of the smallest model, the method and the longest step within a tolerance at the tip."""

import time as clock
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import check_solvable, positive, value_error
from flexman_gym.fidelity.mesh_search import MeshSearch
from flexman_gym.fidelity.model_search import Candidate, CandidateRun, ModelSearch, compact_modes
from flexman_gym.model.dynamics import frequencies, mass_matrix, stiffness_matrix
from flexman_gym.model.model import Model, build_model
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.scene import Scene
from flexman_gym.simulation.methods import EXPLICIT, METHODS, Method
from flexman_gym.simulation.stability import NEGLIGIBLE_GROWTH, remaining_amplitude, spectral_radii, stability_limit

SAFETY_FACTOR = 0.8  # 1; largest estimated error of the chosen run relative to the tolerance
COST_TOLERANCE = 1.25  # 1; ratio of costs below which their difference is within the scatter of the timing
STEP_MULTIPLES = (10, 8, 5, 4, 3, 2)  # output steps; steps to try above the output step
# 1; steps to try, as divisors of the output step
STEP_PARTS = (1, 2, 3, 4, 5, 6, 8, 10, 13, 16, 20, 25, 32, 40, 50, 64, 80, 100, 128, 160, 200, 256, 320, 400, 512, 1024)
REPORTED_GROWTH = 0.01  # 1; numerical growth of a mode in 10 s that is reported
MAX_GROWTH = 100.0  # 1; numerical growth of any mode within the scene; initial amplitudes are close to zero


@dataclass(frozen=True, eq=False)
class Choice:
    """Model, method and step chosen by `choose_model`.

    Attributes:
        model: the model, for `simulate`.
        method: a name from `METHODS`.
        step: s.
        estimated_error: largest distance between the tip and the reference at the outputs of the run, plus the error of
            the reference, m.
        dropped: a text for each omitted part of the model, with its effect.
        report: frequencies, step, numerical damping and computing cost of the choice as text. Where the mesh was
            chosen, it also has the estimated effect of large rotations, which is not part of the estimated error.
        errors: components of the error (m) by name; where they cancel, their sum exceeds the estimate. Where the mesh
            was chosen they are mesh, modes, foreshortening, method and reference, else model and reference.
        runs: number of simulations of the scene for the choice.

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
        left = f"{len(self.dropped)} parts left out" if self.dropped else "nothing left out"
        return (
            f"<Choice: {self.method} with steps of {self.step:g} s, estimated error {self.estimated_error:.3g} m\n"
            f"  {self.model.n_dof} coordinates, {left}: see dropped and report>"
        )


def choose_model(scene: Scene, tolerance: float, longest_step: float | None = None) -> Choice:
    """Choose the cheapest model, method and step whose tip stays within a tolerance of the reference.

    The reference is a converged simulation of the scene's arm with its elements, all coordinates of its flexible parts
    and foreshortening. The discretisation error of its elements is not included. Where a scene leaves its elements open
    (None), they are chosen as well: the reference then has five elements per link, and its discretisation error is
    estimated from a run with one element less.

    Candidates leave out foreshortening, the springs of all joints, and the component modes with the smallest effect on
    the tip in the motion of the reference: the amplitude of a mode times the tip displacement per unit of it. Each
    candidate is run on the scene itself, so every error is measured. Costs within a quarter of the least count as
    equal; of the models with these costs, the one with the fewest coordinates is chosen.

    The tolerance holds at the outputs of the run: at the outputs of the scene or, with a longer step, after each step.
    Between them it holds for cubic interpolation of positions and velocities.

    A choice takes some hundred simulations of the scene, at most a hundred where the mesh is open. Repeated calls with
    the same scene and tolerance return the same object from a cache.

    Args:
        scene: the scene.
        tolerance: largest error of the tip, m.
        longest_step: longest step to try, s; None for ten output steps.

    Returns:
        The choice, with the reasons and the components of its error.

    Raises:
        ValueError: for a wrong scene or tolerance, and where no candidate meets the tolerance, with the error reached.

    Examples:
        >>> choice = fm.choose_model(fm.catalog.paper_scene("rr"), tolerance=0.01)
        >>> choice.estimated_error < 0.01
        True
    """
    if not isinstance(scene, Scene):
        raise value_error("scene", scene, "a Scene")
    if scene.initial.state is not None:
        raise value_error(
            "scene.initial.state", scene.initial.state, "None: the candidate models have different states"
        )
    longest = np.inf if longest_step is None else positive("longest_step", longest_step, "s")
    return _choose(scene, positive("tolerance", tolerance, "m"), longest)


def assembled_modes(
    arm: Arm, elements: int | tuple[int, ...] = 2, highest: float = 25.0, share: float = 0.02
) -> tuple[int | tuple[int, ...], ...]:
    """Return the component modes of each link, for `build_model`, that take part in slow vibrations of the arm.

    A mode is retained when it holds more than `share` of the elastic energy of a slow vibration (motors free,
    undamped). Slow vibrations are those below `highest`, and in any case the lowest three. They are computed at zero
    joint angles and with each joint turned by 0.8 and by 1.6 rad. Unlike `choose_model`, this takes no simulation and
    estimates no error.

    Args:
        arm: the arm.
        elements: one number or one per link, as in `build_model`.
        highest: highest frequency of a slow vibration, Hz.
        share: least share of the elastic energy of a vibration, 1.

    Returns:
        For each link, the number of its lowest modes or a tuple of mode numbers.

    Raises:
        ValueError: for an arm whose masses and stiffnesses differ so much in size that rounding hides its vibrations.
    """
    from scipy.linalg import eigh

    counts = tuple(basis.shape[1] for basis in build_model(arm, elements).bases)
    model = build_model(arm, elements, counts)
    stiffness, n = stiffness_matrix(model), model.n_joints
    turned = [angle * row for angle in (0.8, 1.6) for row in np.eye(n)]
    carried = np.zeros(model.n_dof)
    for pose in [np.zeros(n), *turned]:
        mass = mass_matrix(model, model.initial_state(pose))
        with check_solvable("frequencies"):
            squares, shapes = eigh(stiffness, mass)
            slow = np.sqrt(np.maximum(squares, 0.0)) < 2.0 * np.pi * highest
            slow[: n + 3] = True
            slow[:n] = False  # rigid-body modes about the joints
            energies = shapes[:, slow] ** 2 * np.diag(stiffness)[:, None] / squares[slow]
        carried = np.maximum(carried, energies.max(axis=1, initial=0.0))
    links = [carried[model.elastic_columns(i)] > share for i in range(n)]
    return tuple(compact_modes(tuple(np.flatnonzero(kept).tolist())) for kept in links)


@lru_cache(maxsize=64)
def _choose(scene: Scene, tolerance: float, longest: float) -> Choice:
    """Return the choice for checked arguments."""
    started = clock.process_time()
    search = MeshSearch(scene, tolerance) if scene.model.elements is None else ModelSearch(scene, tolerance)
    if search.error > search.max_reference_share * tolerance:
        least = 2.0 * search.error / search.max_reference_share
        raise value_error("tolerance", tolerance, f"at least {least:.2g} m, the accuracy of the reference")
    parts = search.contributions()
    trials = [trial for candidate in _candidates(search, parts) for trial in _run_candidate(search, candidate, longest)]
    good = [trial for trial in trials if trial.error + search.error <= SAFETY_FACTOR * tolerance]
    if not good:
        reached = min(trial.error for trial in trials) if trials else np.inf
        raise value_error(
            "tolerance", tolerance, f"at least {(reached + search.error) / SAFETY_FACTOR:.2g} m, the error reached"
        )
    cheapest = min(trial.cost for trial in good)
    close = [trial for trial in good if trial.cost <= 1.5 * cheapest]
    if search.max_timed is not None:
        close = sorted(close, key=lambda trial: trial.cost)[: search.max_timed]
    timed = [(min(search.measure(*trial[:3]).cost for _ in range(3)), trial) for trial in close]
    quickest = min(cost for cost, _ in timed)
    alike = [(_model_size(search, trial), cost, trial) for cost, trial in timed if cost <= COST_TOLERANCE * quickest]
    best = min(alike, key=lambda each: each[:2])[2]
    search.refine_reference(best.error)
    run = search.run(*best[:3])
    error, errors = search.tip_error(run) + search.error, search.errors(best.candidate, run)
    dropped = _describe_dropped(search, best.candidate, parts)
    report = _write_report(search, best, trials, clock.process_time() - started)
    chosen = search.model(best.candidate), best.method.name, best.step
    return Choice(*chosen, error, dropped, report, errors, search.runs)


def _model_size(search: ModelSearch, trial: CandidateRun) -> tuple[int, bool]:
    """Return the number of coordinates of the model of a trial, and whether it has foreshortening."""
    return search.model(trial.candidate).n_dof, trial.candidate.stiffening


def _candidates(search: ModelSearch, parts: dict[tuple[int, int], float]) -> list[Candidate]:
    """Return models that meet their share of the tolerance, the one with the fewest coordinates first."""
    result, stiffest = {search.full}, search.stiffest_modes() if search.has_softer_models else []
    for springs in {search.full.springs, False}:
        for stiffening in {False, search.full.stiffening}:
            start = search.full._replace(springs=springs, stiffening=stiffening)
            for share in search.tolerance_shares:
                budget = share * search.tolerance
                if search.screen(start) <= budget:
                    result.add(search.reduced(start, budget, list(parts)))
            if search.has_softer_models and search.screen(start) <= budget:  # for explicit methods
                softer = search.reduced(start, budget, stiffest)
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
    """Run a candidate by each method, with shorter steps until a run meets the tolerance or costs too much."""
    modes = frequencies(search.model(candidate), search.scene.initial.joint_angles)
    aim = SAFETY_FACTOR * search.tolerance - search.error
    ladder = np.array([step for step in _admissible_steps(search.scene) if step <= longest * (1.0 + 1e-9)])
    for method in (METHODS[name] for name in search.methods):
        steps = _stable_steps(method, ladder, modes, search.scene.duration)
        per_step, place = search.estimate_step_cost(candidate, method), search.first_index(method, steps)
        while place < len(steps) and per_step / steps[place] <= 1.2 * search.best and search.runs < search.max_runs:
            trial = search.measure(candidate, method, steps[place])
            per_step, search.last_steps[method.name] = search.step_cost(trial, per_step), trial.step
            yield trial
            if trial.error <= aim:
                search.best = min(search.best, trial.cost)
                break
            # The order of the method predicts the step, except from the error of a step far too long.
            shrink = 0.5 if not trial.error < 1.0 else max(0.2, (aim / trial.error) ** (1.0 / method.order))
            place += max(1, sum(step > 1.15 * shrink * trial.step for step in steps[place:]))


def _stable_steps(method: Method, steps: Array, modes: Array, duration: float) -> list[float]:
    """Return the steps (s) at which a method lets no vibration (Hz) grow beyond MAX_GROWTH within a duration (s)."""
    growth = duration / steps[:, None] * np.log(spectral_radii(method, 2.0 * np.pi * steps[:, None] * modes))
    return [float(step) for step in steps[(growth <= np.log(MAX_GROWTH)).all(axis=1)]]


def _admissible_steps(scene: Scene) -> list[float]:
    """Return the steps accepted by `simulate` for a scene, in descending order."""
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
    for i, kept in enumerate(full.modes):
        gone = [mode for mode in kept if mode not in candidate.modes[i]]
        if gone:
            most = max(parts[i, mode] for mode in gone)
            lowest = np.sqrt(squares[model.elastic_columns(i)][gone[0]]) / (2.0 * np.pi)  # unit modal mass
            numbers = "all" if gone == list(kept) else ", ".join(map(str, gone))
            texts.append(
                f"link {i + 1}, component modes {numbers} of {len(kept)} (from {lowest:.4g} Hz): each moves the tip by"
                f" at most {most:.2g} m"
            )
    if texts:
        texts[-1] += f"; together all omitted parts move the tip by {search.screen(candidate):.2g} m"
    return tuple(texts)


def _write_report(search: ModelSearch, best: CandidateRun, trials: list[CandidateRun], seconds: float) -> str:
    """Return frequencies, step, numerical damping and computing cost as text."""
    scene, model, full = search.scene, search.model(best.candidate), search.model(search.full)
    own, all_ = (frequencies(each, scene.initial.joint_angles)[model.n_joints :] for each in (model, full))
    lines = [f"{model.n_dof} of {full.n_dof} coordinates, {best.method.name} with {best.step:.4g} s"]
    if len(own):
        lines.append("system frequencies (Hz, motors free): " + ", ".join(f"{each:.4g}" for each in own))
        lines.append(f"the highest is {own[-1]:.4g} Hz, with all coordinates {all_[-1]:.4g} Hz")
    if best.method.kind == EXPLICIT and len(own):
        limit = stability_limit(best.method, NEGLIGIBLE_GROWTH) / (2.0 * np.pi * own[-1])
        lines.append(f"longest stable step: {limit:.3g} s for {best.method.name}")
    same = [each for each in trials if each[:2] == best[:2] and each.step > best.step]
    if same:
        next_ = min(same, key=lambda each: each.step)
        lines.append(f"limit of the step: {next_.step:.4g} s has an error of {next_.error:.2g} m")
    grown = [remaining_amplitude(best.method, best.step, frequency) - 1.0 for frequency in own]
    for i, (frequency, part) in enumerate(zip(own[:3], grown, strict=False), start=1):
        lines.append(
            f"numerical damping of mode {i} ({frequency:.4g} Hz) over 10 s: {100.0 * part:+.2g} % of amplitude"
        )
    if grown and max(grown) > REPORTED_GROWTH:
        k = int(np.argmax(grown))
        lines.append(
            f"{best.method.name} lets mode {k + 1} ({own[k]:.4g} Hz) grow by {100.0 * grown[k]:.2g} % in 10 s without"
            " damping"
        )
    lines.append(search.describe_reference())
    lines.append(
        f"computing time: {best.cost:.2g} s for the scene, {seconds:.3g} s and {search.runs} runs for the choice"
    )
    return "\n".join(lines)
