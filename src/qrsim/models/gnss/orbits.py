"""Satellite orbits: the interface every ephemeris has, and a GPS constellation that needs no file.

An ephemeris works in float64 at load, for any time. ``at`` makes of it what a tick uses: a record of arrays that
gives the satellites as they are seen from the site, accurate in single precision.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import Protocol

import numpy as np
import numpy.typing as npt
from jax import Array

from qrsim.core.arrays import NumpyArray
from qrsim.core.fastmath import sincos
from qrsim.core.tree import cast, quantity, record, record_of
from qrsim.core.vectors import Vec3
from qrsim.errors import UsageError
from qrsim.models.site import Float64, Site

SPEED_OF_LIGHT = 299792458.0  # m/s
EARTH_ROTATION_RATE = 7.2921151467e-5  # rad/s, IS-GPS-200
EARTH_GRAVITY = 3.986005e14  # m^3/s^2, IS-GPS-200
EARTH_RADIUS = 6378137.0  # m, equatorial, WGS-84
EARTH_J2 = 1.0826298e-3  # WGS-84

# Travel times lie between 67 ms at the zenith and 86 ms at the horizon.
_TYPICAL_FLIGHT_S = 0.077
_UNITS_PER_RAD = 2.0**32 / (2.0 * math.pi)


class Orbits(Protocol):
    """Satellite orbits as a tick uses them: a record of arrays for one site and one start time."""

    def positions_ned(self, seconds: Array, fraction: Array) -> Vec3:
        """Return the satellites' positions (S,) [m] in the site's NED frame, at a time since the run's start.

        The signals are received at the site at the time asked for. Each position is the one at transmission,
        expressed in the Earth-fixed frame of the time of reception.

        Args:
            seconds: () int32, whole seconds since the start. A float32 of two days' seconds would be 8 ms off, in
                which a satellite moves 30 m; hence the two parts, for which ``split_time`` is made.
            fraction: () float in the run's precision, the rest of the time [s], usually in [0, 1).
        """
        ...


class Ephemeris(Protocol):
    """Satellite positions by time, in float64: an embedded constellation, or a file."""

    @property
    @abstractmethod
    def satellites(self) -> tuple[str, ...]:
        """Names of the S satellites, such as G05."""
        ...

    @property
    def system_of(self) -> str:
        """GNSS system letter of each of the S satellites, as text; G (GPS) by default."""
        return "G" * len(self.satellites)

    @property
    @abstractmethod
    def span_gps_seconds(self) -> tuple[float, float]:
        """First and last time [GPS s] with satellite positions; infinite if unlimited."""
        ...

    @abstractmethod
    def positions_ecef(self, gps_seconds: npt.ArrayLike) -> Float64:
        """Return the S satellites' Earth-fixed positions (..., S, 3) [m] at times (...) [GPS s]."""
        ...

    @property
    @abstractmethod
    def satellite_ids(self) -> npt.NDArray[np.uint32]:
        """Number (S,) of each satellite, which identifies its random errors; the lower byte is its PRN, if any."""
        ...

    @abstractmethod
    def at(self, site: Site, start_gps_seconds: float, dtype: npt.DTypeLike, duration_s: float = math.inf) -> Orbits:
        """Return the satellites' orbits as seen from a site, for a run from a start [GPS s] on, with a duration [s]."""
        ...


@record
class Phase:
    """An angle that grows evenly, counted in units of 2^-32 turns so that it stays exact for years.

    Whole units are int32 and overflow on purpose: that drops whole turns. What is left over of angle and rate,
    less than half a unit, is kept as floats.
    """

    units: Array = quantity(unit="2^-32 turns", doc="(S,) int32, angle at the start")
    units_per_s: Array = quantity(unit="2^-32 turns/s", doc="(S,) int32, rate")
    rest: Array = quantity(unit="2^-32 turns", doc="(S,) what is left over of the angle")
    rest_per_s: Array = quantity(unit="2^-32 turns/s", doc="(S,) what is left over of the rate")

    @staticmethod
    def of(angle: NumpyArray, rate: NumpyArray) -> Phase:
        """Return the phases, in float64, of angles (S,) [rad] that grow at rates (S,) [rad/s]; |rate| < pi."""
        units, units_per_s = np.rint(angle * _UNITS_PER_RAD), np.rint(rate * _UNITS_PER_RAD)
        return record_of(
            Phase,
            units.astype(np.int64).astype(np.int32),
            units_per_s.astype(np.int32),
            angle * _UNITS_PER_RAD - units,
            rate * _UNITS_PER_RAD - units_per_s,
        )

    def angle(self, seconds: Array, fraction: Array) -> Array:
        """Return the angles (S,) [rad], near [-pi, pi], at a time of whole seconds plus a fraction [s], () or (S,)."""
        dtype = fraction.dtype
        units = self.units + self.units_per_s * seconds
        rest = self.rest + self.rest_per_s * seconds.astype(dtype)
        rest = rest + (self.units_per_s.astype(dtype) + self.rest_per_s) * fraction
        return (units.astype(dtype) + rest) * (1.0 / _UNITS_PER_RAD)


@record
class KeplerOrbits:
    """Circular orbits of S satellites as seen from a site; ``NominalConstellation.at`` makes it."""

    argument: Phase = quantity(doc="(S,) argument of latitude, from the ascending node along the orbit")
    node: Phase = quantity(doc="(S,) longitude of the ascending node, Earth-fixed, east positive")
    radius: Array = quantity(unit="m", doc="(S,) distance from the Earth's centre")
    cos_inclination: Array = quantity(unit="1", doc="(S,)")
    sin_inclination: Array = quantity(unit="1", doc="(S,)")
    origin_ecef: Vec3 = quantity(unit="m", doc="() the site")
    north: Vec3 = quantity(unit="1", doc="() the site's north axis, Earth-fixed")
    east: Vec3 = quantity(unit="1", doc="() the site's east axis, Earth-fixed")
    down: Vec3 = quantity(unit="1", doc="() the site's down axis, Earth-fixed")

    def positions_ned(self, seconds: Array, fraction: Array) -> Vec3:
        """Return the satellites' positions (S,) [m] NED, as received at a time; see ``Orbits.positions_ned``.

        The travel time comes from one fixed-point step, which leaves a satellite less than 1 mm off its place.
        """
        nearly = self._received(seconds, fraction, _TYPICAL_FLIGHT_S)
        return self._received(seconds, fraction, nearly.norm() * (1.0 / SPEED_OF_LIGHT))

    def _received(self, seconds: Array, fraction: Array, flight: Array | float) -> Vec3:
        """Return satellite positions NED (S,) [m] as received after signal travel times ``flight`` [s]."""
        sin_u, cos_u = sincos(self.argument.angle(seconds, fraction - flight))
        # While the signal travels the Earth turns on, and what is fixed in space falls back to the west.
        node = self.node.angle(seconds, fraction - flight) - EARTH_ROTATION_RATE * flight
        sin_node, cos_node = sincos(node)
        across = sin_u * self.cos_inclination
        ray = Vec3(
            self.radius * (cos_u * cos_node - across * sin_node) - self.origin_ecef.x,
            self.radius * (cos_u * sin_node + across * cos_node) - self.origin_ecef.y,
            self.radius * (sin_u * self.sin_inclination) - self.origin_ecef.z,
        )
        return Vec3(self.north.dot(ray), self.east.dot(ray), self.down.dot(ray))


# Global Positioning System Standard Positioning Service Performance Standard, October 2001, table 3-1: right ascension
# of the ascending node of each plane, and argument of latitude of its four slots [deg], at 1993-07-01 00:00 UTC.
_PLANES: dict[str, tuple[float, tuple[float, ...]]] = {
    "A": (272.847, (268.126, 161.786, 11.676, 41.806)),
    "B": (332.847, (80.956, 173.336, 309.976, 204.376)),
    "C": (32.847, (111.876, 11.796, 339.666, 241.556)),
    "D": (92.847, (135.226, 265.446, 35.156, 167.356)),
    "E": (152.847, (197.046, 302.596, 66.066, 333.686)),
    "F": (212.847, (238.886, 345.226, 105.206, 135.346)),
}
_SEMI_MAJOR_AXIS = 26559710.0  # m
_INCLINATION = math.radians(55.0)
# 1993-07-01 00:00 UTC is 4925 days and 9 leap seconds after the GPS epoch.
_EPOCH_GPS_SECONDS = 4925 * 86400.0 + 9.0
_EPOCH_GREENWICH_RAD = math.radians(15.0 * (18.0 + 36.0 / 60.0 + 14.4 / 3600.0))

_MEAN_MOTION = math.sqrt(EARTH_GRAVITY / _SEMI_MAJOR_AXIS**3)
_J2_FACTOR = 1.5 * EARTH_J2 * (EARTH_RADIUS / _SEMI_MAJOR_AXIS) ** 2
# Secular rates of a circular orbit [rad/s] (Brouwer 1959, first order; argument of perigee and mean anomaly together).
_NODE_RATE = -_J2_FACTOR * _MEAN_MOTION * math.cos(_INCLINATION)
_ARGUMENT_RATE = _MEAN_MOTION * (1.0 + _J2_FACTOR * (3.0 - 4.0 * math.sin(_INCLINATION) ** 2))


def check_start(start_gps_seconds: float) -> None:
    """Raise UsageError unless the start time [GPS s] is finite."""
    if not math.isfinite(start_gps_seconds):
        raise UsageError(f"start_gps_seconds: {start_gps_seconds} is not a finite time")


def circular_positions(argument: Float64, node: Float64, radius: float, inclination: float) -> Float64:
    """Return Earth-fixed positions (..., 3) [m] on circular orbits, from argument of latitude and node [rad].

    Args:
        argument: of latitude (...) [rad].
        node: Earth-fixed longitude of the ascending node (...) [rad].
        radius: [m].
        inclination: [rad].
    """
    cos_u, across = np.cos(argument), np.sin(argument) * math.cos(inclination)
    cos_node, sin_node = np.cos(node), np.sin(node)
    return radius * np.stack(
        (
            cos_u * cos_node - across * sin_node,
            cos_u * sin_node + across * cos_node,
            np.sin(argument) * math.sin(inclination),
        ),
        axis=-1,
    )


def circular_orbits(
    angles: tuple[Float64, Float64], rates: tuple[float, float], radius: float, inclination: float, site: Site
) -> KeplerOrbits:
    """Return S circular orbits as seen from a site, from (argument of latitude, node) [rad] and their rates [rad/s].

    Args:
        angles: argument of latitude and Earth-fixed longitude of the node (S,) at tick 0 [rad].
        rates: of these [rad/s].
        radius: [m].
        inclination: [rad].
        site: where the signals are received.
    """
    like = np.ones_like(angles[0])
    return record_of(
        KeplerOrbits,
        Phase.of(angles[0], rates[0] * like),
        Phase.of(angles[1], rates[1] * like),
        radius * like,
        math.cos(inclination) * like,
        math.sin(inclination) * like,
        Vec3(*site.origin_ecef()),
        *(Vec3(*axis) for axis in site.ned_from_ecef_rotation()),
    )


@record
class NominalConstellation(Ephemeris):
    """The nominal GPS constellation: 24 slots in 6 planes, circular orbits, secular J2 rates; any time.

    It has the geometry of GPS, not today's satellites; UT1 - UTC, precession and polar motion are left out.
    """

    @property
    def satellites(self) -> tuple[str, ...]:
        """Names of the 24 orbital slots, A1 to F4."""
        return tuple(f"{plane}{slot}" for plane, (_, slots) in _PLANES.items() for slot in range(1, len(slots) + 1))

    @property
    def span_gps_seconds(self) -> tuple[float, float]:
        """First and last time [GPS s] with satellite positions: minus and plus infinity."""
        return -math.inf, math.inf

    def positions_ecef(self, gps_seconds: npt.ArrayLike) -> Float64:
        """Return the 24 satellites' Earth-fixed positions (..., 24, 3) [m] at times (...) [GPS s].

        Rounding is below 0.01 m until 2100.
        """
        argument, node = self._angles(np.asarray(gps_seconds, np.float64)[..., None])
        return circular_positions(argument, node, _SEMI_MAJOR_AXIS, _INCLINATION)

    @property
    def satellite_ids(self) -> npt.NDArray[np.uint32]:
        """Numbers (24,) of the slots from 0, with an upper byte that distinguishes them from PRNs."""
        return np.arange(len(self.satellites), dtype=np.uint32) * np.uint32(256)

    def at(
        self, site: Site, start_gps_seconds: float, dtype: npt.DTypeLike, duration_s: float = math.inf
    ) -> KeplerOrbits:
        """Return the orbits of the satellites in a run, as seen from a site.

        Args:
            site: where the signals are received.
            start_gps_seconds: time of tick 0 [GPS s].
            dtype: float32 or float64, the run's precision.
            duration_s: not needed, these orbits last.

        Raises:
            UsageError: the start is not finite.
        """
        check_start(start_gps_seconds)
        argument, node = self._angles(np.array([start_gps_seconds]))
        rates = _ARGUMENT_RATE, _NODE_RATE - EARTH_ROTATION_RATE
        return cast(circular_orbits((argument, node), rates, _SEMI_MAJOR_AXIS, _INCLINATION, site), dtype)

    @staticmethod
    def _angles(gps_seconds: Float64) -> tuple[Float64, Float64]:
        """Return argument of latitude and Earth-fixed node longitude (..., 24) [rad] at times (..., 1) [GPS s]."""
        age = gps_seconds - _EPOCH_GPS_SECONDS
        slots = np.radians([angle for _, angles in _PLANES.values() for angle in angles])
        planes = np.radians([ascension for ascension, angles in _PLANES.values() for _ in angles])
        node = planes - _EPOCH_GREENWICH_RAD + (_NODE_RATE - EARTH_ROTATION_RATE) * age
        return slots + _ARGUMENT_RATE * age, node


def elevation_azimuth(satellites_ned: npt.ArrayLike) -> tuple[Float64, Float64]:
    """Return elevations and azimuths (...) [rad] of positions (..., 3) NED; azimuths clockwise from north, 0 to 2 pi.

    Args:
        satellites_ned: satellite minus receiver, in NED, in any unit.
    """
    north, east, down = np.moveaxis(_vectors("satellites_ned", satellites_ned), -1, 0)
    return np.arctan2(-down, np.hypot(north, east)), np.arctan2(east, north) % (2.0 * math.pi)


def dilution_of_precision(line_of_sight_ned: npt.ArrayLike) -> tuple[float, float, float, float]:
    """Return (HDOP, VDOP, PDOP, TDOP) for unit vectors to satellites: fix stds for range errors of std 1.

    Args:
        line_of_sight_ned: (S, 3) unit vectors from the receiver to the satellites used.

    Raises:
        UsageError: fewer than 4 satellites, vectors that are not of length 1, or a geometry that gives no fix.
    """
    directions = _vectors("line_of_sight_ned", line_of_sight_ned)
    if directions.ndim != 2 or len(directions) < 4:
        raise UsageError(f"line_of_sight_ned: at least 4 satellites needed, as (S, 3); got shape {directions.shape}")
    lengths = np.linalg.norm(directions, axis=-1)
    if not np.all(np.abs(lengths - 1.0) < 1e-3):
        raise UsageError(f"line_of_sight_ned: expected unit vectors, got lengths {lengths.min()} to {lengths.max()}")
    design = np.column_stack((-directions, np.ones(len(directions))))
    if np.linalg.matrix_rank(design) < 4:
        raise UsageError("line_of_sight_ned: the satellites lie on a cone around the receiver, which gives no fix")
    variance = np.diag(np.linalg.inv(design.T @ design))
    pdop = math.sqrt(variance[:3].sum())
    return math.sqrt(variance[0] + variance[1]), math.sqrt(variance[2]), pdop, math.sqrt(variance[3])


def _vectors(name: str, values: npt.ArrayLike) -> Float64:
    """Return an array (..., 3) as float64; raise UsageError, naming the argument ``name``, for other shapes."""
    array = np.asarray(values, np.float64)
    if array.ndim == 0 or array.shape[-1] != 3:
        raise UsageError(f"{name}: expected an array of shape (..., 3), got {array.shape}")
    return array
