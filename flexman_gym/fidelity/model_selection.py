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
from flexman_gym.simulation.stability import explicit_limit, remaining_amplitude, spectral_radii

SAFETY_FACTOR = 0.8  # part of the tolerance that the chosen run may use
COST_TOLERANCE = 1.25  # costs that a clock cannot tell apart; of such trials the smallest model is chosen
STEP_MULTIPLES = (10, 8, 5, 4, 3, 2)  # of the output step
STEP_PARTS = (1, 2, 3, 4, 5, 6, 8, 10, 13, 16, 20, 25, 32, 40, 50, 64, 80, 100, 128, 160, 200, 256, 320, 400, 512, 1024)
REPORTED_GROWTH = 0.01  # of the amplitude of a mode in 10 s, of which a report speaks
MAX_GROWTH = 100.0  # of any mode by the method within the scene; the amplitudes are next to nothing at first


@dataclass(frozen=True, eq=False)
class Choice:
    """The model, method and step that `choose_model` chose.

    Attributes:
        model: the model, for `simulate`.
        method: a name from `METHODS`.
        step: s.
        estimated_error: largest distance of the tip from the reference at the outputs of the run, plus the error of the
            reference, m.
        dropped: a text for each part of the model that was left out, with its effect.
        report: a text about frequencies, step, numerical damping and the cost of the choice. Where the mesh was chosen,
            it also says how far the arm is from one of large rotations, which is no part of the estimate.
        errors: parts of the error (m) by name; they add up to more than the estimate where they cancel. Where the mesh
            was chosen they are mesh, modes, foreshortening, method and reference, else model and reference.
        runs: how many runs of the scene the choice took.
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
    """Chooses the cheapest model, method and step whose tip stays within a tolerance of the reference.

    The reference is a converged run of the scene's arm with its elements, every coordinate of its flexible parts and
    foreshortening. The error of its elements is not part of it. Where a scene leaves its elements open (None), they are
    chosen too: the reference has five of each link, and its error is estimated from a run with one less.

    Candidates leave out foreshortening, the springs of all joints, and the component modes that move the tip least in
    the motion of the reference. A mode moves the tip by its bend times the motion of the tip per unit of bend. Each
    candidate is run on the scene itself, so every error is measured. Of models whose costs are within a quarter of
    the least, which no clock tells apart, the one with the fewest coordinates is chosen.

    The tolerance holds at the outputs of the run: at the outputs of the scene or, with a longer step, after each step.
    Between them it holds for cubic interpolation of positions and velocities.

    A choice costs some hundred runs of the scene, at most a hundred where the mesh is open. The same scene and
    tolerance give the same object again at once.

    Args:
        scene: the scene.
        tolerance: of the tip, m.
        longest_step: s; longer steps are not tried. None tries up to ten output steps.

    Raises:
        ValueError: for another scene or tolerance, and where nothing meets the tolerance, with the error that was
            reached.

    Examples:
        >>> choice = fm.choose_model(fm.catalog.paper_scene("rr"), tolerance=0.01)
        >>> choice.estimated_error < 0.01
        True
    """
    if not isinstance(scene, Scene):
        raise value_error("scene", scene, "a Scene")
    if scene.initial.state is not None:
        raise value_error(
            "scene.initial.state", scene.initial.state, "None: the models that are tried have other states"
        )
    longest = np.inf if longest_step is None else positive("longest_step", longest_step, "s")
    return _choose(scene, positive("tolerance", tolerance, "m"), longest)


def assembled_modes(
    arm: Arm, elements: int | tuple[int, ...] = 2, highest: float = 25.0, share: float = 0.02
) -> tuple[int | tuple[int, ...], ...]:
    """Gives the loaded modes of each link, for `build_model`, that carry a share of an assembled arm's slow vibrations.

    A mode is kept when it has more than `share` of the elastic energy of a slow vibration (motors free, undamped). Slow
    are vibrations below `highest`, and the lowest three in any case. They are taken at zero joint angles and with each
    joint turned by 0.8 or 1.6 rad. This takes no simulation and gives no error, as `choose_model` does.

    Args:
        arm: the arm.
        elements: one value or one per link, as in `build_model`.
        highest: frequency, Hz.
        share: of the elastic energy of a vibration.

    Raises:
        ValueError: for an arm whose masses and stiffness are of sizes that leave no vibrations after rounding.
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
            slow[:n] = False  # the arm turning about its joints
            energies = shapes[:, slow] ** 2 * np.diag(stiffness)[:, None] / squares[slow]
        carried = np.maximum(carried, energies.max(axis=1, initial=0.0))
    links = [carried[model.elastic_columns(i)] > share for i in range(n)]
    return tuple(compact_modes(tuple(np.flatnonzero(kept).tolist())) for kept in links)


@lru_cache(maxsize=64)
def _choose(scene: Scene, tolerance: float, longest: float) -> Choice:
    started = clock.process_time()
    search = MeshSearch(scene, tolerance) if scene.model.elements is None else ModelSearch(scene, tolerance)
    if search.error > search.blurred * tolerance:
        least = 2.0 * search.error / search.blurred
        raise value_error("tolerance", tolerance, f"at least {least:.2g} m: the reference is known no better")
    parts = search.parts()
    trials = [trial for candidate in _candidates(search, parts) for trial in _run_candidate(search, candidate, longest)]
    good = [trial for trial in trials if trial.error + search.error <= SAFETY_FACTOR * tolerance]
    if not good:
        reached = min(trial.error for trial in trials) if trials else np.inf
        raise value_error(
            "tolerance", tolerance, f"at least {(reached + search.error) / SAFETY_FACTOR:.2g} m, what was reached"
        )
    cheapest = min(trial.cost for trial in good)
    close = [trial for trial in good if trial.cost <= 1.5 * cheapest]
    if search.timed is not None:
        close = sorted(close, key=lambda trial: trial.cost)[: search.timed]
    timed = [(min(search.trial(*trial[:3]).cost for _ in range(3)), trial) for trial in close]
    quickest = min(cost for cost, _ in timed)
    alike = [(_model_size(search, trial), cost, trial) for cost, trial in timed if cost <= COST_TOLERANCE * quickest]
    best = min(alike, key=lambda each: each[:2])[2]
    search.sharpen(best.error)
    run = search.run(*best[:3])
    error, errors = search.tip_error(run) + search.error, search.errors(best.candidate, run)
    dropped = _describe_dropped(search, best.candidate, parts)
    report = _write_report(search, best, trials, clock.process_time() - started)
    chosen = search.model(best.candidate), best.method.name, best.step
    return Choice(*chosen, error, dropped, report, errors, search.runs)


def _model_size(search: ModelSearch, trial: CandidateRun) -> tuple[int, bool]:
    """Gives the number of coordinates of a trial's model, and whether it has foreshortening."""
    return search.model(trial.candidate).n_dof, trial.candidate.stiffening


def _candidates(search: ModelSearch, parts: dict[tuple[int, int], float]) -> list[Candidate]:
    """Gives models that meet their share of the tolerance, the one with the fewest coordinates first."""
    result, stiffest = {search.full}, search.stiffest() if search.softens else []
    for springs in {search.full.springs, False}:
        for stiffening in {False, search.full.stiffening}:
            start = search.full._replace(springs=springs, stiffening=stiffening)
            for share in search.shares:
                budget = share * search.tolerance
                if search.screen(start) <= budget:
                    result.add(search.reduced(start, budget, list(parts)))
            if search.softens and search.screen(start) <= budget:  # for explicit methods
                softer = search.reduced(start, budget, stiffest)
                result.add(search.reduced(softer, search.shares[0] * search.tolerance, list(parts)))
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
    """Runs a candidate by each method, with shorter steps until a run is good, or costs more than a good one."""
    modes = frequencies(search.model(candidate), search.scene.initial.joint_angles)
    aim = SAFETY_FACTOR * search.tolerance - search.error
    ladder = np.array([step for step in _admissible_steps(search.scene) if step <= longest * (1.0 + 1e-9)])
    for method in (METHODS[name] for name in search.tried):
        steps = _stable_steps(method, ladder, modes, search.scene.duration)
        per_step, place = search.guess(candidate, method), search.first(method, steps)
        while place < len(steps) and per_step / steps[place] <= 1.2 * search.best and search.runs < search.most_runs:
            trial = search.trial(candidate, method, steps[place])
            per_step, search.last[method.name] = search.pace(trial, per_step), trial.step
            yield trial
            if trial.error <= aim:
                search.best = min(search.best, trial.cost)
                break
            # The order of the method tells which step may be good; the error of a step far too long tells nothing.
            shrink = 0.5 if not trial.error < 1.0 else max(0.2, (aim / trial.error) ** (1.0 / method.order))
            place += max(1, sum(step > 1.15 * shrink * trial.step for step in steps[place:]))


def _stable_steps(method: Method, steps: Array, modes: Array, duration: float) -> list[float]:
    """Gives those of steps (s) with which a method lets no vibration (Hz) grow much within a duration (s)."""
    growth = duration / steps[:, None] * np.log(spectral_radii(method, 2.0 * np.pi * steps[:, None] * modes))
    return [float(step) for step in steps[(growth <= np.log(MAX_GROWTH)).all(axis=1)]]


def _admissible_steps(scene: Scene) -> list[float]:
    """Gives the steps that `simulate` can take, descending."""
    rows = len(scene.output_times) - 1
    longer = [scene.output_step * multiple for multiple in STEP_MULTIPLES if rows % multiple == 0]
    return longer + [scene.output_step / parts for parts in STEP_PARTS]


def _describe_dropped(
    search: ModelSearch, candidate: Candidate, parts: dict[tuple[int, int], float]
) -> tuple[str, ...]:
    """Writes a text for everything that a candidate leaves out."""
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
            lowest = np.sqrt(squares[model.elastic_columns(i)][gone[0]]) / (2.0 * np.pi)  # its modal mass is 1
            numbers = "all" if gone == list(kept) else ", ".join(map(str, gone))
            texts.append(
                f"link {i + 1}, loaded modes {numbers} of {len(kept)} (from {lowest:.4g} Hz): none moves the tip by"
                f" more than {most:.2g} m"
            )
    if texts:
        texts[-1] += f"; everything that is left out moves the tip by {search.screen(candidate):.2g} m together"
    return tuple(texts)


def _write_report(search: ModelSearch, best: CandidateRun, trials: list[CandidateRun], seconds: float) -> str:
    """Writes frequencies, step, numerical damping and cost in words."""
    scene, model, full = search.scene, search.model(best.candidate), search.model(search.full)
    own, all_ = (frequencies(each, scene.initial.joint_angles)[model.n_joints :] for each in (model, full))
    lines = [f"{model.n_dof} of {full.n_dof} coordinates, {best.method.name} with {best.step:.4g} s"]
    if len(own):
        lines.append("system frequencies (Hz, motors free): " + ", ".join(f"{each:.4g}" for each in own))
        lines.append(f"the highest is {own[-1]:.4g} Hz, with all coordinates {all_[-1]:.4g} Hz")
    if best.method.kind == EXPLICIT and len(own):
        limit = explicit_limit(best.method) / (2.0 * np.pi * own[-1])
        lines.append(f"the step could not exceed {limit:.3g} s, the stability limit of {best.method.name}")
    same = [each for each in trials if each[:2] == best[:2] and each.step > best.step]
    if same:
        next_ = min(same, key=lambda each: each.step)
        lines.append(f"what limits the step: {next_.step:.4g} s leaves an error of {next_.error:.2g} m")
    grown = [remaining_amplitude(best.method, best.step, frequency) - 1.0 for frequency in own]
    for i, (frequency, part) in enumerate(zip(own[:3], grown, strict=False), start=1):
        lines.append(
            f"numerical damping of mode {i} ({frequency:.4g} Hz) over 10 s: {100.0 * part:+.2g} % of amplitude"
        )
    if grown and max(grown) > REPORTED_GROWTH:
        k = int(np.argmax(grown))
        lines.append(
            f"{best.method.name} lets mode {k + 1} ({own[k]:.4g} Hz) grow by {100.0 * grown[k]:.2g} % in 10 s where"
            " nothing damps it"
        )
    lines.append(search.words())
    lines.append(f"the scene costs {best.cost:.2g} s, the choice took {seconds:.3g} s, {search.runs} runs")
    return "\n".join(lines)
