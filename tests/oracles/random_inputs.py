"""Random states and drives for tests of batches."""

import numpy as np


def states_of(model, arms, seed=0):
    """Return random states of arms with turning joints, small deflections and vibrating rotors."""
    random = np.random.default_rng(seed)
    states = 1e-3 * random.normal(size=(arms, 2 * model.n_dof))
    turned = random.uniform(-1.0, 1.0, (arms, model.n_joints))
    states[:, : model.n_joints] += turned
    states[:, model.motor_columns] += turned
    return states


def drives(arms, steps, seed=1):
    """Return random torques, tip forces and base accelerations (steps, b, n + 6)."""
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (steps, arms, 9)) * ([400.0] * 3 + [20.0] * 3 + [1.0] * 3)


EVERYTHING = {
    "payload_mass": (0.0, 5.0), "joint_stiffness_factor": (0.8, 1.2), "link_stiffness_factor": (0.8, 1.2),
    "rotor_inertia_factor": (0.9, 1.1), "joint_damping": (0.0, 20.0), "torque_limit_factor": (0.9, 1.1),
    "sensor_noise": (0.0, 0.01), "sensor_bias": (-0.01, 0.02), "gauge_gain_factor": (0.9, 1.1),
    "dropped_samples": (0.0, 0.2), "delay": (0, 3), "initial_vibration": (0.0, 0.01), "tip_impulse": (0.0, 5.0),
    "tip_load": (0.0, 10.0),
    "base_sway": (0.0, 0.2), "impulse_gap": 0.2,
}  # fmt: skip
FRICTION = {  # and damping of links, of an arm that has some
    "viscous_friction_factor": (0.5, 1.5), "coulomb_friction_factor": (0.5, 1.5), "link_damping_factor": (0.5, 1.5),
    "coulomb_rate": (0.003, 0.03), "static_excess": (0.0, 0.5), "stribeck_rate": (0.005, 0.05),
}  # fmt: skip
GEARS = {"backlash": (0.0, 2e-3), "soft_stiffness": (0.5, 1.0), "ripple_torque": (0.0, 8.0)}  # of an arm that has them
ALL_PARTS = ("motor_encoders", "joint_encoders", "strain", "accelerometer", "tip", "command")
FLAWED = {"kind": "lab", "noise": 0.002, "bias": 0.001, "quantisation": 1e-4, "delay": 1, "every": 2, "dropped": 0.2}


def asked_after_a_state(one, other, before, after):
    """Return the torques asked for by an environment with two motors, and by another that was given its state."""
    still, asked = np.zeros(2, dtype=np.float32), []
    one.reset(seed=1)
    for _ in range(before):
        one.step(still)
    other.reset(seed=2)
    other.set_state(one.get_state())
    for env in (one, other):
        rows = []
        for _ in range(after):
            env.step(still)
            rows.append(env.episodes.view.action.copy())
        asked.append(rows)
    return asked


def actions(arms, steps, seed=0):
    """Yield small random torques, sometimes at the motor limits."""
    random = np.random.default_rng(seed)
    for step in range(steps):
        action = random.uniform(-1.0, 1.0, (arms, 3)).astype(np.float32)
        yield np.sign(action) if step % 40 > 20 else 0.2 * action
