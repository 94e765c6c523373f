"""Search for the finite-element mesh of a scene with open elements, against a converged reference."""

from dataclasses import replace

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.fidelity.model_search import (
    REFERENCE_METHOD,
    REFERENCE_SHARE,
    Candidate,
    CandidateRun,
    ModelSearch,
    full_candidate,
)
from flexman_gym.model.dynamics import frequencies
from flexman_gym.model.model import Model, build_model
from flexman_gym.scene.scene import MAX_ELEMENTS, Scene
from flexman_gym.simulation.methods import Method
from flexman_gym.simulation.scene_simulation import simulate
from flexman_gym.simulation.trajectory import Trajectory

REFERENCE_ELEMENTS = 5  # elements of a link, or of each of its sections, in the reference
# 1; error of the reference mesh relative to the tip displacement for one element less in every link, as the error of
# cubic elements falls with the fourth power of their length
MESH_ERROR_FACTOR = (1.0 - 1.0 / REFERENCE_ELEMENTS) ** 4 / (1.0 - (1.0 - 1.0 / REFERENCE_ELEMENTS) ** 4)
MESH_SHARE = 0.4  # 1; largest error of the mesh relative to the tolerance
STEP_INCREASE = 1.7  # 1; longest step to try relative to the last step of the method with another candidate
# Simulations of the scene in total, and the numbers after which no method is tried, no candidate is screened (its error
# then counts as infinite), and no mesh is tried.
MAX_RUNS, MAX_RUNS_METHODS, MAX_RUNS_SCREENING, MAX_RUNS_MESH = 100, 80, 65, 30


class MeshSearch(ModelSearch):
    """Search for the coarsest mesh and its candidates whose tip stays within a tolerance of a fine reference model.

    The reference has five elements per link and foreshortening.

    Args:
        scene: the scene.
        tolerance: largest error of the tip, m.

    Attributes:
        mesh: chosen number of elements of each link.
        mesh_errors: distance of each mesh from the reference at the tip, m.
    """

    max_runs, max_runs_reference = MAX_RUNS_METHODS, MAX_RUNS - 6
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
        self._ending = False
        self._converge(REFERENCE_SHARE * tolerance)
        self._find_screening()
        if self.reference_model.n_elastic:
            self.mesh_error = MESH_ERROR_FACTOR * self._mesh_distance(tuple(max(1, count - 1) for count in finest))
        self.mesh = self._smallest_mesh(finest)
        self.scene = replace(scene, model=replace(scene.model, elements=self.mesh))
        self.full = full_candidate(self.scene)
        self.screen(self.full)
        self.reference = self.screening_runs[self.full]

    def _full_model(self, mesh: tuple[int, ...]) -> Model:
        """Return the model with all coordinates of a mesh."""
        switches = vars(self.scene.model) | {"elements": mesh, "modes": None}
        plain = build_model(self.scene.arm, **switches)
        return build_model(self.scene.arm, **(switches | {"stiffening": plain.n_elastic > 0}))

    def _mesh_distance(self, mesh: tuple[int, ...]) -> float:
        """Return the distance (m) of a mesh from the reference at the tip; its run is made once."""
        if mesh not in self.mesh_errors:
            if self.runs >= MAX_RUNS_MESH:
                return np.inf
            self._count()
            run = simulate(self.scene, self._full_model(mesh), REFERENCE_METHOD, self.screening)
            self.mesh_errors[mesh] = self._screening_error(run)
        return self.mesh_errors[mesh]

    def _smallest_mesh(self, finest: tuple[int, ...]) -> tuple[int, ...]:
        """Return the mesh with as few elements as its share of the tolerance allows, reduced link after link."""
        flexible, share = [bool(basis.size) for basis in self.reference_model.bases], MESH_SHARE * self.tolerance
        for most in range(1, REFERENCE_ELEMENTS + 1):
            mesh = tuple(min(most, count) if bent else 1 for count, bent in zip(finest, flexible, strict=True))
            if not any(flexible) or mesh == finest or self._mesh_distance(mesh) <= share:
                break
        for link in range(len(mesh)):
            while mesh[link] > 1:
                less = (*mesh[:link], mesh[link] - 1, *mesh[link + 1 :])
                if self._mesh_distance(less) > share:
                    break
                mesh = less
        return mesh

    def screen(self, candidate: Candidate) -> float:
        """Return the error (m) as `ModelSearch.screen`; infinity for a candidate after too many runs."""
        late = candidate not in self.screened and self.runs >= MAX_RUNS_SCREENING and not self._ending
        return np.inf if late else super().screen(candidate)

    def step_cost(self, trial: CandidateRun, guessed: float) -> float:
        """Return the estimate: the cost of a short run is mostly its start, which a shorter step does not change."""
        return guessed

    def first_index(self, method: Method, steps: list[float]) -> int:
        """Return the first of descending steps (s) to try: near the last one of another candidate, of similar error."""
        longest = STEP_INCREASE * self.last_steps.get(method.name, np.inf)
        return sum(step > longest for step in steps)

    def errors(self, candidate: Candidate, run: Trajectory) -> dict[str, float]:
        """Return the components of the error (m) of a run of a candidate, each a distance between two tips.

        They are the effects of the chosen mesh, of the omitted modes and of omitted foreshortening, the error of the
        method, and that of the reference.
        """
        self._ending = True
        shortened = candidate._replace(stiffening=self.full.stiffening)
        parts = {"mesh": self.screen(self.full)}
        parts["modes"] = self._between(shortened, self.full)
        parts["foreshortening"] = self._between(candidate, shortened)
        every = round(run.time[1] / self.scene.output_step)
        exact = self.screening_runs[candidate].tip + (self.reference_tips[-1] - self.screening_reference.tip)
        distances = np.linalg.norm(run.tip - exact[::every], axis=-1)
        return parts | {"method": float(distances.max()), "reference": self.error}

    def _between(self, candidate: Candidate, other: Candidate) -> float:
        """Return the distance (m) between two candidates at the tip."""
        self.screen(candidate)
        self.screen(other)
        tips, others = self.screening_runs[candidate].tip, self.screening_runs[other].tip
        return float(np.linalg.norm(tips - others, axis=-1).max()) if candidate != other else 0.0

    def describe_reference(self) -> str:
        """Return the meshes and the accuracy of the reference, and the estimated effect of large rotations, as text."""
        run, pose = self.halved_runs[max(self.halved_runs)], self.scene.initial.joint_angles
        slowest = frequencies(self.reference_model, pose)[self.reference_model.n_joints :][:1]
        angles, moved = large_rotation_error(
            self.reference_model, run.states, float(slowest.sum()) * self.scene.duration
        )
        return (
            f"elements of each link: {self.mesh}; of the reference: {self.reference_model.choice.elements}, accurate to"
            f" {self.error:.1g} m ({self.mesh_error:.1g} m by its mesh, {self.time_error:.1g} m by its steps)\n"
            f"linear beam theory, not part of the tolerance: the links bend by up to"
            f" {', '.join(f'{each:.3g}' for each in angles)} rad at their tips; large rotations would move the tip"
            f" by about {moved:.1g} m"
        )


def large_rotation_error(model: Model, states: Array, cycles: float) -> tuple[Array, float]:
    """Return the rotations of links at their tips by bending, and the estimated tip displacement by large rotations.

    In linear theory a force turns the tip of a cantilever of length L by a. The true rotation is less by 11/30 a^3 and
    the true deflection by 32/105 a^3 L: the next terms of the elastica (Bisshopp and Drucker 1945, Q. Appl. Math. 3,
    272). Relative to the deflection of 2/3 a L this is a spring stiffer by 0.46 a^2. A vibration of this amplitude is
    faster by 3/8 of it (Duffing), so that a slow vibration leads by 0.17 a^2 of its phase. The estimate adds the loss
    of deflection and the lead over all links, at their largest angles; it is an order of magnitude, not a bound.

    Args:
        model: the model.
        states: (T, 2 d).
        cycles: number of cycles of the slowest vibration.

    Returns:
        Largest angles (n,), rad, and the displacement, m.
    """
    lengths, angles = model.constants.length, np.zeros(model.n_joints)
    for i in range(model.n_joints):
        start, stop = model.constants.elastic_start[i : i + 2]
        turned = states[:, model.elastic_columns(i)] @ model.constants.tip_rotation[start:stop]
        angles[i] = np.linalg.norm(turned[:, 1:], axis=1).max()
    beyond = lengths.sum() - np.cumsum(lengths)
    less, moved = 32.0 / 105.0 * lengths + 11.0 / 30.0 * beyond, 2.0 / 3.0 * lengths + beyond
    ahead = 0.17 * 2.0 * np.pi * cycles * moved
    return angles, float(angles**3 @ (less + ahead))
