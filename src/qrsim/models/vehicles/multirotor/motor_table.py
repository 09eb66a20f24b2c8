"""A motor and propeller from the table of a data sheet: throttle, thrust, rotor speed and electrical power."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.errors import UsageError, did_you_mean
from qrsim.files.csv_file import open_csv
from qrsim.files.csv_rows import name_and_unit
from qrsim.files.user_files import LARGEST_TEXT

STANDARD_GRAVITY = 9.80665
# Column -> quantity, and the factor to its unit: throttle 0 to 1, N, rad/s, W.
COLUMNS = {
    "throttle": ("throttle", 1.0),
    "throttle_percent": ("throttle", 0.01),
    "thrust_N": ("thrust", 1.0),
    "thrust_g": ("thrust", STANDARD_GRAVITY / 1000.0),
    "rpm": ("speed", math.pi / 30.0),
    "power_W": ("power", 1.0),
    "voltage_V": ("voltage", 1.0),
    "current_A": ("current", 1.0),
}
# Largest efficiency of a motor, shaft power over electrical power.
MOST_EFFICIENT = 0.9
# Speed of the tips at full throttle [m/s]; and the part of the electrical power that momentum theory accounts for.
TIP_SPEEDS, IDEAL_SHARES = (20.0, 340.0), (0.1, 1.1)
# Thrust over speed squared of a row, over that of the median row: at most this much, and at least 1 over it.
MOST_APART = 2.0
AIR_DENSITY = 1.225


@dataclass(frozen=True)
class MotorTable:
    """Columns (K,) by rising throttle, at sea level.

    Attributes:
        throttle: 0 to 1.
        thrust: of one propeller [N].
        speed: [rad/s].
        power: electrical power of one motor [W].
    """

    throttle: Floats
    thrust: Floats
    speed: Floats
    power: Floats

    @staticmethod
    def of(columns: object) -> MotorTable:
        """Return a motor table from columns by name (see COLUMNS), or from ``{"file": PATH}`` of a CSV file.

        Raises:
            UsageError: the file cannot be read, a column is missing, unknown or no numbers, or thrust does not rise
                with throttle.
        """
        if not isinstance(columns, Mapping):
            a_file = f"; a CSV file is {{file: {columns}}}" if isinstance(columns, str) else ""
            raise UsageError(f"expected columns by name ({', '.join(COLUMNS)}), found {columns!r:.80}{a_file}")
        if "file" in columns:
            if len(columns) > 1 or not isinstance(columns["file"], str):
                raise UsageError("file: expected the path of a CSV file, and no columns in addition")
            read = _columns_of(Path(columns["file"]))
            try:
                return MotorTable.of(read)
            except UsageError as error:
                raise UsageError(f"{columns['file']}: {error}") from None
        found: dict[str, Floats] = {}
        for name, values in columns.items():
            if name not in COLUMNS:
                raise UsageError(f"no column is called '{name}'{did_you_mean(str(name), COLUMNS)}")
            quantity, factor = COLUMNS[name]
            if quantity in found:
                raise UsageError(f"gives {quantity} twice; give one of its columns")
            found[quantity] = factor * _numbers(name, values)
            least = "above 0" if quantity in ("thrust", "speed") else "from 0"
            if len(values) and (values[0] < 0.0 or (values[0] == 0.0 and least == "above 0")):
                raise UsageError(f"{name} of row 1 is {values[0]:g}; allowed: {least}")
        volts, amperes = found.pop("voltage", None), found.pop("current", None)
        if "power" not in found and volts is not None and amperes is not None and len(volts) == len(amperes):
            found["power"] = volts * amperes
        for quantity in ("throttle", "thrust", "speed", "power"):
            if quantity == "power" and quantity not in found:
                raise UsageError("has no column power_W, nor voltage_V and current_A, from which it follows")
            if quantity not in found:
                raise UsageError(f"has no column {_names_of(quantity)}; found {', '.join(columns)}")
        return MotorTable(**found)._checked()

    def _checked(self) -> MotorTable:
        """Return this table if its columns are valid; raise UsageError if they are short, unequal or do not rise."""
        rows = {name: len(column) for name, column in vars(self).items()}
        if len(set(rows.values())) > 1:
            raise UsageError(f"columns of different lengths: {', '.join(f'{name} {n}' for name, n in rows.items())}")
        if len(self.throttle) < 2:
            rows_there = f"{len(self.throttle)} row{'s' * (len(self.throttle) != 1)}"
            raise UsageError(f"has {rows_there}; at least 2 are needed")
        for name, column in vars(self).items():
            falling = np.flatnonzero(np.diff(column) <= 0.0)
            if len(falling):
                row = int(falling[0]) + 2
                raise UsageError(f"{name} does not rise from row {row - 1} to row {row}")
        if self.throttle[-1] > 1.0:
            raise UsageError(
                f"throttle of row {len(self.throttle)} is {100 * self.throttle[-1]:g} %; allowed: up to 100"
            )
        return self

    def numbers(self, weight: float, rotors: int) -> dict[str, float]:
        """Return multirotor parameters and the hover point by name, for a weight [N] and a number of rotors.

        Returns:
            ``thrust_coefficient`` (least squares of thrust over speed squared), ``thrust_to_weight``, ``speed_max``,
            ``throttle_curve`` (least squares), ``hover_throttle``, and of one motor ``hover_power`` [W] and
            ``hover_speed`` [rad/s], between rows by a line.

        Raises:
            UsageError: it cannot hover with this table.
        """
        each = weight / rotors
        if each >= self.thrust[-1]:
            raise UsageError(
                f"{rotors} motors lift {rotors * self.thrust[-1]:.4g} N at most, and the vehicle weighs {weight:.4g} N"
                f"{' (thrust_g is in grams, mass in kg)' if weight > 100.0 * rotors * self.thrust[-1] else ''}"
            )
        square = self.speed**2
        coefficient = float(square @ self.thrust / (square @ square))
        most = float(self.thrust[-1])
        u, share = self.throttle / self.throttle[-1], self.thrust / most
        bend = u * u - u
        curve = float(np.clip(bend @ (share - u) / max(bend @ bend, 1e-12), 0.0, 1.0))
        speed = math.sqrt(each / coefficient)
        # Power goes with thrust to the power 3/2, so a line between rows is drawn over that.
        power = float(np.interp(each**1.5, self.thrust**1.5, self.power))
        return {
            "thrust_coefficient": coefficient,
            "thrust_to_weight": most / each,
            "speed_max": math.sqrt(most / coefficient),
            "throttle_curve": curve,
            "hover_throttle": float(np.interp(each, self.thrust, self.throttle)),
            "hover_power": power,
            "hover_speed": speed,
        }

    def oddities(self, radius: float) -> Iterator[str]:
        """Yield a warning for each row of the table that is implausible for a propeller of this radius [m].

        The radius may be a guess, so the ranges are wide.
        """
        tip = float(self.speed[-1]) * radius
        if not TIP_SPEEDS[0] <= tip <= TIP_SPEEDS[1]:
            yield (
                f"rpm of row {len(self.speed)} is {self.speed[-1] * 30.0 / math.pi:.4g}: the tips of a propeller of "
                f"radius {radius:.3g} m move at {tip:.3g} m/s; plausible: {TIP_SPEEDS[0]:g} to {TIP_SPEEDS[1]:g} m/s"
            )
        ideal = self.thrust**1.5 / math.sqrt(2.0 * AIR_DENSITY * math.pi * radius**2)
        share = ideal / np.maximum(self.power, 1e-9)
        for row in np.flatnonzero((share < IDEAL_SHARES[0]) | (share > IDEAL_SHARES[1]))[:1]:
            least, most = (float(ideal[row]) / limit for limit in reversed(IDEAL_SHARES))
            yield (
                f"power_W of row {row + 1} is {self.power[row]:.3g} W for {self.thrust[row]:.3g} N of thrust; with a "
                f"propeller of radius {radius:.3g} m plausible: {least:.3g} to {most:.3g} W"
            )
        lift = self.thrust / self.speed**2
        apart = lift / np.median(lift)
        for row in np.flatnonzero((apart > MOST_APART) | (apart < 1.0 / MOST_APART))[:1]:
            yield (
                f"thrust over rpm squared of row {row + 1} is {apart[row]:.3g} times that of the others; plausible: "
                f"{1.0 / MOST_APART:g} to {MOST_APART:g}"
            )


def _names_of(quantity: str) -> str:
    """Return a quantity's allowed column names as text, joined by "or"."""
    return " or ".join(name for name, (other, _) in COLUMNS.items() if other == quantity)


def _columns_of(path: Path) -> dict[str, list[float]]:
    """Return the columns of COLUMNS found in a CSV file, by name; other columns are ignored.

    A name may have its unit in brackets: ``thrust [g]`` is ``thrust_g``. Case does not matter. Voltage and current
    count if there is no power.

    Raises:
        UsageError: the file cannot be read, or a field is no number; names the line and the column.
    """
    with open_csv(path, LARGEST_TEXT) as file:
        names = [_name_of(column) for column in file.header]
        if "power_W" in names:
            names = ["" if name in ("voltage_V", "current_A") else name for name in names]
        twice = next((name for name in COLUMNS if names.count(name) > 1), None)
        if twice:
            file.fail(f"the column '{twice}' is there {names.count(twice)} times")
        if not set(names) & set(COLUMNS):
            file.fail(f"no column is called {', '.join(COLUMNS)}; found {', '.join(file.header)[:80]}")
        for quantity in ("throttle", "thrust", "speed"):
            if not any(COLUMNS[name][0] == quantity for name in names if name in COLUMNS):
                file.fail(f"has no column {_names_of(quantity)}; found {', '.join(file.header)[:80]}")
        found: dict[str, list[float]] = {name: [] for name in names if name in COLUMNS}
        for fields in file:
            for name, field in zip(names, fields, strict=True):
                if name in found:
                    found[name].append(file.number(name, field))
    return found


def _name_of(column: str) -> str:
    """Return a CSV heading in the form of COLUMNS: ``throttle [%]`` becomes ``throttle_percent``."""
    name, unit = name_and_unit(column)
    whole = name if unit in (None, "1", "1/min") else f"{name}_{'percent' if unit == '%' else unit}"
    known = {each.casefold(): each for each in COLUMNS}
    return known.get(whole.casefold(), column)


def _numbers(name: str, values: object) -> Floats:
    """Return a list of numbers as an array; raise UsageError, naming ``name``, for anything else."""
    if not isinstance(values, Sequence) or isinstance(values, str):
        raise UsageError(f"{name}: expected a list of numbers, found {values!r:.80}")
    for row, value in enumerate(values, start=1):
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise UsageError(f"{name}: row {row} is {value!r:.40}, which is not a number")
    return np.asarray(values, np.float64)
