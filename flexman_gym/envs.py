"""Environments: a simulator, a task and sensors behind Gymnasium's interface."""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from flexman_gym.arm import Arm
from flexman_gym.catalog import paper_rrr
from flexman_gym.checks import one_of, positive, refusal, vector
from flexman_gym.drive import SineTorque
from flexman_gym.fidelity import Choice, assembled_modes, choose_model
from flexman_gym.model import build_model
from flexman_gym.scene import Initial, ModelChoice, Scene
from flexman_gym.sensors import FullState, Limits
from flexman_gym.simulator import Simulator
from flexman_gym.tasks import Slew
from flexman_gym.trajectory import ENERGY_ALARM

Observation = NDArray[np.float32]
FIDELITY = {"elements": 2, "modes": "assembled", "method": "ros2", "step": 0.005}
SLEW = 3.0  # s, of the motion for which fidelity="auto" chooses


class FlexManEnv(gym.Env[Observation, Observation]):
    """A flexible arm slews its tip to a target and settles there: `gym.make("FlexRRR-v0")`.

    Arm
        The paper's three-link arm of 8.5 m, flexible links and joints (K 5000 N m/rad), no gravity, 0.5 % modal damping
        in the links, none in the joints (`arm=catalog.paper_rrr(rotor_inertia=10)` gives the paper's undamped arm). Its
        rotors have 10 kg m^2: with the 1 kg m^2 of the paper's scene no motor controller at 50 Hz can damp it.

    Actions
        Box(-1, 1, (n,)): motor torques as parts of `torque_limit` (400 N m), constant during a control period of 20 ms.
        An action outside the box is refused.

    Observations
        Box (36,) float32; `env.unwrapped.sensors` has the same as `slices`, `units` and `bound`:

        slice                  entries  unit   bound
        motor_angles           0-2      rad    4
        motor_rates            3-5      rad/s  10
        joint_twists           6-8      rad    1         motor angle - joint angle
        joint_twist_rates      9-11     rad/s  10
        link_deflections       12-17    m      length/4  tip of each link along y and z of its beam frame
        link_deflection_rates  18-23    m/s    15
        posture_errors         24-26    rad    8         goal posture - motor angles
        target_error           27-29    m      17        target - tip, base frame
        target_nearness        30-32    1      1         target_error / (0.1 m + its length)
        tip_velocity           33-35    m/s    40        base frame

    Reward
        In [0, 1] a step, less a penalty for a failure: `tasks.Slew` has the terms, `info["reward_terms"]` their values.

    Start and end
        `reset(seed=...)` draws start and target; `reset(options={"start": angles, "posture": angles})` sets them. An
        episode is truncated after 10 s (500 steps). It terminates with the failure penalty when an observed quantity
        leaves its bound or the simulation diverges; `info["failure"]` says which. The observation is then the last one
        within the bounds, so that every observation lies in the space.

    Info
        tip_error (m), tip_vibration (m/s, speed of the tip relative to the rigid arm at the motor angles),
        elastic_energy (J), energy_residual (J, work of the motors - dissipation - change of energy since the reset,
        which the integrator invented or lost), energy_alarm (whether that is more than the part `energy_alarm` of the
        energy turned over since the reset), reward_terms, status (of the simulation), failure ("" or what happened),
        tip and target (m), posture (rad, the goal).

    Fidelity
        By default two elements a link, of whose loaded modes those are kept that carry more than 2 % of the elastic
        energy of a vibration of the arm below half the control frequency (`fidelity.assembled_modes`): 16 for the arm
        above, (0-4, 6), (0-5, 8) and (0, 1, 3), with "ros2" at 5 ms. The first five vibrations then have the full
        model's frequencies within 0.7 %; with the 4 lowest modes of each link the first two are 26 % off, as mode 8 of
        link 2 is missing. ros2 leaves 99.9 % of the amplitude of the first two vibrations (3.4 Hz) after 10 s. Three
        episodes of random torques, changed every half second, end 2.5 s later with a tip that was at most 63, 10 and
        19 mm from that of all coordinates with foreshortening (4 lowest modes: 71, 114, 246 mm, 8 % cheaper). Most of
        the 63 mm is the step: method="extrapolated_euler_5", step=0.02 has 8, 8 and 15 mm for 1.3 times the cost, but
        lets vibrations near 14 Hz of an undamped arm grow.

        fidelity="auto" with a tolerance (m) lets `choose_model` choose modes, method and step for a slew of 3 s with
        sine torques (0.5 Hz, `torque_limit`) from a posture within the task's range; the choice is at
        `env.unwrapped.choice`. The tolerance holds for that motion, more or less for others like it.

    Args:
        arm: None takes the arm above.
        task: None takes `Slew()`.
        limits: None takes `Limits()`.
        torque_limit: N m, of each motor.
        control_period: s.
        fidelity: "default" or "auto"; the latter with a tolerance, and without the next four.
        tolerance: m, largest error of the tip in a slew.
        elements, modes, method, step: see `build_model` and `Simulator`; "assembled" modes are those described above.
        energy_alarm: part of the energy turned over (the largest of kinetic + elastic energy, work and dissipation).
        render_mode: None or "rgb_array".
        render_size: width and height of a frame in pixels.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 50}  # noqa: RUF012

    def __init__(
        self,
        *,
        arm: Arm | None = None,
        task: Slew | None = None,
        limits: Limits | None = None,
        torque_limit: float = 400.0,
        control_period: float = 0.02,
        fidelity: str = "default",
        tolerance: float | None = None,
        elements: int | tuple[int, ...] = 2,
        modes: int | tuple[int | tuple[int, ...], ...] | str | None = "assembled",
        method: str = "ros2",
        step: float = 0.005,
        energy_alarm: float = ENERGY_ALARM,
        render_mode: str | None = None,
        render_size: tuple[int, int] = (480, 360),
    ) -> None:
        if render_mode is not None:
            one_of("render_mode", render_mode, ("rgb_array",))
        if arm is not None and not isinstance(arm, Arm):
            raise refusal("arm", arm, "an Arm")
        if task is not None and not isinstance(task, Slew):
            raise refusal("task", task, "a task, such as Slew()")
        if limits is not None and not isinstance(limits, Limits):
            raise refusal("limits", limits, "Limits")
        self.torque_limit = positive("torque_limit", torque_limit, "N m")
        self.energy_alarm = positive("energy_alarm", energy_alarm)
        self.render_mode = render_mode
        self.task = Slew() if task is None else task
        arm = default_arm() if arm is None else arm
        period = positive("control_period", control_period, "s")
        given = {"elements": elements, "modes": modes, "method": method, "step": step}
        self.choice: Choice | None = None
        if _automatic(fidelity, tolerance, given):
            self.choice = _chosen(arm, self.task, self.torque_limit, period, tolerance)
            model, method, step = self.choice.model, self.choice.method, self.choice.step
        else:
            kept = assembled_modes(arm, elements, 0.5 / period) if isinstance(modes, str) else modes
            model = build_model(arm, elements, kept)
        self.simulator = Simulator(model, method, step, control_period)
        self.sensors = FullState(model, Limits() if limits is None else limits)
        bound = self.sensors.bound.astype(np.float32)
        self.observation_space = spaces.Box(-bound, bound, dtype=np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (model.n_joints,), dtype=np.float32)
        self.metadata = FlexManEnv.metadata | {"render_fps": round(1 / self.simulator.control_period)}
        self._painter: Any = None
        if render_mode is not None:
            from flexman_gym.draw import FramePainter  # which needs the extra [render]

            self._painter = FramePainter(model, render_size)
        self._over = True

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Starts an episode; options may set "start" and "posture", joint angles (n,) in rad."""
        super().reset(seed=seed)
        self._over = True  # until the new episode has begun: a refusal below leaves none
        joints = self.simulator.model.n_joints
        start, posture = self.task.draw(self.np_random, joints)
        drawn = {"start": start, "posture": posture}
        if options is not None and not isinstance(options, dict):
            raise refusal("options", options, "a dict with start or posture")
        for name, value in (options or {}).items():
            one_of("options", name, drawn)
            drawn[name] = np.array(vector(f"options[{name!r}]", value, joints, "rad"))
        self.simulator.reset(drawn["posture"])
        self._posture = self.simulator.state[self.sensors.motor_columns][None].copy()
        self._target = self.simulator.tip[None].copy()
        self.simulator.reset(drawn["start"])
        reading = self._read()
        if failure := self.sensors.broken(reading):
            raise refusal("options", options, f"a start and a posture within the limits ({failure})")
        self._over = False
        self._observation = reading.astype(np.float32)
        return self._observation.copy(), self._outcome(np.zeros((1, joints)), "")[1]

    def step(self, action: NDArray[Any]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Applies motor torques for one control period.

        Raises:
            ValueError: for an action of another shape or outside the action space.
            RuntimeError: before a reset and after the end of an episode.
        """
        if self._over:
            raise RuntimeError("the episode is over: reset the environment first")
        values = np.asarray(action)
        if (
            values.shape != self.action_space.shape
            or values.dtype.kind not in "fiu"
            or not (np.abs(values) <= 1.0).all()
        ):
            raise refusal("action", action, f"{self.simulator.model.n_joints} numbers from -1 to 1")
        values = values.astype(float)
        status = self.simulator.step(self.torque_limit * values)
        reading = self._read()
        failure = self.sensors.broken(reading) if status == "ok" else f"the simulation {status}"
        if not failure:
            self._observation = reading.astype(np.float32)
        reward, info = self._outcome(values[None], failure)
        self._over = bool(failure)
        return self._observation.copy(), reward, self._over, False, info

    def render(self) -> NDArray[np.uint8] | None:
        """A frame (height, width, 3) uint8 of the deformed arm and the target."""
        if self._painter is None:
            gym.logger.warn('render() needs render_mode="rgb_array" in gym.make')
            return None
        return self._painter.paint(self.simulator.state, self._target[0])

    def _read(self) -> NDArray[np.float64]:
        simulator = self.simulator
        return self.sensors.read(simulator.state[None], simulator.outputs[None], self._posture, self._target)[0]

    def _outcome(self, actions: NDArray[np.float64], failure: str) -> tuple[float, dict[str, Any]]:
        """Reward and info of the state that the arm is in, after actions (1, n)."""
        simulator = self.simulator
        error = self._target - simulator.tip
        tip_error = np.sqrt((error * error).sum(axis=1))
        rate = simulator.deflection_rate[None]
        tip_vibration = np.sqrt((rate * rate).sum(axis=1))
        terms = self.task.reward_terms(tip_error, tip_vibration, actions, np.array([failure != ""]))
        reward_terms = {name: float(value[0]) for name, value in terms.items()}
        return sum(reward_terms.values()), {
            "tip_error": float(tip_error[0]),
            "tip_vibration": float(tip_vibration[0]),
            "elastic_energy": simulator.elastic_energy,
            "energy_residual": simulator.energy_residual,
            "energy_alarm": abs(simulator.energy_residual) > self.energy_alarm * simulator.energy_turnover,
            "reward_terms": reward_terms,
            "status": simulator.status,
            "failure": failure,
            "tip": simulator.tip.copy(),
            "target": self._target[0].copy(),
            "posture": self._posture[0].copy(),
        }


def _automatic(fidelity: str, tolerance: float | None, given: dict[str, Any]) -> bool:
    """Whether the fidelity is to be chosen; refuses what contradicts that."""
    if one_of("fidelity", fidelity, ("default", "auto")) == "default":
        if tolerance is not None:
            raise refusal("tolerance", tolerance, 'None without fidelity="auto"')
        if isinstance(given["modes"], str):
            one_of("modes", given["modes"], ("assembled",))
        return False
    for name, value in given.items():
        if value != FIDELITY[name]:
            raise refusal(name, value, 'nothing: fidelity="auto" chooses it')
    positive("tolerance", tolerance, 'm, for fidelity="auto"')
    return True


def _chosen(arm: Arm, task: Slew, torque_limit: float, period: float, tolerance: float | None) -> Choice:
    """Fidelity for a slew of the task: sine torques of the limit from a posture in the middle of its range."""
    n = arm.n_joints
    start = [0.5 * task.start * (-1.0) ** i for i in range(n)]
    steps = max(1, round(SLEW / period))
    scene = Scene(
        arm,
        ModelChoice(flexible_links=True, elements=2),
        SineTorque([torque_limit] * n, [0.5] * n, [0.0] * n),
        Initial(start, [0.0] * n),
        duration=steps * period,
        output_step=period,
    )
    return choose_model(scene, positive("tolerance", tolerance, "m"), longest_step=period)


def default_arm() -> Arm:
    """The arm of FlexRRR-v0."""
    return paper_rrr(rotor_inertia=10.0, modal_damping_ratio=0.005)
