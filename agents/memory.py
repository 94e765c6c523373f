"""Memory: all that a training remembers between two rollouts, taken as arrays and plain data, and given back."""

import random
from collections import deque
from collections.abc import Collection
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

from flexman_agents.vector import Arms
from flexman_gym.checks import refusal
from flexman_gym.envs.snapshot import give, take

COUNTS = ("num_timesteps", "_n_updates", "_episode_num", "_current_progress_remaining")
LAST = ("_last_obs", "_last_original_obs", "_last_episode_starts")
SEEN = ("old_obs", "old_reward")
RETURNS = ("episode_returns", "episode_lengths", "episode_count")
REPLAY = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
MOMENTS = ("mean", "var", "count")


def take_policy(model: BaseAlgorithm) -> dict[str, Any]:
    """Gives what acts: the parameters of the networks and the statistics that normalise what they see."""
    return {"policy": _of_tensors(model.policy.state_dict()), "statistics": _of_statistics(_normaliser(model).obs_rms)}


def give_policy(model: BaseAlgorithm, data: Any) -> None:
    """Gives networks and statistics back to a model made alike.

    Raises:
        ValueError: one line, for those of other networks or other observations.
    """
    _check(data, ("policy", "statistics"))
    model.policy.load_state_dict(_tensors("policy", model.policy.state_dict(), data["policy"]))
    _give_statistics("statistics", _normaliser(model).obs_rms, data["statistics"])


def take_training(model: BaseAlgorithm) -> dict[str, Any]:
    """Gives all that a model remembers at the beginning of a rollout, beside its policy."""
    result: dict[str, Any] = {
        "counts": {name: getattr(model, name) for name in _counts(model)},
        "last": {name: take(getattr(model, name)) for name in LAST},
        "optimizers": {name: _of_optimizer(each) for name, each in _optimizers(model).items()},
        "episodes": [[float(each[key]) for key in "rlt"] for each in model.ep_info_buffer or ()],
        "random": _of_random(),
    }
    normaliser, monitor, arms = _layers(model)
    result["returns"] = {"statistics": _of_statistics(normaliser.ret_rms), "running": normaliser.returns.copy()}
    result["seen"] = {name: take(getattr(normaliser, name)) for name in SEEN}
    result["monitor"] = {name: take(getattr(monitor, name)) for name in RETURNS}
    result["environment"] = arms.env.unwrapped.get_state()  # type: ignore[attr-defined]
    if isinstance(model, SAC):
        learned = model.log_ent_coef
        result["entropy"] = None if learned is None else learned.detach().numpy().copy()
        result["replay"] = _of_replay(model)
    return result


def give_training(model: BaseAlgorithm, data: Any) -> None:
    """Gives the same back to a model made alike.

    Raises:
        ValueError: one line, for what another model remembers.
    """
    names = ["counts", "last", "optimizers", "episodes", "random", "returns", "seen", "monitor", "environment"]
    _check(data, names + ["entropy", "replay"] * isinstance(model, SAC))
    normaliser, monitor, arms = _layers(model)
    for part, wanted in (("counts", _counts(model)), ("last", LAST), ("seen", SEEN), ("monitor", RETURNS)):
        _check(data[part], wanted, part)
    arms.env.unwrapped.set_state(data["environment"])  # type: ignore[attr-defined]
    for name in _counts(model):
        setattr(model, name, data["counts"][name])
    for name in LAST:
        setattr(model, name, take(data["last"][name]))
    for name, optimizer in _optimizers(model).items():
        _give_optimizer(name, optimizer, data["optimizers"].get(name))
    told = [dict(zip("rlt", each, strict=True)) for each in data["episodes"]]
    model.ep_info_buffer = deque(told, maxlen=model._stats_window_size)
    model.ep_success_buffer = deque(maxlen=model._stats_window_size)  # no task of ours says success
    _give_statistics("returns", normaliser.ret_rms, data["returns"]["statistics"])
    give("returns", normaliser.returns, data["returns"]["running"])
    for name in SEEN:
        setattr(normaliser, name, take(data["seen"][name]))
    for name in RETURNS:
        setattr(monitor, name, take(data["monitor"][name]))
    if isinstance(model, SAC):
        if model.log_ent_coef is not None:
            logarithm = model.log_ent_coef.detach().numpy().copy()
            model.log_ent_coef.data = torch.as_tensor(give("entropy", logarithm, data["entropy"]))
        _give_replay(model, data["replay"])
    _give_random(data["random"])


def _layers(model: BaseAlgorithm) -> tuple[VecNormalize, VecMonitor, Arms]:
    """What stands between a model and its arms."""
    normaliser = _normaliser(model)
    monitor: Any = normaliser.venv
    return normaliser, monitor, monitor.venv


def _normaliser(model: BaseAlgorithm) -> VecNormalize:
    result = model.get_vec_normalize_env()
    assert result is not None
    return result


def _counts(model: BaseAlgorithm) -> list[str]:
    return [name for name in COUNTS if hasattr(model, name)]


def _check(data: Any, names: Collection[str], field: str = "run") -> None:
    if not isinstance(data, dict) or not set(names) <= data.keys():
        result = sorted(data) if isinstance(data, dict) else type(data).__name__
        raise refusal(field, result, f"what a run remembers: {', '.join(names)}")


def _of_tensors(tensors: Any) -> dict[str, Any]:
    return {name: tensor.detach().cpu().numpy().copy() for name, tensor in tensors.items()}


def _tensors(field: str, like: Any, arrays: Any) -> dict[str, torch.Tensor]:
    if not isinstance(arrays, dict) or arrays.keys() != like.keys():
        raise refusal(field, sorted(arrays) if isinstance(arrays, dict) else arrays, f"arrays {', '.join(like)}")
    wanted = _of_tensors(like)
    return {name: torch.as_tensor(_finite(f"{field}.{name}", wanted[name], arrays[name])) for name in like}


def _finite(field: str, old: NDArray[Any], data: Any, least: float = -np.inf) -> Any:
    """Gives data back to an array, once all of its numbers are finite and none is below the least."""
    result = give(field, old, data)
    if not (np.isfinite(result) & (np.asarray(result) >= least)).all():
        allowed = "finite numbers" if least < 0.0 else "finite numbers >= 0"
        raise refusal(field, "another number", allowed)
    return result


def _of_statistics(moments: Any) -> dict[str, Any]:
    return {name: np.array(getattr(moments, name), dtype=np.float64) for name in MOMENTS}


def _give_statistics(field: str, moments: Any, data: Any) -> None:
    for name, value in _of_statistics(moments).items():
        given = data.get(name) if isinstance(data, dict) else None
        result = _finite(f"{field}.{name}", value, given, -np.inf if name == "mean" else 0.0)
        setattr(moments, name, result if result.ndim else result.item() if name == "count" else np.float64(result))


def _optimizers(model: BaseAlgorithm) -> dict[str, torch.optim.Optimizer]:
    if not isinstance(model, SAC):
        return {"policy": model.policy.optimizer}
    result = {"actor": model.actor.optimizer, "critic": model.critic.optimizer}
    return result | ({"entropy": model.ent_coef_optimizer} if model.ent_coef_optimizer else {})


def _of_optimizer(optimizer: torch.optim.Optimizer) -> dict[str, Any]:
    """What an optimiser remembers of each parameter; its settings belong to the model."""
    return {str(key): _of_tensors(each) for key, each in optimizer.state_dict()["state"].items()}


def _give_optimizer(field: str, optimizer: torch.optim.Optimizer, data: Any) -> None:
    plain = optimizer.state_dict()
    if not isinstance(data, dict) or not data.keys() <= {str(i) for i in plain["param_groups"][0]["params"]}:
        raise refusal(f"optimizers.{field}", data if data is None else sorted(data), "what the optimiser remembered")
    state = {int(key): {name: torch.as_tensor(value) for name, value in each.items()} for key, each in data.items()}
    optimizer.load_state_dict({"state": state, "param_groups": plain["param_groups"]})


def _of_replay(model: SAC) -> dict[str, Any]:
    buffer: Any = model.replay_buffer
    rows = buffer.buffer_size if buffer.full else buffer.pos
    return {"pos": int(buffer.pos), "full": bool(buffer.full)} | {name: getattr(buffer, name)[:rows] for name in REPLAY}


def _give_replay(model: SAC, data: Any) -> None:
    buffer: Any = model.replay_buffer
    rows = buffer.buffer_size if data["full"] else data["pos"]
    for name in REPLAY:
        give(f"replay.{name}", getattr(buffer, name)[:rows], data[name])
    buffer.pos, buffer.full = data["pos"], data["full"]


def _of_random() -> dict[str, Any]:
    """The states of the generators that Python, NumPy and PyTorch share with everybody."""
    version, words, gauss = random.getstate()
    kind, keys, *rest = np.random.get_state(legacy=True)  # noqa: NPY002, Stable-Baselines3 draws from it
    return {
        "python": [version, list(words), gauss],
        "numpy": [kind, np.asarray(keys), *(each if isinstance(each, str) else float(each) for each in rest)],
        "torch": torch.get_rng_state().numpy().copy(),
    }


def _give_random(data: dict[str, Any]) -> None:
    version, words, gauss = data["python"]
    random.setstate((version, tuple(words), gauss))
    kind, keys, position, has, gaussian = data["numpy"]
    np.random.set_state((kind, keys, int(position), int(has), gaussian))  # noqa: NPY002
    torch.set_rng_state(torch.as_tensor(data["torch"]))
