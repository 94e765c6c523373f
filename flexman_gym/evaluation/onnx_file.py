"""ONNX file: a policy as a graph that other programs run, from what its sensors read to its action."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexman_gym.checks import refusal
from flexman_gym.control.network import LARGEST, Network
from flexman_gym.control.policy import Learned, Policy
from flexman_gym.evaluation.entrants import find_entrant

OPSET, IR = 13, 8  # of the operators used, and of the file, which programs of the last years read
CLOSE, COUNT = 1e-4, 64  # largest difference of an action in float32, and rows that are compared


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
    policy = (find_entrant(entrant).interface or {}).get("base")
    if isinstance(policy, Learned):
        allowed = "a policy whose network acts alone, such as ppo-flexrrr: a controller that is made for the arm turns"
        allowed += f' the output of this one into torques; run it by fm.rollout("{entrant}", id)'
        raise refusal("entrant", entrant, allowed)
    if not isinstance(policy, Policy):
        raise refusal("entrant", entrant, "a policy, or the run of one")
    network = policy.network
    model: Any = _graph(network, onnx)
    onnx.checker.check_model(model, full_check=True)
    spread = np.random.default_rng(0).normal(0.0, 3.0, (COUNT, network.size))
    seen = (network.mean + spread / network.scale).astype(np.float32)
    said: Any = ReferenceEvaluator(model).run(None, {"observation": seen})
    apart = float(np.abs(said[0] - network(seen)).max())
    if not apart <= CLOSE:
        raise refusal("onnx", f"actions {apart:.2g} from those of the policy", f"a network that is within {CLOSE}")
    path.parent.mkdir(parents=True, exist_ok=True)
    onnx.save(model, str(path))
    return apart


def _graph(network: Network, onnx: Any) -> Any:
    """The graph of a network: what is observed, normalised and cut off, layer by layer, and cut off or bent at 1."""
    numbers: dict[str, NDArray[Any]] = {
        "mean": network.mean, "scale": network.scale, "most": np.array(LARGEST), "least": np.array(-LARGEST),
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
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR)
