"""Machine behind UDP: what answers a hello, and the transport of its readings."""

import json

import numpy as np
import pytest

from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.toolbox.deployment.machine.drive import drive
from flexman_gym.toolbox.deployment.machine.machine import UdpMachine
from flexman_gym.toolbox.deployment.machine.packets import COPIES, HELLO, READINGS, Packet

from oracles.machines import FakeClock, FakeMachine

ANSWER = {"period": 0.02, "unit": "N m", "quantities": {"motor_angles": [1, "rad"], "motor_rates": [1, "rad/s"]}}


class Peer:
    """Link to a peer that answers a hello with a payload, and delivers packets of readings that a test queues."""

    def __init__(self, payload, echo=None, change=lambda data: data):
        self.payload, self.echo, self.change, self.sent, self.queue = payload, echo, change, [], []

    def send(self, data):
        packet = Packet.decode(data)
        self.sent.append(packet)
        if packet.kind == HELLO:
            echo = packet.sequence if self.echo is None else self.echo
            self.queue.append(self.change(Packet(HELLO, packet.session, 0, 0.0, self.payload, echo).encode()))

    def receive(self):
        return self.queue.pop(0) if self.queue else None

    def close(self):
        self.closed = True


def connected(payload=None, **more):
    peer = Peer(json.dumps(ANSWER).encode() if payload is None else payload, **more)
    return peer, UdpMachine("udp:7", connect=lambda _: peer, clock=FakeClock())


def changed(**entries):
    return json.dumps(ANSWER | entries).encode()


@pytest.mark.parametrize(
    ("payload", "text"),
    [
        (b"", "Expecting value"),
        (b"[1]", "hello: "),
        (b"[" * 100_000, "recursion"),
        (changed(period=0), "period: 0 is not allowed"),
        (changed(period=float("nan")), "period: nan is not allowed"),
        (changed(period=None), "period: None is not allowed"),
        (changed(unit="V"), "unit: 'V' is not allowed; give one of N m, A"),
        (changed(name="x"), "hello: 'name' is not allowed"),
        (changed(quantities={}), "quantities: {} is not allowed"),
        (changed(quantities=[1]), "quantities: [1] is not allowed"),
        (changed(quantities={"speed": [1, "m/s"]}), "quantities: 'speed' is not allowed"),
        (changed(quantities={"motor_angles": [10**9, "rad"]}), "quantities.motor_angles[0]: 1000000000 is not allowed"),
        (changed(quantities={"motor_angles": [1.9, "rad"]}), "quantities.motor_angles[0]: 1.9 is not allowed"),
        (changed(quantities={"motor_angles": [0, "rad"]}), "quantities.motor_angles[0]: 0 is not allowed"),
        (changed(quantities={"motor_angles": [1, "deg"]}), "quantities.motor_angles[1]: 'deg' is not allowed"),
        (changed(quantities={"motor_angles": "rad"}), "quantities.motor_angles: 'rad' is not allowed"),
    ],
)
def test_an_answer_that_is_not_allowed_is_named_in_one_line(payload, text):
    with pytest.raises(ValueError, match=r"udp:7: the answer of the machine is not allowed") as error:
        connected(payload)
    assert text in str(error.value) and "\n" not in str(error.value)


def test_a_peer_of_another_version_and_one_without_echo_are_named():
    with pytest.raises(ValueError, match=r"udp:7: the machine sends packets of version 1 of the format; .* version 2"):
        connected(change=lambda data: data[:2] + b"\x01" + data[3:])
    with pytest.raises(ValueError, match="echo: 0 is not allowed"):
        connected(echo=0)
    with pytest.raises(OSError, match="udp:7: no machine answers within 10 s; packets have version 2"):
        connected(change=lambda data: data[:-1])


@pytest.mark.parametrize(("name", "size"), [("torques", 2), ("motor_rates", 3), ("motor_angles", 2)])
def test_sizes_that_are_not_those_of_the_arm_are_refused_before_it_moves(name, size):
    environment = Configuration.find("FlexOne-v0")
    machine = FakeMachine(environment, 9000, ("motor_angles", "motor_rates", "torques"))
    machine.quantities[name] = size
    with pytest.raises(ValueError, match=rf"machine: '{size} values of {name}' is not allowed; give 1, the number"):
        drive("pd", machine, environment, 9000)
    assert not machine.commands


def test_the_age_of_readings_is_the_round_trip_less_the_time_in_the_machine():
    peer, machine = connected()
    machine.write(np.array([0.1]))
    machine.write(np.array([0.2]))
    first = next(packet for packet in peer.sent if packet.kind != HELLO)
    machine.clock.wait(first.time + 0.03)
    values = np.array([0.5, -1.0], dtype="<f8").tobytes()
    peer.queue += [Packet(READINGS, first.session, 4, 17.0, values, first.sequence, 0.02).encode()] * 2
    assert machine.read()["motor_rates"] == [-1.0]
    receipt = machine.receipt
    assert (receipt.number, receipt.time, receipt.behind, receipt.arrived) == (4, 17.0, 1, 2)
    assert machine.clock.now() - receipt.sampled == pytest.approx(0.01, abs=1e-6)  # 30 ms since, 20 of them there


def test_readings_have_the_age_of_a_later_hello_if_the_machine_was_busy_at_the_first():
    clock, peer = FakeClock(), Peer(json.dumps(ANSWER).encode())
    answer, peer.receive = peer.receive, lambda: None if clock.now() < 0.1 else answer()
    machine = UdpMachine("udp:7", connect=lambda _: peer, clock=clock)
    hello = [packet for packet in peer.sent if packet.kind == HELLO][-1]
    assert hello.sequence == 2 and clock.now() - hello.time < machine.period
    peer.queue.append(Packet(READINGS, hello.session, 1, 1.0, np.zeros(2).tobytes(), hello.sequence).encode())
    machine.read()
    assert machine.receipt.sampled == pytest.approx(hello.time, abs=1e-6)


def test_readings_that_echo_no_packet_of_the_session_have_no_age():
    peer, machine = connected()
    values = np.zeros(2).tobytes()
    peer.queue.append(Packet(READINGS, machine.receiver.session, 1, 1.0, values, 99).encode())
    assert machine.read() is not None and machine.receipt.sampled == -np.inf


def test_commands_are_sent_several_times_and_orders_to_stop_more_often():
    peer, machine = connected()
    machine.write(np.array([0.1]))
    assert len(peer.sent) == 1 + COPIES and len({packet.sequence for packet in peer.sent[1:]}) == 1
    machine.stop()
    assert len(peer.sent) > 1 + 5 * COPIES
