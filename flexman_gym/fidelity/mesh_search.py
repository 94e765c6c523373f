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
    tip_distance,
)
from flexman_gym.model.dynamics import frequencies
from flexman_gym.model.model import Model, build_model
from flexman_gym.scene.scene import MAX_ELEMENTS, Scene
from flexman_gym.simulation.methods import Method
from flexman_gym.simulation.scene_simulation import simulate
from flexman_gym.simulation.trajectory import Trajectory

REFERENCE_ELEMENTS = 5  # elements of a link, or of its sections, in the reference
# Errors of cubic elements fall with the fourth power of their length. What the finest mesh is off by, in parts of what
# moves the tip when every link has one element less:
MESH_ERROR_FACTOR = (1.0 - 1.0 / REFERENCE_ELEMENTS) ** 4 / (1.0 - (1.0 - 1.0 / REFERENCE_ELEMENTS) ** 4)
MESH_SHARE = 0.4  # part of the tolerance that a mesh may use
STEP_INCREASE = 1.7  # times the last step of a method with another candidate: the longest one to try with the next
# Runs of the scene: all of them, those that may come before the end of a choice, before methods are tried, and before
# candidates are screened. What is not screened by then counts as wrong.
MAX_RUNS, MAX_RUNS_METHODS, MAX_RUNS_SCREENING, MAX_RUNS_MESH = 100, 80, 65, 30


class MeshSearch(ModelSearch):
    """The reference of a scene with an open mesh, and the mesh and the candidates that were measured against it.

    The reference has five elements a link and foreshortening.

    Attributes:
        mesh: the elements of each link that were chosen.
        mesh_errors: how far each mesh that was tried is from the reference, m.
    """

    most_runs, last_runs = MAX_RUNS_METHODS, MAX_RUNS - 6
    most_parts, rtols = 512, ()
    shares = (0.6,)
    softens = False
    tried = ("midpoint_2", "gauss_2", "ros2", "extrapolated_euler_3", "rk4", "gauss_3",
             "midpoint_3", "extrapolated_euler_5", "dopri5")  # fmt: skip
    blurred = 0.5
    timed = 3

    def __init__(self, scene: Scene, tolerance: float) -> None:
        self._begin(scene, tolerance)
        sections = [len(link.sections) for link in scene.arm.links]
        finest = tuple(min(REFERENCE_ELEMENTS, MAX_ELEMENTS // count) for count in sections)
        self.finest = self._whole(finest)
        self.mesh_errors: dict[tuple[int, ...], float] = {}
        self._ending = False
        self._converge(REFERENCE_SHARE * tolerance)
        self._find_screening()
        if self.finest.n_elastic:
            self.mesh_error = MESH_ERROR_FACTOR * self._mesh_distance(tuple(max(1, count - 1) for count in finest))
        self.mesh = self._smallest_mesh(finest)
        self.scene = replace(scene, model=replace(scene.model, elements=self.mesh))
        self.full = full_candidate(self.scene)
        self.screen(self.full)
        self.reference = self.screens[self.full]

    def _whole(self, mesh: tuple[int, ...]) -> Model:
        """Builds the model with all coordinates of a mesh."""
        switches = vars(self.scene.model) | {"elements": mesh, "modes": None}
        plain = build_model(self.scene.arm, **switches)
        return build_model(self.scene.arm, **(switches | {"stiffening": plain.n_elastic > 0}))

    def _mesh_distance(self, mesh: tuple[int, ...]) -> float:
        """How far (m) a mesh is from the reference; its run is made once."""
        if mesh not in self.mesh_errors:
            if self.runs >= MAX_RUNS_MESH:
                return np.inf
            self._count()
            run = simulate(self.scene, self._whole(mesh), REFERENCE_METHOD, self.screening)
            self.mesh_errors[mesh] = self._beside(run)
        return self.mesh_errors[mesh]

    def _smallest_mesh(self, finest: tuple[int, ...]) -> tuple[int, ...]:
        """Finds the mesh with as few elements as its share of the tolerance allows, link after link."""
        flexible, share = [bool(basis.size) for basis in self.finest.bases], MESH_SHARE * self.tolerance
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
        """Gives the error (m) as `ModelSearch.screen`, infinity for a candidate that comes after too many runs."""
        late = candidate not in self.screened and self.runs >= MAX_RUNS_SCREENING and not self._ending
        return np.inf if late else super().screen(candidate)

    def pace(self, trial: CandidateRun, guessed: float) -> float:
        """The guess again: most of a short run is what it takes to begin, which a shorter step leaves as it is."""
        return guessed

    def first(self, method: Method, steps: list[float]) -> int:
        """Where in descending steps (s) to begin: near the last one of another candidate, whose error is much alike."""
        longest = STEP_INCREASE * self.last.get(method.name, np.inf)
        return sum(step > longest for step in steps)

    def errors(self, candidate: Candidate, run: Trajectory) -> dict[str, float]:
        """Gives the parts of the error (m) of a run of a candidate, each the distance between two tips.

        They are what the chosen mesh, the modes that are left out and foreshortening, where it is, move the tip by, the
        error of the method, and that of the reference.
        """
        self._ending = True
        shortened = candidate._replace(stiffening=self.full.stiffening)
        parts = {"mesh": self.screen(self.full)}
        parts["modes"] = self._between(shortened, self.full)
        parts["foreshortening"] = self._between(candidate, shortened)
        every = round(run.time[1] / self.scene.output_step)
        exact = self.screens[candidate].tip + (self.tips[-1] - self.beside.tip)
        return parts | {"method": tip_distance(run.tip, exact[::every]), "reference": self.error}

    def _between(self, candidate: Candidate, other: Candidate) -> float:
        self.screen(candidate)
        self.screen(other)
        return tip_distance(self.screens[candidate].tip, self.screens[other].tip) if candidate != other else 0.0

    def words(self) -> str:
        """What the reference is, and how far it is from an arm whose links may turn far."""
        run, still = self.halved[max(self.halved)], self.scene.initial.joint_angles
        slowest = frequencies(self.finest, still)[self.finest.n_joints :][:1]
        angles, moved = large_rotation_error(self.finest, run.states, float(slowest.sum()) * self.scene.duration)
        return (
            f"elements of each link: {self.mesh}, of the reference: {self.finest.choice.elements}; it is known to"
            f" {self.error:.1g} m ({self.mesh_error:.1g} m by its mesh, {self.time_error:.1g} m by its steps)\n"
            f"beam theory, which is no part of the tolerance: links turn by up to"
            f" {', '.join(f'{each:.3g}' for each in angles)} rad at their tips; with large rotations the tip would be"
            f" about {moved:.1g} m away"
        )


def large_rotation_error(model: Model, states: Array, cycles: float) -> tuple[Array, float]:
    """Gives how far links turn at their tips by bending, and about how far large rotations would move the arm's tip.

    A cantilever of length L whose tip a force turns by a, in linear theory, turns by 11/30 a^3 less and deflects by
    32/105 a^3 L less: the next terms of the elastica (Bisshopp and Drucker 1945, Q. Appl. Math. 3, 272). Against its
    deflection of 2/3 a L that is a spring stiffer by 0.46 a^2, and a vibration of this amplitude is faster by three
    eighths of it (Duffing). So a slow vibration runs ahead by 0.17 a^2 of its phase. The figure adds what is lost and
    what runs ahead over all links, at their largest angles: a size, not a bound.

    Args:
        model: the model.
        states: (T, 2 d).
        cycles: of the slowest vibration.

    Returns:
        Largest angles (n,) rad, and the distance in m.
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
