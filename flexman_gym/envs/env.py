"""Environment: a simulator, a task and sensors with the interface of Gymnasium.

The paper is "Dynamic modeling and simulation of spatial manipulator with flexible links and joints".
"""

import math
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec
from numpy.typing import NDArray

from flexman_gym.common.arrays import Vector
from flexman_gym.common.checks import one_of, whole_number
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.config.reset_options import check_parameters
from flexman_gym.envs.episodes import Episodes, validate_actions
from flexman_gym.envs.infos import INFO_MODES, flat_info
from flexman_gym.envs.rendering import RENDER_KEYWORDS, RENDER_MODES, make_renderer
from flexman_gym.envs.stateful import StatefulEnv
from flexman_gym.kernels import layout
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.simulator import Simulator

Observation = NDArray[np.float32]
SINGLE_ARM = np.zeros(1, dtype=np.int64)  # index of the only arm
OWN_KEYWORDS = ("infos", *RENDER_KEYWORDS)
MAX_SEED = 2**128 - 1  # largest seed of a reset


class FlexManEnv(StatefulEnv, gym.Env[Observation, Observation]):
    """Flexible robot arm that moves its tip to a target and stops it there: `gym.make("FlexRRR-v0")`.

    Named environments
        FlexRRR-v0     spatial arm after the paper, 8.5 m, three links, control rate 50 Hz; described below
        FlexPlanar-v0  two strips, 1 m in total, that lift 0.1 kg in a vertical plane under gravity, 100 Hz
        FlexOne-v0     textbook case: one strip of 0.8 m on one flexible joint, in a horizontal plane, 50 Hz
        FlexQuanser-v0 laboratory arm: two steel strips in a horizontal plane with its motors and sensors, 100 Hz
        FlexRotary-v0  laboratory arm: a strip on a motor driven by its voltage, 500 Hz
        FlexCrane-v0   loader crane with two flexible booms and a load on a rope, 100 Hz; hook joints without motors
        FlexTwoMass-v0 benchmark of Wie and Bernstein: two masses and a spring, mass 2 is measured, 50 Hz
        FlexGantry-v0  load on a rope below the flexible bridge of a gantry, whose travel is the action, 50 Hz
        FlexDeck-v0    arm with two flexible links on the deck of a ship, holds its load still in the world, 100 Hz
        `envs.NAMED_ENVIRONMENTS` has the settings of each. The last seven have the reward "distance" (see `Slew`).

    Arm
        Three-link arm after Table 1 of the paper, 8.5 m, with flexible links and joints (stiffness 5000 N m/rad),
        without gravity. The modal damping ratios of the links are 0.005 (the paper neglects damping), and the joints
        have no damping; `arm=catalog.paper_rrr(rotor_inertia=10, torque_limit=400)` is undamped. The paper prints no
        rotor inertia. It is 10 kg m^2 here, because a motor controller at 50 Hz cannot damp an arm with the 1 kg m^2 of
        the catalogue. Link 1 has the printed area, which is ten times too large, see `catalog.paper_rrr`.

    Actions
        Box(-1, 1, (n,)): torques of the n motors as fractions of their limits (400 N m each), constant during a control
        period of 20 ms. An action outside the box raises ValueError, or is clipped with clip_actions=True; values
        beyond its bounds by less than 1e-6, the rounding of float32, are always clipped.

    Observations
        Box (36,) float32; `slices`, `units` and `bound` of `env.unwrapped.sensors` hold the columns of this table:

        slice                  entries  unit   bound
        motor_angles           0-2      rad    4
        motor_rates            3-5      rad/s  10
        joint_twists           6-8      rad    1         motor angle - joint angle
        joint_twist_rates      9-11     rad/s  10
        link_deflections       12-17    m      length/4  tip of each link along y and z of its beam frame
        link_deflection_rates  18-23    m/s    15
        angle_errors           24-26    rad    8         goal angles - motor angles
        target_error           27-29    m      17        target - tip, base frame
        target_nearness        30-32    1      1         target_error / (0.1 m + its length), 0.1 m for 8.5 m of reach
        tip_velocity           33-35    m/s    40        base frame

    Reward
        From 0 to 1 per step, minus a penalty after a failure. `Slew` defines the terms of this sum, and
        `info["reward_terms"]` holds their values.

    Start and end
        `reset(seed=...)` draws a start posture and a target. The options of `reset` replace them: "start" and
        "goal_angles", motor angles (n,) in rad, or "start_tip" and "goal_tip", tip positions (3,) in the base frame, m.
        If several postures reach a tip position, the one with the smallest joint motion is chosen: for a goal relative
        to the start, for a start relative to zero angles. The option "parameters", a dict, sets physical parameters of
        the arm from this episode on (see `Batch.vary`). The arm starts at rest, under gravity deformed by its weight.
        The target is the tip position of the arm at rest at the goal posture.

        An episode is truncated after its `horizon`, 10 s. It terminates with the failure penalty if the arm exceeds its
        limits, an observed value exceeds its bound, or the simulation diverges; `info["failure"]` names the cause. The
        final observation is then the last one within the bounds, so that every observation lies in the space.

    Info
        tip_error (m, distance of tip and target), tip_vibration (m/s, speed of the tip relative to the tip of a rigid
        arm with the same motor angles and rates), elastic_energy (J), energy_residual (J, work - dissipation - change
        of energy since the reset, an error of the integration), energy_alarm (True if the residual exceeds a fraction,
        the setting `energy_alarm`, of the energy turnover, the largest of kinetic + elastic energy, |work| and
        |dissipation| since the reset), reward_terms, status (of the simulation: "ok" or the reason of its end), failure
        ("" or its cause), method (name of the integration method), tip and target (m), goal_angles (rad, of the
        motors); with a randomisation also drawn, a dict of the values drawn for the episode (see `ActiveEffects`); with
        limits of strain, spring torque or workspace or with margins also limits and cost (see `Limits`); with
        safety=True (extra `mpc`) also safety_status and safety_change (see `SafetyFilter`).

    Fidelity
        By default the model has two elements per link and the component modes below half the control rate, 16 of 36
        coordinates for FlexRRR-v0. The integration method is "midpoint_corrected_3", which has no numerical damping,
        with steps of 20/3 ms; the smaller arms have shorter steps. `docs/evidence/accuracy.md` compares the energy and
        the tip motion of this model with the model with all coordinates.

        fidelity="auto" with a tolerance (m) calls `choose_model`, which chooses modes, method and step for a slew of
        3 s with sine torques (0.5 Hz, amplitude `torque_limit`); `env.unwrapped.choice` is the result. The tolerance
        is a bound of the tip error in that slew, and approximately in similar motions.

    Version history
        v0: first version.

    Args:
        infos: "always"; "flat" for an info of numbers and arrays only (see `flat_info`); "at end" for one only at the
            end of an episode; or "none". The info is {} otherwise.
        render_mode: None, "rgb_array", or "human", which shows every step in real time on a local web page whose
            address is printed on stderr.
        render_size: width and height of a frame, pixels.
        render_camera: azimuth and elevation in degrees, and an optional zoom; None chooses them from the joint axes. A
            frame always contains the arm at start and goal, and the target.
        render_gain: magnification of the deflection of the links in frames, or a pair: of the deflection of the links
            and of the twist of the joints, which by default has its true scale. It is printed in the frame.
        render_overlays: True to print time, tip error, reward, torques and scales in each frame.
        **settings: the attributes of `Configuration` (arm, task, limits, fidelity and so on), and "condition", one of
            `envs.config.named_environments.CONDITIONS`, which changes the defaults of some settings.

    Examples:
        >>> import gymnasium as gym
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
        infos: str = "always",
        render_mode: str | None = None,
        render_size: tuple[int, int] = (480, 360),
        render_camera: Vector | None = None,
        render_gain: float | Vector = 1.0,
        render_overlays: bool = True,
        **settings: Any,
    ) -> None:
        self.render_mode, look = render_mode, (render_size, render_camera, render_gain, render_overlays)
        self._info_mode = one_of("infos", infos, INFO_MODES)
        self._arguments = dict(zip(OWN_KEYWORDS, (infos, render_mode, *look), strict=True)) | settings
        configuration = Configuration.from_keywords(settings, OWN_KEYWORDS)
        model, method, step, self.choice = resolve_fidelity(configuration)
        batch = Batch(model, method, step, configuration.control_period, rotates=configuration.rotates)
        self.simulator = Simulator.of_batch(batch)
        self.configuration, self.task = configuration, configuration.task
        self.torque_limit = np.array(configuration.torque_limit)
        self.episodes = Episodes(configuration, self.simulator.batch)
        self.sensors = self.episodes.sensors
        self.observation_space, self.action_space = self.episodes.make_spaces()
        size = len(self.episodes.agent.mode.names)
        self.metadata = FlexManEnv.metadata | {"render_fps": round(1 / self.simulator.control_period)}
        self._action_shape = (size,)
        self._allowed_actions = f"{size} numbers from -1 to 1"
        self._rendering = make_renderer(render_mode, self.episodes, configuration.id, look)

    @property
    def spec(self) -> EnvSpec | None:
        """EnvSpec of Gymnasium, whose `max_episode_steps` follows from the horizon."""
        return self._spec

    @spec.setter
    def spec(self, given: EnvSpec | None) -> None:
        steps = math.ceil(self.configuration.max_periods / self.configuration.action_repeat)
        self._spec = None if given is None else replace(given, max_episode_steps=steps)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode.

        Args:
            seed: seed of the random generator; None continues with the current generator.
            options: "start" and "goal_angles", motor angles (n,) in rad, or "start_tip" and "goal_tip", tip positions
                (3,) in m, and "parameters", physical parameters by name; see the class.

        Returns:
            Observation and info.

        Raises:
            ValueError: for a seed or options that are not allowed. The running episode may then be over; the result of
                the next reset is not affected.
        """
        checked = None if seed is None else whole_number("seed", seed, 0, MAX_SEED)
        check_parameters(options, self.simulator.batch)
        with self._restored_on_error(options):
            super().reset(seed=checked)
            self.episodes.reset(SINGLE_ARM, [self.np_random], options)
        self._show()
        return self.episodes.agent.observations[0].copy(), self._info()

    def step(self, action: NDArray[Any]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Apply an action for `action_repeat` control periods.

        Args:
            action: (k,) values from -1 to 1; by default one for each motor.

        Returns:
            Observation, reward, terminated, truncated and info.

        Raises:
            ValueError: for an action of the wrong shape, with NaN or infinite values, or, without clip_actions,
                outside the action space.
            RuntimeError: before the first reset, and after the end of an episode.
        """
        episodes = self.episodes
        if episodes.over[0]:
            raise RuntimeError("the episode is over: reset the environment first")
        reward = episodes.step_single(action)
        if reward is None:
            clip = self.configuration.clip_actions
            values = validate_actions("action", action, self._action_shape, self._allowed_actions, clip)
            reward = episodes.step(values[None]).item()
        info = self._info()
        self._show()
        observation = episodes.agent.observations[0].copy()
        return observation, reward, bool(episodes.failures), bool(episodes.truncated[0]), info

    def _generators(self, restored: dict[str, Any]) -> list[np.random.Generator | None]:
        return [restored["_np_random"]]

    def render(self) -> NDArray[np.uint8] | None:
        """Return a frame (height, width, 3) uint8 of the deformed arm and the target.

        Raises:
            RuntimeError: before the first reset.
        """
        if self.render_mode == "human":
            return None  # every step is shown
        if self._rendering is None:
            gym.logger.warn('render() needs render_mode="rgb_array" in gym.make')
            return None
        return self._rendering.frame(0)

    def _show(self) -> None:
        if self.render_mode == "human" and self._rendering is not None:
            self._rendering.show()

    def close(self) -> None:
        """Close the web page of render_mode="human"."""
        if self._rendering is not None:
            self._rendering.close()

    def _info(self) -> dict[str, Any]:
        """Return the info of the current state in the form of `infos`."""
        episodes, mode = self.episodes, self._info_mode
        if mode == "none" or (mode == "at end" and not episodes.over[0]):
            return {}
        view, info = episodes.current_view, episodes.info()
        info["status"] = layout.STATUS[episodes.batch.status[0]]
        info["failure"], info["method"] = episodes.failures.get(0, ""), episodes.batch.method.name
        info["tip"], info["target"], info["goal_angles"] = view.tip.copy(), view.target.copy(), view.goal_angles.copy()
        if episodes.effects is not None:
            info["drawn"] = episodes.effects.drawn_for(0)
        if estimates := getattr(episodes.base, "estimates", None):
            info["estimates"] = {name: values[0].copy() for name, values in estimates.items()}
        return flat_info(info) if mode == "flat" else info
