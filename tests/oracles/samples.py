"""Samples: small arms, models and environments, good arguments of public functions, and calls that use them."""

import gymnasium as gym
import numpy as np

import flexman_gym as fm
from flexman_gym.simulation.batch import Batch

ARM = fm.catalog.planar_2r(joint_stiffness=20.0)
LINK, JOINT = ARM.links[0], ARM.joints[0]
CHOICE, TWO = fm.ModelChoice(True, 1), [0.1, -0.2]
SCENE = fm.Scene(ARM, CHOICE, fm.ConstantTorque([0.1, 0.0]), fm.Initial(TWO, [0.0] * 2), 0.02, 0.01)
MODEL, RIGID = fm.build_model(ARM, 1), fm.build_model(ARM, 1, flexible_links=False, flexible_joints=False)
STATE = np.zeros(2 * MODEL.n_dof)
ONE = gym.make("FlexOne-v0", randomisation={"payload_mass": (0.0, 0.1)}).unwrapped
MANY = gym.make_vec("FlexOne-v0", 2, "vector_entry_point", randomisation={"payload_mass": (0.0, 0.1)}).unwrapped
SIMULATOR, BATCH = fm.Simulator(MODEL), Batch(MODEL, arms=2)
TRAJECTORY = fm.simulate(SCENE)
TIPS, TIMES = np.cumsum(np.ones((200, 3)), axis=0) / 200, 0.02 * np.arange(200)
WAVE = np.exp(-TIMES) * np.cos(20.0 * TIMES)
LARGEST = 64  # arms, elements and threads; more are allowed and take their time


def stepped(env):
    """An environment after a reset and a step, with what both gave."""
    first = env.reset(seed=0)
    result = first, env.step(np.zeros(env.action_space.shape, dtype=np.float32))
    env.close()
    return result


def made(**keywords):
    """What an environment with some settings gives."""
    return stepped(gym.make("FlexOne-v0", disable_env_checker=True, **keywords).unwrapped)


def made_many(**keywords):
    """What a vector environment with some settings gives."""
    return stepped(gym.make_vec("FlexOne-v0", vectorization_mode="vector_entry_point", **keywords).unwrapped)


def moved(**arguments):
    """A step of a simulator with some arguments."""
    simulator = fm.Simulator(**arguments)
    status = simulator.step(np.zeros(simulator.model.n_joints))
    return simulator, (simulator.explanation() if status != "ok" else "")


def fresh(simulator=SIMULATOR):
    """The simulator, after a reset."""
    simulator.reset()
    return simulator


def restarted(**arguments):
    """The simulator after a reset with some arguments."""
    SIMULATOR.reset(**arguments)
    return SIMULATOR


def played(**arguments):
    """A step of an environment in an episode."""
    ONE.reset(seed=0)
    return ONE.step(**arguments)


def played_many(**arguments):
    """A step of a vector environment in an episode."""
    MANY.reset(seed=0)
    return MANY.step(**arguments)


def batched(**arguments):
    """A batch with some arguments after a step."""
    batch = Batch(**arguments)
    batch.step(np.zeros((len(batch.rows), batch.model.n_joints + 6)))
    return batch.rows, batch.outputs, batch.status


def varied(**parameters):
    """Parameters of two arms."""
    BATCH.vary(np.arange(2), **parameters)
    return BATCH.rows


def arm_of(joint_stiffness, rotor_inertia, damping, gravity, payload, modal_damping_ratio, **link):
    """An arm of one joint and two links that are alike."""
    orientation = LINK.orientation
    links = [fm.Link(**link, orientation=orientation)] * 2
    joints = [fm.Joint((0.0, 0.0, 1.0), rotor_inertia, joint_stiffness, damping)] * 2
    return fm.Arm(links, joints, fm.Payload(payload), (0.0, gravity, 0.0), modal_damping_ratio=modal_damping_ratio)


def simulated(torque, step, duration, method, **parts):
    """A simulation of an arm with some parts."""
    scene = fm.Scene(arm_of(**parts), CHOICE, fm.ConstantTorque([torque] * 2), SCENE.initial, duration, duration)
    return fm.simulate(scene, None, method, step)


def analysed(**parts):
    """What is calculated of an arm with some parts at an instant."""
    model, torque = fm.build_model(arm_of(**parts), 1), [0.1, 0.0]
    state = fm.rest_state(model, TWO)
    return (
        model, state, fm.frequencies(model), fm.frequencies(model, lock_joints=True), fm.mass_matrix(model, state),
        fm.holding_torques(model, TWO), fm.acceleration(model, state, torque), fm.linearize(model, state=state),
        fm.tip_acceleration(model, state, torque), fm.strain(model, state, 0, 0.0),
    )  # fmt: skip


def controlled(base, torque_limit, control_period, **parts):
    """An environment with an arm of some parts."""
    arm, gains = arm_of(**parts), {"stiffness": [5.0, 5.0], "damping": [1.0, 1.0]}
    env = gym.make("FlexPlanar-v0", disable_env_checker=True, arm=arm, base=base, gains=gains,
                   torque_limit=torque_limit, control_period=control_period)  # fmt: skip
    return stepped(env.unwrapped)


def fields_of(made_of):
    """The values of a dataclass by name."""
    return {name: value for name, value in vars(made_of).items() if not name.startswith("_")}


SETTINGS = {
    "arm": fm.catalog.one_link(rotor_inertia=0.5), "task": "slew", "sensors": "full", "history": 2,
    "limits": fm.Limits(), "torque_limit": 1.0, "control_period": 0.02, "horizon": 1.0, "base": None,
    "gains": {"stiffness": [5.0], "damping": [2.0]}, "hold": 2, "elements": 2, "modes": "assembled", "step": None,
    "method": "midpoint_3_sweeps", "stiffening": False, "spinning_rotors": False, "rotary_inertia": True,
    "tell": ("joint_angles",), "energy_alarm": 0.01, "tolerance": None, "fidelity": "default",
    "randomisation": {"payload_mass": (0.0, 0.1), "delay": (0, 2), "sensor_noise": (0.0, 0.01), "impulse_gap": 1.0},
}  # fmt: skip
DESCRIBED = {
    "id": "FlexOne-v0", "arm": {"catalog": "one_link", "rotor_inertia": 0.5}, "torque_limit": 1.0,
    "task": {"kind": "slew", "start": 0.3},
    "limits": {"angle": 4.0}, "sensors": [{"kind": "lab", "noise": 0.01, "delay": 1}], "horizon": 2.0,
    "randomisation": {"payload_mass": [0.0, 0.1]}, "modes": [3], "history": 2, "base": "pd",
    "gains": {"stiffness": [5.0], "damping": [2.0]},
}  # fmt: skip
TRAINING = {
    "algo": "ppo", "environment": DESCRIBED, "steps": 1000, "seed": 1, "envs": 2, "normalise_reward": True,
    "hyperparameters": {"n_steps": 8, "gamma": 0.99, "learning_rate": 1e-3, "activation": "relu", "net_arch": [8]},
    "schedules": {"learning_rate": {"start": 1e-2, "end": 0.0, "until": 0.5}}, "judge_every": 60,
}  # fmt: skip
EFFECTS = {
    "payload_mass": (0.0, 0.1), "joint_stiffness_factor": (0.8, 1.2), "link_stiffness_factor": (0.8, 1.2),
    "delay": (0, 2), "rotor_inertia_factor": (0.9, 1.1), "joint_damping": (0.0, 0.1),
    "torque_limit_factor": (0.9, 1.1), "sensor_noise": (0.0, 0.01),
    "initial_vibration": (0.0, 0.01), "tip_impulse": (0.0, 0.1), "tip_load": (0.0, 0.1), "base_sway": (0.0, 0.1),
    "impulse_gap": 0.5,
}  # fmt: skip
OPTIONS = {"start": [0.1], "goal_angles": [0.2], "parameters": {"payload_mass": 0.05, "joint_stiffness": [3.0]}}
BODY = {"mass": 0.5, "inertia": np.eye(3).tolist(), "offset": [0.0, 0.0, 0.1]}
AT = {"model": MODEL, "state": STATE}

PARTS = {name: value for name, value in fields_of(LINK).items() if name != "orientation"} | {
    "joint_stiffness": 20.0, "rotor_inertia": 0.1, "damping": 0.1, "gravity": -9.81, "payload": 0.1,
    "modal_damping_ratio": 0.005,
}  # fmt: skip
RUN = {"torque": 0.1, "step": 1e-3, "duration": 0.01, "method": "ros2"}
