"""Search: candidates for a scene, each measured against a converged run of its finest model."""

import time as clock
from typing import NamedTuple

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.model.instant import mass_matrix, stiffness_matrix, tip_jacobian
from flexman_gym.model.model import Model, build_model
from flexman_gym.scene.scene import Scene
from flexman_gym.simulation.families import REFERENCE, Explicit, Method
from flexman_gym.simulation.methods import METHODS
from flexman_gym.simulation.scenes import simulate
from flexman_gym.simulation.trajectory import Trajectory

MODEL_SHARES = (0.6, 0.25)  # parts of the tolerance that dropped coordinates may use; each gives a model
TRIED = ("extrapolated_euler_5", "extrapolated_euler_4", "extrapolated_euler_3", "ros2", "rk4", "dopri5",
         "implicit_midpoint_2", "implicit_midpoint_3", "generalised_alpha")  # fmt: skip
SHARP = 0.05  # of the tolerance, the most by which the reference may be off
# Method, steps in an output step and rtol of finer and finer references. Stiff modes do not limit the first two
# methods, but the first method lets some of them grow.
REFERENCES = (
    *((METHODS["extrapolated_euler_5"], parts, 1e-6) for parts in (1, 2)),
    *((METHODS["ros2"], parts, 1e-6) for parts in (16, 64)),
    *((METHODS["dop853"], None, rtol) for rtol in (1e-5, 1e-8, 1e-11)),
)


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
        modes = tuple(given_modes(kept) for kept in self.modes)
        switches = vars(scene.model) | {"flexible_joints": self.springs, "stiffening": self.stiffening, "modes": modes}
        return build_model(scene.arm, **switches)


class Trial(NamedTuple):
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


class Search:
    """The reference of a scene, and the candidates that were measured against it.

    Attributes:
        scene: the scene.
        tolerance: of the tip, m.
        models: the models that were built.
        screened: the runs that `screen` made.
        full: the candidate that keeps everything.
        tips: positions of the tip by finer and finer references, (T, 3) each, m.
        reference: the finest reference that did not fail.
        error: of the reference, m.
        best: cost of the cheapest run that met the tolerance, s.
        runs: how many runs of the scene were made.
        last: the last step (s) that was tried of each method.
        most_runs: no method is tried any more when there are so many.
        shares: parts of the tolerance that dropped coordinates may use; each gives a model.
        softens: whether explicit methods get models of their own.
        tried: names of the methods to try.
        blurred: part of the tolerance from which on the error of the reference is too large.
        timed: how many of the cheapest trials are timed again, None for all that are close.
    """

    most_runs: float = np.inf
    shares: tuple[float, ...] = MODEL_SHARES
    softens = True
    tried: tuple[str, ...] = TRIED
    blurred = 2 * SHARP
    timed: int | None = None

    def __init__(self, scene: Scene, tolerance: float) -> None:
        self._begin(scene, tolerance)
        self.error = np.inf
        self._converge(SHARP * tolerance)

    def _begin(self, scene: Scene, tolerance: float) -> None:
        """Starts without runs, for a scene with a mesh."""
        self.scene, self.tolerance, self.runs, self.best = scene, tolerance, 0, np.inf
        self.tips: list[Array] = []
        self.last: dict[str, float] = {}
        self.models: dict[Candidate, Model] = {}
        self.screened: dict[Candidate, Trial] = {}
        choice = scene.model
        everything = build_model(scene.arm, **(vars(choice) | {"modes": None}))
        modes = tuple(tuple(range(basis.shape[1])) for basis in everything.bases)
        self.full = Candidate(modes, everything.n_motors > 0, any(modes))

    def _converge(self, error: float) -> None:
        """Goes to finer references until two agree to an error (m)."""
        for method, parts, rtol in REFERENCES[len(self.tips) :]:
            if self.error <= error:
                return
            step = self.scene.output_step / parts if parts else None
            self.runs += 1
            run = simulate(self.scene, self.model(self.full), method, step, rtol, 0.01 * rtol)
            if run.status == "ok":
                self.reference = run
            last = self.tips[-1] if self.tips else np.full_like(run.tip, np.nan)
            self.tips.append(run.tip if run.status == "ok" else np.full((*self.scene.output_times.shape, 3), np.nan))
            self.error = np.nan_to_num(distance(self.tips[-1], last), nan=np.inf)

    @property
    def screening(self) -> tuple[Method, float | None]:
        """The first reference that is right on the scene with all coordinates: its method and step (s)."""
        for (method, parts, _), tip in zip(REFERENCES, self.tips, strict=False):
            if distance(tip, self.tips[-1]) <= 2 * SHARP * self.tolerance:
                return method, self.scene.output_step / parts if parts else None
        return METHODS["dop853"], None

    def sharpen(self, error: float) -> None:
        """Goes to finer references until their own error is small beside an error (m) measured against them."""
        if self.error > 0.25 * error:
            self._converge(0.25 * error)

    def model(self, candidate: Candidate) -> Model:
        """Gives the model of a candidate, built once."""
        if candidate not in self.models:
            self.models[candidate] = candidate.build(self.scene)
        return self.models[candidate]

    def run(self, candidate: Candidate, method: Method, step: float | None) -> Trajectory:
        """Simulates the scene with a candidate."""
        self.runs += 1
        return simulate(self.scene, self.model(candidate), method, step)

    def trial(self, candidate: Candidate, method: Method, step: float | None) -> Trial:
        """Simulates the scene with a candidate and measures error and cost."""
        trial, run = self.timed_run(candidate, method, step)
        return trial._replace(error=self.tip_error(run))

    def timed_run(self, candidate: Candidate, method: Method, step: float | None) -> tuple[Trial, Trajectory]:
        """Simulates the scene with a candidate and measures its cost; the error of the trial is left open, NaN."""
        self.model(candidate)
        started = clock.process_time()
        run = self.run(candidate, method, step)
        cost = clock.process_time() - started
        return Trial(candidate, method, step or 0.0, np.nan, cost, run.evaluations), run

    def tip_error(self, run: Trajectory) -> float:
        """Gives the error (m) of a run at its outputs; inf for a run that failed or goes astray between its outputs."""
        times, reference = self.scene.output_times, self.tips[-1]
        if run.status != "ok" or not np.isclose(run.time[-1], times[-1], rtol=1e-6):
            return np.inf
        error = distance(run.tip, reference[:: (len(times) - 1) // (len(run.time) - 1)])
        if len(run.time) < len(times):
            from scipy.interpolate import CubicHermiteSpline

            between = CubicHermiteSpline(run.time, run.tip, run.tip_velocity)(times)
            error = error if distance(between, reference) <= self.tolerance else np.inf
        return error

    def screen(self, candidate: Candidate) -> float:
        """Gives the error (m) of a candidate that is integrated well; its run is made once."""
        if candidate not in self.screened:
            self.screened[candidate] = self.trial(candidate, *self.screening)
        return self.screened[candidate].error

    def guess(self, candidate: Candidate, method: Method) -> float:
        """Guesses the cost of the scene times the step of an explicit method; 0 for others, whose steps are long."""
        self.screen(candidate)
        screened = self.screened[candidate]
        ease = 1.0 if screened.method.kind == REFERENCE else 0.3  # an explicit method factorises no matrix
        seconds = ease * screened.cost / max(screened.evaluations, 1)
        return seconds * len(method.b) * self.scene.duration if isinstance(method, Explicit) else 0.0

    def pace(self, trial: Trial, guessed: float) -> float:
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
        """Gives how far (m) each mode (link, number) moves the tip in the motion of the reference, ascending.

        A mode that bends turns the free joints the other way, as momentum is kept. The motion of the tip includes this
        turn.
        """
        model, states = self.model(self.full), self.reference.states
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
        for link, kept in enumerate(self.full.modes):
            for number, part in zip(kept, moves[model.elastic_columns(link)], strict=True):
                parts[link, number] = float(part)
        return dict(sorted(parts.items(), key=lambda item: item[1]))

    def stiffest(self) -> list[tuple[int, int]]:
        """Gives the modes (link, number) in an order that lowers the highest frequency of the arm fast.

        Each is the mode with the largest part in the highest vibration of the arm without the modes before it.
        """
        from scipy.linalg import eigh

        model = self.model(self.full)
        mass = mass_matrix(model, model.initial_state(self.scene.initial.joint_angles))
        stiffness, size = stiffness_matrix(model), np.sqrt(np.diag(mass))
        modes = [(link, number) for link, kept in enumerate(self.full.modes) for number in kept]
        first, order = model.n_dof - len(modes), []
        left = list(range(model.n_dof))
        while len(left) > first:
            block = np.ix_(left, left)
            shape = eigh(stiffness[block], mass[block])[1][:, -1]
            place = first + int(np.argmax(np.abs(shape * size[left])[first:]))
            order.append(modes[left.pop(place) - first])
        return order

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


def given_modes(numbers: tuple[int, ...]) -> int | tuple[int, ...]:
    """Gives the modes of a link as `build_model` takes them: the lowest ones as their number, others as a tuple."""
    return len(numbers) if numbers == tuple(range(len(numbers))) else numbers


def distance(tips: Array, others: Array) -> float:
    """Gives the largest distance (m) between tips (T, 3)."""
    return float(np.linalg.norm(tips - others, axis=-1).max())
