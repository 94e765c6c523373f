"""Oracle observer with the true state, parameters and delay; not realisable on hardware."""

from collections.abc import Mapping

import numpy as np

from flexman_gym.agent.controller import EpisodeInfo, Plant, Readings
from flexman_gym.common.arrays import Array, BoolArray, IntArray, pad_rows
from flexman_gym.simulation.physical_parameters import PARAMETERS, UNCERTAIN
from flexman_gym.toolbox.controllers.internal_model import DelayCompensation
from flexman_gym.toolbox.controllers.observers.observer import Estimate
from flexman_gym.toolbox.controllers.observers.perturbed_models import UncertainParameters

# Time constant T (s) and exponent k of the remaining deviation 1 / (1 + (t / T)^k): the medians of the Estimator on
# 24 arms of FlexRRR-v0 under unknown-lab agree within a third
DEVIATION_DECAY = {"payload_mass": (0.2, 3.0), "joint_stiffness": (0.1, 3.0), "link_stiffness_factor": (0.26, 2.0)}


class Oracle:
    """Privileged observer: the true state, predicted over the delay with the true parameters.

    Args:
        plant: plant model; the true parameters are those of each episode.
        doubt: True to add to the uncertain parameters a simulated estimation error that decays as that of `Estimator`,
            for agents that are trained with the oracle and run with the estimator.
        time: factor of the times of this decay, for an arm whose slews are longer or shorter than those of FlexRRR-v0.
    """

    sensors: tuple[str, ...] = ("state",)
    state_fields = ("_prediction", "_ages")

    def __init__(self, plant: Plant, doubt: bool = False, time: float = 1.0) -> None:
        self._prediction, self._delays = DelayCompensation(plant), np.zeros(0, dtype=np.int64)
        self._parameters: dict[str, Array] = {}
        self._plant, self._time, self._ages = plant, time, np.zeros(0, dtype=np.int64)
        ranges = {name: span for name, span in plant.unknown.items() if UNCERTAIN.get(name) in DEVIATION_DECAY}
        self._uncertain = UncertainParameters(plant.model, ranges) if doubt and ranges else None
        # true parameter vectors and standard normal errors
        self._theta = np.zeros((0, 2, len(self._uncertain.names) if self._uncertain else 0))

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Store parameters and delays of new episodes; arguments as in `Controller.reset`."""
        self._prediction.reset(arms, count, episode.drawn.get("torque_limit"))
        self._prediction.extend(int(np.max(episode.drawn.get("delay", 0), initial=0)))
        drawn = {name: values.astype(float) for name, values in episode.drawn.items() if name in PARAMETERS}
        for name, values in drawn.items():
            self._parameters[name] = pad_rows(self._parameters.get(name, values[:0]), count)
            self._parameters[name][arms] = values
        self._prediction.set_parameters(arms, drawn)
        self._delays, self._ages = pad_rows(self._delays, count), pad_rows(self._ages, count)
        self._delays[arms], self._ages[arms] = episode.drawn.get("delay", 0), 0
        if self._uncertain:
            self._theta = pad_rows(self._theta, count)
            self._theta[arms, 0] = self._normalised_parameters(arms)
            for arm in arms.tolist():  # seeded by the parameters: equal arms have equal errors
                random = np.random.default_rng(np.abs(self._theta[arm, 0].view(np.int64)))
                self._theta[arm, 1] = random.standard_normal(self._theta.shape[2])

    def _normalised_parameters(self, arms: IntArray) -> Array:
        """Return the true parameter vectors (r, p) of arms (r,), see `UncertainParameters`."""
        assert self._uncertain is not None
        columns = zip(self._uncertain.names, self._uncertain.joints, self._uncertain.scales, strict=True)
        values = [(self._parameters[name][arms], joint, scale) for name, joint, scale in columns]
        return np.stack([(each if each.ndim == 1 else each[:, joint]) / scale for each, joint, scale in values], axis=1)

    @property
    def _remaining_deviation(self) -> Array:
        """Standard deviations (b, p) as fractions of the prior standard deviations."""
        assert self._uncertain is not None
        scales, powers = np.array([DEVIATION_DECAY[name] for name in self._uncertain.names]).T
        return 1.0 / (1.0 + (self._ages[:, None] * self._plant.period / (self._time * scales)) ** powers)

    def _current_parameters(self) -> dict[str, Array]:
        """Return the parameters of all arms, name -> (b, ...), with the simulated estimation errors."""
        if self._uncertain is None:
            return dict(self._parameters)
        uncertain, remaining, (true, errors) = self._uncertain, self._remaining_deviation, self._theta.swapaxes(0, 1)
        initial, later = uncertain.mean - true, uncertain.deviation * errors
        theta = true + remaining * (remaining * initial + np.sqrt(1.0 - remaining**2) * later)
        estimated = uncertain.values(self._plant.model, np.clip(theta, uncertain.low, uncertain.high))
        return self._parameters | estimated

    @property
    def estimates(self) -> Mapping[str, Array]:
        """Standard deviations of the simulated errors, NAME_deviation -> (b, ...); {} without simulated errors."""
        if self._uncertain is None:
            return {}
        return self._uncertain.deviations(self._remaining_deviation * self._uncertain.deviation)

    def estimate(self, readings: Readings, applied: Array, active: BoolArray) -> Estimate:
        """Return the true state at the time at which torques commanded now take effect; see `Observer`."""
        states, arms = np.array(readings["state"], dtype=float), np.flatnonzero(active)
        self._prediction.record(arms, applied[arms])
        states[arms] = self._prediction(arms, states[arms], self._delays[arms])
        result = Estimate(states, self._delays, self._current_parameters())
        self._ages += active
        return result
