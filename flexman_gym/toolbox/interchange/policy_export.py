"""Export of the policy of a training run: arrays with metadata, or an ONNX graph."""

import subprocess
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexman_gym.agent.network import MAX_INPUT, Network, policy_parameters
from flexman_gym.common.arrays import Array
from flexman_gym.common.computer import optional_module
from flexman_gym.common.errors import value_error
from flexman_gym.common.files import write_file
from flexman_gym.common.run_folder import policy_file, read_npz, read_settings
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.agent_info import training_seconds
from flexman_gym.evaluation.agent_spec import AgentSpec, split_interface
from flexman_gym.evaluation.agents import find_agent
from flexman_gym.evaluation.metrics import evaluate
from flexman_gym.evaluation.policy_files import CHECK_ROWS, write_policy
from flexman_gym.evaluation.rollouts import SELECTION_SEEDS, TEST_SEEDS, rollout
from flexman_gym.evaluation.trained_agents import check_settings, observation_layout

DEFAULT_LICENCE = "MIT"
CHECK_SEEDS = SELECTION_SEEDS[:16]  # seeds of the episodes whose observations are stored as a check of the network


def export_policy(
    run: Path, folder: Path, description: str, recipe: str, environment: str = "", licence: str = DEFAULT_LICENCE
) -> dict[str, float]:
    """Export the best policy of a training run; return its metrics in the test episodes by name, see `evaluate`.

    Args:
        run: folder of the run.
        folder: new folder of the policy.
        description: description of the policy, one sentence.
        recipe: name or file of the settings of the training.
        environment: id, id and condition, or file of the environment for which the policy is recommended; "" for the
            environment of the training. The settings of the agent, such as sensors and base controller, do not change.
        licence: licence of the policy.

    Raises:
        FileNotFoundError: if a file of the run is missing.
        ValueError: for an existing folder, and for a run whose settings were changed or whose result is its base.
    """
    if folder.exists():
        raise value_error("folder", str(folder), "a new one")
    settings = read_settings(run)
    path = policy_file(run)
    data = read_npz(path)
    check_settings(path, data, settings)
    target = _target_environment(Configuration.from_plain(settings["environment"]), environment)
    layers = policy_parameters(settings["algo"], data["policy"])
    arrays = layers | {f"statistics.{name}": np.asarray(data["statistics"][name]) for name in ("mean", "var")}
    network = Network(settings["algo"], settings["hyperparameters"].get("activation"), layers, data["statistics"])
    observations = _check_observations(network, target, settings.get("base_in_use"))
    metadata = {
        "words": description,
        "licence": licence,
        "commit": _commit(),
        "versions": settings["versions"],
        "recipe": {"name": recipe, "settings": {name: each for name, each in settings.items() if name != "versions"}},
        "training_seconds": training_seconds(str(run)) or 0.0,
        "environment": target.to_plain(),
        "observation": observation_layout(target),
        "league": {},
    }
    arrays |= {"check.observations": observations, "check.actions": network(observations)}
    write_policy(folder, metadata, arrays)
    policy = find_agent(str(folder))
    assert policy.environment is not None
    metrics = evaluate(policy, policy.environment, TEST_SEEDS)
    row = {name: value if np.isfinite(value) else None for name, value in metrics.items()}
    metadata["league"] = {"environment": environment or target.id, "seeds": [TEST_SEEDS.start, TEST_SEEDS.stop], **row}
    write_policy(folder, metadata, arrays)
    return metrics


def _target_environment(trained: Configuration, name: str) -> Configuration:
    """Return an environment by its name, with the settings of the trained agent; for "" the trained environment."""
    if not name:
        return trained
    return split_interface(Configuration.find(name))[0].replace(**split_interface(trained)[1])


class _RecordedNetwork:
    """Network that records its inputs."""

    def __init__(self, network: Network) -> None:
        self.network, self.size, self.joints = network, network.size, network.joints
        self.inputs: list[NDArray[np.float32]] = []

    def __call__(self, observations: NDArray[np.float32]) -> Array:
        self.inputs.append(observations.copy())
        return self.network(observations)


def _check_observations(network: Network, environment: Configuration, base_in_use: object) -> NDArray[np.float32]:
    """Run the policy with CHECK_SEEDS and return a sample of its observations (CHECK_ROWS, size) at equal intervals.

    The exported policy stores them with its actions, which are compared after loading.
    """
    recorded = _RecordedNetwork(network)
    policy = AgentSpec.from_network("", recorded, environment, base_in_use)
    rollout(policy, split_interface(environment)[0], CHECK_SEEDS)
    rows = np.concatenate(recorded.inputs)
    result: NDArray[np.float32] = rows[np.linspace(0, len(rows) - 1, CHECK_ROWS).astype(int)]
    return result


def _commit() -> str:
    """Return the git commit of this library; "" outside a git repository."""
    done = subprocess.run(["git", "rev-parse", "HEAD"], cwd=Path(__file__).parent, capture_output=True, text=True)
    return done.stdout.strip() if done.returncode == 0 else ""


OPSET, IR_VERSION = 13, 8  # versions of the ONNX operators and of the file format, supported by old runtimes
ONNX_TOLERANCE = 1e-4  # dimensionless; largest difference of an action in float32
ONNX_ROWS = 64  # number of observations for which actions are compared


def write_onnx(agent: str, path: Path) -> float:
    """Write the network of a policy, with its normalisation of observations, as an ONNX graph.

    The input "observation" (b, size) float32 contains the readings of the sensors, with history; `observation_layout`
    returns their order and units. The output "action" (b, n) float32 is the output of the network, without the base
    controller.

    Args:
        agent: name of a policy, or folder of a policy or a training run.
        path: path of the file.

    Returns:
        Largest difference between an action of the graph and of the policy, on random observations.

    Raises:
        ImportError: without the extra [onnx].
        ValueError, FileNotFoundError: for an unknown agent.
        ValueError: for an agent without a network, for a policy with a base controller, and for a graph whose actions
            differ from the actions of the policy.
    """
    onnx, reference = (optional_module(name, "the export", "onnx") for name in ("onnx", "onnx.reference"))
    policy = find_agent(agent)
    network = policy.law
    if not isinstance(network, Network):
        raise value_error("agent", agent, "a policy, or the run of one")
    if isinstance((policy.interface or {}).get("base"), str | dict):
        allowed = "a policy whose network acts alone, such as ppo-flexrrr: here a controller designed for the arm turns"
        allowed += f' the output of the network into torques; run it by fm.rollout("{agent}", id)'
        raise value_error("agent", agent, allowed)
    model: Any = _onnx_model(network, onnx)
    onnx.checker.check_model(model, full_check=True)
    spread = np.random.default_rng(0).normal(0.0, 3.0, (ONNX_ROWS, network.size))
    observations = (network.mean + spread / network.scale).astype(np.float32)
    actions: Any = reference.ReferenceEvaluator(model).run(None, {"observation": observations})
    difference = float(np.abs(actions[0] - network(observations)).max())
    if not difference <= ONNX_TOLERANCE:
        given = f"actions that differ by {difference:.2g} from those of the policy"
        raise value_error("onnx", given, f"a network whose actions differ by at most {ONNX_TOLERANCE}")
    write_file(path, model.SerializeToString())
    return difference


def _onnx_model(network: Network, onnx: Any) -> Any:
    """Return the ONNX model of a network: normalisation and clipping of the input, layers, clipping or tanh."""
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
    nodes.append(("Tanh", (last,), "action") if network.squashed else ("Clip", (last, "minus_one", "one"), "action"))
    helper, kind = onnx.helper, onnx.TensorProto.FLOAT
    inputs, outputs = [[helper.make_tensor_value_info(name, kind, ["b", size])]
            for name, size in (("observation", network.size), ("action", network.joints))]  # fmt: skip
    constants = [onnx.numpy_helper.from_array(np.ascontiguousarray(each, dtype=np.float32), name)
            for name, each in numbers.items()]  # fmt: skip
    operators = [helper.make_node(kind, names, [name]) for kind, names, name in nodes]
    graph = helper.make_graph(operators, "policy", inputs, outputs, constants)
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION)
