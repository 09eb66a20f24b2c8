"""Signals of flight logs, by name, each in one SI unit."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from qrsim.errors import LogError

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Signal:
    """One quantity of a log.

    Attributes:
        unit: SI.
        doc: one sentence.
        command: held until the next sample rather than interpolated.
        largest: magnitudes above this are hardly in this unit.
    """

    unit: str
    doc: str
    command: bool = False
    largest: float = float("inf")


SIGNALS: dict[str, Signal] = {
    "roll": Signal("rad", "roll angle, right side down positive", largest=3.2),
    "pitch": Signal("rad", "pitch angle, nose up positive", largest=1.6),
    "yaw": Signal("rad", "yaw angle, clockwise from north seen from above", largest=400.0),
    "roll_rate": Signal("rad/s", "body rate p", largest=35.0),
    "pitch_rate": Signal("rad/s", "body rate q", largest=35.0),
    "yaw_rate": Signal("rad/s", "body rate r", largest=35.0),
    "velocity_north": Signal("m/s", "velocity over ground, north", largest=100.0),
    "velocity_east": Signal("m/s", "velocity over ground, east", largest=100.0),
    "velocity_down": Signal("m/s", "velocity over ground, down", largest=100.0),
    "thrust": Signal("N", "collective thrust, positive up", largest=5000.0),
    "roll_command": Signal("rad", "roll angle asked for", True, 1.6),
    "pitch_command": Signal("rad", "pitch angle asked for", True, 1.6),
    "yaw_rate_command": Signal("rad/s", "yaw rate asked for", True, 35.0),
    "throttle": Signal("1", "collective throttle, 0 to 1", True, 1.0001),
    "battery": Signal("V", "battery voltage", True, 100.0),
}
ANGLES = ("roll", "pitch", "yaw")


@dataclass(frozen=True)
class Track:
    """Samples of one signal as they were logged: ``time`` (n,) [s] and ``values`` (n,) in SI."""

    time: Floats
    values: Floats


@dataclass(frozen=True)
class FlightLog:
    """A log on one regular grid of time.

    Attributes:
        name: of the file, without its ending.
        source: the file.
        kind: its format in words.
        dt: step [s].
        time: (T,) since the first row [s].
        signals: by name, (T,) each in SI; NaN within gaps.
        notes: what reading did to the data, one sentence each.
        rates: by name, how often a signal was logged [Hz]; where it is known.
    """

    name: str
    source: Path
    kind: str
    dt: float
    time: Floats
    signals: dict[str, Floats]
    notes: list[str] = field(default_factory=list)
    rates: dict[str, float] = field(default_factory=dict)

    def require(self, names: Iterable[str], purpose: str) -> None:
        """Raise LogError if the log lacks one of the named signals; ``purpose`` says what needs them.

        Raises:
            LogError: names what is missing and lists what is there.
        """
        missing = [name for name in names if name not in self.signals]
        if missing:
            raise LogError(
                f"{self.source}: {purpose} needs {', '.join(missing)}, which this log ({self.kind}) has not;"
                f" there: {', '.join(self.signals)}"
            )

    def delayed(self, delay: float) -> FlightLog:
        """Return the log with commands delayed by ``delay`` [s], each the mean of the held command over its step.

        Args:
            delay: [s], at least 0; before the log's first row its first commands are held.
        """
        whole, part = divmod(delay / self.dt, 1.0)
        rows = np.arange(len(self.time)) - int(whole)
        later, earlier = np.maximum(rows, 0), np.maximum(rows - 1, 0)
        late = {
            name: values[later] + part * (values[earlier] - values[later]) if part else values[later]
            for name, values in self.signals.items()
            if SIGNALS[name].command and name != "battery"
        }
        return replace(self, signals=self.signals | late)
