"""PD controller of the motors."""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from flexman_gym.agent.base_controllers import ControllerEntry
from flexman_gym.agent.controller import EpisodeInfo, Plant, Readings, saturated
from flexman_gym.common.arrays import Array, BoolArray, IntArray, Vector, pad_rows
from flexman_gym.common.checks import non_negative, physical, vector
from flexman_gym.model.dynamics import mass_matrix
from flexman_gym.model.model import Model, check_model
from flexman_gym.model.statics import holding_torques


class PD:
    """Proportional-derivative controller of the motors: torque = stiffness (goal - angle) - damping rate, saturated.

    With a moving goal, the rate is relative to the rate of the goal. The controller reads motor encoders only, as in
    industrial robots. Sensors and actuators are collocated, so that the continuous-time loop is stable for any positive
    gains.

    Args:
        stiffness: (n,) proportional gains, N m/rad.
        damping: (n,) derivative gains, N m s/rad; with a control period T they must stay below about 2 rotor_inertia /
            T.
        torque_limit: torque limit of all joints, or of each joint (n,), N m.
        gravity_model: model whose holding torques at the goal are added as feed-forward; None for no feed-forward.

    Examples:
        >>> import numpy as np
        >>> from flexman_gym.control import PD
        >>> pd = PD(stiffness=[40.0, 6.0], damping=[9.0, 1.3], torque_limit=[10.0, 4.0])
        >>> pd.act({"angle_errors": np.array([0.1, -0.1]), "motor_rates": np.zeros(2)}).astype(float).round(2).tolist()
        [0.4, -0.15]
    """

    sensors: tuple[str, ...] = ("servo",)
    c_program: ClassVar[str] = "flexman_gym.toolbox.deployment.c_programs:pd_program"
    gain_units: ClassVar[Mapping[str, str]] = {"stiffness": "N m/rad", "damping": "N m s/rad"}

    def __init__(
        self,
        stiffness: Vector,
        damping: Vector,
        torque_limit: float | Vector,
        gravity_model: Model | None = None,
    ) -> None:
        checked = vector("PD.stiffness", stiffness, unit="N m/rad")
        n = len(checked)
        self.stiffness, self.damping = np.array(checked), np.array(vector("PD.damping", damping, n, "N m s/rad"))
        for name in ("stiffness", "damping"):
            for i, gain in enumerate(getattr(self, name).tolist()):
                non_negative(f"PD.{name}[{i}]", gain)
        self.torque_limit = np.array(torque_limits("PD.torque_limit", torque_limit, n))
        self.gravity_model = None if gravity_model is None else check_model(gravity_model)
        self._holding = np.zeros((1, n))  # N m; holding torques of each arm

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Compute the holding torques of new episodes at their goals; arguments as in `Controller.reset`."""
        if self.gravity_model is None:
            return
        self._holding = pad_rows(self._holding, count)
        for arm, angles in zip(arms, episode.goal, strict=True):
            self._holding[arm] = holding_torques(self.gravity_model, angles)

    def move_tables(self) -> dict[str, Array]:
        """Return the holding torques (1, n) of the present goal of a single arm, N m; {} without a gravity model."""
        return {} if self.gravity_model is None else {"holding": self._holding[:1]}

    def unstable(self, model: Model, period: float, delay: int = 0) -> str:
        """Return a message if the damping makes the sampled loop unstable, else "".

        Within a control period a motor with inertia J turns independently of the link behind its spring. With a period
        T and a delay of k periods, its rate then follows r' = r - (damping T / J) r_k, with r_k the rate k periods
        earlier, and grows for damping T / J >= 2 sin(pi / (4 k + 2)): 2 without delay, 1 with one period, 0.62 with
        two (Levin and May, Theoretical Population Biology 9, 1976, 178). Below this bound, stiffness and flexible
        links may still cause instability.

        Args:
            model: model of the arm.
            period: control period, s.
            delay: delay of the torques, whole control periods.

        Returns:
            Message with the gain, the bound and the largest stable gain.
        """
        limit = stability_limit(delay)
        inertia = 1.0 / np.diag(np.linalg.inv(mass_matrix(model, np.zeros(2 * model.n_dof))))[model.motor_columns]
        ratios = self.damping * period / inertia
        late = f" and a delay of {delay} periods" if delay else ""
        for i in np.flatnonzero(ratios >= limit):
            return (
                f"PD.damping[{i}]: {self.damping[i]:.4g} N m s/rad is not stable with a period of {period:g} s{late}: "
                f"damping x period / inertia of the motor is {ratios[i]:.3g}; give less than {limit:.3g}, "
                f"which is {limit * inertia[i] / period:.4g} N m s/rad"
            )
        return ""

    def act(
        self, readings: Readings, applied: Array | None = None, active: BoolArray | None = None
    ) -> NDArray[np.float32]:
        """Return the action (n,) or (b, n) from angle_errors, motor_rates and, for a moving goal, goal_rates."""
        return np.clip(self._torques(readings)[0] / self.torque_limit, -1.0, 1.0).astype(np.float32)

    def _torques(self, readings: Readings) -> tuple[Array, Array, Array]:
        """Return the torques, and the errors of angles and rates, (n,) or (b, n) each."""
        error, rate = readings["angle_errors"], readings["motor_rates"]
        if "goal_rates" in readings:
            rate = rate - readings["goal_rates"]
        torque = self.stiffness * error - self.damping * rate
        if self.gravity_model is not None:
            torque = torque + (self._holding if error.ndim > 1 else self._holding[0])
        return torque, error, rate

    def derivatives(self, readings: Readings, changes: Readings) -> tuple[Array, Array]:
        """Return the actions (1, n) of an arm and their derivatives (p, n), see `Controller`."""
        torque, error, rate = self._torques(readings)
        change = self.stiffness * changes["angle_errors"] - self.damping * changes["motor_rates"]
        change += changes["stiffness"] * error - changes["damping"] * rate
        return saturated(torque / self.torque_limit, change / self.torque_limit)


def stability_limit(delay: int) -> float:
    """Return the bound of damping x period / inertia above which a sampled motor loop is unstable, see `PD.unstable`.

    Args:
        delay: delay of the torques, whole control periods.

    Returns:
        Bound, 2 without delay.
    """
    return float(2.0 * np.sin(np.pi / (4 * delay + 2)))


def torque_limits(name: str, value: object, joints: int) -> tuple[float, ...]:
    """Return the torque limits (n,) of the joints, N m.

    Args:
        name: name of the field, for error messages.
        value: torque limit of all joints, or of each joint (n,), N m.
        joints: n, number of joints.

    Raises:
        ValueError: for a number of limits other than n, and for a limit outside 1e-30 to 1e30.
    """
    if not isinstance(value, list | tuple | np.ndarray):
        return (physical(name, value, "N m"),) * joints
    limits = vector(name, value, joints, "N m")
    return tuple(physical(f"{name}[{i}]", limit, "N m") for i, limit in enumerate(limits))


def make_pd(plant: Plant, **gains: Any) -> PD:
    """Return the PD of a plant with tuned gains, of which "stiffness" and "damping" can be replaced.

    The holding torques at the goal are added for an arm under gravity.
    """
    weight = plant.model if plant.model.constants.gravity.any() else None
    tuned = gains if len(gains) == 2 else {**plant.gains(), **gains}
    return PD(**tuned, torque_limit=plant.torque_scales, gravity_model=weight)


ENTRY = ControllerEntry(
    make_pd,
    (),
    ("stiffness", "damping"),
    "a PD of the motors, with gains for each arm, task and delay",
    "by `flexman optimise gains`, about half a minute of computing time per environment, on the seeds 0 to 7; "
    "designed from a model for an own arm",
    passive="all",
)
