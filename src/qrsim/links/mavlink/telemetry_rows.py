"""Payloads of the most frequent messages, of all vehicles at once; byte for byte those of ``telemetry``."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.links.mavlink.dialect import LAYOUTS
from qrsim.links.mavlink.telemetry import BODY_FRD, DIAGONAL, GPS_INS, LOCAL_NED, throttle
from qrsim.links.mavlink.view import View
from qrsim.links.shared import sight as s

# Payloads by message, with the fields of one type that follow each other as one array.
_MS, _US = ("ms", "<u4"), ("us", "<u8")
_FORMS: dict[str, np.dtype[np.void]] = {
    "ATTITUDE": np.dtype([_MS, ("numbers", "<f4", 6)]),
    "ATTITUDE_QUATERNION": np.dtype([_MS, ("numbers", "<f4", 11)]),
    "LOCAL_POSITION_NED": np.dtype([_MS, ("numbers", "<f4", 6)]),
    "GLOBAL_POSITION_INT": np.dtype([_MS, ("place", "<i4", 4), ("velocity", "<i2", 3), ("heading", "<u2")]),
    "VFR_HUD": np.dtype([("numbers", "<f4", 4), ("heading", "<i2"), ("throttle", "<u2")]),
    "ALTITUDE": np.dtype([_US, ("numbers", "<f4", 6)]),
    "HIGHRES_IMU": np.dtype([_US, ("numbers", "<f4", 13), ("updated", "<u2"), ("id", "u1")]),
    "ODOMETRY": np.dtype([_US, ("numbers", "<f4", 55), ("frames", "u1", 3), ("estimator", "u1"), ("quality", "i1")]),
}
# Columns of HIGHRES_IMU, their scales (microtesla are 0.01 gauss, pascals 0.01 mbar), and the bit of each first one.
_IMU = [
    *(at + i for at in (s.FORCE, s.RATES, s.FIELD) for i in range(3)),
    s.PRESSURE,
    s.DIFFERENTIAL,
    s.HEIGHT,
    s.TEMPERATURE,
]
_IMU_SCALES = np.array([1.0] * 6 + [0.01] * 5 + [1.0, 1.0])
_IMU_BITS = np.array([0x7, 0, 0, 0x38, 0, 0, 0x1C0, 0, 0, 0x200, 0x400, 0x800, 0x1000])
_IMU_TEMPERATURE, _ZERO_CELSIUS = 12, 273.15
_STD_SPEED = [s.STD_VELOCITY, s.STD_VELOCITY + 1, s.STD_VELOCITY + 2]
_STD_POSE = [*range(s.STD_POSITION, s.STD_POSITION + 3), *range(s.STD_ATTITUDE, s.STD_ATTITUDE + 3)]

Blanks = dict[str, tuple[NumpyArray, NumpyArray]]


@dataclass(frozen=True)
class Rows:
    """What the messages of n vehicles are made of at a tick, see ``View``.

    Attributes:
        views: of the vehicles.
        blanks: by name of a message its payloads (n,) and the same as bytes (n, size), used again at each tick.
        values: (n, WIDTH) numbers of each (``shared.sight``).
        valid: (n,) whether there is an estimate.
        ms, us: time since the reset, of all.
        position, velocity, attitude, rates: (n, 3) of the estimate, the position in the vehicle's local frame.
        place: (n, 3) latitude and longitude [deg], and altitude [m].
        relative: (n,) altitude above home [m].
    """

    views: Sequence[View]
    blanks: Blanks
    values: NumpyArray
    valid: NumpyArray
    ms: int
    us: int
    position: NumpyArray
    velocity: NumpyArray
    attitude: NumpyArray
    rates: NumpyArray
    place: NumpyArray
    relative: NumpyArray

    @staticmethod
    def of(views: Sequence[View], blanks: Blanks | None = None) -> Rows:
        """Return the rows of vehicles at one tick; ``blanks``: of the tick before."""
        values = np.concatenate([v.numbers for v in views]).reshape(len(views), -1)
        own = np.array([(v.seen.altitude, *v.stack.origin, v.home_altitude) for v in views])
        place, rates = values[:, s.PLACE : s.PLACE + 3].copy(), values[:, s.RATES : s.RATES + 3]
        place[:, 2] = own[:, 0]
        return Rows(
            views,
            {} if blanks is None else blanks,
            values,
            np.array([v.seen.valid for v in views]),
            views[0].boot_ms,
            views[0].boot_us,
            values[:, s.POSITION : s.POSITION + 3] - own[:, 1:4],
            values[:, s.VELOCITY : s.VELOCITY + 3],
            values[:, s.ATTITUDE : s.ATTITUDE + 3],
            np.where(np.isnan(rates[:, :1]), 0.0, rates),
            place,
            own[:, 0] - own[:, 4],
        )

    def blank(self, name: str) -> NumpyArray:
        """Return payloads (n,) of a message, zero where no message of this name has a number."""
        if name not in self.blanks:
            raw = np.zeros((len(self.views), _FORMS[name].itemsize), np.uint8)
            self.blanks[name] = raw.view(_FORMS[name])[:, 0], raw
        return self.blanks[name][0]


# Payloads (n,) by the fields of a message, and which of them are sent (n,).
Payloads = tuple[NumpyArray, NumpyArray]


def _triples(r: Rows, name: str, first: NumpyArray, second: NumpyArray) -> Payloads:
    """Return the payloads of a message of six numbers of the estimate: two arrays (n, 3)."""
    found = r.blank(name)
    found["ms"] = r.ms
    found["numbers"][:, :3], found["numbers"][:, 3:] = first, second
    return found, r.valid


def attitude(r: Rows) -> Payloads:
    """Return the payloads of ATTITUDE."""
    return _triples(r, "ATTITUDE", r.attitude, r.rates)


def attitude_quaternion(r: Rows) -> Payloads:
    """Return the payloads of ATTITUDE_QUATERNION."""
    found = r.blank("ATTITUDE_QUATERNION")
    found["ms"], numbers = r.ms, found["numbers"]
    numbers[:, :4], numbers[:, 4:7] = r.values[:, s.QUATERNION : s.QUATERNION + 4], r.rates
    return found, r.valid


def local_position_ned(r: Rows) -> Payloads:
    """Return the payloads of LOCAL_POSITION_NED."""
    return _triples(r, "LOCAL_POSITION_NED", r.position, r.velocity)


def global_position_int(r: Rows) -> Payloads:
    """Return the payloads of GLOBAL_POSITION_INT."""
    found = r.blank("GLOBAL_POSITION_INT")
    place, valid = found["place"], r.valid[:, None]
    found["ms"] = r.ms
    place[:, :3] = np.where(valid, np.rint(r.place * (1e7, 1e7, 1e3)), 0.0)
    place[:, 3] = np.where(r.valid, np.rint(r.relative * 1e3), 0.0)
    found["velocity"] = np.where(valid, np.clip(np.rint(r.velocity * 100.0), -32768.0, 32767.0), 0.0)
    found["heading"] = _heading(r, 100.0) % 36000
    return found, r.valid


def _heading(r: Rows, scale: float) -> NumpyArray:
    """Return the headings (n,) in parts of a degree, rounded; 0 without an estimate."""
    degrees = np.rint(np.degrees(r.attitude[:, 2]) * scale)
    return np.where(r.valid, degrees, 0.0).astype(np.int64)


def vfr_hud(r: Rows) -> Payloads:
    """Return the payloads of VFR_HUD."""
    found = r.blank("VFR_HUD")
    numbers, airspeed = found["numbers"], r.values[:, s.AIRSPEED]
    # NumPy rounds the last bit of a hypotenuse in another way.
    ground = np.array([math.hypot(*v.seen.velocity_ned[:2]) for v in r.views])
    numbers[:, 0] = np.where(np.isnan(airspeed), ground, airspeed)
    numbers[:, 1], numbers[:, 2], numbers[:, 3] = ground, r.place[:, 2], -r.velocity[:, 2]
    found["heading"] = _heading(r, 1.0) % 360
    found["throttle"] = [throttle(v) for v in r.views]
    return found, r.valid


def altitude(r: Rows) -> Payloads:
    """Return the payloads of ALTITUDE."""
    found = r.blank("ALTITUDE")
    found["us"], numbers = r.us, found["numbers"]
    numbers[:, :2], numbers[:, 2], numbers[:, 3] = r.place[:, 2:], -r.position[:, 2], r.relative
    numbers[:, 4], numbers[:, 5] = np.nan, r.values[:, s.RANGE]
    return found, r.valid


def highres_imu(r: Rows) -> Payloads:
    """Return the payloads of HIGHRES_IMU."""
    found = r.blank("HIGHRES_IMU")
    values = r.values[:, _IMU]
    known = ~np.isnan(values)
    values *= _IMU_SCALES
    values[:, _IMU_TEMPERATURE] -= _ZERO_CELSIUS
    updated = known @ _IMU_BITS
    found["us"], found["numbers"], found["updated"] = r.us, np.where(known, values, 0.0), updated
    return found, updated & 0x3F != 0


def odometry(r: Rows) -> Payloads:
    """Return the payloads of ODOMETRY."""
    found = r.blank("ODOMETRY")
    found["us"], numbers = r.us, found["numbers"]
    quaternion = r.values[:, s.QUATERNION : s.QUATERNION + 4]
    (w, x, y, z), (north, east, down) = quaternion.T, r.velocity.T
    # Velocity turned into body axes by the conjugate of the quaternion.
    tx, ty, tz = 2.0 * (z * east - y * down), 2.0 * (x * down - z * north), 2.0 * (y * north - x * east)
    numbers[:, :3], numbers[:, 3:7] = r.position, quaternion
    numbers[:, 7] = north + w * tx + z * ty - y * tz
    numbers[:, 8] = east + w * ty + x * tz - z * tx
    numbers[:, 9] = down + w * tz + y * tx - x * ty
    numbers[:, 10:13] = r.rates
    pose, speed = r.values[:, _STD_POSE], r.values[:, _STD_SPEED]
    numbers[:, [13 + at for at in DIAGONAL]] = pose * pose
    numbers[:, [34 + at for at in DIAGONAL[:3]]] = speed * speed
    numbers[:, [34 + at for at in DIAGONAL[3:]]] = np.nan
    found["frames"], found["estimator"] = (LOCAL_NED, BODY_FRD, 0), GPS_INS
    return found, r.valid


# By the number of the message.
BY_ROWS: dict[int, Callable[[Rows], Payloads]] = {
    LAYOUTS[function.__name__.upper()].number: function
    for function in (
        attitude, attitude_quaternion, local_position_ned, global_position_int, vfr_hud, altitude, highres_imu,
        odometry,
    )
}  # fmt: skip
