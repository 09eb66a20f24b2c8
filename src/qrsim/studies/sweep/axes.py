"""Axes of a study: listed values, or a sampled range."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.errors import UsageError, did_you_mean
from qrsim.files import Content
from qrsim.scenarios.ranges import is_time_of_fault
from qrsim.scenarios.reading import apply_override
from qrsim.studies.sweep.study import StudySpec
from qrsim.studies.sweep.varying import Condition, assignment

COUNT = ".vehicles.count"


@dataclass(frozen=True)
class Axis:
    """A parameter that varies.

    Attributes:
        path: in the scenario; ``fleets.NAME.vehicles.count`` means the first so many of the vehicles it has. Of
            conditions, what they are called together.
        name: of the dimension or coordinate.
        unit: as the study says, "" where it does not.
        values: what it goes through; None where it is sampled between ``low`` and ``high``.
        scale: linear, log or normal, see ``VarySpec``.
        step: of times of faults [s], which are rounded down to whole ticks; else 0.
    """

    path: str
    name: str
    unit: str
    values: tuple[Any, ...] | None
    low: float = 0.0
    high: float = 0.0
    scale: str = "linear"
    step: float = 0.0

    @property
    def numeric(self) -> bool:
        """Whether all values of the axis are numbers; a number of vehicles does not count: it changes the structure."""
        if self.path.endswith(COUNT):
            return False
        return self.values is None or all(
            isinstance(value, int | float) and not isinstance(value, bool) for value in self.values
        )

    @property
    def labels(self) -> NumpyArray:
        """Return the axis's values as coordinates of a Dataset: numbers, or texts if any value is not a number."""
        assert self.values is not None
        if all(isinstance(value, int | float) and not isinstance(value, bool) for value in self.values):
            return np.array(self.values, np.float64)
        texts = [str(value) if isinstance(value, str) else json.dumps(value) for value in self.values]
        return np.array(texts, dtype=object)

    def ends(self) -> tuple[Any, Any]:
        """Return the smallest and the largest value of a numeric axis."""
        return (self.low, self.high) if self.values is None else (min(self.values), max(self.values))

    def scaled(self, unit: NumpyArray) -> NumpyArray:
        """Map numbers in [0, 1) to values of a numeric axis, by its scale (linear, log or normal)."""
        if self.scale == "normal":
            from scipy.stats import truncnorm

            found = 0.5 * (self.low + self.high) + (self.high - self.low) / 6.0 * truncnorm.ppf(unit, -3.0, 3.0)
        elif self.scale == "log":
            found = np.exp(np.log(self.low) + unit * (np.log(self.high) - np.log(self.low)))
        else:
            found = self.low + unit * (self.high - self.low)
        return in_ticks(found, self.step)


def in_ticks(values: NumpyArray, step: float) -> NumpyArray:
    """Return times [s] rounded down to multiples of ``step`` [s]; unchanged if that is 0."""
    return np.round(np.floor(values / step + 1e-6) * step, 9) if step else values


def axes_of(spec: StudySpec, time_step: float = 0.0) -> tuple[Axis, ...]:
    """Return the varied parameters of a study as axes, in its order; ``time_step`` [s] rounds times of faults.

    Args:
        spec: of the study.
        time_step: to whose multiples [s] times of faults are rounded down; 0: they are not.
    """
    found = []
    for path, item in spec.vary.items():
        name, unit = item.name or path, item.unit or ""
        step = time_step if is_time_of_fault(path) else 0.0
        if item.listed is not None:
            found.append(Axis(path, name, unit, tuple(item.listed), step=step))
            continue
        low, high = in_ticks(np.array([item.low or 0.0, item.high or 0.0]), step).tolist()
        if item.count is None:
            found.append(Axis(path, name, unit, None, low, high, item.scale, step))
            continue
        spaced = in_ticks((np.geomspace if item.scale == "log" else np.linspace)(low, high, item.count), step)
        found.append(Axis(path, name, unit, tuple(spaced.tolist()), step=step))
    return tuple(found)


def apply(content: Content, path: str, value: object) -> None:
    """Set the value at a path of a scenario's content, or all values of a named condition, in place."""
    for text in overrides(content, path, value):
        apply_override(content, text)


def overrides(content: Content, path: str, value: object) -> list[str]:
    """Return the ``qrsim run --set`` arguments that set a value at a path, or the values of a named condition.

    Raises:
        UsageError: a fleet has not so many vehicles.
    """
    if isinstance(value, Condition):
        return [text for own, part in value.settings.items() for text in overrides(content, own, part)]
    if not path.endswith(COUNT):
        return [assignment(path, value)]
    name = path.removeprefix("fleets.").removesuffix(COUNT)
    fleets = content.get("fleets", {})
    if name not in fleets:
        raise UsageError(f"{path}: no fleet is called '{name}'{did_you_mean(name, fleets)}")
    vehicles = fleets[name].get("vehicles", [])
    if isinstance(vehicles, dict):
        return [assignment(path, value)]
    if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= len(vehicles):
        raise UsageError(f"{path}: {value!r}; allowed: 1 to {len(vehicles)}, the vehicles that the scenario has")
    return [assignment(f"fleets.{name}.vehicles", vehicles[:value])]
