"""Hints: option names of other libraries, and the settings with the same meaning."""

HINTS = {
    "gravity": 'it to the arm, as gravity belongs to it: arm=fm.Arm(..., gravity=(0, 0, -9.81)), or arm={"catalog": '
    '"planar_2r", "gravity": [0, 0, -9.81]}',
    "payload": "it to the arm, which carries it: arm=fm.Arm(..., payload=fm.Payload(0.5))",
    "damping": "it to the arm, whose links and joints are damped: arm=fm.Arm(..., modal_damping_ratio=0.01)",
    "delay": 'randomisation={"delay": (1, 1)}, the fewest and the most control periods by which torques come late',
    "max_steps": "horizon, the time in s after which an episode is truncated",
    "max_episode_length": "horizon, the time in s after which an episode is truncated",
    "frame_skip": "hold, the control periods for which an action is kept",
    "action_repeat": "hold, the control periods for which an action is kept",
    "dt": "control_period, the time in s between two actions, or step, that of the integrator",
    "timestep": "control_period, the time in s between two actions, or step, that of the integrator",
    "obs_type": "sensors",
    "observation": "sensors",
    "noise": 'randomisation={"sensor_noise": ...}, or sensors with flaws',
    "reward": 'a task, such as task={"kind": "slew", "reward": "distance"}',
    "seed": "it to reset(seed=...)",
}
