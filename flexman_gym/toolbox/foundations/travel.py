"""Travel of a foundation on a servo, which an agent commands."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from flexman_gym.agent.action_modes import ActionMode
from flexman_gym.agent.controller import Controller
from flexman_gym.common.arrays import Array, BoolArray, IntArray, Vector
from flexman_gym.common.checks import positive, set_fields, vector
from flexman_gym.common.errors import value_error
from flexman_gym.envs.sensors.sensor import Entry
from flexman_gym.envs.view import View
from flexman_gym.simulation.batch import Batch
from flexman_gym.toolbox.foundations.foundation_mode import FoundationMode


@dataclass(frozen=True)
class Travel:
    """Travel of the foundation along an axis, on a stiff servo: a trolley, the portal of a gantry, a carriage.

    An action has one more entry, the commanded velocity as a fraction of `speed`. In a control period T the servo
    accelerates uniformly to this velocity as far as `acceleration` allows: its lag is half a period. Towards a stop the
    velocity v is at most that from which the foundation stops before it, v^2 / (2 a) + v T / 2 for the acceleration a;
    it brakes by itself and reaches the stop at rest.

    Attributes:
        axis: (3,) direction of the travel in the world frame, which is the base frame.
        speed: largest speed, m/s.
        acceleration: largest acceleration, m/s^2.
        travel: distance of the stops from the middle, m.
    """

    kind: ClassVar[str] = "travel"
    axis: Vector = (1.0, 0.0, 0.0)
    speed: float = 1.0
    acceleration: float = 0.5
    travel: float = 5.0

    def __post_init__(self) -> None:
        axis = vector("Travel.axis", self.axis, 3)
        norm = math.hypot(*axis)
        if not norm > 0.0:
            raise value_error("Travel.axis", axis, "a direction other than zero")
        set_fields(self, axis=tuple(each / norm for each in axis))
        for name, unit in (("speed", "m/s"), ("acceleration", "m/s^2"), ("travel", "m")):
            set_fields(self, **{name: positive(f"Travel.{name}", getattr(self, name), unit)})

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the entries of an action."""
        return ("travel",)

    @property
    def rotates(self) -> bool:
        """False: the base keeps its attitude."""
        return False

    @property
    def range(self) -> float:
        """Largest distance of the base from the middle, m."""
        return self.travel

    def make_mode(self, mode: ActionMode, base: Controller | None) -> FoundationMode:
        """Return an action mode with the commands of the foundation."""
        return FoundationMode(mode, base, self.names, self.speed, self.acceleration)

    def make(self, batch: Batch) -> "MovingFoundation":
        """Return the foundations of the arms of a batch."""
        return MovingFoundation(self, len(batch.rows), batch.control_period)


class MovingFoundation:
    """Foundations of b arms that travel along an axis.

    Args:
        travel: the axis and its limits.
        arms: b, number of arms.
        period: control period, s.

    Attributes:
        position: (b, 1) distance from the middle along the axis, m.
        velocity: (b, 1) its rate, m/s.
        goal: (b, 1) goal of the position, m.
        accelerations: (b, 3) acceleration of the base in the present control period, base frame, m/s^2.
    """

    state_fields = ("position", "velocity", "goal", "_targets")
    moves_goals = False  # the goal of the motor angles rests

    def __init__(self, travel: Travel, arms: int, period: float) -> None:
        self.settings, self._period, self._axis = travel, period, np.array(travel.axis)
        self.position, self.velocity, self.goal = np.zeros((arms, 1)), np.zeros((arms, 1)), np.zeros((arms, 1))
        self.accelerations = np.zeros((arms, 3))
        self._targets = np.zeros((arms, 3))  # m; targets in the frame of a base at its goal

    def draw(self, random: np.random.Generator) -> dict[str, Array]:
        """Draw start and goal of the travel, uniformly between the stops."""
        start, goal = random.uniform(-self.settings.travel, self.settings.travel, 2)
        return {"travel_start": np.array([start]), "travel_goal": np.array([goal])}

    def begin(self, arms: IntArray, parameters: Mapping[str, Array]) -> None:
        """Start episodes of the arms (r,), at rest, with parameters (r, 1) as drawn.

        Raises:
            ValueError: for a start or a goal beyond a stop.
        """
        for name in ("travel_start", "travel_goal"):
            if (np.abs(parameters[name]) > self.settings.travel).any():
                allowed = f"a distance within the stops, {self.settings.travel:g} m"
                raise value_error(f"options[{name!r}]", parameters[name].tolist(), allowed)
        self.position[arms], self.goal[arms] = parameters["travel_start"], parameters["travel_goal"]
        self.velocity[arms] = self.accelerations[arms] = 0.0

    def aim(self, view: View, arms: Any) -> None:
        """Store the targets of arms, given for a base at its goal, and set those in the present base frame."""
        self._targets[arms] = view.target[arms]
        view.target[arms] = self._in_base(arms)

    def follow(self, view: View, arms: Any) -> None:
        """Set the targets of arms, and their velocities, in the frame of a base that has moved."""
        target = self._in_base(arms)
        view.target_velocity[arms] = (target - view.target[arms]) / view.control_period
        view.target[arms] = target

    def _in_base(self, arms: Any) -> Array:
        """Return the targets (r, 3) of arms in the frame of the base, m."""
        result: Array = self._targets[arms] + (self.goal[arms] - self.position[arms]) * self._axis
        return result

    def move(self, mode: Any, moving: BoolArray) -> None:
        """Advance the moving arms (b,) by a control period under the commands of a `FoundationMode`."""
        self.advance(mode.commands, moving)

    def advance(self, commands: Array, moving: BoolArray) -> None:
        """Advance the moving arms by a control period, and set `accelerations`.

        Args:
            commands: (b, 1) velocities as fractions of the largest speed.
            moving: (b,) flags of the arms that move.
        """
        travel, period, speed = self.settings, self._period, self.velocity
        change = travel.acceleration * period
        wanted = np.clip(commands, -1.0, 1.0) * travel.speed
        for side in (1.0, -1.0):  # of the stop ahead
            left = travel.travel - side * self.position - 0.5 * period * side * speed
            fastest = np.sqrt(np.maximum(change**2 + 2.0 * travel.acceleration * left, 0.0)) - change
            wanted = side * np.minimum(side * wanted, np.maximum(fastest, 0.0))
        reached = np.clip(wanted, speed - change, speed + change)
        reached[~moving] = speed[~moving] = 0.0
        self.accelerations[:] = (reached - speed) / period * self._axis
        self.position += 0.5 * period * (speed + reached) * moving[:, None]
        self.velocity[:] = reached

    def ends(self, parameters: Mapping[str, Array]) -> Array:
        """Return start and goal of the travel (r, 2), m, from parameters as drawn."""
        return np.hstack([parameters["travel_start"], parameters["travel_goal"]])

    def entries(self) -> list[Entry]:
        """Return the entries of `readings`."""
        travel = self.settings
        return [
            Entry("travel", 1, "m", travel.travel),
            Entry("travel_rate", 1, "m/s", travel.speed),
            Entry("travel_error", 1, "m", 2.0 * travel.travel),
        ]

    @property
    def goals(self) -> Array:
        """Goals of the positions of the bases in the world frame, (b, 3), m."""
        result: Array = self.goal * self._axis
        return result

    @property
    def displacements(self) -> Array:
        """Positions of the bases in the world frame, (b, 3), m."""
        result: Array = self.position * self._axis
        return result

    @property
    def readings(self) -> Array:
        """Position, velocity and error of the position of the foundation, (b, 3), m and m/s."""
        return np.hstack([self.position, self.velocity, self.goal - self.position])
