"""The sensor ``magnetometer``: its noise at rest against theory, and what its errors do to a heading in flight.

At rest: chips of every preset for hours; the overlapping Allan deviation by allantools, averaged over chips and axes,
against the closed form of white noise and of a sampled Ornstein-Uhlenbeck process. In flight: vehicles on the default
patrol, each with another chip, whose heading is taken with the true tilt: what is left are errors of the magnetometer.
"""

from __future__ import annotations

import math
from typing import Any

import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

import qrsim
from evidence import IMAGES
from evidence._at_rest import compared as against_theory
from evidence._at_rest import readings_at_rest
from evidence._pictures import picture
from qrsim.core.tree import cast
from qrsim.core.vectors import Euler, Vec3
from qrsim.models.sensors.earth_field import declination
from qrsim.models.sensors.magnetometer import Magnetometer
from qrsim.models.sensors.magnetometer_presets import PRESETS
from qrsim.models.vehicles.contracts import Load

DOC = "noise of the magnetometer presets against its theory, and errors of a compass in flight"
SEED = 20261122
CONFIDENCE = 0.9
Floats = npt.NDArray[np.float64]


def expected_variance(sensor: Magnetometer, lengths: npt.NDArray[np.int64]) -> Floats:
    """Return the Allan variance over windows of so many readings (K,), exactly: N^2/t, and that of the sampled drift.

    With the correlation a of neighbouring readings, the variance of the mean of n of them less the covariance of two
    neighbouring means: (n + 2 a (n (1 - a) - (1 - a^n))/(1 - a)^2 - a ((1 - a^n)/(1 - a))^2)/n^2. A reading's step is a
    white error of step^2/12 where the noise is larger.
    """
    noise, drift, time = (float(getattr(sensor, name)) for name in ("noise", "drift_std", "drift_time_constant"))
    n = lengths.astype(np.float64)
    a, rest = math.exp(-sensor.period / time), -math.expm1(-sensor.period / time)
    gone = -np.expm1(-n * sensor.period / time)
    drifting = (n + 2.0 * a * (n * rest - gone) / rest**2 - a * (gone / rest) ** 2) / n**2
    step = sensor.resolution / max(1.0, sensor.sample_rate * sensor.period)
    return (noise**2 / sensor.period + step**2 / 12.0) / n + drift**2 * drifting


def compared(sensor: Magnetometer, count: int, chips: int, confidence: float, seed: int = SEED) -> dict[str, Any]:
    """Return how readings of chips at rest compare with the theory."""
    zero = jnp.zeros(chips, jnp.float32)
    inputs = {
        "position_ned": Vec3(zero, zero, zero),
        "attitude": Euler(zero, zero, zero),
        "load": Load(zero + 1.0, zero + 1.0),
    }
    (taken,) = readings_at_rest(sensor, "compass", inputs, ("field_body",), count, seed)
    found = against_theory(taken, sensor.period, 12, lambda lengths: expected_variance(sensor, lengths), confidence)
    short = found.windows <= 10.0 * found.windows[0]
    # What is left where drift and steps are taken away, over N^2/t.
    drifting = found.expected - float(sensor.noise) ** 2 / found.windows
    noise = math.sqrt(float(np.mean(((found.variance - drifting) * found.windows)[short])))
    return {**found.row(), "fitted_over_true": {"noise": noise / float(sensor.noise)}}


def at_rest(name: str, hours: float, chips: int) -> dict[str, Any]:
    """Return how chips of a preset at rest compare with the theory."""
    sensor = cast(Magnetometer(**{**PRESETS[name], "preset": name}), np.float32)  # type: ignore[arg-type]
    seed = SEED + list(PRESETS).index(name)
    return compared(sensor, round(3600.0 * hours / sensor.period), chips, CONFIDENCE, seed)


def heading(name: str, flights: int, seconds: float) -> dict[str, float]:
    """Return errors of headings by a preset on the default patrol, with the true tilt, over vehicles and flights."""
    scenario = qrsim.load_scenario(
        "patrol_plain", [f"fleets.pelicans.sensors.compass={{type: magnetometer, preset: {name}}}"]
    )
    turn = declination(scenario.earth_field_ned)
    simulation = qrsim.Simulation(scenario.world())
    errors = []
    for flight in range(flights):
        simulation.reset(seed=SEED + flight)
        for _ in range(round(seconds / 2.0)):
            reading, truth = simulation.step(ticks=100), simulation.truth
            roll, pitch, yaw = truth.attitude.T
            found = qrsim.compass_heading(Vec3(*reading.compass.field_body.T), roll, pitch, turn)  # type: ignore[arg-type]
            # A reading is up to its period old, in which the vehicle has hardly turned.
            wrong = np.asarray(found, np.float64) - yaw
            errors.append(np.degrees(np.remainder(wrong + math.pi, 2.0 * math.pi) - math.pi))
    every = np.array(errors)[np.isfinite(errors)]
    return {"rms_deg": float(np.sqrt(np.mean(every**2))), "p95_deg": float(np.quantile(np.abs(every), 0.95))}


def draw(rest: dict[str, Any]) -> None:
    """Write docs/images/magnetometer_allan.png: measured and expected Allan deviations of every preset."""
    with picture(IMAGES / "magnetometer_allan.png", (5.2, 3.6)) as axes:
        for number, (name, row) in enumerate(rest.items()):
            axes.loglog(row["windows_s"], row["expected"], color=f"C{number}", linewidth=1.0)
            axes.loglog(row["windows_s"], row["deviation"], ".", color=f"C{number}", markersize=5, label=name)
        axes.set(xlabel="window [s]", ylabel="Allan deviation [uT]")


def run(full: bool) -> dict[str, Any]:
    """Return all comparisons; the full form has six hours of four chips of each preset, and 40 flights."""
    hours, flights, seconds = (6.0, 40, 60.0) if full else (1.0, 2, 10.0)
    names = list(PRESETS) if full else ["rm3100"]
    rest = {name: at_rest(name, hours, 4) for name in names}
    if full:
        draw(rest)
    for row in rest.values():
        for long in ("windows_s", "deviation", "expected"):
            del row[long]
    return {
        "confidence": CONFIDENCE,
        "hours": hours,
        "flights": flights,
        "at_rest": rest,
        "heading": {name: heading(name, flights, seconds) for name in names},
    }
