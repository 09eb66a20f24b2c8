"""Times of a scenario: steps, and periods that are multiples of them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from qrsim.core.clock import split_time
from qrsim.scenarios import catalogue as known
from qrsim.scenarios.schema import ScenarioSpec

# Steps are counted in int32.
MOST_STEPS = 2**31 - 2


def is_multiple(seconds: float, step: float, most: float = MOST_STEPS) -> bool:
    """Return whether a time [s] is a whole multiple, from 1 to ``most``, of ``step`` [s]."""
    ratio = seconds / step
    return math.isfinite(ratio) and 1 <= round(ratio) <= most and math.isclose(ratio, round(ratio), rel_tol=1e-9)


def timing_problems(scenario: ScenarioSpec) -> Iterator[str]:
    """Yield the errors of a scenario's time step, duration and periods."""
    dt = scenario.time_step
    try:
        split_time(np.int32(0), dt, np.float32)  # type: ignore[arg-type]
    except ValueError as error:
        yield str(error)
    if scenario.duration / dt > MOST_STEPS:
        yield f"duration: {scenario.duration:g} s; allowed: up to {MOST_STEPS * dt:g} s, {MOST_STEPS} time steps"
    elif not is_multiple(scenario.duration, dt):
        yield f"duration: {scenario.duration:g} s is not a multiple of the time step {dt:g} s"
    sky = scenario.world.sky.period
    if not is_multiple(sky, dt):
        yield f"world.sky.period: {sky:g} s is not a multiple of the time step {dt:g} s"
    for name, fleet in scenario.fleets.items():
        for sensor_name, sensor in fleet.sensors.items():
            path = f"fleets.{name}.sensors.{sensor_name}.period"
            if sensor.period / dt > MOST_STEPS:
                yield f"{path}: {sensor.period:g} s; allowed: up to {MOST_STEPS * dt:g} s, {MOST_STEPS} time steps"
            elif not is_multiple(sensor.period, dt):
                yield f"{path}: {sensor.period:g} s is not a multiple of the time step {dt:g} s"
            elif "sky" in _reads(sensor.type) and not is_multiple(sensor.period, sky):
                yield f"{path}: {sensor.period:g} s is not a multiple of world.sky.period, {sky:g} s"
            if sensor.type == "imu":
                yield from _bandwidth_problems(path.removesuffix("period"), sensor)


def _bandwidth_problems(path: str, sensor: Any) -> Iterator[str]:
    """Yield an error if the low-pass bandwidth of a sensor exceeds half its sampling rate."""
    bandwidth = sensor.bandwidth_hz
    half = 0.5 * sensor.subsamples / sensor.period
    if bandwidth >= half:
        yield (
            f"{path}bandwidth_hz: {bandwidth:g} Hz; allowed: below {half:g} Hz, half the rate of its measurements "
            "(subsamples/period), or 0 for no filter"
        )


def _reads(sensor: str) -> tuple[str, ...]:
    """Return the names of the true quantities that a type of sensor reads."""
    cls = known.SENSORS[sensor]
    return tuple(cls.reads)
