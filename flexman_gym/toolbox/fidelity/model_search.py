"""Search for a reduced model: candidates with omitted modes, and their errors against a converged reference."""

import time as clock
from typing import NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.errors import value_error
from flexman_gym.common.progress import Progress
from flexman_gym.model.assembled_modes import compact_modes
from flexman_gym.model.dynamics import mass_matrix, stiffness_matrix, tip_jacobian
from flexman_gym.model.model import Model, build_model
from flexman_gym.scene.scene import Scene
from flexman_gym.simulation.methods import METHODS, Method
from flexman_gym.simulation.scene_simulation import simulate
from flexman_gym.simulation.trajectory import Trajectory


class Candidate(NamedTuple):
    """Modes and effects that a reduced model retains.

    Attributes:
        modes: numbers of the retained component modes of each link, from 0.
        springs: True retains the springs of flexible joints.
        stiffening: True retains the foreshortening of the links.
    """

    modes: tuple[tuple[int, ...], ...]
    springs: bool
    stiffening: bool

    def without(self, omitted: list[tuple[int, int]]) -> "Candidate":
        """Return the candidate without some modes (link, mode number)."""
        modes = [tuple(j for j in numbers if (i, j) not in omitted) for i, numbers in enumerate(self.modes)]
        return self._replace(modes=tuple(modes))

    def build(self, scene: Scene) -> Model:
        """Return the model of the candidate for a scene."""
        modes = tuple(compact_modes(numbers) for numbers in self.modes)
        options = vars(scene.model) | {"flexible_joints": self.springs, "stiffening": self.stiffening, "modes": modes}
        return build_model(scene.arm, **options)


TOLERANCE_SHARES = (0.6, 0.25)  # dimensionless; error by omitted modes / tolerance; a candidate is built for each value
CANDIDATE_METHODS = ("extrapolated_euler_5", "extrapolated_euler_4", "extrapolated_euler_3", "ros2", "rk4", "dopri5",
         "midpoint_corrected_2", "midpoint_corrected_3", "midpoint_2", "midpoint_3", "gauss_2", "gauss_3",
         "generalised_alpha")  # fmt: skip
REFERENCE_SHARE = 0.05  # dimensionless; largest error of the reference / tolerance
REFERENCE_METHOD = METHODS["midpoint_3"]  # without numerical damping of vibrations at any step
MIN_PARTS, MAX_PARTS = 1, 64  # steps per output step in the first and the last of the runs with halved steps
# error of the extrapolated tip positions / their change by the last halving: 1/15 in theory, larger for vibrations
# with periods below the step
EXTRAPOLATION_ERROR = 0.5
MAX_SINGLE_MODES = 16  # number of modes that are omitted alone from the selected candidate, at most
MAX_SINGLE_RUNS = 28  # number of simulations for the omission of single modes, at most
MAX_SINGLE_DISPLACEMENT = 2.0  # dimensionless; tip displacement by a mode that is omitted singly / tolerance, at most
REFERENCE_RTOLS = (1e-5, 1e-8, 1e-11)  # relative tolerances of "dop853", used if halved steps do not converge


class CandidateRun(NamedTuple):
    """Simulation of the scene with a candidate model.

    Attributes:
        candidate: the candidate.
        method: integration method.
        step: s; 0 for a method with step-size control.
        error: largest error of the tip position, m; inf if the simulation failed.
        cost: processor time, s.
        evaluations: number of evaluations of the accelerations.
    """

    candidate: Candidate
    method: Method
    step: float
    error: float
    cost: float
    evaluations: int


class ModelSearch:
    """Converged reference simulation of a scene, and errors and costs of candidate models measured against it.

    The tip positions of the reference are extrapolated to a step of zero from simulations by the midpoint rule with
    successively halved steps. If these do not converge, the reference is a simulation with step-size control.
    Candidates are screened: they are simulated with one of these steps and compared with the full candidate at the same
    step, so that the common error of the method cancels.

    Args:
        scene: the scene.
        tolerance: largest error of the tip position, m.

    Attributes:
        models: candidate -> model built so far.
        screened, screening_runs: candidate -> result of `screen`, as `CandidateRun` and as trajectory.
        full: candidate with all modes, the joint springs and foreshortening.
        reference_model: model of the reference.
        halved_runs: number of steps per output step -> simulation of the reference model by the midpoint rule.
        reference_tips: tip positions (T, 3), m, of successively refined references.
        reference: a simulation of the full candidate.
        time_error, mesh_error: error of the reference by its steps and by its mesh, m.
        best: lowest cost so far of a simulation within the tolerance, s.
        runs: number of simulations of the scene so far.
        last_steps: method -> step tried last, s.
        screening: step for the screening of candidates, s; None for "dop853".
        screening_reference: simulation of the reference model at this step.
        max_runs, max_runs_reference: numbers of simulations after which no method is tried and no step is halved.
        max_runs_screening: number of simulations after which no candidate is screened: its error is taken as infinite.
        max_runs_single: number of simulations after which no mode is omitted singly.
        max_parts: largest number of steps per output step in `halved_runs`.
        reference_rtols: relative tolerances of references with step-size control, 1.
        tolerance_shares: error by omitted modes / tolerance, 1; a candidate is built for each value.
        has_softer_models: True adds candidates with low highest frequencies, for explicit methods.
        methods: names of the methods to try.
        max_reference_share: largest error of the reference / tolerance, 1.
        max_timed: number of the cheapest simulations that are timed again; None for all with similar cost.
    """

    max_runs: float = np.inf
    max_runs_reference: float = np.inf
    max_runs_screening: float = np.inf
    max_runs_single: float = np.inf
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
        self._set_full()
        self.reference_model = self.model(self.full)
        self._converge(REFERENCE_SHARE * tolerance)
        self._find_screening()

    def _initialise(self, scene: Scene, tolerance: float) -> None:
        """Initialise the search without a simulation."""
        self.scene, self.tolerance, self.runs, self.best, self.time_error = scene, tolerance, 0, np.inf, np.inf
        self.reference_tips: list[Array] = []
        self.halved_runs: dict[int, Trajectory] = {}
        self.last_steps: dict[str, float] = {}
        self.models: dict[Candidate, Model] = {}
        self.screened: dict[Candidate, CandidateRun] = {}
        self.screening_runs: dict[Candidate, Trajectory] = {}
        self._progress = Progress("runs of the scene")
        self._controlled = 0  # number of references with step-size control

    def _set_full(self) -> None:
        """Set the full candidate, the unreduced model: all modes, joint springs and foreshortening of the scene."""
        model = build_model(self.scene.arm, **(vars(self.scene.model) | {"modes": None}))
        modes = tuple(tuple(range(basis.shape[1])) for basis in model.bases)
        self.full = Candidate(modes, model.n_motors > 0, any(modes))

    @property
    def error(self) -> float:
        """Error of the reference, m."""
        return self.time_error + self.mesh_error

    def _converge(self, error: float) -> None:
        """Refine the reference until its estimated error by the steps is at most `error` (m)."""
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
            raise value_error("scene", "a motion without a converged reference", "a slower motion or a stiffer arm")

    def _halve(self) -> None:
        """Simulate the reference with half the last step, and extrapolate its tip positions to a step of zero."""
        parts = 2 * max(self.halved_runs) if self.halved_runs else MIN_PARTS
        self.halved_runs[parts] = run = self._reference(REFERENCE_METHOD, self.scene.output_step / parts)
        longer = self.halved_runs.get(parts // 2)
        if longer is not None and run.status == longer.status == "ok":
            self.reference_tips.append((4.0 * run.tip - longer.tip) / 3.0)
            if len(self.reference_tips) > 1:
                self.time_error = EXTRAPOLATION_ERROR * _tip_distance(self.reference_tips[-1], self.reference_tips[-2])

    def _reference(self, method: Method, step: float | None, rtol: float = 1e-6) -> Trajectory:
        """Simulate the reference model, and store the trajectory if the simulation did not fail."""
        self._count()
        run = simulate(self.scene, self.reference_model, method, step, rtol, 0.01 * rtol)
        if run.status == "ok":
            self.reference = run
        return run

    def _find_screening(self) -> None:
        """Select the longest of the halved steps within the tolerance for screening, else the latest reference."""
        accurate = [parts for parts, run in self.halved_runs.items() if self.tip_error(run) <= self.tolerance]
        parts = min(accurate, default=0 if self._controlled else max(self.halved_runs))
        self.screening = self.scene.output_step / parts if parts else None
        self.screening_reference = self.halved_runs[parts] if parts else self.reference

    def refine_reference(self, error: float) -> None:
        """Refine the reference until its error is at most a quarter of an error (m) measured against it."""
        self._converge(0.25 * error)

    def model(self, candidate: Candidate) -> Model:
        """Return the model of a candidate from a cache."""
        if candidate not in self.models:
            self.models[candidate] = candidate.build(self.scene)
        return self.models[candidate]

    def run(self, candidate: Candidate, method: Method, step: float | None) -> Trajectory:
        """Simulate the scene with a candidate."""
        self._count()
        return simulate(self.scene, self.model(candidate), method, step)

    def _count(self) -> None:
        """Count a simulation of the scene."""
        self.runs += 1
        self._progress.count()

    def measure(self, candidate: Candidate, method: Method, step: float | None) -> CandidateRun:
        """Simulate the scene with a candidate, and return its error and cost."""
        trial, run = self.run_timed(candidate, method, step)
        return trial._replace(error=self.tip_error(run))

    def run_timed(self, candidate: Candidate, method: Method, step: float | None) -> tuple[CandidateRun, Trajectory]:
        """Simulate the scene with a candidate; return its cost, with NaN as error, and the trajectory."""
        self.model(candidate)
        started = clock.process_time()
        run = self.run(candidate, method, step)
        cost = clock.process_time() - started
        return CandidateRun(candidate, method, step or 0.0, np.nan, cost, run.evaluations), run

    def tip_error(self, run: Trajectory) -> float:
        """Return the largest tip error (m) of a simulation at its outputs.

        It is infinite for a failed simulation, and for one that exceeds the tolerance between its outputs.
        """
        times, reference = self.scene.output_times, self.reference_tips[-1]
        if run.status != "ok" or not np.isclose(run.time[-1], times[-1], rtol=1e-6):
            return np.inf
        error = _tip_distance(run.tip, reference[:: (len(times) - 1) // (len(run.time) - 1)])
        if len(run.time) < len(times):
            from scipy.interpolate import CubicHermiteSpline

            interpolated = CubicHermiteSpline(run.time, run.tip, run.tip_velocity)(times)
            error = error if _tip_distance(interpolated, reference) <= self.tolerance else np.inf
        return error

    def screen(self, candidate: Candidate) -> float:
        """Return the largest tip error (m) of a candidate by its model alone, simulated once.

        The candidate and the full candidate are simulated by the same method with the same step, so that the error of
        the method cancels. The error is infinite if `max_runs_screening` is exceeded.
        """
        if candidate not in self.screened:
            if self.runs >= self.max_runs_screening:
                return np.inf
            method = REFERENCE_METHOD if self.screening else METHODS["dop853"]
            trial, self.screening_runs[candidate] = self.run_timed(candidate, method, self.screening)
            self.screened[candidate] = trial._replace(error=self._screening_error(self.screening_runs[candidate]))
        return self.screened[candidate].error

    def _screening_error(self, run: Trajectory) -> float:
        """Return the largest tip distance (m) to the full candidate simulated at the screening step; inf if failed."""
        return _tip_distance(run.tip, self.screening_reference.tip) if run.status == "ok" else np.inf

    def estimate_step_cost(self, candidate: Candidate, method: Method) -> float:
        """Return a low estimate, s^2, of processor time (s) to simulate the scene with a method, times the step (s)."""
        self.screen(candidate)
        screened = self.screened[candidate]
        cost = self.scene.duration * screened.cost / max(screened.evaluations, 1)  # s^2, for an evaluation per step
        return cost * method.step_cost

    def step_cost(self, trial: CandidateRun, estimate: float) -> float:
        """Return the processor time (s) to simulate the scene times the step (s), s^2, from a simulation.

        Args:
            trial: the simulation.
            estimate: the product before the simulation, s^2.
        """
        return trial.cost * trial.step

    def first_index(self, method: Method, steps: list[float]) -> int:
        """Return the index of the first of descending steps (s) to try with a method."""
        return 0

    def errors(self, candidate: Candidate, run: Trajectory) -> dict[str, float]:
        """Return the components of the tip error (m) of a simulation: reduced model and reference."""
        return {"model": self.screen(candidate), "reference": self.error}

    def describe_reference(self) -> str:
        """Return the evaluations and the accuracy of the reference as text."""
        return (
            f"reference: {self.reference.evaluations} evaluations with all coordinates, accurate to {self.error:.1g} m"
        )

    def contributions(self) -> dict[tuple[int, int], float]:
        """Return (link, mode number) -> largest tip displacement (m) in the motion of the reference, smallest first.

        The displacement includes the rotation of the free joints by conservation of momentum when the mode deflects.
        """
        model, states = self.model(self.full), self.reference.states
        rotations = np.eye(model.n_dof)[:, : model.n_joints]  # of joints together with their motors
        rotations[model.motor_columns] = np.eye(model.n_joints)
        displacements = np.zeros(model.n_dof)
        for state in states[:: max(1, len(states) // 8)]:
            momentum = rotations.T @ mass_matrix(model, state)
            projection = np.eye(model.n_dof) - rotations @ np.linalg.solve(momentum @ rotations, momentum)
            tip = tip_jacobian(model, state[: model.n_dof]) @ projection
            displacements = np.maximum(displacements, np.linalg.norm(tip, axis=0))
        displacements *= np.abs(states[:, : model.n_dof]).max(axis=0)
        contributions = {}
        for link, numbers in enumerate(self.full.modes):
            for number, displacement in zip(numbers, displacements[model.elastic_columns(link)], strict=True):
                contributions[link, number] = float(displacement)
        return dict(sorted(contributions.items(), key=lambda item: item[1]))

    def stiffest_modes(self) -> list[tuple[int, int]]:
        """Return the modes (link, mode number), ordered so that omitting them lowers the highest frequency fast.

        Each is the component mode with the largest amplitude in the vibration mode of highest frequency of the arm
        without the component modes already listed.
        """
        from scipy.linalg import eigh

        model = self.model(self.full)
        mass = mass_matrix(model, model.initial_state(self.scene.initial.joint_angles))
        stiffness, size = stiffness_matrix(model), np.sqrt(np.diag(mass))
        modes = [(link, number) for link, numbers in enumerate(self.full.modes) for number in numbers]
        first, order = model.n_dof - len(modes), []
        remaining = list(range(model.n_dof))
        while len(remaining) > first:
            block = np.ix_(remaining, remaining)
            shape = eigh(stiffness[block], mass[block])[1][:, -1]
            largest = first + int(np.argmax(np.abs(shape * size[remaining])[first:]))
            order.append(modes[remaining.pop(largest) - first])
        return order

    def reduced(self, start: Candidate, limit: float, order: list[tuple[int, int]]) -> Candidate:
        """Return a candidate from which as many modes are omitted, in a given order, as an error limit allows.

        After the first mode that cannot be omitted, the next four modes are tried one by one.

        Args:
            start: the candidate to reduce.
            limit: largest tip error, m.
            order: modes (link, mode number).
        """
        low, high = 0, len(order) + 1
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (middle, high) if self.screen(start.without(order[:middle])) <= limit else (low, middle)
        omitted = order[:low]
        for mode in order[low + 1 : low + 5]:
            if self.screen(start.without([*omitted, mode])) <= limit:
                omitted = [*omitted, mode]
        return start.without(omitted)

    def single_errors(self, candidate: Candidate, parts: dict[tuple[int, int], float]) -> dict[tuple[int, int], float]:
        """Return (link, mode number) -> tip error (m) of a candidate by its model without this retained mode alone.

        Only modes with a small displacement of the tip are screened, at most MAX_SINGLE_MODES.

        Args:
            candidate: the candidate.
            parts: `contributions`.
        """
        self.max_runs_screening = np.inf
        self.max_runs_single = min(self.max_runs_single, self.runs + MAX_SINGLE_RUNS)
        last, errors = min(self.runs + MAX_SINGLE_MODES, self.max_runs_single - MAX_SINGLE_RUNS // 4), {}
        for (link, number), displacement in parts.items():
            retained = number in candidate.modes[link] and displacement <= MAX_SINGLE_DISPLACEMENT * self.tolerance
            if retained and self.runs < last:
                errors[link, number] = self.screen(candidate.without([(link, number)]))
        return errors


def _tip_distance(tips: Array, others: Array) -> float:
    """Return the largest distance (m) between the tip positions (T, 3) of two simulations."""
    return float(np.linalg.norm(tips - others, axis=-1).max())
