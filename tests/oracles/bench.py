"""Bench: arms that a test knows all about, moved and read as an environment would, beside an observer."""

import numpy as np

from flexman_gym.control.controller import Episode
from flexman_gym.envs.setup import build, setup_of
from flexman_gym.envs.specification import make_plant
from flexman_gym.model.statics import rest_states
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.parameters import PARAMETERS
from flexman_gym.simulation.readings import Readings

SMALL = {"elements": 1, "modes": 1}


def small_plant(name="FlexOne-v0", randomisation=None, **settings):
    """The plant of a named environment with few coordinates."""
    setup = setup_of({"name": name, **SMALL, "randomisation": randomisation, **settings})
    return make_plant(setup, build(setup).model)


def drawn_parameters(plant, arms, random):
    """Parameters (b, ...) of arms, evenly from the ranges of the plant."""
    result = {}
    for name, span in plant.unknown.items():
        row, nominal = PARAMETERS[name], np.asarray(PARAMETERS[name].nominal(plant.model))
        result[name] = random.uniform(*span, (arms, *nominal.shape)) * (nominal if row.factor else 1.0)
    return result


class Bench:
    """b arms at rest with parameters (b, ...), torques that come late by delays (b,), and readings with noise.

    Noise is a part of the deviations of the plant; biases (m,) are added to the readings by name.
    """

    def __init__(self, plant, start, parameters=None, delays=0, noise=0.0, seed=0, biases=None):
        self.plant, self.start, self.noise = plant, np.array(start), noise
        arms, n = self.start.shape
        self.delays, self.biases = np.broadcast_to(delays, arms), biases or {}
        self.batch = Batch(plant.model, *plant.moved, plant.period, arms=arms)
        if parameters:
            self.batch.vary(np.arange(arms), **parameters)
        self.batch.reset(np.arange(arms), rest_states(plant.model, self.start))
        self.past, self.applied = np.zeros((1 + np.max(delays), arms, n)), np.zeros((arms, n))
        self.randoms = [np.random.default_rng([seed, arm]) for arm in range(arms)]
        self.read, self.force = Readings(plant.model), np.zeros(3)

    def readings(self):
        """What instruments read now; the noise of each arm is its own."""
        result = self.read.named(self.batch.state)
        for name, values in result.items():
            deviation = self.plant.measured()[name][1]
            own = np.array([random.standard_normal(values.shape[1]) for random in self.randoms])
            result[name] = values + self.noise * deviation * own + self.biases.get(name, 0.0)
        return result | {"state": self.batch.state.copy()}

    def step(self, actions):
        """Moves all arms by a period under actions (b, n), parts of the limits."""
        self.applied = np.array(actions, dtype=float)
        self.past = np.concatenate([self.applied[None], self.past[:-1]])
        n = self.applied.shape[1]
        drive = np.zeros((len(self.applied), n + 6))
        drive[:, :n] = self.past[self.delays, np.arange(len(drive))] * self.plant.torque_limit
        drive[:, n : n + 3] = self.force
        self.batch.step(drive)

    def episode(self):
        """What an observer is told at the start."""
        drawn = {"delay": np.array(self.delays)}
        return Episode(self.start, self.start, self.plant.period, drawn=drawn)

    def follow(self, observer, actions, begin=True):
        """Estimates of an observer after each of the actions (T, b, n), and before the first where it begins."""
        playing, result = np.ones(len(self.start), dtype=bool), []
        if begin:
            observer.reset(np.arange(len(playing)), self.episode())
            result.append(observer.estimate(self.readings(), self.applied, playing))
        for action in actions:
            self.step(action)
            result.append(observer.estimate(self.readings(), self.applied, playing))
        return result


def pushes(random, periods, arms, n, held=8):
    """Actions (T, b, n) that are kept for some periods."""
    return random.uniform(-0.7, 0.7, (periods // held + 1, arms, n)).repeat(held, axis=0)[:periods]
