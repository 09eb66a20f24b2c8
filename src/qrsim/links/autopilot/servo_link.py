"""A port on which one vehicle waits for the servos of its autopilot, step by step."""

from __future__ import annotations

import math
import socket
import time
from collections.abc import Callable
from contextlib import suppress

from qrsim.errors import RunError, UsageError
from qrsim.links.autopilot.ardupilot import Servos, servos

HOST = "127.0.0.1"
LONGEST = 2048
# ArduPilot repeats a step that nobody answers after 10 s; who has been silent for longer is not there any more.
SILENCE_S = 15.0
_POLL_S = 0.5


class ServoLink:
    """Waits for steps and answers them, in lock-step.

    Args:
        name: of the vehicle.
        port: UDP on the loopback.
        wait: for the first packet [s].
        say: told a line of what is odd.

    Raises:
        UsageError: the port is taken.

    Attributes:
        lost, repeated, foreign: packets that never came, came again, or were of somebody else.
        restarts: how often the autopilot has begun anew.
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
        self._reply = b""
        self.lost = self.repeated = self.foreign = self.restarts = 0

    def wait(self) -> Servos:
        """Return the next step; a step that comes again is answered again.

        Raises:
            RunError: nobody has been there in time.
        """
        limit = time.monotonic() + (self._wait if self._last is None else SILENCE_S)
        while True:
            found = self._received()
            if found is not None:
                return found
            if time.monotonic() > limit:
                self._complain()

    def _received(self) -> Servos | None:
        """Return the step of a packet; None for silence and for what is no new step."""
        try:
            packet, peer = self._socket.recvfrom(LONGEST)
        except TimeoutError:
            return None
        except ConnectionError:  # of an answer that nobody took
            return None
        found = servos(packet)
        if found is None or self._peer not in (None, peer):
            self.foreign += 1
            if self.foreign == 1:
                self._say(f"{self.name}: a packet of {peer[0]}:{peer[1]} that is not of its ArduPilot is passed over")
            return None
        last, self._peer = self._last, peer
        if last is None:
            self._say(f"{self.name}: ArduPilot at {peer[0]}:{peer[1]}, which asks for {found.rate} steps a second")
        elif found.frame == last.frame:
            self.repeated += 1
            self._send(self._reply)
            return None
        elif found.frame < last.frame:
            self.restarts += 1
            self._say(f"{self.name}: ArduPilot has begun anew; the vehicle goes on from where it is")
        else:
            self.lost += found.frame - last.frame - 1
        self._last = found
        return found

    def answer(self, reply: bytes) -> None:
        """Send the answer of the step that came last."""
        self._reply = reply
        self._send(reply)

    def _send(self, reply: bytes) -> None:
        # Who is not there any more is found out where its next step is waited for.
        if self._peer is not None and reply:
            with suppress(OSError):
                self._socket.sendto(reply, self._peer)

    def _complain(self) -> None:
        if self._last is None:
            raise RunError(
                f"{self.name}: no ArduPilot has come to UDP port {self.port} in {self._wait:g} s; start it with "
                f"--model JSON:{HOST} and -I {max(0, math.floor((self.port - FIRST_PORT) / PORT_STEP))}"
            )
        raise RunError(f"{self.name}: its ArduPilot has been silent for {SILENCE_S:g} s, after step {self._last.frame}")

    def close(self) -> None:
        """Close the port."""
        self._socket.close()


# Of instance 0 (-I 0), and how far the next is.
FIRST_PORT, PORT_STEP = 9002, 10
