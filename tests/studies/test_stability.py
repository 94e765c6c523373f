"""Tests of predicted stability limits, and examples of failures with methods or models that avoid them."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.linalg import block_diag, eigh

import flexman_gym as fm
from flexman_gym.model.beam import build_beam
from flexman_gym.model.component_modes import LoadedModes
from flexman_gym.model.dynamics import stiffness_matrix
from flexman_gym.model.outboard_inertia import outboard_inertias
from flexman_gym.simulation.stability import amplification_factors, amplitude_range, spectral_radii, stability_limit
from studies.files import read_rows
from studies.methods import explicit_methods, fixed_step_methods, vibration_factor
from studies.stability.measure import (
    SPIN_STIFFENED,
    SPRINGS,
    StabilityRow,
    grows,
    growth_per_step,
    measured_limit,
    natural_modes,
    predicted_limit,
    select,
    small_vibration,
    spin_case,
)
from studies.stability.page import ROTORS, amplitude_bounds
from studies.stability.rows import (
    FREQUENCY,
    IN_PERIODS,
    KEPT,
    LIMIT_STUDIES,
    damping_rows,
    drift_rows,
    limit_rows,
    map_rows,
    remaining,
)

from oracles.files import ROOT


@cache
def arm_model(modes=4, **options):
    """Return the model of the paper's arm."""
    return fm.build_model(fm.catalog.paper_rrr(**options), 2, modes)


@cache
def damping(rotor_inertia, name, step):
    """Return the rows of one method and step by quantity and mode."""
    return {(row.quantity, row.parameter): row for row in damping_rows(rotor_inertia, (name,), (step,))}


# predictions


@pytest.mark.parametrize("name", ["rk4", "ros2", "extrapolated_euler_5", "semi_implicit_euler", "generalised_alpha"])
def test_many_angles_at_once_have_the_factors_of_each_alone(name):
    method, angles = fm.METHODS[name], np.geomspace(1e-2, 1e2, 12).reshape(3, 4)
    alone = [[amplification_factors(method, angle) for angle in row] for row in angles]
    assert amplification_factors(method, angles) == pytest.approx(np.array(alone), rel=1e-12)


def test_stability_limits_are_those_of_the_textbooks():
    assert stability_limit(fm.METHODS["semi_implicit_euler"]) == pytest.approx(2.0)
    assert stability_limit(fm.METHODS["rk4"]) == pytest.approx(math.sqrt(8.0))
    assert stability_limit(fm.METHODS["ros2"]) == stability_limit(fm.METHODS["implicit_midpoint"]) == math.inf


@pytest.mark.parametrize("name", fixed_step_methods())
def test_the_vibration_factor_is_exact_to_the_order_of_the_method(name):
    method = fm.METHODS[name]
    # linear vibrations need one iteration less; the correction of the midpoint rule removes its error of order two
    order = 4 if name == "gauss_2" or getattr(method, "correction", 0.0) else method.order
    largest = 0.5 if method.order > 5 else 0.1  # else rounding is all that one sees
    errors = [abs(vibration_factor(method, angle) - np.exp(1j * angle)) for angle in (largest, 0.5 * largest)]
    if getattr(method, "semi_implicit", False):  # a symplectic method of order 1 turns by an angle of order 2
        assert errors[0] / errors[1] == pytest.approx(8.0, rel=0.05)
    else:
        assert math.log2(errors[0] / errors[1]) == pytest.approx(order + 1, abs=0.3)


@pytest.mark.slow
@pytest.mark.parametrize("study", LIMIT_STUDIES)
def test_predicted_limits_are_right_to_5_percent(study):
    rows = list(limit_rows(study, quick=True))
    assert len(rows) >= 3
    assert {row.verdict for row in rows} == {"ok"}


def test_a_limit_outside_the_bracket_is_not_a_number():
    model, method = arm_model(2), fm.METHODS["rk4"]
    assert math.isnan(measured_limit(model, method, 3.0 * predicted_limit(model, method)))


@pytest.mark.parametrize("name", ["ros2", "extrapolated_euler_3", "implicit_midpoint", "generalised_alpha"])
def test_measured_damping_and_frequency_are_those_of_the_amplification_factor(name):
    for row in damping(10.0, name, 0.005).values():
        if row.quantity in (KEPT, FREQUENCY):
            assert row.value == pytest.approx(row.expected, rel=1e-4), row


# the gallery of failures


@pytest.mark.parametrize("modes", [2, 4, None])
@pytest.mark.parametrize("name", ["semi_implicit_euler", "rk4"])
def test_an_explicit_method_past_its_limit_diverges_and_ros2_survives(name, modes):
    model, method = arm_model(modes), fm.METHODS[name]
    start, limit = small_vibration(model), predicted_limit(model, method)
    assert not grows(model, method, 0.95 * limit, start)
    assert grows(model, method, 1.05 * limit, start)
    assert not grows(model, fm.METHODS["ros2"], 20.0 * limit, start)


def extrapolated_midpoint(model, step, duration, start):
    """Return the time (s) of divergence of the linearly implicit midpoint rule with extrapolated speeds, or inf."""
    d, stiffness = model.n_dof, stiffness_matrix(model)
    x, v = np.split(start, 2)
    before = v
    for i in range(round(duration / step)):
        speed = 1.5 * v - 0.5 * before
        middle = np.r_[x + 0.5 * step * speed, speed]
        mass = fm.mass_matrix(model, middle)
        force = mass @ fm.acceleration(model, middle, np.zeros(3)) + stiffness @ middle[:d]
        rate = np.linalg.solve(mass + 0.25 * step**2 * stiffness, force - stiffness @ (x + 0.5 * step * v))
        before, x, v = v, x + step * v + 0.5 * step**2 * rate, v + step * rate
        if not np.abs(np.r_[x, v]).max() < 1e3:
            return i * step
    return math.inf


def test_midpoint_with_extrapolated_speeds_diverges_and_damping_of_stiff_modes_survives():
    """A-stable for vibrations alone, its stiff modes alternate in sign, and speed-dependent forces feed on that."""
    model, step, duration = arm_model(4), 0.02, 6.0
    start, d = small_vibration(model, [1, 2, 3], energy=5.0), model.n_dof
    start[d : d + 3] = start[d + model.motor_columns] = (3.0, 3.0, -6.0)
    assert extrapolated_midpoint(model, step, duration, start) < duration
    for name in ("ros2", "implicit_midpoint"):
        simulator = fm.Simulator(model, name, step, duration)
        simulator.reset(state=start)
        first = simulator.energy
        assert simulator.step(np.zeros(3)) == "ok"
        assert simulator.energy == pytest.approx(first, rel=0.05)


def test_extrapolation_of_ros2_grows_where_ros2_does_not():
    """Richardson's (4 R(z/2)^2 - R(z)) / 3 is of order 3 and no longer A-stable."""
    model, ros2 = arm_model(2), fm.METHODS["ros2"]

    def factor(angle):
        return (4.0 * vibration_factor(ros2, angle / 2.0) ** 2 - vibration_factor(ros2, angle)) / 3.0

    angles = np.arange(1, 2000) * 0.01
    worst = max(angles, key=lambda angle: abs(factor(angle)))
    assert abs(factor(worst)) > 1.05
    step = worst / natural_modes(model)[0][-1]
    whole, halves = (fm.Simulator(model, "ros2", step / parts, step) for parts in (1, 2))
    start = small_vibration(model, [model.n_dof - 3])
    state, count = start, 100
    for _ in range(count):
        for simulator in (whole, halves):
            simulator.reset(state=state)
            simulator.step(np.zeros(3))
        state = (4.0 * halves.state - whole.state) / 3.0
    grown = np.linalg.norm(state[model.n_dof :]) / np.linalg.norm(start[: model.n_dof])
    assert grown > 1e2
    assert not grows(model, ros2, step, start)


def test_extrapolated_euler_grows_slowly_where_the_midpoint_rule_keeps_the_vibration():
    model, steps, angle = arm_model(2), 5000, 0.642
    step = angle / natural_modes(model)[0][-1]
    ratios = {}
    for name in ("extrapolated_euler_3", "implicit_midpoint", "ros2"):
        simulator = fm.Simulator(model, name, step, steps * step)
        simulator.reset(state=small_vibration(model, [model.n_dof - 3]))
        first = simulator.energy
        assert simulator.step(np.zeros(3)) == "ok"
        ratios[name] = math.sqrt(simulator.energy / first)
    radius = spectral_radii(fm.METHODS["extrapolated_euler_3"], angle)
    assert radius == pytest.approx(1.0016, abs=5e-5)
    assert ratios["extrapolated_euler_3"] == pytest.approx(radius**steps, rel=0.1) and radius**steps > 1e3
    assert ratios["implicit_midpoint"] == pytest.approx(1.0, abs=1e-3)
    damped = spectral_radii(fm.METHODS["ros2"], angle) ** steps
    assert ratios["ros2"] == pytest.approx(damped, rel=0.1) and damped < 0.1  # no cure for one who wants that mode


def test_strong_damping_eats_the_vibration_and_the_midpoint_rule_keeps_it():
    assert damping(1.0, "ros2", 0.02)[KEPT, 2.0].value < 0.05
    assert damping(1.0, "implicit_midpoint", 0.02)[KEPT, 2.0].value > 0.99
    assert damping(1.0, "ros2", 0.001)[KEPT, 2.0].value > 0.99  # the same method keeps it at a short step


def test_generalised_alpha_keeps_its_vibration_over_control_periods():
    rows = damping(1.0, "generalised_alpha", 0.005)
    assert rows[KEPT, 2.0].value > 0.998
    assert rows[IN_PERIODS, 2.0].value == pytest.approx(rows[KEPT, 2.0].value, abs=1e-3)


@pytest.mark.parametrize("name", ["rk4", "ros2", "implicit_midpoint"])
def test_a_linear_frame_fails_past_its_spin_limit_and_stiffening_survives(name):
    limit = 2.0 * np.pi * fm.frequencies(spin_case(0.0, False).model, lock_joints=True)[0]

    def deflection(rate, stiffening):
        case = spin_case(rate, stiffening)
        simulator = fm.Simulator(case.model, name, 0.0025, 0.02, prescribed=(0,))
        simulator.reset(state=case.scene.initial.state)
        done = all(simulator.step([0.0]) == "ok" for _ in range(100))
        return float(np.linalg.norm(simulator.deflection[1:])) if done else math.inf

    assert deflection(1.3 * limit, False) > 1.0
    assert deflection(0.7 * limit, False) < 0.05
    assert deflection(1.3 * limit, True) < 0.02


def test_clamped_modes_without_torsion_miss_centimetres_and_loaded_modes_do_not():
    """Four modes a link of the full model, 1 s of linear motion under 400 N m a joint."""
    arm, full = fm.catalog.paper_rrr(), arm_model(None)
    d, n = full.n_dof, full.n_joints
    mass, stiffness = fm.mass_matrix(full, full.initial_state(np.zeros(n))), stiffness_matrix(full)
    observed, push = fm.linearize(full).C[:, :d], np.zeros(d)
    push[full.motor_columns] = 400.0
    beams = tuple(build_beam(link, 2) for link in arm.links)
    outboard = outboard_inertias(arm, beams)

    def motion(kept):
        """Return tip displacement (3,) and lowest frequency (Hz) in the span of given columns (d, k)."""
        squares, shapes = eigh(kept.T @ stiffness @ kept, kept.T @ mass @ kept)
        omegas = np.sqrt(squares[n:])
        amounts = np.r_[np.full(n, 0.5), (1.0 - np.cos(omegas)) / squares[n:]]
        return observed @ kept @ shapes @ (amounts * (shapes.T @ kept.T @ push)), omegas[0] / (2.0 * np.pi)

    def basis(carried):
        modes = [LoadedModes.of(beam, inertia)[1][:, :4] for beam, inertia in zip(beams, carried, strict=True)]
        return block_diag(np.eye(2 * n), *modes)

    tip, frequency = motion(np.eye(d))
    bare_tip, bare_frequency = motion(basis(np.zeros_like(outboard)))
    tip_of_loaded, loaded_frequency = motion(basis(outboard))
    assert bare_frequency > 1.1 * frequency and loaded_frequency == pytest.approx(frequency, rel=1e-3)
    assert np.linalg.norm(bare_tip - tip) > 0.02 and np.linalg.norm(tip_of_loaded - tip) < 0.002


@pytest.mark.slow
def test_a_tiny_rotor_on_a_stiff_spring_stops_an_explicit_method_and_ros2_is_right():
    model, step = arm_model(2, rotor_inertia=1e-6), 0.00025
    scene = replace(fm.catalog.paper_scene(), duration=0.2, output_step=0.02)
    reference = fm.simulate(scene, model, "dop853", rtol=1e-8, atol=1e-10)
    assert reference.status == "ok"
    for name in explicit_methods():
        assert fm.simulate(scene, model, name, step).status == "diverged"
    run = fm.simulate(scene, model, "ros2", step)
    assert run.status == "ok"
    assert np.linalg.norm(run.tip - reference.tip, axis=1).max() < 1e-3


# rows, charts and page


@pytest.mark.slow
@pytest.mark.parametrize("method", ["midpoint_corrected_2", "midpoint_corrected_3"])
def test_measured_amplitudes_of_the_corrected_midpoint_rule_are_within_the_bounds_of_theory(method):
    """Rows of the modes of an arm; they would leave the bounds within 10 s if the vibrations decayed or grew."""
    rows = read_rows(ROOT / "docs" / "evidence" / "stability.csv", StabilityRow)
    kept = select(rows, study=ROTORS, quantity=KEPT, method=method)
    assert len(kept) >= 12
    for row in kept:
        fine = select(rows, study=ROTORS, quantity=FREQUENCY, method="gauss_3", parameter=row.parameter)
        frequency = min(fine, key=lambda each: each.step).value
        low, high = amplitude_range(fm.METHODS[method], 2.0 * np.pi * frequency * row.step)
        assert abs(row.value - 1.0) <= 0.05 * (high - low) + 1e-3, "neither decay nor growth over windows of a second"
    assert amplitude_bounds(rows, 0.02)[1] > 1.05


@pytest.mark.slow
def test_maps_show_failures_and_survivors():
    rows = list(map_rows(SPRINGS, quick=True))
    assert {row.verdict for row in rows} >= {"ok", "inaccurate", "diverged"}
    assert {row.verdict for row in select(rows, method="rk4", parameter=1e6)} == {"diverged"}
    assert "diverged" not in {row.verdict for row in select(rows, method="ros2")}
    assert {row.verdict for row in select(map_rows(SPIN_STIFFENED, quick=True), method="ros2")} == {"ok"}


def test_a_long_run_reports_its_energy():
    rows = [row for row in drift_rows(1000) if row.method in ("rk4", "implicit_midpoint")]
    assert {row.parameter for row in rows} == {100.0, 1000.0}
    assert all(row.value < 1e-4 and row.verdict == "ok" for row in rows)


def test_the_growth_that_a_measurement_tolerates_is_small():
    assert 0.0 < growth_per_step() < 2e-3


@pytest.mark.parametrize("decay", [0.0, 0.1, 0.5])
@pytest.mark.parametrize("wobble", [0.0, 0.07])
def test_the_amplitude_left_is_that_of_the_decay_without_its_oscillation(decay, wobble):
    """After ten seconds a decay leaves its exponential; an oscillation about it counts as nothing."""
    times = 0.02 * np.arange(501)
    amplitudes = np.exp(-decay * times) * (1.0 + wobble * np.sin(40.0 * times))
    assert remaining(amplitudes) == pytest.approx(math.exp(-10.0 * decay), rel=5e-3 if wobble else 1e-9)
