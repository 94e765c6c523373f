"""UDP packets between a controller and a machine, and the receiver that refuses damaged, late and repeated packets.

The format is described in docs/command_line.md, "A machine behind UDP".
"""

import struct
import zlib
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array

HELLO, READINGS, COMMAND, STOP = range(4)
HEADER, CHECKSUM = struct.Struct("<2sBBIId"), struct.Struct("<I")
MAGIC, VERSION = b"FM", 1
MAX_PACKET = 65507  # bytes; largest payload of UDP
MAX_MISSING = 1000  # skipped sequence numbers that are remembered; packets that arrive later count as repeated


class Packet(NamedTuple):
    """Content of a packet: kind, session, sequence number, time of the sender (s) and payload."""

    kind: int
    session: int
    sequence: int
    time: float
    payload: bytes = b""

    def encode(self) -> bytes:
        """Return the bytes of the packet."""
        body = HEADER.pack(MAGIC, VERSION, *self[:4]) + self.payload
        return body + CHECKSUM.pack(zlib.crc32(body))

    @classmethod
    def decode(cls, data: bytes) -> "Packet | None":
        """Return the packet of received bytes; None for damaged bytes and for another format."""
        body, checksum = data[: -CHECKSUM.size], data[-CHECKSUM.size :]
        if len(data) < HEADER.size + CHECKSUM.size or CHECKSUM.pack(zlib.crc32(body)) != checksum:
            return None
        magic, version, kind, session, sequence, sent = HEADER.unpack_from(body)
        return cls(kind, session, sequence, sent, body[HEADER.size :]) if (magic, version) == (MAGIC, VERSION) else None

    @property
    def values(self) -> Array:
        """Values of the payload of READINGS or COMMAND; empty for a payload that is not a row of float64."""
        return np.frombuffer(self.payload if len(self.payload) % 8 == 0 else b"", dtype="<f8").astype(np.float64)


@dataclass
class Counts:
    """Numbers of packets: accepted, lost, and refused because late, repeated, damaged, or sent by a frozen clock."""

    accepted: int = 0
    lost: int = 0
    late: int = 0
    repeated: int = 0
    damaged: int = 0
    frozen: int = 0


class Receiver:
    """Receiver of the packets of one session, which accepts packets in the order of their sequence numbers only.

    Attributes:
        session: session whose packets are accepted.
        counts: numbers of packets; those of other sessions are not counted.
    """

    def __init__(self, session: int) -> None:
        self.session, self.counts = session, Counts()
        self._newest, self._time = 0, -np.inf
        self._missing: dict[int, None] = {}  # skipped sequence numbers, in their order

    def accept(self, data: bytes) -> Packet | None:
        """Return the packet of received bytes; None for a packet that is refused, which is counted."""
        packet, counts = Packet.decode(data), self.counts
        if packet is None:
            counts.damaged += 1
            return None
        if packet.session != self.session:
            return None
        if packet.sequence <= self._newest:
            if packet.sequence in self._missing:  # overtaken by a newer packet
                del self._missing[packet.sequence]
                counts.late, counts.lost = counts.late + 1, counts.lost - 1
            else:
                counts.repeated += 1
            return None
        skipped = range(self._newest + 1, packet.sequence)
        counts.lost, self._newest = counts.lost + len(skipped), packet.sequence
        self._missing |= dict.fromkeys(skipped[-MAX_MISSING:])
        for old in list(self._missing)[:-MAX_MISSING]:
            del self._missing[old]
        if not packet.time > self._time:
            counts.frozen += 1
            return None
        self._time, counts.accepted = packet.time, counts.accepted + 1
        return packet
