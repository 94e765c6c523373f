"""Endurance test: millions of steps with constant memory, and bitwise equality of single and vector environments."""

import re
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode

from flexman_gym.envs.config.configuration import Configuration

PARTS = ("observations", "rewards", "terminated", "truncated")
HELD = 7  # steps for which a random action is held, long enough to exceed limits


def alike(name: str, steps: int, arms: int, mode: AutoresetMode, **settings: Any) -> int:
    """Step a vector environment and the same single environments side by side; return the number of failed episodes.

    Raises:
        AssertionError: at the first difference, with the step and the kind of output.
    """
    ours = gym.make_vec(name, arms, "vector_entry_point", autoreset_mode=mode, **settings)
    single = gym.make_vec(name, arms, "sync", vector_kwargs={"autoreset_mode": mode}, **settings)
    ours.action_space.seed(0)
    assert np.array_equal(ours.reset(seed=0)[0], single.reset(seed=0)[0]), "reset"
    failures = 0
    for step in range(-(-steps // arms)):
        if step % HELD == 0:
            action = ours.action_space.sample()
        result, expected = ours.step(action), single.step(action)
        for part, one, other in zip(PARTS, result, expected, strict=False):
            assert np.array_equal(one, other), f"{part} after {step} steps"
        failures += int(result[2].sum())
        over = result[2] | result[3]
        if mode == AutoresetMode.DISABLED and over.any():
            observations = [env.reset(options={"reset_mask": over.copy()})[0][over] for env in (ours, single)]
            assert np.array_equal(*observations), f"reset after {step} steps"
    return failures


RANDOMISATION = {
    "payload_mass": (0.0, 5.0),
    "joint_stiffness_factor": (0.7, 1.3),
    "link_stiffness_factor": (0.8, 1.2),
    "rotor_inertia_factor": (0.8, 1.2),
    "joint_damping": (0.0, 20.0),
    "torque_limit_factor": (0.8, 1.0),
    "sensor_noise": (0.0, 0.01),
    "delay": (0, 3),
    "initial_vibration": (0.0, 0.01),
    "tip_impulse": (0.0, 20.0),
    "impulse_gap": 1.0,
}
STEPS, DIVERGED, ALARMS = "steps", "divergences", "steps with an energy alarm"
WARM_MEMORY, MEMORY = "memory after 100000 steps, MB", "memory at the end, MB"


@dataclass(frozen=True)
class EnduranceRow:
    """Quantity of an endurance run and its value."""

    quantity: str
    value: float


SETTLED = 100_000  # steps; warm-up, after which the memory should stay constant
ALLOWED = 0.05  # allowed relative growth of the memory
HOLDS = (1, 5, 25)  # control periods for which an action is held; longer holds lead to faster motion
BLOCK = 200  # steps whose actions are drawn at once


@dataclass
class _Count:
    """Counts of an endurance run.

    Attributes:
        steps, episodes: totals of all arms; a step that only resets an arm does not count.
        truncated: episodes that reached their time limit.
        failures: failed episodes by kind of failure.
        diverged: steps whose status was not "ok".
        alarms: steps with an energy alarm.
        memory: resident memory after SETTLED steps and at the end, MB.
        cpu: CPU time, s.
    """

    steps: int = 0
    episodes: int = 0
    truncated: int = 0
    failures: Counter[str] = field(default_factory=Counter)
    diverged: int = 0
    alarms: int = 0
    memory: tuple[float, float] = (0.0, 0.0)
    cpu: float = 0.0

    @property
    def growth(self) -> float:
        """Relative growth of the memory between the two measurements."""
        return self.memory[1] / self.memory[0] - 1.0


def _resident() -> float:
    """Return the resident memory of this process, MB."""
    result = re.search(r"VmRSS:\s*(\d+) kB", Path("/proc/self/status").read_text())
    if result is None:
        raise OSError("the memory of this process cannot be read here")
    return int(result[1]) / 1024


def _actions(arms: int, joints: int, random: np.random.Generator) -> np.ndarray:
    """Return random actions (BLOCK, arms, joints) float32; each arm holds an action for one of the HOLDS periods."""
    result = random.uniform(-1.0, 1.0, (BLOCK, arms, joints)).astype(np.float32)
    for arm in range(arms):
        hold = HOLDS[arm % len(HOLDS)]
        result[:, arm] = np.repeat(result[: -(-BLOCK // hold), arm], hold, axis=0)[:BLOCK]
    return result


def all_conditions(name: str) -> dict[str, Any]:
    """Return the keywords of a named environment with all of its conditions combined."""
    friction, general = (Configuration.find(f"{name}/{condition}") for condition in ("friction", "unknown"))
    return {
        "arm": friction.arm,
        "randomisation": {**general.given["randomisation"], "delay": (0, 2)},
    }


def endure(steps: int, arms: int, settled: int = SETTLED, name: str = "FlexRRR-v0", **settings: Any) -> _Count:
    """Run a number of steps of a named environment, by default with all randomisations, and return the counts.

    Raises:
        AssertionError: if a reward is not finite or an observation is outside its space.
    """
    env = gym.make_vec(name, arms, "vector_entry_point", **(settings or {"randomisation": RANDOMISATION}))
    random, count, before = np.random.default_rng(0), _Count(), 0.0
    joints = env.single_action_space.shape[0]  # type: ignore[index]
    assert env.reset(seed=0)[0] in env.observation_space
    started, over = time.process_time(), np.zeros(arms, dtype=bool)
    while count.steps < steps:
        for action in _actions(arms, joints, random):
            observations, rewards, terminated, truncated, infos = env.step(action)
            assert observations in env.observation_space, f"after {count.steps} steps"
            assert np.isfinite(rewards).all(), f"after {count.steps} steps"
            count.steps += int(arms - over.sum())
            count.alarms += int(infos["energy_alarm"].sum())
            over = terminated | truncated
            count.episodes += int(over.sum())
            count.truncated += int((truncated & ~terminated).sum())
            for arm in np.flatnonzero(terminated):
                count.failures[infos["failure"][arm].split(" ")[0]] += 1
                count.diverged += int(infos["status"][arm] != "ok")
            if not before and count.steps >= settled:
                before = _resident()
            if count.steps >= steps:
                break
    count.cpu = time.process_time() - started
    count.memory = before, _resident()
    return count


def endurance_rows(count: _Count) -> list[EnduranceRow]:
    """Return the counts of a run as rows."""
    values = {
        STEPS: count.steps, "steps per CPU second": round(count.steps / count.cpu), "episodes": count.episodes,
        "ended by their time limit": count.truncated,
        **{f"ended by a failure of {name}": number for name, number in count.failures.most_common()},
        DIVERGED: count.diverged, ALARMS: count.alarms, WARM_MEMORY: count.memory[0], MEMORY: count.memory[1],
    }  # fmt: skip
    return [EnduranceRow(name, float(value)) for name, value in values.items()]
