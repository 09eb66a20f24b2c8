"""Colour of vehicles and paths by a quantity of a recorded run: its values, its range, and the colour map."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.errors import RunError, UsageError, did_you_mean
from qrsim.runs import Run
from qrsim.runs.colours import GREY, on_scale
from qrsim.runs.quantities import readable_quantities
from qrsim.view.columns import Columns, vector
from qrsim.view.truth import AXES

# Percentiles of all values between which the colours run: a spike does not make everything else one colour.
LOW, HIGH = 1.0, 99.0
# Steps of the colour map that are kept; its colours lie on straight lines between them to within a step of sRGB.
STEPS = 33
POSITION = "position_ned"


@dataclass(frozen=True)
class Paint:
    """One quantity as colours, with the same range for the whole run.

    Attributes:
        title: the quantity.
        unit: of its values, "" if it has none.
        low, high: values of the first and of the last colour; values beyond have these colours too.
        beyond: whether any value is below ``low``, and whether any is above ``high``.
        values: returns the values (K, n) at times (K,) [s]; NaN where there are none.
    """

    title: str
    unit: str
    low: float
    high: float
    beyond: tuple[bool, bool]
    values: Callable[[Floats], Floats]

    def colours(self, times: Floats) -> Floats:
        """Return the vehicles' colours (K, n, 3), sRGB, at times (K,) [s]; grey where the quantity has no value."""
        found = self.values(times)
        part = (found - self.low) / max(self.high - self.low, 1e-30)
        known = np.isfinite(part)
        colours = on_scale(colour_map(), np.where(known, part, 0.0).ravel()).reshape(*part.shape, 3)
        return np.where(known[..., None], colours, GREY).astype(np.uint8)

    def told(self) -> dict[str, object]:
        """Return the content of the colour bar for JSON: title, unit, range and colours."""
        below, above = self.beyond
        ends = [("\u2264 " if below else "") + f"{self.low:.3g}", ("\u2265 " if above else "") + f"{self.high:.3g}"]
        title = f"{self.title} [{self.unit}]" if self.unit not in ("", "1") else self.title
        return {"title": title, "ends": ends, "colours": colour_map().astype(int).tolist()}


@lru_cache(maxsize=1)
def colour_map() -> Floats:
    """Return the colour map viridis as colours (STEPS, 3), sRGB 0 to 255, from low to high."""
    from matplotlib import colormaps

    return np.round(255.0 * colormaps["viridis"](np.linspace(0.0, 1.0, STEPS))[:, :3])


class Paints:
    """The quantities of a run that vehicles and paths can be coloured by.

    Args:
        run: what was recorded.

    Attributes:
        names: first those that are computed from several columns, then all columns that are numbers.
    """

    def __init__(self, run: Run):
        self._run = run
        self._columns = {
            item.name: (item.stream, item.column)
            for item in readable_quantities(run)
            if item.column.dtype.startswith(("float", "int", "uint", "bool"))
        }
        self._computed: dict[str, Callable[[], _Recipe]] = {}
        # Of a damaged stream nothing is computed.
        with suppress(RunError):
            self._computed = {name: make for name, make in self._derived().items() if make is not None}
        self.names = [*self._computed, *self._columns]
        self._kept: dict[str, Paint] = {}

    def of(self, name: str) -> Paint:
        """Return how vehicles are coloured by the quantity ``name``: its title, unit, range and values.

        Raises:
            UsageError: the run has no such quantity.
        """
        if name not in self._kept:
            if name not in self.names:
                raise UsageError(f"--colour {name}: no such quantity{did_you_mean(name, self.names)}")
            # One is as large as a column of the log.
            self._kept.clear()
            self._kept[name] = self._made(name)
        return self._kept[name]

    def _made(self, name: str) -> Paint:
        """Read or compute a quantity, and return its colours with a range over all vehicles and times."""
        if name in self._computed:
            unit, stream, columns, compute = self._computed[name]()
        else:
            stream, column = self._columns[name]
            unit, columns = column.unit, {"value": (column.name,)}
            compute = lambda parts, time: parts["value"][..., 0]  # noqa: E731
        read = Columns(self._run, stream, columns)
        series = compute({part: read.at(part, read.time) for part in columns}, read.time).astype(np.float32)
        finite = series[np.isfinite(series)]
        low, high = map(float, np.percentile(finite, [LOW, HIGH])) if len(finite) else (0.0, 1.0)
        least, most = (float(finite.min()), float(finite.max())) if len(finite) else (low, high)
        time = read.time

        def values(times: Floats) -> Floats:
            """Return the last values (K, n) up to each time (K,) [s]."""
            if not len(time):
                return np.full((len(times), len(self._run.vehicles)), np.nan)
            return series[np.maximum(0, np.searchsorted(time, np.asarray(times) + 1e-6, side="right") - 1)]

        return Paint(name, unit, low, high, (least < low, most > high), values)

    # ---- quantities that are computed ----

    def _derived(self) -> dict[str, Callable[[], _Recipe] | None]:
        """Return quantity -> function that prepares its computation; None if the run lacks a column for it."""
        run = self._run
        speed = vector(run, "truth", "velocity_body", AXES)
        mean, gust = (vector(run, "wind", f"{part}_ned", AXES) for part in ("mean", "gust"))
        measured = run["measurements"].columns() if "measurements" in run else ()
        ending = f".{POSITION}.x"
        sensor = next((name.removesuffix(ending) for name in measured if name.endswith(ending)), None)
        fix = vector(run, "measurements", f"{sensor}.{POSITION}", AXES) if sensor else None
        believed = vector(run, "commands", f"estimate.{POSITION}", AXES)
        down = "truth" in run and f"{POSITION}.z" in run["truth"]
        return {
            "speed": (lambda: ("m/s", "truth", {"v": speed}, _length)) if speed else None,
            "height": (lambda: ("m", "truth", {"z": (f"{POSITION}.z",)}, _upwards)) if down else None,
            "wind speed": (lambda: ("m/s", "wind", {"mean": mean, "gust": gust}, _length)) if mean and gust else None,
            "gust speed": (lambda: ("m/s", "wind", {"gust": gust}, _length)) if gust else None,
            "GNSS error": (lambda: ("m", "measurements", {"at": fix}, self._error)) if fix else None,
            "estimate error": (lambda: ("m", "commands", {"at": believed}, self._error)) if believed else None,
        }

    def _error(self, parts: dict[str, Floats], time: Floats) -> Floats:
        """Return the distance (T, n) [m] between the positions in ``parts`` and the true ones at times (T,) [s]."""
        true = Columns(self._run, "truth", {"at": vector(self._run, "truth", POSITION, AXES)})
        return np.linalg.norm(parts["at"] - true.at("at", time), axis=-1)


_Compute = Callable[[dict[str, Floats], Floats], Floats]
# Unit, stream, columns of each vector, and the function of the vectors and their times.
_Recipe = tuple[str, str, dict[str, tuple[str, ...]], _Compute]


def _length(parts: dict[str, Floats], time: Floats) -> Floats:
    """Return the length (T, n) of the sum of the vectors in ``parts``."""
    return np.linalg.norm(sum(parts.values()), axis=-1)


def _upwards(parts: dict[str, Floats], time: Floats) -> Floats:
    """Return the height (T, n) [m] from a down coordinate in ``parts``."""
    return -parts["z"][..., 0]


class JoinedPaints:
    """The quantities of several runs, with one range for all of them.

    Args:
        parts: of each run its quantities, how much later it is shown [s], and its number of vehicles.

    Attributes:
        names: those of the first run.
    """

    def __init__(self, parts: list[tuple[Paints, float, int]]):
        self._parts, self.names = parts, parts[0][0].names

    def of(self, name: str) -> Paint:
        """Return the colours of a quantity for the vehicles of all runs; grey for runs without it.

        Raises:
            UsageError: the first run has no such quantity.
        """
        first = self._parts[0][0].of(name)
        found = [(own.of(name) if name in own.names else None, shift, size) for own, shift, size in self._parts]
        known = [paint for paint, _, _ in found if paint is not None]
        low, high = min(paint.low for paint in known), max(paint.high for paint in known)

        def values(times: Floats) -> Floats:
            """Return the last values (K, n) of all runs' vehicles up to each time (K,) [s]."""
            times = np.asarray(times)
            nothing = np.full((len(times), 1), np.nan)
            parts = [
                np.repeat(nothing, size, axis=1) if paint is None else paint.values(times - shift)
                for paint, shift, size in found
            ]
            return np.concatenate(parts, axis=1)

        beyond = (any(paint.beyond[0] for paint in known), any(paint.beyond[1] for paint in known))
        return Paint(first.title, first.unit, low, high, beyond, values)
