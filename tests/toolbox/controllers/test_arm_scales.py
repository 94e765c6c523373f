"""Times and rates of an arm: closed forms of a rigid link, and invariance under a change of the unit of time."""

from dataclasses import replace

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.config.plant import make_plant
from flexman_gym.envs.registration import IDS
from flexman_gym.toolbox.controllers.arm_scales import CHANGE, SHORTEST_RANGE, ArmScales, ringing_period
from flexman_gym.toolbox.controllers.cost_weights import CostWeights, NamedWeights

from oracles.assertions import refusal

INERTIA, ROTOR, STIFFNESS = 0.3, 0.05, 400.0  # kg m^2, kg m^2, N m/rad


def one_link(stiffness=STIFFNESS, **joint):
    """A rigid link of the inertia INERTIA about a joint with a rotor and a spring."""
    link = fm.Link.rigid(1.0, 1.0, (0.5, 0.0, 0.0), np.diag([0.0, 0.05, INERTIA - 0.25]).tolist())
    return fm.Arm([link], [fm.Joint((0.0, 0.0, 1.0), ROTOR, stiffness=stiffness, **joint)])


def scales(arm, limit=10.0, rate=np.inf):
    return ArmScales.of(fm.build_model(arm, 1), (limit,) * arm.n_joints, rate)


def test_scales_of_a_rigid_link_on_a_spring_are_their_closed_forms():
    """Spring and link with the motor held; the torque of a minimum-jerk slew."""
    own = scales(one_link(), 10.0)
    assert own.vibration == pytest.approx(2.0 * np.pi * np.sqrt(INERTIA / STIFFNESS), rel=1e-6)
    whole = (INERTIA + ROTOR) * CHANGE * 10.0 / np.sqrt(3.0)
    assert own.torque_slew == pytest.approx(np.sqrt(whole / (0.95 * 10.0)), rel=1e-9)


def test_planned_rates_are_the_smaller_of_those_of_motor_and_environment():
    motor = fm.Motor(
        gear_ratio=100.0, torque_constant=0.1, rotor_inertia=ROTOR / 1e4, current_limit=1.0, speed_limit=300.0
    )
    link = one_link().links[0]
    arm = fm.Arm([link], [fm.Joint((0.0, 0.0, 1.0), motor=motor, stiffness=STIFFNESS)])
    assert scales(arm).rates == pytest.approx((0.85 * 3.0,))
    assert scales(arm, rate=2.0).rates == pytest.approx((1.2,))
    assert scales(one_link(), rate=2.0).rates == pytest.approx((1.2,)) and scales(one_link()).rates == (np.inf,)


@pytest.mark.parametrize("factor", [0.1, 3.0])
def test_scales_are_invariant_under_a_change_of_the_unit_of_time(factor):
    """Stiffness and torques increase by the square of the factor, rates by the factor, and times decrease by it."""
    arm, limit = one_link(damping=0.4), 50.0
    fast = one_link(STIFFNESS * factor**2, damping=0.4 * factor)
    own, other = scales(arm, limit, 40.0), scales(fast, limit * factor**2, 40.0 * factor)
    assert other.vibration == pytest.approx(own.vibration / factor)
    assert other.slew == pytest.approx(own.slew / factor) and other.vibrations == pytest.approx(own.vibrations)
    assert SHORTEST_RANGE[0] < own.vibrations < SHORTEST_RANGE[1]
    periods = own.slew / 150.0 * np.array([0.1, 1.0, 5.0])
    assert [own.unit(period) for period in periods] == [other.unit(period / factor) for period in periods] == [10, 1, 1]
    first, second = (CostWeights.default(fm.build_model(each, 1), s) for each, s in ((arm, own), (fast, other)))
    assert second.tip == first.tip and second.torque == pytest.approx(first.torque) and first.torque < 1.0
    assert second.tip_speed == pytest.approx(factor * first.tip_speed)
    assert second.motor_rate == pytest.approx(np.array(first.motor_rate) * factor)


def test_a_slew_is_longer_the_more_torque_exceeds_what_a_vibration_needs():
    """Of an arm with strong motors 1.6 periods, and of one with weak motors 0.7, which its torques exceed anyway."""
    strong, middle, weak = (scales(one_link(), limit) for limit in (1e3, 50.0, 0.1))
    assert strong.vibrations == 1.6 > middle.vibrations > weak.vibrations == 0.7
    assert strong.slew == 1.6 * strong.vibration and weak.slew == weak.torque_slew > weak.vibration


@pytest.mark.parametrize("tilt", [0.0, 0.03, 0.5])
def test_a_mode_that_the_motor_hardly_excites_does_not_ring(tilt):
    """A strip that turns about the normal of its plane is softer out of it; a tilted axis (rad) excites both modes."""
    periods = []
    for thin in ("y", "z"):
        link = fm.Link.strip(0.5, width=0.02, thickness=0.002, material="aluminium", thin=thin)
        axis = (0.0, np.sin(tilt), np.cos(tilt))
        model = fm.build_model(fm.Arm([link], [fm.Joint(axis, 0.1)], fm.Payload(0.1)), 2)
        periods.append(ringing_period(model, np.zeros(1)))
        assert 1.0 / fm.frequencies(model, lock_joints=True)[0] == pytest.approx(periods[0], rel=1e-3)
    assert periods[1] == pytest.approx(periods[0] * (1.0 if tilt == 0.5 else 0.002 / 0.02), rel=1e-2)


def test_an_arm_that_cannot_vibrate_has_no_shortest_slew():
    rigid = fm.build_model(one_link(), 1, flexible_joints=False)
    own = ArmScales.of(rigid, (10.0,))
    assert own.vibration == 0.0 and own.slew == own.torque_slew
    weights = CostWeights.default(rigid, own)
    assert weights.torque == 1.0 and weights.tip / weights.tip_speed == pytest.approx(own.slew / 16.0)


@pytest.mark.parametrize("name", sorted({*IDS} - {"FlexCrane-v0"}))  # a load that hangs has the design "arm"
def test_a_time_unit_is_a_control_period_of_named_environments(name):
    setup = Configuration(name)
    plant = make_plant(setup, resolve_fidelity(setup).model)
    assert ArmScales.of_plant(plant).unit(plant.period) == 1
    assert plant.rate_limit == setup.limits.rate


def test_the_design_named_has_fixed_weights_and_no_bounds():
    setup = Configuration("FlexOne-v0")
    plant = make_plant(setup, fm.build_model(setup.arm, 1))
    own = ArmScales.of_plant(plant, "named")
    bounds = own.bounds(np.ones(1), 0.9)
    assert bounds.shortest(plant.model, np.zeros(1)) == 0.0 and np.isinf(bounds.rates).all()
    assert own.unit(plant.period) == 1
    weights = CostWeights.default(plant.model, own)
    assert isinstance(weights, NamedWeights) and weights.tip / weights.tip_speed == pytest.approx(0.2)
    line = refusal(ArmScales.of_plant, plant, "own")
    assert line == "base.design: 'own' is not allowed; give one of arm, named"


def test_a_joint_that_only_just_holds_its_weight_has_a_finite_slew():
    heavy = replace(one_link(), gravity=(0.0, -9.81, 0.0))
    assert 0.0 < scales(heavy, 0.5).torque_slew < np.inf
