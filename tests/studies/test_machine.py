"""Tests of fits to a real arm, which predict held-out runs, and to simulated arms, whose parameters are recovered."""

import numpy as np
import pytest

import flexman_gym as fm
from studies.machine.measure import (
    DATA,
    ONE,
    STAGE_1,
    both_stages,
    draws,
    driven,
    moving,
)
from studies.machine.strain import (
    ALL,
    LENGTHS,
    LOGGED,
    THICKNESSES,
    GaugeObserver,
    one_stage,
    strain_record,
    unfiltered,
)


@pytest.mark.slow
def test_half_of_the_runs_of_a_real_arm_predicts_the_others():
    """Goals: R2 of 0.90 in the median and 0.95 at 20 and 30 degrees, 1.80 to 1.97 Hz, damping ratio 0.09 to 0.16."""
    runs = moving(DATA)
    names = sorted(runs)
    assert len(names) == 11
    half = [runs[name] for name in names[::2]]
    found = fm.fit(
        fm.catalog.quanser_2dsfl(1), ["link_stiffness_factor", "link_damping"], records=half, starts=0, **ONE
    )
    modes = fm.modes(fm.build_model(found.arm, **ONE))
    assert 1.80 < modes.frequencies[0] < 1.97 and 0.09 < modes.damping_ratios[0] < 0.16
    scores = {name: found.score(runs[name])[STAGE_1] for name in names[1::2]}
    assert np.median(list(scores.values())) > 0.90
    assert min(scores["lqg_20deg"], scores["hinf_neg_20deg"]) > 0.95
    assert found.undetermined == () and found.warnings == ()


def test_records_of_both_stages_say_what_went_in_and_came_out():
    record = both_stages(DATA / "two_stages.csv")
    assert record.period == pytest.approx(0.002) and len(record.times) == 5000
    assert set(record.outputs) == set(record.filters) == set(record.gains)
    currents = driven(DATA / "two_stages.csv")
    assert set(currents.inputs) == {"current_1", "current_2"} and currents.period == pytest.approx(0.01)
    assert np.abs(currents.inputs["current_1"]).max() < 0.94  # A, the limit of the drives


@pytest.mark.slow
def test_the_truth_of_a_made_up_arm_is_where_the_fit_says():
    found = [each for each in draws(3, 1) if each[2]]
    assert len(found) >= 4
    assert max(abs(error) for _, error, _ in found) < 4.0


def test_the_signal_before_the_filter_of_the_log_comes_back():
    times = 0.002 * np.arange(2000)
    signal = np.sin(2.0 * np.pi * 1.9 * times) * times**2 + 0.1 * np.sin(2.0 * np.pi * 5.0 * times)
    error = unfiltered(LOGGED.applied(signal, 0.002), 0.002) - signal
    assert np.abs(error).max() < 0.002 * np.abs(signal).max()


def test_a_logged_deflection_is_the_strain_of_a_cantilever_with_a_force_at_its_end():
    logged = both_stages(DATA / "two_stages.csv")
    strains = strain_record(logged).outputs
    for i, (length, thickness) in enumerate(zip(LENGTHS, THICKNESSES, strict=True), 1):
        link = fm.Link.strip(length, 0.05, thickness, material="steel")
        model = fm.build_model(fm.Arm([link], [fm.Joint((0.0, 0.0, 1.0))]), elements=3)
        pulled = fm.linearize(model, inputs=("tip_force",), outputs=("link_deflections", "root_strains"))
        forces, held = pulled.balance.forces, np.arange(1, model.n_dof)  # the hub does not move
        bent = np.linalg.solve(-forces[np.ix_(held, held)], forces[held, 2 * model.n_dof + 1])
        deflection, strain = pulled.C[0, held] @ bent, pulled.C[2, held] @ bent
        expected = strain / deflection * np.asarray(logged.outputs[f"link_deflection_{i}_y"])
        assert np.allclose(strains[f"root_strain_{i}_y"], expected, rtol=1e-6, atol=0.0)


def test_the_observer_has_the_vibrations_of_the_held_arm_and_the_filter_of_the_log():
    arm = fm.catalog.quanser_2dsfl(1)
    found = fm.fit(arm, ["link_damping"], frequencies=[2.0], damping=[0.1], **ONE)
    found.gains["root_strain_1_y"] = (1.0, 0.0)
    poles = np.log(np.linalg.eigvals(GaugeObserver(found, ["root_strain_1_y"], 0.002, 1.0).transition)) / 0.002
    modes = fm.modes(fm.build_model(found.arm, **ONE))
    ratio, rate = modes.damping_ratios[0], 2.0 * np.pi * modes.frequencies[0]
    rate /= np.sqrt(1.0 - ratio**2)
    for pole in (-ratio * rate + 1j * rate * np.sqrt(1.0 - ratio**2), *np.roots(LOGGED.denominator)):
        assert np.abs(poles - pole).min() < 1e-6 * abs(pole)


def test_held_out_strains_of_a_real_link_are_predicted_within_a_fifth_of_their_peak():
    pooled = {row.horizon: row for row in one_stage() if row.run == ALL}
    assert max(row.nearly_all for row in pooled.values()) < 0.2
    assert pooled[0.1].rms < pooled[0.3].rms < pooled[1.0].rms < pooled[0.0].rms < 0.05
