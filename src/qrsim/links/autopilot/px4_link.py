"""A TCP port to which one vehicle's PX4 connects, and the frames between the two.

PX4 connects, sends a HEARTBEAT and a request once, and takes each HIL_SENSOR of id 0 for the time. It answers none
until its start script has started the rate controller; until then, frames are sent by the wall clock. Afterwards it
answers each frame with rates, stamped with that frame's time, and qrsim waits for the answer. A build without
lock-step has its own clock, and qrsim does not wait for it.
"""

from __future__ import annotations

import select
import socket
import time
from collections.abc import Callable
from contextlib import suppress

from qrsim.errors import RunError, UsageError
from qrsim.links.autopilot import px4_messages as messages
from qrsim.links.autopilot.px4_messages import Controls
from qrsim.links.mavlink.frames import Frame, Reader

FIRST_PORT = 4560
LOOPBACK, EVERYWHERE = "127.0.0.1", "0.0.0.0"
# Wall-clock times [s]: between frames while PX4 boots; for an answer; of silence that ends its flight; for another PX4
# to take its place.
BOOT_FRAME_S, ANSWER_S, SILENCE_S, RECONNECT_S = 0.004, 0.5, 15.0, 15.0
# If a PX4 often answers the next frame but not this one, it drops frames, and the time to wait is shorter [s]. A gap
# counts for about 30 frames.
IMPATIENT_S, GAP_DECAY, MANY_GAPS = 0.02, 0.97, 5.0
# A stream of this length without a frame is not MAVLink.
NO_FRAME_BYTES = 64 * 1024
# Silence after which an incomplete frame is searched for others, and interval of checks for other connections [s].
_QUIET_S, _LOOK_S = 0.02, 0.5
_AT_ONCE = 65536


class Px4Link:
    """The port of one vehicle.

    Args:
        name: of the vehicle.
        instance: of its PX4 (-i), whose MAV_SYS_ID is one more.
        port: TCP.
        host: address that is listened on.
        wait: for PX4 to connect at first, and for its first answer [s].
        say: called with a line for each unusual event.

    Raises:
        UsageError: the port is taken.

    Attributes:
        wanted: the present outputs of PX4.
        booted: whether the PX4 that is connected has answered yet.
        free: whether it is a build without lock-step.
        unanswered, foreign, harmed, odd, restarts: frames without an answer in time; answers to frames that were never
            sent, and messages without a meaning here; frames with a wrong check; outputs that were no number from -1
            to 1; how often another PX4 has taken over.
    """

    def __init__(self, name: str, instance: int, port: int, host: str, wait: float, say: Callable[[str], None]):
        self.name, self.instance, self.port = name, instance, port
        self._wait, self._say = wait, say
        self._listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._listener.bind((host, port))
            self._listener.listen(4)
        except OSError as error:
            self._listener.close()
            raise UsageError(
                f"TCP port {port} for {name} is taken by another simulator or qrsim ({error.strerror or error}); "
                "end it, or choose another --first-instance"
            ) from None
        self._listener.setblocking(False)
        self._peer: socket.socket | None = None
        self._told: set[str] = set()
        self._ever = False
        self._looked = 0.0
        self.unanswered = self.foreign = self.harmed = self.odd = self.restarts = 0
        # For tests and --px4: returns why a process that was started here has ended; "" while it runs.
        self.ended: Callable[[], str] = lambda: ""
        self._reset_connection()

    def _reset_connection(self) -> None:
        """Reset all that belongs to the previous connection, before a new PX4 connects."""
        self.wanted = Controls()
        self.booted = self.free = self._greeted = False
        self._reader = Reader()
        self._gaps, self._missed = 0.0, False
        self._unframed = self._frames = self._sent = self._answered = 0
        self._since = self._heard = time.perf_counter()

    # Connections

    def comes(self) -> bool:
        """Accept a waiting PX4; return True if one is connected, or if the PX4 process started here has ended."""
        return self.connected or self._accept_peer() or bool(self.ended())

    def connect(self, until: float) -> None:
        """Wait for a PX4 to connect until ``until`` of ``time.perf_counter`` [s]; does nothing if one is connected.

        Args:
            until: time of ``time.perf_counter`` [s].

        Raises:
            RunError: none has connected in time.
        """
        while self._peer is None:
            left = until - time.perf_counter()
            ready = select.select([self._listener], [], [], min(max(left, 0.0), 0.2))[0]
            if ready and self._accept_peer():
                return
            why = self.ended()
            if why:
                raise RunError(f"{self.name}: {why}")
            if left <= 0.0:
                raise RunError(f"{self.name}: {self.nobody()}")

    def _accept_peer(self) -> bool:
        """Accept a waiting connection, unless a PX4 is connected already; return whether it was kept."""
        try:
            peer, address = self._listener.accept()
        except OSError:
            return False
        if self._peer is not None:
            peer.close()
            self._print_once(
                "second", f"a second connection, of {address[0]}:{address[1]}, is closed; the first flies on"
            )
            return False
        peer.setblocking(False)
        with suppress(OSError):
            peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._reset_connection()
        self._peer = peer
        if self._ever:
            self.restarts += 1
            self._say(f"{self.name}: another PX4 connects; it boots with the vehicle as it is, the others wait for it")
        self._ever = True
        return True

    def _hang_up(self, why: str) -> None:
        """Close the connection to PX4, stop the vehicle's motors, and print the reason."""
        if self._peer is not None:
            self._peer.close()
            self._peer = None
            self.wanted = Controls()
            # A process that was started here ends its vehicle's flight, in the next ``connect``.
            self._say(f"{self.name}: {why}; its motors stop")

    @property
    def oddities(self) -> str:
        """Return a text with counts of unusual events (frames unanswered or damaged, restarts); "" without any."""
        counts = {
            "frames unanswered": self.unanswered,
            "frames damaged": self.harmed,
            "messages without a meaning": self.foreign,
            "outputs clamped": self.odd,
            "restarts": self.restarts,
        }
        return ", ".join(f"{count} {what}" for what, count in counts.items() if count)

    @property
    def connected(self) -> bool:
        """Whether a PX4 is connected."""
        return self._peer is not None

    @property
    def reconnects_until(self) -> float:
        """Time of ``time.perf_counter`` [s] until which another PX4 may replace one whose connection was lost."""
        return time.perf_counter() + RECONNECT_S

    def nobody(self) -> str:
        """Return the error message for a port to which no PX4 has connected, with a shell command that starts one."""
        if self._ever:
            return f"no other PX4 has connected to TCP {self.port} in {RECONNECT_S:g} s"
        return (
            f"no PX4 has connected to TCP {self.port} in {self._wait:g} s; in an empty folder: "
            f"PX4_SIM_MODEL=none_iris BUILD/bin/px4 -i {self.instance} -d BUILD/etc"
        )

    # Frames

    def send(self, data: bytes, stamp: int) -> None:
        """Send one frame's MAVLink messages (``data``), stamped ``stamp`` [us], to PX4; closes the connection if that
        fails.

        Args:
            data: HIL_SENSOR is the last.
            stamp: its time [us].
        """
        if self._peer is None:
            return
        self._sent = stamp
        self._frames += 1
        try:
            self._peer.sendall(data)
        except BlockingIOError:
            self._hang_up("its PX4 reads nothing any more")
        except OSError:
            self._hang_up("PX4 has ended or closed the connection")

    def settle(self, begin: float, answers: bool) -> None:
        """Read from PX4 until it has answered the frame sent at ``begin`` [s], or its waiting time is over; accept new
        connections.

        Args:
            begin: when it was sent, by ``time.perf_counter`` [s].
            answers: whether a PX4 that has booted answers this frame.

        Raises:
            RunError: it has been silent for too long.
        """
        now = time.perf_counter()
        if now - self._looked > _LOOK_S:
            self._looked = now
            self._accept_peer()
        if self._peer is None:
            return
        if self.free or not self.booted:
            while self._peer is not None and self._receive(begin + BOOT_FRAME_S):
                pass
            self._check_boot()
        elif answers:
            patience = ANSWER_S if self._gaps < MANY_GAPS else min(IMPATIENT_S, ANSWER_S)
            in_time = True
            while self._peer is not None and self._answered < self._sent:
                if not in_time:
                    self._count_unanswered()
                    return
                in_time = self._receive(begin + patience)
            self._gaps = GAP_DECAY * self._gaps + self._missed
            self._missed = False

    def _count_unanswered(self) -> None:
        """Count a sensor frame that PX4 did not answer; raises RunError after SILENCE_S seconds without an answer."""
        self.unanswered += 1
        self._missed = True
        if self._gaps >= MANY_GAPS:
            self._print_once("gaps", f"PX4 leaves many frames unanswered; each is waited for {1e3 * IMPATIENT_S:g} ms")
        silence = time.perf_counter() - self._heard
        if silence > SILENCE_S:
            raise RunError(f"{self.name}: its PX4 has not answered for {SILENCE_S:g} s")

    def _check_boot(self) -> None:
        """Raise RunError if the connected PX4 has sent no motor command within the waiting time."""
        waited = time.perf_counter() - self._since
        if self._peer is None or self.booted or waited <= self._wait:
            return
        why = (
            "has sent no HIL_ACTUATOR_CONTROLS"
            if self._greeted
            else "is not a PX4: neither HEARTBEAT nor HIL_ACTUATOR_CONTROLS has come"
        )
        raise RunError(f"{self.name}: the program connected to TCP {self.port} {why} in {self._wait:g} s")

    def _receive(self, until: float) -> bool:
        """Read bytes from PX4 once, waiting for them; return False once ``until`` of ``time.perf_counter`` [s] has
        passed.

        Return False if that time has passed, True if the caller may read again.
        """
        peer = self._peer
        assert peer is not None
        try:
            data = peer.recv(_AT_ONCE)
        except BlockingIOError:
            left = until - time.perf_counter()
            if select.select([peer], [], [], min(max(left, 0.0), _QUIET_S))[0]:
                return True
            # Nothing came for a while: bytes that only look like the head of a frame may hold back whole frames.
            for found in self._reader.inside():
                self._handle_frame(found)
            return left > 0.0
        except OSError:
            data = b""
        if not data:
            self._hang_up("PX4 has ended or closed the connection")
            return True
        self._unframed += len(data)
        for found in self._reader.feed(data):
            self._unframed = 0
            self._handle_frame(found)
        self.harmed = self._reader.damaged
        if self._unframed > NO_FRAME_BYTES:
            self._hang_up(f"not a PX4: {NO_FRAME_BYTES // 1024} kB without a MAVLink frame")
        # A peer that sends without a pause does not delay the next frame of sensors.
        return time.perf_counter() < until

    def _handle_frame(self, found: Frame) -> None:
        """Store the motor controls of a MAVLink frame from PX4; count frames of other programs."""
        number = found.layout.number
        if number == messages.HEARTBEAT:
            self._greeted = True
        if number != messages.CONTROLS:
            self.foreign += number not in (messages.HEARTBEAT, messages.COMMAND_LONG)
            return
        wanted = messages.controls(found.payload)
        # In lock-step the clock of PX4 is never ahead of the frames: a later time is from another program.
        if wanted.lockstep and wanted.time_usec > self._sent:
            self.foreign += 1
            return
        if found.system != self.instance + 1:
            line = f"PX4 has MAV_SYS_ID {found.system}, and instance {self.instance} should have {self.instance + 1}"
            self._print_once("system", line)
        self._heard = time.perf_counter()
        self._answered, self.wanted = wanted.time_usec, wanted
        if not self.booted:
            self.booted, self.free = True, not wanted.lockstep
            self._say(f"{self.name}: PX4 answers, {self._frames} frames after it connected")
            if self.free:
                line = "this PX4 is built without lock-step: it is paced by the wall clock, and not waited for"
                self._say(f"{self.name}: {line}")

    def speeds(self, count: int) -> list[float]:
        """Return the last speeds that PX4 commanded for motors 1 to ``count``, 0 to 1."""
        found, odd = messages.speeds(self.wanted, count)
        if odd:
            self.odd += odd
            self._print_once(
                "odd", "an output of PX4 is not within -1 to 1; it is clamped, and 0 where it is not a number"
            )
        return found

    def _print_once(self, kind: str, line: str) -> None:
        """Print a line about this vehicle, but only the first one of each ``kind``."""
        if kind not in self._told:
            self._told.add(kind)
            self._say(f"{self.name}: {line}")

    def close(self) -> None:
        """Close the vehicle's TCP port and the connection to PX4."""
        if self._peer is not None:
            self._peer.close()
            self._peer = None
        self._listener.close()
