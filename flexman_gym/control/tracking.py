"""Tracking: the law that drives arms along references, by feed-forward and scheduled LQR gains on what is estimated."""

import numpy as np

from flexman_gym.arrays import Array, Flags, IntArray, grown, row_dots
from flexman_gym.control.controller import Episode
from flexman_gym.control.discrete import Weights
from flexman_gym.control.following import Following
from flexman_gym.control.gains import GainTable
from flexman_gym.control.lqr import HOLDING, SHARE, usual_weights
from flexman_gym.control.observer import Estimate
from flexman_gym.control.plant import Plant
from flexman_gym.control.shape import Shape
from flexman_gym.control.slews import Slews, payloads_of

RETIMED = (6, 12, 20, 30, 45)  # control periods after which a slew is timed anew with the parameters as estimated
ARRIVING = 0.75  # of a path, from which on it is not timed anew
ADAPTED = 5  # control periods between two looks at the parameters


class Tracking:
    """Tracking law of b arms: torque of the reference - K (state - reference), with gains for posture and payload.

    Slews follow straight paths of the motors in quintic timing within 95 % of the torque limits, timed anew from where
    the reference is while the parameters become known. An arm that starts at its goal is held there more tightly.

    Args:
        plant: the arm and what is unknown of it.
        weights: of the cost; None takes those of `LQR`.
        retimed: whether slews are timed anew.

    Attributes:
        slews: that the arms follow.
        shape: what an agent makes of them; None for nothing.
    """

    kept = ("slews", "_following", "_ages", "_tight", "_goal", "_planned", "shape")

    def __init__(self, plant: Plant, weights: Weights | None = None, retimed: bool = True) -> None:
        model, self._retimed = plant.model, RETIMED if retimed else ()
        weights = weights or usual_weights(model)
        low, high = plant.unknown.get("payload_mass", (model.constants.payload_mass[0],) * 2)
        self._payloads = (low, 0.5 * (low + high), high) if high > low else (low,)
        self.limits, self._period = np.array(plant.torque_limit), plant.period
        self._following = Following(model, plant.period, self._payloads)
        self.slews = Slews(model, self.limits, SHARE, self._payloads)
        tight = weights._replace(tip=HOLDING * weights.tip)
        self._gains = [GainTable(model, self.limits, plant.period, each, self._payloads) for each in (weights, tight)]
        self._motors = model.motor_columns
        self.shape: Shape | None = None
        self._planned = np.zeros(0, dtype=bool)  # in this period
        self._ages, self._tight = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=bool)
        self._goal, self._follows = np.zeros((0, model.n_joints)), np.zeros(0, dtype=bool)  # whether goals move

    def reset(self, arms: IntArray, episode: Episode) -> None:
        """Starts new episodes of the arms (r,); they are planned from the first estimate of where they are."""
        count = int(arms.max(initial=-1)) + 1
        for name in ("_ages", "_tight", "_goal", "_follows", "_planned"):
            setattr(self, name, grown(getattr(self, name), count))
        self.slews.grow(count)
        self._planned[arms] = False
        self._ages[arms], self._goal[arms], self._follows[arms] = 0, episode.goal, episode.reference is not None
        self._tight[arms] = (episode.start == episode.goal).all(axis=1) & (episode.reference is None)
        if episode.reference is not None:
            for arm, path in zip(arms.tolist(), episode.reference, strict=True):
                self._following.begin(arm, path)
        for table in self._gains:
            table.save()

    def torques(self, estimate: Estimate, playing: Flags) -> Array:
        """Gives torques (b, n) N m, within the limits, and moves on by a period; 0 for arms that do not play."""
        arms, result = np.flatnonzero(playing), np.zeros((len(playing), len(self.limits)))
        if not len(arms):
            return result
        self.plan(estimate, playing)
        if self.shape:
            self.shape.quicken(arms)
        now = self.clock(estimate, arms)
        states, (reference, forward) = estimate.states[arms], self._reference(now, arms)
        payloads = payloads_of(self.slews.model, estimate.parameters, arms)
        gains = np.zeros((len(arms), len(self.limits), states.shape[1]))
        for table, some in zip(self._gains, (~self._tight[arms], self._tight[arms]), strict=True):
            if some.any():
                gains[some] = table(arms[some], states[some][:, self._motors], payloads[some])
        asked = forward - row_dots(gains, (states - reference)[:, None])
        if self.shape:
            asked += self.shape.advance(arms, self.slews.at(now, arms)[0])
        result[arms] = np.clip(asked, -self.limits, self.limits)
        self._ages += playing
        self._planned[arms] = False
        return result

    def clock(self, estimate: Estimate, arms: IntArray) -> Array:
        """Gives the times (r,) s on the slews of arms (r,) at which torques that are asked for now begin to act."""
        now = (self._ages[arms] + estimate.lead[arms]).astype(float) * self._period
        return now + self.shape.ahead[arms] if self.shape else now

    def plan(self, estimate: Estimate, playing: Flags) -> None:
        """Plans for the arms (b,) that are playing, once in a period; `torques` does it where nobody has."""
        due = playing & ~self._planned
        if due.any():
            arms = np.flatnonzero(due)
            self._plan(arms, estimate)
            self._planned |= due

    def reference(self, estimate: Estimate, arms: IntArray) -> Array:
        """Gives the states (r, 2 d) in which arms (r,) should be when torques that are asked for now begin to act."""
        return self._reference(self.clock(estimate, arms), arms)[0]

    def _reference(self, now: Array, arms: IntArray) -> tuple[Array, Array]:
        """States (r, 2 d) of the references of arms (r,) at times (r,) s, and torques (r, n) in the period after."""
        moving = self._follows[arms]
        if moving.all():
            return self._following.at(now, arms)
        middle = now + 0.5 * self._period * self.slews.pace[arms]
        states, torques = self.slews.states(now, arms), self.slews.torques(middle, arms)
        if self.shape:
            states += self.shape.offset_states(arms)
        if moving.any():
            states[moving], torques[moving] = self._following.at(now[moving], arms[moving])
        return states, torques

    def _plan(self, arms: IntArray, estimate: Estimate) -> None:
        """Plans for arms (r,) that begin, and looks at the parameters of the others now and then."""
        due, follows = self._ages[arms] % ADAPTED == 0, self._follows[arms]
        self._following.adapt(arms[follows & due], estimate.parameters)
        arms, due = arms[~follows], due[~follows] & (self._ages[arms[~follows]] > 0)
        first = arms[self._ages[arms] == 0]
        if len(first):
            start = np.where(self._tight[first, None], self._goal[first], estimate.states[first][:, self._motors])
            self.slews.begin(first, start, self._goal[first])
            self.slews.adapt(first, estimate.parameters)
            self.slews.time(first, self.clock(estimate, first), first=True)
        again = arms[np.isin(self._ages[arms], self._retimed)] if estimate.parameters else arms[:0]
        self.slews.adapt(np.union1d(arms[due], again), estimate.parameters)
        if len(again):
            again = again[self.slews.at(self.clock(estimate, again), again)[0] < ARRIVING]
            self.slews.time(again, self.clock(estimate, again), first=False)
