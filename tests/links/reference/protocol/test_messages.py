"""The numbers and kinds of the reference's fields, as bytes written by hand; and what is generated is up to date."""

from __future__ import annotations

import struct
import subprocess
import sys
from pathlib import Path

import pytest
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto

from qrsim.links.reference.protocol import qrsim_pb2 as pb
from qrsim.links.reference.protocol.qrsim_pb2 import Message, Step

ROOT = Path(__file__).resolve().parents[4]
HALF = struct.pack("<d", 0.5)


def nested(tag: int, content: bytes) -> bytes:
    return bytes([tag, len(content)]) + content


VECTOR = nested(0x0A, HALF)
REFERENCE = {
    "init": (
        Message(type=Message.INIT, init=pb.Init(task="T", realTime=True)),
        b"\x08\x01" + nested(0x12, b"\x0a\x01T\x10\x01"),
    ),
    "reset": (Message(type=Message.RESET, reset=pb.Reset(value=True)), b"\x08\x02\x1a\x02\x08\x01"),
    "disconnect": (
        Message(type=Message.DISCONNECT, disconnect=pb.Disconnect(quit=False)),
        b"\x08\x03\x22\x02\x08\x00",
    ),
    "set_state": (
        Message(type=Message.SETSTATE, setsState=pb.SetState(X=[pb.Arrayd(value=[0.5])])),
        b"\x08\x04" + nested(0x2A, nested(0x12, VECTOR)),
    ),
    "step": (
        Message(type=Message.STEP, step=Step(dt=0.5, type=Step.VEL, cmd=[pb.Arrayd(value=[0.5])])),
        b"\x08\x05" + nested(0x32, b"\x09" + HALF + b"\x10\x03" + nested(0x1A, VECTOR)),
    ),
    "state": (
        Message(type=Message.STATE, state=pb.State(t=0.5, X=[pb.Arrayd(value=[0.5])], eX=[pb.Arrayd(value=[0.5])])),
        b"\x08\x06" + nested(0x3A, b"\x09" + HALF + nested(0x12, VECTOR) + nested(0x1A, VECTOR)),
    ),
    "task_info": (
        Message(type=Message.TASKINFO, taskInfo=pb.TaskInfo(timestep=0.5, numUAVs=3)),
        b"\x08\x07" + nested(0x42, b"\x09" + HALF + b"\x10\x03"),
    ),
    "ack": (
        Message(type=Message.ACK, ack=pb.Ack(error=True, msg="no")),
        b"\x08\x08" + nested(0x4A, b"\x08\x01\x12\x02no"),
    ),
    "none": (Message(type=Message.NONE), b"\x08\x00"),
    "size": (pb.Size(value=258), b"\x0d\x02\x01\x00\x00"),
}


@pytest.mark.parametrize("name", REFERENCE)
def test_messages_of_the_reference_are_these_bytes(name):
    message, content = REFERENCE[name]
    assert message.SerializeToString() == content
    assert type(message).FromString(content) == message


def test_kinds_of_steps_and_required_fields_are_those_of_the_reference():
    assert {name: number for name, number in Step.Type.items() if number < 100} == {"WP": 1, "CTRL": 2, "VEL": 3}
    file = FileDescriptorProto()
    pb.DESCRIPTOR.CopyToProto(file)
    labels = {f"{message.name}.{field.name}": field.label for message in file.message_type for field in message.field}
    required = {name for name, label in labels.items() if label == FieldDescriptorProto.LABEL_REQUIRED}
    own = {"Server", "Session", "Event", "Events", "Pacing", "Readings", "Values", "Episode", "Outcome"}
    own |= {"Claimed", "Order", "Commanded", "Status", "World", "Inject"}
    assert {name for name in required if name.partition(".")[0] not in own} == {
        "Size.value",
        "Init.task",
        "Reset.value",
        "Disconnect.quit",
        "Step.dt",
        "Step.type",
        "State.t",
        "Ack.error",
        "Message.type",
    }


def test_extensions_have_numbers_above_those_of_the_reference():
    types = dict(Message.Type.items())
    assert sorted(number for number in types.values() if number < 100) == list(range(9))
    for field in Message.DESCRIPTOR.fields:
        if field.number >= 100:
            assert types[field.name.upper()] == field.number, "a type and its field share their number"


def test_what_is_generated_is_what_make_proto_makes(tmp_path):
    pytest.importorskip("grpc_tools", reason="grpcio-tools is not installed: make tools")
    folder = "qrsim/links/reference/protocol"
    words = ["-m", "grpc_tools.protoc", f"--proto_path={ROOT / 'src'}", f"--python_out={tmp_path}"]
    subprocess.run([sys.executable, *words, f"--pyi_out={tmp_path}", f"{folder}/qrsim.proto"], check=True)
    for name in ("qrsim_pb2.py", "qrsim_pb2.pyi"):
        assert (tmp_path / folder / name).read_text("utf-8") == (ROOT / "src" / folder / name).read_text("utf-8")
