"""PPO of Tianshou by its high-level interface."""

import tempfile

import torch
from report import ENVIRONMENT, SETTINGS, report
from tianshou.highlevel.config import OnPolicyTrainingConfig
from tianshou.highlevel.env import EnvFactoryRegistered, VectorEnvType
from tianshou.highlevel.experiment import ExperimentConfig, PPOExperimentBuilder
from tianshou.highlevel.params.algorithm_params import PPOParams

factory = EnvFactoryRegistered(task=ENVIRONMENT, venv_type=VectorEnvType.DUMMY, **SETTINGS)
training = OnPolicyTrainingConfig(
    max_epochs=2, epoch_num_steps=10_000, num_training_envs=4, num_test_envs=2, collection_step_num_env_steps=2048,
    batch_size=64, update_step_num_repetitions=10,
)  # fmt: skip
with tempfile.TemporaryDirectory() as folder:
    config = ExperimentConfig(seed=0, device="cpu", watch=False, persistence_enabled=False, persistence_base_dir=folder)
    experiment = (
        PPOExperimentBuilder(factory, config, training)
        .with_ppo_params(PPOParams(lr=3e-4, gae_lambda=0.95))
        .with_actor_factory_default(hidden_sizes=(64, 64))
        .with_critic_factory_default(hidden_sizes=(64, 64))
        .build()
    )
    world = experiment.create_experiment_world()

    def act(observation):
        """Return the most probable action."""
        policy = world.algorithm.policy
        with torch.no_grad():
            return policy.map_action(policy.compute_action(observation))

    report("Tianshou PPO", act, world.trainer.run)
