"""Arms with known parameters, simulated and measured as in an environment, for tests of observers."""

import numpy as np

from flexman_gym.agent.controller import EpisodeInfo
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.config.plant import make_plant
from flexman_gym.model.linearization import LINEAR_SENSORS, LinearMeasurements
from flexman_gym.model.statics import rest_state
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.physical_parameters import PARAMETERS, UNCERTAIN
from flexman_gym.toolbox.controllers.observers.observer import MeasurementModel

SMALL = {"elements": 1, "modes": 1}


def small_plant(name="FlexOne-v0", randomisation=None, **settings):
    """Return the plant of a named environment with few coordinates."""
    setup = Configuration.from_keywords({"name": name, **SMALL, "randomisation": randomisation, **settings})
    return make_plant(setup, resolve_fidelity(setup).model)


def drawn_parameters(plant, arms, random):
    """Draw parameters (b, ...) of arms uniformly from the ranges of the plant."""
    result = {}
    for key, span in plant.unknown.items():
        name = UNCERTAIN[key]
        row, nominal = PARAMETERS[name], np.asarray(PARAMETERS[name].nominal(plant.model))
        result[name] = random.uniform(*span, (arms, *nominal.shape)) * (nominal if row.factor else 1.0)
    return result


class Bench:
    """Test bench of b arms at rest with parameters (b, ...), torque delays (b,) and measurement noise.

    The noise is a share of the standard deviations of the plant; biases (m,) are added to the measurements by name.
    """

    def __init__(self, plant, start, parameters=None, delays=0, noise=0.0, seed=0, biases=None):
        self.plant, self.start, self.noise = plant, np.array(start), noise
        arms, n = self.start.shape
        self.delays, self.biases = np.broadcast_to(delays, arms), biases or {}
        self.batch = Batch(plant.model, *plant.integration, plant.period, arms=arms)
        if parameters:
            self.batch.vary(np.arange(arms), **parameters)
        self.batch.reset(np.arange(arms), rest_state(plant.model, self.start))
        self.past, self.applied = np.zeros((1 + np.max(delays), arms, n)), np.zeros((arms, n))
        self.randoms = [np.random.default_rng([seed, arm]) for arm in range(arms)]
        self.read, self.force = LinearMeasurements(plant.model), np.zeros(3)

    def readings(self):
        """Return the measurements by name."""
        result = self.read.measure(self.batch.state)
        for name, values in result.items():
            deviation = self.plant.measured()[name][1]
            own = np.array([random.standard_normal(values.shape[1]) for random in self.randoms])
            result[name] = values + self.noise * deviation * own + self.biases.get(name, 0.0)
        return result | {"state": self.batch.state.copy()}

    def step(self, actions):
        """Apply torques (b, 2), relative to their limits."""
        self.applied = np.array(actions, dtype=float)
        self.past = np.concatenate([self.applied[None], self.past[:-1]])
        n = self.applied.shape[1]
        drive = np.zeros((len(self.applied), n + 6))
        drive[:, :n] = self.past[self.delays, np.arange(len(drive))] * self.plant.torque_limit
        drive[:, n : n + 3] = self.force
        self.batch.step(drive)

    def episode(self):
        """Return the information of an observer at the start."""
        drawn = {"delay": np.array(self.delays)}
        return EpisodeInfo(self.start, self.start, self.plant.period, drawn=drawn)

    def follow(self, observer, actions, begin=True):
        """Return the estimates of an observer: the first one if it begins, and one after each action (T, b, n)."""
        playing, result = np.ones(len(self.start), dtype=bool), []
        if begin:
            observer.reset(np.arange(len(playing)), self.episode(), len(playing))
            result.append(observer.estimate(self.readings(), self.applied, playing))
        for action in actions:
            self.step(action)
            result.append(observer.estimate(self.readings(), self.applied, playing))
        return result


def pushes(random, periods, arms, n, held=8):
    """Return random actions (T, b, n), each held for some periods."""
    return random.uniform(-0.7, 0.7, (periods // held + 1, arms, n)).repeat(held, axis=0)[:periods]


ALL = tuple(LINEAR_SENSORS)
POSTURES = np.array([[0.4, -0.7], [-1.2, 0.5], [0.9, 1.3]])


def plant(name="FlexPlanar-v0", **changes):
    """Return the plant model of a named environment, with changes."""
    setup = Configuration.from_keywords({"name": name})
    return make_plant(setup, resolve_fidelity(setup).model)._replace(**changes)


class World:
    """True arms of two joints at rest at postures: what they are asked for moves them when it comes, instruments read.

    What nobody is told of: `offset`, torques on the motors, `force` on the tip; `bias` and `noise` (b, m) of readings.
    """

    def __init__(self, given, postures=POSTURES):
        self.plant, self.count = given, len(postures)
        self.batch, self.goals = Batch(given.model, *given.integration, given.period, arms=self.count), postures
        self.batch.place(np.arange(self.count), rest_state(given.model, postures))
        self.instruments, self.arms = MeasurementModel(given, ALL), np.arange(self.count)
        self.last, self.asked = np.zeros((self.count, 2)), [np.zeros((self.count, 2))] * (given.delay[0] + 1)
        self.offset, self.force, self.bias, self.noise = (0.0,) * 4

    def begin(self, told):
        """Start an observer or controller without information about the states of the arms."""
        told.reset(self.arms, EpisodeInfo(np.full_like(self.goals, 9.0), self.goals, self.plant.period), len(self.arms))

    @property
    def numbers(self):
        """Return the measurements (b, m)."""
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
        """Run actions (T, b, 2) with an observer update before each; return its estimates and the true states."""
        said, true = [], []
        for each in actions:
            said.append(observer.estimate(self.readings(), self.last, np.ones(self.count, dtype=bool)))
            true.append(self.batch.state.copy())
            watch(said[-1])
            self.step(each)
        return said, true


def random_actions(periods, count=3, seed=0, size=0.3):
    """Return random actions (T, b, 2) that change in every period."""
    return size * np.random.default_rng(seed).uniform(-1.0, 1.0, (periods, count, 2))
