"""Model-based controllers of arms with passive joints: gains, quasi-static swing, output feedback, unknown payload."""

import gymnasium as gym
import numpy as np
import pytest
from scipy.optimize import fsolve

import flexman_gym as fm
from flexman_gym.agent.base_controllers import make_base
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.config.plant import make_plant
from flexman_gym.model.friction import friction_coefficients, frictionless
from flexman_gym.toolbox.controllers.references.trajectories import DeflectionCompensation, QuasiStaticDeflection

from oracles.assertions import refusal

ID, X, Y, Z = "FlexCrane-v0", (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
DOWN = ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0))
GRAVITY, BOOM, ROPE, SHORT = 9.81, 2.0, 1.0, 1e-6  # m/s^2, m, m, m
pytestmark = pytest.mark.filterwarnings("ignore:.*radius of gyration")


def slewing_boom(friction=0.0):
    """Return a rigid arm: boom about a vertical axis, and a load on a rope without mass at its tip."""
    light = np.eye(3) * 1e-9
    links = [fm.Link.rigid(BOOM, 3.0, (1.0, 0.0, 0.0), np.eye(3)), fm.Link.rigid(SHORT, 1e-6, (0.0, 0.0, 0.0), light),
             fm.Link.rigid(ROPE, 1e-6, (0.5, 0.0, 0.0), light, orientation=DOWN)]  # fmt: skip
    motor = fm.Joint(Z, torque_limit=50.0, viscous_friction=friction)
    passive = [fm.Joint(axis, passive=True, viscous_friction=0.3) for axis in (Y, X)]
    return fm.Arm(links, [motor, *passive], fm.Payload(5.0), gravity=(0.0, 0.0, -GRAVITY))


@pytest.fixture(scope="module")
def plant():
    configuration = Configuration(ID)
    return make_plant(configuration, resolve_fidelity(configuration).model)


@pytest.mark.parametrize("acceleration", [0.0, 0.4, 1.5])
def test_a_rope_is_parallel_to_gravity_and_acceleration_of_its_load(acceleration):
    """The load at (x, y, -z) from the boom tip accelerates by a k x r: x / z = a y / g and y / z = -a (R + x) / g."""
    model = fm.build_model(slewing_boom())
    deflection = QuasiStaticDeflection(model)
    still = np.zeros(3)
    coordinates, torques = deflection.at(np.zeros(3), (still, still, np.array([acceleration, 0.0, 0.0])))

    def unbalanced(position):
        x, y = position
        z = np.sqrt(ROPE**2 - x**2 - y**2)
        return x / z - acceleration * y / GRAVITY, y / z + acceleration * (BOOM + x) / GRAVITY

    x, y = fsolve(unbalanced, (0.0, 0.0), xtol=1e-12)
    simulator = fm.Simulator(model)
    simulator.reset(state=np.concatenate([coordinates, np.zeros(3)]))
    expected = [BOOM + x, y, -np.sqrt(ROPE**2 - x**2 - y**2)]
    np.testing.assert_allclose(simulator.tip, expected, atol=1e-5)  # the axes are 1e-6 m apart
    rotating = 1.0 + 3.0 * (BOOM / 2.0) ** 2 + 5.0 * ((BOOM + x) ** 2 + y**2)
    np.testing.assert_allclose(torques, [rotating * acceleration, 0.0, 0.0], atol=1e-4)


def test_the_turn_of_a_motor_moves_a_hanging_load_as_it_hangs():
    """Against differences of equilibria: the load stays plumb, unlike a load on a rigid extension of the boom."""
    model = fm.build_model(fm.catalog.loader_crane())
    goal, turn = np.array([0.1, 0.2, -0.3, 0.0, 0.0]), np.array([0.0, 2e-3, -1e-3, 0.0, 0.0])
    target, other = (fm.rest_state(model, each)[: model.n_dof] for each in (goal, goal + turn))
    found = DeflectionCompensation(model).rotation(other, target)
    np.testing.assert_allclose(found, turn, atol=2e-5)


def test_only_the_friction_of_motors_is_compensated():
    model = fm.build_model(slewing_boom(friction=2.0))
    np.testing.assert_array_equal(friction_coefficients(model), [[2.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    np.testing.assert_array_equal(frictionless(model).constants.rotor_damping, [0.0, 0.3, 0.3])
    without = fm.build_model(slewing_boom())
    assert frictionless(without) is without


def test_a_passive_joint_has_no_gain_and_the_motors_damp_the_swing(plant):
    regulator = make_base("lqr-tracking", plant)
    posture = np.array([0.3, 0.2, -0.4, 0.0, 0.0])
    gain = regulator.gain(posture)
    assert gain.shape == (5, 38) and gain[:3].all() and not gain[3:].any()
    state, torque = fm.rest_state(plant.model, posture), fm.holding_torques(plant.model, posture)
    sampled = fm.linearize(plant.model, state=state, torque=torque).discrete(plant.period)
    poles = np.log(np.linalg.eigvals(sampled.A - sampled.B @ gain[:3]).astype(complex)) / plant.period
    held = fm.modes(plant.model, posture, motors="held")
    assert held.damping_ratios[:2].max() < 0.015  # the two swings with held motors
    swings = poles[np.abs(np.abs(poles) / (2.0 * np.pi) - held.frequencies[0]) < 0.1]
    assert len(swings) and (-swings.real / np.abs(swings)).min() > 0.1


@pytest.mark.parametrize("base", ["lqr-tracking", "lqg", "privileged-lqr"])
def test_a_hanging_load_comes_to_rest_at_its_target(base):
    arms = gym.make_vec(ID, 2, "vector_entry_point", base=base, horizon=8.0, autoreset_mode="Disabled")
    arms.reset(seed=[5001, 5002])
    for _ in range(800):
        _, _, failed, _, info = arms.step(np.zeros((2, 3), dtype=np.float32))
        assert not failed.any()
    assert info["tip_error"].max() < 1e-3 and info["tip_vibration"].max() < 2e-3


@pytest.mark.slow
def test_an_unknown_payload_is_estimated_while_it_swings():
    """Encoders of motors and hook, torque and strain; the LQR that knows 100 kg misses the target by centimetres."""
    settings = {"condition": "payload", "horizon": 7.0, "autoreset_mode": "Disabled"}
    errors = {}
    for base in ("adaptive-lqr", "lqr-tracking"):
        arms = gym.make_vec(ID, 2, "vector_entry_point", base=base, **settings)
        arms.reset(seed=[5007, 5009])
        true = arms.unwrapped.episodes.effects.drawn["payload_mass"].copy()
        assert np.abs(true - 100.0).min() > 50.0
        for _ in range(699):
            _, _, failed, _, info = arms.step(np.zeros((2, 3), dtype=np.float32))
            assert not failed.any()
        errors[base] = info["tip_error"]
        if base == "adaptive-lqr":
            estimated = arms.unwrapped.episodes.base.estimates["payload_mass"]
            np.testing.assert_allclose(estimated, true, atol=1.0)
    assert errors["adaptive-lqr"].max() < 5e-3 < 0.02 < errors["lqr-tracking"].min()


def test_a_load_on_a_sprung_joint_without_gravity_comes_to_rest():
    """A passive joint with a spring, whose equilibrium is that of the spring."""
    bars = [fm.Link.rod(0.5, 0.02), fm.Link.rod(0.3, 0.02)]
    joints = [fm.Joint(Z, rotor_inertia=0.05, torque_limit=20.0), fm.Joint(Z, passive=True, stiffness=3.0)]
    arms = gym.make_vec("FlexPlanar-v0", 2, "vector_entry_point", arm=fm.Arm(bars, joints, fm.Payload(0.2)),
                        base="lqr-tracking", autoreset_mode="Disabled")  # fmt: skip
    arms.reset(seed=[1, 2])
    errors = []
    for _ in range(round(4.0 / arms.unwrapped.configuration.control_period)):
        errors.append(arms.step(np.zeros((2, 1), dtype=np.float32))[4]["tip_error"])
    assert errors[-1].max() < 1e-3 < 0.02 < errors[0].min()


@pytest.mark.parametrize("base", ["lqr", "lqg", "adaptive-lqr", "mpc"])
def test_an_arm_without_motors_is_refused(base):
    line = refusal(lambda: gym.make("FlexGantry-v0", base=base))
    assert line.endswith("give pd, pd-shaped, or a controller of your own, for an arm without motors")


def test_limits_of_passive_joints_are_no_scale_of_their_actions(plant):
    assert plant.torque_scales.tolist() == [2000.0, 10000.0, 5000.0, 1e30, 1e30]
