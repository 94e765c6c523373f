"""PPO trained inside the safety filter, free, and with episodes that end at a violation; PPO trained to violate."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import product
from pathlib import Path
from time import process_time

import numpy as np

from flexman_agents.sb3 import make_model
from flexman_agents.settings import find_recipe
from flexman_gym.common.arrays import Array
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.episodes import Episodes
from flexman_gym.envs.view import View
from flexman_gym.evaluation.agent_spec import AgentSpec
from flexman_gym.evaluation.metrics import METRICS
from flexman_gym.evaluation.rollouts import rollout
from flexman_gym.metrics.statistics import upper_median
from studies.safety.measure import ACCEPTED, ENVIRONMENT, kept

RECIPE = "one_ppo_safety"  # settings of all trainings
SEEDS, TEST_SEEDS = (0, 1), range(9000, 9100)  # of trainings, and of the moves of a policy
KINDS = {"inside": (True, "cost"), "free": (False, "cost"), "ended": (False, "end")}  # filter, on_violation
ADVERSARY_STEPS = 300_000  # actions of the training of the adversary, of 5 control periods each
INTERFACE = {"action_repeat": 5, "sensors": "full"}


@dataclass(frozen=True)
class LearningRow:
    """Policy of one training; a violation is an excess above 2 % of the limit.

    Attributes:
        training: key of KINDS.
        seed: seed of the training.
        steps: actions of the training.
        cpu: CPU time of the training, min.
        episodes, violating: episodes of the training, and those with a violation.
        filtered: True for moves with the filter.
        violations: share of the moves with a violation, after the training.
        settled: share of settled moves.
        settling: median settling time, s.
        reward: mean return.
    """

    training: str
    seed: int
    steps: int
    cpu: float
    episodes: int
    violating: int
    filtered: str
    violations: float
    settled: float
    settling: float
    reward: float


def task(on_violation: str) -> Configuration:
    """Return the environment of the recipe without the filter."""
    environment = find_recipe(RECIPE).environment
    return environment.replace(safety=False, limits=replace(environment.limits, on_violation=on_violation))


class ViolationCount:
    """Number of the episodes of a training, and of those with a violation."""

    def __init__(self, episodes: Episodes) -> None:
        self._episodes, self._violated = episodes, np.zeros(len(episodes.over), dtype=bool)
        self.ended, self.violating = 0, 0

    def __call__(self) -> None:
        """Count after a control period."""
        over = self._episodes.over
        self._violated |= self._episodes.excess > ACCEPTED
        self.ended += int(over.sum())
        self.violating += int((over & self._violated).sum())
        self._violated[over] = False


def trained(environment: Configuration, seed: int, steps: int) -> tuple[AgentSpec, ViolationCount, float]:
    """Return a trained policy, the count of violations of its training, and the CPU time, min."""
    started = process_time()
    model = make_model(replace(find_recipe(RECIPE), environment=environment, seed=seed, steps=steps))
    episodes = model.get_env().get_attr("episodes")[0]  # type: ignore[union-attr]
    episodes.callback = count = ViolationCount(episodes)
    model.learn(steps)
    return AgentSpec.from_predictor(model), count, (process_time() - started) / 60.0


def learning_rows(folder: Path) -> Iterator[LearningRow]:
    """Yield the rows, two for each policy: without and with the filter; finished policies are kept in a folder."""
    for seed, (kind, (safety, on_violation)) in product(SEEDS, KINDS.items()):
        values = kept(folder / f"learning_{kind}_{seed}.npy", lambda: _measured(seed, safety, on_violation))  # noqa: B023
        for filtered, (cpu, episodes, violating, *rest) in zip((False, True), values, strict=True):
            counts = int(episodes), int(violating), str(filtered)
            yield LearningRow(kind, seed, find_recipe(RECIPE).steps, cpu, *counts, *rest)


def _measured(seed: int, safety: bool, on_violation: str) -> list[list[float]]:
    """Return the numbers from `cpu` on of the rows of a policy, without and with the filter."""
    policy, count, cpu = trained(task(on_violation).replace(safety=safety), seed, find_recipe(RECIPE).steps)
    result = []
    for filtered in (False, True):
        records = rollout(policy, task("cost"), list(TEST_SEEDS), safety=filtered).records
        settling = np.array([METRICS["settling_time"].evaluate([record]) for record in records])
        violated = [float(record.excess.max()) > ACCEPTED for record in records if record.excess is not None]
        result.append([cpu, count.ended, count.violating, float(np.mean(violated)), float(np.isfinite(settling).mean()),
                       upper_median(settling), METRICS["reward"].evaluate(records)])  # fmt: skip
    return result


def _largest_share(view: View, strain: Array, torque: Array) -> Array:
    """Return the largest strain and spring torque (b,) as fractions of their limits, the reward of the adversary."""
    parts = [view.root_strains / strain, view.spring_torques / torque]
    return np.asarray(np.abs(np.concatenate(parts, axis=1)).max(axis=1))


@cache
def adversary() -> AgentSpec:
    """Return a policy of FlexRRR-v0 that is trained to break the limits of strain and spring torque."""
    limits = Configuration.find(ENVIRONMENT, ["limits=study"]).limits
    reward = partial(_largest_share, strain=limits.of_quantities("strain"), torque=np.array(limits.spring_torque))
    environment = Configuration.find(ENVIRONMENT).replace(reward=reward, limits=replace(limits, on_violation="cost"))
    return trained(environment.replace(**INTERFACE), 0, ADVERSARY_STEPS)[0]
