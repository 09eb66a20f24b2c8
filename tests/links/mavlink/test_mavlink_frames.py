"""Frames against pymavlink's, byte for byte, and what becomes of frames that are harmed."""

import random
import struct

import pytest
from pymavlink.dialects.v20 import ardupilotmega, common, development

from qrsim.links.mavlink.checksum import x25
from qrsim.links.mavlink.dialect import BY_NUMBER, LAYOUTS
from qrsim.links.mavlink.frames import Reader, frame

RANGES = {
    "B": (0, 255),
    "b": (-128, 127),
    "H": (0, 65535),
    "h": (-32768, 32767),
    "I": (0, 2**32 - 1),
    "i": (-(2**31), 2**31 - 1),
    "Q": (0, 2**64 - 1),
    "q": (-(2**63), 2**63 - 1),
}


def value_of(field, draw):
    if field.type == "c":
        return bytes(draw.choices(b"ABCxyz_09", k=draw.randint(0, field.count)))
    one = (lambda: draw.uniform(-1e4, 1e4)) if field.type == "f" else lambda: draw.randint(*RANGES[field.type])
    return [one() for _ in range(field.count)] if field.count else one()


def test_check_of_the_standard_text():
    assert x25(b"123456789") == 0x6F91
    assert x25(b"") == 0xFFFF


def test_the_version_of_the_protocol_which_pymavlink_lacks():
    # CRC_EXTRA and length are those of the protocol's C library, mavlink_msg_protocol_version.h.
    layout = LAYOUTS["PROTOCOL_VERSION"]
    assert (layout.number, layout.extra, layout.least) == (300, 217, 22)
    assert layout.payload(version=200, min_version=100, max_version=200) == b"\xc8\0d\0\xc8\0" + bytes(16)


@pytest.mark.parametrize("name", sorted(set(LAYOUTS) - {"PROTOCOL_VERSION"}))
def test_every_message_is_that_of_pymavlink(name):
    layout = LAYOUTS[name]
    dialects = (common, ardupilotmega, development)
    dialect = next(one for one in dialects if hasattr(one, f"MAVLink_{name.lower()}_message"))
    theirs = getattr(dialect, f"MAVLink_{name.lower()}_message")
    assert (layout.number, layout.extra) == (theirs.id, theirs.crc_extra)
    assert [field.name for field in layout.fields] == theirs.ordered_fieldnames
    draw = random.Random(name)
    for full in (True, False):
        values = {field.name: value_of(field, draw) for field in layout.fields} if full else {}
        sender = dialect.MAVLink(None, srcSystem=17, srcComponent=1)
        sender.seq = 200
        everything = {
            field.name: values.get(field.name, b"" if field.type == "c" else [0] * field.count if field.count else 0)
            for field in layout.fields
        }
        bytes_of_theirs = theirs(**everything).pack(sender)
        assert frame(layout.number, layout.payload(**values), 200, 17) == bytes_of_theirs
        (read,) = Reader().feed(bytes_of_theirs)
        found = read.message()
        assert (read.system, read.component, read.sequence) == (17, 1, 200)
        for field in layout.fields:
            wanted = everything[field.name]
            if field.type == "f":
                count = field.count or 1
                wanted = struct.unpack(f"<{count}f", struct.pack(f"<{count}f", *(wanted if field.count else [wanted])))
                wanted = wanted if field.count else wanted[0]
            elif field.type == "c":
                wanted = wanted.rstrip(b"\0")
            assert getattr(found, field.name) == (tuple(wanted) if field.count and field.type != "c" else wanted)


def test_version_1_and_a_stream_in_pieces():
    from pymavlink.dialects.v10 import common as old

    first = old.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(old.MAVLink(None, 255, 190))
    second = frame(0, LAYOUTS["HEARTBEAT"].payload(custom_mode=7), 1, 3)
    reader = Reader()
    found = [read for byte in b"\x00junk" + first + second for read in reader.feed(bytes([byte]))]
    assert [(read.version, read.system) for read in found] == [(1, 255), (2, 3)]
    assert found[0].message().type == 6
    assert reader.skipped == 5


def test_a_signed_frame_is_read():
    whole = frame(0, LAYOUTS["HEARTBEAT"].payload(custom_mode=7), 1, 3)
    signed = bytearray(whole[:-2])
    signed[2] = 1
    check = x25(bytes(signed[1:]) + bytes([LAYOUTS["HEARTBEAT"].extra]))
    data = bytes(signed) + struct.pack("<H", check) + bytes(13)
    reader = Reader()
    assert [read.message().custom_mode for read in reader.feed(data + whole)] == [7, 7]


def test_whatever_is_changed_in_a_frame_is_noticed():
    whole = frame(30, LAYOUTS["ATTITUDE"].payload(roll=0.1, yaw=2.0, yawspeed=1.0), 9, 3)
    for at in range(len(whole)):
        for change in (0x01, 0x80):
            harmed = bytearray(whole)
            harmed[at] ^= change
            assert list(Reader().datagram(bytes(harmed))) == []


def test_an_unknown_message_hides_no_other_one():
    theirs = common.MAVLink_scaled_imu3_message(1, 253, 254, 253, 0, 0, 0, 0, 0, 0).pack(common.MAVLink(None, 9, 1))
    assert 129 not in BY_NUMBER
    beat = frame(0, LAYOUTS["HEARTBEAT"].payload(custom_mode=7), 1, 3)
    assert [read.layout.name for read in Reader().datagram(theirs + beat)] == ["HEARTBEAT"]


def test_wrong_fields_are_refused():
    with pytest.raises(ValueError, match="HEARTBEAT has no field mode"):
        LAYOUTS["HEARTBEAT"].payload(mode=3)
    with pytest.raises(AttributeError, match="HEARTBEAT has no field 'mode'"):
        _ = LAYOUTS["HEARTBEAT"].message(b"").mode
