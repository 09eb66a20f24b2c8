"""Slow errors of barometer and attitude estimate: Ornstein-Uhlenbeck parameters recovered from readings."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qrsim.core.arrays import Floats
from qrsim.core.noise import Draw, Key
from qrsim.core.tree import cast
from qrsim.core.vectors import Euler, Vec3
from qrsim.models.sensors.attitude import AttitudeEstimator
from qrsim.models.sensors.barometer import Barometer
from qrsim.models.sensors.contracts import Sensor
from qrsim.studies.validate.published import ATTITUDE, BAROMETER
from qrsim.studies.validate.report import Check, Outcome, Part, Picture
from qrsim.studies.validate.statistics import CONFIDENCE, mean_and_error, widest_z

SEED = 20140918
# Readings are kept once a second.
KEPT_S, PERIOD = 1.0, 0.02
VEHICLES, FEW_VEHICLES = 2048, 128
# Lags at which the autocovariance is checked, and up to which it is drawn, in time constants.
LAGS, LONGEST = (0.5, 1.0), 1.5


class Process(NamedTuple):
    """A sensor's error process and its expected parameters.

    Attributes:
        title: in words.
        std, time_constant: as published [unit, s].
        unit: of std.
        errors: (T, n) once a second.
        squared_steps: (n,) mean square of the change over one period of 0.02 s [unit^2].
    """

    title: str
    std: float
    time_constant: float
    unit: str
    errors: Floats
    squared_steps: Floats


@partial(jax.jit, static_argnames=("sensor", "seconds", "vehicles"))
def _simulate_errors(sensor: str, model: Sensor, seconds: int, vehicles: int) -> tuple[jax.Array, jax.Array]:
    """Simulate K errors of n sensors at rest; return them (T, K, n) per second, and mean squares of their changes."""
    like = jnp.zeros((), jnp.float32)
    ids = jnp.arange(vehicles, dtype=jnp.uint32)
    key, zero = Key.root(SEED), jnp.zeros(vehicles, jnp.float32)
    still, level = Vec3(zero, zero, zero), Euler(zero, zero, zero)
    inputs = (still, still) if sensor == "barometer" else (level,)
    per_row = round(KEPT_S / PERIOD)

    def error(reading: Any) -> jax.Array:
        """Return the error of a sensor's reading at rest."""
        return reading.height[None] if sensor == "barometer" else jnp.stack(jax.tree.leaves(reading.attitude))

    def tick(carry: Any, now: jax.Array) -> Any:
        """Advance the sensor by one period, and sum the squared change of its error."""
        state, before, squares = carry
        state, reading = model.step(state, Draw(key.stream(sensor, ids), now, like), *inputs)
        after = error(reading)
        return (state, after, squares + (after - before) ** 2), None

    def second(carry: Any, start: jax.Array) -> Any:
        """Advance the sensor by one second; return its error then."""
        carry, _ = jax.lax.scan(tick, carry, start + jnp.arange(per_row, dtype=jnp.uint32))
        return carry, carry[1]

    state, reading = model.init(Draw(key.stream(f"{sensor} start", ids), jnp.uint32(0), like), *inputs)
    first = error(reading)
    starts = per_row * jnp.arange(seconds, dtype=jnp.uint32)
    (_, _, squares), rows = jax.lax.scan(second, (state, first, jnp.zeros_like(first)), starts)
    return rows, squares / (per_row * seconds)


def read(sensor: str, model: object, title: str, std: float, time_constant: float, unit: str, vehicles: int) -> Process:
    """Simulate errors of many sensors at rest over two time constants, in float32, with the parameters expected."""
    rows, squares = _simulate_errors(sensor, cast(model, np.float32), round(2.0 * time_constant), vehicles)
    errors = np.asarray(rows, np.float64)
    return Process(
        title, std, time_constant, unit, errors.reshape(len(errors), -1), np.asarray(squares, np.float64).reshape(-1)
    )


def processes(vehicles: int) -> dict[str, Process]:
    """Return name -> error process of both drifting sensors; an attitude's three angles count as three vehicles."""
    return {
        "barometer": read("barometer", Barometer(), "barometric height", *BAROMETER, "m", vehicles),
        "attitude": read("attitude", AttitudeEstimator(), "attitude estimate", *ATTITUDE, "rad", vehicles // 2),
    }


def autocovariance(errors: Floats, lag: int) -> Floats:
    """Return the mean product (n,) of errors (T, n) ``lag`` rows apart; the errors' mean is known to be 0."""
    return np.asarray(np.mean(errors[lag:] * errors[: len(errors) - lag], axis=0))


def _drift_checks(name: str, of: Process) -> list[Check]:
    """Return the checks of an error process against theory: standard deviation, time constant, autocorrelation."""
    count = 2 * (len(LAGS) + 3)
    z, variance = widest_z(count), of.std**2
    reason = (
        f"{{}}; {z:.1f} standard errors of the mean of {of.errors.shape[1]} processes, {100 * CONFIDENCE:g} % for all"
    )
    reason += f" {count} together"
    mean_square, error = mean_and_error(np.mean(of.errors**2, axis=0))
    std = math.sqrt(float(mean_square))
    checks = [
        Check(
            f"{of.title}: standard deviation",
            std,
            of.std,
            z * float(error) / (2.0 * of.std),
            of.unit,
            reason.format("the reference"),
        ),
        _time_constant(of, z, reason),
    ]
    for share in LAGS:
        lag = round(share * of.time_constant / KEPT_S)
        found, error = mean_and_error(autocovariance(of.errors, lag) / variance)
        checks.append(
            Check(
                f"{of.title}: autocovariance after {lag * KEPT_S:g} s, in units of the variance",
                float(found),
                math.exp(-share),
                z * float(error),
                "",
                reason.format("exp(-lag/time constant)"),
            )
        )
    if name == "barometer":
        decay = math.exp(-PERIOD / of.time_constant)
        expected = of.std * math.sqrt(2.0 * (1.0 - decay)) / PERIOD
        rate, error = mean_and_error(of.squared_steps)
        checks.append(
            Check(
                "height rate: standard deviation",
                math.sqrt(float(rate)) / PERIOD,
                expected,
                z * float(error) / (2.0 * PERIOD**2 * expected),
                "m/s",
                reason.format("exact from drift and period"),
            )
        )
    return checks


def _time_constant(of: Process, z: float, reason: str) -> Check:
    """Return the check of an error process's time constant, from mean square changes per period; ``z``: tolerance.

    The mean square change is 2 sigma^2 (1 - exp(-T/tau)), and so well known that sigma is the error that remains.
    """
    ratios = of.squared_steps / np.mean(of.errors**2)
    mean, error = mean_and_error(ratios)
    _, error_of_variance = mean_and_error(np.mean(of.errors**2, axis=0) / np.mean(of.errors**2))
    found = -PERIOD / math.log1p(-0.5 * float(mean))
    relative = math.hypot(float(error) / float(mean), float(error_of_variance))
    return Check(
        f"{of.title}: time constant",
        found,
        of.time_constant,
        z * relative * of.time_constant,
        "s",
        reason.format("the reference; from variance and mean square change per period"),
    )


def _run_part(paths: Mapping[str, Path], full: bool) -> Outcome:
    """Simulate the drifts of both sensors, in full or with few vehicles; return the outcome for the report."""
    found = processes(VEHICLES if full else FEW_VEHICLES)
    checks = [check for name, of in found.items() for check in _drift_checks(name, of)]
    numbers = {
        name: {
            "std": of.std,
            "time_constant_s": of.time_constant,
            "processes": of.errors.shape[1],
            "seconds": len(of.errors) * KEPT_S,
            "autocorrelation": _correlation_curve(of),
        }
        for name, of in found.items()
    }
    std, tau = (next(check.value for check in checks if words in check.name) for words in ("standard", "time constant"))
    return Outcome(
        method="Sensors of many vehicles at rest are read 50 times a second for two time constants, and their errors"
        " are taken for processes of unknown size and speed, whose standard deviation and time constant are recovered"
        " from the readings. There is no public recording of these errors: this shows that the simulator has the"
        " processes it states, not that a given sensor has them.",
        reading=f"Both processes come out as stated: a barometer that drifts by {std:.2f} m over {tau:.0f} s, for"
        " example, within what chance allows.",
        checks=checks,
        findings=[],
        pictures=[_draw_drifts(found)],
        numbers=numbers,
    )


def _curve_lags(of: Process) -> Floats:
    """Return at most 31 lags, in rows, for drawing an autocorrelation up to LONGEST time constants."""
    return np.unique(np.linspace(0.0, LONGEST * of.time_constant / KEPT_S, 31).round().astype(int))


def _correlation_curve(of: Process) -> dict[str, list[float]]:
    """Return the autocorrelation of an error process at several lags [s], with its standard error, for JSON."""
    found = [mean_and_error(autocovariance(of.errors, int(lag)) / of.std**2) for lag in _curve_lags(of)]
    return {
        "lags_s": (KEPT_S * _curve_lags(of)).tolist(),
        "measured": [float(mean) for mean, _ in found],
        "standard_error": [float(error) for _, error in found],
    }


def _draw_drifts(found: dict[str, Process]) -> Picture:
    """Draw traces of both sensors' errors, and their autocorrelations with theory."""
    from qrsim.runs.picture import new_figure
    from qrsim.studies.validate.pictures import SIMULATED, picture

    figure = new_figure(11.0, 6.2)
    panels = figure.subplots(2, 2, width_ratios=(3, 2))
    for row, of in zip(panels, found.values(), strict=True):
        traces, correlation = row
        scale, unit = (1000.0, "mrad") if of.unit == "rad" else (1.0, of.unit)
        time = KEPT_S * (1 + np.arange(len(of.errors)))
        traces.plot(time, scale * of.errors[:, :5], lw=0.8)
        for sign in (-1, 1):
            traces.axhline(sign * scale * of.std, color="black", ls="--", lw=0.8)
        traces.set(ylabel=f"error [{unit}]", title=f"{of.title}: five of {of.errors.shape[1]}, dashed ± sigma")
        curve = _correlation_curve(of)
        lags = np.array(curve["lags_s"])
        measured, error = np.array(curve["measured"]), np.array(curve["standard_error"])
        correlation.fill_between(lags, measured - 3 * error, measured + 3 * error, color=SIMULATED, alpha=0.2, lw=0)
        correlation.plot(lags, measured, color=SIMULATED, lw=1.2, label="simulated, ± 3 standard errors")
        correlation.plot(
            lags, np.exp(-lags / of.time_constant), "k--", lw=1.0, label=f"exp(-lag/{of.time_constant:g} s)"
        )
        correlation.set(title="autocorrelation", ylim=(0.0, 1.15))
        correlation.legend(fontsize=8)
        for axes in row:
            axes.grid(alpha=0.3)
            axes.set_xlim(left=0.0)
    panels[1][0].set_xlabel("time [s]")
    panels[1][1].set_xlabel("lag [s]")
    return picture(figure, "Errors of barometer (above) and attitude estimate (below), and how long they last.")


PART = Part(
    "drifts",
    "Barometer and attitude",
    "no figure of the paper: the processes of its section on sensors, by their stated numbers",
    (),
    _run_part,
)
