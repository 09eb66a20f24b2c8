"""What one vehicle knows of itself at a tick."""

from __future__ import annotations

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.links.contracts import Order
from qrsim.links.mavlink.stack.contracts import NAN, Seen, Stack, Triple
from qrsim.links.shared import sight as s
from qrsim.links.shared.around import Around
from qrsim.models.geoid import GeoidPlane


class View:
    """What the messages of one vehicle are made of, at a tick.

    Attributes:
        numbers: of it (``shared.sight``), of which ``row`` makes a list when a message needs them.
        seen: what its stack sees.
        stack: its flight stack.
        order: what it flies by.
        fresh: whether a fix has arrived at this tick.
        fix_time: when its last fix was true [s].
        unix: when the scenario starts, in seconds since 1970.
        load: share of a tick's time that computing takes, in 1/1000.
        truth: true state, for HIL_STATE_QUATERNION: quaternion, rates, latitude, longitude, altitude, velocity NED,
            airspeed, specific force; else None.
        geoid: surface that altitudes are measured from.
        around: what it perceives, by its row ``number`` in the world; None where nothing does.
        turn: which of the other vehicles that it sees was sent last.
    """

    def __init__(self, stack: Stack, unix: float):
        self.stack, self.unix = stack, unix
        self.numbers = np.full(s.WIDTH, NAN)
        self._row: list[float] | None = None
        self.seen = Seen()
        self.order: Order | None = None
        self.fresh = False
        self.fix_time = 0.0
        self.load = 0
        self.truth: tuple[float, ...] | None = None
        self.geoid = GeoidPlane()
        self.around: Around | None = None
        self.number = self.turn = 0

    def look(self, numbers: NumpyArray) -> None:
        """Set the vehicle's readings (WIDTH,) of the present tick."""
        self.numbers, self._row = numbers, None

    @property
    def row(self) -> list[float]:
        """Readings of the vehicle as a list of floats, cached for the tick."""
        if self._row is None:
            self._row = self.numbers.tolist()
        return self._row

    def local(self, position_ned: Triple) -> Triple:
        """Convert a position from the site's frame NED [m] to the vehicle's local frame."""
        (north, east, down), origin = position_ned, self.stack.origin
        return north - origin[0], east - origin[1], down - origin[2]

    @property
    def height(self) -> float:
        """Estimated height above the ellipsoid [m]."""
        return self.seen.altitude + self.geoid.undulation(*self.seen.position_ned[:2])

    @property
    def fix_altitude(self) -> float:
        """Altitude above mean sea level of the last fix [m]."""
        return self.row[s.FIX_PLACE + 2] - self.geoid.undulation(*self.row[s.FIX_POSITION : s.FIX_POSITION + 2])

    @property
    def boot_ms(self) -> int:
        """Simulated time since the reset [ms]."""
        return int(self.seen.time * 1e3 + 0.5) & 0xFFFFFFFF

    @property
    def boot_us(self) -> int:
        """Simulated time since the reset [us]."""
        return int(self.seen.time * 1e6 + 0.5)

    @property
    def home_altitude(self) -> float:
        """Altitude of home above mean sea level [m]; the vehicle's own altitude before there is a home."""
        home = self.stack.home
        return self.seen.altitude if home is None else home.altitude
