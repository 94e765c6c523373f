"""Recorder: the last states of a simulator, and a scene that reproduces its failure."""

from collections import deque
from typing import Any

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import instance, whole_number
from flexman_gym.scene.scene import Initial, Scene
from flexman_gym.scene.signals import ConstantTorque, Signal
from flexman_gym.simulation.simulator import Simulator

MOST = 1_000_000


class Recorder:
    """A simulator whose last states are kept.

    Args:
        simulator: the simulator; the recorder's `step` takes the place of its own.
        most: states that are kept.

    Attributes:
        times: of the last control periods at whose start the arm was well, oldest first, s.
        states: of these control periods, (2 d,) each.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """

    def __init__(self, simulator: Simulator, most: int = 100) -> None:
        self.simulator = instance("simulator", simulator, Simulator, "a Simulator")
        whole_number("most", most, 1, MOST)
        self.times: deque[float] = deque(maxlen=most)
        self.states: deque[Array] = deque(maxlen=most)
        self._drives: deque[Array] = deque(maxlen=most)

    def step(self, *drive: Any, **more: Any) -> str:
        """Moves on by one control period as `Simulator.step` does, and keeps where it started."""
        simulator = self.simulator
        time, state = simulator.time, simulator.state.copy()
        status = simulator.step(*drive, **more)
        self.times.append(time)
        self.states.append(state)
        self._drives.append(simulator.drive.copy())
        return status

    def scene(self, back: int = 1) -> Scene:
        """Gives one control period as a scene: the failed one, from the state at its start, by its constant drive.

        `simulate(scene, model, method, step)` with those of the simulator fails as the simulator did.

        Args:
            back: control periods from the last one on, 1 for the last.

        Raises:
            ValueError: for a period that was not kept.
        """
        simulator, n = self.simulator, self.simulator.model.n_joints
        whole_number("back", back, 1, len(self.states))
        state, drive, period = self.states[-back], self._drives[-back], simulator.control_period
        held = simulator.prescribed
        motions = [Signal(value) if fixed else None for value, fixed in zip(drive.tolist(), held, strict=False)]
        return Scene(
            simulator.model.arm,
            simulator.model.choice,
            ConstantTorque(np.where(held, 0.0, drive[:n]).tolist()),
            Initial(state[:n].tolist(), state[simulator.model.n_dof :][:n].tolist(), state.tolist()),
            period,
            period,
            f"the control period that began at {self.times[-back]:.6g} s; {simulator.status}",
            motions if held.any() else None,
            [Signal(value) for value in drive[n : n + 3].tolist()],
            [Signal(value) for value in drive[n + 3 :].tolist()],
        )
