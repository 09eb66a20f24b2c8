"""Colour of vehicles and paths by a quantity of a live flight: its values are kept from when it is chosen."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.view.frame import Frame
from qrsim.view.paint import Paint
from qrsim.view.paths import LENGTH_S

# Values that are kept, over the last minute.
MOST_KEPT = 600
# The range of the colours grows in steps of this part of it, so that paths are rarely coloured again.
STEP = 0.25


def _speed(frame: Frame) -> Floats:
    """Return the ground speeds (n,) [m/s] of the vehicles in a frame; NaN where unknown."""
    return np.full(len(frame.valid), np.nan) if frame.details is None else _length(frame.details().velocity_ned)


def _length(vectors: Floats) -> Floats:
    """Return the lengths (n,) of vectors (n, 3)."""
    return np.asarray(np.linalg.norm(vectors, axis=1))


# Name, unit, and the values (n,) in a frame.
QUANTITIES: dict[str, tuple[str, Callable[[Frame], Floats]]] = {
    "speed": ("m/s", _speed),
    "height": ("m", lambda frame: -frame.position_ned[:, 2]),
    "wind speed": ("m/s", lambda frame: _length(frame.wind_ned + frame.gust_ned)),
    "gust speed": ("m/s", lambda frame: _length(frame.gust_ned)),
    "GNSS error": ("m", lambda frame: _length(frame.ghost_ned - frame.position_ned)),
    "estimate error": ("m", lambda frame: _length(frame.estimate_ned - frame.position_ned)),
}


class LivePaints:
    """The quantities of a live flight that vehicles and paths can be coloured by.

    Args:
        size: number of vehicles.

    Attributes:
        names: of the quantities.
    """

    def __init__(self, size: int):
        self.names = list(QUANTITIES)
        self._size, self._name = size, ""
        self._paint: Paint | None = None
        self._kept: deque[tuple[float, Floats]] = deque(maxlen=MOST_KEPT)

    def of(self, name: str) -> Paint:
        """Start keeping the values of a quantity by name, and return its colours (range 0 to 1 at first)."""
        self._name = name
        self._kept.clear()
        return self._made(0.0, 1.0)

    def note(self, frame: Frame, shown: Paint | None) -> Paint | None:
        """Keep a frame's values; return new colours at first, and for values beyond ``shown``'s range; else None.

        Args:
            frame: the newest one.
            shown: colours of the page; nothing is kept unless they are of this flight.
        """
        if shown is None or shown is not self._paint:
            return None
        values = np.asarray(QUANTITIES[self._name][1](frame), np.float32)
        first = not self._kept
        if self._kept and frame.time < self._kept[-1][0]:
            self._kept.clear()
        # The newest is always kept, and closer to it than this nothing else.
        if len(self._kept) > 1 and self._kept[-1][0] - self._kept[-2][0] < LENGTH_S / MOST_KEPT:
            self._kept.pop()
        self._kept.append((frame.time, values))
        known = values[np.isfinite(values)]
        if not len(known):
            return None
        low, high = float(known.min()), float(known.max())
        if first:
            return self._made(*_rounded(low, high))
        if low >= shown.low and high <= shown.high:
            return None
        return self._made(*_rounded(min(low, shown.low), max(high, shown.high)))

    def _made(self, low: float, high: float) -> Paint:
        """Return the colours of the chosen quantity, with a colour range from ``low`` to ``high``."""
        kept = self._kept

        def values(times: Floats) -> Floats:
            """Return the last kept values (K, n) up to each time (K,) [s]; NaN before the first one."""
            found = list(kept)
            if not found:
                return np.full((len(times), self._size), np.nan)
            rows = np.searchsorted([time for time, _ in found], np.asarray(times) + 1e-6, side="right") - 1
            each = np.stack([own for _, own in found])[np.maximum(0, rows)]
            return np.where(rows[:, None] < 0, np.nan, each)

        self._paint = Paint(self._name, QUANTITIES[self._name][0], low, high, (False, False), values)
        return self._paint


def _rounded(low: float, high: float) -> tuple[float, float]:
    """Return a value range rounded outwards to STEP times a power of ten, and never empty."""
    step = STEP * 10.0 ** math.floor(math.log10(max(high - low, 1e-3)))
    found = step * math.floor(low / step), step * math.ceil(high / step)
    return found if found[1] > found[0] else (found[0], found[0] + step)
