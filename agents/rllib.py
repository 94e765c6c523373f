"""Training of PPO recipes with RLlib, with an environment runner that steps all arms as arrays."""

import shutil
import uuid
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from numpy.typing import NDArray
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.connectors.connector_v2 import ConnectorV2
from ray.rllib.core.columns import Columns
from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig
from ray.rllib.env.single_agent_env_runner import SingleAgentEnvRunner
from ray.rllib.env.single_agent_episode import SingleAgentEpisode
from ray.rllib.env.utils.infinite_lookback_buffer import InfiniteLookbackBuffer
from ray.tune.registry import register_env

from flexman_agents.settings import DEFAULT_HYPERPARAMETERS, EXPLORATION_SCHEDULES, Settings
from flexman_gym.common.checks import value_error, whole_number
from flexman_gym.common.parallel import ray_cluster
from flexman_gym.common.run_folder import NEWEST, lock_folder, write_npz
from flexman_gym.control.normalisation import RunningMeanStd
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.rollout import training_seed

CLIP = 10.0  # dimensionless; largest magnitude of normalised observations and rewards


class _NormalisationConnector(ConnectorV2):
    """RLlib connector with the running means and variances of observations and returns.

    Args:
        size: number of entries of an observation.

    Attributes:
        shared: statistics of all runners up to the last synchronisation.
        own: statistics of this runner since then.
    """

    def __init__(self, size: int) -> None:
        super().__init__()
        self.shared, self.own = self._new(size), self._new(size)

    @staticmethod
    def _new(size: int) -> dict[str, RunningMeanStd]:
        return {"observations": RunningMeanStd((size,)), "returns": RunningMeanStd()}

    def merged(self, name: str) -> RunningMeanStd:
        """Return the shared and own statistics of "observations" or "returns" together."""
        result = RunningMeanStd(self.own[name].mean.shape)
        result.merge(self.shared[name])
        result.merge(self.own[name])
        return result

    def __call__(self, *, batch: Any, **named: Any) -> Any:
        """Return the batch unchanged."""
        return batch  # the runner has normalised it

    def get_state(self, *parts: Any, **named: Any) -> dict[str, Any]:
        """Return shared and own statistics as arrays and numbers."""
        return {part: {name: each.get_state() for name, each in getattr(self, part).items()}
                for part in ("shared", "own")}  # fmt: skip

    def set_state(self, state: dict[str, Any]) -> None:
        """Set the statistics from the result of `get_state` or `merge_states`."""
        for part, moments in state.items():
            for name, each in moments.items():
                present = "observations" if name == "seen" else name  # "seen": checkpoints of release 0.2
                getattr(self, part)[present].set_state(each)

    def merge_states(self, states: list[dict[str, Any]]) -> dict[str, Any]:
        """Merge the states of all runners; the shared statistics are counted once."""
        result = _NormalisationConnector(len(self.own["observations"].mean))
        for part, several in (("shared", states[:1]), ("own", states)):
            for name, moments in result.shared.items():
                for state in several:
                    other = RunningMeanStd(moments.mean.shape)
                    other.set_state(state[part][name])
                    moments.merge(other)
        return result.get_state()


class _ArrayEnvRunner(SingleAgentEnvRunner):
    """Environment runner that steps all arms at once and splits the arrays into episodes at the end.

    The runner of RLlib handles each arm separately, which is slower.
    """

    _needs_initial_reset: bool
    _observed: NDArray[Any]
    _discounted_return: NDArray[Any]
    _episode_return: NDArray[Any]
    _length: NDArray[Any]

    def _sample(self, *, num_timesteps: int | None = None, force_reset: bool = False, **named: Any) -> list[Any]:
        assert num_timesteps is not None, "the algorithm sets the number of steps"
        steps = -(-num_timesteps // self.num_envs)
        if self._needs_initial_reset or force_reset:
            self._begin()
        connector = next(each for each in self._env_to_module if isinstance(each, _NormalisationConnector))
        normalisation, deviation = connector.merged("observations"), connector.merged("returns").deviation
        scale = deviation if self.config.env_config["normalise_reward"] else 1.0
        rows: dict[str, list[Any]] = {name: [] for name in ("raw", "actions", "logits", "logp", "rewards", "returns")}
        ends: list[tuple[int, int, Any, bool]] = []
        for step in range(1, steps + 1):
            with torch.no_grad():
                batch = {Columns.OBS: torch.from_numpy(normalisation.apply(self._observed, CLIP))}
                logits = self.module.forward_exploration(batch)[Columns.ACTION_DIST_INPUTS]
                distribution = self.module.get_exploration_action_dist_cls().from_logits(logits)
                actions = distribution.sample()
                logp = distribution.logp(actions)
            rows["raw"].append(self._observed)
            self._observed, reward, terminated, truncated, infos = self.env.env.step(actions.clamp(-1.0, 1.0).numpy())
            self._discounted_return = self._discounted_return * self.config.gamma + reward
            self._episode_return += reward
            self._length += 1
            reward = np.clip(reward / scale, -CLIP, CLIP)
            for name, each in zip(("actions", "logits", "logp", "rewards", "returns"),
                                  (actions.numpy(), logits.numpy(), logp.numpy(), reward,
                                   self._discounted_return.copy()), strict=True):  # fmt: skip
                rows[name].append(each)
            for arm in np.flatnonzero(terminated | truncated).tolist():
                ends.append((arm, step, normalisation.apply(infos["final_obs"][arm], CLIP), bool(terminated[arm])))
                self._log_episode_metrics(int(self._length[arm]), float(self._episode_return[arm]), 0.0)
                self._discounted_return[arm] = self._episode_return[arm] = self._length[arm] = 0
        connector.own["observations"].add(np.array(rows["raw"]))
        connector.own["returns"].add(np.array(rows.pop("returns")))
        arrays = {name: np.stack(values, 1) for name, values in rows.items()}
        arrays["obs"] = np.concatenate(
            [normalisation.apply(arrays.pop("raw"), CLIP), normalisation.apply(self._observed, CLIP)[:, None]], 1
        )
        self._log_env_steps(metric=self._metrics_num_env_steps_sampled, num_steps=self.num_envs * steps)
        self._increase_sampled_metrics(self.num_envs * steps, len(ends))
        return self._episodes(arrays, ends, steps)

    def _begin(self) -> None:
        """Reset all arms, with seeds that differ between runners."""
        first = self.config.env_config["first_seed"] + max(0, self.worker_index - 1) * self.num_envs
        self._observed, _ = self.env.env.reset(seed=first)
        self._discounted_return, self._episode_return, self._length = np.zeros((3, self.num_envs))
        self._names = [uuid.uuid4().hex for _ in range(self.num_envs)]
        self._needs_initial_reset = False

    def _episodes(self, arrays: dict[str, NDArray[Any]], ends: list[Any], steps: int) -> list[Any]:
        """Split arrays into episodes.

        Args:
            arrays: name -> (arms, steps, ...).
            ends: (arm, step, last observation, terminated) for each end of an episode.
            steps: number of steps.

        Returns:
            Episodes of RLlib; unfinished ones end with the arrays.
        """
        starts, result = np.zeros(self.num_envs, dtype=int), []
        open_ends = [(arm, steps, None, False) for arm in range(self.num_envs)]
        for arm, stop, last, terminated in ends + open_ends:
            part = slice(starts[arm], stop)
            starts[arm], length = stop, stop - starts[arm]
            if length == 0:
                continue
            observed = arrays["obs"][arm, part.start : stop + 1].copy()
            if last is not None:
                observed[-1] = last
            episode = SingleAgentEpisode(
                self._names[arm], observations=_buffer(observed), infos=_buffer([{}] * (length + 1)), t_started=0,
                actions=_buffer(arrays["actions"][arm, part]), rewards=_buffer(arrays["rewards"][arm, part]),
                extra_model_outputs={Columns.ACTION_DIST_INPUTS: _buffer(arrays["logits"][arm, part]),
                                     Columns.ACTION_LOGP: _buffer(arrays["logp"][arm, part])},
                terminated=terminated, truncated=last is not None and not terminated, len_lookback_buffer=0,
            )  # fmt: skip
            episode.t = length
            result.append(episode)
            if last is not None:
                self._names[arm] = uuid.uuid4().hex
        return result

    def get_metrics(self) -> Any:
        """Return the metrics of the samples since the last call."""
        return self.metrics.reduce()


def _buffer(values: Any) -> Any:
    """Return the values as a buffer of an RLlib episode, marked as converted to arrays."""
    result = InfiniteLookbackBuffer(data=values, lookback=0)
    result.finalized = not isinstance(values, list)
    return result


def _make_environment(context: Any) -> Any:
    """Return the vector environment of an environment runner."""
    torch.set_num_threads(1)
    environment = Configuration.from_plain(context["environment"])
    return gym.make_vec(environment.id, context.get("num_envs", 1), "vector_entry_point", autoreset_mode="SameStep",
                        infos="at end", **environment.keywords())  # fmt: skip


CHECKPOINT_FOLDER = "rllib"  # folder of the checkpoints in the run folder
# hyperparameter of Stable-Baselines3 -> option of RLlib; "" for one that other options of RLlib replace
RLLIB_NAMES = {"n_steps": "", "batch_size": "minibatch_size", "n_epochs": "num_epochs", "gamma": "gamma",
         "gae_lambda": "lambda_", "clip_range": "clip_param", "ent_coef": "entropy_coeff",
         "vf_coef": "vf_loss_coeff", "max_grad_norm": "grad_clip"}  # fmt: skip
POLICY_HYPERPARAMETERS = ("net_arch", "activation", "log_std_init", "learning_rate", "ortho_init")
# prefix of network parameters in RLlib -> in Stable-Baselines3
SB3_PREFIXES = {"encoder.actor_encoder.net.mlp.": "mlp_extractor.policy_net.", "pi.net.mlp.0.": "action_net."}


def _ppo_config(settings: Settings, runners: int) -> PPOConfig:
    """Convert the settings of a run to a configuration of RLlib.

    Args:
        settings: settings of the run; SAC, evaluations, value warm-up and some hyperparameters are not supported.
        runners: processes that step environments; 0 for the learning process itself.
    """
    if settings.algo != "ppo":
        raise value_error("algo", settings.algo, "ppo with RLlib")
    if settings.envs % max(1, runners):
        raise value_error("runners", runners, f"a number that divides the {settings.envs} arms")
    for name in ("eval_every", "value_warmup"):
        if getattr(settings, name):
            raise value_error(name, getattr(settings, name), "0 with RLlib")
    chosen = DEFAULT_HYPERPARAMETERS["ppo"] | {"clip_range": 0.2, "ent_coef": 0.0, "vf_coef": 0.5, "max_grad_norm": 0.5}
    chosen |= dict(settings.hyperparameters)
    if unknown := chosen.keys() - {*RLLIB_NAMES, *POLICY_HYPERPARAMETERS}:
        raise value_error(
            "hyperparameters", sorted(unknown), f"some of {', '.join([*RLLIB_NAMES, *POLICY_HYPERPARAMETERS])}"
        )
    rate, gain = settings.schedule("learning_rate"), {"gain": 2.0**0.5}
    fixed = chosen.get("learning_rate", 2e-4)
    points = [[0, fixed]] if rate is None else [[0, rate.start], [int(rate.until * settings.steps), rate.end + 1e-12]]
    rows = chosen["n_steps"] * settings.envs
    chosen["batch_size"] = min(chosen["batch_size"], rows)
    register_env("flexman", _make_environment)
    context = {"environment": settings.environment.to_plain(), "first_seed": training_seed(settings.seed),
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
                     gym_env_vectorize_mode="vector_entry_point", env_runner_cls=_ArrayEnvRunner,
                     rollout_fragment_length=chosen["n_steps"], episode_lookback_horizon=0,
                     env_to_module_connector=_make_normalisation)
        .learners(num_learners=0)
        .training(lr=points, train_batch_size_per_learner=rows, use_kl_loss=False, kl_coeff=0.0, vf_clip_param=1e9,
                  grad_clip_by="global_norm", **{own: chosen[name] for name, own in RLLIB_NAMES.items() if own})
        .rl_module(model_config=model)
        .reporting(metrics_num_episodes_for_smoothing=settings.envs, min_time_s_per_iteration=None)
        .debugging(seed=settings.seed, log_level="ERROR")
    )  # fmt: skip


def _make_normalisation(env: Any, spaces: Any, device: Any) -> _NormalisationConnector:
    space = env.single_observation_space if env is not None else spaces["__env_single__"][0]
    return _NormalisationConnector(space.shape[0])


def train_rllib(settings: Settings, folder: Path, runners: int = 0, every: int = 100_000, resume: bool = False) -> None:
    """Train a PPO recipe with RLlib in a run folder, which `flexman evaluate` can read.

    Args:
        settings: settings of the run.
        folder: folder of the run, for settings, policy and checkpoints of RLlib.
        runners: processes that step environments, in addition to the learning process; 0 for none.
        every: environment steps between checkpoints.
        resume: True to continue from the newest checkpoint, which contains networks, optimiser, normalisation and step
            counts. Episodes and random generators restart, so that results differ from the results of an uninterrupted
            run.

    Raises:
        FileNotFoundError: for `resume` without a checkpoint.
        ValueError: for unsupported settings, or a folder that holds a run.
    """
    runners, every = whole_number("runners", runners, 0, 10_000), whole_number("checkpoint_every", every, 0, 10**10)
    config, place = _ppo_config(settings, runners), Path(folder).absolute() / CHECKPOINT_FOLDER
    checkpoints = sorted(place.glob("[0-9]*"), key=lambda path: int(path.name))
    if resume and not checkpoints:
        raise FileNotFoundError(f"{place}: no checkpoint; give the folder of a training with RLlib")
    if not resume and folder.exists() and any(folder.iterdir()):
        raise value_error("folder", folder, "a new one, or resume the run in it")
    place.mkdir(parents=True, exist_ok=True)
    with ray_cluster(runners + 1, OMP_NUM_THREADS="1"), lock_folder(folder):
        settings.write(folder, 0)
        _train(config.build_algo(), settings, place, every, int(checkpoints[-1].name) if resume else 0)


def _train(algorithm: Any, settings: Settings, place: Path, every: int, done: int) -> None:
    """Train to the end of the steps, from the checkpoint after `done` environment steps."""
    torch.set_num_threads(1)
    exploration = settings.schedule(EXPLORATION_SCHEDULES[0])
    if done:
        algorithm.restore_from_path(str(place / str(done)))
    elif exploration is None:
        _set_exploration(algorithm, settings.hyperparameters.get("log_std_init", -3.0), True)
    saved = done
    while done < settings.steps:
        if exploration is not None:
            _set_exploration(algorithm, exploration.at(done / settings.steps), False)
        done = int(algorithm.train()["env_runners"]["num_env_steps_sampled_lifetime"])
        if done >= settings.steps or (every and done >= saved + every):
            _save(algorithm, settings, place, saved := done)
    algorithm.stop()


def _set_exploration(algorithm: Any, value: float, learned: bool) -> None:
    """Set the logarithm of the standard deviation of actions in the learner and the runners."""

    def set_parameter(learner: Any) -> None:
        for name, parameter in learner.module["default_policy"].named_parameters():
            if name.endswith("log_std"):
                parameter.data.fill_(value)
                parameter.requires_grad_(learned)

    algorithm.learner_group.foreach_learner(set_parameter)
    algorithm.env_runner_group.sync_weights(from_worker_or_learner_group=algorithm.learner_group, inference_only=True)


def _save(algorithm: Any, settings: Settings, place: Path, done: int) -> None:
    """Write a checkpoint, remove the earlier ones, and write the policy in the format of all runs."""
    temporary = place / f".{done}"
    shutil.rmtree(temporary, ignore_errors=True)
    algorithm.save_to_path(str(temporary))
    temporary.rename(place / str(done))
    for path in place.iterdir():
        if path.name != str(done):
            shutil.rmtree(path)
    state = algorithm.learner_group.get_weights()["default_policy"]
    policy = {ours + name.removeprefix(theirs): np.asarray(values) for name, values in state.items()
              for theirs, ours in SB3_PREFIXES.items() if name.startswith(theirs)}  # fmt: skip
    moments = next(
        each for each in algorithm.env_runner._env_to_module if isinstance(each, _NormalisationConnector)
    ).merged("observations")
    statistics = {"mean": moments.mean, "var": moments.squares / moments.count, "count": np.array(moments.count)}
    write_npz(place.parent / NEWEST, {"policy": policy, "statistics": statistics, "settings": settings.plain()})
