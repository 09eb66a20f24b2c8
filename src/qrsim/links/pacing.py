"""Simulated time against the wall clock."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

from qrsim.errors import UsageError

# A client that stays behind for longer has paused: the clock starts anew rather than to hurry after it.
LONGEST_DELAY_S = 0.25
SLOWEST, FASTEST = 1e-3, 1e3


def checked_factor(factor: float) -> float:
    """Check a real-time factor (simulated seconds per wall second; 0: lock-step) and return it; raises UsageError.

    Raises:
        UsageError: it is out of range.
    """
    if factor == 0.0 or (math.isfinite(factor) and SLOWEST <= factor <= FASTEST):
        return factor
    raise UsageError(f"real-time factor {factor:g}; allowed: {SLOWEST:g} to {FASTEST:g}, or 0 for lock-step")


@dataclass(frozen=True)
class PaceReport:
    """How a pace was kept.

    Attributes:
        factor: simulated seconds per second of the wall clock; 0: lock-step.
        steps, overruns: steps, and those of them that were late.
        worst_delay: of a late step [s].
        simulated, wall: seconds since the start.
    """

    factor: float
    steps: int
    overruns: int
    worst_delay: float
    simulated: float
    wall: float


class Pacer:
    """Schedules the states of simulated times on the wall clock.

    A STEP is late (an overrun) where its state is ready only after that: because the simulation was slower than its
    pace, or because the client asked late.

    Args:
        factor: simulated seconds per second of the wall clock; 0: always at once.
        simulated: simulated time now [s].
        clock: returns the wall time [s].
    """

    def __init__(self, factor: float, simulated: float, clock: Callable[[], float] = time.perf_counter):
        self.factor = checked_factor(factor)
        self._clock = clock
        self._begin = self._anchor = (simulated, clock())
        self._last = simulated
        self.steps = self.overruns = 0
        self.worst_delay = 0.0

    def wait_s(self, simulated: float) -> float:
        """Count a step that ends at a simulated time [s]; return how long [s] to wait before the reply, 0 if it is
        late."""
        self.steps += 1
        self._last = simulated
        if not self.factor:
            return 0.0
        until = self.until_s(simulated)
        self._note_delay(simulated, -until, 0.0)
        return max(0.0, until)

    def until_s(self, simulated: float) -> float:
        """Return the wall time [s] left until a simulated time [s] is due; negative if it is late."""
        return self._anchor[1] + (simulated - self._anchor[0]) / self.factor - self._clock()

    def _note_delay(self, simulated: float, delay: float, allowed: float) -> None:
        """Count an overrun of the pace if ``delay`` [s] exceeds ``allowed`` [s]; a very long delay restarts the
        schedule."""
        if delay <= allowed:
            return
        self.overruns += 1
        self.worst_delay = max(self.worst_delay, delay)
        if delay > LONGEST_DELAY_S:
            self._anchor = (simulated, self._clock())

    def restarted(self) -> None:
        """Restart the count of simulated time at 0, after a reset of the simulation."""
        self._begin = (self._begin[0] - self._last, self._begin[1])
        self._anchor = (0.0, self._clock())
        self._last = 0.0

    def report(self) -> PaceReport:
        """Return the statistics of the pace: real-time factor, overruns and delays so far."""
        return PaceReport(
            factor=self.factor,
            steps=self.steps,
            overruns=self.overruns,
            worst_delay=self.worst_delay,
            simulated=self._last - self._begin[0],
            wall=self._clock() - self._begin[1],
        )


class Metronome(Pacer):
    """Schedules the ticks of a world that runs by itself.

    A tick is late (an overrun) where its state is ready only when the next one is due already.

    Args:
        factor: simulated seconds per second of the wall clock, above 0.
        simulated: simulated time now [s].
        time_step: of a tick [s].
        clock: returns the wall time [s].
    """

    def __init__(
        self, factor: float, simulated: float, time_step: float, clock: Callable[[], float] = time.perf_counter
    ):
        if factor == 0.0:
            raise UsageError("real-time factor 0: a world that runs by itself needs one above 0")
        super().__init__(factor, simulated, clock)
        self._period = time_step / factor

    def ended(self, simulated: float) -> None:
        """Count a tick, for the statistics of the pace, when its state at a simulated time [s] has been sent."""
        self.steps += 1
        self._last = simulated
        self._note_delay(simulated, -self.until_s(simulated), self._period)
