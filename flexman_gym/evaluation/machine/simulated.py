"""Simulated machine: an environment's arm in real time, in a process of its own, behind the UDP of a real machine."""

import gc
import heapq
import json
import multiprocessing
import os
import select
import socket
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from multiprocessing.connection import Connection
from typing import Any, Self

import gymnasium as gym
import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import finite, non_negative, one_of, value_error
from flexman_gym.control.controller import EpisodeInfo
from flexman_gym.control.pd import PD
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.envs.episodes import Episodes
from flexman_gym.evaluation.agent import split_interface
from flexman_gym.evaluation.machine.machine import LOCALHOST, UNITS
from flexman_gym.evaluation.machine.packets import COMMAND, HELLO, MAX_PACKET, READINGS, STOP, Packet, Receiver

SILENT_PERIODS = 5  # control periods without a packet after which an arm is brought to rest
START_SECONDS = 120.0  # s; longest start of the process, which may compile kernels
ROUNDING = 1e-9  # relative excess of a torque over its limit that is clipped
BRAKED, RUNNING, STOPPING = range(3)
OLD_PACKETS = 100  # packets that the fault "replay" sends again
FAULTS = ("kill", "silent", "nan", "frozen", "replay")


class SimulatedArm:
    """Arm of an environment with the drives of a machine: brakes, limits of the commands, and a stop.

    Args:
        environment: environment; its randomisation and the flaws of its sensors act on the arm.
        seed: seed of the episode.
        options: options of the reset, such as start.

    Attributes:
        mode: BRAKED until the first step, RUNNING, or STOPPING.
        reason: why the arm stops; "" if it does not.
        episodes: the episode of the arm.
        limits: (n,) torque limits, N m.
        torques: (n,) torques of the last control period, N m.
    """

    def __init__(self, environment: Configuration, seed: int, options: Mapping[str, Any] | None = None) -> None:
        bare = split_interface(environment)[0].replace(sensors=environment.sensors, actions="torque")
        venv: Any = gym.make_vec(bare.id, 1, "vector_entry_point", **bare.keywords())
        venv.reset(seed=[seed], options=dict(options or {}) or None)
        self.episodes: Episodes = venv.unwrapped.episodes
        self.limits, self.mode, self.reason = np.array(bare.torque_limit), BRAKED, ""
        self.torques, self._posture = np.zeros_like(self.limits), np.zeros_like(self.limits)
        gains, model = bare.gains or NAMED_ENVIRONMENTS[bare.id].pd, self.episodes.batch.model
        weight = model if self.episodes.view.has_gravity else None
        self._pd = PD(gains["stiffness"], gains["damping"], bare.torque_limit, weight)

    def readings(self, names: Sequence[str]) -> dict[str, Array]:
        """Return the quantities (size,) of these names, as the sensors of the environment measure them."""
        view, shared = self.episodes.view, self.episodes.sensors.shared
        own = {"torques": self.torques, "state": view.state[0]}
        return {name: np.array(own[name] if name in own else getattr(shared, name)[0]) for name in names}

    def stop(self, reason: str) -> None:
        """Hold the motors where they are now by the PD controller of the environment; the torques stay limited."""
        if self.mode == RUNNING:
            self.mode, self.reason = STOPPING, reason
            self._posture = self.episodes.view.motor_angles.copy()
            self._pd.reset(
                np.array([0]), EpisodeInfo(self._posture, self._posture, self.episodes.view.control_period), 1
            )

    def step(self, torques: Array) -> None:
        """Simulate a control period under torques (n,), N m; a torque that is not allowed stops the arm."""
        if self.mode == BRAKED:
            self.mode = RUNNING
        if self.mode == RUNNING and not (np.abs(torques) <= self.limits * (1.0 + ROUNDING)).all():
            self.stop(f"torques {torques.tolist()} N m are not within the limits {self.limits.tolist()} N m")
        view = self.episodes.view
        if self.mode == STOPPING:
            readings = {"angle_errors": self._posture - view.motor_angles, "motor_rates": view.motor_rates}
            torques = self._pd.act(readings)[0] * self.limits
        self.episodes.step(np.clip(torques / self.limits, -1.0, 1.0)[None])
        self.torques = self.episodes.motors.torques[0].copy()
        if failure := self.episodes.failures.get(0):
            self.stop(failure)


@dataclass(frozen=True)
class Disturbances:
    """Disturbances of the packets of a simulated machine, and a fault for tests.

    Attributes:
        jitter: mean of the random delay of the readings, s, exponentially distributed.
        loss: probability that a packet is lost, in either direction.
        asynchronous: True for torques that act from the arrival of their packet on. By default the last torques that
            arrive within a control period act in the whole period, as in a simulation: computing time then counts in
            whole periods, as the delay of the environment.
        fault: one of FAULTS: "kill" ends the process, "silent" sends no more readings, "nan" sends NaN, "frozen" sends
            the same time in all packets, "replay" sends old packets; "" for none.
        fault_time: time of the fault after the first command, s.
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
            "time" (T,), s, "mode" (T,), "states" (T, 2 d), "tips" (T, 3), m, and "torques" (T, n), N m, at the ends of
            the control periods, "reason" of the stop, and "packets", the counts of the received packets.
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
    server = _Server(arm, disturbances, seed, silence)
    pipe.send(server.socket.getsockname()[1])
    gc.collect()
    gc.disable()  # a collection takes longer than some control periods
    try:
        while not pipe.poll():
            server.run_period()
        pipe.send(server.record())
    except (EOFError, OSError, KeyboardInterrupt):  # the other process ended
        pass


class _Server:
    """UDP server of an arm in real time, with one controller at a time."""

    def __init__(self, arm: SimulatedArm, disturbances: Disturbances, seed: int, silence: int) -> None:
        self._silence = silence
        self.arm, self._disturbances, self._random = arm, disturbances, np.random.default_rng(seed)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind((LOCALHOST, 0))
        self.socket.setblocking(False)
        self._period, self._sequence = arm.episodes.view.control_period, 0
        self._peer: Any = None
        self._receiver, self._names = Receiver(0), list[str]()
        self._command: Array | None = None  # N m; None before the first command
        self._arrivals: list[tuple[float, Array]] = []
        self._due: list[tuple[float, bytes]] = []  # packets by the times at which they are sent
        self._sent: list[bytes] = []
        self._silent, self._periods, self._frozen = 0, 0, 0.0
        self._rows: list[tuple[float, int, Array, Array, Array]] = []
        self._start = time.monotonic()
        self._deadline = self._start + self._period

    def run_period(self) -> None:
        """Receive and send packets until the end of the control period, then simulate it and send the readings."""
        begin = self._deadline - self._period
        while (now := time.monotonic()) < self._deadline:
            until = min([self._deadline, *(each[0] for each in self._due[:1])])
            if select.select([self.socket], [], [], max(until - now, 0.0))[0]:
                self._receive()
            while self._due and self._due[0][0] <= time.monotonic():
                self._send(heapq.heappop(self._due)[1])
        self._step(begin)
        self._deadline += self._period
        if self._peer is not None:
            self._queue_readings()

    def _receive(self) -> None:
        try:
            data, sender = self.socket.recvfrom(MAX_PACKET)
        except OSError:
            return
        packet = Packet.decode(data)
        if packet is not None and packet.kind == HELLO:
            self._greet(packet, data, sender)
        elif sender == self._peer and self._random.random() >= self._disturbances.loss:
            accepted = self._receiver.accept(data)
            if accepted is not None and accepted.kind == STOP:
                self.arm.stop("ordered by the controller")
            elif accepted is not None and accepted.kind == COMMAND and len(accepted.values) == len(self.arm.limits):
                self._arrivals.append((time.monotonic(), accepted.values))

    def _greet(self, packet: Packet, data: bytes, sender: Any) -> None:
        """Start the session of a controller, and answer; a running arm keeps its controller."""
        if packet.session != self._receiver.session:
            if self.arm.mode != BRAKED:
                return
            try:
                wanted = json.loads(packet.payload)["quantities"]
                self._names = [name for name in UNITS if name in wanted] or ["motor_angles"]
            except (ValueError, KeyError, TypeError):  # a hello of another form
                return
            self._receiver, self._peer, self._sequence = Receiver(packet.session), sender, 0
        self._receiver.accept(data)
        sizes = {name: [len(each), UNITS[name]] for name, each in self.arm.readings(self._names).items()}
        answer = json.dumps({"period": self._period, "unit": "N m", "quantities": sizes}).encode()
        self._send(Packet(HELLO, packet.session, 0, time.monotonic(), answer).encode())

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
        row = (view.state[0].copy(), view.tip[0].copy(), self.arm.torques)
        self._rows.append((self._periods * self._period, self.arm.mode, *row))

    def _queue_readings(self) -> None:
        """Queue a packet with the readings, changed by the disturbances and the fault."""
        given, now = self._disturbances, time.monotonic()
        fault = given.fault if self._periods * self._period >= given.fault_time else ""
        if fault == "kill":
            os._exit(1)
        values = np.concatenate(list(self.arm.readings(self._names).values()))
        if fault == "nan":
            values[0] = np.nan
        self._frozen = self._frozen if fault == "frozen" and self._frozen else now
        self._sequence += 1
        data = Packet(READINGS, self._receiver.session, self._sequence, self._frozen, values.tobytes()).encode()
        self._sent = [*self._sent, data][:OLD_PACKETS]
        data = self._sent[self._periods % len(self._sent)] if fault == "replay" else data
        if fault != "silent" and self._random.random() >= given.loss:
            heapq.heappush(self._due, (now + given.jitter * self._random.standard_exponential(), data))

    def _send(self, data: bytes) -> None:
        if self._peer is not None:
            self.socket.sendto(data, self._peer)

    def record(self) -> dict[str, Any]:
        """Return the record of the arm, see `SimulatedMachine.close`."""
        columns = [np.array(each) for each in zip(*self._rows, strict=True)] if self._rows else [np.zeros(0)] * 5
        record: dict[str, Any] = dict(zip(("time", "mode", "states", "tips", "torques"), columns, strict=True))
        return record | {"reason": self.arm.reason, "packets": asdict(self._receiver.counts)}
