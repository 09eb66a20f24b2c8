"""A port on which one vehicle waits for the servos of its autopilot, step by step."""

from __future__ import annotations

import math
import socket
import time
from collections.abc import Callable
from contextlib import suppress
from typing import NoReturn

from qrsim.errors import RunError, UsageError
from qrsim.links.autopilot.ardupilot import Servos, servos

HOST = "127.0.0.1"
LONGEST = 2048
# ArduPilot repeats a step that is not answered after 1 s (SIM_JSON.cpp, recv_fdm), so a longer silence is its end.
SILENCE_S = 1.5
# It binds no port (set_interface_ports): after a restart it sends from another one, and counts frames from 0 again,
# the first one until it is answered.
FIRST_FRAMES = 10
_POLL_S = 0.5


class ServoLink:
    """Waits for steps and answers them, in lock-step.

    Args:
        name: of the vehicle.
        port: UDP on the loopback.
        wait: for the first packet, and for a restart of an autopilot that has become silent [s].
        say: told a line of what is odd.

    Raises:
        UsageError: the port is taken.

    Attributes:
        lost, repeated, foreign: packets that never came, came again, or were of somebody else.
        restarts: how often the autopilot has been restarted.
    """

    def __init__(self, name: str, port: int, wait: float, say: Callable[[str], None]):
        self.name, self.port, self._wait, self._say = name, port, wait, say
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((HOST, port))
        except OSError as error:
            self._socket.close()
            raise UsageError(
                f"UDP port {port} for {name} is taken ({error.strerror or error}); choose another --port"
            ) from None
        self._socket.settimeout(_POLL_S)
        self._peer: tuple[str, int] | None = None
        self._last: Servos | None = None
        self._heard = -math.inf
        self._reply = b""
        self.lost = self.repeated = self.foreign = self.restarts = 0

    def wait(self) -> Servos:
        """Wait for ArduPilot's next servo packet and return it; a repeated packet is answered with the last reply
        again.

        Raises:
            RunError: no autopilot has come, or come back, in time.
        """
        begin = time.monotonic()
        told = self._last is None
        while True:
            found = self._next_step()
            if found is not None:
                return found
            silence = time.monotonic() - begin
            if silence > self._wait:
                self._raise_silence()
            if not told and silence > SILENCE_S:
                told = True
                self._say(f"{self.name}: its ArduPilot is silent; waiting {self._wait:g} s for it to start again")

    def _next_step(self) -> Servos | None:
        """Receive and decode one servo packet; return None after a time-out, and for foreign and repeated packets."""
        try:
            packet, peer = self._socket.recvfrom(LONGEST)
        except TimeoutError:
            return None
        except ConnectionError:  # an earlier answer found its port closed
            return None
        found = servos(packet)
        if found is None or not self._is_from_autopilot(found, peer):
            self.foreign += 1
            if self.foreign == 1:
                self._say(f"{self.name}: a packet of {peer[0]}:{peer[1]} that is not of its ArduPilot is passed over")
            return None
        last, moved = self._last, self._peer not in (None, peer)
        self._peer, self._heard = peer, time.monotonic()
        if last is None:
            self._say(f"{self.name}: ArduPilot at {peer[0]}:{peer[1]}, which asks for {found.rate} steps a second")
        elif moved or found.frame < last.frame:
            self.restarts += 1
            self._say(f"{self.name}: ArduPilot has restarted, at {peer[0]}:{peer[1]}; the vehicle goes on as it is")
        elif found.frame == last.frame:
            self.repeated += 1
            self._send_reply(self._reply)
            return None
        else:
            self.lost += found.frame - last.frame - 1
        self._last = found
        return found

    def _is_from_autopilot(self, found: Servos, peer: tuple[str, int]) -> bool:
        """Return whether a servo packet comes from this vehicle's ArduPilot, or from one that replaces it."""
        silent = time.monotonic() - self._heard > SILENCE_S
        return self._peer in (None, peer) or found.frame < FIRST_FRAMES or silent

    def answer(self, reply: bytes) -> None:
        """Send a reply (a JSON line) to ArduPilot, and keep it for repeated packets."""
        self._reply = reply
        self._send_reply(reply)

    def _send_reply(self, reply: bytes) -> None:
        """Send a reply to ArduPilot, ignoring socket errors; the next ``wait`` reports them."""
        # Who is not there any more is found out where its next step is waited for.
        if self._peer is not None and reply:
            with suppress(OSError):
                self._socket.sendto(reply, self._peer)

    def _raise_silence(self) -> NoReturn:
        """Raise a RunError: no ArduPilot has connected, or it has been silent for too long."""
        if self._last is None:
            raise RunError(
                f"{self.name}: no ArduPilot has come to UDP port {self.port} in {self._wait:g} s; start it with "
                f"--model JSON:{HOST} and -I {max(0, math.floor((self.port - FIRST_PORT) / PORT_STEP))}"
            )
        raise RunError(
            f"{self.name}: its ArduPilot has been silent for {self._wait:g} s, since step {self._last.frame}, and no "
            "other has come"
        )

    def close(self) -> None:
        """Close the vehicle's UDP port."""
        self._socket.close()


# Of instance 0 (-I 0), and how far the next is.
FIRST_PORT, PORT_STEP = 9002, 10
