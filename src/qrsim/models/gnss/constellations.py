"""The nominal constellations of GPS, Galileo, GLONASS and BeiDou, which need no file.

See docs/explanation/models/gnss.md.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from qrsim.core.tree import cast, record, record_of, setting
from qrsim.errors import UsageError, nearest
from qrsim.models.gnss.orbits import (
    EARTH_GRAVITY,
    EARTH_J2,
    EARTH_RADIUS,
    EARTH_ROTATION_RATE,
    Ephemeris,
    KeplerOrbits,
    NominalConstellation,
    Phase,
    check_start,
    circular_orbits,
    circular_positions,
)
from qrsim.models.site import Float64, Site

# Letters of RINEX, in the order in which the systems are numbered.
SYSTEMS = {"G": "GPS", "E": "Galileo", "R": "GLONASS", "C": "BeiDou"}
# 2016-11-21 00:00 UTC is 13469 days and 17 leap seconds after the GPS epoch; Greenwich's mean sidereal angle then.
_EPOCH_GPS_SECONDS = 13469 * 86400.0 + 17.0
_EPOCH_GREENWICH_DEG = 60.426397


class Walker(NamedTuple):
    """A Walker delta pattern 24/3/1 of circular orbits at the epoch 2016-11-21 00:00 UTC.

    Attributes:
        radius: of the orbits [m].
        inclination_deg: of the orbits [deg].
        node_deg: right ascension of the ascending node of plane A [deg]; the planes are 120 deg apart.
        argument_deg: argument of latitude of its first slot [deg]; 45 deg to the next, 15 deg more in the next plane.
        published: secular rates of argument and node [deg/day]; None: by J2.
    """

    radius: float
    inclination_deg: float
    node_deg: float
    argument_deg: float
    published: tuple[float, float] | None = None


PLANES, SLOTS = 3, 8
# - Galileo: all numbers are those of the reference constellation of the European GNSS Service Centre, "orbital and
#   technical parameters" (slot A02 has node 317.632 and argument 225.153 deg).
# - GLONASS: ICD 5.1, section 5.2: 64.8 deg, period 11 h 15 min 44 s. BeiDou: Open Service Performance Standard 3.0,
#   section 4.1: 21528 km high, 55 deg. No epoch is published for either: where the first slot stands is ours.
WALKERS = {
    "E": Walker(29599800.0, 56.0, 317.632, 180.153, (613.72253566, -0.02764398)),
    "R": Walker(25508000.0, 64.8, 100.0, 20.0),
    "C": Walker(27906000.0, 55.0, 140.0, 7.0),
}


def check_systems(systems: str, what: str = "systems") -> None:
    """Raise UsageError unless ``systems`` has letters of satellite systems (such as "GE"), each at most once."""
    known = ", ".join(f"{letter} ({name})" for letter, name in SYSTEMS.items())
    wrong = [letter for letter in systems if letter not in SYSTEMS]
    if wrong or not systems:
        names = {name: letter for letter, name in SYSTEMS.items()}
        match = nearest(systems, [*names, "GERC"])
        hint = f"; did you mean '{names.get(match, match)}'?" if match else ""
        raise UsageError(f"{what}: '{systems}' does not consist of letters of satellite systems: {known}{hint}")
    if len(set(systems)) != len(systems):
        raise UsageError(f"{what}: '{systems}' names a system twice; allowed: each of {', '.join(SYSTEMS)} once")


def satellite_name(number: int) -> str:
    """Return a satellite's name by its number (``satellite_ids``): G05 if from a file, G-A1 if nominal."""
    letter, middle = number >> 16, (number >> 8) & 0xFF
    if letter or middle < ord("A"):
        # The constellation of GPS alone has no letters in its numbers.
        return NominalConstellations(chr(letter or ord("G"))).satellites[middle]
    return f"{chr(middle)}{number & 0xFF:02}"


@record
class NominalConstellations(Ephemeris):
    """Nominal constellations of GPS, Galileo, GLONASS and BeiDou: circular orbits, secular J2 rates; any time.

    They have the geometry of the systems, not today's satellites: GPS as ``nominal_constellation``, the others as
    Walker patterns 24/3/1. How GLONASS and BeiDou stand against the others is arbitrary, because no epoch is published.
    BeiDou's six satellites over Asia are left out.
    """

    systems: str = setting(default="GERC", doc="letters of the systems: G (GPS), E (Galileo), R (GLONASS), C (BeiDou)")

    def __post_init__(self) -> None:
        """Check the letters; raises UsageError."""
        check_systems(self.systems)

    @property
    def satellites(self) -> tuple[str, ...]:
        """Names of the satellites from system letter, plane and slot, such as G-A1."""
        gps = NominalConstellation().satellites
        walker = [f"{'ABC'[plane]}{slot + 1}" for plane in range(PLANES) for slot in range(SLOTS)]
        return tuple(f"{letter}-{slot}" for letter in self._letters for slot in (gps if letter == "G" else walker))

    @property
    def system_of(self) -> str:
        """GNSS system letter of each of the S satellites, as text, such as G for GPS."""
        return "".join(name[0] for name in self.satellites)

    @property
    def satellite_ids(self) -> npt.NDArray[np.uint32]:
        """Number (S,) of each satellite, the same whichever systems are simulated; the lower byte, of PRNs, is 0."""
        numbers = np.arange(24, dtype=np.uint32) * np.uint32(256)
        return np.concatenate([numbers + np.uint32(ord(letter) << 16) for letter in self._letters])

    @property
    def span_gps_seconds(self) -> tuple[float, float]:
        """First and last time [GPS s] with satellite positions: minus and plus infinity."""
        return -math.inf, math.inf

    def positions_ecef(self, gps_seconds: npt.ArrayLike) -> Float64:
        """Return the S satellites' Earth-fixed positions (..., S, 3) [m] at times (...) [GPS s]."""
        times = np.asarray(gps_seconds, np.float64)
        found = []
        for letter in self._letters:
            if letter == "G":
                found.append(NominalConstellation().positions_ecef(times))
                continue
            argument, node, (_, _, inclination) = _angles(WALKERS[letter], times[..., None])
            found.append(circular_positions(argument, node, WALKERS[letter].radius, inclination))
        return np.concatenate(found, axis=-2)

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
        parts = [self._orbits(letter, site, start_gps_seconds) for letter in self._letters]
        first = parts[0]
        joined = {
            name: _joined([getattr(part, name) for part in parts])
            for name in ("argument", "node", "radius", "cos_inclination", "sin_inclination")
        }
        orbits = KeplerOrbits(
            **joined, origin_ecef=first.origin_ecef, north=first.north, east=first.east, down=first.down
        )
        return cast(orbits, dtype)

    def _orbits(self, letter: str, site: Site, start: float) -> KeplerOrbits:
        """Return the orbits of one system's satellites from ``start`` [GPS s], by its letter, in float64."""
        if letter == "G":
            return NominalConstellation().at(site, start, np.float64)
        argument, node, (*rates, inclination) = _angles(WALKERS[letter], np.array([start]))
        return circular_orbits((argument, node), (rates[0], rates[1]), WALKERS[letter].radius, inclination, site)

    @property
    def _letters(self) -> tuple[str, ...]:
        """GNSS system letters in use, in the order of the systems' numbers."""
        return tuple(letter for letter in SYSTEMS if letter in self.systems)


def _angles(pattern: Walker, gps_seconds: Float64) -> tuple[Float64, Float64, tuple[float, float, float]]:
    """Return argument of latitude and Earth-fixed node longitude [rad], and (both rates [rad/s], inclination [rad]).

    Times (..., 1) give angles (..., 24). Secular rates of a circular orbit: Brouwer 1959, first order.
    """
    inclination = math.radians(pattern.inclination_deg)
    motion = math.sqrt(EARTH_GRAVITY / pattern.radius**3)
    factor = 1.5 * EARTH_J2 * (EARTH_RADIUS / pattern.radius) ** 2
    argument_rate = motion * (1.0 + factor * (3.0 - 4.0 * math.sin(inclination) ** 2))
    node_rate = -factor * motion * math.cos(inclination)
    if pattern.published is not None:
        argument_rate, node_rate = (math.radians(rate) / 86400.0 for rate in pattern.published)
    node_rate -= EARTH_ROTATION_RATE
    plane, slot = np.divmod(np.arange(PLANES * SLOTS), SLOTS)
    arguments = np.radians(pattern.argument_deg + 360.0 / SLOTS * slot + 360.0 / (PLANES * SLOTS) * plane)
    nodes = np.radians(pattern.node_deg + 360.0 / PLANES * plane - _EPOCH_GREENWICH_DEG)
    age = gps_seconds - _EPOCH_GPS_SECONDS
    return arguments + argument_rate * age, nodes + node_rate * age, (argument_rate, node_rate, inclination)


def _joined(parts: list[Any]) -> Any:
    """Return a list of arrays (S,), or of ``Phase`` records, concatenated."""
    if isinstance(parts[0], Phase):
        names = ("units", "units_per_s", "rest", "rest_per_s")
        joined = (np.concatenate([getattr(part, name) for part in parts]) for name in names)
        return record_of(Phase, *joined)
    return np.concatenate(parts)
