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
HEADER, CHECKSUM = struct.Struct("<2sBBIQdQd"), struct.Struct("<I")
MAGIC, VERSION = b"FM", 2
MAX_PACKET = 65507  # bytes; largest payload of UDP
MAX_MISSING = 1000  # skipped sequence numbers that are remembered; packets that arrive later count as repeated
COPIES = 3  # copies of each packet but hello; of 15 packets in five control periods more than a third arrive


class Packet(NamedTuple):
    """Content of a packet.

    Attributes:
        kind: HELLO, READINGS, COMMAND or STOP.
        session: random number of the session.
        sequence: sequence number; all copies of a packet have the same.
        time: time of the sender, s; of READINGS the time of the sample.
        payload: bytes after the header.
        echo: sequence number of the newest packet that the sender has received; 0 for none.
        dwell: time from the arrival of that packet to `time`, s.
    """

    kind: int
    session: int
    sequence: int
    time: float
    payload: bytes = b""
    echo: int = 0
    dwell: float = 0.0

    def encode(self) -> bytes:
        """Return the bytes of the packet."""
        body = HEADER.pack(MAGIC, VERSION, *self[:4], self.echo, self.dwell) + self.payload
        return body + CHECKSUM.pack(zlib.crc32(body))

    @classmethod
    def decode(cls, data: bytes) -> "Packet | None":
        """Return the packet of received bytes; None for damaged bytes and for another format."""
        body, checksum = data[: -CHECKSUM.size], data[-CHECKSUM.size :]
        if len(data) < HEADER.size + CHECKSUM.size or CHECKSUM.pack(zlib.crc32(body)) != checksum:
            return None
        magic, version, kind, session, sequence, sent, echo, dwell = HEADER.unpack_from(body)
        if (magic, version) != (MAGIC, VERSION):
            return None
        return cls(kind, session, sequence, sent, body[HEADER.size :], echo, dwell)

    @property
    def values(self) -> Array:
        """Values of the payload of READINGS or COMMAND; empty for a payload that is not a row of float64."""
        return np.frombuffer(self.payload if len(self.payload) % 8 == 0 else b"", dtype="<f8").astype(np.float64)


def other_version(data: bytes) -> int | None:
    """Return the version of a packet in another version of the format; None for all other bytes."""
    version = data[2] if len(data) > 2 and data.startswith(MAGIC) else VERSION
    return None if version == VERSION else version


@dataclass
class Counts:
    """Numbers of packets by their fate; copies of a packet with the same sequence number are one packet.

    Attributes:
        accepted: packets that were accepted.
        lost: packets of which no copy arrived.
        late: packets that were overtaken by a newer one.
        repeated: further copies.
        damaged: bytes that are no packet.
        frozen: packets with a time that does not advance.
    """

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
        arrived: number of packets of this session, with all copies.
        newest: largest sequence number that arrived; 0 before the first.
        arrival: time at which it arrived first, s, by the clock of the receiver.
    """

    def __init__(self, session: int) -> None:
        self.session, self.counts = session, Counts()
        self.arrived, self.newest, self.arrival = 0, 0, 0.0
        self._time = -np.inf
        self._missing: dict[int, None] = {}  # skipped sequence numbers, in their order

    def accept(self, data: bytes, now: float = 0.0) -> Packet | None:
        """Return the packet of bytes received at a time, s; None for a packet that is refused, which is counted."""
        packet, counts = Packet.decode(data), self.counts
        if packet is None:
            counts.damaged += 1
            return None
        if packet.session != self.session:
            return None
        self.arrived += 1
        if packet.sequence <= self.newest:
            if packet.sequence in self._missing:  # overtaken by a newer packet
                del self._missing[packet.sequence]
                counts.late, counts.lost = counts.late + 1, counts.lost - 1
            else:
                counts.repeated += 1
            return None
        first = self.newest + 1
        counts.lost, self.newest, self.arrival = counts.lost + packet.sequence - first, packet.sequence, now
        self._missing |= dict.fromkeys(range(max(first, packet.sequence - MAX_MISSING), packet.sequence))
        for old in list(self._missing)[:-MAX_MISSING]:
            del self._missing[old]
        if not packet.time > self._time:
            counts.frozen += 1
            return None
        self._time, counts.accepted = packet.time, counts.accepted + 1
        return packet
