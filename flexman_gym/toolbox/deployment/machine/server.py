"""Server of a simulated machine: packets of an arm with one controller at a time, without sockets and clocks."""

import heapq
import json
import os
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import finite, non_negative, one_of
from flexman_gym.common.errors import value_error
from flexman_gym.toolbox.deployment.machine.arm import BRAKED, SimulatedArm
from flexman_gym.toolbox.deployment.machine.faults import CLOCK_RATE, FAULTS, JUMP, LATE, LOSSY, VALUE_FAULTS, Readings
from flexman_gym.toolbox.deployment.machine.machine import UNITS
from flexman_gym.toolbox.deployment.machine.packets import (
    COMMAND,
    COPIES,
    HELLO,
    READINGS,
    STOP,
    Packet,
    Receiver,
    other_version,
)

OLD_PACKETS = 100  # packets that the fault "replay" sends again


@dataclass(frozen=True)
class Disturbances:
    """Disturbances of the packets of a simulated machine, and a fault for tests.

    Attributes:
        jitter: mean of the random delay of each copy of the readings, s, exponentially distributed.
        loss: probability that a copy of a packet is lost, in either direction.
        asynchronous: True for torques that act from the arrival of their packet on. By default the last torques that
            arrive within a control period act in the whole period, as in a simulation: computing time then counts in
            whole periods, as the delay of the environment.
        fault: a name in `faults.FAULTS`; "" for none. Of the packets: "kill" ends the process, "silent" sends no more
            readings, "replay" sends old packets, "late" delays the readings by 2.5 control periods, "fast" sends twice
            in each period, "slow" in every second period, "lossy" loses four of five packets; the clock stands, jumps
            by 50 periods, or runs twice as fast. Of the values: "nan", all values, the encoders or those of the last
            joint stand still, the rates of the motors have the wrong sign, their angles jump by 0.25 rad, they are in
            degrees, the joints are in the wrong order, a torque is 2000 times its limit.
        fault_time: time of the fault after the first command, s; 0 for a fault from the start of the machine on.
    """

    jitter: float = 0.0
    loss: float = 0.0
    asynchronous: bool = False
    fault: str = ""
    fault_time: float = 1.0

    def __post_init__(self) -> None:
        non_negative("jitter", self.jitter, "s")
        if not 0.0 <= finite("loss", self.loss) <= 1.0:
            raise value_error("loss", self.loss, "a probability, from 0 to 1")
        one_of("fault", self.fault, ("", *FAULTS))


class MachineServer:
    """Server of an arm. Times are those of the process that calls it, s.

    Args:
        arm: arm of the machine.
        disturbances: disturbances of the packets.
        seed: seed of the disturbances.
        silence: control periods without commands after which the arm is stopped.
        send: function that sends a packet to an address.
        start: begin of the first control period, s.

    Attributes:
        arm: arm of the machine.
        deadline: end of the present control period, s.
    """

    def __init__(
        self,
        arm: SimulatedArm,
        disturbances: Disturbances,
        seed: int,
        silence: int,
        send: Callable[[bytes, Any], object],
        start: float,
    ) -> None:
        self.arm, self._disturbances, self._silence, self._send = arm, disturbances, silence, send
        self._random = np.random.default_rng(seed)
        self._period, self._sequence = arm.episodes.view.control_period, 0
        self._start, self.deadline = start, start + self._period
        self._peer: Any = None
        self._receiver, self._names = Receiver(0), list[str]()
        self._command: Array | None = None  # N m; None before the first command
        self._arrivals: list[tuple[float, Array]] = []
        self._due: list[tuple[float, int, bytes]] = []  # packets by the times at which they are sent
        self._sent: list[bytes] = []
        self._at_fault: Readings | None = None
        self._silent, self._periods, self._ticks, self._count, self._stands = 0, 0, 0, 0, 0.0
        self._rows: list[tuple[float, int, Array, Array, Array, Array]] = []

    @property
    def next_event(self) -> float:
        """Time of the next call of `advance` that has an effect, s."""
        return min([self.deadline, *(each[0] for each in self._due[:1])])

    def advance(self, now: float) -> None:
        """Send the packets that are due, and at the end of a control period simulate it and queue the readings."""
        while self._due and self._due[0][0] <= now:
            self._send(heapq.heappop(self._due)[2], self._peer)
        if now < self.deadline:
            return
        self._step(self.deadline - self._period)
        self.deadline += self._period
        if self._peer is not None:
            self._queue_readings(now)

    @property
    def _fault(self) -> str:
        """Fault that acts now; "" for none."""
        given = self._disturbances
        return given.fault if self._periods * self._period >= given.fault_time - 1e-9 else ""

    def _lost(self) -> bool:
        """Return True if the next packet, in either direction, is lost."""
        self._count += 1
        if self._fault == "lossy":
            return self._count % LOSSY > 0
        return bool(self._random.random() < self._disturbances.loss)

    def receive(self, data: bytes, sender: Any, now: float) -> None:
        """Receive a packet from an address."""
        packet = Packet.decode(data)
        if other_version(data) is not None:  # the answer shows the version of this format
            self._send(Packet(HELLO, 0, 0, now).encode(), sender)
        elif packet is not None and packet.kind == HELLO:
            self._greet(packet, data, sender, now)
        elif sender == self._peer and not self._lost():
            accepted = self._receiver.accept(data, now)
            if accepted is not None and accepted.kind == STOP:
                self.arm.stop("ordered by the controller")
            elif accepted is not None and accepted.kind == COMMAND and len(accepted.values) == len(self.arm.limits):
                self._arrivals.append((now, accepted.values))

    def _greet(self, packet: Packet, data: bytes, sender: Any, now: float) -> None:
        """Start the session of a controller, and answer; a running arm keeps its controller."""
        if packet.session != self._receiver.session:
            if self.arm.mode != BRAKED:
                return
            try:
                wanted = json.loads(packet.payload)["quantities"]
                self._names = [name for name in UNITS if name in wanted] or ["motor_angles"]
            except (ValueError, KeyError, TypeError, RecursionError):  # a hello of another form
                return
            self._receiver, self._peer, self._sequence = Receiver(packet.session), sender, 0
        self._receiver.accept(data, now)
        sizes = {name: [len(each), UNITS[name]] for name, each in self.arm.readings(self._names).items()}
        answer = json.dumps({"period": self._period, "unit": "N m", "quantities": sizes}).encode()
        self._send(Packet(HELLO, packet.session, 0, now, answer, self._receiver.newest).encode(), sender)

    def _step(self, begin: float) -> None:
        """Simulate the control period that began at a time, s; the brakes hold the arm until the first command."""
        if self._command is None and not self._arrivals:
            return
        self._silent = 0 if self._arrivals else self._silent + 1
        if self._silent >= self._silence:
            self.arm.stop(f"no command for {self._silence} control periods")
        torques = self._arrivals[0][1] if self._command is None else self._command
        mean, last = np.zeros_like(self.arm.limits), begin
        for arrival, command in self._arrivals:
            mean, last, torques = mean + (arrival - last) * torques, arrival, command
        if self._disturbances.asynchronous:
            torques = (mean + (begin + self._period - last) * torques) / self._period
        self._command = self._arrivals[-1][1] if self._arrivals else self._command
        self._arrivals = []
        self.arm.step(torques)
        self._periods += 1
        view = self.arm.episodes.view
        row = (view.state[0].copy(), view.tip[0].copy(), self.arm.torques, view.tip_velocity[0].copy())
        self._rows.append((self._periods * self._period, self.arm.mode, *row))

    def _queue_readings(self, now: float) -> None:
        """Queue packets with the readings, changed by the disturbances and the fault."""
        fault = self._fault
        if fault == "kill":
            os._exit(1)
        values = self.arm.readings(self._names)
        if fault and self._at_fault is None:
            self._at_fault, self._stands = {name: each.copy() for name, each in values.items()}, now
        if fault in VALUE_FAULTS:
            assert self._at_fault is not None
            VALUE_FAULTS[fault](values, self._at_fault, self.arm.limits)
        self._ticks += 1
        if fault == "silent" or (fault == "slow" and self._ticks % 2):
            return
        payload = np.concatenate(list(values.values())).tobytes()
        late = LATE * self._period if fault == "late" else 0.0
        for part in (0.0, 0.5) if fault == "fast" else (0.0,):
            self._queue(now + part * self._period, late, payload)
        self._sent = self._sent[:OLD_PACKETS]

    def _queue(self, sampled: float, late: float, payload: bytes) -> None:
        """Queue the copies of a packet of readings that were sampled at a time, s."""
        given, receiver, fault = self._disturbances, self._receiver, self._fault
        clock = {
            "clock stands": self._stands,
            "clock jumps": sampled + JUMP * self._period,
            "clock drifts": sampled + (CLOCK_RATE - 1.0) * (sampled - self._stands),
        }.get(fault, sampled)
        self._sequence += 1
        echo = receiver.newest, sampled - receiver.arrival
        data = Packet(READINGS, receiver.session, self._sequence, clock, payload, *echo).encode()
        self._sent.append(data)
        data = self._sent[self._periods % OLD_PACKETS % len(self._sent)] if fault == "replay" else data
        for _ in range(COPIES):
            if not self._lost():
                delay = late + given.jitter * self._random.standard_exponential()
                heapq.heappush(self._due, (sampled + delay, self._count, data))

    def record(self) -> dict[str, Any]:
        """Return the record of the arm, see `SimulatedMachine.close`."""
        names = ("time", "mode", "states", "tips", "torques", "tip_velocities")
        columns = [np.array(each) for each in zip(*self._rows, strict=True)] if self._rows else [np.zeros(0)] * 6
        record: dict[str, Any] = dict(zip(names, columns, strict=True))
        return record | {"reason": self.arm.reason, "packets": asdict(self._receiver.counts)}
