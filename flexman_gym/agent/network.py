"""Policy network in NumPy: layers and observation statistics of a trained policy."""

from collections.abc import Callable, Collection, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.arrays import Array, row_dots
from flexman_gym.common.checks import is_decimal_integer, one_of
from flexman_gym.common.errors import value_error

ACTIVATION_FUNCTIONS: dict[str, Callable[[Array], Array]] = {
    "tanh": np.tanh,
    "relu": lambda values: np.maximum(values, 0.0),
}
MAX_INPUT = 10.0  # dimensionless; largest magnitude of a normalised observation
VARIANCE_OFFSET = 1e-8  # added to variances to avoid division by zero
RENORM_OFFSET = 1e-3  # added to the variances of a batch renormalisation, as in sb3-contrib
RENORM_PARTS = ("ra_mean", "ra_var", "scale", "bias")  # running mean and variance, learned scale and shift
RENORM_COUNTER = "steps"  # number of updates of the running statistics
# algorithm -> prefix of its layers, name of the last layer, default activation, output function
LAYER_NAMES: dict[str, tuple[str, str, str, Callable[[Array], Array]]] = {
    "ppo": ("mlp_extractor.policy_net.", "action_net", "tanh", lambda values: np.clip(values, -1.0, 1.0)),
    "dagger": ("mlp_extractor.policy_net.", "action_net", "tanh", lambda values: np.clip(values, -1.0, 1.0)),
    **dict.fromkeys(("sac", "tqc", "crossq"), ("actor.latent_pi.", "actor.mu", "relu", np.tanh)),
}


class Network:
    """Multilayer perceptron with layers f(W x + b), from normalised observations to actions between -1 and 1.

    The action for an observation does not depend on the other observations of the batch, to the last bit.

    Args:
        algo: "ppo", "dagger", "sac", "tqc" or "crossq", which defines the names of the parameters.
        activation: "tanh" or "relu"; None for the default of the algorithm.
        parameters: name -> array, with the names of Stable-Baselines3. The batch renormalisations of CrossQ are merged
            into the layers.
        statistics: "mean" and "var" (variance) of observations, (size,) each.

    Attributes:
        size: number of inputs.
        joints: n, number of outputs.
        mean: (size,) mean of observations.
        scale: (size,) reciprocal standard deviation of observations.
        layers: weights (m, k) and bias (m,) of each layer.
        activation: "tanh" or "relu".
        squashed: True if a tanh bounds the actions; False if the actions are clipped.

    Raises:
        ValueError: for missing arrays, inconsistent shapes and numbers that are not finite.
    """

    c_program = "flexman_gym.toolbox.deployment.c_programs:network_program"

    def __init__(self, algo: str, activation: str | None, parameters: object, statistics: object) -> None:
        first, last, default, self._output = LAYER_NAMES[one_of("algo", algo, LAYER_NAMES)]
        self.activation = one_of("activation", activation or default, ACTIVATION_FUNCTIONS)
        self.squashed = self._output is np.tanh
        self._function = ACTIVATION_FUNCTIONS[self.activation]
        given = _mapping("policy", parameters)
        result = policy_parameters(algo, {name: _finite(f"policy.{name}", each) for name, each in given.items()
                                          if not name.endswith(f".{RENORM_COUNTER}")})  # fmt: skip
        moments = _mapping("statistics", statistics)
        self.mean = _finite("statistics.mean", moments.get("mean"))
        self.scale = 1.0 / np.sqrt(_finite("statistics.var", moments.get("var"), 0.0) + VARIANCE_OFFSET)
        self.layers = [_layer(result, name) for name in _layer_names(result, first, last)]
        sizes = [self.mean.size, *(len(bias) for _, bias in self.layers)]
        for (weights, _), size in zip(self.layers, sizes, strict=False):
            if weights.shape[1] != size:
                raise value_error("policy", f"a layer with {weights.shape[1]} inputs", f"one with {size}")
        if self.scale.shape != self.mean.shape or self.mean.ndim != 1:
            raise value_error("statistics.var", f"an array {self.scale.shape}", f"one of {self.mean.shape}")
        self.size, self.joints = sizes[0], sizes[-1]

    def __call__(self, observations: NDArray[np.floating]) -> Array:
        """Return the actions (b, n) for observations (b, size)."""
        values = np.clip((observations - self.mean) * self.scale, -MAX_INPUT, MAX_INPUT)
        for weights, bias in self.layers[:-1]:
            values = self._function(self.product(values, weights) + bias)
        weights, bias = self.layers[-1]
        actions: Array = self._output(self.product(values, weights) + bias)
        return actions

    def derivatives(self, observations: NDArray[np.floating], changes: Array) -> Array:
        """Return the derivatives (p, n) of the actions at an observation (1, size) with derivatives (p, size)."""
        scaled = (observations - self.mean) * self.scale
        changes = np.where(np.abs(scaled) < MAX_INPUT, changes * self.scale, 0.0)
        values = np.clip(scaled, -MAX_INPUT, MAX_INPUT)
        for weights, bias in self.layers[:-1]:
            inputs = self.product(values, weights) + bias
            values = self._function(inputs)
            slopes = 1.0 - values**2 if self.activation == "tanh" else inputs > 0.0
            changes = slopes * (changes @ weights.T)
        weights, bias = self.layers[-1]
        outputs, changes = self.product(values, weights) + bias, changes @ weights.T
        return changes * (1.0 - np.tanh(outputs) ** 2 if self.squashed else np.abs(outputs) < 1.0)

    def product(self, values: Array, weights: Array) -> Array:
        """Return the product (b, m) of values (b, k) with weights (m, k), row by row."""
        result: Array = row_dots(values[:, None], weights)
        return result


def policy_parameters(algo: str, parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Return the parameters of the layers of the policy alone, without critics and exploration.

    Batch renormalisations are merged into the layers that follow them: evaluated with running statistics, they are
    affine.

    Args:
        algo: algorithm of the training.
        parameters: name -> array, with the names of Stable-Baselines3.

    Raises:
        ValueError: for a batch renormalisation that does not fit the layer that follows it.
    """
    first, last, *_ = LAYER_NAMES[one_of("algo", algo, LAYER_NAMES)]
    result = {name: each for name, each in parameters.items() if _is_layer(name, first) or name.startswith(f"{last}.")}
    for name, following in pairwise(_layer_names(result, first, last)):
        if f"{name}.{RENORM_PARTS[0]}" in result:
            own = [result.pop(f"{name}.{part}", None) for part in (*RENORM_PARTS, RENORM_COUNTER)][:-1]
            layer = {f"{following}.{part}": result.get(f"{following}.{part}") for part in ("weight", "bias")}
            result |= dict(zip(layer, _merged(f"policy.{name}", own, [*layer.values()]), strict=True))
    return result


def _merged(field: str, renorm: Sequence[Any], layer: Sequence[Any]) -> tuple[Array, Array]:
    """Return weights and bias of a layer, with the batch renormalisation of its inputs merged into them."""
    shapes = [np.shape(each) for each in (*renorm, *layer)]
    if len(shapes[-2]) != 2 or shapes != [shapes[-2][1:]] * len(renorm) + [shapes[-2], shapes[-2][:1]]:
        raise value_error(field, f"arrays {shapes}", f"{', '.join(RENORM_PARTS)} of the inputs of the next layer")
    mean, variance, scale, shift, weights, bias = (np.asarray(each, dtype=np.float64) for each in (*renorm, *layer))
    if not (variance >= 0.0).all():
        raise value_error(f"{field}.ra_var", "a number out of range", "finite numbers >= 0")
    factor = scale / np.sqrt(variance + RENORM_OFFSET)
    return weights * factor, bias + weights @ (shift - factor * mean)


def _layer_names(parameters: Collection[str], first: str, last: str) -> list[str]:
    """Return the names of the layers in the order of their numbers."""
    numbers = sorted({int(name[len(first) :].split(".")[0]) for name in parameters if _is_layer(name, first)})
    return [*(f"{first}{number}" for number in numbers), last]


def _is_layer(name: str, first: str) -> bool:
    return name.startswith(first) and is_decimal_integer(name[len(first) :].split(".")[0])


def _mapping(field: str, value: object) -> Mapping[str, Any]:
    if not isinstance(value, dict):
        raise value_error(field, type(value).__name__, "a mapping of arrays")
    return value


def _layer(result: Mapping[str, Array], name: str) -> Sequence[Array]:
    weights, bias = (result.get(f"{name}.{part}", np.zeros(0)) for part in ("weight", "bias"))
    if weights.ndim != 2 or bias.shape != weights.shape[:1]:
        raise value_error(
            f"policy.{name}", f"arrays {weights.shape} and {bias.shape}", "weights (m, k) and a bias (m,)"
        )
    return weights, bias


def _finite(field: str, value: object, least: float = -np.inf) -> Array:
    """Return an array as floats, all finite and none below `least`."""
    if not isinstance(value, np.ndarray) or value.dtype.kind != "f":
        raise value_error(field, type(value).__name__, "an array of numbers")
    if not (np.isfinite(value) & (value >= least)).all():
        raise value_error(field, "a number out of range", "finite numbers" if least < 0.0 else "finite numbers >= 0")
    return value.astype(np.float64)
