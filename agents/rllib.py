"""RLlib: the recipes of PPO on Ray's library, with runners that keep the arrays of the vector environment whole."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import torch
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig
from ray.tune.registry import register_env

from flexman_agents.array_runner import ArrayRunner, Moments, make_arms
from flexman_agents.record import keep_settings
from flexman_agents.settings import EXPLORATION, HYPERPARAMETERS, Settings
from flexman_gym.checks import refusal, whole_number
from flexman_gym.evaluation.folder import NEWEST, locked, write_data
from flexman_gym.evaluation.seeds import training_seed
from flexman_gym.evaluation.workers import cluster, paths

CHECKPOINTS = "rllib"  # the folder of them
NAMES = {"n_steps": "", "batch_size": "minibatch_size", "n_epochs": "num_epochs", "gamma": "gamma",
         "gae_lambda": "lambda_", "clip_range": "clip_param", "ent_coef": "entropy_coeff",
         "vf_coef": "vf_loss_coeff", "max_grad_norm": "grad_clip"}  # fmt: skip
POLICY = ("net_arch", "activation", "log_std_init", "learning_rate", "ortho_init")
OURS = {"encoder.actor_encoder.net.mlp.": "mlp_extractor.policy_net.", "pi.net.mlp.0.": "action_net."}


def configure(settings: Settings, runners: int) -> PPOConfig:
    """Translates the settings of a run.

    Raises:
        ValueError: one line, for SAC, for hyperparameters and arms that have no translation, and for a judge.
    """
    if settings.algo != "ppo":
        raise refusal("algo", settings.algo, "ppo with RLlib")
    if settings.envs % max(1, runners):
        raise refusal("runners", runners, f"a number that divides the {settings.envs} arms")
    for name in ("judge_every", "value_first"):
        if getattr(settings, name):
            raise refusal(name, getattr(settings, name), "0 with RLlib")
    chosen = HYPERPARAMETERS["ppo"] | {"clip_range": 0.2, "ent_coef": 0.0, "vf_coef": 0.5, "max_grad_norm": 0.5}
    chosen |= dict(settings.hyperparameters)
    if unknown := chosen.keys() - {*NAMES, *POLICY}:
        raise refusal("hyperparameters", sorted(unknown), f"some of {', '.join([*NAMES, *POLICY])}")
    rate, gain = settings.schedule("learning_rate"), {"gain": 2.0**0.5}
    fixed = chosen.get("learning_rate", 2e-4)
    points = [[0, fixed]] if rate is None else [[0, rate.start], [int(rate.until * settings.steps), rate.end + 1e-12]]
    rows = chosen["n_steps"] * settings.envs
    chosen["batch_size"] = min(chosen["batch_size"], rows)
    register_env("flexman", make_arms)
    context = {"environment": dict(settings.environment), "first_seed": training_seed(settings.seed),
               "normalise_reward": settings.normalise_reward}  # fmt: skip
    model = DefaultModelConfig(
        fcnet_hiddens=chosen.get("net_arch", [128, 128]), fcnet_activation=chosen.get("activation", "tanh"),
        vf_share_layers=False, free_log_std=True, fcnet_kernel_initializer="orthogonal_",
        fcnet_kernel_initializer_kwargs=gain, head_fcnet_kernel_initializer="orthogonal_",
        head_fcnet_kernel_initializer_kwargs={"gain": 0.01},
    )  # fmt: skip
    return (
        PPOConfig()
        .environment("flexman", env_config=context, disable_env_checking=True, normalize_actions=False,
                     clip_actions=False)
        .env_runners(num_env_runners=runners, num_envs_per_env_runner=settings.envs // max(1, runners),
                     gym_env_vectorize_mode="vector_entry_point", env_runner_cls=ArrayRunner,
                     rollout_fragment_length=chosen["n_steps"], episode_lookback_horizon=0,
                     env_to_module_connector=_moments)
        .learners(num_learners=0)
        .training(lr=points, train_batch_size_per_learner=rows, use_kl_loss=False, kl_coeff=0.0, vf_clip_param=1e9,
                  grad_clip_by="global_norm", **{ours: chosen[name] for name, ours in NAMES.items() if ours})
        .rl_module(model_config=model)
        .reporting(metrics_num_episodes_for_smoothing=settings.envs, min_time_s_per_iteration=None)
        .debugging(seed=settings.seed, log_level="ERROR")
    )  # fmt: skip


def _moments(env: Any, spaces: Any, device: Any) -> Moments:
    space = env.single_observation_space if env is not None else spaces["__env_single__"][0]
    return Moments(space.shape[0])


def train_rllib(settings: Settings, folder: Path, runners: int = 0, every: int = 100_000, resume: bool = False) -> None:
    """Trains a recipe with RLlib; the folder then has what `flexman evaluate` reads, and checkpoints of RLlib.

    Args:
        settings: of the run.
        folder: of it.
        runners: processes that roll out, beside the one that learns; 0 for none.
        every: steps between checkpoints.
        resume: goes on from the newest checkpoint. Networks, optimiser, scales and counts come back, episodes and
            random generators begin anew: the run is not the one that it would have been.

    Raises:
        FileNotFoundError, ValueError: one line.
    """
    runners, every = whole_number("runners", runners, 0, 10_000), whole_number("checkpoint_every", every, 0, 10**10)
    config, place = configure(settings, runners), Path(folder).absolute() / CHECKPOINTS
    known = sorted(place.glob("[0-9]*"), key=lambda path: int(path.name))
    if resume and not known:
        raise FileNotFoundError(f"{place}: no checkpoint; give a folder that a training with RLlib has written")
    if not resume and folder.exists() and any(folder.iterdir()):
        raise refusal("folder", folder, "a new one, or resume the run in it")
    place.mkdir(parents=True, exist_ok=True)
    here = {"env_vars": {"PYTHONPATH": paths(), "OMP_NUM_THREADS": "1"}}
    with cluster(runners + 1, runtime_env=here), locked(folder):
        keep_settings(settings, folder, 0)
        _learn(config.build_algo(), settings, place, every, int(known[-1].name) if resume else 0)


def _learn(algorithm: Any, settings: Settings, place: Path, every: int, done: int) -> None:
    """Learns to the end of the steps, from a checkpoint after `done` of them."""
    torch.set_num_threads(1)
    exploration = settings.schedule(EXPLORATION[0])
    if done:
        algorithm.restore_from_path(str(place / str(done)))
    elif exploration is None:
        _explore(algorithm, settings.hyperparameters.get("log_std_init", -3.0), True)
    kept = done
    while done < settings.steps:
        if exploration is not None:
            _explore(algorithm, exploration.at(done / settings.steps), False)
        done = int(algorithm.train()["env_runners"]["num_env_steps_sampled_lifetime"])
        if done >= settings.steps or (every and done >= kept + every):
            _keep(algorithm, settings, place, kept := done)
    algorithm.stop()


def _explore(algorithm: Any, value: float, learned: bool) -> None:
    """Sets the logarithm of the standard deviation of actions in the learner and the runners."""

    def put(learner: Any) -> None:
        for name, parameter in learner.module["default_policy"].named_parameters():
            if name.endswith("log_std"):
                parameter.data.fill_(value)
                parameter.requires_grad_(learned)

    algorithm.learner_group.foreach_learner(put)
    algorithm.env_runner_group.sync_weights(from_worker_or_learner_group=algorithm.learner_group, inference_only=True)


def _keep(algorithm: Any, settings: Settings, place: Path, done: int) -> None:
    """Writes a checkpoint, then takes the earlier ones away; and the policy as our own runs have it."""
    beside = place / f".{done}"
    shutil.rmtree(beside, ignore_errors=True)
    algorithm.save_to_path(str(beside))
    beside.rename(place / str(done))
    for path in place.iterdir():
        if path.name != str(done):
            shutil.rmtree(path)
    state = algorithm.learner_group.get_weights()["default_policy"]
    policy = {ours + name.removeprefix(theirs): np.asarray(values) for name, values in state.items()
              for theirs, ours in OURS.items() if name.startswith(theirs)}  # fmt: skip
    scales = next(each for each in algorithm.env_runner._env_to_module if isinstance(each, Moments)).now("seen")
    statistics = {"mean": scales.mean, "var": scales.squares / scales.count, "count": np.array(scales.count)}
    write_data(place.parent / NEWEST, {"policy": policy, "statistics": statistics, "settings": settings.plain()})
