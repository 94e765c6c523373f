"""Parts: what a step of the vector environment spends its time on."""

from collections.abc import Callable, Sequence

import numpy as np

from flexman_gym.envs.vector_env import FlexManVectorEnv
from flexman_gym.simulation.helper import Helper
from studies.benchmark.rows import PARTS, Row, in_turns, timer

ARMS, CALLS = (1, 64), 400
WHOLE, HANDED = "a step of the vector environment", "an empty task for another thread, and back"
NOTE = """A step of the vector environment of `FlexRRR-v0`, and some of the calls in it, repeated alone. The other calls
check actions and limits, and copy results for whoever calls. The last row is the cost of a second thread before it has
done anything; there the time of the clock counts."""


def rows(rounds: int, arms: Sequence[int] = ARMS, calls: int = CALLS) -> list[Row]:
    """A row for each part and number of arms."""
    parts = {(name, count): call for count in arms for name, call in _calls(count).items()}
    helper = Helper()

    def handed() -> None:
        helper.begin(_nothing)
        helper.finish()

    timers = {f"{name} {count}": timer(_repeated(call, calls), calls) for (name, count), call in parts.items()}
    timers[HANDED] = timer(_repeated(handed, calls), calls)
    costs = [np.median(cost, axis=0) for cost in in_turns(timers, rounds).values()]
    heads = [*((name, float(count), 1.0) for name, count in parts), (HANDED, None, 2.0)]
    return [Row(PARTS, *head, float(cost[0]), float(cost[1])) for head, cost in zip(heads, costs, strict=True)]


def _calls(arms: int) -> dict[str, Callable[[], object]]:
    """Calls that belong to a step of so many arms, which rest."""
    env = FlexManVectorEnv(arms)
    env.reset(seed=0)
    episodes, view = env.episodes, env.episodes.view
    action, drive = np.zeros(env.action_space.shape or ()), np.zeros((arms, episodes.batch.model.n_joints + 6))
    shown = view.alone() if arms == 1 else view
    return {
        WHOLE: lambda: env.step(action),
        "moving the arms": lambda: episodes.batch.step(drive),
        "reading the motion": view.read,
        "sensors": episodes.sight.sensors.read,
        "rewards and info": lambda: episodes.outcome(shown),
    }


def _repeated(call: Callable[[], object], times: int) -> Callable[[], None]:
    def repeat() -> None:
        for _ in range(times):
            call()

    return repeat


def _nothing() -> None:
    pass
