"""Track: the task to lead the tip along a path in space."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from flexman_gym.arrays import Array, Vector
from flexman_gym.checks import non_negative, one_of, positive, refusal, sequence, store, vector
from flexman_gym.envs.limits import Limits
from flexman_gym.envs.sensors.sensor import Entry, Sensor
from flexman_gym.envs.tasks.paths import SHAPES, on_series, phase, place_path
from flexman_gym.envs.tasks.rewards import distance_reward
from flexman_gym.envs.tasks.task import MOVING, Goal
from flexman_gym.simulation.view import Number, View

ANY = "any"


@dataclass(frozen=True)
class Track:
    """Track: lead the tip along a path in space.

    Description
        A target runs round a closed path, a circle, a lemniscate (a figure of eight) or a random smooth curve, so fast
        that the first mode of the arm matters. The tip is to stay on it. The target starts from rest and has its full
        speed after about half a period.

    Actions
        As of every environment: motor torques as parts of the torque limits.

    Observations
        As the sensors say. With a preview the task adds an entry:

        slice    entries     unit  bound
        preview  3 per time  m     (1 + deflection limit) of the reach   where the target will be, base frame

    Reward
        At most 1 a control period, the sum of these terms:
            distance       1 - ln(1 + (e^2 + (0.1 s v)^2) / n^2) / ln(1 + (f / n)^2); e is the tip error, v the speed of
                           the tip relative to the target, n = R / 425 (20 mm) and f = R / 1.7 (5 m) for a reach R, in
                           brackets for 8.5 m
            failure        -failure_penalty when the step ended the episode by a limit or a divergence

    Start
        At rest where the path begins. The middle of the path is where the tip is at motor angles drawn uniformly from
        +-middle; the path lies in a random plane, or in space, of the directions into which the tip can move there.

    End
        Truncated after the horizon of the environment; terminated by a failure.

    Arguments
        Those below.

    Version history
        v0: first version.

    Attributes:
        path: "circle", "lemniscate", "smooth", or "any" of them, drawn for each episode.
        size: how far the path goes from its middle, a part of the reach.
        period: range (low, high) from which the time for one round is drawn uniformly, in periods of the first mode of
            the arm with its motors held; in seconds for an arm that does not bend.
        preview: times (s) ahead at which the target is seen; () for none.
        middle: rad.
        failure_penalty: reward lost by a failure, >= 0.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """

    path: str = ANY
    size: float = 0.06
    period: Vector = (2.5, 5.0)
    preview: Vector = ()
    middle: float = 0.8
    failure_penalty: float = 10.0
    moves: ClassVar[bool] = True
    figures: ClassVar[tuple[str, ...]] = MOVING

    def __post_init__(self) -> None:
        times = sequence("Track.preview", self.preview, "times (s)")
        store(
            self,
            path=one_of("Track.path", self.path, (*SHAPES, ANY)),
            size=positive("Track.size", self.size, "of the reach"),
            period=tuple(vector("Track.period", self.period, 2)),
            preview=tuple(positive(f"Track.preview[{i}]", time, "s") for i, time in enumerate(times)),
            middle=positive("Track.middle", self.middle, "rad"),
            failure_penalty=non_negative("Track.failure_penalty", self.failure_penalty),
        )
        if not 0.0 < self.period[0] <= self.period[1]:
            raise refusal("Track.period", self.period, "a range (low, high) with 0 < low <= high")

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        """What of the path is seen beside the sensors of the environment."""
        return (Preview(self.preview),) if self.preview else ()

    def draw(self, random: np.random.Generator, view: View) -> dict[str, Array]:
        """The path of one episode: series of the tip (m) and of the motors (rad), the time for a round, the start."""
        shape = list(SHAPES)[random.integers(len(SHAPES))] if self.path == ANY else self.path
        mode = 1.0 / view.first_frequency if np.isfinite(view.first_frequency) else 1.0
        period = random.uniform(self.period[0], self.period[1]) * mode
        path, postures = place_path(shape, self.size * view.reach, self.middle, random, view)
        start = on_series(postures[None], np.zeros((1, 1)))[0, 0]
        return {"start": start, "path": path, "postures": postures, "period": np.array(period)}

    def goal(self, plan: Mapping[str, Array], time: Array, view: View) -> Goal:
        """Where the target is on its path, and the posture that belongs to it."""
        phases = phase(time, plan["period"])[:, None]
        return Goal(on_series(plan["path"], phases)[:, 0], on_series(plan["postures"], phases)[:, 0])

    def reward_terms(self, view: View) -> dict[str, Number]:
        """Terms of the reward, see the class."""
        return {
            "distance": distance_reward(view, view.tip_velocity - view.target_velocity),
            "failure": 0.0 - self.failure_penalty * view.failed,
        }

    def info(self, view: View) -> dict[str, Number]:
        """Velocity of the target (3,) m/s, over the last control period."""
        return {"target_velocity": view.target_velocity}


class Preview:
    """Where the target of `Track` will be at some times (s) ahead."""

    measures: ClassVar[tuple[str, ...]] = ()

    def __init__(self, times: Vector) -> None:
        self._ahead = np.array(times)

    def entries(self, view: View, limits: Limits) -> Sequence[Entry]:
        """Says what it reads: three numbers for each time."""
        return [Entry("preview", 3 * len(self._ahead), "m", (1.0 + limits.deflection) * view.reach)]

    def read(self, view: View, out: Array) -> None:
        """Writes into out (b, 3 times)."""
        phases = phase(view.time[:, None] + self._ahead, view.plan["period"][:, None])
        out[:] = on_series(view.plan["path"], phases).reshape(len(out), -1)
