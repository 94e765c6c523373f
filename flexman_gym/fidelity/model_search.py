"""Search for a reduced model: candidates, dropped modes, and errors against a converged reference."""

import time as clock
from typing import NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array, Vector
from flexman_gym.common.checks import value_error
from flexman_gym.common.progress import Progress
from flexman_gym.model.dynamics import mass_matrix, stiffness_matrix, tip_jacobian
from flexman_gym.model.model import Model, build_model
from flexman_gym.scene.scene import Scene
from flexman_gym.simulation.methods import METHODS, Explicit, IteratedGauss, LinearlyImplicit, Method
from flexman_gym.simulation.scene_simulation import simulate
from flexman_gym.simulation.trajectory import Trajectory


class Candidate(NamedTuple):
    """Parts retained in a reduced model.

    Attributes:
        modes: numbers of the component modes of each link.
        springs: flexible joints.
        stiffening: foreshortening of the links.
    """

    modes: tuple[tuple[int, ...], ...]
    springs: bool
    stiffening: bool

    def build(self, scene: Scene) -> Model:
        """Return the model of the candidate for a scene."""
        modes = tuple(compact_modes(kept) for kept in self.modes)
        switches = vars(scene.model) | {"flexible_joints": self.springs, "stiffening": self.stiffening, "modes": modes}
        return build_model(scene.arm, **switches)


def full_candidate(scene: Scene) -> Candidate:
    """Return the candidate with all parts of the model of a scene."""
    everything = build_model(scene.arm, **(vars(scene.model) | {"modes": None}))
    modes = tuple(tuple(range(basis.shape[1])) for basis in everything.bases)
    return Candidate(modes, everything.n_motors > 0, any(modes))


def compact_modes(numbers: tuple[int, ...]) -> int | tuple[int, ...]:
    """Return mode numbers in the form of `build_model`: the count of the lowest modes, any other set as a tuple."""
    return len(numbers) if numbers == tuple(range(len(numbers))) else numbers


def _tip_contributions(model: Model, full: Candidate, states: Array) -> dict[tuple[int, int], float]:
    """Return the tip displacement (m) by each mode (link, number) in the motion of the reference, ascending.

    The bending of a mode turns the free joints in the opposite direction, by conservation of momentum. The displacement
    includes this rotation.

    Args:
        model: model of the full candidate.
        full: the full candidate.
        states: (T, 2 d) of the reference.

    Returns:
        Displacement by (link, number).
    """
    turns = np.eye(model.n_dof)[:, : model.n_joints]
    turns[model.motor_columns] = np.eye(model.n_joints)
    moves = np.zeros(model.n_dof)
    for state in states[:: max(1, len(states) // 8)]:
        momentum = turns.T @ mass_matrix(model, state)
        moved = np.eye(model.n_dof) - turns @ np.linalg.solve(momentum @ turns, momentum)
        tip = tip_jacobian(model, state[: model.n_dof]) @ moved
        moves = np.maximum(moves, np.linalg.norm(tip, axis=0))
    moves *= np.abs(states[:, : model.n_dof]).max(axis=0)
    parts = {}
    for link, kept in enumerate(full.modes):
        for number, part in zip(kept, moves[model.elastic_columns(link)], strict=True):
            parts[link, number] = float(part)
    return dict(sorted(parts.items(), key=lambda item: item[1]))


def _stiffest_modes(model: Model, full: Candidate, angles: Vector) -> list[tuple[int, int]]:
    """Return the modes (link, number), ordered for a fast decrease of the highest frequency of the arm.

    Each is the mode with the largest component in the highest vibration of the arm without the modes before it.

    Args:
        model: model of the full candidate.
        full: the full candidate.
        angles: (n,) joint angles, rad.

    Returns:
        All modes of the full candidate, as (link, number).
    """
    from scipy.linalg import eigh

    mass = mass_matrix(model, model.initial_state(angles))
    stiffness, size = stiffness_matrix(model), np.sqrt(np.diag(mass))
    modes = [(link, number) for link, kept in enumerate(full.modes) for number in kept]
    first, order = model.n_dof - len(modes), []
    left = list(range(model.n_dof))
    while len(left) > first:
        block = np.ix_(left, left)
        shape = eigh(stiffness[block], mass[block])[1][:, -1]
        place = first + int(np.argmax(np.abs(shape * size[left])[first:]))
        order.append(modes[left.pop(place) - first])
    return order


TOLERANCE_SHARES = (0.6, 0.25)  # 1; shares of the tolerance for omitted coordinates; each gives a candidate
CANDIDATE_METHODS = ("extrapolated_euler_5", "extrapolated_euler_4", "extrapolated_euler_3", "ros2", "rk4", "dopri5",
         "midpoint_corrected_2", "midpoint_corrected_3", "midpoint_2", "midpoint_3", "gauss_2", "gauss_3",
         "generalised_alpha")  # fmt: skip
REFERENCE_SHARE = 0.05  # 1; largest error of the reference relative to the tolerance
REFERENCE_METHOD = METHODS["midpoint_3"]  # keeps the amplitude of vibrations at any step
MIN_PARTS, MAX_PARTS = 1, 64  # steps in an output step: first and last of the halved runs
# 1; error of the extrapolated tips relative to the change by the last halving: 1/15 in theory, more with vibrations
# faster than the steps
EXTRAPOLATION_ERROR = 0.5
REFERENCE_RTOLS = (1e-5, 1e-8, 1e-11)  # 1; tolerances of "dop853" where halved steps are not accurate enough


class CandidateRun(NamedTuple):
    """Run of a candidate.

    Attributes:
        candidate: the candidate.
        method: the method.
        step: s; 0 where the method chose its steps.
        error: error at the tip, m; inf where the run failed.
        cost: computing time, s.
        evaluations: number of evaluations of the accelerations.
    """

    candidate: Candidate
    method: Method
    step: float
    error: float
    cost: float
    evaluations: int


class ModelSearch:
    """Reference of a scene, and candidates measured against it.

    The tips of the reference are extrapolated to step zero from runs of the midpoint rule with successively halved
    steps. Where these do not converge, the reference is a method with step-size control. Candidates are screened with
    one of these steps against the full candidate at the same step, so that the common part of the error cancels.

    Args:
        scene: the scene.
        tolerance: largest error of the tip, m.

    Attributes:
        models: models built so far.
        screened, screening_runs: results of `screen`, as `CandidateRun` and as trajectory.
        full: the full candidate.
        reference_model: model of the reference.
        halved_runs: runs of this model by the midpoint rule, by their number of steps in an output step.
        reference_tips: tip positions of successively refined references, (T, 3) each, m.
        reference: a run of the full candidate.
        time_error, mesh_error: error of the reference by its steps and by its mesh, m.
        best: lowest cost so far of a run within the tolerance, s.
        runs: number of simulations of the scene so far.
        last_steps: last step tried of each method, s.
        screening: step for the screening of candidates, s; None for "dop853".
        screening_reference: run of the full candidate at this step.
        max_runs, max_runs_reference: numbers of runs after which no method is tried and no step is halved.
        max_parts: steps in an output step in the last of the halved runs.
        reference_rtols: relative tolerances of references with step-size control.
        tolerance_shares: shares of the tolerance for omitted coordinates; each gives a candidate.
        has_softer_models: flag of further candidates for explicit methods.
        methods: names of the methods to try.
        max_reference_share: largest error of the reference relative to the tolerance.
        max_timed: number of the cheapest runs to be timed again; None for all with similar cost.
    """

    max_runs: float = np.inf
    max_runs_reference: float = np.inf
    max_parts: int = MAX_PARTS
    reference_rtols: tuple[float, ...] = REFERENCE_RTOLS
    mesh_error = 0.0
    tolerance_shares: tuple[float, ...] = TOLERANCE_SHARES
    has_softer_models = True
    methods: tuple[str, ...] = CANDIDATE_METHODS
    max_reference_share = 2 * REFERENCE_SHARE
    max_timed: int | None = None

    def __init__(self, scene: Scene, tolerance: float) -> None:
        self._initialise(scene, tolerance)
        self.full = full_candidate(scene)
        self.reference_model = self.model(self.full)
        self._converge(REFERENCE_SHARE * tolerance)
        self._find_screening()

    def _initialise(self, scene: Scene, tolerance: float) -> None:
        """Initialise the search without any run."""
        self.scene, self.tolerance, self.runs, self.best, self.time_error = scene, tolerance, 0, np.inf, np.inf
        self.reference_tips: list[Array] = []
        self.halved_runs: dict[int, Trajectory] = {}
        self.last_steps: dict[str, float] = {}
        self.models: dict[Candidate, Model] = {}
        self.screened: dict[Candidate, CandidateRun] = {}
        self.screening_runs: dict[Candidate, Trajectory] = {}
        self._progress = Progress("runs of the scene")
        self._controlled = 0  # references of step control

    @property
    def error(self) -> float:
        """Error of the reference, m."""
        return self.time_error + self.mesh_error

    def _converge(self, error: float) -> None:
        """Refine the reference until two successive ones agree to an error (m)."""
        while (
            self.time_error > error
            and max(self.halved_runs, default=0) < self.max_parts
            and self.runs < self.max_runs_reference
        ):
            self._halve()
        while self.time_error > error and self._controlled < len(self.reference_rtols):
            rtol = self.reference_rtols[self._controlled]
            self._controlled += 1
            run = self._reference(METHODS["dop853"], None, rtol)
            if run.status == "ok":
                self.time_error = _tip_distance(run.tip, self.reference_tips[-1]) if self.reference_tips else np.inf
                self.reference_tips.append(run.tip)
        if not np.isfinite(self.time_error):
            raise value_error("scene", "a motion without a converged reference", "a slower motion or less bending")

    def _halve(self) -> None:
        """Halve the step of the reference."""
        parts = 2 * max(self.halved_runs) if self.halved_runs else MIN_PARTS
        self.halved_runs[parts] = run = self._reference(REFERENCE_METHOD, self.scene.output_step / parts)
        longer = self.halved_runs.get(parts // 2)
        if longer is not None and run.status == longer.status == "ok":
            self.reference_tips.append((4.0 * run.tip - longer.tip) / 3.0)
            if len(self.reference_tips) > 1:
                self.time_error = EXTRAPOLATION_ERROR * _tip_distance(self.reference_tips[-1], self.reference_tips[-2])

    def _reference(self, method: Method, step: float | None, rtol: float = 1e-6) -> Trajectory:
        """Return a run of the reference model, and store it if it did not fail."""
        self._count()
        run = simulate(self.scene, self.reference_model, method, step, rtol, 0.01 * rtol)
        if run.status == "ok":
            self.reference = run
        return run

    def _find_screening(self) -> None:
        """Select the longest of the halved steps that meets the tolerance for screening, else the last reference."""
        good = [parts for parts, run in self.halved_runs.items() if self.tip_error(run) <= self.tolerance]
        parts = min(good, default=0 if self._controlled else max(self.halved_runs))
        self.screening = self.scene.output_step / parts if parts else None
        self.screening_reference = self.halved_runs[parts] if parts else self.reference

    def refine_reference(self, error: float) -> None:
        """Refine the reference until its error is small relative to an error (m) measured against it."""
        self._converge(0.25 * error)

    def model(self, candidate: Candidate) -> Model:
        """Return the model of a candidate, built once."""
        if candidate not in self.models:
            self.models[candidate] = candidate.build(self.scene)
        return self.models[candidate]

    def run(self, candidate: Candidate, method: Method, step: float | None) -> Trajectory:
        """Simulate the scene with a candidate."""
        self._count()
        return simulate(self.scene, self.model(candidate), method, step)

    def _count(self) -> None:
        """Count a run of the scene."""
        self.runs += 1
        self._progress.count()

    def measure(self, candidate: Candidate, method: Method, step: float | None) -> CandidateRun:
        """Simulate the scene with a candidate and return error and cost."""
        trial, run = self.run_timed(candidate, method, step)
        return trial._replace(error=self.tip_error(run))

    def run_timed(self, candidate: Candidate, method: Method, step: float | None) -> tuple[CandidateRun, Trajectory]:
        """Simulate the scene with a candidate and return its cost, with the error NaN, and the trajectory."""
        self.model(candidate)
        started = clock.process_time()
        run = self.run(candidate, method, step)
        cost = clock.process_time() - started
        return CandidateRun(candidate, method, step or 0.0, np.nan, cost, run.evaluations), run

    def tip_error(self, run: Trajectory) -> float:
        """Return the error (m) of a run at its outputs; inf after a failure and for a large error between outputs."""
        times, reference = self.scene.output_times, self.reference_tips[-1]
        if run.status != "ok" or not np.isclose(run.time[-1], times[-1], rtol=1e-6):
            return np.inf
        error = _tip_distance(run.tip, reference[:: (len(times) - 1) // (len(run.time) - 1)])
        if len(run.time) < len(times):
            from scipy.interpolate import CubicHermiteSpline

            between = CubicHermiteSpline(run.time, run.tip, run.tip_velocity)(times)
            error = error if _tip_distance(between, reference) <= self.tolerance else np.inf
        return error

    def screen(self, candidate: Candidate) -> float:
        """Return the error (m) of a candidate without the error of a method; its run is made once.

        The candidate and the full candidate are run by the same method with the same step, so that their common error
        cancels.
        """
        if candidate not in self.screened:
            method = REFERENCE_METHOD if self.screening else METHODS["dop853"]
            trial, self.screening_runs[candidate] = self.run_timed(candidate, method, self.screening)
            self.screened[candidate] = trial._replace(error=self._screening_error(self.screening_runs[candidate]))
        return self.screened[candidate].error

    def _screening_error(self, run: Trajectory) -> float:
        """Return the distance (m) of a run from the full candidate at the same step; inf for a failed run."""
        return _tip_distance(run.tip, self.screening_reference.tip) if run.status == "ok" else np.inf

    def estimate_step_cost(self, candidate: Candidate, method: Method) -> float:
        """Return a low estimate of the cost of the scene times the step of a method."""
        self.screen(candidate)
        screened = self.screened[candidate]
        each = self.scene.duration * screened.cost / max(screened.evaluations, 1)
        if isinstance(method, Explicit):
            return 0.3 * each * len(method.b)  # no matrix factorisation
        if isinstance(method, IteratedGauss):
            return 0.7 * each * method.evaluations
        return 0.7 * each * len(method.b) * max(method.sequence) if isinstance(method, LinearlyImplicit) else 0.0

    def step_cost(self, trial: CandidateRun, guessed: float) -> float:
        """Return the cost of the scene times the step after a run.

        Args:
            trial: the run.
            guessed: the estimate before it.

        Returns:
            The product, s^2.
        """
        return trial.cost * trial.step

    def first_index(self, method: Method, steps: list[float]) -> int:
        """Return the index of the first of descending steps (s) to try with a method."""
        return 0

    def errors(self, candidate: Candidate, run: Trajectory) -> dict[str, float]:
        """Return the components of the error (m) of a run of a candidate: reduced model and reference."""
        return {"model": self.screen(candidate), "reference": self.error}

    def describe_reference(self) -> str:
        """Return the evaluations and the accuracy of the reference as text."""
        return (
            f"reference: {self.reference.evaluations} evaluations with all coordinates, accurate to {self.error:.1g} m"
        )

    def contributions(self) -> dict[tuple[int, int], float]:
        """Return the tip displacement (m) by each mode (link, number) in the motion of the reference, ascending."""
        return _tip_contributions(self.model(self.full), self.full, self.reference.states)

    def stiffest_modes(self) -> list[tuple[int, int]]:
        """Return the modes (link, number), ordered for a fast decrease of the highest frequency of the arm."""
        return _stiffest_modes(self.model(self.full), self.full, self.scene.initial.joint_angles)

    def reduced(self, start: Candidate, budget: float, order: list[tuple[int, int]]) -> Candidate:
        """Return a candidate with as many modes omitted, in a given order, as a budget allows.

        Beyond these, up to four of the next modes are omitted where the budget allows.

        Args:
            start: the candidate to reduce.
            budget: largest error at the tip, m.
            order: modes (link, number).

        Returns:
            The reduced candidate.
        """

        def without(gone: list[tuple[int, int]]) -> Candidate:
            modes = [tuple(j for j in kept if (i, j) not in gone) for i, kept in enumerate(start.modes)]
            return start._replace(modes=tuple(modes))

        low, high = 0, len(order) + 1
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (middle, high) if self.screen(without(order[:middle])) <= budget else (low, middle)
        gone = order[:low]
        for mode in order[low + 1 : low + 5]:
            if self.screen(without([*gone, mode])) <= budget:
                gone = [*gone, mode]
        return without(gone)


def _tip_distance(tips: Array, others: Array) -> float:
    """Return the largest distance (m) between tips (T, 3)."""
    return float(np.linalg.norm(tips - others, axis=-1).max())
