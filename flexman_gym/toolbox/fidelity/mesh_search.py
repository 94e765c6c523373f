"""Search for the number of finite elements of each link, for scenes with `elements=None`."""

from dataclasses import replace

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.model.dynamics import frequencies
from flexman_gym.model.model import Model, build_model
from flexman_gym.scene.scene import MAX_ELEMENTS, Scene
from flexman_gym.simulation.methods import Method
from flexman_gym.simulation.scene_simulation import simulate
from flexman_gym.simulation.trajectory import Trajectory
from flexman_gym.toolbox.fidelity.model_search import (
    REFERENCE_METHOD,
    REFERENCE_SHARE,
    Candidate,
    CandidateRun,
    ModelSearch,
)

REFERENCE_ELEMENTS = 5  # number of elements of a link, or of each of its sections, in the reference model
# error of the reference mesh / change of the tip position with one element less in every link, because the error of
# cubic elements is proportional to the fourth power of their length
MESH_ERROR_FACTOR = (1.0 - 1.0 / REFERENCE_ELEMENTS) ** 4 / (1.0 - (1.0 - 1.0 / REFERENCE_ELEMENTS) ** 4)
MESH_SHARE = 0.4  # dimensionless; largest error of the mesh / tolerance
STEP_INCREASE = 1.7  # dimensionless; longest step to try / last step of the same method with another candidate
# Largest number of simulations of the scene; the numbers after which no further method is tried, no further candidate
# is screened (its error is then taken as infinite), no mode is omitted singly, and no further mesh is tried.
MAX_RUNS, MAX_RUNS_METHODS, MAX_RUNS_SCREENING, MAX_RUNS_SINGLE, MAX_RUNS_MESH = 100, 80, 65, 86, 30


class MeshSearch(ModelSearch):
    """Search for the coarsest mesh, and reduced models with this mesh, within a tolerance of a fine reference model.

    The reference has five elements per link and foreshortening.

    Args:
        scene: the scene.
        tolerance: largest error of the tip position, m.

    Attributes:
        mesh: (n,) selected number of elements of each link.
        mesh_errors: mesh -> largest tip error of the model with this mesh, m.
    """

    max_runs, max_runs_reference, max_runs_single = MAX_RUNS_METHODS, MAX_RUNS - 6, MAX_RUNS_SINGLE
    max_runs_screening: float = MAX_RUNS_SCREENING
    max_parts, reference_rtols = 512, ()
    tolerance_shares = (0.6,)
    has_softer_models = False
    methods = ("midpoint_corrected_2", "gauss_2", "ros2", "extrapolated_euler_3", "rk4", "gauss_3",
             "midpoint_corrected_3", "extrapolated_euler_5", "dopri5")  # fmt: skip
    max_reference_share = 0.5
    max_timed = 3

    def __init__(self, scene: Scene, tolerance: float) -> None:
        self._initialise(scene, tolerance)
        sections = [len(link.sections) for link in scene.arm.links]
        finest = tuple(min(REFERENCE_ELEMENTS, MAX_ELEMENTS // count) for count in sections)
        self.reference_model = self._full_model(finest)
        self.mesh_errors: dict[tuple[int, ...], float] = {}
        self._converge(REFERENCE_SHARE * tolerance)
        self._find_screening()
        if self.reference_model.n_elastic:
            self.mesh_error = MESH_ERROR_FACTOR * self._mesh_distance(tuple(max(1, count - 1) for count in finest))
        self.mesh = self._smallest_mesh(finest)
        self.scene = replace(scene, model=replace(scene.model, elements=self.mesh))
        self._set_full()
        self.screen(self.full)
        self.reference = self.screening_runs[self.full]

    def _full_model(self, mesh: tuple[int, ...]) -> Model:
        """Return the model with all elastic coordinates of a mesh, and with foreshortening."""
        options = vars(self.scene.model) | {"elements": mesh, "modes": None}
        plain = build_model(self.scene.arm, **options)
        return build_model(self.scene.arm, **(options | {"stiffening": plain.n_elastic > 0}))

    def _mesh_distance(self, mesh: tuple[int, ...]) -> float:
        """Return the largest tip error (m) of the model with a mesh, relative to the reference; simulated once."""
        if mesh not in self.mesh_errors:
            if self.runs >= MAX_RUNS_MESH:
                return np.inf
            self._count()
            run = simulate(self.scene, self._full_model(mesh), REFERENCE_METHOD, self.screening)
            self.mesh_errors[mesh] = self._screening_error(run)
        return self.mesh_errors[mesh]

    def _smallest_mesh(self, finest: tuple[int, ...]) -> tuple[int, ...]:
        """Return the coarsest mesh with an error below MESH_SHARE of the tolerance, coarsened link by link."""
        flexible, limit = [bool(basis.size) for basis in self.reference_model.bases], MESH_SHARE * self.tolerance
        for most in range(1, REFERENCE_ELEMENTS + 1):
            mesh = tuple(min(most, count) if deforms else 1 for count, deforms in zip(finest, flexible, strict=True))
            if not any(flexible) or mesh == finest or self._mesh_distance(mesh) <= limit:
                break
        for link in range(len(mesh)):
            while mesh[link] > 1:
                coarser = (*mesh[:link], mesh[link] - 1, *mesh[link + 1 :])
                if self._mesh_distance(coarser) > limit:
                    break
                mesh = coarser
        return mesh

    def step_cost(self, trial: CandidateRun, estimate: float) -> float:
        """Return the estimate (s^2) unchanged, because most of the cost of a short run does not depend on the step."""
        return estimate

    def first_index(self, method: Method, steps: list[float]) -> int:
        """Return the index of the first of descending steps (s) to try, from the last step of another candidate."""
        longest = STEP_INCREASE * self.last_steps.get(method.name, np.inf)
        return sum(step > longest for step in steps)

    def errors(self, candidate: Candidate, run: Trajectory) -> dict[str, float]:
        """Return the components of the error of a run of a candidate, each a largest distance between two tips, m.

        They are the errors by the selected mesh, by omitted modes, by omitted foreshortening, of the method, and of the
        reference.
        """
        self.max_runs_screening = np.inf
        stiffened = candidate._replace(stiffening=self.full.stiffening)
        parts = {"mesh": self.screen(self.full)}
        parts["modes"] = self._distance(stiffened, self.full)
        parts["foreshortening"] = self._distance(candidate, stiffened)
        stride = round(run.time[1] / self.scene.output_step)
        exact = self.screening_runs[candidate].tip + (self.reference_tips[-1] - self.screening_reference.tip)
        distances = np.linalg.norm(run.tip - exact[::stride], axis=-1)
        return parts | {"method": float(distances.max()), "reference": self.error}

    def _distance(self, candidate: Candidate, other: Candidate) -> float:
        """Return the largest distance (m) between the tips of two candidates."""
        self.screen(candidate)
        self.screen(other)
        tips, others = self.screening_runs[candidate].tip, self.screening_runs[other].tip
        return float(np.linalg.norm(tips - others, axis=-1).max()) if candidate != other else 0.0

    def describe_reference(self) -> str:
        """Return the meshes and the accuracy of the reference, and the estimated effect of large rotations, as text."""
        run, posture = self.halved_runs[max(self.halved_runs)], self.scene.initial.joint_angles
        lowest = frequencies(self.reference_model, posture)[self.reference_model.n_joints :][:1]
        angles, displacement = _large_rotation_error(
            self.reference_model, run.states, float(lowest.sum()) * self.scene.duration
        )
        return (
            f"elements of each link: {self.mesh}; of the reference: {self.reference_model.choice.elements}, accurate to"
            f" {self.error:.1g} m ({self.mesh_error:.1g} m by its mesh, {self.time_error:.1g} m by its steps)\n"
            f"linear beam theory, not part of the tolerance: the links bend by up to"
            f" {', '.join(f'{each:.3g}' for each in angles)} rad at their tips; large rotations would move the tip"
            f" by about {displacement:.1g} m"
        )


def _large_rotation_error(model: Model, states: Array, cycles: float) -> tuple[Array, float]:
    """Return rotations of the link tips by bending, and an estimate of the error of the tip by linear beam theory.

    In linear theory a tip force rotates the tip of a cantilever of length L by an angle a. The rotation of the elastica
    is smaller by 11/30 a^3 and its deflection by 32/105 a^3 L, to the next order in a (Bisshopp and Drucker 1945, Q.
    Appl. Math. 3, 272). Relative to the linear deflection 2/3 a L the stiffness is larger by 0.46 a^2. The frequency of
    a vibration with this amplitude is larger by 3/8 of this value (Duffing oscillator), so that its phase leads by 0.17
    a^2 times the phase. The estimate sums the differences of deflection and phase over all links, at their largest
    angles; it is an order of magnitude, not a bound.

    Args:
        model: model of the arm.
        states: (T, 2 d).
        cycles: number of cycles of the vibration with the lowest frequency, 1.

    Returns:
        Largest angles (n,), rad, and the estimated error of the tip position, m.
    """
    lengths, angles = model.constants.length, np.zeros(model.n_joints)
    for i in range(model.n_joints):
        start, stop = model.constants.elastic_start[i : i + 2]
        rotations = states[:, model.elastic_columns(i)] @ model.constants.tip_rotation[start:stop]
        angles[i] = np.linalg.norm(rotations[:, 1:], axis=1).max()
    outboard = lengths.sum() - np.cumsum(lengths)
    deflection, linear = 32.0 / 105.0 * lengths + 11.0 / 30.0 * outboard, 2.0 / 3.0 * lengths + outboard
    lead = 0.17 * 2.0 * np.pi * cycles * linear
    return angles, float(angles**3 @ (deflection + lead))
