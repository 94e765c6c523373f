"""Worlds: true arms that an observer is asked about, with what it is not told of."""

import numpy as np

from flexman_gym.control.controller import Episode
from flexman_gym.control.instruments import make_instruments
from flexman_gym.envs.setup import build, setup_of
from flexman_gym.envs.specification import make_plant
from flexman_gym.model.statics import rest_states
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.readings import INSTRUMENTS

ALL = tuple(INSTRUMENTS)
POSTURES = np.array([[0.4, -0.7], [-1.2, 0.5], [0.9, 1.3]])


def plant(name="FlexPlanar-v0", **changes):
    """What is told of a named environment, with changes."""
    setup = setup_of({"name": name})
    return make_plant(setup, build(setup).model)._replace(**changes)


class World:
    """True arms of two joints at rest at postures: what they are asked for moves them when it comes, instruments read.

    What nobody is told of: `offset`, torques on the motors, `force` on the tip; `bias` and `noise` (b, m) of readings.
    """

    def __init__(self, given, postures=POSTURES):
        self.plant, self.count = given, len(postures)
        self.batch, self.goals = Batch(given.model, *given.moved, given.period, arms=self.count), postures
        self.batch.place(np.arange(self.count), rest_states(given.model, postures))
        self.instruments, self.arms = make_instruments(given, ALL), np.arange(self.count)
        self.last, self.asked = np.zeros((self.count, 2)), [np.zeros((self.count, 2))] * (given.delay[0] + 1)
        self.offset, self.force, self.bias, self.noise = (0.0,) * 4

    def begin(self, told):
        """Starts an observer or a controller, which is not told where the arms are."""
        told.reset(self.arms, Episode(np.full_like(self.goals, 9.0), self.goals, self.plant.period))

    @property
    def numbers(self):
        """What instruments read (b, m)."""
        return self.batch.state @ self.instruments.matrix.T + self.bias + self.noise

    def readings(self):
        """The same by name."""
        numbers = self.numbers
        return {name: numbers[:, place] for name, place in self.instruments.places.items()}

    def step(self, actions):
        """Asks the motors for parts (b, 2) of their limits."""
        self.last, self.asked = actions, [*self.asked[1:], actions * np.array(self.plant.torque_limit)]
        drive = np.zeros((self.count, 8))
        drive[:, :2], drive[:, 2:5] = self.asked[0] + self.offset, self.force
        self.batch.step(drive)

    def play(self, observer, actions, watch=lambda estimate: None):
        """Takes actions (T, b, 2), the observer is asked before each of them; gives what it said, and true states."""
        said, true = [], []
        for each in actions:
            said.append(observer.estimate(self.readings(), self.last, np.ones(self.count, dtype=bool)))
            true.append(self.batch.state.copy())
            watch(said[-1])
            self.step(each)
        return said, true


def random_actions(periods, count=3, seed=0, size=0.3):
    """Actions (T, b, 2) that change in every period."""
    return size * np.random.default_rng(seed).uniform(-1.0, 1.0, (periods, count, 2))
