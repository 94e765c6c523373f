"""Packets of a machine: what is received is what was sent, in order and once, or nothing."""

import numpy as np
import pytest

from flexman_gym.toolbox.deployment.machine import packets
from flexman_gym.toolbox.deployment.machine.packets import (
    COMMAND,
    HELLO,
    READINGS,
    STOP,
    Packet,
    Receiver,
    other_version,
)


def reading(sequence, time=None, session=7, values=(1.0, -2.5e-9)):
    payload = np.array(values, dtype="<f8").tobytes()
    return Packet(READINGS, session, sequence, float(sequence) if time is None else time, payload).encode()


def counts(receiver):
    return {name: each for name, each in vars(receiver.counts).items() if each}


@pytest.mark.parametrize("kind", [HELLO, READINGS, COMMAND, STOP])
@pytest.mark.parametrize(
    "payload", [b"", b'{"quantities": ["motor_angles"]}', np.array([np.pi, -0.0, np.nan]).tobytes()]
)
def test_a_packet_is_read_back_to_the_bit(kind, payload):
    packet = Packet(kind, 2**32 - 1, 2**64 - 1, 1.25, payload, 2**63, 0.5)
    assert Packet.decode(packet.encode()) == packet


def test_values_are_read_back_to_the_bit():
    values = np.array([1.0 / 3.0, -0.0, 5e-324, 1e300])
    assert Packet.decode(reading(1, values=values)).values.tobytes() == values.tobytes()


def test_a_packet_with_any_flipped_bit_is_refused():
    data = reading(3)
    receiver = Receiver(7)
    for bit in range(8 * len(data)):
        damaged = bytearray(data)
        damaged[bit // 8] ^= 1 << (bit % 8)
        assert receiver.accept(bytes(damaged)) is None
    assert counts(receiver) == {"damaged": 8 * len(data)}
    assert receiver.accept(data) is not None


@pytest.mark.parametrize("length", range(0, 40, 3))
def test_a_shortened_packet_is_refused(length):
    assert Packet.decode(reading(1)[:length]) is None


def test_packets_that_are_repeated_late_or_of_another_session_are_refused_and_counted():
    receiver = Receiver(7)
    order = [1, 2, 2, 5, 4, 4, 1, 6]
    accepted = [sequence for sequence in order if receiver.accept(reading(sequence))]
    assert accepted == [1, 2, 5, 6]
    assert receiver.accept(reading(9, session=8)) is None
    assert counts(receiver) == {"accepted": 4, "lost": 1, "late": 1, "repeated": 3}


def test_packets_of_a_frozen_clock_are_refused():
    receiver = Receiver(7)
    accepted = [
        bool(receiver.accept(reading(sequence, time))) for sequence, time in ((1, 0.1), (2, 0.1), (3, 0.1), (4, 0.2))
    ]
    assert accepted == [True, False, False, True]
    assert counts(receiver) == {"accepted": 2, "frozen": 2}


def test_all_copies_are_counted_as_arrived_and_the_first_has_the_time_of_the_arrival():
    receiver = Receiver(7)
    for now, sequence in enumerate((1, 1, 1, 3, 2, 3)):
        receiver.accept(reading(sequence), float(now))
    assert (receiver.arrived, receiver.newest, receiver.arrival) == (6, 3, 3.0)
    assert counts(receiver) == {"accepted": 2, "late": 1, "repeated": 3}


def test_a_jump_to_the_largest_sequence_number_is_accepted_once_and_nothing_after_it():
    receiver = Receiver(7)
    assert receiver.accept(reading(2**64 - 1)) is not None
    assert receiver.accept(reading(5, 6.0)) is None and receiver.accept(reading(2**64 - 1, 7.0)) is None


def test_a_packet_of_another_version_is_no_packet_but_known_as_one(monkeypatch):
    """Also one whose checksum is right."""
    data = reading(1)
    monkeypatch.setattr(packets, "VERSION", 1)
    older = reading(1)
    monkeypatch.undo()
    assert Packet.decode(older) is None and other_version(older) == 1
    assert other_version(data) is None and other_version(b"") is None and other_version(b"XM\x01") is None
    assert other_version(data[:2] + b"\x01" + data[3:]) == 1
