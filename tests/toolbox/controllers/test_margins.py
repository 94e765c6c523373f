"""Margins: closed forms of a single motor, the frequency response of an arm, and those of every named environment."""

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.model.dynamics import mass_matrix
from flexman_gym.simulation.physical_parameters import varied_model
from flexman_gym.toolbox.controllers.margins import (
    GAIN_FACTORS,
    MIN_MARGINS,
    PHASE_SHIFTS,
    Margins,
    has_margins,
    margins,
    sampled_loops,
)
from flexman_gym.toolbox.controllers.pd_design import POSTURES, PDDesign
from studies.servos.measure import AT_REST, FrictionCase, friction_rows, remaining_vibration, smoothed_loop

PERIOD = 0.01
STEP, DEGREES = GAIN_FACTORS[1] / GAIN_FACTORS[0], PHASE_SHIFTS[1]


def rigid():
    """A rigid link on a rigid joint, and its inertia about the motor."""
    model = fm.build_model(fm.catalog.one_link(rotor_inertia=0.1), flexible_links=False, flexible_joints=False)
    return model, mass_matrix(model, np.zeros(2 * model.n_dof))[0, 0]


@pytest.mark.parametrize("part", [0.3, 0.7, 1.2, 1.7])
def test_a_motor_that_is_damped_has_the_margins_of_an_integrator(part):
    """Rates follow r' = r - part r: stable to a factor 2 / part, and to a phase of 90 degrees - asin(part / 2)."""
    model, inertia = rigid()
    result = margins([sampled_loops(model, [0.3], PERIOD)[0]], [1e-6], [part * inertia / PERIOD])
    assert result.gain <= 2.0 / part < result.gain * STEP
    assert result.phase <= 90.0 - np.degrees(np.arcsin(part / 2.0)) < result.phase + DEGREES


@pytest.mark.parametrize("late", [1, 2, 4])
def test_a_late_motor_is_stable_up_to_the_limit_of_levin_and_may(late):
    """Theoretical Population Biology 9, 1976, 178: 2 sin(pi / (4 k + 2))."""
    model, inertia = rigid()
    part = 0.3 * 2.0 * np.sin(np.pi / (4 * late + 2))
    result = margins([sampled_loops(model, [0.0], PERIOD, late)[0]], [1e-9], [part * inertia / PERIOD])
    assert result.gain <= 1.0 / 0.3 < result.gain * STEP


def test_an_unstable_loop_has_no_margins():
    model, inertia = rigid()
    loop = sampled_loops(model, [0.0], PERIOD)[0]
    assert margins([loop], [1.0], [2.1 * inertia / PERIOD]) == Margins(1.0, 0.0)
    assert not has_margins([loop], [1.0], [2.1 * inertia / PERIOD], Margins(1.0, 0.0))


def nearest(locus):
    """The least factor and phase (degrees) that lead a frequency response, or an eigenvalue of one, to -1."""
    size, turn = np.abs(locus), np.degrees(np.abs(np.angle(-locus)))
    steady = np.abs(np.diff(locus)) < 0.1 * size[:-1]  # where eigenvalues do not change places
    crossing = np.flatnonzero(np.diff(locus.imag > 0.0) & (locus.real[:-1] < 0.0) & steady)
    factors = 1.0 / size[[*crossing, *([-1] if locus.real[-1] < 0.0 else [])]]
    return factors[factors > 1.0].min(initial=np.inf), turn[:-1][np.diff(size > 1.0)].min(initial=np.inf)


def test_margins_are_those_of_the_loop_that_has_the_least():
    model, inertia = rigid()
    damped, late = sampled_loops(model, [0.0], PERIOD)[0], sampled_loops(model, [0.0], PERIOD, 3)[0]
    gains = [1e-6], [0.3 * inertia / PERIOD]
    assert margins([damped, late], *gains) == margins([late], *gains)
    assert has_margins([damped], *gains, Margins(2.0, 30.0)) and not has_margins([late], *gains, Margins(2.0, 30.0))
    assert not has_margins([damped, late], *gains, Margins(2.0, 30.0))


@pytest.mark.parametrize("late", [0, 1])
def test_margins_are_those_of_the_frequency_response(late):
    """Of one motor's loop while the other stays closed, and of the eigenvalues of both loops together."""
    setup = Configuration.from_keywords({"name": "FlexPlanar-v0"})
    loop = sampled_loops(resolve_fidelity(setup).model, [0.4, -0.7], setup.control_period, late)[0]
    stiffness, damping = np.array([20.0, 6.0]), np.array([3.0, 0.5])
    gain = np.zeros(loop.inputs.T.shape)
    gain[np.arange(2), loop.motors], gain[np.arange(2), loop.rates] = stiffness, damping
    around, loci = np.exp(1j * np.linspace(1e-4, np.pi, 40001)), []
    for opened in ([0], [1], [0, 1]):
        closed = np.delete(np.arange(2), opened)
        values, left = np.linalg.eig(loop.transition - loop.inputs[:, closed] @ gain[closed])
        inner = np.linalg.solve(left, loop.inputs[:, opened])
        response = np.einsum("ik,wk,kj->wij", gain[opened] @ left, 1.0 / (around[:, None] - values), inner)
        each = np.linalg.eigvals(response)
        loci += list(np.take_along_axis(each, np.abs(each).argsort(axis=1), axis=1).T)
    factor, phase = np.min([nearest(locus) for locus in loci], axis=0)
    result = margins([loop], stiffness, damping)
    assert result.gain <= factor * 1.001 and factor < result.gain * STEP * 1.001
    assert result.phase <= phase + 0.1 and phase < result.phase + DEGREES + 0.1


def test_torques_on_their_way_arrive_in_their_turn():
    model = resolve_fidelity(Configuration.from_keywords({"name": "FlexPlanar-v0"})).model
    now, late = (sampled_loops(model, [0.2, 0.1], 0.01, delay)[0] for delay in (0, 3))
    random, size = np.random.default_rng(0), len(now.transition)
    state, longer = np.zeros(size), np.zeros(len(late.transition))
    torques = random.standard_normal((9, 2))
    for period, torque in enumerate(torques):
        longer = late.transition @ longer + late.inputs @ torque
        state = now.transition @ state + now.inputs @ (torques[period - 3] if period >= 3 else np.zeros(2))
        assert longer[:size] == pytest.approx(state, abs=1e-12)


DELAYED = [f"{name}/{each}" for name in ("FlexRRR-v0", "FlexPlanar-v0", "FlexRRR-Gravity-v0")
           for each in ("delay", "friction", "unknown", "unknown-lab")]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted({*NAMED_ENVIRONMENTS, *DELAYED} - {"FlexGantry-v0"}))  # no motor
def test_the_pd_of_every_environment_has_a_gain_margin_of_two_and_a_phase_margin_of_thirty_degrees(name, monkeypatch):
    """At the goals of its first four episodes, with its delay; of random delays up to two periods no gains have it."""
    factors, shifts = GAIN_FACTORS[GAIN_FACTORS < 2.01], PHASE_SHIFTS[PHASE_SHIFTS <= 30.0]  # no more
    monkeypatch.setattr("flexman_gym.toolbox.controllers.margins.GAIN_FACTORS", factors)
    monkeypatch.setattr("flexman_gym.toolbox.controllers.margins.PHASE_SHIFTS", shifts)
    environment = Configuration.find(name)
    gains = environment.pd_gains
    loops = [loop for number, loop in enumerate(PDDesign(environment).loops) if number % POSTURES < 4]
    reached = margins(loops, gains["stiffness"], gains["damping"])
    assert reached.gain >= MIN_MARGINS.gain * (1.0 - 1e-9) and reached.phase >= MIN_MARGINS.phase


RUBBING = (1.2, 0.4)  # N m


def two_links(coulomb=(0.0, 0.0)):
    """Two strips on elastic joints, with Coulomb friction (N m) of the motors."""
    joints = [fm.Joint((0.0, 0.0, 1.0), inertia, stiffness, coulomb_friction=each)
              for inertia, stiffness, each in zip((0.04, 0.01), (300.0, 100.0), coulomb, strict=True)]  # fmt: skip
    links = [fm.Link.strip(0.5, 0.05, 0.004), fm.Link.strip(0.5, 0.05, 0.003)]
    return fm.build_model(fm.Arm(links, joints, fm.Payload(0.3), modal_damping_ratio=0.01), elements=1)


def test_friction_makes_no_unstable_loop_stable():
    """With the slope of the smoothed friction at rest these gains have a gain margin of 10; the arm runs away."""
    gains = np.array([100.0, 30.0]), np.array([10.0, 3.0])
    for coulomb in ((0.0, 0.0), RUBBING):
        model = two_links(coulomb)
        assert margins(sampled_loops(model, [0.0, 0.3], 0.005, 1), *gains)[:2] == (1.0, 0.0)
    case = FrictionCase(model, 0.005, 1, *gains, np.array([0.0, 0.3]), np.array([0.1, -0.1]))
    assert remaining_vibration(case) > 0.5
    assert smoothed_loop(case).spectral_radius(*gains) < 1.0, "what the slope at rest would say"


def test_a_loop_with_a_stuck_motor_is_that_of_an_arm_whose_motor_has_no_end_of_inertia():
    model, angles = two_links(RUBBING), [0.2, 0.4]
    loops = {loop.stuck: loop for loop in sampled_loops(model, angles, 0.01, 1, 20.0)}
    assert set(loops) == {(), (0,), (1,)}, "without both, which no torque moves"
    for stuck in (0, 1):
        heavy = model.constants.rotor_inertia.copy()
        heavy[stuck] = 1e9
        held = sampled_loops(varied_model(model, rotor_inertia=heavy), angles, 0.01, 1, 20.0)[0]
        free = np.setdiff1d(np.arange(len(held.transition)), [held.motors[stuck], held.rates[stuck]])
        own = loops[stuck,]
        scale = np.abs(held.transition).max()
        assert np.abs(own.transition - held.transition)[np.ix_(free, free)].max() < 1e-6 * scale
        assert np.abs(own.inputs - held.inputs)[free].max() < 1e-6 * np.abs(held.inputs).max()


@pytest.mark.slow
def test_margins_are_those_of_the_worst_set_of_motors_that_stick():
    """Gains for which a loop is stable while all motors slide, and not while friction holds the first one."""
    model, angles = two_links(RUBBING), [0.0, 0.3]
    loops = sampled_loops(model, angles, 0.02, 2)
    draws = np.exp(np.random.default_rng(0).uniform(np.log([1e-2] * 4), np.log([10.0, 10.0, 1.0, 1.0]), (300, 4)))
    split = [gains for gains in draws if loops[0].spectral_radius(*np.split(gains, 2)) < 1.0
             and max(loop.spectral_radius(*np.split(gains, 2)) for loop in loops[1:]) > 1.0 + 1e-6]  # fmt: skip
    assert split, "such gains exist"
    for gains in split:
        assert margins(loops[:1], *np.split(gains, 2)).gain >= 1.0
        result = margins(loops, *np.split(gains, 2))
        assert result[:2] == (1.0, 0.0) and result.stuck
        worst = next(loop for loop in loops if loop.stuck == result.stuck)
        assert worst.spectral_radius(*np.split(gains, 2)) > 1.0


@pytest.mark.slow
def test_a_loop_that_is_stable_comes_to_rest_with_friction():
    """A few of the random loops of docs/evidence/servos.md, which has 200 of them."""
    rows = list(friction_rows(6))
    assert all(row.left < AT_REST for row in rows if row.is_stable)
    assert sum(row.is_stable for row in rows) == 6
