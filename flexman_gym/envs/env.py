"""Environment: a simulator, a task and sensors behind Gymnasium's interface."""

import math
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from numpy.typing import NDArray

from flexman_gym.common.arrays import Vector
from flexman_gym.common.checks import whole_number
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.config.reset_options import check_parameters
from flexman_gym.envs.episodes import Episodes, action_space, validate_actions
from flexman_gym.envs.rendering import RENDER_KEYWORDS, RENDER_MODES, make_renderer
from flexman_gym.envs.stateful import StatefulEnv
from flexman_gym.kernels import layout
from flexman_gym.simulation.simulator import Simulator

Observation = NDArray[np.float32]
SINGLE_ARM = np.zeros(1, dtype=np.int64)  # the index of the arm
MAX_SEED = 2**128 - 1


class FlexManEnv(StatefulEnv, gym.Env[Observation, Observation]):
    """A flexible arm slews its tip to a target and settles there: `gym.make("FlexRRR-v0")`.

    Named environments
        FlexRRR-v0     the paper's spatial arm of 8.5 m, three links, 50 Hz; described below
        FlexPlanar-v0  two strips, 1 m together, that lift 0.1 kg in a vertical plane under gravity, 100 Hz
        FlexOne-v0     the textbook case: one strip of 0.8 m on one elastic joint, in a horizontal plane, 50 Hz
        FlexQuanser-v0 a real machine: two steel strips in a horizontal plane with its motors and sensors, 100 Hz
        `envs.config.named_environments.NAMED_ENVIRONMENTS` has what each is made of. The latter three are rewarded by distance (see
        `Slew`).

    Arm
        The paper's three-link arm of 8.5 m, flexible links and joints (K 5000 N m/rad), no gravity, 0.5 % modal damping
        in the links, none in the joints (`arm=catalog.paper_rrr(rotor_inertia=10, torque_limit=400)` gives the paper's
        undamped arm). Its rotors have 10 kg m^2: with the 1 kg m^2 of the paper's scene no motor controller at 50 Hz
        can damp it.

    Actions
        Box(-1, 1, (n,)): motor torques as parts of the torque limits (400 N m each), constant during a control period
        of 20 ms. An action outside the box is refused; one that is beyond it by less than 1e-6, as float32 rounds,
        counts as its edge.

    Observations
        Box (36,) float32; `env.unwrapped.sensors` has the same as `slices`, `units` and `bound`:

        slice                  entries  unit   bound
        motor_angles           0-2      rad    4
        motor_rates            3-5      rad/s  10
        joint_twists           6-8      rad    1         motor angle - joint angle
        joint_twist_rates      9-11     rad/s  10
        link_deflections       12-17    m      length/4  tip of each link along y and z of its beam frame
        link_deflection_rates  18-23    m/s    15
        angle_errors         24-26    rad    8         goal angles - motor angles
        target_error           27-29    m      17        target - tip, base frame
        target_nearness        30-32    1      1         target_error / (0.1 m + its length), 0.1 m for 8.5 m of reach
        tip_velocity           33-35    m/s    40        base frame

    Reward
        In [0, 1] a step, less a penalty for a failure: `Slew` has the terms, `info["reward_terms"]` their values.

    Start and end
        `reset(seed=...)` draws start and target; `reset(options={"start": angles, "goal_angles": angles})` sets them,
        or the places of the tip where they are, "start_tip" and "goal_tip", (3,) m in the base frame. Of the postures
        that lead there it takes the one whose joints turn least, a goal from the start and a start from zero angles.
        "parameters", a dict, sets physical parameters of the arm from this episode on (see `Batch.vary`). An arm starts
        at rest. Under gravity its weight bends it, and the target is where it rests at the goal posture.

        An episode is truncated after its `horizon`, 10 s. It terminates with the failure penalty when the arm leaves
        its limits, a number that is observed its bound, or the simulation diverges; `info["failure"]` says which. The
        observation is then the last one within the bounds, so that every observation lies in the space.

    Info
        tip_error (m), tip_vibration (m/s, speed of the tip relative to the rigid arm at the motor angles),
        elastic_energy (J), energy_residual (J, work of the motors - dissipation - change of energy since the reset,
        which the integrator invented or lost), energy_alarm (whether that is more than the part `energy_alarm` of the
        energy turned over since the reset), reward_terms, status (of the simulation), failure ("" or what happened),
        tip and target (m), goal_angles (rad, of the motors); with a randomisation also drawn, a dict of what the
        episode drew (see `Effects`).

    Fidelity
        By default two elements a link with the loaded modes that matter below half the control frequency, 16 of 36 for
        FlexRRR-v0, and "midpoint_3_sweeps" at 20/3 ms, which takes no energy from vibrations of its own. The smaller
        arms have shorter steps. `docs/accuracy.md` says how far energy and tip are from those of all coordinates.

        fidelity="auto" with a tolerance (m) lets `choose_model` choose modes, method and step for a slew of 3 s with
        sine torques (0.5 Hz, `torque_limit`) from a bent posture; the choice is at
        `env.unwrapped.choice`. The tolerance holds for that motion, more or less for others like it.

    Version history
        v0: first version. Until 0.1.0 the method was "ros2" at 5 ms, which gave released vibrations energy and took
        it from others; rewards and observations differ from then on (`method="ros2", step=0.005` has the old ones).

    Args:
        render_mode: None, "rgb_array", or "human". The latter shows every step at its pace: in a window of pygame where
            there is a display, else on a page of this machine whose address a line on stderr says.
        render_size: width and height of a frame in pixels.
        render_camera: azimuth and elevation in degrees, and a zoom if wanted; None chooses them by the joints. The
            picture always holds the arm at start and goal, and the target.
        render_gain: by which the deflection is multiplied in a frame, which says so.
        render_overlays: whether time, tip error, reward, torques and scales are written over a frame.
        settings: the attributes of `Configuration`: arm, task, limits, fidelity and so on; and "condition", one of
            `envs.config.named_environments.CONDITIONS`, which changes some of those that are not given.

    Raises:
        ValueError: one line with field, value and what is allowed.

    Examples:
        >>> env = gym.make("FlexOne-v0", base="pd", action_repeat=5)
        >>> observation, info = env.reset(seed=0)
        >>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        >>> sorted(info["reward_terms"])
        ['distance', 'failure']
    """

    _spec: EnvSpec | None = None
    state_fields, spaces = ("_np_random", "_np_random_seed"), ("action_space",)
    metadata = {"render_modes": list(RENDER_MODES), "render_fps": 50}  # noqa: RUF012

    def __init__(
        self,
        *,
        render_mode: str | None = None,
        render_size: tuple[int, int] = (480, 360),
        render_camera: Vector | None = None,
        render_gain: float = 1.0,
        render_overlays: bool = True,
        **settings: Any,
    ) -> None:
        self.render_mode, given = render_mode, (render_size, render_camera, render_gain, render_overlays)
        self._made = dict(zip(RENDER_KEYWORDS, (render_mode, *given), strict=True)) | settings
        setup = Configuration.from_keywords(settings, RENDER_KEYWORDS)
        model, method, step, self.choice = resolve_fidelity(setup)
        self.simulator = Simulator(model, method, step, setup.control_period)
        self.setup, self.task, self.torque_limit = setup, setup.task, np.array(setup.torque_limit)
        self.episodes = Episodes(setup, self.simulator.batch)
        self.sensors = self.episodes.sensors
        self.observation_space = observation_space(self.episodes)
        size = len(self.episodes.agent.mode.names)
        self.action_space = action_space(size)
        self.metadata = FlexManEnv.metadata | {"render_fps": round(1 / self.simulator.control_period)}
        self._shape = (size,)
        self._allowed = f"{size} numbers from -1 to 1"
        self._rendering = make_renderer(render_mode, self.episodes, setup.id, given)

    @property
    def spec(self) -> EnvSpec | None:
        """What Gymnasium knows of the environment, with the steps after which an episode is truncated."""
        return self._spec

    @spec.setter
    def spec(self, given: EnvSpec | None) -> None:
        steps = math.ceil(self.setup.longest / self.setup.action_repeat)
        self._spec = None if given is None else replace(given, max_episode_steps=steps)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Starts an episode; options may set "start" and "goal_angles", joint angles (n,) in rad, and "parameters".

        Raises:
            ValueError: one line, for a seed or options that are not allowed. The next reset gives what it would have
                given, but the episode may be over.
        """
        whole = None if seed is None else whole_number("seed", seed, 0, MAX_SEED)
        check_parameters(options, self.simulator.batch)
        with self._undoing(options):
            super().reset(seed=whole)
            self.episodes.reset(SINGLE_ARM, [self.np_random], options)
        self._show()
        return self.episodes.agent.observations[0].copy(), self._info()

    def step(self, action: NDArray[Any]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Applies motor torques for one control period, or for as many as `action_repeat` says.

        Raises:
            ValueError: for an action of another shape or outside the action space.
            RuntimeError: before a reset and after the end of an episode.
        """
        episodes = self.episodes
        if episodes.over[0]:
            raise RuntimeError("the episode is over: reset the environment first")
        values = validate_actions("action", action, self._shape, self._allowed)
        reward, info = episodes.step(values[None]).item(), self._info()
        self._show()
        seen = episodes.agent.observations[0].copy()
        return seen, reward, bool(episodes.failures), bool(episodes.truncated[0]), info

    def _generators(self, own: dict[str, Any]) -> list[np.random.Generator | None]:
        return [own["_np_random"]]

    def render(self) -> NDArray[np.uint8] | None:
        """A frame (height, width, 3) uint8 of the deformed arm and the target."""
        if self.render_mode == "human":
            return None  # every step has been shown
        if self._rendering is None:
            gym.logger.warn('render() needs render_mode="rgb_array" in gym.make')
            return None
        return self._rendering.frame(0)

    def _show(self) -> None:
        if self.render_mode == "human" and self._rendering is not None:
            self._rendering.show()

    def close(self) -> None:
        """Closes what a person looked at."""
        if self._rendering is not None:
            self._rendering.close()

    def _info(self) -> dict[str, Any]:
        """Return the info of the present state."""
        episodes = self.episodes
        view, info = episodes.present, episodes.info()
        info["status"] = layout.STATUS[episodes.batch.status[0]]
        info["failure"] = episodes.failures.get(0, "")
        info["tip"], info["target"], info["goal_angles"] = view.tip.copy(), view.target.copy(), view.goal_angles.copy()
        if episodes.effects is not None:
            info["drawn"] = episodes.effects.of(0)
        if estimates := getattr(episodes.base, "estimates", None):
            info["estimates"] = {name: values[0].copy() for name, values in estimates.items()}
        return info


def observation_space(episodes: Episodes) -> spaces.Space[Any]:
    """The space of observations of one arm."""
    bound = episodes.agent.bound(episodes.sensors.bound)
    return spaces.Box(-bound, bound, dtype=np.float32)
