"""Tests of H-infinity control: identities of its plant, norms, bounds of random plants, and the agent `hinf`."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.toolbox.controllers import hinf
from flexman_gym.toolbox.controllers.cost_weights import NamedWeights
from flexman_gym.toolbox.controllers.hinf import (
    GeneralisedPlant,
    linear_parameters,
)
from flexman_gym.toolbox.controllers.observers.observer import MeasurementModel
from studies.robust.measure import (
    LOSS,
    SENSORS,
    UNKNOWN,
    designs,
    exact_plant,
    gu_plant,
    peak_gain,
    random_values,
    simulate_move,
)

slycot = pytest.importorskip("slycot")
GOAL = np.zeros(1)


@pytest.fixture(scope="module")
def plant():
    return gu_plant()


@pytest.fixture(scope="module")
def whole(plant):
    """Generalised plant with all excited modes."""
    return GeneralisedPlant.linearised(plant, MeasurementModel(plant, SENSORS), GOAL, np.inf)


@pytest.fixture(scope="module")
def found(plant):
    return dict(designs(plant))


def test_the_channels_of_parameters_are_the_differences_of_the_equations_of_motion(plant):
    model = hinf.centred_model(plant)
    modes = hinf._modes(model, GOAL, np.array(plant.torque_limit), np.inf)
    wide, random = np.kron(np.eye(3), modes.shapes), np.random.default_rng(1)
    centre = hinf._linearised(model, GOAL)[1]
    uncertain = linear_parameters(plant)
    channels = hinf._channels(plant, modes)
    assert [*channels] == ["payload_mass", "viscous_friction[0]"]
    for (left, right), half in zip(channels.values(), np.diag(0.5 * np.ptp(uncertain.ranges, axis=1)), strict=True):
        assert left.shape[1] == 1  # a payload that the motor moves in one direction, a motor
        delta = random.uniform(-1.0, 1.0)
        changed = hinf._linearised(uncertain.varied_model(plant.model, uncertain.mean + delta * half), GOAL)[1]
        change = modes.shapes.T @ (changed - centre) @ wide
        scale = np.concatenate([1.0 / modes.rates, np.ones(len(modes.rates)), modes.rates])
        np.testing.assert_allclose(
            delta * left @ right * scale, change * scale, atol=1e-8 * np.abs(change * scale).max()
        )


def test_the_sampled_plant_has_the_responses_of_the_linear_model_with_delay(plant):
    late = plant._replace(delay=(2, 2))
    model, instruments = hinf.centred_model(late), MeasurementModel(late, SENSORS)
    result, weights = GeneralisedPlant.linearised(late, instruments, GOAL, np.inf), NamedWeights.of_reach(model)
    outputs = ("tip", "tip_velocity", "motor_angles", "motor_angles", "motor_rates", "root_strains")
    linear = fm.linearize(model, GOAL, outputs=outputs)
    frequencies = np.array([0.3, 4.0, 17.0, 120.0])
    expected = linear.discrete(late.period).frequency_response(frequencies) * late.torque_limit[0]
    expected[:, :3] /= weights.tip
    expected[:, 3:6] /= weights.tip_speed
    expected[:, 6] /= weights.motor
    shift = np.exp(-2j * np.pi * frequencies * late.period)[:, None] ** 2
    response = result.system.frequency_response(frequencies)
    first = sum(result.blocks)
    rows = [*range(first, first + 7), *range(first + result.outputs, first + result.outputs + 5)]
    scale = np.abs(expected).max()
    np.testing.assert_allclose(response[:, rows, -1], shift * expected[:, :, 0], rtol=1e-6, atol=1e-6 * scale)
    np.testing.assert_allclose(response[:, first + 7, -1], 1.0, rtol=1e-12)  # the commanded torque itself
    np.testing.assert_allclose(
        response[:, rows, 0], hinf.TORQUE_ERROR * shift * expected[:, :, 0], rtol=1e-6, atol=1e-6 * scale
    )
    felt = response[:, rows, first]
    np.testing.assert_allclose(felt, hinf.TORQUE_DISTURBANCE * expected[:, :, 0], rtol=1e-6, atol=1e-6 * scale)


@pytest.mark.parametrize("name", ["payload_mass", "viscous_friction_factor", "link_stiffness_factor"])
def test_a_channel_closed_with_its_largest_value_is_the_changed_plant(plant, found, name):
    """Only the lag of the hold of the channel, half a period, and the ranks left out remain."""
    uncertain = plant._replace(unknown={name: UNKNOWN.get(name, (0.95, 1.05))})
    whole, loop = (
        GeneralisedPlant.linearised(uncertain, MeasurementModel(plant, SENSORS), GOAL, np.inf),
        found["channels"].loop,
    )
    frequencies, (_, rank) = np.array([0.3, 1.0, 3.0]), whole.blocks
    matrix = whole.closed_loop(loop).frequency_response(frequencies)[:, 1:, 1:]
    inner = np.linalg.solve(np.eye(rank) - matrix[:, :rank, :rank], matrix[:, :rank, rank:])
    nominal, changed = matrix[:, rank:, rank:], matrix[:, rank:, rank:] + matrix[:, rank:, :rank] @ inner
    exact = exact_plant(uncertain, linear_parameters(uncertain).ranges[:, 1])
    expected = exact.closed_loop(loop).frequency_response(frequencies)[:, 1:, 1:]
    errors = np.abs(changed - expected).max(axis=(1, 2)) / np.abs(nominal - expected).max(axis=(1, 2))
    if name == "viscous_friction_factor":
        np.testing.assert_allclose(errors, np.pi * frequencies * plant.period, rtol=0.1)
    assert errors.max() < 0.06, (rank, errors)


def test_the_closed_loop_has_the_norm_of_the_synthesis(plant, found):
    centre = plant._replace(model=hinf.centred_model(plant), unknown={})
    ignored = GeneralisedPlant.linearised(centre, MeasurementModel(centre, SENSORS), GOAL)
    ones, norm = np.ones(1), found["ranges ignored"].norm
    best = hinf._central(ignored, ones, 0.0, 1.0, norm)
    closed = ignored.closed_loop(best.loop)
    A, B, C, D = closed.A, closed.B[:, 1:], closed.C[1:], closed.D[1:, 1:]
    gain = slycot.ab13dd("D", "I", "N", "D", len(A), B.shape[1], len(C), A, np.eye(len(A)), B, C, D)[0]
    assert 0.8 * norm < gain < norm
    assert hinf._central(ignored, ones, 0.0, 1.0, 0.95 * norm) is None, "a smaller norm has no controller"


def test_random_plants_are_within_the_bound_of_the_scaled_design_only(plant, whole, found):
    scaled, unscaled = found["scaled channels"], found["channels"]
    exact = [exact_plant(plant, random_values(plant, seed)) for seed in range(12)]
    exact += [exact_plant(plant, end) for end in linear_parameters(plant).ranges.T]
    gains = [peak_gain(each, scaled.loop) for each in exact]
    assert whole.robustness(scaled.loop).max() < 1.0
    nominal, bound = peak_gain(exact_plant(plant, linear_parameters(plant).mean), scaled.loop), LOSS * scaled.norm
    assert whole.robustness(scaled.loop, bound).max() < 1.0 < whole.robustness(scaled.loop, nominal).max()
    assert nominal < max(gains) < bound, "robust performance at the gain that the design allows"
    assert whole.robustness(unscaled.loop).max() > 1.0 and scaled.share > unscaled.share
    assert max(peak_gain(each, unscaled.loop) for each in exact) == np.inf, "without scales some are unstable"


def test_simulated_random_plants_settle_after_the_move_of_the_book(plant, found):
    settling, remaining = simulate_move(plant, found["scaled channels"], 4)
    assert 0.9 < settling < 1.5 and remaining < 0.02 * np.pi / 12.0 * 1e3 * plant.model.constants.length.sum()


def test_arms_are_independent_and_the_observer_of_saturated_torques_is_stable(plant):
    controller = hinf.HInfinity(plant, SENSORS)
    goals, active = np.array([[0.2], [-0.3]]), np.ones(2, dtype=bool)
    episode = fm.control.EpisodeInfo(np.zeros((2, 1)), goals, plant.period)
    readings = {"motor_angles": np.array([[2.0], [0.01]]), "motor_rates": np.zeros((2, 1)),
                "root_strains": np.zeros((2, 3))}  # fmt: skip
    controller.reset(np.arange(2), episode, 2)
    both = [controller.act(readings, np.zeros((2, 1)), active) for _ in range(200)]
    design = controller.design(goals[0])
    assert both[-1][0] == -1.0 and design is controller.design(goals[0])
    observer = design.loop.A - design.saturation @ design.loop.C
    assert np.abs(np.linalg.eigvals(observer)).max() < 1.0, "a stable observer"
    for _ in range(3000):
        controller.act(readings, np.zeros((2, 1)), active)
    _, reference, forward = controller._loops[0]
    error = controller._instruments.read(readings)[0] - reference[-1]
    driven = design.loop.B @ error + design.saturation @ (both[-1][0] - forward[-1] - design.loop.D @ error)
    rest = np.linalg.solve(np.eye(len(observer)) - observer, driven)
    np.testing.assert_allclose(controller._states[0, : len(rest)], rest, rtol=1e-6, err_msg="at rest")
    alone = hinf.HInfinity(plant, SENSORS)
    alone.reset(np.array([0]), fm.control.EpisodeInfo(np.zeros((1, 1)), goals[1:], plant.period), 1)
    own = {name: value[1:] for name, value in readings.items()}
    for both_actions in both:
        np.testing.assert_array_equal(alone.act(own, np.zeros((1, 1)), active[:1])[0], both_actions[1])


def test_without_deviations_the_torque_is_the_feed_forward_of_the_delayed_period_also_after_missing_readings(plant):
    late = plant._replace(delay=(1, 2))
    controller, places = hinf.HInfinity(late, SENSORS), MeasurementModel(late, SENSORS).places
    controller.reset(np.array([0]), fm.control.EpisodeInfo(np.zeros((1, 1)), np.array([[0.3]]), late.period), 1)
    _, reference, forward = controller._loops[0]
    active = np.ones(1, dtype=bool)
    for now in range(40):
        if now in (5, 6, 20):
            controller.skip(active)
            continue
        readings = {name: reference[now : now + 1, place] for name, place in places.items()}
        np.testing.assert_allclose(controller.act(readings, np.zeros((1, 1)), active), forward[now + 2 : now + 3])
    assert np.ptp(forward[:42]) > 0.01 and np.abs(forward).max() < 1.0, "torques change, within the limits"


def test_the_feed_forward_holds_coulomb_friction_while_the_motor_turns(plant):
    goal, torques = np.array([0.3]), []
    arm = fm.catalog.gu_2005()
    for friction in (0.0, 1.5):
        joint = replace(arm.joints[0], coulomb_friction=friction)
        rubbing = plant._replace(model=fm.build_model(replace(arm, joints=(joint,)), 2))
        torques.append(hinf.HInfinity(rubbing, SENSORS)._reference(np.zeros(1), goal, None, 0)[1][:, 0])
    difference = torques[1] - torques[0]
    middle = len(difference) // 2
    np.testing.assert_allclose(difference[middle - 3 : middle + 3], 1.5, rtol=1e-3)
    assert difference[-1] == 0.0, "at rest"


def test_noise_of_unit_size_is_three_deviations_and_at_least_a_thousandth_of_the_range(plant):
    ranges = MeasurementModel(plant, SENSORS).ranges
    for deviation, share in ((0.0, 1e-3), (0.01, 0.03)):
        quiet = plant._replace(measured=lambda deviation=deviation: {
            name: errors * np.array([1.0, 0.0, 1.0, 1.0])[:, None] + np.outer([0.0, deviation, 0.0, 0.0], errors[0])
            for name, errors in plant.measured().items()
        })  # fmt: skip
        system = GeneralisedPlant.linearised(quiet, MeasurementModel(quiet, SENSORS), GOAL).system
        y = len(ranges)
        np.testing.assert_allclose(system.D[-y:, -1 - y : -1], np.diag(share * ranges))


@pytest.mark.parametrize("name", ["FlexRotary-v0", "FlexRRR-v0/payload"])
def test_the_agent_settles(name):
    assert fm.evaluate("hinf", name, range(9000, 9003))["settled"] == 1.0


def test_no_other_module_imports_slycot_and_a_missing_package_is_one_line(monkeypatch, plant):
    folder = Path(fm.__file__).parent
    users = {
        path.relative_to(folder).as_posix()
        for path in folder.rglob("*.py")
        if "slycot" in path.read_text(encoding="utf-8")
    }
    assert users == {"toolbox/controllers/hinf.py"}
    monkeypatch.setitem(sys.modules, "slycot", None)
    with pytest.raises(ImportError, match=r"^the agent hinf needs slycot: pip install 'flexman_gym\[control\]'$"):
        hinf.HInfinity(plant)


def test_wrong_arguments_are_one_line(plant):
    with pytest.raises(ValueError, match=r"^loss: 0\.0"):
        hinf.HInfinity(plant, loss=0.0)
    blind = GeneralisedPlant.linearised(plant, MeasurementModel(plant, SENSORS), GOAL)
    system = blind.system
    with pytest.raises(ValueError, match=r"^sensors: "):
        blind._replace(system=replace(system, C=np.concatenate([system.C[:-5], 0.0 * system.C[-5:]]))).synthesise()
