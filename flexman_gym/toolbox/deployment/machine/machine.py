"""Machine: protocol of a robot arm that is driven in real time, and a machine behind UDP."""

import json
import socket
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from secrets import randbits
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import mapping, one_of, positive, whole_number
from flexman_gym.common.errors import value_error
from flexman_gym.model.linearization import MEASUREMENT_UNITS
from flexman_gym.toolbox.deployment.machine.clock import Clock, MonotonicClock
from flexman_gym.toolbox.deployment.machine.packets import (
    COMMAND,
    COPIES,
    HELLO,
    MAX_PACKET,
    READINGS,
    STOP,
    VERSION,
    Packet,
    Receiver,
    other_version,
)

UNITS = MEASUREMENT_UNITS | {"torques": "N m", "state": "rad, m, rad/s, m/s"}  # quantity of a machine -> unit
COMMAND_UNITS = ("N m", "A")
LOCALHOST = "127.0.0.1"
HELLO_SECONDS = 10.0  # s; time in which a machine must answer
GREETINGS = 3  # round trips of a hello; one that waited for a busy machine would age all readings by as much
REPEAT_SECONDS = 0.2  # s; time between two hellos
READ_INTERVAL = 3e-4  # s; time between two attempts to read while nothing else is to be done, more than `clock.SPIN`
STOP_COPIES = 20  # copies of the order to stop; one of them arrives even if four of five packets are lost
MAX_SENT = 1000  # commands whose times are remembered
MAX_VALUES = 4096  # values of a quantity in readings


class Receipt(NamedTuple):
    """Transport of the newest readings of a machine.

    Attributes:
        number: number of the control period of the machine at whose end the readings were sampled.
        time: time of the sample, s, by the clock of the machine.
        sampled: earliest possible time of the sample, s, by the clock of the loop: the time at which the newest packet
            that the machine had received was sent, plus the time from its arrival to the sample.
        behind: number of commands that were written after the newest command that the machine had received.
        arrived: number of packets that have arrived, with all copies.
    """

    number: int
    time: float
    sampled: float
    behind: int
    arrived: int


@runtime_checkable
class Machine(Protocol):
    """Robot arm with n motors, driven by `flexman drive`. A class with these members needs no base class.

    The machine holds its arm with brakes until the first command, and brings it to rest if it receives no command for
    some control periods, or after `stop`. Two attributes are optional. `clock`, with the methods of
    `clock.MonotonicClock`, is the clock of a machine that does not move in real time. `receipt` is the `Receipt` of the
    newest readings; without it their age and period are not tested.

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


class Link(Protocol):
    """Connection to a machine that transports packets."""

    def send(self, data: bytes) -> object:
        """Send a packet; OSError if the machine is gone."""
        ...

    def receive(self) -> bytes | None:
        """Return a packet that has arrived; None without one."""
        ...

    def close(self) -> None:
        """Close the connection."""
        ...


class UdpLink:
    """Connection to the address "udp:HOST:PORT"; "udp:PORT" for this computer.

    Raises:
        ValueError: for an address of another form.
    """

    def __init__(self, address: str) -> None:
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
        self._socket.setblocking(False)
        self.send, self.close = self._socket.send, self._socket.close

    def receive(self) -> bytes | None:
        """Return a packet that has arrived; None without one."""
        with suppress(OSError):  # no packet, or the machine is gone
            return self._socket.recv(MAX_PACKET)
        return None


class UdpMachine:
    """Machine behind UDP, see `machine.packets`.

    Args:
        address: address of the machine, see `UdpLink`.
        wanted: names of quantities to ask for.
        connect: function that opens the connection to an address.
        clock: clock of the loop.

    Attributes:
        period: control period, s.
        unit: unit of the commands.
        quantities: name -> number of values.
        receiver: receiver of the readings, with the counts of packets.
        receipt: transport of the newest readings; None before the first.
        clock: clock of the loop.

    Raises:
        OSError: for a machine that does not answer.
        ValueError: for an address of another form, and for an answer that is not allowed.
    """

    def __init__(
        self,
        address: str,
        wanted: Sequence[str] = tuple(MEASUREMENT_UNITS),
        connect: Callable[[str], Link] = UdpLink,
        clock: Clock | None = None,
    ) -> None:
        self.clock, self._link = clock or MonotonicClock(), connect(address)
        self.receiver = Receiver(randbits(32))
        self.receipt: Receipt | None = None
        self._sequence, self._commands = 0, 0
        self._sent: deque[tuple[int, float, int]] = deque(maxlen=MAX_SENT)  # sequence number, time (s), commands so far
        try:
            for _ in range(GREETINGS):
                answer = self._greet(address, wanted)
                self.period, self.unit, self.quantities = _checked_answer(address, answer)
                sent = next((time for number, time, _ in self._sent if number == answer.echo), -np.inf)
                if self.clock.now() - sent <= self.period:
                    break
        except BaseException:
            self._link.close()
            raise
        self._ends = np.cumsum(list(self.quantities.values()), dtype=int).tolist()

    def _greet(self, address: str, wanted: Sequence[str]) -> Packet:
        """Return the answer of the machine to HELLO."""
        end = self.clock.now() + HELLO_SECONDS
        while (now := self.clock.now()) < end:
            with suppress(OSError):  # no machine yet
                self._send(HELLO, json.dumps({"quantities": list(wanted)}).encode())
            while self.clock.now() < now + REPEAT_SECONDS:
                if (data := self._link.receive()) is None:
                    self.clock.wait(self.clock.now() + READ_INTERVAL)
                    continue
                if (version := other_version(data)) is not None:
                    text = f"{address}: the machine sends packets of version {version}"
                    raise ValueError(f"{text} of the format; give one that sends version {VERSION}")
                packet = Packet.decode(data)
                if packet is not None and (packet.kind, packet.session) == (HELLO, self.receiver.session):
                    return packet
        text = f"{address}: no machine answers within {HELLO_SECONDS:g} s"
        raise OSError(f"{text}; packets have version {VERSION} of the format")

    def _send(self, kind: int, payload: bytes = b"", copies: int = 1) -> None:
        self._sequence += 1
        now, receiver = self.clock.now(), self.receiver
        self._sent.append((self._sequence, now, self._commands))
        dwell = now - receiver.arrival if receiver.newest else 0.0
        packet = Packet(kind, receiver.session, self._sequence, now, payload, receiver.newest, dwell).encode()
        for _ in range(copies):
            self._link.send(packet)

    def read(self) -> dict[str, Array] | None:
        """Return the readings of the newest packet; None without a new packet."""
        newest = None
        while (data := self._link.receive()) is not None:
            packet = self.receiver.accept(data, self.clock.now())
            if packet is not None and packet.kind == READINGS and len(packet.payload) == 8 * self._ends[-1]:
                newest = packet
        if newest is None:
            return None
        sent, commands = next(((time, count) for each, time, count in self._sent if each == newest.echo), (-np.inf, 0))
        behind, arrived = self._commands - commands, self.receiver.arrived
        self.receipt = Receipt(newest.sequence, newest.time, sent + newest.dwell, behind, arrived)
        values = newest.values
        return {
            name: values[end - size : end]
            for (name, size), end in zip(self.quantities.items(), self._ends, strict=True)
        }

    def write(self, commands: Array) -> None:
        """Send the commands (n,)."""
        self._commands += 1
        self._try_send(COMMAND, COPIES, np.asarray(commands, dtype="<f8").tobytes())

    def stop(self) -> None:
        """Send the order to stop."""
        self._try_send(STOP, STOP_COPIES)

    def _try_send(self, kind: int, copies: int, payload: bytes = b"") -> None:
        with suppress(OSError):  # of a machine that is gone, which the loop finds by its silence
            self._send(kind, payload, copies)

    def close(self) -> None:
        """Close the connection."""
        self._link.close()


def _checked_answer(address: str, packet: Packet) -> tuple[float, str, dict[str, int]]:
    """Return control period (s), unit of the commands, and quantities of an answer to HELLO."""
    try:
        if not packet.echo:
            raise value_error("echo", packet.echo, "the sequence number of the hello")
        answer = mapping("hello", json.loads(packet.payload), ("period", "unit", "quantities"))
        period, unit = positive("period", answer.get("period"), "s"), one_of("unit", answer.get("unit"), COMMAND_UNITS)
        quantities = {}
        for name, entry in mapping("quantities", answer.get("quantities"), tuple(UNITS)).items():
            if not isinstance(entry, list) or len(entry) != 2:
                raise value_error(f"quantities.{name}", entry, "a list of size and unit")
            quantities[name] = whole_number(f"quantities.{name}[0]", entry[0], 1, MAX_VALUES)
            one_of(f"quantities.{name}[1]", entry[1], (UNITS[name],))
        if not quantities:
            raise value_error("quantities", {}, "at least motor_angles")
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{address}: the answer of the machine is not allowed ({error})") from None
    return period, unit, quantities
