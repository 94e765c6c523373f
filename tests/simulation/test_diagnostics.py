"""Explanation: a failure names the first quantity that left its range, and what to change."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.kernels import layout
from flexman_gym.simulation.diagnostics import explain_bending
from flexman_gym.simulation.stability import NEGLIGIBLE_GROWTH, stability_limit

HUB = fm.Joint((0.0, 0.0, 1.0), 1.0)
BEAM = fm.catalog.planar_2r().links[0]
ARM = fm.Arm([BEAM, BEAM], [HUB, HUB])


def scene(arm=ARM, torque=(0.0, 0.0), rates=(0.0, 0.0), **choice):
    """Half a second of an arm under constant torques."""
    model = (
        fm.ModelChoice(True, 1) if not choice else fm.ModelChoice(**{"flexible_links": True, "elements": 1} | choice)
    )
    return fm.Scene(arm, model, fm.ConstantTorque(torque), fm.Initial([0.0, 0.0], rates), 0.5, 0.05)


def test_nothing_is_explained_while_all_is_well():
    simulator = fm.Simulator(fm.build_model(ARM, 1))
    assert simulator.explanation() == ""
    assert simulator.step([0.1, 0.0]) == "ok" and simulator.explanation() == ""
    assert fm.simulate(scene()).explanation() == ""


@pytest.mark.parametrize("joint", [0, 1])
def test_a_joint_under_an_absurd_torque_is_named(joint):
    """A rigid arm: nothing but the joint that is driven can go first, by four orders of magnitude."""
    torque = [0.0, 0.0]
    torque[joint] = 1e9
    heavy = replace(ARM, joints=[replace(HUB, rotor_inertia=1e3 if i != joint else 1.0) for i in range(2)])
    result = fm.simulate(scene(heavy, torque, flexible_links=False), method="ros2", step=1e-3)
    assert result.status == "diverged"
    assert f"out of bounds is the rate of joints[{joint}]" in result.explanation()
    assert "Try a step shorter than 0.001 s" in result.explanation() and "smaller torques" in result.explanation()


@pytest.mark.parametrize("link", [0, 1])
def test_an_unstable_step_names_the_coordinate_of_the_link_and_the_stable_step(link):
    """Only one link bends; the step that is named is stable, as the linear theory says, and the one given is not."""
    flexible = tuple(i == link for i in range(2))
    wild = scene(torque=(0.1, 0.1), flexible_links=flexible)
    result = fm.simulate(wild, method="rk4", step=1e-3)
    text = result.explanation()
    assert result.status == "diverged" and f"of links[{link}], " in text
    highest = fm.frequencies(fm.build_model(ARM, 1, flexible_links=flexible)).max()
    stable = stability_limit(fm.METHODS["rk4"], NEGLIGIBLE_GROWTH) / (2 * np.pi * highest)
    assert f"a step of at most {stable:.2g} s" in text and "implicit" in text and "modal_damping_ratio" in text
    steps = int(np.ceil(0.05 / (0.9 * stable)))
    calm = fm.simulate(replace(wild, duration=0.05), method="rk4", step=0.05 / steps)
    assert calm.status == "ok" and calm.explanation() == ""


def test_a_link_that_is_spun_past_its_first_frequency_is_told_of_foreshortening():
    thin = replace(BEAM, second_moment_y=1e-3 * BEAM.second_moment_y, second_moment_z=1e-3 * BEAM.second_moment_z)
    with pytest.warns(UserWarning):
        thin = replace(thin)
    rates = [60.0, 0.0]
    without = fm.simulate(scene(replace(ARM, links=[thin, thin]), rates=rates), method="rk4", step=1e-3)
    assert without.status == "diverged" and "stiffening=True" in without.explanation()
    assert "stiffening" not in fm.simulate(scene(torque=(0.1, 0.1)), method="rk4", step=1e-3).explanation()


@pytest.mark.parametrize("share", [0.09, 0.11, 0.5])
def test_a_link_that_bends_by_more_than_a_tenth_of_its_length_is_named(share):
    """The tip of a clamped link under a tip force F moves by F L^3 / (3 E I): one element is exact."""
    for stiffening in (False, True):
        model = fm.build_model(ARM, 1, stiffening=stiffening)
        states = np.zeros((2, 2 * model.n_dof))
        shapes = model.constants.tip_translation[model.constants.elastic_start[1] :, 1]
        columns = model.elastic_columns(1)
        states[1, columns] = share * BEAM.length * shapes / (shapes @ shapes)
        text = explain_bending(model, states)
        assert (text == "") == (share < 0.1)
        if text:
            assert text.startswith(f"link 2 bends by up to {share:.0%} of its length; beyond 10% ")
            assert ("Try stiffening=True; or " in text) != stiffening
    assert explain_bending(fm.build_model(ARM, flexible_links=False), np.zeros((1, 4))) == ""


def test_a_motion_with_large_bending_is_explained_though_it_is_ok():
    bent = fm.simulate(scene(torque=(20.0, 10.0)))
    assert bent.status == "ok" and bent.energy_alarm() is None
    assert " bends by up to " in bent.explanation() and "large bending of a link" in repr(bent)
    small = fm.simulate(scene(torque=(0.1, 0.1)))
    assert small.explanation() == "" and "bending" not in repr(small)


@pytest.mark.parametrize(("part", "advised"), [(0.45, False), (0.55, True)])
def test_foreshortening_is_advised_from_half_of_the_first_frequency_on(part, advised):
    """Spun so fast a link without it has a quarter less of the stiffness of its first mode; it hardly bends here."""
    model = fm.build_model(replace(ARM, links=[BEAM], joints=[HUB]), 1)
    state, columns = np.zeros(2 * model.n_dof), model.elastic_columns(0)
    state[columns.start] = 1e-3
    state[model.n_dof] = part * 2.0 * np.pi * fm.frequencies(model, lock_joints=True)[0]
    spun = fm.Scene(model.arm, model.choice, fm.ConstantTorque([0.0]), fm.Initial([0.0], [0.0], state), 0.5, 0.05)
    failed = fm.simulate(spun, method="rk4", step=1e-3)
    assert failed.status == "diverged" and ("stiffening=True" in failed.explanation()) == advised


def test_an_energy_alarm_names_the_coordinate_that_vibrates():
    """One soft spring of two, wound up and let go, with a step that loses its energy."""
    soft = replace(ARM, joints=[replace(HUB, stiffness=1e7), replace(HUB, stiffness=50.0)])
    choice = {"flexible_links": False}
    state = np.zeros(8)
    state[3] = 0.5
    start = fm.Initial([0.0, 0.0], [0.0, 0.0], state)
    wound = replace(scene(soft, **choice), initial=start)
    text = fm.simulate(wound, method="ros2", step=0.05).explanation()
    assert text.startswith("the energy residual exceeds 1 % of the energy turnover at ")
    assert "the spring of joints[1]" in text and "Try a step shorter than 0.05 s" in text


@pytest.mark.parametrize(("method", "step"), [("ros2", 0.005), ("midpoint_3", 0.005), ("rk4", 0.0025)])
def test_a_simulator_explains_its_failure_with_the_parameters_of_the_arm(method, step):
    simulator = fm.Simulator(fm.build_model(ARM, 1, flexible_links=False), method, step)
    simulator.batch.vary(np.array([0]), rotor_inertia=np.array([[1.0, 1e6]]))
    simulator.reset()
    assert simulator.step([1e10, 0.0]) == "diverged"
    state, outputs = simulator.state.copy(), simulator.outputs.copy()
    assert "out of bounds is the rate of joints[0]" in simulator.explanation()
    assert np.array_equal(simulator.state, state) and np.array_equal(simulator.outputs, outputs)
    simulator.reset()
    assert simulator.explanation() == ""


@pytest.mark.feature
@pytest.mark.slow
def test_a_scene_may_start_from_a_whole_state_of_its_model():
    model = fm.build_model(ARM, 1)
    state = np.linspace(-1e-3, 1e-3, 2 * model.n_dof)
    whole = replace(scene(), initial=fm.Initial([0.0, 0.0], [0.0, 0.0], state))
    assert fm.simulate(whole).states[0] == pytest.approx(state)
    assert fm.Scene.from_dict(whole.to_dict()) == whole
    assert "state" not in scene().to_dict()["initial"]
    for bad in (state[1:], [1e300, *state[1:]]):
        with pytest.raises(ValueError, match=r"^Initial.state(\[0\])?: .* is not allowed; give "):
            fm.simulate(replace(whole, initial=fm.Initial([0.0, 0.0], [0.0, 0.0], bad)))
    with pytest.raises(ValueError, match=r"^scene.initial.state: .* is not allowed; give None"):
        fm.choose_model(whole, 0.01)


def test_explaining_costs_nothing_before_it_is_asked_for(monkeypatch):
    def never(*arguments):
        raise AssertionError("nobody asked")

    monkeypatch.setattr("flexman_gym.simulation.simulator.explain_failure", never)
    monkeypatch.setattr("flexman_gym.simulation.simulator.explain_energy", never)
    simulator = fm.Simulator(fm.build_model(ARM, 1, flexible_links=False))
    assert simulator.step([1e12, 0.0]) == "diverged" == layout.STATUS[simulator.batch.status[0]]
    assert fm.simulate(scene(torque=(1e12, 0.0)), method="ros2", step=1e-3).status == "diverged"


def test_a_trajectory_that_was_pickled_still_explains_itself():
    result = fm.simulate(scene(torque=(1e12, 0.0), flexible_links=False), method="ros2", step=1e-3)
    assert pickle.loads(pickle.dumps(result)).explanation() == result.explanation() != ""
