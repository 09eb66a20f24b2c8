"""Frames, byte for byte."""

from __future__ import annotations

import random

import pytest

from qrsim.errors import UsageError
from qrsim.links.reference.protocol.framing import LARGEST_REQUEST, Deframer, frame
from qrsim.links.reference.protocol.qrsim_pb2 import Size


def test_a_length_message_is_that_of_the_protocol():
    for size in (0, 1, 2, 300):
        assert frame(b"\x07" * size) == Size(value=size).SerializeToString() + b"\x07" * size
    assert frame(b"ab") == b"\x0d\x02\x00\x00\x00ab"


@pytest.mark.parametrize("seed", range(5))
def test_payloads_come_out_however_they_were_cut(seed):
    chance = random.Random(seed)
    payloads = [chance.randbytes(chance.choice((0, 1, 5, 400))) for _ in range(50)]
    stream, deframer, found = b"".join(map(frame, payloads)), Deframer(), []
    while stream:
        size = chance.choice((1, 2, 5, 7, 900))
        deframer.feed(stream[:size])
        stream = stream[size:]
        while (payload := deframer.next()) is not None:
            found.append(payload)
    assert found == payloads
    assert deframer.waiting == 0


def test_the_largest_length_is_taken_and_the_next_refused_before_its_bytes_arrive():
    deframer = Deframer()
    deframer.feed(b"\x0d" + LARGEST_REQUEST.to_bytes(4, "little"))
    assert deframer.next() is None
    deframer = Deframer()
    deframer.feed(b"\x0d" + (LARGEST_REQUEST + 1).to_bytes(4, "little"))
    with pytest.raises(UsageError, match=f"{LARGEST_REQUEST + 1} bytes; allowed: up to {LARGEST_REQUEST}"):
        deframer.next()


@pytest.mark.parametrize("first", [0x00, 0x0A, 0x47])
def test_what_is_no_length_message_is_refused_at_its_first_byte(first):
    deframer = Deframer()
    deframer.feed(bytes([first]))
    with pytest.raises(UsageError, match=f"starts with 0x{first:02X}; expected 0x0D"):
        deframer.next()


def test_ready_says_whether_next_has_something_to_say():
    """Byte by byte, and for what is no message."""
    deframer, content = Deframer(10), frame(b"abc")
    assert not deframer.ready
    for i, byte in enumerate(content):
        deframer.feed(bytes([byte]))
        assert deframer.ready == (i == len(content) - 1)
    assert deframer.next() == b"abc"
    assert not deframer.ready
    for wrong in (b"x", frame(b"01234567890")[:5]):
        deframer = Deframer(10)
        deframer.feed(wrong)
        assert deframer.ready
        with pytest.raises(UsageError):
            deframer.next()
