"""Tests of the fit of the rotary link to a frequency response: a made-up response of a changed arm is recovered."""

from dataclasses import replace

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.__main__ import main
from flexman_gym.model.state_space import discretize
from flexman_gym.simulation.physical_parameters import PARAMETERS, varied_model
from flexman_gym.toolbox.verification import response as module

HERTZ = np.geomspace(0.1, 40.0, 60)
FACTORS = {"link_stiffness_factor": 1.06, "rotor_inertia": 0.93, "viscous_friction": 1.1, "link_damping": 0.8}


def made_up(noise):
    """Return the response of an arm with changed parameters, 1.05 times the torque per volt, and relative noise."""
    model, random = fm.build_model(fm.catalog.quanser_rotary(), 8), np.random.default_rng(3)
    values = {name: factor * np.array(PARAMETERS[name].nominal(model)) for name, factor in FACTORS.items()}
    exact = 1.05 * module._hub_response(varied_model(model, **values), HERTZ)
    return exact * (1.0 + noise * (random.standard_normal((2, len(HERTZ))) * [[1.0], [1.0j]]).sum(axis=0))


def test_parameters_are_recovered_within_their_deviations():
    fit = module.fit_response(HERTZ, made_up(0.01))
    expected = [*FACTORS.values(), 1.05]
    assert (np.abs(fit.factors - expected) < 4.0 * fit.deviations).all()
    assert fit.deviations.max() < 0.1
    assert fit.error < 0.02 < 0.1 < fit.before  # noise of 1.4 % in modulus


def test_the_response_without_link_damping_has_an_antiresonance_at_the_clamped_frequency():
    """With the hub held the link vibrates alone: the response of the hub has a zero at each clamped frequency."""
    model = fm.build_model(replace(fm.catalog.quanser_rotary(), modal_damping_ratio=0.0), 8)
    clamped = fm.frequencies(model, lock_joints=True)[:2]
    near, at = np.abs(module._hub_response(model, clamped * 1.1)), np.abs(module._hub_response(model, clamped))
    assert (at < 1e-9 * near).all()


def test_files(tmp_path):
    response = made_up(0.0)
    path = tmp_path / "response.csv"
    lines = [f"{f!r},{h.real!r},{h.imag!r}" for f, h in zip(HERTZ.tolist(), response.tolist(), strict=True)]
    path.write_text("\n".join([",".join(module.COLUMNS), *lines]), encoding="utf-8")
    hertz, read, machine = module.read_response(path)
    assert machine is module.ROTARY
    assert np.array_equal(hertz, HERTZ)
    assert np.array_equal(read, response)
    for content, message in (
        ("\n".join(["f,re,im", *lines]), "columns of response.csv"),
        ("\n".join([",".join(module.COLUMNS), *lines[:5]]), "rows of response.csv"),
        ("\n".join([",".join(module.COLUMNS), *lines[::-1]]), "rows of response.csv"),
        ("\n".join([",".join(module.COLUMNS), *lines[:12], "1,2,nan"]), "line 14"),
    ):
        path.write_text(content, encoding="utf-8")
        with pytest.raises(ValueError, match=message):
            module.read_response(path)


def test_a_response_of_another_arm_is_not_explained():
    """That of a mass without a spring, of another gain, has no antiresonance."""
    fit = module.fit_response(HERTZ, 30.0 / (2j * np.pi * HERTZ) ** 3)
    assert fit.error > module.LARGE_ERROR and "the fit does not explain the response" in str(fit)


AXIS_FACTORS = np.array([1.1, 0.9, 1.05, 0.95, 1.08, 1.3, 0.8, 1.2])


def axis_file(path, factors, noise=0.0, scale=1.0):
    """Write a file with the response of the axis with changed factors, and relative noise."""
    random = np.random.default_rng(4)
    response = scale * module.AXIS.response(factors, HERTZ)
    response = response * (1.0 + noise * (random.standard_normal((2, len(HERTZ))) * [[1.0], [1.0j]]).sum(axis=0))
    lines = [f"{f!r},{h.real!r},{h.imag!r}" for f, h in zip(HERTZ.tolist(), response.tolist(), strict=True)]
    path.write_text("\n".join([",".join(module.AXIS_COLUMNS), *lines]), encoding="utf-8")
    return path


def test_the_response_of_the_axis_has_a_closed_form():
    """The impedance of three inertias in a chain; J, fractions, springs and dampers as printed."""
    total, motor, gear, s = 0.03291699877416, 0.17910964111956, 0.61206166914114, 2j * np.pi * HERTZ
    inertias = total * np.array([motor, gear, 1.0 - motor - gear])
    inner, outer = 20.59269827430799 / s + 0.0624181404729, 20.23072060978318 / s + 0.00987527995798
    arm = inertias[2] * s
    both = inertias[1] * s + outer * arm / (outer + arm)
    impedance = inertias[0] * s + 0.00986346744839 + inner * both / (inner + both)
    np.testing.assert_allclose(module.AXIS.response(np.ones(8), HERTZ), 1.0 / impedance, rtol=1e-4)


def test_a_file_of_the_axis_itself_is_fitted(tmp_path):
    hertz, response, machine = module.read_response(axis_file(tmp_path / "axis.csv", AXIS_FACTORS))
    assert machine is module.AXIS
    fit = module.fit_response(hertz, response, machine)
    np.testing.assert_allclose(fit.factors, AXIS_FACTORS, rtol=1e-4)
    assert fit.error < 1e-5 < 0.1 < fit.before
    assert "inertia of the gear: 0.9 +-" in str(fit) and "times the value of the paper" in str(fit)


def test_factors_of_the_axis_are_recovered_within_their_deviations(tmp_path):
    fit = module.fit_response(*module.read_response(axis_file(tmp_path / "axis.csv", AXIS_FACTORS, noise=0.01)))
    assert (np.abs(fit.factors - AXIS_FACTORS) < 4.0 * fit.deviations).all() and fit.error < 0.03


def test_a_planted_sign_of_the_torque_is_not_explained(tmp_path):
    fit = module.fit_response(*module.read_response(axis_file(tmp_path / "axis.csv", AXIS_FACTORS, scale=-1.0)))
    assert fit.error > module.LARGE_ERROR and "motor rate, rad/s" in str(fit)


def test_the_command_fits_a_file_of_the_axis(tmp_path, capsys):
    path = axis_file(tmp_path / "axis.csv", AXIS_FACTORS)
    assert main(["verify", "papers", "--data", str(path)]) == 0
    assert "stiffness of the arm: 1.08 +-" in capsys.readouterr().out


def write_record(path, factors, seconds=100.0, period=2e-3):
    """Write a record of the axis with changed factors under random torques that are held between samples."""
    linear = fm.linearize(module.AXIS.model(factors), outputs=("motor_rates",))
    transition, held = discretize(linear.A, linear.B, period)
    torques = np.random.default_rng(5).standard_normal(round(seconds / period))
    state, rows = np.zeros(len(transition)), []
    for i, torque in enumerate(torques.tolist()):
        rows.append(f"{i * period!r},{torque!r},{float((linear.C @ state)[0])!r}")
        state = transition @ state + held[:, 0] * torque
    path.write_text("\n".join([",".join(module.RECORD_COLUMNS), *rows]), encoding="utf-8")
    return path


def test_a_record_of_the_axis_itself_is_fitted(tmp_path):
    path = write_record(tmp_path / "record.csv", AXIS_FACTORS)
    fit = module.fit_response(*module.read_response(path))
    assert fit.error < 0.05 < 0.1 < fit.before
    np.testing.assert_allclose(fit.factors[:5], AXIS_FACTORS[:5], rtol=0.02)
    short = path.read_text(encoding="utf-8").splitlines()[:40]
    path.write_text("\n".join(short), encoding="utf-8")
    with pytest.raises(ValueError, match="frequencies with a coherence above"):
        module.read_response(path)
    path.write_text("\n".join([*short, "7.0,0.0,0.0"]), encoding="utf-8")
    with pytest.raises(ValueError, match="equal intervals"):
        module.read_response(path)
