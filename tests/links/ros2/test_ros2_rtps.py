"""Services on the wire protocol of DDS, asked by packets as Fast DDS 2.9 and CycloneDDS send them.

The packets are built here by DDSI-RTPS 2.3, chapter 9; which parameters they have is as recorded of both.
"""

import os
import socket
import struct
import time
from random import Random

import pytest

pytest.importorskip("cyclonedds")
pytest.importorskip("rosbags")

from qrsim.links.ros2.rtps import wire
from qrsim.links.ros2.rtps.history import Kept, Received
from qrsim.links.ros2.rtps.services import Services

DOMAIN = 100 + (os.getpid() + 10) % 100
ALONE = (
    '<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="lo" multicast="true"/></Interfaces></General>'
    "</Domain></CycloneDDS>"
)
OWN = b"\0\0qrsim-test"
REQUEST, RESPONSE = "test_msgs::srv::dds_::Ask_Request_", "test_msgs::srv::dds_::Ask_Response_"
# GUID prefixes: vendor, then anything. Entities of the client: writer of requests, reader of responses.
FAST, CYCLONE = b"\x01\x0ffast-dds-1", b"\x01\x10cyclonedds"
WRITER, READER = b"\0\0\1\x03", b"\0\0\2\x04"
SERVICE_READER, SERVICE_WRITER = b"\0\0\1\x04", b"\0\0\1\x03"
CDR = b"\0\1\0\0"


def submessage(kind, flags, body):
    return struct.pack("<BBH", kind, flags | 1, len(body)) + body


def packet(prefix, *parts):
    return b"RTPS\2\3" + prefix[:2] + prefix + submessage(0x0E, 0, OWN) + b"".join(parts)


def listed(*values):
    return b"".join(struct.pack("<HH", kind, len(value)) + value for kind, value in values) + b"\1\0\0\0"


def text(value):
    raw = value.encode() + b"\0"
    raw += bytes(-len(raw) % 4)
    return struct.pack("<I", len(value) + 1) + raw


def data(reader, writer, sequence, payload, inline=b""):
    flags = 0x04 | (0x02 if inline else 0)
    head = struct.pack("<HH", 0, 16) + reader + writer + struct.pack("<iI", 0, sequence)
    return submessage(0x15, flags, head + inline + payload)


class Client:
    """A client of a service, at a port of its own."""

    def __init__(self, prefix, services):
        self.prefix, self.services, self.waiting = prefix, services, []
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(5.0)
        self.place = struct.pack("<iI", 1, self.socket.getsockname()[1]) + bytes(12) + bytes((127, 0, 0, 1))

    def send(self, *parts):
        self.socket.sendto(packet(self.prefix, *parts), self.services._sockets.own[0])
        time.sleep(0.005)
        self.services.spin()

    def discover(self):
        presence = listed(
            (0x15, b"\2\3\0\0"),
            (0x16, self.prefix[:2] + b"\0\0"),
            (0x50, self.prefix + b"\0\0\1\xc1"),
            (0x32, self.place),
            (0x31, self.place),
            (0x02, struct.pack("<iI", 20, 0)),
            (0x58, b"\x3f\x0c\0\0"),
        )
        self.send(data(b"\0\1\0\xc7", b"\0\1\0\xc2", 1, b"\0\3\0\0" + presence))
        for writer, reader, own, topic, kind in (
            (b"\0\0\3\xc2", b"\0\0\3\xc7", WRITER, "rq/uav/askRequest", REQUEST),
            (b"\0\0\4\xc2", b"\0\0\4\xc7", READER, "rr/uav/askReply", RESPONSE),
        ):
            endpoint = listed(
                (0x2F, self.place),
                (0x05, text(topic)),
                (0x07, text(kind)),
                (0x5A, self.prefix + own),
                (0x1A, struct.pack("<III", 2, 0, 0)),
            )
            self.send(data(reader, writer, 1, b"\0\3\0\0" + endpoint))

    def heard(self, kind):
        """Return the body and flags of the next submessage of a kind."""
        while True:
            while self.waiting:
                own, flags, body = self.waiting.pop(0)
                if own == kind:
                    return body, flags
            found, at = self.socket.recv(65536), 20
            assert found[:4] == b"RTPS"
            while at < len(found):
                size = struct.unpack_from("<H", found, at + 2)[0]
                self.waiting.append((found[at], found[at + 1], found[at + 4 : at + 4 + size]))
                at += 4 + size


@pytest.fixture
def services(monkeypatch):
    monkeypatch.setenv("CYCLONEDDS_URI", ALONE)
    made = Services(DOMAIN, OWN)
    yield made
    made.close()


def test_a_client_of_fast_dds_is_answered_by_its_reader_and_number(services):
    """The request names the client's reader in an inline parameter; the response has it, and the request's number."""
    own = services.service("/uav/ask", REQUEST, RESPONSE)
    client = Client(FAST, services)
    client.discover()
    # It is told of both entities of the service.
    told = [client.heard(0x15)[0] for _ in range(3)]
    assert any(text("rq/uav/askRequest") in each and text(REQUEST) in each for each in told)
    assert any(text("rr/uav/askReply") in each and text(RESPONSE) in each for each in told)
    related = listed((0x800F, FAST + READER + b"\xff\xff\xff\xff\0\0\0\0"))
    for sequence in (1, 1, 2):
        client.send(data(SERVICE_READER, WRITER, sequence, CDR + b"\1\0\0\0", related))
    # One that comes again is taken once.
    assert [cdr for _, cdr in own.waiting] == [CDR + b"\1\0\0\0"] * 2
    services.reply(own, own.waiting[1][0], CDR + b"\1\x05")
    body, flags = client.heard(0x15)
    while body[8:12] != SERVICE_WRITER:
        body, flags = client.heard(0x15)
    assert flags & 0x06 == 0x06
    assert body[4:8] == READER
    # Inline parameters, then the payload, filled up to four bytes.
    identity = FAST + READER + struct.pack("<iI", 0, 2)
    assert body[20:] == listed((0x83, identity), (0x800F, identity)) + CDR + b"\1\x05\0\0"
    assert struct.unpack_from("<iI", body, 12) == (0, 1)


def test_a_client_of_cyclonedds_is_answered_by_its_header(services):
    """Sixteen bytes before the message, which the response repeats."""
    own = services.service("/uav/ask", REQUEST, RESPONSE)
    client = Client(CYCLONE, services)
    client.discover()
    header = bytes(range(16))
    # It writes to all readers of the topic.
    client.send(data(bytes(4), WRITER, 1, CDR + header + b"\1\0\0\0"))
    request, cdr = own.waiting[0]
    assert cdr == CDR + b"\1\0\0\0"
    services.reply(own, request, CDR + b"\1\x05")
    body = client.heard(0x15)[0]
    while body[8:12] != SERVICE_WRITER:
        body = client.heard(0x15)[0]
    assert body[20:] == CDR + header + b"\1\x05\0\0"


def test_what_is_lost_is_asked_for_and_sent_again(services):
    own = services.service("/uav/ask", REQUEST, RESPONSE)
    client = Client(FAST, services)
    client.discover()
    client.send(data(SERVICE_READER, WRITER, 3, CDR + b"\1\0\0\0"))
    # A heartbeat says that there are 2 to 4: 2 and 4 are asked for.
    numbers = struct.pack("<iIiI", 0, 2, 0, 4)
    client.send(submessage(0x07, 0, SERVICE_READER + WRITER + numbers + struct.pack("<i", 1)))
    body = client.heard(0x06)[0]
    while body[4:8] != WRITER:
        body = client.heard(0x06)[0]
    base, count, bits = struct.unpack_from("<iI", body, 8)[1], *struct.unpack_from("<II", body, 16)
    assert (base, count, bits) == (2, 3, 0b101 << 29)
    services.reply(own, own.waiting[0][0], CDR + b"\1\x05")
    services.reply(own, own.waiting[0][0], CDR + b"\0\x05")
    # It has none of them: base 1, and bits for 1 and 2.
    client.send(submessage(0x06, 0, READER + SERVICE_WRITER + struct.pack("<iIIIi", 0, 1, 2, 0b11 << 30, 1)))
    found = [client.heard(0x15)[0] for _ in range(4)]
    sequences = [struct.unpack_from("<iI", body, 12)[1] for body in found if body[8:12] == SERVICE_WRITER]
    assert sequences == [1, 2, 1, 2]


def test_sets_of_numbers_are_those_of_the_standard():
    """DDSI-RTPS 2.3, 9.4.2.6: 1234/12:00110 has the numbers 1236 and 1237."""
    whole = struct.pack("<iIII", 0, 1234, 12, 0b00110 << 27)
    message = wire.Submessage(wire.ACKNACK, 1, bytes(8) + whole, b"", b"")
    assert wire.numbers_at(message, 8) == (1234, [1236, 1237])
    assert wire.numbers(1234, [1236, 1237]) == struct.pack("<iIII", 0, 1234, 4, 0b0011 << 28)


def test_numbers_that_came_and_that_are_kept():
    received = Received()
    assert [received.take(each) for each in (1, 3, 3, 1, 2, 4)] == [True, True, False, False, True, True]
    received.skip(5, 7)
    assert not received.take(6)
    # All before 8 has come, and nothing is missing.
    assert received.answer(b"read", b"writ", 1, 7)[12:24] == struct.pack("<iII", 0, 8, 0)
    kept = Kept(b"writ", 2)
    assert [kept.add(payload) for payload in (b"a", b"b", b"c")] == [1, 2, 3]
    assert kept.message(b"read", 1)[0] == wire.GAP
    assert kept.message(b"read", 3).endswith(b"c\0\0\0")
    assert kept.heartbeat(b"read")[12:28] == struct.pack("<iIiI", 0, 2, 0, 3)


def test_wild_packets_end_nothing(services):
    """Of a client that is known and of others: cut off, changed, repeated."""
    own = services.service("/uav/ask", REQUEST, RESPONSE)
    client, random = Client(FAST, services), Random(5)
    client.discover()
    sound = [
        packet(FAST, data(SERVICE_READER, WRITER, 1, CDR + b"\1\0\0\0", listed((0x800F, bytes(24))))),
        packet(FAST, submessage(0x07, 0, SERVICE_READER + WRITER + struct.pack("<iIiIi", 0, 1, 0, 9, 1))),
        packet(FAST, submessage(0x06, 0, READER + SERVICE_WRITER + struct.pack("<iIIIi", 0, 1, 40, 7, 1))),
        packet(FAST, submessage(0x08, 0, SERVICE_READER + WRITER + struct.pack("<iIiII", 0, 1, 0, 9, 0))),
        packet(FAST, data(b"\0\0\4\xc7", b"\0\0\4\xc2", 2, b"\0\3\0\0" + listed((0x05, text("rr/uav/askReply"))))),
    ]
    for _ in range(3000):
        found = bytearray(random.choice(sound))
        for _ in range(random.randrange(1, 5)):
            found[random.randrange(8 if random.random() < 0.9 else 0, len(found))] = random.choice([0, 1, 127, 255])
        cut = bytes(found[: random.randrange(20, len(found) + 1)])
        services._sockets.received = lambda cut=cut: [cut]
        services._spun = 0.0
        services.spin()
    for writer in range(5000):
        gap = SERVICE_READER + struct.pack("<I", writer) + struct.pack("<iIiII", 0, 1, 0, 9, 0)
        cut = packet(FAST, submessage(0x08, 0, gap))
        services._sockets.received = lambda cut=cut: [cut]
        services._spun = 0.0
        services.spin()
    assert len(services._received) == 4096
    assert len(services._peers) <= 256
    assert len(own.waiting) <= 256
