"""Simulated machine in virtual time: the packets and the server of `SimulatedMachine`, without sockets and waiting."""

from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

from flexman_gym.common.errors import value_error
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.toolbox.deployment.machine.arm import SimulatedArm
from flexman_gym.toolbox.deployment.machine.machine import UNITS, UdpMachine
from flexman_gym.toolbox.deployment.machine.server import Disturbances, MachineServer
from flexman_gym.toolbox.deployment.machine.simulated import SILENT_PERIODS

TICK = 1e-9  # s; time that a look at the clock takes


class VirtualMachine(UdpMachine):
    """Machine whose time passes only while the loop waits: deterministic, and faster than real time.

    A computing time of zero is simulated.

    Args:
        environment: environment of the arm.
        seed: seed of the episode and of the disturbances.
        disturbances: disturbances of the packets; any fault but "kill".
        wanted: names of quantities to ask for.
        options: options of the reset.
        silence: control periods without commands after which the arm is stopped.
    """

    def __init__(
        self,
        environment: Configuration,
        seed: int,
        disturbances: Disturbances | None = None,
        wanted: Sequence[str] = tuple(UNITS),
        options: Mapping[str, Any] | None = None,
        silence: int = SILENT_PERIODS,
    ) -> None:
        disturbances = disturbances or Disturbances()
        if disturbances.fault == "kill":
            raise value_error("fault", disturbances.fault, "a fault that leaves the process of the machine")
        arm = SimulatedArm(environment, seed, options)
        self._arrived: deque[bytes] = deque()
        self._time = 0.0
        self._server = MachineServer(
            arm, disturbances, seed, silence, lambda data, _: self._arrived.append(data), self._time
        )
        super().__init__("virtual", wanted, lambda _: _VirtualLink(self), self)

    def now(self) -> float:
        """Return the virtual time, s."""
        self._time += TICK
        return self._time

    def wait(self, deadline: float) -> None:
        """Let the machine move until a time, s."""
        while (event := self._server.next_event) <= deadline:
            self._time = max(self._time, event)
            self._server.advance(self._time)
        self._time = max(self._time, deadline)

    @property
    def arm(self) -> SimulatedArm:
        """Arm of the machine."""
        return self._server.arm

    def record(self) -> dict[str, Any]:
        """Return the record of the arm, see `SimulatedMachine.close`."""
        return self._server.record()


class _VirtualLink:
    """Connection to the server of a virtual machine."""

    def __init__(self, machine: VirtualMachine) -> None:
        self._machine = machine

    def send(self, data: bytes) -> None:
        """Deliver a packet at once."""
        machine = self._machine
        machine._server.receive(data, "controller", machine._time)

    def receive(self) -> bytes | None:
        """Return a packet that has arrived; None without one."""
        return self._machine._arrived.popleft() if self._machine._arrived else None

    def close(self) -> None:
        """Do nothing."""
