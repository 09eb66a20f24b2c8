"""Play, pause, step and speed of simulated time: read by one thread, changed by others."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Sequence

from qrsim.errors import UsageError

SPEEDS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, math.inf)
# Seconds between two looks at the clock: how often the page moves.
FRAME_S = 1.0 / 30.0
# Who was busy for longer than this falls behind.
LONGEST_S = 0.25


class Clock:
    """Paces simulated time against wall time.

    Args:
        speed: simulated seconds per second; infinite: as fast as can be.
        playing: whether time passes at first.
        speeds: that are offered.
        now: returns the wall time [s].
    """

    def __init__(
        self,
        speed: float = 1.0,
        playing: bool = True,
        speeds: Sequence[float] = SPEEDS,
        now: Callable[[], float] = time.perf_counter,
    ):
        self.speeds = tuple(speeds)
        self._now = now
        self._changed = threading.Condition()
        self._speed, self._playing, self._closed = checked_speed(speed), playing, False
        self._steps = 0
        # Up to when simulated time was let pass, and when somebody was last sent off.
        self._anchor = self._sent = now()

    @property
    def speed(self) -> float:
        """Simulated seconds that pass per real second."""
        return self._speed

    @speed.setter
    def speed(self, speed: float) -> None:
        """Set how many simulated seconds pass per second from now on."""
        with self._changed:
            self._speed, self._anchor = checked_speed(speed), self._now()
            self._changed.notify_all()

    @property
    def playing(self) -> bool:
        """Whether simulated time advances (not paused)."""
        return self._playing

    @playing.setter
    def playing(self, playing: bool) -> None:
        """Let simulated time advance, or pause it."""
        with self._changed:
            self._playing, self._anchor = playing, self._now()
            self._changed.notify_all()

    def step(self) -> None:
        """Let one time step of the simulation pass, then pause."""
        with self._changed:
            self._playing = False
            self._steps += 1
            self._changed.notify_all()

    def close(self) -> None:
        """Release all threads that wait for simulated time, which from now on passes as fast as possible."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def wait(self, step_s: float, most: int) -> int:
        """Wait until time steps of ``step_s`` [s] are due, and return how many, at most ``most``.

        What is too slow for the speed falls behind; it does not hurry after it later.

        Args:
            step_s: of the simulation [s].
            most: how many steps are done at a time.
        """
        with self._changed:
            while True:
                count = self._due(step_s, most)
                if count:
                    return count
                self._changed.wait(0.25 if not self._playing else max(0.001, self._missing(step_s)))

    def _due(self, step_s: float, most: int) -> int:
        """Return how many of at most ``most`` steps of ``step_s`` [s] are due now, and count them as taken."""
        if self._closed:
            return most
        if self._steps:
            self._steps -= 1
            return 1
        if not self._playing:
            return 0
        if math.isinf(self._speed):
            return most
        if self._missing(step_s) > 0.0:
            return 0
        now = self._now()
        self._sent = max(self._sent + FRAME_S, now - FRAME_S)
        count = int((now - self._anchor) * self._speed / step_s + 1e-9)
        limit = min(most, 1 + int(LONGEST_S * self._speed / step_s))
        self._anchor = now if count > limit else self._anchor + count * step_s / self._speed
        return min(count, limit)

    def _missing(self, step_s: float) -> float:
        """Return the real time [s] until the next frame and the next step of ``step_s`` [s] are due."""
        return max(self._sent + FRAME_S, self._anchor + step_s / self._speed) - self._now()


def checked_speed(speed: float) -> float:
    """Return a playback speed (simulated seconds per second); raise UsageError if it is out of range.

    Raises:
        UsageError: it is out of range.
    """
    if SPEEDS[0] <= speed <= SPEEDS[-2] or speed == math.inf:
        return speed
    raise UsageError(f"speed {speed:g}: expected {SPEEDS[0]:g} to {SPEEDS[-2]:g}, or inf for as fast as can be")
