"""Export of the policy of a training run: arrays and JSON for NumPy, or an ONNX graph."""

import re
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import value_error
from flexman_gym.common.files import existing_file
from flexman_gym.common.run_folder import BEST, NEWEST, read_npz, read_settings
from flexman_gym.control.network import MAX_INPUT, Network, policy_parameters
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.agent import (
    check_settings,
    find_agent,
    load_policy,
    network_agent,
    observation_layout,
    split_interface,
)
from flexman_gym.evaluation.agent_info import training_seconds
from flexman_gym.evaluation.metrics import evaluate
from flexman_gym.evaluation.policy_files import CHECK_ROWS, FOLDER, write_policy
from flexman_gym.evaluation.rollout import SELECTION_SEEDS, TEST_SEEDS, rollout

DEFAULT_LICENCE = "MIT"
CHECK_SEEDS = SELECTION_SEEDS[:16]  # episodes from which the observations are that are kept


def export_policy(
    run: Path, folder: Path, words: str, recipe: str, venue: str = "", licence: str = DEFAULT_LICENCE
) -> dict[str, float]:
    """Exports the best policy of a run; gives the figures that it reaches in the test episodes.

    Args:
        run: the folder of the run.
        folder: a new one.
        words: one sentence that says what it is.
        recipe: name or file of the settings with which it was trained.
        venue: an id, an id and a condition, or a file of the environment for which it is, "" for that of the training;
            what acts, such as sensors and base, stays that of the training.
        licence: of the policy.

    Raises:
        FileNotFoundError, ValueError: one line with what is wrong and what is allowed.
    """
    if folder.exists():
        raise value_error("folder", str(folder), "a new one")
    settings = read_settings(run)
    path = run / BEST if (run / BEST).is_file() else existing_file(run / NEWEST)
    data = read_npz(path)
    check_settings(path, data, settings)
    described = _target_environment(Configuration.from_plain(settings["environment"]), venue)
    layers = policy_parameters(settings["algo"], data["policy"])
    arrays = layers | {f"statistics.{name}": np.asarray(data["statistics"][name]) for name in ("mean", "var")}
    network = Network(settings["algo"], settings["hyperparameters"].get("activation"), layers, data["statistics"])
    seen = _check_observations(network, described, settings.get("base_in_use"))
    about = {
        "words": words,
        "licence": licence,
        "commit": _commit(),
        "versions": settings["versions"],
        "recipe": {"name": recipe, "settings": {name: each for name, each in settings.items() if name != "versions"}},
        "training_seconds": training_seconds(str(run)) or 0.0,
        "environment": described.to_plain(),
        "observation": observation_layout(described),
        "league": {},
    }
    arrays |= {"check.observations": seen, "check.actions": network(seen)}
    write_policy(folder, about, arrays)
    policy = load_policy(folder)
    assert policy.environment is not None
    figures = evaluate(policy, policy.environment, TEST_SEEDS)
    row = {name: value if np.isfinite(value) else None for name, value in figures.items()}
    about["league"] = {"environment": venue or described.id, "seeds": [TEST_SEEDS.start, TEST_SEEDS.stop], **row}
    write_policy(folder, about, arrays)
    return figures


def shipped_policy_folder(name: str) -> Path:
    """Gives the folder in the package for a policy of that name.

    Raises:
        ValueError: for a name that is no part of a path.
    """
    if not re.fullmatch(r"[A-Za-z0-9-]{0,59}[A-Za-z0-9]", name):
        raise value_error("name", name, "1 to 60 letters a to z, digits and hyphens, with no hyphen at the end")
    return FOLDER / name


def _target_environment(trained: Configuration, venue: str) -> Configuration:
    """The environment for which a policy is, with what acts as it was trained."""
    if not venue:
        return trained
    return split_interface(Configuration.find(venue))[0].replace(**split_interface(trained)[1])


class _RecordedNetwork:
    """A network, and every observation for which it was asked."""

    def __init__(self, network: Network) -> None:
        self.network, self.size, self.joints = network, network.size, network.joints
        self.seen: list[NDArray[np.float32]] = []

    def __call__(self, observations: NDArray[np.float32]) -> Array:
        self.seen.append(observations.copy())
        return self.network(observations)


def _check_observations(network: Network, described: Configuration, in_use: object) -> NDArray[np.float32]:
    """Observations (COUNT, size) of episodes that the policy plays, evenly from their first to their last."""
    watching = _RecordedNetwork(network)
    policy = network_agent("", watching, described, in_use)
    rollout(policy, split_interface(described)[0], CHECK_SEEDS)
    rows = np.concatenate(watching.seen)
    result: NDArray[np.float32] = rows[np.linspace(0, len(rows) - 1, CHECK_ROWS).astype(int)]
    return result


def _commit() -> str:
    """The commit of the checkout that this is a part of, "" where it is none."""
    done = subprocess.run(["git", "rev-parse", "HEAD"], cwd=Path(__file__).parent, capture_output=True, text=True)
    return done.stdout.strip() if done.returncode == 0 else ""


OPSET, IR_VERSION = 13, 8  # of the operators used, and of the file, which programs of the last years read
ONNX_TOLERANCE, ONNX_ROWS = 1e-4, 64  # largest difference of an action in float32, and rows that are compared


def write_onnx(entrant: str, path: Path) -> float:
    """Writes the network of a policy, its normalisation inside; gives how far its actions are from those of NumPy.

    The input "observation" (b, size) is what the sensors read, with history; the output "action" (b, n) that of the
    network, without its base. Both are float32.

    Args:
        entrant: name of a policy, or folder of a policy or a run.
        path: of the file.

    Raises:
        ImportError: without the extra [onnx].
        FileNotFoundError, ValueError: one line, for an entrant without a network, and for a graph that acts otherwise.
    """
    try:
        import onnx
        from onnx.reference import ReferenceEvaluator
    except ImportError as error:
        raise ImportError("ONNX needs another package: pip install 'flexman_gym[onnx]'") from error
    policy = find_agent(entrant)
    network = policy.law
    if not isinstance(network, Network):
        raise value_error("entrant", entrant, "a policy, or the run of one")
    if isinstance((policy.interface or {}).get("base"), str | dict):
        allowed = "a policy whose network acts alone, such as ppo-flexrrr: a controller that is made for the arm turns"
        allowed += f' the output of this one into torques; run it by fm.rollout("{entrant}", id)'
        raise value_error("entrant", entrant, allowed)
    model: Any = _onnx_model(network, onnx)
    onnx.checker.check_model(model, full_check=True)
    spread = np.random.default_rng(0).normal(0.0, 3.0, (ONNX_ROWS, network.size))
    seen = (network.mean + spread / network.scale).astype(np.float32)
    said: Any = ReferenceEvaluator(model).run(None, {"observation": seen})
    apart = float(np.abs(said[0] - network(seen)).max())
    if not apart <= ONNX_TOLERANCE:
        raise value_error(
            "onnx", f"actions {apart:.2g} from those of the policy", f"a network that is within {ONNX_TOLERANCE}"
        )
    path.parent.mkdir(parents=True, exist_ok=True)
    onnx.save(model, str(path))
    return apart


def _onnx_model(network: Network, onnx: Any) -> Any:
    """The graph of a network: what is observed, normalised and cut off, layer by layer, and cut off or bent at 1."""
    numbers: dict[str, NDArray[Any]] = {
        "mean": network.mean, "scale": network.scale, "most": np.array(MAX_INPUT), "least": np.array(-MAX_INPUT),
        "one": np.array(1.0), "minus_one": np.array(-1.0),
    }  # fmt: skip
    nodes = [("Sub", ("observation", "mean"), "centred"), ("Mul", ("centred", "scale"), "scaled"),
             ("Clip", ("scaled", "least", "most"), "h0")]  # fmt: skip
    for i, (weights, bias) in enumerate(network.layers):
        numbers |= {f"w{i}": weights.T, f"b{i}": bias}
        nodes += [("MatMul", (f"h{i}", f"w{i}"), f"p{i}"), ("Add", (f"p{i}", f"b{i}"), f"s{i}")]
        if i + 1 < len(network.layers):
            nodes.append(({"tanh": "Tanh", "relu": "Relu"}[network.activation], (f"s{i}",), f"h{i + 1}"))
    last = f"s{len(network.layers) - 1}"
    nodes.append(("Tanh", (last,), "action") if network.bent else ("Clip", (last, "minus_one", "one"), "action"))
    helper, kind = onnx.helper, onnx.TensorProto.FLOAT
    ends = [[helper.make_tensor_value_info(name, kind, ["b", size])]
            for name, size in (("observation", network.size), ("action", network.joints))]  # fmt: skip
    held = [onnx.numpy_helper.from_array(np.ascontiguousarray(each, dtype=np.float32), name)
            for name, each in numbers.items()]  # fmt: skip
    made = [helper.make_node(kind, given, [gives]) for kind, given, gives in nodes]
    graph = helper.make_graph(made, "policy", *ends, held)
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION)
