"""Machine: protocol of a robot arm that is driven in real time, and a machine behind UDP."""

import json
import socket
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from secrets import randbits
from typing import Any, Protocol, runtime_checkable

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import one_of, value_error
from flexman_gym.evaluation.machine.packets import COMMAND, HELLO, MAX_PACKET, READINGS, STOP, Packet, Receiver
from flexman_gym.model.linearization import MEASUREMENT_UNITS

UNITS = MEASUREMENT_UNITS | {"torques": "N m", "state": "rad, m, rad/s, m/s"}  # quantity of a machine -> unit
COMMAND_UNITS = ("N m", "A")
LOCALHOST = "127.0.0.1"
HELLO_SECONDS = 10.0  # s; time in which a machine must answer
STOP_PACKETS = 3  # number of STOP packets, as each of them may be lost


@runtime_checkable
class Machine(Protocol):
    """Robot arm with n motors, driven by `flexman drive`. A class with these members needs no base class.

    The machine holds its arm with brakes until the first command, and brings it to rest if it receives no command for
    some control periods, or after `stop`. The optional attribute `clock`, with the methods of `drive.MonotonicClock`,
    is the clock of a machine that does not move in real time.

    Attributes:
        period: control period, s.
        unit: unit of the commands: "N m", torques at the joints after the gear, or "A", currents of the motors.
        quantities: name -> number of values of each measured quantity: motor_angles, motor_rates, joint_twists,
            joint_twist_rates (n each; rad, rad/s) and root_strains (3 n, m/m) as in `envs.view.View`, and torques (n, N
            m), the mean torques in the last control period. A simulated machine may have its state.

    Examples:
        >>> class Bench:
        ...     period, unit, quantities = 0.002, "A", {"motor_angles": 1, "motor_rates": 1}
        ...
        ...     def read(self):
        ...         return {"motor_angles": [0.0], "motor_rates": [0.0]}
        ...
        ...     def write(self, commands): ...
        ...     def stop(self): ...
        >>> isinstance(Bench(), fm.Machine)
        True
    """

    @property
    def period(self) -> float:
        """Control period, s."""
        ...

    @property
    def unit(self) -> str:
        """Unit of the commands, "N m" or "A"."""
        ...

    @property
    def quantities(self) -> Mapping[str, int]:
        """Name -> number of values of each measured quantity."""
        ...

    def read(self) -> Mapping[str, Any] | None:
        """Return the newest readings, name -> values; None without new readings since the last call."""
        ...

    def write(self, commands: Array) -> None:
        """Set the commands (n,) of the motors."""
        ...

    def stop(self) -> None:
        """Bring the arm to rest."""
        ...


class UdpMachine:
    """Machine behind UDP, see `machine.packets`.

    Args:
        address: "udp:HOST:PORT"; "udp:PORT" for this computer.
        wanted: names of quantities to ask for.

    Attributes:
        period: control period, s.
        unit: unit of the commands.
        quantities: name -> number of values.
        receiver: receiver of the readings, with the counts of packets.

    Raises:
        OSError: for a machine that does not answer.
        ValueError: for an address of another form, and for an answer that is not allowed.
    """

    def __init__(self, address: str, wanted: Sequence[str] = tuple(MEASUREMENT_UNITS)) -> None:
        kind, _, place = address.partition(":")
        host, _, port = place.rpartition(":")
        if kind != "udp" or not port.isdecimal() or not 0 < int(port) < 2**16:
            raise value_error("machine", address, "udp:HOST:PORT, or udp:PORT for a machine on this computer")
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.connect((host or LOCALHOST, int(port)))  # packets of other senders are then not received
        except OSError as error:
            self._socket.close()
            raise value_error("machine", address, f"the name or address of a computer ({error.strerror})") from None
        self.receiver, self._sequence = Receiver(randbits(32)), 0
        answer = self._greet(address, wanted)
        self._socket.setblocking(False)
        try:
            self.period, self.unit = float(answer["period"]), one_of("unit", answer["unit"], COMMAND_UNITS)
            self.quantities = {name: int(size) for name, (size, _) in answer["quantities"].items()}
            self._ends = np.cumsum(list(self.quantities.values()), dtype=int).tolist()
            for name, (_, unit) in answer["quantities"].items():
                one_of(f"the unit of {name}", unit, (UNITS[one_of("quantities", name, UNITS)],))
        except (KeyError, TypeError, ValueError) as error:
            self._socket.close()
            raise ValueError(f"{address}: the answer of the machine is not allowed ({error})") from None

    def _greet(self, address: str, wanted: Sequence[str]) -> dict[str, Any]:
        """Return the answer of the machine to HELLO."""
        self._socket.settimeout(0.2)
        end = time.monotonic() + HELLO_SECONDS
        while time.monotonic() < end:
            try:
                self._send(HELLO, json.dumps({"quantities": list(wanted)}).encode())
                packet = Packet.decode(self._socket.recv(MAX_PACKET))
                if packet is not None and (packet.kind, packet.session) == (HELLO, self.receiver.session):
                    return dict(json.loads(packet.payload))
            except (OSError, ValueError):  # no machine yet, or an answer of another program
                time.sleep(0.02)
        self._socket.close()
        raise OSError(f"{address}: no machine answers within {HELLO_SECONDS:g} s")

    def _send(self, kind: int, payload: bytes = b"") -> None:
        self._sequence += 1
        self._socket.send(Packet(kind, self.receiver.session, self._sequence, time.monotonic(), payload).encode())

    def read(self) -> dict[str, Array] | None:
        """Return the readings of the newest packet; None without a new packet."""
        newest = None
        while True:
            try:
                packet = self.receiver.accept(self._socket.recv(MAX_PACKET))
            except OSError:  # no further packet, or the machine is gone
                break
            if packet is not None and packet.kind == READINGS and len(packet.payload) == 8 * self._ends[-1]:
                newest = packet
        if newest is None:
            return None
        values = newest.values
        return {
            name: values[end - size : end]
            for (name, size), end in zip(self.quantities.items(), self._ends, strict=True)
        }

    def write(self, commands: Array) -> None:
        """Send the commands (n,)."""
        self._try_send(COMMAND, np.asarray(commands, dtype="<f8").tobytes())

    def stop(self) -> None:
        """Send the order to stop."""
        for _ in range(STOP_PACKETS):
            self._try_send(STOP)

    def _try_send(self, kind: int, payload: bytes = b"") -> None:
        with suppress(OSError):  # of a machine that is gone, which the loop finds by its silence
            self._send(kind, payload)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
