"""Conditions: changes of a named environment, in each of which the PD of the environment is stable."""

import warnings
from dataclasses import replace
from itertools import product

import gymnasium as gym
import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.agent.base_controllers import make_base
from flexman_gym.agent.pd import PD, stability_limit
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS, condition_names
from flexman_gym.envs.config.plant import make_plant
from flexman_gym.envs.config.randomisation import Randomisation
from flexman_gym.envs.registration import CONDITION_FOLDER, CONDITIONS
from flexman_gym.model.state_space import discretize
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.physical_parameters import UNMODELLED

pytestmark = pytest.mark.filterwarnings("ignore:Link.second_moment_y")  # of the paper's printed area
IDS = [name for name, named in NAMED_ENVIRONMENTS.items() if named.conditions]
# Over all that is uncertain, without friction and with a delay of three periods, no PD is stable that moves the arm.
UNSTABLE = ("uncertain",)
FEWER = {
    "FlexRotary-v0": ("nominal", "friction", "unknown-lab"),  # a rigid joint
    "FlexTwoMass-v0": ("nominal", "stiffness"),
    "FlexCrane-v0": (),  # `arms` has no gravity and flexible links only; see test_crane
    "FlexGantry-v0": (),  # no motor
}
CASES = [
    (name, condition)
    for name in IDS
    for condition in FEWER.get(name, [each for each in condition_names(name) if each not in UNSTABLE])
]
CRANE = [("FlexCrane-v0", condition) for condition in condition_names("FlexCrane-v0")]
COMMON = [name for name in CONDITIONS if name not in ("short-rope", "long-rope", "rough")]  # those of one environment
FOLDERS = {"rrr": "FlexRRR-v0", "planar": "FlexPlanar-v0", "gravity": "FlexRRR-Gravity-v0"}


def largest_eigenvalue(model, controller, period, delay, posture):
    """Of the sampled loop of arm and PD about a posture, with torques that are late by whole periods."""
    n, d = model.n_joints, model.n_dof
    linear = fm.linearize(model, posture)
    transition, inputs = discretize(linear.A, linear.B, period)
    gain = np.zeros((n, 2 * d))
    gain[np.arange(n), model.motor_columns] = controller.stiffness
    gain[np.arange(n), d + model.motor_columns] = controller.damping
    loop = np.zeros((2 * d + delay * n,) * 2)
    loop[: 2 * d, : 2 * d] = transition
    if delay == 0:
        loop[: 2 * d, : 2 * d] -= inputs @ gain
    else:
        loop[: 2 * d, 2 * d : 2 * d + n] = inputs  # of the oldest torques
        loop[2 * d : -n, 2 * d + n :] = np.eye((delay - 1) * n)
        loop[-n:, : 2 * d] = -gain
    return np.abs(np.linalg.eigvals(loop)).max()


def arms(setup):
    """The arm at the ends of what a condition draws, without friction and weight, which only help or stay constant."""
    drawn = setup.disturbances
    payloads = (drawn and drawn.payload_mass) or (None,)
    for payload, links, joints in product(
        payloads, (drawn and drawn.link_stiffness_factor) or (1.0,), (drawn and drawn.joint_stiffness_factor) or (1.0,)
    ):
        yield replace(
            setup.arm,
            payload=setup.arm.payload if payload is None else fm.Payload(payload),
            gravity=(0.0, 0.0, 0.0),
            links=[replace(link, youngs_modulus=links * link.youngs_modulus, shear_modulus=links * link.shear_modulus)
                   for link in setup.arm.links],
            joints=[replace(joint, stiffness=joint.stiffness and joints * joint.stiffness, viscous_friction=0.0,
                            coulomb_friction=0.0, static_friction=None)
                    for joint in setup.arm.joints],
        )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("name", "condition"), CASES)
def test_the_pd_is_stable_wherever_a_condition_leads(name, condition):
    """All eigenvalues of the sampled, linear loop are within the unit circle, at postures all over the task's range."""
    description = Configuration.find(f"{name}/{condition}")
    setup = description
    model = gym.make(description.id, **description.keywords()).unwrapped.simulator.model
    controller, drawn = make_base("pd", make_plant(setup, model)), setup.disturbances
    delays = range(int(drawn.delay[0]), int(drawn.delay[1]) + 1) if drawn and drawn.delay else (0,)
    random = np.random.default_rng(0)
    reach = sum(getattr(setup.task, part, 0.0) for part in ("start", "slew", "middle"))
    for arm in arms(setup):
        bent = fm.build_model(arm, 2, model.choice.modes)
        for delay in delays:
            for posture in random.uniform(-reach, reach, (3, arm.n_joints)):
                assert largest_eigenvalue(bent, controller, setup.control_period, delay, posture) < 1.0
    assert controller.unstable(model, setup.control_period, max(delays)) == ""


@pytest.mark.slow
@pytest.mark.parametrize(("name", "condition"), [*CASES, *CRANE])
def test_a_condition_suits_every_task_of_its_arm(name, condition):
    """The PD beside an agent that does nothing holds out for two seconds, without a warning."""
    description = Configuration.find(f"{name}/{condition}")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gym.make_vec(
            name, 4, "vector_entry_point", **description.keywords() | {"base": "pd", "horizon": 2.0}
        ).unwrapped
    observations, infos = env.reset(seed=9000)
    for _ in range(env.max_episode_steps):
        observations, _, failed, _, infos = env.step(np.zeros(env.action_space.shape, dtype=np.float32))
        assert not failed.any(), infos["failure"]
        assert not infos["energy_alarm"].any()
    assert observations in env.observation_space


def test_what_a_condition_draws_is_in_its_file():
    lab = Configuration.find("FlexRRR-v0/unknown-lab")
    full = Configuration.find("FlexRRR-v0/unknown")
    assert lab.randomisation == full.randomisation and lab.gains == full.gains
    assert set(full.randomisation.effects) == {
        "payload_mass", "joint_stiffness", "link_stiffness_factor", "delay", "sensor_noise",
    }  # fmt: skip
    assert full.randomisation.payload_mass == (0.0, 20.0) and full.randomisation.sensor_noise == (0.001, 0.001)
    names = gym.make("FlexRRR-v0", sensors=lab.sensors).unwrapped.sensors.slices
    assert list(names) == [
        "motor_angles", "motor_rates", "joint_twists", "joint_twist_rates", "root_strains", "angle_command",
        "rate_command", "tip_command", "tip_velocity_command",
    ]  # fmt: skip


@pytest.mark.parametrize("folder", FOLDERS)
def test_unknown_is_payload_stiffness_and_delay_and_noise_of_a_thousandth_of_the_ranges(folder):
    own, drawn = {}, {name: Configuration.find(f"{FOLDERS[folder]}/{name}").randomisation for name in COMMON}
    for name in ("payload", "stiffness", "delay"):
        own |= {field: getattr(drawn[name], field) for field in drawn[name].given}
    assert own.keys() == {"payload_mass", "joint_stiffness_factor", "link_stiffness_factor", "delay"}
    assert drawn["unknown"] == drawn["unknown-lab"] == Randomisation(**own, sensor_noise=(0.001, 0.001))


@pytest.mark.parametrize("folder", FOLDERS)
def test_everything_is_uncertain_at_once(folder):
    """Friction is that of the condition friction, from none to half as much again; payloads are a quarter larger."""
    drawn, rubbing = (Configuration.find(f"{FOLDERS[folder]}/{name}") for name in ("uncertain", "friction"))
    payload = Configuration.find(f"{FOLDERS[folder]}/payload").randomisation.payload_mass
    assert drawn.arm == rubbing.arm and drawn.randomisation.payload_mass == (0.0, 1.25 * payload[1])
    expected = {
        "payload_mass", "joint_stiffness", "link_stiffness_factor", "viscous_friction", "coulomb_friction", "delay",
        "sensor_noise", "sensor_bias", "gauge_gain", "dropped_samples",
    }  # fmt: skip
    assert set(drawn.randomisation.effects) == expected and drawn.randomisation.coulomb_friction_factor == (0.0, 1.5)


@pytest.mark.parametrize("folder", FOLDERS)
def test_friction_is_all_that_its_arm_has_beside_its_own(folder):
    """In parts of the torque limits that of the PUMA 560, see the file."""
    name = FOLDERS[folder]
    arm, own = Configuration.find(f"{name}/friction").arm, NAMED_ENVIRONMENTS[name].arm
    bare = [replace(joint, viscous_friction=0.0, coulomb_friction=0.0, coulomb_rate=0.01) for joint in arm.joints]
    assert replace(arm, joints=bare) == own
    gears, most = np.array([62.6111, 107.815, 53.7063]), np.array([97.6, 186.4, 89.4])
    viscous, coulomb = np.array([1.48e-3, 0.817e-3, 1.38e-3]) * gears**2, np.array([0.415, 0.0985, 0.1185]) * gears
    limits = np.array([joint.torque_limit for joint in arm.joints])
    kept = slice(3 - arm.n_joints, 3)
    for field, values in (("viscous_friction", viscous), ("coulomb_friction", coulomb)):
        result = [getattr(joint, field) for joint in arm.joints]
        assert result == pytest.approx((values / most)[kept] * limits, rel=0.01)


@pytest.mark.parametrize("folder", FOLDERS)
def test_unmodelled_is_the_arm_of_friction_with_all_that_no_controller_is_given(folder):
    """Undrawn it moves as that arm, within rounding: without play, break-away torque and ripple."""
    rubbing, real = (Configuration.find(f"{FOLDERS[folder]}/{name}") for name in ("friction", "unmodelled"))
    drawn = {*UNMODELLED, "torque_limit", "delay", "sensor_noise"}
    assert set(real.randomisation.effects) == drawn and real.gains == Configuration.find(f"{real.id}/delay").gains
    most = min(joint.torque_limit for joint in real.arm.joints)
    assert real.randomisation.ripple_torque == pytest.approx((0.0, 0.02 * most))
    for joint in real.arm.joints:
        assert joint.stiffness_pieces == ((pytest.approx(0.1 * joint.torque_limit), 1.0),)
    states = []
    for setup in (rubbing, real):
        batch = Batch(fm.build_model(setup.arm, 1, 1), control_period=0.01)
        random = np.random.default_rng(1)
        for _ in range(50):
            torques = random.uniform(-1.0, 1.0, setup.arm.n_joints) * setup.torque_limit
            batch.step(np.concatenate([torques, np.zeros(6)])[None])
        states.append(batch.state[0].copy())
    assert states[0] == pytest.approx(states[1], rel=1e-6, abs=1e-9)


def test_all_files_are_there_and_no_others():
    for folder in FOLDERS:
        names = {path.stem for path in (CONDITION_FOLDER / folder).iterdir()}
        assert names == {*COMMON} - {"nominal"}


@pytest.mark.parametrize("condition", [each for each in condition_names("FlexPlanar-v0") if each not in UNSTABLE])
def test_a_condition_is_a_keyword_too_and_what_is_given_beside_it_goes_before(condition):
    expected = Configuration.find(f"FlexPlanar-v0/{condition}")
    for made in (
        gym.make("FlexPlanar-v0", condition=condition, action_repeat=2),
        gym.make_vec("FlexPlanar-v0", 2, "vector_entry_point", condition=condition, action_repeat=2),
    ):
        setup = made.unwrapped.configuration
        assert (setup.arm, setup.randomisation, setup.gains) == (expected.arm, expected.randomisation, expected.gains)
        assert setup.sensors == expected.sensors and setup.action_repeat == 2
    own = gym.make("FlexPlanar-v0", condition=condition, randomisation={"delay": (3, 3)}).unwrapped.configuration
    assert own.randomisation == Randomisation(delay=(3, 3)) and own.arm == expected.arm
    described = Configuration("FlexPlanar-v0", {"condition": condition, "horizon": 1.0})
    assert described.arm == expected.arm and "condition" not in described.to_plain()


def test_a_condition_that_is_set_later_takes_the_place_of_what_was_drawn_before():
    described = Configuration("FlexPlanar-v0", {"condition": "payload", "action_repeat": 2}).changed(
        ["condition=delay"]
    )
    assert described.randomisation == Randomisation(delay=(1, 1)) and described.action_repeat == 2
    assert described.gains == Configuration.find("FlexPlanar-v0/delay").gains


# A PD that says when it is unstable


@pytest.mark.parametrize("delay", [0, 1, 2, 5])
def test_the_limit_is_where_the_delayed_rate_grows(delay):
    """The rate of a motor follows r' = r - a r of so many periods ago: roots of z^(k + 1) - z^k + a."""

    def growth(a):
        return np.abs(np.roots([1.0, -1.0, *[0.0] * (delay - 1), a] if delay else [1.0, a - 1.0])).max()

    limit = stability_limit(delay)
    assert growth(0.999 * limit) < 1.0 < growth(1.001 * limit)


def test_a_pd_says_when_sampling_and_delay_make_it_unstable():
    model = gym.make("FlexRRR-v0").unwrapped.simulator.model
    controller = PD([500.0] * 3, [900.0, 400.0, 100.0], 400.0)
    assert controller.unstable(model, 0.02) == ""
    said = controller.unstable(model, 0.02, 1)
    assert said.startswith(
        "PD.damping[0]: 900 N m s/rad is not stable with a period of 0.02 s and a delay of 1 periods"
    )
    assert "less than 1, which is 500 N m s/rad" in said
    assert "PD.damping[0]" in controller.unstable(model, 0.05)
    with pytest.warns(UserWarning, match=r"PD.damping\[0\]: 472 N m s/rad is not stable"):
        gym.make("FlexRRR-v0", base="pd", randomisation={"delay": (0, 2)})


def test_gains_of_ones_own_suit_any_arm():
    gains = {"stiffness": (5.0, 2.0), "damping": (1.0, 0.5)}
    env = gym.make("FlexRRR-v0", arm=fm.catalog.vertical_2r(), torque_limit=(12.0, 4.0), base="pd", gains=gains)
    assert env.unwrapped.episodes.base.stiffness.tolist() == [5.0, 2.0]
