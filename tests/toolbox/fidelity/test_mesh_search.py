"""Open meshes: the elements that are chosen keep the tolerance against the converged arm, and the estimate is right."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.integrate import quad, solve_bvp

import flexman_gym as fm
from flexman_gym.model.model import scene_model
from flexman_gym.toolbox.fidelity import mesh_search
from flexman_gym.toolbox.fidelity.mesh_search import MAX_RUNS, MeshSearch

from oracles.assertions import refusal
from oracles.chains import random_scene

pytestmark = pytest.mark.filterwarnings("ignore:Link.second_moment_y:UserWarning")


def opened(scene):
    """The scene with its elements left to the choice."""
    return replace(scene, model=replace(scene.model, elements=None))


SCENES = {
    "paper ff": lambda: opened(replace(fm.catalog.paper_scene("ff"), duration=0.5)),
    "paper fr": lambda: opened(replace(fm.catalog.paper_scene("fr"), duration=0.5)),
    "two links": lambda: random_scene(3, 2, None, 0.4),
}


@cache
def converged(name, elements=6):
    """The tip of a finer mesh than any that is chosen, its steps extrapolated away."""
    scene = SCENES[name]()
    model = fm.build_model(scene.arm, **(vars(scene.model) | {"elements": elements, "stiffening": True}))
    longer, shorter = (fm.simulate(scene, model, "implicit_midpoint", step).tip for step in (5e-4, 2.5e-4))
    return (4.0 * shorter - longer) / 3.0


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("tolerance", [2e-2, 2e-3])
def test_a_choice_with_its_mesh_meets_the_tolerance_and_knows_its_error(name, tolerance):
    scene, tips = SCENES[name](), converged(name)
    assert np.linalg.norm(tips - tips[0], axis=1).max() > 2e-2, "the arm moves"
    choice = fm.choose_model(scene, tolerance)
    run = fm.simulate(scene, choice.model, choice.method, choice.step)
    error = np.linalg.norm(run.tip - tips[:: round(run.time[1] / scene.output_step)], axis=1).max()
    assert error <= tolerance and choice.estimated_error <= tolerance
    assert error / 3.0 <= choice.estimated_error <= 3.0 * error
    assert set(choice.errors) == {"mesh", "modes", "foreshortening", "method", "reference"}
    assert choice.estimated_error <= 1.01 * sum(choice.errors.values())
    assert choice.runs <= MAX_RUNS and f"{choice.runs} runs" in choice.report
    assert fm.choose_model(scene, tolerance) is choice


@pytest.mark.slow
def test_a_tighter_tolerance_takes_more_elements():
    loose, tight = (fm.choose_model(SCENES["paper ff"](), tolerance).model.choice for tolerance in (2e-2, 5e-4))
    assert sum(loose.elements) < sum(tight.elements)
    assert all(few <= many for few, many in zip(loose.elements, tight.elements, strict=True))


@pytest.mark.slow
def test_the_error_of_the_reference_mesh_is_estimated_from_a_coarser_one():
    """Beside seven elements a link; the converged steps are the same for both."""
    search = MeshSearch(SCENES["paper ff"](), 2e-3)
    true = np.linalg.norm(converged("paper ff", 5) - converged("paper ff", 7), axis=1).max()
    assert true / 3.0 < search.mesh_error < 3.0 * true
    assert (
        np.linalg.norm(search.reference_tips[-1] - converged("paper ff", 5), axis=1).max()
        < 2.0 * search.time_error + 1e-6
    )


@pytest.mark.slow
def test_a_scene_with_a_mesh_keeps_it():
    scene = replace(SCENES["paper ff"](), model=fm.catalog.paper_scene("ff").model)
    choice = fm.choose_model(scene, 2e-2)
    assert choice.model.choice.elements == (2, 2, 2) and set(choice.errors) == {"model", "reference"}
    assert "large rotations" not in choice.report and choice.runs > 10


def test_rigid_links_need_no_mesh():
    scene = opened(replace(fm.catalog.paper_scene("rr"), duration=0.5))
    choice = fm.choose_model(scene, 1e-2)
    assert choice.model.n_dof == 3 and choice.errors["mesh"] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.slow
def test_an_arm_of_many_links_costs_no_more_runs():
    assert fm.choose_model(random_scene(1, 4, None, 0.4), 2e-3).runs <= MAX_RUNS


@pytest.mark.parametrize("suffix", ["json", "yaml"])
def test_a_scene_file_may_leave_its_mesh_open(tmp_path, suffix):
    scene, path = SCENES["two links"](), tmp_path / f"scene.{suffix}"
    scene.save(path)
    loaded = fm.Scene.load(path)
    assert loaded == scene and loaded.model.elements is None
    assert fm.choose_model(loaded, 2e-3).model.choice.elements


def test_a_model_without_elements_is_refused_in_one_line():
    scene = SCENES["two links"]()
    for action in (
        lambda: fm.build_model(scene.arm, None), lambda: scene_model(scene), lambda: fm.simulate(scene),
    ):  # fmt: skip
        line = refusal(action)
        assert line.startswith("elements: None is not allowed") and "choose_model" in line


def cantilever(load):
    """Deflection over length, and angle, of the tip under a load F L^2 / (E I), bent as far as it likes."""
    result = solve_bvp(
        lambda place, y: np.array([y[1], -load * np.cos(y[0]), np.sin(y[0])]),
        lambda start, end: np.array([start[0], end[1], start[2]]),
        np.linspace(0.0, 1.0, 21),
        np.zeros((3, 21)),
        tol=1e-8,
    )
    return result.y[2, -1], result.y[0, -1]


def test_the_cantilever_that_bends_far_is_that_of_the_books():
    assert cantilever(1.0) == pytest.approx((0.30172, 0.46135), abs=1e-5)  # Bisshopp and Drucker 1945


@pytest.mark.parametrize("load", [0.1, 0.2, 0.5])
def test_the_figure_of_large_rotations_is_that_of_a_cantilever_with_a_rigid_arm_beyond(load):
    arm = fm.catalog.one_link()
    model = fm.build_model(fm.Arm([arm.links[0]] * 2, [arm.joints[0]] * 2), 1)
    length, angle, columns = float(model.constants.length[0]), load / 2.0, model.elastic_columns(0)
    own = slice(0, columns.stop - columns.start)
    moves = np.vstack([model.constants.tip_rotation[own].T, model.constants.tip_translation[own].T])
    state = np.zeros((1, 2 * model.n_dof))
    state[0, columns] = np.linalg.pinv(moves) @ [0.0, 0.0, angle, 0.0, load / 3.0 * length, 0.0]
    angles, moved = mesh_search._large_rotation_error(model, state, 0.0)
    deflection, turn = cantilever(load)
    assert angles == pytest.approx([angle, 0.0], abs=1e-9)
    beyond = float(model.constants.length[1])
    assert moved == pytest.approx((load / 3.0 - deflection) * length + (angle - turn) * beyond, rel=0.1)
    assert mesh_search._large_rotation_error(model, state, 10.0)[1] > moved


def runs_ahead(angle):
    """The part of a cycle by which each cycle of a mass on a weightless cantilever is ahead of the linear one.

    The mass vibrates as far as a force goes that turns the tip by an angle (rad) in linear theory, under the force of
    the elastica at each deflection, three times it in linear theory; a quarter of a period is an integral.
    """
    loads = np.linspace(0.0, 2.0 * angle, 6)[1:]
    bent = np.array([cantilever(load)[0] for load in loads])
    powers = np.array([1, 3, 5])
    force = np.linalg.lstsq(bent[:, None] ** powers, loads, rcond=None)[0]
    energy = lambda place: force @ (place ** (powers + 1) / (powers + 1))  # noqa: E731
    most, whole = bent[-1], energy(bent[-1])

    def slowness(phase):
        place = most * np.sin(phase)
        return most * np.cos(phase) / np.sqrt(2.0 * (whole - energy(place)))

    return np.pi / 2.0 / np.sqrt(3.0) / quad(slowness, 0.0, np.pi / 2.0)[0] - 1.0


def test_a_vibration_that_bends_far_runs_ahead_as_the_elastica_says():
    """Its tip is ahead by as much of its largest speed, that of its deflection, 2/3 of angle and length."""
    angle, cycles, arm = 0.1, 2.0, fm.catalog.one_link()
    model, length = fm.build_model(arm, 1), arm.links[0].length
    moves = np.vstack([model.constants.tip_rotation.T, model.constants.tip_translation.T])
    state = np.zeros((1, 2 * model.n_dof))
    state[0, model.elastic_columns(0)] = np.linalg.pinv(moves) @ [0.0, 0.0, angle, 0.0, angle * length / 1.5, 0.0]
    moved, still = (mesh_search._large_rotation_error(model, state, many)[1] for many in (cycles, 0.0))
    expected = 2.0 * np.pi * cycles * runs_ahead(angle) * angle * length / 1.5
    assert moved - still == pytest.approx(expected, rel=0.03)
