"""Settings of training runs that take a second and use every stored quantity."""

from flexman_agents.settings import Settings
from flexman_gym.common.run_folder import NEWEST, read_npz

SHORT = {"learning_starts": 40, "batch_size": 16, "gradient_steps": 2, "buffer_size": 120}
ENVIRONMENT = {
    "id": "FlexOne-v0", "base": "pd", "action_repeat": 3, "sensors": ["full", "fine"], "horizon": 0.6,
    "randomisation": {
        "payload_mass": [0.0, 0.1], "delay": [0, 2], "sensor_noise": [0.0, 0.01], "tip_impulse": [0.0, 0.01],
        "torque_limit_factor": [0.9, 1.1],
    },
}  # fmt: skip
RUNS = {
    "ppo": Settings(
        "ppo", ENVIRONMENT, 160, seed=2, envs=3, hyperparameters={"n_steps": 8, "batch_size": 12, "net_arch": [8]},
        schedules={"learning_rate": {"start": 1e-2, "end": 0.0}, "log_std": {"start": -1.0, "end": -4.0}},
        eval_every=60,
    ),
    **{algo: Settings(
        algo, ENVIRONMENT, 150, seed=2, envs=3, normalise_reward=False, hyperparameters=SHORT | own,
        schedules={"learning_rate": {"start": 1e-2, "end": 0.0}, "target_entropy": {"start": -1.0, "end": -4.0}},
        eval_every=60,
    ) for algo, own in {
        "sac": {"net_arch": [8]},
        "tqc": {"net_arch": {"pi": [8], "qf": [12]}, "critic_norm": True, "n_quantiles": 5},
        "crossq": {"net_arch": {"pi": [8, 8], "qf": [12]}, "policy_delay": 3},
    }.items()},
}  # fmt: skip


def bits(folder):
    """Return the arrays of the policy of a run as bytes."""
    return {name: values.tobytes() for name, values in read_npz(folder / NEWEST)["policy"].items()}
