"""Machines without sockets, processes and real time."""

import numpy as np

from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.toolbox.deployment.machine.arm import SimulatedArm
from flexman_gym.toolbox.deployment.machine.drive import MEASURED


class FakeClock:
    """Clock that is always on time."""

    def __init__(self):
        self.time = 0.0

    def now(self):
        self.time += 1e-9
        return self.time

    def wait(self, deadline):
        self.time = max(self.time, deadline)


class FakeMachine:
    """Machine that simulates a control period in each command, and after a stop at each tick of its clock.

    `fault(machine, readings)` returns the readings that are received, or None.
    """

    def __init__(self, environment, seed, names, fault=None, unit="N m"):
        environment = Configuration.find(environment)
        self.arm, self.unit, self.period = SimulatedArm(environment, seed), unit, environment.control_period
        self._names, self._fault, self.commands, self.path = names, fault, [], []
        self.clock, self._tick = FakeClock(), 0.0
        self.quantities = {name: len(each) for name, each in self.arm.readings(names).items()}
        self.scale = np.array(
            [joint.motor.torque_per_ampere if unit == "A" else 1.0 for joint in environment.arm.joints]
        )

    def write(self, commands):
        self.commands.append(commands)
        self._step(commands * self.scale)

    def _step(self, torques):
        self.arm.step(torques)
        view = self.arm.episodes.view
        self.path.append((view.motor_angles[0].copy(), view.motor_rates[0].copy(), self.arm.torques))

    def read(self):
        if self.arm.reason:
            if self.clock.now() < self._tick:
                return None
            self._tick = self.clock.now() + self.period
            self._step(np.zeros_like(self.scale))
        readings = self.arm.readings(self._names)
        return self._fault(self, readings) if self._fault else readings

    def stop(self):
        self.arm.stop("ordered")


class FakeSimulatedMachine:
    """Stand-in for `SimulatedMachine` whose address is a FakeMachine, so that a busy computer keeps all deadlines."""

    def __init__(self, environment, seed, *_):
        self.address = FakeMachine(environment, seed, (*MEASURED, "torques"))

    def __enter__(self):
        return self

    def __exit__(self, *error):
        pass
