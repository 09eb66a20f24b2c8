"""What goes wrong on a connection: one reply to each request, and nobody else is disturbed."""

from __future__ import annotations

import contextlib
import math
import socket
import struct
import time

import pytest
from hypothesis import HealthCheck, given, seed, settings
from hypothesis import strategies as st
from wires import DISCONNECT, HELLO, HERE, QUIT, RESET, TASK, Wire, running, step

from qrsim.links.reference.protocol import qrsim_pb2 as pb
from qrsim.links.reference.protocol.framing import LARGEST_REQUEST, frame
from qrsim.links.reference.protocol.qrsim_pb2 import Message, Step

OUTSIDE = [500.0, 0.0, -9.0]


def init(task: str) -> Message:
    return Message(type=Message.INIT, init=pb.Init(task=task))


def set_state(*rows: list[float]) -> Message:
    return Message(type=Message.SETSTATE, setsState=pb.SetState(X=[pb.Arrayd(value=row) for row in rows]))


@pytest.mark.parametrize(
    ("task", "said"),
    [
        ("keep_spott", "no task is called 'keep_spott'; did you mean 'keep_spot'?"),
        ("TaskGoToWP", "did you mean 'TaskGotoWP'?"),
        ("TaskPlumeSingleSource", "no task is called 'TaskPlumeSingleSource'; did you mean 'TaskPlumeSingleSource"),
        ("/etc/passwd", "no task is called '/etc/passwd'"),
        ("../keep_spot.yaml", "no task is called"),
        ("", "no task is called ''"),
        ("x" * 100_000, "no task is called 'xxx"),
    ],
)
def test_an_unknown_task_gets_one_ack_and_the_connection_is_closed(task, said, wire):
    assert said in wire.refused(init(task))
    assert wire.closed()


@pytest.mark.parametrize(
    ("message", "said"),
    [
        (step(dt=0.03), "dt: 0.03 s is not a positive multiple of the time step, 0.02 s"),
        (step(dt=0.0), "dt: 0 s is not a positive multiple"),
        (step(dt=-0.02), "dt: -0.02 s is not a positive multiple"),
        (step(dt=math.nan), "dt: nan s"),
        (step(dt=math.inf), "dt: inf s"),
        (step(dt=1e300), "time steps; allowed: up to 1000000 in one STEP"),
        (step(dt=20_000.02), "is 1000001 time steps; allowed: up to 1000000"),
        (step(Step.WP, [*HERE, 0.0], [*HERE, 0.0]), "cmd: 2 vectors; expected 1, one for each vehicle"),
        (Message(type=Message.STEP, step=Step(dt=0.02, type=Step.WP)), "cmd: 0 vectors; expected 1"),
        (step(Step.WP, HERE), "cmd of vehicle 0 ('pelicans_0'): 3 numbers; expected 4"),
        (step(Step.WP, []), "0 numbers; expected 4"),
        (step(Step.CTRL, [0.0] * 4), "4 numbers; expected 5"),
        (step(Step.VEL, [0.0] * 13), "13 numbers; expected 3"),
        (step(Step.WP, [math.nan, 0.0, 0.0, 0.0]), "position_ned.x of vehicle 0 ('pelicans_0') is not finite"),
        (step(Step.VEL, [0.0, math.inf, 0.0]), "velocity_ned.y of vehicle 0 ('pelicans_0') is not finite"),
        (step(Step.CTRL, [0.0, 0.0, 0.6, 0.0, 12.5]), "battery of vehicle 0 ('pelicans_0') is 12.5; allowed: 9 to 12"),
        (step(Step.CTRL, [math.nan, 0.0, 0.6, 0.0, 12.0]), "pitch of vehicle 0 ('pelicans_0') is nan"),
        (Message(type=Message.STEP), "STEP: the message has no 'step'"),
        (Message(type=Message.RESET), "RESET: the message has no 'reset'"),
        (Message(type=Message.DISCONNECT), "DISCONNECT: the message has no 'disconnect'"),
        (Message(type=Message.SETSTATE), "X: 0 vectors; expected 1"),
        (set_state([0.0] * 7), "X of vehicle 0 ('pelicans_0'): 7 numbers; expected 3 or 6 or 12 or 13"),
        (set_state([math.nan] * 6), "X of vehicle 0 ('pelicans_0') is not finite"),
        (set_state(OUTSIDE), "vehicle 0 ('pelicans_0') would be invalid"),
        (set_state(HERE, HERE), "X: 2 vectors; expected 1"),
        (Message(type=Message.NONE), "NONE is not a request"),
        (Message(type=Message.STATE), "STATE is not a request"),
        (Message(type=Message.SESSION), "SESSION is not a request"),
    ],
)
def test_a_wrong_request_gets_one_ack_and_changes_nothing(message, said, connect):
    """All on the same session: what is refused leaves it as it was."""
    wire = connect()
    wire.init()
    assert said in wire.refused(message)
    assert wire.ask(step()).state.t == pytest.approx(0.02)


@pytest.mark.parametrize(
    ("payload", "said"),
    [
        (b"", "a required field is missing"),
        (b"\x08\x32", "a kind is unknown"),
        (b"\x0a", "1 bytes that are no Message"),
        (b"\xff" * 40, "40 bytes that are no Message"),
        (b"\x08\x05\x32\x00", "a required field is missing"),
        (b"\x08\x05\x32\x0b\x09\x00\x00\x00\x00\x00\x00\x00\x00\x10\x09", "a kind is unknown"),
        (b"\x08\x66\xb2\x06\x04\x0a\x02\xff\xfe", "a text is not UTF-8"),
    ],
)
def test_bytes_that_are_no_request_get_one_ack_and_the_connection_goes_on(payload, said, wire):
    assert said in wire.refused(frame(payload))
    assert wire.ask(HELLO).type == Message.SERVER


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"GET / HTTP/1.1\r\n\r\n", "starts with 0x47; expected 0x0D"),
        (b"\x0d\xff\xff\xff\xff", f"a message of 4294967295 bytes; allowed: up to {LARGEST_REQUEST}"),
        (b"\x0d" + struct.pack("<I", LARGEST_REQUEST + 1) + bytes(100), f"{LARGEST_REQUEST + 1} bytes; allowed"),
    ],
)
def test_after_a_broken_frame_there_is_one_ack_and_the_end(content, said, wire):
    assert said in wire.refused(content + bytes(1000))
    assert wire.closed()


@pytest.mark.parametrize("message", [step(), RESET, set_state(HERE)])
def test_requests_before_init_are_refused_and_the_connection_goes_on(message, wire):
    assert wire.refused(message) == "there is no session on this connection: send INIT first"
    wire.init()


@pytest.mark.parametrize("payload", [b"\x08\x01", b"\x08\x01\x12\x00", b"\x08\x01\x12\x04\x0a\x02\xff\xfe"])
def test_an_init_that_is_wrong_in_itself_is_the_end_too(payload, wire):
    wire.refused(frame(payload))
    assert wire.closed()


def test_a_second_client_is_told_and_the_first_goes_on(connect):
    first, second = connect(), connect()
    first.init()
    assert "another client controls this server's simulation" in second.refused(init(TASK))
    assert second.closed()
    assert first.ask(step()).state.t == pytest.approx(0.02)


def test_init_again_starts_again(connect):
    wire = connect()
    wire.init()
    wire.ask(step())
    assert wire.init().state.t == 0.0


def test_quit_on_a_fresh_connection_without_permission_is_acknowledged_and_disturbs_nobody(connect):
    first, second = connect(), connect()
    first.init()
    reply = second.ask(QUIT)
    assert reply.type == Message.ACK
    assert not reply.ack.error
    assert "--allow-quit" in reply.ack.msg
    assert second.closed()
    assert first.ask(step()).state.t == pytest.approx(0.02)


def test_after_an_invalid_state_every_step_says_so_until_reset(wire):
    wire.init()
    # Out of the ceiling at 20 m; it is noticed at the end of the STEP, and a stopped vehicle stays so.
    climb = step(Step.VEL, [0.0, 0.0, -3.0], dt=8.0)
    for _ in range(2):
        assert wire.refused(climb) == "invalid uav state"
    assert wire.ask(RESET).ack.error is False
    assert wire.ask(step()).state.t == pytest.approx(0.02)


def test_a_session_that_asked_for_reasons_gets_them(wire):
    assert wire.ask(HELLO).type == Message.SERVER
    state = wire.init().state
    assert list(state.reason) == [""]
    state = wire.ask(step(Step.VEL, [0.0, 0.0, -3.0], dt=8.0)).state
    assert len(state.reason) == 1
    assert "z" in state.reason[0]
    assert math.isnan(state.eX[0].value[0])
    assert math.isfinite(state.X[0].value[2])
    assert state.t == pytest.approx(8.0)


@pytest.mark.parametrize("how", ["killed", "closed", "half a message"])
def test_a_client_that_vanishes_makes_room_for_the_next(how, connect):
    first, second = connect(), connect()
    first.init()
    first.ask(step(dt=20.0))
    if how == "half a message":
        first.socket.sendall(frame(step().SerializeToString())[:20])
    else:
        first.send(step(dt=20_000.0))
        time.sleep(0.05)
    if how == "killed":  # with a reset, as when a process dies with unread data
        first.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    first.socket.close()
    assert second.init().state.t == 0.0


def test_who_closes_his_half_gets_the_answers_to_what_he_has_asked(wire):
    wire.init()
    wire.send(step(), step(), RESET)
    wire.socket.shutdown(socket.SHUT_WR)
    assert [wire.receive().type for _ in range(3)] == [Message.STATE, Message.STATE, Message.ACK]
    assert wire.closed()


def test_half_a_message_keeps_nobody_waiting(connect):
    stalled, other = connect(), connect()
    stalled.socket.sendall(b"\x0d\x10\x00")
    other.init()
    assert other.ask(step()).type == Message.STATE
    stalled.socket.sendall(b"\x00\x00" + bytes(16))
    assert stalled.receive().ack.error


def test_a_hundred_connections_at_once(connect):
    wires = [connect() for _ in range(100)]
    for wire in wires:
        wire.send(HELLO)
    assert {wire.receive().type for wire in wires} == {Message.SERVER}


def is_served(wire: Wire) -> bool:
    """Return whether a greeting is answered by a server with room for one more client."""
    with contextlib.suppress(ConnectionError):
        return bool(wire.ask(HELLO).type == Message.SERVER)
    return False


def test_one_client_more_than_allowed_is_told_so():
    with running(max_clients=2) as served, contextlib.ExitStack() as stack:
        wires = [stack.enter_context(Wire(served.port)) for _ in range(3)]
        assert "the server has 2 clients" in wires[2].receive().ack.msg
        assert wires[2].closed()
        wires[0].socket.close()
        # The server notices soon that one has gone.
        end = time.monotonic() + 20.0
        while not is_served(stack.enter_context(Wire(served.port))):
            assert time.monotonic() < end
            time.sleep(0.05)


def test_who_sends_and_does_not_read_gets_all_replies_later(connect):
    """The server stops to read rather than to pile up replies; other connections notice nothing."""
    wire, other = connect(), connect()
    wire.init()
    count = 3000
    wire.socket.settimeout(0.2)
    content = frame(step().SerializeToString()) * count
    sent = 0
    with contextlib.suppress(TimeoutError):
        while sent < len(content):
            sent += wire.socket.send(content[sent : sent + 65536])
    assert other.ask(HELLO).type == Message.SERVER
    wire.socket.settimeout(60.0)
    complete = sent // len(content[: len(content) // count])
    for i in range(complete):
        assert wire.receive().state.t == pytest.approx(0.02 * (i + 1))


# ---- fuzz ----

VALID = [
    message.SerializeToString()
    for message in (
        step(), step(Step.VEL, [0.0, 0.0, 0.0], dt=0.1), step(Step.CTRL, [0.0, 0.0, 0.59, 0.0, 12.0]), RESET, HELLO,
        set_state(HERE), init(TASK), Message(type=Message.WATCH, watch=pb.Watch(period=0.1)),
        Message(type=Message.PACE, pace=pb.Pace()), Message(type=Message.GET_READINGS),
        Message(type=Message.RESTART, restart=pb.Restart(seed=3)), Message(type=Message.GET_EVENTS),
        Message(type=Message.OPEN, open=pb.Open(scenario="name: x\nfleets: {}")),
        Message(type=Message.PLAY, play=pb.Play(task="keep_spot")),
        Message(type=Message.ACT, act=pb.Act(action=[pb.Arrayd(value=[0.0, 0.0, 0.2, 0.0, 1.0])])),
    )
]  # fmt: skip


@st.composite
def mutated(draw: st.DrawFn) -> bytes:
    """Return a request with some of its bytes changed, cut off, or repeated."""
    content = bytearray(draw(st.sampled_from(VALID)))
    for _ in range(draw(st.integers(1, 3))):
        at = draw(st.integers(0, len(content) - 1)) if content else 0
        kind = draw(st.sampled_from(["flip", "cut", "insert", "repeat"]))
        if kind == "flip" and content:
            content[at] ^= 1 << draw(st.integers(0, 7))
        elif kind == "cut":
            del content[at:]
        elif kind == "insert":
            content[at:at] = draw(st.binary(max_size=8))
        else:
            content += content[at:]
    return bytes(content)


REPLIES = {Message.STATE, Message.TASKINFO, Message.ACK, Message.SERVER, Message.SESSION, Message.READINGS,
           Message.EVENTS, Message.PACING, Message.EPISODE, Message.OUTCOME}  # fmt: skip


@seed(7)
@settings(max_examples=100, deadline=None, database=None, suppress_health_check=list(HealthCheck))
@given(payloads=st.lists(st.one_of(mutated(), st.binary(max_size=60)), min_size=20, max_size=20), started=st.booleans())
@pytest.mark.long
def test_two_thousand_malformed_requests(payloads, started, serving):
    """One reply to each, or the connection ends in order; the server serves on."""
    with Wire(serving.port) as wire, Wire(serving.port) as other:
        if started:
            wire.init()
        with contextlib.suppress(EOFError, ConnectionError):
            for payload in payloads:
                wire.socket.sendall(frame(payload))
                reply = wire.receive()
                assert reply.type in REPLIES
                if payload[:2] == b"\x08\x01" and reply.type == Message.STATE:
                    assert wire.receive().type == Message.TASKINFO
        assert other.ask(HELLO).type == Message.SERVER


@pytest.mark.long
@seed(8)
@settings(max_examples=50, deadline=None, database=None, suppress_health_check=list(HealthCheck))
@given(content=st.binary(min_size=1, max_size=200), shut=st.booleans())
def test_any_bytes(content, shut, serving):
    """Whatever comes, the connection ends when the client ends it, and the next one is served."""
    with Wire(serving.port) as wire, contextlib.suppress(ConnectionError):
        wire.socket.sendall(content)
        if shut:
            wire.socket.shutdown(socket.SHUT_WR)
            while wire.socket.recv(4096):
                pass
    with Wire(serving.port) as other:
        assert other.ask(DISCONNECT).type == Message.ACK
