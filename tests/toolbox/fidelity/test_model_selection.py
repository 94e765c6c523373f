"""Fidelity: what is chosen meets its tolerance, knows its error and says what it left out."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eigh

import flexman_gym as fm
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.model.assembled_modes import assembled_modes
from flexman_gym.model.dynamics import stiffness_matrix
from flexman_gym.simulation.methods import METHODS
from flexman_gym.simulation.stability import NEGLIGIBLE_GROWTH, remaining_amplitude, spectral_radii, stability_limit
from flexman_gym.toolbox.fidelity.model_search import CandidateRun, ModelSearch
from flexman_gym.toolbox.fidelity.model_selection import REPORTED_GROWTH

from oracles.chains import random_scene
from oracles.files import REFERENCE

pytestmark = pytest.mark.filterwarnings("ignore:Link.second_moment_y:UserWarning")
FIXED = [name for name, method in METHODS.items() if not method.adaptive]


def one_link():
    """A thin link on a hub, pushed for half a second."""
    arm = fm.catalog.one_link(rotor_inertia=0.1)
    torque, start = fm.ConstantTorque([0.5]), fm.Initial([0.0], [0.0])
    return fm.Scene(arm, fm.ModelChoice(True, 2), torque, start, 0.5, 0.01)


SCENES = {
    "paper ff": lambda: replace(fm.catalog.paper_scene("ff"), duration=0.5),
    "paper fr": lambda: replace(fm.catalog.paper_scene("fr"), duration=0.5),
    "gravity and payload": lambda: replace(fm.Scene.load(REFERENCE / "gravity_payload_ff.json"), duration=0.5),
    "two links": lambda: random_scene(3, 2, 1, 0.6),
    "one link": one_link,
}


def truth(scene):
    """The finest model of the scene by the reference method, independently of the choice."""
    model = fm.build_model(scene.arm, **(vars(scene.model) | {"modes": None, "stiffening": True}))
    return fm.simulate(scene, model, "dop853", rtol=1e-8, atol=1e-11).tip


def true_error(scene, choice, tips):
    """Largest distance of the tip, by an independent run of the choice."""
    run = fm.simulate(scene, choice.model, choice.method, choice.step)
    assert run.status == "ok"
    every = round(run.time[1] / scene.output_step)
    return np.linalg.norm(run.tip - tips[::every], axis=1).max()


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_a_choice_meets_its_tolerance_and_knows_its_error(name):
    scene = SCENES[name]()
    tips = truth(scene)
    size = np.linalg.norm(tips - tips[0], axis=1).max()
    assert size > 0.01, "the arm moves"
    for tolerance in (1e-2, 2e-3):
        choice = fm.choose_model(scene, tolerance)
        error = true_error(scene, choice, tips)
        assert error <= tolerance and choice.estimated_error <= tolerance
        assert error / 5 <= choice.estimated_error <= 5 * max(error, 1e-12)
        assert choice.model.n_dof <= fm.build_model(scene.arm, scene.model.elements).n_dof
        assert fm.choose_model(scene, tolerance) is choice


@pytest.mark.slow
def test_a_loose_tolerance_drops_more_and_the_report_says_how():
    scene = SCENES["paper ff"]()
    loose, tight = fm.choose_model(scene, 0.1), fm.choose_model(scene, 2e-3)
    assert loose.model.n_dof < tight.model.n_dof < 42
    for word in ("of 42 coordinates", "Hz", "limit of the step", "mode 1", "over 10 s", "computing time"):
        assert word in tight.report, word


def choose_cheapest(monkeypatch, scene, tolerance, cost, longest_step=None):
    """Return the choice where runs cost what a function of candidate and method returns, and all candidates."""
    tried = []

    def run_timed(search, candidate, method, step):
        tried.append(candidate)
        run = search.run(candidate, method, step)
        return CandidateRun(candidate, method, step or 0.0, np.nan, cost(candidate, method), 1), run

    monkeypatch.setattr(ModelSearch, "run_timed", run_timed)
    return fm.choose_model(scene, tolerance, longest_step), tried


@pytest.mark.parametrize("parts", [("springs",), ("stiffening",), ("springs", "stiffening"), ()])
def test_a_loose_tolerance_allows_what_has_no_foreshortening_and_texts_say_what_is_gone(parts, monkeypatch):
    """Which of the models that are good is quickest is a matter of the clock; which are good is none."""
    scene = replace(SCENES["paper ff"](), duration=0.48)
    choice, tried = choose_cheapest(
        monkeypatch, scene, 0.1 + 1e-6 * len("".join(parts)),
        lambda candidate, _: 1.0 if all(getattr(candidate, part) for part in parts) else 2.0,
    )  # fmt: skip
    assert any(not each.stiffening for each in tried) and any(not each.springs for each in tried)
    said, model = "\n".join(choice.dropped), choice.model
    assert ("foreshortening" in said) == (not model.choice.stiffening)
    assert ("springs of the joints" in said) == (model.n_dof == model.n_joints + sum(map(_modes, model.bases)))
    full = fm.build_model(scene.arm, scene.model.elements)
    for i, (kept, basis) in enumerate(zip(model.bases, full.bases, strict=True)):
        assert (f"link {i + 1}, component modes" in said) == (_modes(kept) < _modes(basis))
    assert all(" m" in text for text in choice.dropped)


def _modes(basis):
    return basis.shape[1]


@pytest.mark.parametrize(("dearer", "coordinates"), [(1.2, 3), (1.3, 6)])
def test_of_models_that_cost_alike_the_smallest_is_chosen(monkeypatch, dearer, coordinates):
    scene, tolerance = SCENES["paper ff"](), 0.1 + 1e-9 * dearer  # choices are cached by scene and tolerance
    choice, _ = choose_cheapest(monkeypatch, scene, tolerance, lambda each, _: 1.0 if each.springs else dearer)
    assert choice.model.n_dof == coordinates


def _numbers(model):
    """Return the numbers of the retained component modes of each link."""
    return [set(range(modes)) if isinstance(modes, int) else set(modes) for modes in model.choice.modes]


def _count(candidate, _):
    return 1.0 + sum(map(len, candidate.modes))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "tolerance"), [("paper fr", 1e-2), ("paper fr", 3e-3), ("gravity and payload", 1e-2)])
def test_single_modes_are_omitted_that_a_selection_in_the_order_of_displacements_retains(name, tolerance, monkeypatch):
    """The error remains estimated, and the report has the effect of each retained mode."""
    scene, tips = SCENES[name](), truth(SCENES[name]())
    after, _ = choose_cheapest(monkeypatch, scene, (1.0 + 1e-7) * tolerance, _count)
    monkeypatch.setattr(ModelSearch, "single_errors", lambda *_: {})
    before, _ = choose_cheapest(monkeypatch, scene, (1.0 + 2e-7) * tolerance, _count)
    assert (after.method, after.step) == (before.method, before.step) and 0 < after.runs - before.runs <= 34
    retained, modes = _numbers(after.model), _numbers(before.model)
    assert retained != modes and all(few <= many for few, many in zip(retained, modes, strict=True))
    error = true_error(scene, after, tips)
    assert error <= 0.8 * tolerance and error / 1.3 <= after.estimated_error <= 1.3 * error
    measured = {}
    for i, numbers in enumerate(retained):
        lines = [line for line in after.report.splitlines() if line.startswith(f"link {i + 1}, ")]
        texts = lines[0].split("estimated") if lines else [""]
        effects = [{int(mode): float(size) for mode, size in re.findall(r"(\d+): ([\d.e-]+)", text)} for text in texts]
        assert len(lines) == bool(numbers) and set().union(*effects) == numbers
        assert sum(map(len, effects)) == len(numbers), "each mode once"
        measured |= {(i, mode): size for mode, size in effects[0].items() if "tip error" in texts[0]}
    link, mode = min(measured, key=measured.get)
    modes[link] -= {mode}
    options = vars(before.model.choice) | {"modes": tuple(tuple(sorted(each)) for each in modes)}
    run = fm.simulate(scene, fm.build_model(scene.arm, **options), "dop853", rtol=1e-8, atol=1e-11)
    assert np.linalg.norm(run.tip - tips, axis=1).max() == pytest.approx(measured[link, mode], rel=0.3)


@pytest.mark.slow
def test_single_modes_are_retained_where_the_smaller_model_costs_more(monkeypatch):
    scene = SCENES["gravity and payload"]()
    with monkeypatch.context() as patch:
        patch.setattr(ModelSearch, "single_errors", lambda *_: {})
        before, tried = choose_cheapest(patch, scene, 1e-2 + 3e-9, _count)
    dearer, _ = choose_cheapest(
        monkeypatch, scene, 1e-2 + 4e-9, lambda each, _: _count(each, _) if each in tried else 100.0
    )
    assert _numbers(dearer.model) == _numbers(before.model) and "tip error (m) without mode" in dearer.report


@pytest.mark.parametrize("method", ["extrapolated_euler_3", "midpoint_2"])
def test_a_report_speaks_of_every_method_that_lets_a_mode_grow(method, monkeypatch):
    monkeypatch.setattr(ModelSearch, "methods", (method,))
    scene = replace(SCENES["two links"](), duration=0.4)
    choice, _ = choose_cheapest(monkeypatch, scene, 0.01 + 1e-9 * len(method), lambda *_: 1.0, 0.02)
    own = fm.frequencies(choice.model, [0.0, 0.0])[2:]
    grown = max(remaining_amplitude(METHODS[method], choice.step, frequency) for frequency in own) - 1.0
    assert choice.method == method
    assert ("grow by" in choice.report) == (grown > REPORTED_GROWTH) == (method != "midpoint_2")


def test_what_a_scene_declares_rigid_stays_rigid():
    scene = replace(fm.catalog.paper_scene("rr"), duration=0.5)
    choice = fm.choose_model(scene, 1e-2)
    assert choice.model.n_dof == 3 and choice.dropped == ()


def test_a_tolerance_below_what_can_be_reached_is_refused_with_what_was():
    with pytest.raises(ValueError, match=r"^tolerance: 1e-15 is not allowed; give at least .* m"):
        fm.choose_model(one_link(), 1e-15)


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        (("scene", 1e-3), "scene"),
        ((None, 1e-3), "scene"),
        ((one_link(), 0.0), "tolerance"),
        ((one_link(), -1.0), "tolerance"),
        ((one_link(), np.nan), "tolerance"),
        ((one_link(), None), "tolerance"),
        ((one_link(), 1e-3, 0.0), "longest_step"),
    ],
)
def test_bad_input_is_refused_in_one_line(arguments, field):
    with pytest.raises(ValueError) as error:
        fm.choose_model(*arguments)
    assert str(error.value).startswith(f"{field}: ") and "give " in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize("name", FIXED)
def test_the_amplification_is_what_a_vibration_does(name):
    """A free vibration of a spring between two rotors: its energy falls by the square of the amplification a step."""
    arm = fm.catalog.one_link(rotor_inertia=0.3, joint_stiffness=50.0)
    model = fm.build_model(arm, flexible_links=False)
    frequency = fm.frequencies(model)[-1]
    step = 0.1 / frequency
    simulator = fm.Simulator(model, name, step, 40 * step)
    inertia = fm.mass_matrix(model, np.zeros(4))
    simulator.reset(state=[0.2 / inertia[0, 0], -0.2 / inertia[1, 1], 0.0, 0.0])
    before = simulator.elastic_energy
    for _ in range(5):
        assert simulator.step([0.0]) == "ok"
    kept = spectral_radii(METHODS[name], 2 * np.pi * frequency * step) ** 400
    assert kept == pytest.approx(remaining_amplitude(METHODS[name], step, frequency, 200 * step) ** 2)
    # Semi-implicit Euler and the corrected midpoint rule keep a modified energy; that of the latter differs by up to
    # (omega h)^2 / 12, see tests/simulation/test_corrected_midpoint.py.
    waver = (2 * np.pi * frequency * step) ** 2 / 12 if getattr(METHODS[name], "correction", 0.0) else 0.02
    if name != "semi_implicit_euler":
        assert simulator.energy / before == pytest.approx(kept, rel=waver)


def test_explicit_limits_are_those_of_the_books():
    assert stability_limit(METHODS["rk4"], NEGLIGIBLE_GROWTH) == pytest.approx(np.sqrt(8.0), abs=0.01)
    assert stability_limit(METHODS["semi_implicit_euler"], NEGLIGIBLE_GROWTH) == pytest.approx(2.0, abs=0.01)
    assert stability_limit(METHODS["ros2"], NEGLIGIBLE_GROWTH) == np.inf
    with pytest.raises(ValueError, match=r"^method: dop853 chooses its steps"):
        spectral_radii(METHODS["dop853"], 0.1)


def test_the_default_environment_has_the_slow_vibrations_of_the_full_arm():
    model = FlexManEnv().simulator.model
    full = fm.build_model(model.arm)
    for pose in ((0.0, 0.0, 0.0), (0.3, 0.8, -0.8), (0.0, 0.4, 1.2), (0.3, 0.8, 0.8)):
        assert fm.frequencies(model, pose)[3:8] == pytest.approx(fm.frequencies(full, pose)[3:8], rel=7e-3)
    assert model.n_elastic <= 16
    assert assembled_modes(fm.catalog.planar_2r(), 1)[0]


@pytest.mark.parametrize("number", range(5))
def test_the_default_environment_keeps_an_undamped_vibration_for_10_s(number):
    env = FlexManEnv(arm=fm.catalog.paper_rrr(rotor_inertia=10.0, torque_limit=400.0))
    simulator, model = env.simulator, env.simulator.model
    squares, shapes = eigh(stiffness_matrix(model), fm.mass_matrix(model, np.zeros(2 * model.n_dof)))
    simulator.reset(state=[*(1e-3 * shapes[:, 3 + number]), *np.zeros(model.n_dof)])
    energies = []
    for _ in range(500):
        assert simulator.step(np.zeros(3)) == "ok"
        energies.append(simulator.energy)
    kept = np.sqrt(np.mean(energies[250:]) / np.mean(energies[:250]))  # the energy of the corrected rule wavers
    frequency = np.sqrt(squares[3 + number]) / (2 * np.pi)
    assert kept == pytest.approx(remaining_amplitude(simulator.method, 0.02 / simulator.substeps, frequency), abs=1e-3)
    assert kept == pytest.approx(1.0, abs=1e-4)
    assert np.ptp(energies) <= 1.05 * (2 * np.pi * frequency * 0.02 / simulator.substeps) ** 2 / 6 * np.max(energies)


def test_an_environment_chooses_its_fidelity():
    env = FlexManEnv(arm=fm.catalog.planar_2r(joint_stiffness=50.0), torque_limit=0.2, fidelity="auto", tolerance=0.01)
    assert env.choice is not None and env.choice.estimated_error <= 0.01
    assert env.simulator.model is env.choice.model and env.simulator.method.name == env.choice.method
    assert env.simulator.control_period / env.choice.step == pytest.approx(env.simulator.substeps)
    env.reset(seed=0)
    assert env.step(np.zeros(2))[4]["status"] == "ok"


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({"fidelity": "auto"}, "tolerance"),
        ({"fidelity": "best"}, "fidelity"),
        ({"tolerance": 0.01}, "tolerance"),
        ({"fidelity": "auto", "tolerance": -1.0}, "tolerance"),
        ({"fidelity": "auto", "tolerance": 0.01, "modes": 4}, "modes"),
        ({"fidelity": "auto", "tolerance": 0.01, "step": 0.01}, "step"),
        ({"fidelity": "auto", "tolerance": 0.01, "method": "rk4"}, "method"),
        ({"fidelity": "auto", "tolerance": 0.01, "elements": 3}, "elements"),
        ({"modes": "all"}, "modes"),
    ],
)
def test_a_contradictory_fidelity_is_refused(arguments, field):
    with pytest.raises(ValueError, match=f"^{field}: ") as error:
        FlexManEnv(**arguments)
    assert "\n" not in str(error.value)
