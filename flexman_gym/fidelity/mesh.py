"""Mesh: the search of a scene that leaves its finite elements open, measured against the converged arm."""

from dataclasses import replace

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.checks import refusal
from flexman_gym.fidelity.search import SHARP, Candidate, Search, Trial, distance
from flexman_gym.model.instant import frequencies
from flexman_gym.model.model import Model, build_model
from flexman_gym.scene.choice import MOST_ELEMENTS
from flexman_gym.scene.scene import Scene
from flexman_gym.simulation.families import Explicit, LinearlyImplicit, Method, Midpoint
from flexman_gym.simulation.methods import METHODS
from flexman_gym.simulation.scenes import simulate
from flexman_gym.simulation.trajectory import Trajectory

FINEST = 5  # elements of a link, or of its sections, in the reference
# Errors of cubic elements fall with the fourth power of their length. What the finest mesh is off by, in parts of what
# moves the tip when every link has one element less:
LEFT = (1.0 - 1.0 / FINEST) ** 4 / (1.0 - (1.0 - 1.0 / FINEST) ** 4)
MESH_SHARE = 0.4  # part of the tolerance that a mesh may use
FIRST_PARTS, MOST_PARTS = 5, 640  # steps in an output step of the first and of the last reference
# What extrapolated tips are off by, in parts of what the last halving changed; 1/15 but for modes faster than steps.
STEPS_LEFT = 0.5
LONGER = 1.7  # times the last step of a method with another candidate: the longest one to try with the next
REFERENCE = METHODS["implicit_midpoint_3"]  # lets no vibration grow or fade, however short its steps
# Runs of the scene: all of them, those that may come before the end of a choice, before methods are tried, and before
# candidates are screened. What is not screened by then counts as wrong.
MOST_RUNS, TRYING, SCREENING, MESHING = 100, 80, 65, 30


class MeshSearch(Search):
    """The reference of a scene with an open mesh, and the mesh and the candidates that were measured against it.

    The reference has five elements a link and foreshortening. Its tips are extrapolated from runs of the midpoint rule
    and halved steps to steps of no length. Candidates are screened at one of these steps, beside the reference at the
    same step, so that what both have of its error drops out.

    Attributes:
        time_error, mesh_error: of the reference by its steps and by its mesh, m.
        mesh: the elements of each link that were chosen.
        mesh_errors: how far each mesh that was tried is from the reference, m.
    """

    most_runs = TRYING
    shares = (0.6,)
    softens = False
    tried = ("implicit_midpoint_2", "ros2", "extrapolated_euler_3", "rk4", "implicit_midpoint_3",
             "extrapolated_euler_5", "dopri5")  # fmt: skip
    blurred = 0.5
    timed = 3

    def __init__(self, scene: Scene, tolerance: float) -> None:
        self.scene, self.tolerance, self.runs = scene, tolerance, 0
        self.tips: list[Array] = []
        sections = [len(link.sections) for link in scene.arm.links]
        finest = tuple(min(FINEST, MOST_ELEMENTS // count) for count in sections)
        self.finest = self._whole(finest)
        self.mesh_errors: dict[tuple[int, ...], float] = {}
        self._ending = False
        self._halved: dict[int, Trajectory] = {}  # runs of the finest mesh, by their steps in an output step
        self._screens: dict[Candidate, Trajectory] = {}
        self.time_error, self.mesh_error = np.inf, 0.0
        self._halve(SHARP * tolerance)
        good = [parts for parts, run in self._halved.items() if self.tip_error(run) <= tolerance]
        self._parts = min(good, default=max(self._halved))
        if self.finest.n_elastic:
            self.mesh_error = LEFT * self._mesh_distance(tuple(max(1, count - 1) for count in finest))
        self.error = self.time_error + self.mesh_error
        self.mesh = self._smallest_mesh(finest)
        tips, runs = self.tips, self.runs
        self._begin(replace(scene, model=replace(scene.model, elements=self.mesh)), tolerance)
        self.tips, self.runs = tips, runs
        self.screen(self.full)
        self.reference = self._screens[self.full]

    def _whole(self, mesh: tuple[int, ...]) -> Model:
        """Builds the model with all coordinates of a mesh."""
        switches = vars(self.scene.model) | {"elements": mesh, "modes": None}
        plain = build_model(self.scene.arm, **switches)
        return build_model(self.scene.arm, **(switches | {"stiffening": plain.n_elastic > 0}))

    def _run(self, model: Model, parts: int) -> Trajectory:
        self.runs += 1
        return simulate(self.scene, model, REFERENCE, self.scene.output_step / parts)

    def _halve(self, error: float) -> None:
        """Halves the step of the reference until its tips change little enough (m)."""
        while self.time_error > error and max(self._halved, default=0) < MOST_PARTS and self.runs < MOST_RUNS - 6:
            parts = 2 * max(self._halved) if self._halved else FIRST_PARTS
            self._halved[parts] = run = self._run(self.finest, parts)
            longer = self._halved.get(parts // 2)
            if longer is not None and run.status == longer.status == "ok":
                self.tips.append((4.0 * run.tip - longer.tip) / 3.0)
                if len(self.tips) > 1:
                    self.time_error = STEPS_LEFT * distance(self.tips[-1], self.tips[-2])
        self.error = self.time_error + self.mesh_error
        if not np.isfinite(self.time_error):
            raise refusal("scene", "a motion that no reference follows", "one that is slower or bends less")

    def sharpen(self, error: float) -> None:
        """Halves the step of the reference until its error is small beside an error (m) measured against it."""
        self._halve(0.25 * error)

    def _beside(self, run: Trajectory) -> float:
        """How far (m) a run is from the reference at the same step; inf for one that failed."""
        return distance(run.tip, self._halved[self._parts].tip) if run.status == "ok" else np.inf

    def _mesh_distance(self, mesh: tuple[int, ...]) -> float:
        """How far (m) a mesh is from the reference; its run is made once."""
        if mesh not in self.mesh_errors:
            if self.runs >= MESHING:
                return np.inf
            self.mesh_errors[mesh] = self._beside(self._run(self._whole(mesh), self._parts))
        return self.mesh_errors[mesh]

    def _smallest_mesh(self, finest: tuple[int, ...]) -> tuple[int, ...]:
        """Finds the mesh with as few elements as its share of the tolerance allows, link after link."""
        flexible, share = [bool(basis.size) for basis in self.finest.bases], MESH_SHARE * self.tolerance
        for most in range(1, FINEST + 1):
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
        """Gives the error (m) of a candidate without that of a method; its run is made once."""
        if candidate not in self.screened:
            if self.runs >= SCREENING and not self._ending:
                return np.inf
            step = self.scene.output_step / self._parts
            trial, self._screens[candidate] = self.timed_run(candidate, REFERENCE, step)
            self.screened[candidate] = trial._replace(error=self._beside(self._screens[candidate]))
        return self.screened[candidate].error

    def guess(self, candidate: Candidate, method: Method) -> float:
        """Guesses the cost of the scene times the step of a method, on the low side."""
        self.screen(candidate)
        screened = self.screened[candidate]
        each = self.scene.duration * screened.cost / max(screened.evaluations, 1)
        if isinstance(method, Explicit):
            return 0.3 * each * len(method.b)
        if isinstance(method, Midpoint):
            return 0.7 * each * method.sweeps
        return 0.7 * each * len(method.b) * max(method.sequence) if isinstance(method, LinearlyImplicit) else 0.0

    def pace(self, trial: Trial, guessed: float) -> float:
        """The guess again: most of a short run is what it takes to begin, which a shorter step leaves as it is."""
        return guessed

    def first(self, method: Method, steps: list[float]) -> int:
        """Where in descending steps (s) to begin: near the last one of another candidate, whose error is much alike."""
        longest = LONGER * self.last.get(method.name, np.inf)
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
        exact = self._screens[candidate].tip + (self.tips[-1] - self._halved[self._parts].tip)
        return parts | {"method": distance(run.tip, exact[::every]), "reference": self.error}

    def _between(self, candidate: Candidate, other: Candidate) -> float:
        self.screen(candidate)
        self.screen(other)
        return distance(self._screens[candidate].tip, self._screens[other].tip) if candidate != other else 0.0

    def words(self) -> str:
        """What the reference is, and how far it is from an arm whose links may turn far."""
        run, still = self._halved[max(self._halved)], self.scene.initial.joint_angles
        slowest = frequencies(self.finest, still)[self.finest.n_joints :][:1]
        angles, moved = large_rotations(self.finest, run.states, float(slowest.sum()) * self.scene.duration)
        return (
            f"elements of each link: {self.mesh}, of the reference: {self.finest.choice.elements}; it is known to"
            f" {self.error:.1g} m ({self.mesh_error:.1g} m by its mesh, {self.time_error:.1g} m by its steps)\n"
            f"beam theory, which is no part of the tolerance: links turn by up to"
            f" {', '.join(f'{each:.3g}' for each in angles)} rad at their tips; with large rotations the tip would be"
            f" about {moved:.1g} m away"
        )


def large_rotations(model: Model, states: Array, cycles: float) -> tuple[Array, float]:
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
