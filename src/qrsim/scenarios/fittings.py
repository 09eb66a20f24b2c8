"""How the sensors of a scenario are fitted: checks, and what a world is built from."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from qrsim.core.tree import field_info, record_of, replace
from qrsim.core.vectors import Euler, Vec3
from qrsim.models.sensors.contracts import Sensor
from qrsim.models.sensors.fitting import LATEST, LONGEST_DELAY, Fitting
from qrsim.scenarios import catalogue as known
from qrsim.scenarios.schema import FleetSpec, ScenarioSpec


def fitting_problems(scenario: ScenarioSpec) -> Iterator[str]:
    """Yield the errors of sensors' delays, jitters and mountings in a scenario."""
    dt = scenario.time_step
    for name, fleet in scenario.fleets.items():
        for sensor_name, spec in fleet.sensors.items():
            path = f"fleets.{name}.sensors.{sensor_name}"
            (delay, jitter, *_), period = _given(spec), spec.period
            seconds = delay * period
            ticks = seconds / dt
            if delay and not math.isclose(ticks, round(ticks), rel_tol=1e-9, abs_tol=1e-9):
                yield (
                    f"{path}.delay: {delay:g} periods of {period:g} s are {seconds:g} s, not a multiple of the time "
                    f"step {dt:g} s"
                )
            elif jitter > seconds * (1.0 + 1e-9):
                yield f"{path}.jitter: {jitter:g} s is above the delay, {seconds:g} s ({delay:g} periods)"
            elif jitter and delay + LATEST * jitter / period > LONGEST_DELAY:
                yield (
                    f"{path}.jitter: the last of the readings would arrive after {seconds + LATEST * jitter:g} s; "
                    f"allowed: up to {LONGEST_DELAY * period:g} s, {LONGEST_DELAY} periods, for which they are kept"
                )


def _given(spec: Any) -> tuple[float, float, list[float] | None, list[float] | None]:
    """Return (delay [periods], jitter [s], position, attitude) of a sensor as given; 0 and None for what is not given.

    A sensor from outside may have parameters of these names, which are its own affair; but a delay that is compiled is
    one in periods, as that of a GNSS receiver.
    """
    own = {field.name: field_info(field).static for field in dataclasses.fields(known.SENSORS[spec.type])}
    names = ("delay", "jitter", "mount_position_body", "mount_attitude_rad")
    delay, jitter, place, turned = (None if name in own else getattr(spec, name) for name in names)
    if own.get("delay") and isinstance(spec.delay, int):
        delay = spec.delay
    return float(delay or 0.0), float(jitter or 0.0), place, turned


def fitted(spec: FleetSpec, sensors: Sequence[Any]) -> tuple[tuple[Sensor, ...], tuple[Fitting | None, ...]]:
    """Return a fleet's sensors, and the fitting (mounting, delay) or None of each; () if no sensor has one."""
    found, fittings = [], []
    for sensor, part in zip(sensors, spec.sensors.values(), strict=True):
        delay, jitter, place, turned = _given(part)
        own = "delay" in sensor.__dataclass_fields__
        # What holds its readings back itself goes on doing so, unless they arrive irregularly.
        late = delay if jitter or not own else 0.0
        turned, place = (values if values is not None and any(values) else None for values in (turned, place))
        position = None if place is None else record_of(Vec3, *(np.asarray(value) for value in place))
        attitude = None if turned is None else record_of(Euler, *(np.asarray(value) for value in turned))
        fitting = Fitting(position, attitude, late, jitter)
        found.append(replace(sensor, delay=0) if own and late else sensor)
        fittings.append(fitting if late or position is not None or attitude is not None else None)
    return tuple(found), tuple(fittings) if any(fitting is not None for fitting in fittings) else ()
