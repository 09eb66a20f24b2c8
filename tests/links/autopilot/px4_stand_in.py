"""A stand-in for PX4's SITL at the end of its simulator interface: pymavlink and nothing of qrsim.

It follows SimulatorMavlink.cpp of PX4-Autopilot: connects until it is accepted, sends a HEARTBEAT and a request in
either order, takes the time from HIL_SENSOR of id 0, and answers each of its frames once it has booted. It flies by the
messages alone: takes off, holds ``height`` over its start, and checks what it gets.
"""

from __future__ import annotations

import math
import random
import socket
import threading
import time
from collections.abc import Sequence

from pymavlink.dialects.v20 import common

RATE = 250.0
G = 9.81
# PX, PY, KM of PX4's airframe 10016_none_iris.
IRIS = ((0.1515, 0.245, 0.05), (-0.1515, -0.1875, 0.05), (0.1515, -0.245, -0.05), (-0.1515, 0.1875, -0.05))
HANDLED = {"HIL_SENSOR", "HIL_GPS", "HIL_STATE_QUATERNION", "DISTANCE_SENSOR", "HIL_OPTICAL_FLOW"}
ACCEL, GYRO, MAG, BARO = 0x7, 0x38, 0x1C0, 0x1A00


def free_ports(count: int) -> int:
    """Return the first of so many neighbouring ports that nobody has."""
    for _ in range(50):
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            first = probe.getsockname()[1]
        try:
            for port in range(first, first + count):
                with socket.socket() as probe:
                    probe.bind(("127.0.0.1", port))
        except OSError:
            continue
        return int(first)
    raise AssertionError("no free ports")


class Px4StandIn(threading.Thread):
    """One PX4.

    Args:
        port: of the simulator.
        instance: its MAV_SYS_ID is one more.
        boot: frames that it takes before it answers; None: it never does.
        frames: after so many it closes the connection; None: it stays.
        height: that it takes off to [m].
        hover: its guess of the thrust at hover, of the largest.
        rotors: PX, PY and KM of its motors.
        drop_every, stale_every, garbage_every: answers left out, stamped a frame too old, or sent after noise.
        split: whether answers are sent in two pieces.
        flags: of its answers; 0: built without lock-step.
        outputs: its outputs whatever comes, armed; None: those of its controller.
        harm: makes bytes that are sent before each answer.
    """

    def __init__(
        self,
        port: int,
        instance: int = 0,
        boot: int | None = 4,
        frames: int | None = None,
        height: float = 3.0,
        hover: float = 0.62,
        rotors: Sequence[tuple[float, float, float]] = IRIS,
        drop_every: int = 0,
        stale_every: int = 0,
        garbage_every: int = 0,
        split: bool = False,
        flags: int = 1,
        outputs: Sequence[float] | None = None,
        harm=None,
        start_unix: float = 1782036000.0,
    ):
        super().__init__(daemon=True)
        self.port, self.instance, self.boot, self.frames = port, instance, boot, frames
        self.height, self.hover, self.rotors, self.outputs = height, hover, rotors, outputs
        self.drop_every, self.stale_every, self.garbage_every = drop_every, stale_every, garbage_every
        self.split, self.flags, self.harm, self.start_unix = split, flags, harm, start_unix
        self._random = random.Random(instance)
        self._mav = common.MAVLink(None, srcSystem=instance + 1, srcComponent=1)
        self._mav.robust_parsing = True
        self.received = b""
        self.kinds: set[str] = set()
        self.problem = ""
        self.count = self.dropped = 0
        self.clock = 0
        self.armed_at: int | None = None
        self.pilot = Pilot(height, hover, rotors)
        self.stop = threading.Event()

    def run(self) -> None:
        try:
            self._run()
        except OSError:
            pass
        except AssertionError as error:
            self.problem = str(error) or "assertion"

    def _run(self) -> None:
        wire = self._connected()
        with wire:
            hello = [
                self._mav.command_long_encode(0, 0, 511, 0, 115.0, 5000.0, 0, 0, 0, 0, 0).pack(self._mav),
                self._mav.heartbeat_encode(0, 12, 0, 0, 0).pack(self._mav),
            ]
            self._random.shuffle(hello)
            for message in hello:
                wire.sendall(message)
            while not self.stop.is_set():
                data = wire.recv(65536)
                if not data:
                    return
                self.received += data
                for message in self._mav.parse_buffer(data) or []:
                    self._take(message, wire)
                    if self.frames is not None and self.count >= self.frames:
                        return

    def _connected(self) -> socket.socket:
        while True:
            wire = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
            try:
                wire.connect(("127.0.0.1", self.port))
                wire.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                wire.settimeout(60.0)
                return wire
            except ConnectionRefusedError:
                wire.close()
                if self.stop.is_set():
                    raise
                time.sleep(0.0005)

    def _take(self, message, wire: socket.socket) -> None:
        kind = message.get_type()
        assert kind in HANDLED, f"PX4 has no handler for {kind}"
        self.kinds.add(kind)
        if kind == "HIL_GPS":
            self._check_gps(message)
            self.pilot.gps(message)
        if kind != "HIL_SENSOR" or message.id != 0:
            return
        self._check_sensor(message)
        self.clock = message.time_usec
        self.count += 1
        self.pilot.sensor(message)
        if self.armed_at is None and self.pilot.ready:
            self.armed_at = self.clock + 1_000_000
        # Without new rates its controller does not run, and nothing is published.
        if self.boot is not None and self.count > self.boot and message.fields_updated & GYRO == GYRO:
            self._answer(wire)

    def _answer(self, wire: socket.socket) -> None:
        number = self.count - self.boot
        armed = self.armed_at is not None and self.clock >= self.armed_at
        outputs = self.outputs
        if outputs is None:
            outputs = self.pilot.outputs() if armed else []
        armed = armed or self.outputs is not None
        controls = [*outputs, *[0.0] * 16][:16] if armed else [0.0] * 16
        stamp = self.clock - (4000 if self.stale_every and number % self.stale_every == 0 else 0)
        answer = self._mav.hil_actuator_controls_encode(stamp, controls, 129 if armed else 1, self.flags)
        packed = answer.pack(self._mav)
        if self.harm is not None:
            wire.sendall(self.harm(packed))
        if self.garbage_every and number % self.garbage_every == 0:
            wire.sendall(bytes(self._random.randrange(256) for _ in range(30)))
        if self.drop_every and number % self.drop_every == 0:
            self.dropped += 1
            return
        if self.split:
            wire.sendall(packed[:20])
            wire.sendall(packed[20:])
        else:
            wire.sendall(packed)

    def _check_sensor(self, m) -> None:
        assert not self.clock or m.time_usec == self.clock + 4000, f"stamp {m.time_usec} after {self.clock}"
        assert m.time_usec >= 1_000_000, "a clock of 0 is none"
        for bits in (ACCEL, GYRO, MAG, BARO):
            assert m.fields_updated & bits in (0, bits), f"half a group: {m.fields_updated:#x}"
        if m.fields_updated & MAG:
            field = math.hypot(m.xmag, m.ymag, m.zmag)
            assert 0.2 < field < 0.7, f"{field} gauss"
        if m.fields_updated & BARO:
            assert 900.0 < m.abs_pressure < 1050.0, f"{m.abs_pressure} hPa"
            assert -20.0 < m.temperature < 45.0, f"{m.temperature} deg C"
        if m.fields_updated & ACCEL and self.count > 5:
            force = math.hypot(m.xacc, m.yacc, m.zacc)
            assert force < 60.0, f"{force} m/s^2"

    def _check_gps(self, m) -> None:
        assert 0 <= m.time_usec / 1e6 - self.start_unix < 3600.0, f"UTC {m.time_usec}"


class Pilot:
    """Estimates attitude, place and velocity from the messages, and holds a place by the motors.

    Attributes:
        ready: whether a PX4 would arm: accuracy below 3 m, 6 satellites, 3 readings of barometer and magnetometer.
    """

    def __init__(self, height: float, hover: float, rotors: Sequence[tuple[float, float, float]]):
        self._height, self._hover, self._rotors = height, hover, rotors
        self.roll = self.pitch = self.yaw = 0.0
        self.place, self.velocity = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
        self._rates = [0.0, 0.0, 0.0]
        self._sum = [0.0, 0.0, 0.0]
        self._origin: tuple[float, float, float] | None = None
        self._ground: list[float] = []
        self._readings = [0, 0]
        self._fix = self._flying = False
        self._heading: float | None = None
        self._wanted_yaw = 0.0

    @property
    def ready(self) -> bool:
        return self._fix and min(self._readings) >= 3

    def gps(self, m) -> None:
        self._fix = m.fix_type >= 3 and m.eph < 300 and m.satellites_visible >= 6
        if m.fix_type < 3:
            return
        here = m.lat * 1e-7, m.lon * 1e-7
        if self._origin is None:
            self._origin = (*here, 0.0)
        north = math.radians(here[0] - self._origin[0]) * 6.371e6
        east = math.radians(here[1] - self._origin[1]) * 6.371e6 * math.cos(math.radians(here[0]))
        for axis, (place, speed) in enumerate(((north, m.vn * 0.01), (east, m.ve * 0.01))):
            # The fix is 0.2 s old.
            self.velocity[axis] += 0.25 * (speed - self.velocity[axis]) + 0.05 * (place - self.place[axis])
            self.place[axis] += 0.3 * (place + 0.2 * self.velocity[axis] - self.place[axis])

    def sensor(self, m) -> None:
        dt = 1.0 / RATE
        if m.fields_updated & GYRO:
            self._rates = [m.xgyro, m.ygyro, m.zgyro]
        p, q, r = self._rates
        sr, cr, tp = math.sin(self.roll), math.cos(self.roll), math.tan(self.pitch)
        self.roll += dt * (p + (q * sr + r * cr) * tp)
        self.pitch += dt * (q * cr - r * sr)
        self.yaw += dt * (q * sr + r * cr) / math.cos(self.pitch)
        sr, cr, sp, cp, sy, cy = (f(a) for a in (self.roll, self.pitch, self.yaw) for f in (math.sin, math.cos))
        if m.fields_updated & MAG:
            self._readings[1] += 1
            x = m.xmag * cp + m.ymag * sr * sp + m.zmag * cr * sp
            y = m.ymag * cr - m.zmag * sr
            heading = math.atan2(-y, x)
            if self._heading is None:
                self.yaw = self._wanted_yaw = heading
            self._heading = heading
            self.yaw += 0.02 * math.remainder(heading - self.yaw, math.tau)
        if m.fields_updated & ACCEL:
            x, y, z = m.xacc, m.yacc, m.zacc
            if not self._flying:
                self.roll += 0.05 * (math.atan2(-y, -z) - self.roll)
                self.pitch += 0.05 * (math.atan2(x, math.hypot(y, z)) - self.pitch)
            else:
                north = x * cp * cy + y * (sr * sp * cy - cr * sy) + z * (cr * sp * cy + sr * sy)
                east = x * cp * sy + y * (sr * sp * sy + cr * cy) + z * (cr * sp * sy - sr * cy)
                down = -x * sp + y * sr * cp + z * cr * cp + G
                for axis, force in enumerate((north, east, down)):
                    self.velocity[axis] += dt * force
                    self.place[axis] += dt * self.velocity[axis]
        if m.fields_updated & BARO:
            self._readings[0] += 1
            height = (1.0 - (m.abs_pressure / 1013.25) ** 0.190263) / 2.25577e-5
            if not self._flying:
                self._ground = [*self._ground[-49:], height]
            below = sum(self._ground) / len(self._ground) - height
            self.velocity[2] += 0.02 * (below - self.place[2])
            self.place[2] += 0.05 * (below - self.place[2])

    def outputs(self) -> list[float]:
        self._flying = True
        north, east, down = self.place
        errors = -north, -east, -self._height - down
        lean = []
        for axis in (0, 1):
            self._sum[axis] = min(max(self._sum[axis] + 0.3 * errors[axis] / RATE, -3.0), 3.0)
            pull = 0.8 * errors[axis] - 1.4 * self.velocity[axis] + self._sum[axis]
            lean.append(min(max(pull, -3.5), 3.5) / G)
        climb = min(max(1.2 * -errors[2], -0.8), 1.0)
        lift = climb + self.velocity[2]
        self._sum[2] = min(max(self._sum[2] + 0.4 * lift / RATE, -0.2), 0.2)
        thrust = min(max(self._hover * (1.0 + 0.25 * lift) + self._sum[2], 0.1), 0.9)
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        wanted_pitch, wanted_roll = -(cos * lean[0] + sin * lean[1]), cos * lean[1] - sin * lean[0]
        p, q, r = self._rates
        turn_roll = 0.06 * (6.0 * (wanted_roll - self.roll) - p)
        turn_pitch = 0.06 * (6.0 * (wanted_pitch - self.pitch) - q)
        turn_yaw = 0.15 * (1.5 * math.remainder(self._wanted_yaw - self.yaw, math.tau) - r)
        found = []
        for x, y, turn in self._rotors:
            away = math.hypot(x, y)
            part = thrust - turn_roll * y / away + turn_pitch * x / away + turn_yaw * math.copysign(1.0, turn)
            # Thrust is the square of a motor's output.
            found.append(math.sqrt(min(max(part, 0.01), 1.0)))
        return found
