"""Simulated machine: an environment's arm in real time, in a process of its own, behind the UDP of a real machine."""

import gc
import multiprocessing
import select
import socket
import time
from collections.abc import Mapping
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any, Self

import numpy as np

from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.toolbox.deployment.machine.arm import SimulatedArm
from flexman_gym.toolbox.deployment.machine.machine import LOCALHOST
from flexman_gym.toolbox.deployment.machine.packets import MAX_PACKET
from flexman_gym.toolbox.deployment.machine.server import Disturbances, MachineServer

SILENT_PERIODS = 5  # control periods without a packet after which an arm is brought to rest
START_SECONDS = 120.0  # s; longest start of the process, which may compile kernels


class SimulatedMachine:
    """Process with a `SimulatedArm` in real time behind UDP on this computer.

    Args:
        environment: environment of the arm.
        seed: seed of the episode.
        disturbances: disturbances of the packets.
        options: options of the reset.
        silence: control periods without commands after which the arm is stopped.

    Attributes:
        address: address for `UdpMachine`.
        pid: number of the process.
    """

    def __init__(
        self,
        environment: Configuration,
        seed: int,
        disturbances: Disturbances | None = None,
        options: Mapping[str, Any] | None = None,
        silence: int = SILENT_PERIODS,
    ) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        arguments = (theirs, environment, seed, disturbances or Disturbances(), options, silence)
        self._process = context.Process(target=_serve, args=arguments, daemon=True)
        self._process.start()
        theirs.close()
        if not self._pipe.poll(START_SECONDS):
            self._process.kill()
            raise OSError(f"sim: the simulated machine did not start within {START_SECONDS:g} s")
        try:
            answer = self._pipe.recv()
        except EOFError:
            raise OSError("sim: the process of the simulated machine ended during its start") from None
        if isinstance(answer, str):
            raise ValueError(answer)
        self.address, self.pid = f"udp:{LOCALHOST}:{answer}", self._process.pid

    def close(self) -> dict[str, Any]:
        """End the process and return its record; {} if it was killed.

        Returns:
            "time" (T,), s, "mode" (T,), "states" (T, 2 d), "tips" (T, 3), m, "torques" (T, n), N m, and
            "tip_velocities" (T, 3), m/s, at the ends of the control periods, "reason" of the stop, and "packets", the
            counts of the received packets.
        """
        record: dict[str, Any] = {}
        try:
            self._pipe.send("close")
            record = self._pipe.recv() if self._pipe.poll(10.0) else {}
        except (EOFError, OSError):  # the process was killed
            pass
        self._process.join(2.0)
        if self._process.is_alive():
            self._process.kill()
        return record

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def _serve(
    pipe: Connection, environment: Configuration, seed: int, disturbances: Disturbances, options: Any, silence: int
) -> None:
    """Run the process of a simulated machine; arguments as for `SimulatedMachine`."""
    try:
        arm = SimulatedArm(environment, seed, options)
    except (ValueError, OSError) as error:
        pipe.send(str(error))
        return
    arm.step(np.zeros_like(arm.limits))  # loads all kernels
    arm = SimulatedArm(environment, seed, options)
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    link.bind((LOCALHOST, 0))
    link.setblocking(False)
    server = MachineServer(arm, disturbances, seed, silence, link.sendto, time.monotonic())
    pipe.send(link.getsockname()[1])
    gc.collect()
    gc.disable()  # a collection takes longer than some control periods
    try:
        while not pipe.poll():
            _run_period(server, link)
        pipe.send(server.record())
    except (EOFError, OSError, KeyboardInterrupt):  # the other process ended
        pass


def _run_period(server: MachineServer, link: socket.socket) -> None:
    """Receive and send packets until the end of a control period."""
    deadline = server.deadline
    while server.deadline == deadline:
        if select.select([link], [], [], max(server.next_event - time.monotonic(), 0.0))[0]:
            with suppress(OSError):
                data, sender = link.recvfrom(MAX_PACKET)
                server.receive(data, sender, time.monotonic())
        with suppress(OSError):  # the controller is gone
            server.advance(time.monotonic())
