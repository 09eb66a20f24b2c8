"""One world for several clients: what is wrong gets one reply, and disturbs nobody."""

from __future__ import annotations

import random
from typing import Any

import pytest
from shared_worlds import A, B, alone, goal
from tests.wrong_input import requests as wrong
from wires import Wire, step

from qrsim.errors import UsageError
from qrsim.links.reference.client import Refused
from qrsim.links.reference.protocol import qrsim_pb2 as pb
from qrsim.links.reference.protocol.framing import frame
from qrsim.links.reference.protocol.qrsim_pb2 import Message, Step

NAMED = pb.Order(vehicle=A, type=Step.WP, cmd=pb.Arrayd(value=[0.0, 0.0, -10.0, 0.0]))


def claim(*names: str, **others: Any) -> Message:
    return Message(type=Message.CLAIM, claim=pb.Claim(vehicle=names, **others))


def command(*orders: pb.Order, **others: Any) -> Message:
    return Message(type=Message.COMMAND, command=pb.Command(order=orders, **others))


@pytest.mark.parametrize(
    ("message", "said"),
    [
        (claim("vehicle_0"), "CLAIM: no vehicle is called 'vehicle_0'; did you mean 'vehicles_0'?"),
        (claim(B), "CLAIM: 'vehicles_1' is flown by client"),
        (claim(A, on_silence="retrun"), "CLAIM: on_silence 'retrun': expected hold or return or stop; did"),
        (claim(A, hold=-1.0), "hold -1 s"),
        (Message(type=Message.RELEASE, release=pb.Release(vehicle=[B])), "RELEASE: 'vehicles_1' is flown by client"),
        (command(NAMED), "COMMAND: 'vehicles_0' is not claimed; CLAIM it first"),
        (command(pb.Order(vehicle=B, type=Step.WP, cmd=NAMED.cmd)), "COMMAND: 'vehicles_1' is flown by client"),
        (command(NAMED, NAMED), "COMMAND: 'vehicles_0' is given 2 orders"),
        (command(until_tick=5), "this client has claimed no vehicle"),
        (command(ticks=0), "COMMAND: ticks 0; allowed: from 1"),
        (Message(type=Message.SUBSCRIBE, subscribe=pb.Subscribe(vehicle=["x"])), "no vehicle is called 'x'"),
        (Message(type=Message.SUBSCRIBE, subscribe=pb.Subscribe(rate=0.0)), "SUBSCRIBE: rate 0 Hz"),
        (step(), "STEP: this server's world is shared by its clients"),
        (Message(type=Message.RESET, reset=pb.Reset(value=True)), "RESET: this server's world is shared"),
        (Message(type=Message.SETSTATE), "SETSTATE: this server's world is shared"),
        (Message(type=Message.OPEN), "OPEN: this server's world is shared"),
        (Message(type=Message.RESTART), "RESTART: client "),
        (Message(type=Message.PACE, pace=pb.Pace(factor=2.0)), "PACE: client "),
        (Message(type=Message.SENSED), "SENSED is not a request"),
    ],
)
def test_a_wrong_request_gets_one_reply_and_disturbs_nobody(message, said, barrier):
    server, connect = barrier
    other = connect()
    with alone(other):
        other.claim(B)
        with Wire(server.port) as wire:
            assert said in wire.refused(message)
            # It has claimed nothing by it, so nobody waits for it.
            assert other.advance({B: ("waypoint", goal(1, 0))}).tick == 1
            assert wire.ask(Message(type=Message.HELLO, hello=pb.Hello())).type == Message.SERVER
    other.close()


def test_what_is_wrong_at_the_barrier_alone(barrier):
    _, connect = barrier
    one = connect()
    with alone(one):
        one.claim(A)
        one.advance(until_tick=3)
        with pytest.raises(Refused, match="until_tick 3: the world is at tick 3 already"):
            one.advance(until_tick=3)
        with pytest.raises(Refused, match="until_tick 9999999999 is 9999999996 ticks away"):
            one.advance(until_tick=9999999999)
        with pytest.raises(UsageError, match="not both"):
            one.advance(until_tick=5, ticks=1)
        with pytest.raises(UsageError, match="no order is of kind 'waypont'"):
            one.advance({A: ("waypont", goal(0, 0))})
        with pytest.raises(UsageError, match=r"order of 'vehicles_0': expected \(kind, numbers\)"):
            one.advance({A: goal(0, 0)})


@pytest.mark.parametrize("kind", ["CLAIM", "RELEASE", "COMMAND", "SUBSCRIBE", "GET_STATUS"])
def test_other_servers_say_that_their_worlds_have_owners(kind, wire):
    message = Message(type=Message.Type.Value(kind))
    assert wire.refused(message).startswith(f"{kind}: this server's worlds are flown by one client each")


def test_malformed_requests_get_one_reply_each_and_disturb_nobody(free):
    """500 requests with bits flipped, bytes put in or cut off, on connections of 20; what was unexpected fails here."""
    _, connect = free
    # As long as the name of a vehicle here, so that orders for it are among them.
    requests = [content.replace(b"pelicans_0", b"vehicles_0") for content in wrong.valid()]
    chance = random.Random(20261122)
    other = connect()
    other.claim(B)
    for _ in range(25):
        with Wire(free[0].port) as wire:
            for _ in range(20):
                payload = wrong.mutated(chance, requests)
                wire.socket.sendall(frame(payload))
                reply = wire.receive()
                while reply.type == Message.SENSED:
                    reply = wire.receive()
                if wrong.kind(payload) in (Message.INIT, Message.DISCONNECT) and reply.type == Message.ACK:
                    break
        assert other.command({B: ("waypoint", goal(1, 0))}) > 0
    other.disconnect()
