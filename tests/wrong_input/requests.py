"""Requests to a server: one of each kind, and mutations of them."""

from __future__ import annotations

import random
from contextlib import suppress

from google.protobuf.message import DecodeError

from qrsim.links.reference.protocol import qrsim_pb2 as pb
from qrsim.links.reference.protocol.qrsim_pb2 import Message, Step

TASK, PLAYED = "free_flight", "keep_spot"


def valid() -> list[bytes]:
    """Return a request of each kind."""
    place = pb.Arrayd(value=[6.0, -8.0, -9.0, 0.0])
    step = Step(dt=0.02, type=Step.WP, cmd=[place])
    order = pb.Order(vehicle="pelicans_0", type=Step.WP, cmd=place)
    messages = [
        Message(type=Message.INIT, init=pb.Init(task=TASK)),
        Message(type=Message.STEP, step=step),
        Message(type=Message.RESET, reset=pb.Reset(value=True)),
        Message(type=Message.SETSTATE, setsState=pb.SetState(X=[pb.Arrayd(value=[6.0, -8.0, -9.0])])),
        Message(type=Message.HELLO, hello=pb.Hello()),
        Message(type=Message.OPEN, open=pb.Open(scenario="name: x\nfleets: {}")),
        Message(type=Message.RESTART, restart=pb.Restart(seed=3)),
        Message(type=Message.GET_READINGS, get_readings=pb.GetReadings()),
        Message(type=Message.WATCH, watch=pb.Watch(stop=True)),
        Message(type=Message.PACE, pace=pb.Pace()),
        Message(type=Message.PLAY, play=pb.Play(task=PLAYED)),
        Message(type=Message.DESCRIBE, describe=pb.Describe()),
        Message(type=Message.CLAIM, claim=pb.Claim(vehicle=["pelicans_0"], on_silence="hold", hold=1.0)),
        Message(type=Message.COMMAND, command=pb.Command(order=[order], computed_from=1)),
        Message(type=Message.SUBSCRIBE, subscribe=pb.Subscribe(rate=10.0)),
        Message(type=Message.GET_STATUS, get_status=pb.GetStatus()),
        Message(type=Message.RELEASE, release=pb.Release()),
        Message(type=Message.ACT, act=pb.Act(action=[pb.Arrayd(value=[0.0, 0.0, 0.2, 0.0, 1.0])])),
        Message(type=Message.SAY, say=pb.Say(words=[pb.Say.Words(vehicle="pelicans_0", value=[1.0], to="x")])),
    ]
    return [message.SerializeToString() for message in messages]


def mutated(chance: random.Random, requests: list[bytes]) -> bytes:
    """Return a request with bits flipped, bytes put in, or its end cut off; sometimes plain noise."""
    if chance.random() < 0.1:
        return chance.randbytes(chance.randrange(64))
    content = bytearray(chance.choice(requests))
    for _ in range(chance.randint(1, 3)):
        at = chance.randrange(len(content)) if content else 0
        kind = chance.randrange(3)
        if kind == 0 and content:
            content[at] ^= 1 << chance.randrange(8)
        elif kind == 1:
            content[at:at] = chance.randbytes(chance.randint(1, 8))
        else:
            del content[at:]
    return bytes(content)


def kind(payload: bytes) -> int:
    """Return the type of a request, as far as it can be read."""
    message = Message()
    with suppress(DecodeError):
        message.ParseFromString(payload)
    return message.type
