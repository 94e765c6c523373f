"""Targets of the fuzz test: calls of public functions with valid arguments for small arms, models and environments."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import gymnasium as gym
import numpy as np

import flexman_gym as fm
from flexman_agents.settings import Settings
from flexman_gym import metrics
from flexman_gym.agent.pd import PD
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.tasks import Hold, Track
from flexman_gym.simulation.batch import Batch
from flexman_gym.toolbox.controllers.lqr import LQR, TrackingLQR

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
    """Return an environment after a reset and a step, with the results of both."""
    first = env.reset(seed=0)
    result = first, env.step(np.zeros(env.action_space.shape, dtype=np.float32))
    env.close()
    return result


def made(**keywords):
    """Return the results of an environment with some settings."""
    return stepped(gym.make("FlexOne-v0", disable_env_checker=True, **keywords).unwrapped)


def made_many(**keywords):
    """Return the results of a vector environment with some settings."""
    return stepped(gym.make_vec("FlexOne-v0", vectorization_mode="vector_entry_point", **keywords).unwrapped)


def moved(**arguments):
    """Return the result of a step of a simulator with given arguments."""
    simulator = fm.Simulator(**arguments)
    status = simulator.step(np.zeros(simulator.model.n_joints))
    return simulator, (simulator.explanation() if status != "ok" else "")


def fresh(simulator=SIMULATOR):
    """Return a simulator after a reset."""
    simulator.reset()
    return simulator


def restarted(**arguments):
    """Return a simulator after a reset with given arguments."""
    SIMULATOR.reset(**arguments)
    return SIMULATOR


def played(**arguments):
    """Return the result of a step of an environment."""
    ONE.reset(seed=0)
    return ONE.step(**arguments)


def played_many(**arguments):
    """Return the result of a step of a vector environment."""
    MANY.reset(seed=0)
    return MANY.step(**arguments)


def batched(**arguments):
    """Return a batch with given arguments after a step."""
    batch = Batch(**arguments)
    batch.step(np.zeros((len(batch.rows), batch.model.n_joints + 6)))
    return batch.rows, batch.outputs, batch.status


def varied(**parameters):
    """Return parameters of two arms."""
    BATCH.vary(np.arange(2), **parameters)
    return BATCH.rows


def arm_of(joint_stiffness, rotor_inertia, damping, gravity, payload, modal_damping_ratio, **link):
    """Return an arm of one joint and two equal links."""
    orientation = LINK.orientation
    links = [fm.Link(**link, orientation=orientation)] * 2
    joints = [fm.Joint((0.0, 0.0, 1.0), rotor_inertia, joint_stiffness, damping)] * 2
    return fm.Arm(links, joints, fm.Payload(payload), (0.0, gravity, 0.0), modal_damping_ratio=modal_damping_ratio)


def simulated(torque, step, duration, method, **parts):
    """Return the simulation of an arm with given parts."""
    scene = fm.Scene(arm_of(**parts), CHOICE, fm.ConstantTorque([torque] * 2), SCENE.initial, duration, duration)
    return fm.simulate(scene, None, method, step)


def analysed(**parts):
    """Return the quantities of an arm with some parts at an instant."""
    model, torque = fm.build_model(arm_of(**parts), 1), [0.1, 0.0]
    state = fm.rest_state(model, TWO)
    return (
        model, state, fm.frequencies(model), fm.frequencies(model, lock_joints=True), fm.mass_matrix(model, state),
        fm.holding_torques(model, TWO), fm.acceleration(model, state, torque), fm.linearize(model, state=state),
        fm.tip_acceleration(model, state, torque), fm.strain(model, state, 0, 0.0),
    )  # fmt: skip


def controlled(base, torque_limit, control_period, **parts):
    """Return an environment of an arm with given parts."""
    arm, gains = arm_of(**parts), {"stiffness": [5.0, 5.0], "damping": [1.0, 1.0]}
    env = gym.make("FlexPlanar-v0", disable_env_checker=True, arm=arm, base=base, gains=gains,
                   torque_limit=torque_limit, control_period=control_period)  # fmt: skip
    return stepped(env.unwrapped)


def fields_of(made_of):
    """Return the fields of a dataclass by name."""
    computed = {name for name, each in vars(type(made_of)).items() if isinstance(each, cached_property)}
    return {name: value for name, value in vars(made_of).items() if not name.startswith("_") and name not in computed}


SETTINGS = {
    "arm": fm.catalog.one_link(rotor_inertia=0.5), "task": "slew", "sensors": "full", "history": 2,
    "limits": fm.Limits(), "torque_limit": 1.0, "control_period": 0.02, "horizon": 1.0, "base": None,
    "gains": {"stiffness": [5.0], "damping": [2.0]}, "action_repeat": 2, "elements": 2, "modes": "assembled",
    "step": None, "method": "midpoint_3", "stiffening": False, "spinning_rotors": False,
    "rotary_inertia": True,
    "info_keys": ("joint_angles",), "energy_alarm": 0.01, "tolerance": None, "fidelity": "default",
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
    "schedules": {"learning_rate": {"start": 1e-2, "end": 0.0, "until": 0.5}}, "eval_every": 60,
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


@dataclass(frozen=True)
class Target:
    """Call with valid arguments.

    Attributes:
        call: called function.
        good: valid arguments.
        numbers: names of arguments that must be numbers, or arrays or lists of numbers.
        open_to: allow infinite or NaN results.
        weight: relative frequency of the call.
    """

    call: Callable[..., Any]
    good: dict[str, Any]
    numbers: tuple[str, ...] = ()
    open_to: bool = False
    weight: float = 1.0
    cost: dict[str, float] = field(default_factory=dict)  # name -> number beyond which a call is allowed but long


TARGETS = {
    "an arm": Target(analysed, PARTS, tuple(set(PARTS) - {"joint_stiffness"}), weight=6.0),
    "a simulation": Target(
        simulated, PARTS | RUN, (*(set(PARTS) - {"joint_stiffness"}), "torque", "duration"), weight=8.0,
        cost={"duration": 1.0},
    ),
    "an environment": Target(
        controlled, PARTS | {"base": "lqr", "torque_limit": 20.0, "control_period": 0.02},
        ("torque_limit", "control_period"), weight=6.0, cost={"control_period": 1.0},
    ),
    "Settings": Target(Settings.from_dict, {"data": TRAINING}, weight=3.0),
    "Link": Target(fm.Link, fields_of(LINK), tuple(fields_of(LINK)), weight=2.0),
    "Joint": Target(fm.Joint, fields_of(JOINT), ("axis", "rotor_inertia", "damping"), weight=2.0),
    "Payload": Target(fm.Payload, BODY, tuple(BODY)),
    "Arm": Target(fm.Arm, fields_of(ARM), ("gravity", "modal_damping_ratio"), weight=2.0),
    "NonUniformLink": Target(fm.NonUniformLink, {"sections": [LINK, LINK]}),
    "ModelChoice": Target(fm.ModelChoice, fields_of(CHOICE)),
    "ConstantTorque": Target(fm.ConstantTorque, {"value": TWO}, ("value",)),
    "SineTorque": Target(fm.SineTorque, {"amplitude": TWO, "frequency_hz": [1.0, 2.0], "phase": TWO}, ("phase",)),
    "Signal": Target(fm.Signal, fields_of(fm.Signal(1.0)), ("offset", "amplitude", "frequency", "phase")),
    "SampledTorque": Target(
        fm.SampledTorque, {"times": [0.0, 0.1], "values": [TWO, TWO], "hold": "linear"}, ("times", "values"),
    ),
    "SampledSignal": Target(fm.SampledSignal, {"times": [0.0, 0.1], "values": [1.0, 2.0]}, ("times", "values")),
    "SampledAngles": Target(
        fm.SampledAngles, {"times": [0.0, 0.1, 0.2, 0.4], "angles": [0.0, 1.0, 1.0, 2.0], "deviation": 0.01},
        ("times", "angles", "deviation"),
    ),
    "Initial": Target(fm.Initial, {"joint_angles": TWO, "joint_rates": TWO}, ("joint_angles", "joint_rates")),
    "Scene": Target(fm.Scene, fields_of(SCENE), ("duration", "output_step"), weight=2.0),
    "Scene.from_dict": Target(fm.Scene.from_dict, {"data": SCENE.to_dict()}, weight=4.0),
    "Limits": Target(fm.Limits, fields_of(fm.Limits()), tuple(fields_of(fm.Limits()))),
    "Randomisation": Target(fm.Randomisation, EFFECTS, weight=2.0),
    "Slew": Target(fm.Slew, fields_of(fm.Slew()), ("start", "slew", "failure_penalty")),
    "Track": Target(Track, fields_of(Track()), ("size", "period", "middle", "failure_penalty")),
    "Hold": Target(Hold, fields_of(Hold()), ("start", "impulse", "load", "sway", "gap")),
    "catalog.paper_rrr": Target(fm.catalog.paper_rrr, {"link1_area": "printed", "rotor_inertia": 1.0}),
    "catalog.planar_2r": Target(fm.catalog.planar_2r, {"joint_stiffness": 20.0, "payload": fm.Payload(0.1)}),
    "catalog.paper_scene": Target(fm.catalog.paper_scene, {"case": "ff"}),
    "build_model": Target(
        fm.build_model, {"arm": ARM, "elements": (1, 2), "modes": (3, 2), "flexible_links": True,
                         "flexible_joints": True, "stiffening": False, "spinning_rotors": False},
        ("elements",), weight=2.0, cost={"elements": LARGEST},
    ),
    "frequencies": Target(fm.frequencies, {"model": MODEL, "joint_angles": TWO, "lock_joints": False}),
    "linearize": Target(fm.linearize, {"model": MODEL, "state": STATE, "torque": TWO}),
    "mass_matrix": Target(fm.mass_matrix, AT, ("state",), weight=2.0),
    "acceleration": Target(fm.acceleration, AT | {"torque": TWO}, ("state", "torque"), weight=2.0),
    "tip_acceleration": Target(fm.tip_acceleration, AT | {"torque": TWO}, ("state", "torque")),
    "rest_state": Target(fm.rest_state, {"model": MODEL, "motor_angles": TWO}, ("motor_angles",)),
    "holding_torques": Target(fm.holding_torques, {"model": MODEL, "motor_angles": TWO}, ("motor_angles",)),
    "inverse_dynamics": Target(
        fm.inverse_dynamics, {"model": RIGID, "joint_angles": TWO, "joint_rates": TWO, "joint_accelerations": TWO},
        ("joint_angles", "joint_rates", "joint_accelerations"), weight=2.0,
    ),
    "curvature": Target(fm.curvature, AT | {"link": 0, "position": 0.1}, ("state", "link", "position")),
    "strain": Target(fm.strain, AT | {"link": 0, "position": 0.1, "y": 0.01, "z": 0.0}, ("state", "link", "y", "z")),
    "choose_model": Target(fm.choose_model, {"scene": SCENE, "tolerance": 0.1, "longest_step": 0.01},
                           ("tolerance",), weight=0.3),
    "generalised_alpha": Target(fm.generalised_alpha, {"radius": 0.8}, ("radius",), weight=0.5),
    "simulate": Target(
        fm.simulate, {"scene": SCENE, "model": MODEL, "method": "ros2", "step": 0.001, "rtol": 1e-6, "atol": 1e-9},
        ("rtol", "atol"), weight=2.0,
    ),
    "simulate_all": Target(
        fm.simulate_all, {"scenes": [SCENE, SCENE], "model": MODEL, "method": "ros2", "step": 0.001, "threads": 1,
                          "payload_mass": [0.1, 0.2], "joint_stiffness": [[20.0, 20.0]] * 2},
        ("threads", "payload_mass", "joint_stiffness"), weight=2.0, cost={"threads": 8},
    ),
    "Simulator": Target(
        moved, {"model": MODEL, "method": "ros2", "step": 0.005, "control_period": 0.02, "rtol": 1e-6, "atol": 1e-9,
                "prescribed": [0]}, ("control_period", "rtol", "atol"), weight=2.0, cost={"control_period": 1.0},
    ),
    "Simulator.reset": Target(restarted, {"joint_angles": TWO, "joint_rates": TWO}),
    "Simulator.reset state": Target(restarted, {"state": STATE}, weight=2.0),
    "Simulator.step": Target(
        lambda **given: (fresh().step(**given), SIMULATOR, SIMULATOR.explanation()),
        {"torque": TWO, "tip_force": [0.1] * 3, "base_acceleration": [0.1] * 3, "acceleration": [0.0, 0.0]},
        ("torque",), weight=3.0,
    ),
    "Batch": Target(
        batched, {"model": MODEL, "method": "ros2", "step": 0.005, "control_period": 0.02, "arms": 2, "threads": 1},
        ("arms", "threads", "control_period"), cost={"arms": LARGEST, "threads": 8, "control_period": 1.0},
    ),
    "Batch.vary": Target(
        varied, {"payload_mass": np.array([0.1, 0.2]), "joint_stiffness": np.full((2, 2), 20.0),
                 "joint_damping": np.zeros((2, 2)), "link_stiffness_factor": np.ones((2, 2))},
        ("payload_mass", "joint_stiffness", "joint_damping", "link_stiffness_factor"), weight=2.0,
    ),
    "Trajectory.energy_alarm": Target(TRAJECTORY.energy_alarm, {"level": 0.01}, ("level",), weight=0.5),
    "PD": Target(
        PD, {"stiffness": [5.0, 2.0], "damping": [1.0, 1.0], "torque_limit": [1.0, 2.0], "gravity_model": MODEL}
    ),
    "LQR": Target(LQR, {"model": MODEL, "torque_limit": 1.0, "period": 0.01}, ("torque_limit", "period")),
    "TrackingLQR": Target(TrackingLQR, {"model": MODEL, "torque_limit": 1.0, "period": 0.01}, ("torque_limit",)),
    "gym.make": Target(
        made, SETTINGS, ("control_period", "horizon", "action_repeat", "energy_alarm", "torque_limit"), weight=6.0,
        cost={"elements": LARGEST, "control_period": 1.0},
    ),
    "gym.make_vec": Target(
        made_many, SETTINGS | {"num_envs": 3, "threads": 1, "autoreset_mode": "NextStep", "max_episode_steps": 9},
        ("num_envs", "threads", "control_period", "horizon"), weight=4.0,
        cost={"elements": LARGEST, "num_envs": LARGEST, "threads": 8, "control_period": 1.0},
    ),
    "env.reset": Target(ONE.reset, {"seed": 3, "options": OPTIONS}, weight=5.0),
    "env.step": Target(played, {"action": np.zeros(1, np.float32)}, ("action",), weight=3.0),
    "env.set_state": Target(ONE.set_state, {"state": ONE.get_state()}, weight=2.0),
    "venv.reset": Target(MANY.reset, {"seed": [3, 4], "options": OPTIONS}, weight=5.0),
    "venv.step": Target(played_many, {"actions": np.zeros((2, 1), np.float32)}, ("actions",), weight=3.0),
    "Configuration": Target(Configuration.from_plain, {"data": DESCRIBED}, weight=4.0),
    "Configuration.find": Target(lambda name: Configuration.find(name), {"name": "FlexRRR-v0/unknown"}),
    "Configuration.changed": Target(
        lambda changes: Configuration.from_plain(DESCRIBED).changed(changes),
        {"changes": ["horizon=2.0", "arm.payload.mass=0.1"]}, weight=2.0,
    ),
    "settling_time": Target(
        metrics.settling_time, {"errors": 1.0 / (1.0 + TIMES), "band": 0.5, "period": 0.02, "since": "start"},
        ("band", "period"), open_to=True,
    ),
    "overshoot": Target(metrics.overshoot, {"errors": np.abs(WAVE), "band": 0.5}, ("band",), open_to=True),
    "attained_distances": Target(metrics.attained_distances, {"tips": TIPS, "period": 0.02}, ("tips", "period")),
    "band_of_move": Target(metrics.move_band, {"errors": 1.0 - WAVE / 2.0, "fraction": 0.05}, ("fraction",)),
    "final_error": Target(metrics.final_error, {"errors": np.abs(WAVE), "period": 0.02}, ("period",), open_to=True),
    "rms": Target(metrics.rms, {"values": TIPS}, ("values",)),
    "squared_acceleration": Target(metrics.squared_acceleration, {"accelerations": TIPS, "period": 0.02},
                                   ("accelerations", "period")),
    "peak_to_peak": Target(metrics.peak_to_peak, {"tips": TIPS, "period": 0.02, "window": 3.0}, ("period", "window"),
                           open_to=True),
    "residual_vibration": Target(
        metrics.residual_vibration, {"tips": TIPS, "unshaped": TIPS, "period": 0.02, "end": 1.0},
        ("tips", "unshaped", "period", "end"),
    ),
    "damping_ratio": Target(metrics.damping_ratio, {"signal": WAVE}, ("signal",), open_to=True),
    "energy_left": Target(
        metrics.remaining_energy, {"energies": np.abs(WAVE) + 1e-3, "reference": "largest"}, ("energies",)
    ),
    "effort": Target(metrics.effort, {"actions": TIPS}, open_to=True),
    "power_above": Target(metrics.high_frequency_power, {"actions": TIPS, "period": 0.02, "frequency": 5.0},
                          ("actions", "period", "frequency")),
    "median_interval": Target(
        metrics.median_interval, {"values": WAVE, "level": 0.95, "draws": 100}, ("level", "draws"), open_to=True,
        cost={"draws": 10**5},
    ),
}  # fmt: skip
