"""Vector environment: many arms, each in its own episode, behind Gymnasium's interface for vectors."""

import fcntl
from collections.abc import Sequence
from contextlib import nullcontext
from functools import cache
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import logger
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from flexman_gym.common.arrays import Array, BoolArray, IntArray, Vector
from flexman_gym.common.checks import one_of, sequence, value_error, whole_number
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.config.reset_options import check_parameters
from flexman_gym.envs.env import MAX_SEED, FlexManEnv, observation_space
from flexman_gym.envs.episodes import Episodes, action_space, validate_actions
from flexman_gym.envs.rendering import RENDER_KEYWORDS, make_renderer
from flexman_gym.envs.stateful import Observations, StatefulEnv
from flexman_gym.kernels import CACHE_FOLDER, layout
from flexman_gym.simulation.batch import MAX_ARMS, Batch

Infos = dict[str, Any]


def _batched(info: Infos) -> Infos:
    """The info of an arm alone, with an axis for the arms in front of every number and array."""
    return {key: _batched(value) if isinstance(value, dict) else np.array([value]) for key, value in info.items()}


def _with_masks(infos: Infos, mask: BoolArray) -> Infos:
    """The infos with a mask for each key, those of dicts inside too."""
    result = {}
    for key, value in infos.items():
        result[key] = _with_masks(value, mask) if isinstance(value, dict) else value
        result[f"_{key}"] = mask
    return result


def _masked(infos: Infos, mask: BoolArray) -> Infos:
    """Infos of the arms of a mask alone, zero (None for objects) elsewhere."""
    result: Infos = {}
    for key, value in infos.items():
        if isinstance(value, dict):
            result[key] = _masked(value, mask)
        elif not key.startswith("_"):
            result[key] = np.zeros_like(value) if value.dtype != object else np.full_like(value, None)
            result[key][mask] = value[mask]
        result[key if key.startswith("_") else f"_{key}"] = mask.copy()
    return result


MAX_STEPS = 10**9  # steps of an episode
INFO_MODES = ("always", "at end")
MAX_SEED_STRIDE = 10**12
OWN_KEYWORDS = ("num_envs", "threads", "max_episode_steps", "autoreset_mode", "infos", "seed_stride", *RENDER_KEYWORDS)
INDEXED_ATTRIBUTES = ("render", "np_random", "np_random_seed")  # what has an entry for each arm already


class FlexManVectorEnv(StatefulEnv, VectorEnv[Observations, Array, Any]):
    """Many `FlexManEnv` in one: `gym.make_vec("FlexRRR-v0", num_envs=64, vectorization_mode="vector_entry_point")`.

    Observations, rewards, terminations, truncations and infos are those of `gymnasium.vector.SyncVectorEnv` over the
    single environment, bit for bit, with an axis for the arms in front. Infos follow Gymnasium's convention: an array
    for each key and its mask under the key with an underscore in front; masks of one info may be the same array.

    `reset(seed=...)` takes a list of a seed for each arm, or one seed s, of which arm i takes s * seed_stride + i. With
    a stride of at least `num_envs`, environments with the seeds s and s + 1 have no episode in common. Options may set
    "start", "goal_angles" and "parameters" for all arms, or with a leading axis for each. With
    autoreset_mode="Disabled" the option "reset_mask", (num_envs,) bool, says which arms are reset.

    Args:
        num_envs: number of arms.
        threads: that move them, at most one for 32 arms; a second one pays where a core has nothing else to do.
        max_episode_steps: steps after which an episode is truncated; None takes the `horizon`.
        autoreset_mode: an AutoresetMode of Gymnasium, or its value.
        infos: "always", or "at end" for those of arms whose episode has just ended alone; with "SameStep" these are
            `final_obs` and `final_info`. All other infos, those of a reset too, are then empty and cost nothing.
        seed_stride: by which a seed counts, see above.
        render_mode: see `FlexManEnv`; a frame of each arm, of which `draw.grid` makes one picture.
        render_size: see `FlexManEnv`.
        render_camera: see `FlexManEnv`.
        render_gain: see `FlexManEnv`.
        render_overlays: see `FlexManEnv`.
        settings: the attributes of `Configuration`, and "condition"; see `FlexManEnv`.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """

    kept, spaces = ("_randoms", "_seeds"), ("action_space", "single_action_space")
    metadata = FlexManEnv.metadata | {"render_modes": ["rgb_array"], "autoreset_mode": AutoresetMode.NEXT_STEP}

    def __init__(
        self,
        num_envs: int = 1,
        *,
        threads: int = 1,
        max_episode_steps: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        infos: str = "always",
        seed_stride: int = 1,
        render_mode: str | None = None,
        render_size: tuple[int, int] = (480, 360),
        render_camera: Vector | None = None,
        render_gain: float = 1.0,
        render_overlays: bool = True,
        **settings: Any,
    ) -> None:
        modes = {mode.value: mode for mode in AutoresetMode}
        chosen = autoreset_mode.value if isinstance(autoreset_mode, AutoresetMode) else autoreset_mode
        self.autoreset_mode = modes[one_of("autoreset_mode", chosen, modes)]
        self.num_envs = whole_number("num_envs", num_envs, 1, MAX_ARMS)
        self._at_end = one_of("infos", infos, INFO_MODES) == "at end"
        self._stride = whole_number("seed_stride", seed_stride, 1, MAX_SEED_STRIDE)
        self.render_mode, look = render_mode, (render_size, render_camera, render_gain, render_overlays)
        given = num_envs, threads, max_episode_steps, autoreset_mode, infos, seed_stride, render_mode, *look
        self._made = dict(zip(OWN_KEYWORDS, given, strict=True)) | settings
        setup = Configuration.from_keywords(settings, OWN_KEYWORDS)
        model, method, step, self.choice = resolve_fidelity(setup)
        period = setup.control_period
        self.batch = Batch(model, method, step, period, arms=num_envs, threads=threads)
        self.setup, self.task, self.torque_limit = setup, setup.task, np.array(setup.torque_limit)
        self.episodes = Episodes(setup, self.batch)
        self._rendering = make_renderer(render_mode, self.episodes, setup.id, look, ("rgb_array",))
        if max_episode_steps is not None:
            self.episodes.longest = setup.action_repeat * whole_number(
                "max_episode_steps", max_episode_steps, 1, MAX_STEPS
            )
        self.max_episode_steps = -(-self.episodes.longest // setup.action_repeat)
        self.sensors = self.episodes.sensors
        self.single_observation_space = observation_space(self.episodes)
        size = len(self.episodes.agent.mode.names)
        self.single_action_space = action_space(size)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.metadata = self.metadata | {"autoreset_mode": self.autoreset_mode, "render_fps": round(1 / period)}
        self._shape = (num_envs, size)
        self._allowed = f"{num_envs} rows of {size} numbers from -1 to 1"
        self._randoms: list[np.random.Generator | None] = [None] * num_envs
        self._seeds = [-1] * num_envs
        self._ok, self._no_failure = (np.full(num_envs, text, dtype=object) for text in (layout.STATUS[0], ""))
        self._everyone = np.ones(num_envs, dtype=bool)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, Infos]:
        """Starts the episodes of all arms, or of those of options["reset_mask"]; see the class.

        Raises:
            ValueError: one line, for a seed or options that are not allowed. The next reset gives what it would have
                given, but the episodes of these arms may be over.
        """
        seeds = self._each_seed(seed)
        check_parameters(options, self.batch)
        mask = None
        if isinstance(options, dict) and "reset_mask" in options:
            options = dict(options)
            mask = self._checked_mask(options.pop("reset_mask"))
        arms = np.arange(self.num_envs) if mask is None else np.flatnonzero(mask)
        with self._undoing(options):
            for arm in arms:
                if seeds[arm] is not None:
                    self._randoms[arm], self._seeds[arm] = seeding.np_random(seeds[arm])
            self._restart(arms, options)
        infos = {} if self._at_end else self._infos()
        return self.episodes.agent.observations.copy(), infos if mask is None else _masked(infos, mask)

    def step(self, actions: NDArray[Any]) -> tuple[Observations, Array, BoolArray, BoolArray, Infos]:
        """Applies actions (num_envs, k) for `action_repeat` control periods, and resets as the autoreset mode says.

        Raises:
            ValueError: for actions of another shape or outside the action space.
            RuntimeError: before a reset and, with autoreset_mode="Disabled", for an arm whose episode is over.
        """
        episodes, over = self.episodes, self.episodes.over
        values = validate_actions("actions", actions, self._shape, self._allowed)
        late = np.flatnonzero(over) if np.count_nonzero(over) else None
        if late is not None and (self.autoreset_mode != AutoresetMode.NEXT_STEP or None in self._randoms):
            raise RuntimeError(f"the episodes of arms {late.tolist()} are over: reset them first")
        rewards = episodes.step(values)
        if late is not None:
            self._restart(late, None)
        ending = bool(episodes.failures) or bool(np.count_nonzero(episodes.truncated))
        infos = self._infos() if ending or not self._at_end else {}
        if late is not None:
            rewards[late] = 0.0
        truncations = episodes.truncated.copy()
        terminations = np.zeros(self.num_envs, dtype=bool)
        if ending:
            terminations[list(episodes.failures)] = True
            if self.autoreset_mode == AutoresetMode.SAME_STEP:
                infos = self._finish(over.copy(), infos)
            elif self._at_end:
                infos = _masked(infos, terminations | truncations)
        return episodes.agent.observations.copy(), rewards, terminations, truncations, infos

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Frames (height, width, 3) uint8 of the deformed arms and their targets."""
        if self._rendering is None:
            logger.warn('render() needs render_mode="rgb_array" in gymnasium.make_vec')
            return None
        return tuple(map(self._rendering.frame, range(self.num_envs)))

    def call(self, name: str, *args: Any, **named: Any) -> tuple[Any, ...]:
        """Gives what a method or an attribute of the environment gives, once for each arm, as SyncVectorEnv does.

        Spaces are those of one arm. What has no entry for each arm is shared by all.

        Raises:
            ValueError: for "reset", "step" and "close", which no arm can do alone.
            AttributeError: for a name that the environment does not have.
        """
        if name in ("reset", "step", "close"):
            raise value_error(
                "call", name, "a method that an arm has alone: call the environment's own, which moves all"
            )
        value = getattr(self, f"single_{name}" if name in ("observation_space", "action_space") else name)
        value = value(*args, **named) if callable(value) else value
        return tuple(value) if name in INDEXED_ATTRIBUTES and value is not None else (value,) * self.num_envs

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Gives an attribute once for each arm, see `call`."""
        return self.call(name)

    def _finish(self, ended: BoolArray, infos: Infos) -> Infos:
        """Resets the arms that have ended; returns the infos of all, with what the ended ones were."""
        final = np.full(self.num_envs, None, dtype=object)
        arms = np.flatnonzero(ended)
        for arm in arms:
            final[arm] = self.episodes.agent.observations[arm].copy()
        self._restart(arms, None)
        both = _masked({"final_obs": final, "final_info": _masked(infos, ended)}, ended)
        return both if self._at_end else both | self._infos()

    def _restart(self, arms: IntArray, options: dict[str, Any] | None) -> None:
        randoms = self.np_random
        self.episodes.reset(arms, [randoms[arm] for arm in arms], options)

    def _infos(self) -> Infos:
        """Return the infos of the present states."""
        episodes, view = self.episodes, self.episodes.view
        infos = _batched(episodes.info()) if self.num_envs == 1 else episodes.info()
        status, failure = self._ok.copy(), self._no_failure.copy()
        for arm, text in episodes.failures.items():
            status[arm], failure[arm] = layout.STATUS[self.batch.status[arm]], text
        infos |= {
            "status": status, "failure": failure, "tip": view.tip.copy(), "target": view.target.copy(),
            "goal_angles": view.goal_angles.copy(),
        }  # fmt: skip
        if episodes.effects is not None:
            infos["drawn"] = episodes.effects.drawn
        if estimates := getattr(episodes.base, "estimates", None):
            infos["estimates"] = {name: values.copy() for name, values in estimates.items()}
        return _with_masks(infos, self._everyone.copy())

    @property  # type: ignore[misc]
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]
        """The generator of each arm, of starts and postures; made with a random seed where there is none."""
        for arm, random in enumerate(self._randoms):
            if random is None:
                self._randoms[arm], self._seeds[arm] = seeding.np_random()
        return tuple(self._randoms)  # type: ignore[arg-type]

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]
        """The seed of each arm's generator."""
        return tuple(self._seeds) if self.np_random else ()

    def _generators(self, own: dict[str, Any]) -> list[np.random.Generator | None]:
        return list(own["_randoms"])

    def _each_seed(self, seed: object) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, int | np.integer):
            first = whole_number("seed", seed, 0, MAX_SEED)
            return [first * self._stride + arm for arm in range(self.num_envs)]
        if not isinstance(seed, list | tuple | np.ndarray) or len(sequence("seed", seed)) != self.num_envs:
            raise value_error("seed", seed, f"a whole number, or a list of {self.num_envs}")
        return [
            each if each is None else whole_number(f"seed[{arm}]", each, 0, MAX_SEED) for arm, each in enumerate(seed)
        ]

    def _checked_mask(self, mask: object) -> BoolArray:
        if isinstance(mask, np.ndarray) and mask.shape == (self.num_envs,) and mask.dtype == bool and mask.any():
            return mask
        raise value_error("options['reset_mask']", mask, f"an array ({self.num_envs},) of bool, not all of them False")


@cache
def compile_kernels() -> None:
    """Compile the kernels of the environments; a lock lets only one process on a computer compile while others wait."""
    with (Path(CACHE_FOLDER) / "lock").open("w") if CACHE_FOLDER else nullcontext() as lock:
        if lock is not None:
            fcntl.flock(lock, fcntl.LOCK_EX)
        for env in (gym.make("FlexRRR-v0"), gym.make_vec("FlexRRR-v0", 2, "vector_entry_point")):
            env.reset(seed=0)
            env.step(env.action_space.sample())
