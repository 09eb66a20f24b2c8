"""A connection of PX4, by a socket at its other end that sends what it is told."""

from __future__ import annotations

import math
import socket
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from px4_stand_in import free_ports
from pymavlink.dialects.v20 import common

from qrsim.errors import RunError, UsageError
from qrsim.links.autopilot import px4_link
from qrsim.links.autopilot.px4_link import Px4Link


class Wire:
    """A link, and the socket of somebody at its other end."""

    def __init__(self, **options: Any):
        self.said: list[str] = []
        self.port = free_ports(1)
        self.link = Px4Link("quad", 2, self.port, "127.0.0.1", options.get("wait", 5.0), self.said.append)
        self.peer = socket.create_connection(("127.0.0.1", self.port))
        self.link.connect(time.perf_counter() + 5.0)
        self.mav = common.MAVLink(None, srcSystem=options.get("system", 3), srcComponent=1)

    def answer(self, stamp: int, outputs: Sequence[float] = (0.5,) * 16, mode: int = 129, flags: int = 1) -> None:
        self.peer.sendall(self.mav.hil_actuator_controls_encode(stamp, outputs, mode, flags).pack(self.mav))

    def settle(self, stamp: int) -> list[float]:
        self.link.send(b"", stamp)
        self.link.settle(time.perf_counter(), True)
        return self.link.speeds(4)

    def settle_all(self, stamps: range) -> None:
        for stamp in stamps:
            self.settle(stamp)


@pytest.fixture
def wire() -> Iterator[Wire]:
    found = Wire()
    yield found
    found.peer.close()
    found.link.close()


def test_an_answer_to_an_older_frame_holds_but_is_not_waited_with(wire: Wire, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(px4_link, "ANSWER_S", 0.05)
    wire.answer(1000)
    assert wire.settle(1000) == [0.5] * 4
    wire.answer(1000, (0.25,) * 16)
    assert wire.settle(2000) == [0.25] * 4
    assert wire.link.unanswered == 1
    # A time that was never sent is somebody else's.
    wire.answer(2**60, (1.0,) * 16)
    assert wire.settle(3000) == [0.25] * 4
    assert (wire.link.unanswered, wire.link.foreign) == (2, 1)
    monkeypatch.setattr(px4_link, "SILENCE_S", 0.1)
    with pytest.raises(RunError, match=r"quad: its PX4 has not answered for 0\.1 s"):
        wire.settle_all(range(4000, 9000, 1000))


def test_a_px4_that_answers_every_second_frame_is_not_waited_for_long(
    wire: Wire, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(px4_link, "ANSWER_S", 0.1)
    begin = time.perf_counter()
    said_at = []
    for stamp in range(1000, 41_000, 1000):
        if stamp % 2000:
            wire.answer(stamp)
        wire.settle(stamp)
        if any("leaves many frames unanswered; each is waited for 20 ms" in line for line in wire.said):
            said_at.append(stamp)
    # Six gaps, at frames 3, 5, ... 13, each 3 % less per answer: 1, 1.97, 2.91, 3.82, 4.71, 5.57.
    assert said_at[0] == 14_000
    assert sum("leaves many frames" in line for line in wire.said) == 1
    # Six of 0.1 s and 14 of 0.02 s; without that it were 2 s.
    assert time.perf_counter() - begin < 1.99
    assert wire.link.unanswered == 20


def test_odd_outputs_are_clamped_and_said_once(wire: Wire) -> None:
    for stamp in (1000, 2000):
        wire.answer(stamp, (math.nan, 2.0, -3.0, 0.5, *[0.0] * 12))
        assert wire.settle(stamp) == [0.0, 1.0, 0.0, 0.5]
    assert wire.link.odd == 6
    assert [line for line in wire.said if "not within -1 to 1" in line] == [
        "quad: an output of PX4 is not within -1 to 1; it is clamped, and 0 where it is not a number"
    ]
    wire.answer(3000, mode=1)
    assert wire.settle(3000) == [0.0] * 4


def test_a_wrong_system_is_said_with_both_numbers() -> None:
    found = Wire(system=9)
    found.answer(1000)
    found.settle(1000)
    assert "quad: PX4 has MAV_SYS_ID 9, and instance 2 should have 3" in found.said
    found.link.close()


def test_a_build_without_lock_step_is_not_waited_for(wire: Wire, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(px4_link, "ANSWER_S", 10.0)
    wire.answer(77, flags=0)
    for stamp in range(1000, 20_000, 1000):
        begin = time.perf_counter()
        assert wire.settle(stamp) == [0.5] * 4
        assert 0.004 <= time.perf_counter() - begin < 9.0
    assert wire.link.unanswered == 0
    assert "is built without lock-step" in wire.said[-1]


def test_a_second_connection_is_closed_and_said_once(wire: Wire, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(px4_link, "_LOOK_S", 0.0)
    for stamp in (1000, 2000, 3000):
        with socket.create_connection(("127.0.0.1", wire.port)) as other:
            other.settimeout(5.0)
            wire.answer(stamp)
            assert wire.settle(stamp) == [0.5] * 4
            assert other.recv(1) == b""
    assert sum("a second connection" in line for line in wire.said) == 1


def test_what_is_no_mavlink_is_hung_up_on(wire: Wire) -> None:
    wire.peer.sendall(b"GET / HTTP/1.1\r\n" * 4200)
    wire.settle_all(range(1000, 6000, 1000))
    assert wire.said == ["quad: not a PX4: 64 kB without a MAVLink frame; its motors stop"]
    assert not wire.link.connected


def test_mavlink_without_heartbeat_and_controls_is_no_px4() -> None:
    found = Wire(wait=0.1)
    found.peer.sendall(found.mav.ping_encode(1, 2, 0, 0).pack(found.mav))
    with pytest.raises(RunError, match=r"is not a PX4: neither HEARTBEAT nor HIL_ACTUATOR_CONTROLS has come in 0\.1 s"):
        found.settle_all(range(1000, 90_000, 1000))
    found.link.close()


def test_a_peer_that_never_pauses_holds_up_no_frame(wire: Wire, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(px4_link, "ANSWER_S", 0.05)
    # More than one read takes, at every frame.
    beats = wire.mav.heartbeat_encode(2, 12, 0, 0, 0).pack(wire.mav) * 4000
    stop = threading.Event()

    def flood() -> None:
        with suppress(OSError):
            while not stop.is_set():
                wire.peer.sendall(beats)

    sender = threading.Thread(target=flood, daemon=True)
    sender.start()
    begin = time.perf_counter()
    wire.settle(1000)
    wire.link.booted = True
    wire.settle(2000)
    stop.set()
    assert time.perf_counter() - begin < 2.0
    assert wire.link.unanswered == 1
    wire.link.close()
    sender.join(5.0)


def test_a_port_that_is_taken_is_said(wire: Wire) -> None:
    with pytest.raises(UsageError, match=rf"TCP port {wire.port} for b is taken by another simulator or qrsim"):
        Px4Link("b", 0, wire.port, "127.0.0.1", 1.0, lambda line: None)


def test_the_page_names_the_times_of_the_link() -> None:
    page = (Path(__file__).parents[3] / "docs" / "howto" / "px4.md").read_text("utf-8")
    assert f"a frame every {1e3 * px4_link.BOOT_FRAME_S:g} ms of the wall clock" in page
    assert f"at most {px4_link.ANSWER_S:g} s" in page
    assert f"silent for {px4_link.SILENCE_S:g} s" in page
    assert f"restart within {px4_link.RECONNECT_S:g} s" in page
