"""How long a fit takes, told while it goes on."""

from __future__ import annotations

import time
from collections.abc import Callable

# The shortest time between two lines [s].
EVERY_S = 10.0
# Steps of a fit to the public recordings; a step is an evaluation of the residuals with their derivatives.
USUAL_STEPS = (15, 60)


class Pace:
    """Tells the time of a step once it is known, and from then on now and then how many are done.

    Args:
        seconds: of flight that is fitted.
        unknowns: how many are estimated.
        progress: is told.
        first: whether the program has yet to be compiled.
    """

    def __init__(self, seconds: float, unknowns: int, progress: Callable[[str], None], first: bool):
        self._progress, self._first = progress, first
        self._begun = self._told = time.perf_counter()
        self._ends: list[float] = []
        usually = ": half a minute to some minutes, compiling first" if first else ""
        progress(f"fitting {unknowns} numbers to {seconds:.0f} s of flight{usually}")

    def step(self) -> None:
        """Count one step of a fit, and print its progress if it is due."""
        now = time.perf_counter()
        self._ends.append(now)
        count = len(self._ends)
        if self._first and count <= 3:
            # The first step has the compiling in it.
            if count == 3:
                each = min(now - self._ends[1], self._ends[1] - self._ends[0])
                low, high = (_duration(steps * each) for steps in USUAL_STEPS)
                self._progress(
                    f"a step takes {each:.2g} s, so a fit of {USUAL_STEPS[0]} to {USUAL_STEPS[1]} steps {low} to "
                    f"{high}; it is repeated without the constants that the logs do not show"
                )
                self._told = now
        elif now - self._told > EVERY_S:
            self._progress(f"step {count}, {_duration(now - self._begun)}")
            self._told = now


def _duration(seconds: float) -> str:
    """Format a duration [s] as text, in seconds or minutes."""
    return f"{seconds:.0f} s" if seconds < 100.0 else f"{seconds / 60.0:.1f} min"
