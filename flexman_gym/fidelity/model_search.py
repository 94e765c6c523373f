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
    """The parts that a model keeps.

    Attributes:
        modes: numbers of the loaded modes of each link.
        springs: whether joints have their springs.
        stiffening: whether links have foreshortening.
    """

    modes: tuple[tuple[int, ...], ...]
    springs: bool
    stiffening: bool

    def build(self, scene: Scene) -> Model:
        """Builds its model for a scene."""
        modes = tuple(compact_modes(kept) for kept in self.modes)
        switches = vars(scene.model) | {"flexible_joints": self.springs, "stiffening": self.stiffening, "modes": modes}
        return build_model(scene.arm, **switches)


def full_candidate(scene: Scene) -> Candidate:
    """Gives the candidate that keeps everything of a scene."""
    everything = build_model(scene.arm, **(vars(scene.model) | {"modes": None}))
    modes = tuple(tuple(range(basis.shape[1])) for basis in everything.bases)
    return Candidate(modes, everything.n_motors > 0, any(modes))


def compact_modes(numbers: tuple[int, ...]) -> int | tuple[int, ...]:
    """Gives the modes of a link as `build_model` takes them: the lowest ones as their number, others as a tuple."""
    return len(numbers) if numbers == tuple(range(len(numbers))) else numbers


def _tip_contributions(model: Model, full: Candidate, states: Array) -> dict[tuple[int, int], float]:
    """Gives how far (m) each mode (link, number) moves the tip in the motion of the reference, ascending.

    A mode that bends turns the free joints the other way, as momentum is kept. The motion of the tip includes this
    turn.

    Args:
        model: of the full candidate.
        full: the candidate that keeps everything.
        states: (T, 2 d) of the reference.
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
    """Gives the modes (link, number) in an order that lowers the highest frequency of the arm fast.

    Each is the mode with the largest part in the highest vibration of the arm without the modes before it.

    Args:
        model: of the full candidate.
        full: the candidate that keeps everything.
        angles: (n,) rad, of the joints.
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


TOLERANCE_SHARES = (0.6, 0.25)  # parts of the tolerance that dropped coordinates may use; each gives a model
CANDIDATE_METHODS = ("extrapolated_euler_5", "extrapolated_euler_4", "extrapolated_euler_3", "ros2", "rk4", "dopri5",
         "midpoint_2", "midpoint_3", "gauss_2", "gauss_3", "generalised_alpha")  # fmt: skip
REFERENCE_SHARE = 0.05  # of the tolerance, the most by which the reference may be off
# Lets no vibration grow or fade, however short or long its steps.
REFERENCE_METHOD, MIN_PARTS, MAX_PARTS = METHODS["midpoint_3"], 1, 64  # steps in an output step
# What extrapolated tips are off by, in parts of what the last halving changed; 1/15 but for modes faster than steps.
EXTRAPOLATION_ERROR = 0.5
REFERENCE_RTOLS = (1e-5, 1e-8, 1e-11)  # of "dop853", for a reference that halved steps do not make sharp


class CandidateRun(NamedTuple):
    """A run of a candidate.

    Attributes:
        candidate: the candidate.
        method: the method.
        step: s; 0 where the method chose its steps.
        error: at the tip, m; inf where the run failed.
        cost: time of computing, s.
        evaluations: number of evaluations of the accelerations.
    """

    candidate: Candidate
    method: Method
    step: float
    error: float
    cost: float
    evaluations: int


class ModelSearch:
    """The reference of a scene, and the candidates that were measured against it.

    The tips of the reference are extrapolated from runs of the midpoint rule and halved steps to steps of no length.
    Where these do not agree it is a method of step control. Candidates are screened with one of these steps, beside the
    reference at the same step, so that what both have of its error drops out.

    Attributes:
        scene: the scene.
        tolerance: of the tip, m.
        models: the models that were built.
        screened, screens: the runs that `screen` made, as trials and with their motion.
        full: the candidate that keeps everything.
        finest: the model of the reference.
        halved: runs of this model by the midpoint rule, by their steps in an output step.
        tips: positions of the tip by finer and finer references, (T, 3) each, m.
        reference: a run of the full candidate.
        time_error, mesh_error: of the reference by its steps and by its mesh, m.
        best: cost of the cheapest run that met the tolerance, s.
        runs: how many runs of the scene were made.
        last: the last step (s) that was tried of each method.
        screening: the step (s) with which candidates are screened; None takes "dop853".
        beside: the run of the full candidate by this step.
        most_runs, last_runs: when there are so many no method is tried, and no step halved, any more.
        most_parts: steps in an output step of the last of the halved runs.
        rtols: of the references of step control.
        shares: parts of the tolerance that dropped coordinates may use; each gives a model.
        softens: whether explicit methods get models of their own.
        tried: names of the methods to try.
        blurred: part of the tolerance from which on the error of the reference is too large.
        timed: how many of the cheapest trials are timed again, None for all that are close.
    """

    most_runs: float = np.inf
    last_runs: float = np.inf
    most_parts: int = MAX_PARTS
    rtols: tuple[float, ...] = REFERENCE_RTOLS
    mesh_error = 0.0
    shares: tuple[float, ...] = TOLERANCE_SHARES
    softens = True
    tried: tuple[str, ...] = CANDIDATE_METHODS
    blurred = 2 * REFERENCE_SHARE
    timed: int | None = None

    def __init__(self, scene: Scene, tolerance: float) -> None:
        self._begin(scene, tolerance)
        self.full = full_candidate(scene)
        self.finest = self.model(self.full)
        self._converge(REFERENCE_SHARE * tolerance)
        self._find_screening()

    def _begin(self, scene: Scene, tolerance: float) -> None:
        """Starts without runs."""
        self.scene, self.tolerance, self.runs, self.best, self.time_error = scene, tolerance, 0, np.inf, np.inf
        self.tips: list[Array] = []
        self.halved: dict[int, Trajectory] = {}
        self.last: dict[str, float] = {}
        self.models: dict[Candidate, Model] = {}
        self.screened: dict[Candidate, CandidateRun] = {}
        self.screens: dict[Candidate, Trajectory] = {}
        self._progress = Progress("runs of the scene")
        self._controlled = 0  # references of step control

    @property
    def error(self) -> float:
        """Of the reference, m."""
        return self.time_error + self.mesh_error

    def _converge(self, error: float) -> None:
        """Goes to finer references until two agree to an error (m)."""
        while self.time_error > error and max(self.halved, default=0) < self.most_parts and self.runs < self.last_runs:
            self._halve()
        while self.time_error > error and self._controlled < len(self.rtols):
            rtol = self.rtols[self._controlled]
            self._controlled += 1
            run = self._reference(METHODS["dop853"], None, rtol)
            if run.status == "ok":
                self.time_error = tip_distance(run.tip, self.tips[-1]) if self.tips else np.inf
                self.tips.append(run.tip)
        if not np.isfinite(self.time_error):
            raise value_error("scene", "a motion that no reference follows", "one that is slower or bends less")

    def _halve(self) -> None:
        """Halves the step of the reference."""
        parts = 2 * max(self.halved) if self.halved else MIN_PARTS
        self.halved[parts] = run = self._reference(REFERENCE_METHOD, self.scene.output_step / parts)
        longer = self.halved.get(parts // 2)
        if longer is not None and run.status == longer.status == "ok":
            self.tips.append((4.0 * run.tip - longer.tip) / 3.0)
            if len(self.tips) > 1:
                self.time_error = EXTRAPOLATION_ERROR * tip_distance(self.tips[-1], self.tips[-2])

    def _reference(self, method: Method, step: float | None, rtol: float = 1e-6) -> Trajectory:
        self._count()
        run = simulate(self.scene, self.finest, method, step, rtol, 0.01 * rtol)
        if run.status == "ok":
            self.reference = run
        return run

    def _find_screening(self) -> None:
        """Finds the longest of the halved steps that meets the tolerance, else takes the last reference."""
        good = [parts for parts, run in self.halved.items() if self.tip_error(run) <= self.tolerance]
        parts = min(good, default=0 if self._controlled else max(self.halved))
        self.screening = self.scene.output_step / parts if parts else None
        self.beside = self.halved[parts] if parts else self.reference

    def sharpen(self, error: float) -> None:
        """Makes the error of the reference small beside an error (m) measured against it."""
        self._converge(0.25 * error)

    def model(self, candidate: Candidate) -> Model:
        """Gives the model of a candidate, built once."""
        if candidate not in self.models:
            self.models[candidate] = candidate.build(self.scene)
        return self.models[candidate]

    def run(self, candidate: Candidate, method: Method, step: float | None) -> Trajectory:
        """Simulates the scene with a candidate."""
        self._count()
        return simulate(self.scene, self.model(candidate), method, step)

    def _count(self) -> None:
        """Count a run of the scene."""
        self.runs += 1
        self._progress.count()

    def trial(self, candidate: Candidate, method: Method, step: float | None) -> CandidateRun:
        """Simulates the scene with a candidate and measures error and cost."""
        trial, run = self.timed_run(candidate, method, step)
        return trial._replace(error=self.tip_error(run))

    def timed_run(self, candidate: Candidate, method: Method, step: float | None) -> tuple[CandidateRun, Trajectory]:
        """Simulates the scene with a candidate and measures its cost; the error of the trial is left open, NaN."""
        self.model(candidate)
        started = clock.process_time()
        run = self.run(candidate, method, step)
        cost = clock.process_time() - started
        return CandidateRun(candidate, method, step or 0.0, np.nan, cost, run.evaluations), run

    def tip_error(self, run: Trajectory) -> float:
        """Gives the error (m) of a run at its outputs; inf for a run that failed or goes astray between its outputs."""
        times, reference = self.scene.output_times, self.tips[-1]
        if run.status != "ok" or not np.isclose(run.time[-1], times[-1], rtol=1e-6):
            return np.inf
        error = tip_distance(run.tip, reference[:: (len(times) - 1) // (len(run.time) - 1)])
        if len(run.time) < len(times):
            from scipy.interpolate import CubicHermiteSpline

            between = CubicHermiteSpline(run.time, run.tip, run.tip_velocity)(times)
            error = error if tip_distance(between, reference) <= self.tolerance else np.inf
        return error

    def screen(self, candidate: Candidate) -> float:
        """Gives the error (m) of a candidate without that of a method; its run is made once.

        It is run beside the full candidate, by the same method with the same step, so that what both have of its error
        drops out.
        """
        if candidate not in self.screened:
            method = REFERENCE_METHOD if self.screening else METHODS["dop853"]
            trial, self.screens[candidate] = self.timed_run(candidate, method, self.screening)
            self.screened[candidate] = trial._replace(error=self._beside(self.screens[candidate]))
        return self.screened[candidate].error

    def _beside(self, run: Trajectory) -> float:
        """How far (m) a run is from the full candidate at the same step; inf for one that failed."""
        return tip_distance(run.tip, self.beside.tip) if run.status == "ok" else np.inf

    def guess(self, candidate: Candidate, method: Method) -> float:
        """Guesses the cost of the scene times the step of a method, on the low side."""
        self.screen(candidate)
        screened = self.screened[candidate]
        each = self.scene.duration * screened.cost / max(screened.evaluations, 1)
        if isinstance(method, Explicit):
            return 0.3 * each * len(method.b)  # it factorises no matrix
        if isinstance(method, IteratedGauss):
            return 0.7 * each * method.evaluations
        return 0.7 * each * len(method.b) * max(method.sequence) if isinstance(method, LinearlyImplicit) else 0.0

    def pace(self, trial: CandidateRun, guessed: float) -> float:
        """Gives the cost of the scene times the step, after a trial and what was guessed before it."""
        return trial.cost * trial.step

    def first(self, method: Method, steps: list[float]) -> int:
        """Where in descending steps (s) to begin to try a method."""
        return 0

    def errors(self, candidate: Candidate, run: Trajectory) -> dict[str, float]:
        """Gives parts of the error (m) of a run of a candidate: what it lacks, and how well the reference is known."""
        return {"model": self.screen(candidate), "reference": self.error}

    def words(self) -> str:
        """What the reference is."""
        return f"reference: {self.reference.evaluations} evaluations with all coordinates, known to {self.error:.1g} m"

    def parts(self) -> dict[tuple[int, int], float]:
        """Gives how far (m) each mode (link, number) moves the tip in the motion of the reference, ascending."""
        return _tip_contributions(self.model(self.full), self.full, self.reference.states)

    def stiffest(self) -> list[tuple[int, int]]:
        """Gives the modes (link, number) in an order that lowers the highest frequency of the arm fast."""
        return _stiffest_modes(self.model(self.full), self.full, self.scene.initial.joint_angles)

    def reduced(self, start: Candidate, budget: float, order: list[tuple[int, int]]) -> Candidate:
        """Leaves out as many modes, in a given order, as a budget allows, and some of the next ones where it can.

        Args:
            start: the candidate that loses modes.
            budget: largest error at the tip, m.
            order: modes (link, number).
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


def tip_distance(tips: Array, others: Array) -> float:
    """Gives the largest distance (m) between tips (T, 3)."""
    return float(np.linalg.norm(tips - others, axis=-1).max())
