"""Vector environment: many arms with separate episodes, with the vector interface of Gymnasium."""

from collections.abc import Sequence
from functools import cache
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import logger
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from flexman_gym.common.arrays import Array, BoolArray, IntArray, Vector
from flexman_gym.common.checks import one_of, sequence, whole_number
from flexman_gym.common.errors import value_error
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.config.reset_options import check_parameters
from flexman_gym.envs.env import MAX_SEED, FlexManEnv
from flexman_gym.envs.episodes import Episodes, validate_actions
from flexman_gym.envs.infos import INFO_MODES, Infos, batched_info, flat_info, masked, with_masks
from flexman_gym.envs.rendering import RENDER_KEYWORDS, make_renderer
from flexman_gym.envs.stateful import Observations, StatefulEnv
from flexman_gym.kernels import layout
from flexman_gym.simulation.batch import MAX_ARMS, Batch

MAX_STEPS = 10**9  # largest max_episode_steps
MAX_SEED_STRIDE = 10**12  # largest seed_stride
OWN_KEYWORDS = ("num_envs", "threads", "max_episode_steps", "autoreset_mode", "infos", "seed_stride", *RENDER_KEYWORDS)
INDEXED_ATTRIBUTES = ("render", "np_random", "np_random_seed")  # members with an entry for each arm


class FlexManVectorEnv(StatefulEnv, VectorEnv[Observations, Array, Any]):
    """Vectorised `FlexManEnv`: `gym.make_vec("FlexRRR-v0", num_envs=64)`.

    Each of the b = `num_envs` arms is one sub-environment. Observations, rewards, terminations, truncations and infos
    equal the results of `gymnasium.vector.SyncVectorEnv` over single environments, bit for bit, with a leading axis for
    the arms. Infos follow the convention of Gymnasium: an array for each key, and its mask under the key with a leading
    underscore. Several masks may be the same array object.

    `reset(seed=...)` takes a list with a seed for each arm, or one seed s; arm i then has the seed s * seed_stride + i.
    With a stride of at least `num_envs`, the seeds s and s + 1 of the vector environment share no seed of an arm. The
    options "start", "goal_angles" and "parameters" apply to all arms, or have a leading axis for the arms. With
    autoreset_mode="Disabled" the option "reset_mask", (num_envs,) bool, selects the arms to reset.

    Args:
        num_envs: number of arms.
        threads: number of threads, at most one per 32 arms; a second thread is faster only on an idle core.
        max_episode_steps: steps after which an episode is truncated; None for the `horizon`.
        autoreset_mode: an AutoresetMode of Gymnasium, or its value.
        infos: "always"; "flat" for `flat_info`, without nested dicts and texts; "at end" for infos only of arms whose
            episode has just ended, while all other infos, including those of a reset, are empty, which saves time; or
            "none". With autoreset_mode="SameStep" `final_obs` and `final_info` are those of the ended episodes.
        seed_stride: factor on a single seed, see above.
        render_mode: None or "rgb_array"; `render` returns one frame per arm, which `draw.grid` combines.
        render_size: see `FlexManEnv`.
        render_camera: see `FlexManEnv`.
        render_gain: see `FlexManEnv`.
        render_overlays: see `FlexManEnv`.
        **settings: the attributes of `Configuration`, and "condition"; see `FlexManEnv`.
    """

    state_fields, spaces = ("_randoms", "_seeds"), ("action_space", "single_action_space")
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
        render_gain: float | Vector = 1.0,
        render_overlays: bool = True,
        **settings: Any,
    ) -> None:
        modes = {mode.value: mode for mode in AutoresetMode}
        chosen = autoreset_mode.value if isinstance(autoreset_mode, AutoresetMode) else autoreset_mode
        self.autoreset_mode = modes[one_of("autoreset_mode", chosen, modes)]
        self.num_envs = whole_number("num_envs", num_envs, 1, MAX_ARMS)
        self._info_mode = one_of("infos", infos, INFO_MODES)
        self._seed_stride = whole_number("seed_stride", seed_stride, 1, MAX_SEED_STRIDE)
        self.render_mode, rendering = render_mode, (render_size, render_camera, render_gain, render_overlays)
        given = num_envs, threads, max_episode_steps, autoreset_mode, infos, seed_stride, render_mode, *rendering
        self._arguments = dict(zip(OWN_KEYWORDS, given, strict=True)) | settings
        configuration = Configuration.from_keywords(settings, OWN_KEYWORDS)
        self.batch, self.choice = _make_batch(configuration, self.num_envs, threads)
        self.configuration, self.task = configuration, configuration.task
        self.torque_limit = np.array(configuration.torque_limit)
        self.episodes = Episodes(configuration, self.batch)
        self._rendering = make_renderer(render_mode, self.episodes, configuration.id, rendering, ("rgb_array",))
        if max_episode_steps is not None:
            self.episodes.max_periods = configuration.action_repeat * whole_number(
                "max_episode_steps", max_episode_steps, 1, MAX_STEPS
            )
        self.max_episode_steps = -(-self.episodes.max_periods // configuration.action_repeat)
        self.sensors = self.episodes.sensors
        self.single_observation_space, self.single_action_space = self.episodes.make_spaces()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        rate = round(1 / configuration.control_period)
        self.metadata = self.metadata | {"autoreset_mode": self.autoreset_mode, "render_fps": rate}
        size = len(self.episodes.agent.mode.names)
        self._action_shape, self._allowed_actions = (num_envs, size), f"{num_envs} rows of {size} numbers from -1 to 1"
        self._randoms: list[np.random.Generator | None] = [None] * num_envs
        self._seeds = [-1] * num_envs
        texts = layout.STATUS[0], "", self.batch.method.name
        self._status_ok, self._no_failure, self._method = (np.full(num_envs, text, dtype=object) for text in texts)
        self._all_arms = np.ones(num_envs, dtype=bool)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, Infos]:
        """Start the episodes of all arms, or of the arms in options["reset_mask"]; see the class.

        Args:
            seed: one seed, or a list with one for each arm.
            options: see the class.

        Returns:
            Observations (num_envs, size) and infos.

        Raises:
            ValueError: for a seed or options that are not allowed. The running episodes of these arms may then be over;
                the result of the next reset is not affected.
        """
        seeds = self._each_seed(seed)
        check_parameters(options, self.batch)
        mask = None
        if isinstance(options, dict) and "reset_mask" in options:
            options = dict(options)
            mask = self._checked_mask(options.pop("reset_mask"))
        arms = np.arange(self.num_envs) if mask is None else np.flatnonzero(mask)
        with self._restored_on_error(options):
            for arm in arms:
                if seeds[arm] is not None:
                    self._randoms[arm], self._seeds[arm] = seeding.np_random(seeds[arm])
            self._restart(arms, options)
        infos = {} if self._info_mode == "at end" else self._infos()
        return self.episodes.agent.observations.copy(), infos if mask is None else masked(infos, mask)

    def step(self, actions: NDArray[Any]) -> tuple[Observations, Array, BoolArray, BoolArray, Infos]:
        """Apply actions for `action_repeat` control periods, and reset according to the autoreset mode.

        Args:
            actions: (num_envs, k) values from -1 to 1; by default one for each motor of an arm.

        Returns:
            Observations (num_envs, size), rewards, terminations and truncations (num_envs,), and infos.

        Raises:
            ValueError: for actions of the wrong shape, with NaN or infinite values, or, without clip_actions, outside
                the action space.
            RuntimeError: before the first reset; with autoreset_mode="Disabled" also if the episode of an arm is over.
        """
        episodes, over = self.episodes, self.episodes.over
        clip = self.configuration.clip_actions
        values = validate_actions("actions", actions, self._action_shape, self._allowed_actions, clip)
        finished = np.flatnonzero(over) if np.count_nonzero(over) else None
        if finished is not None and (self.autoreset_mode != AutoresetMode.NEXT_STEP or None in self._randoms):
            raise RuntimeError(f"the episodes of arms {finished.tolist()} are over: reset them first")
        rewards = episodes.step(values)
        if finished is not None:
            self._restart(finished, None)
        any_ended = bool(episodes.failures) or bool(np.count_nonzero(episodes.truncated))
        infos = self._infos() if any_ended or self._info_mode != "at end" else {}
        if finished is not None:
            rewards[finished] = 0.0
        truncations = episodes.truncated.copy()
        terminations = np.zeros(self.num_envs, dtype=bool)
        if any_ended:
            terminations[list(episodes.failures)] = True
            if self.autoreset_mode == AutoresetMode.SAME_STEP:
                infos = self._reset_ended(over.copy(), infos)
            elif self._info_mode == "at end":
                infos = masked(infos, terminations | truncations)
        return episodes.agent.observations.copy(), rewards, terminations, truncations, infos

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Return a frame (height, width, 3) uint8 of each deformed arm and its target.

        Raises:
            RuntimeError: before the first reset.
        """
        if self._rendering is None:
            logger.warn('render() needs render_mode="rgb_array" in gymnasium.make_vec')
            return None
        return tuple(map(self._rendering.frame, range(self.num_envs)))

    def call(self, name: str, *args: Any, **named: Any) -> tuple[Any, ...]:
        """Return the result of a method or the value of an attribute for each arm, as in SyncVectorEnv.

        Spaces are the spaces of one arm. A value without an entry for each arm is repeated for all arms.

        Args:
            name: name of the method or the attribute.
            *args: arguments of the method.
            **named: keyword arguments of the method.

        Returns:
            One value for each arm.

        Raises:
            ValueError: for "reset", "step" and "close", which act on all arms at once.
            AttributeError: for an unknown name.
        """
        if name in ("reset", "step", "close"):
            raise value_error(
                "call", name, "a method that an arm has alone: call the environment's own, which moves all"
            )
        value = getattr(self, f"single_{name}" if name in ("observation_space", "action_space") else name)
        value = value(*args, **named) if callable(value) else value
        return tuple(value) if name in INDEXED_ATTRIBUTES and value is not None else (value,) * self.num_envs

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Return the value of an attribute for each arm, see `call`."""
        return self.call(name)

    def _reset_ended(self, ended: BoolArray, infos: Infos) -> Infos:
        """Reset the arms whose episodes have ended; return the infos of all arms, with "final_obs" and "final_info"."""
        final = np.full(self.num_envs, None, dtype=object)
        arms = np.flatnonzero(ended)
        for arm in arms:
            final[arm] = self.episodes.agent.observations[arm].copy()
        self._restart(arms, None)
        combined = masked({"final_obs": final, "final_info": masked(infos, ended)}, ended)
        return combined if self._info_mode == "at end" else combined | self._infos()

    def _restart(self, arms: IntArray, options: dict[str, Any] | None) -> None:
        randoms = self.np_random
        self.episodes.reset(arms, [randoms[arm] for arm in arms], options)

    def _infos(self) -> Infos:
        """Return the infos of the current states; {} for the mode "none"."""
        if self._info_mode == "none":
            return {}
        episodes, view = self.episodes, self.episodes.view
        infos = batched_info(episodes.info()) if self.num_envs == 1 else episodes.info()
        status, failure = self._status_ok.copy(), self._no_failure.copy()
        for arm, text in episodes.failures.items():
            status[arm], failure[arm] = layout.STATUS[self.batch.status[arm]], text
        infos |= {
            "status": status, "failure": failure, "method": self._method.copy(), "tip": view.tip.copy(),
            "target": view.target.copy(), "goal_angles": view.goal_angles.copy(),
        }  # fmt: skip
        if episodes.effects is not None:
            infos["drawn"] = episodes.effects.drawn
        if estimates := getattr(episodes.base, "estimates", None):
            infos["estimates"] = {name: values.copy() for name, values in estimates.items()}
        return with_masks(flat_info(infos) if self._info_mode == "flat" else infos, self._all_arms.copy())

    @property  # type: ignore[misc]
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]
        """Random generator of each arm; a missing one is made with a random seed."""
        for arm, random in enumerate(self._randoms):
            if random is None:
                self._randoms[arm], self._seeds[arm] = seeding.np_random()
        return tuple(self._randoms)  # type: ignore[arg-type]

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]
        """Seed of the generator of each arm."""
        return tuple(self._seeds) if self.np_random else ()

    def _generators(self, restored: dict[str, Any]) -> list[np.random.Generator | None]:
        return list(restored["_randoms"])

    def _each_seed(self, seed: object) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, int | np.integer):
            first = whole_number("seed", seed, 0, MAX_SEED)
            return [first * self._seed_stride + arm for arm in range(self.num_envs)]
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
    """Compile the kernels of the environments, so that processes started later load them."""
    for env in (gym.make("FlexRRR-v0"), gym.make_vec("FlexRRR-v0", 2, "vector_entry_point")):
        env.reset(seed=0)
        env.step(env.action_space.sample())


def _make_batch(configuration: Configuration, arms: int, threads: int) -> tuple[Batch, Any]:
    """Return the simulated arms of an environment, and the choice of the model, see `resolve_fidelity`."""
    model, method, step, choice = resolve_fidelity(configuration)
    period, rotates = configuration.control_period, configuration.rotates
    return Batch(model, method, step, period, arms=arms, threads=threads, rotates=rotates), choice
