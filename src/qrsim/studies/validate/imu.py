"""The sensor ``imu`` at rest against what data sheets say: white noise and turn-on bias."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qrsim.core.allan import overlapping_allan_deviation
from qrsim.core.arrays import Floats
from qrsim.core.noise import Draw, Drawn, Key, Stream
from qrsim.core.tree import cast
from qrsim.core.vectors import Vec3
from qrsim.engine.settings import quick_jit
from qrsim.models.sensors.imu import Imu
from qrsim.models.sensors.imu_presets import PRESETS
from qrsim.models.vehicles.contracts import Load
from qrsim.studies.validate.published import DATA_SHEETS, GRAVITY
from qrsim.studies.validate.report import Check, Outcome, Part, Picture
from qrsim.studies.validate.statistics import CONFIDENCE, mean_and_error, widest_z

SEED, PERIOD, SECONDS = 952, 0.02, 60.0
CHIPS, FEW_CHIPS = 1024, 128
# Windows in readings: that of the noise is short, so that no slow error is in it.
NOISE_WINDOW, WINDOWS = 4, np.array([1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 700])
# Errors that gravity turns into something like a bias.
NOT_OF_BIAS = {"accelerometer_scale": 0.0, "accelerometer_misalignment": 0.0, "gyroscope_g_sensitivity": 0.0}
FIELDS = {"gyroscope": "rates_body", "accelerometer": "specific_force"}


class Chips(NamedTuple):
    """Readings of many chips at rest, each with what was measured of it.

    Attributes:
        readings: (T, chips, 3) less what a perfect one would say.
        deviation: (K, chips, 3) Allan deviations over WINDOWS.
    """

    readings: Floats
    deviation: Floats


@partial(quick_jit, static_argnames="count")
def _simulate_readings(sensor: Imu, inputs: dict[str, Any], begin: Stream, source: Stream, count: int) -> object:
    """Simulate ``count`` readings of IMUs at rest; ``begin`` and ``source`` are their random streams."""
    like = jnp.zeros((), jnp.float32)

    def drawn(stream: Stream, now: jax.Array, size: int) -> Drawn:
        """Return ``size`` random normals of a stream at a tick."""
        return Drawn(tuple(Draw(stream, now, like).normal_rows(size)))

    def tick(state: Any, now: jax.Array) -> tuple[Any, Any]:
        """Advance the IMU by one reading; return its state and the reading."""
        state, reading = sensor.step(state, drawn(source, now, sensor.normals), **inputs)
        return state, tuple(getattr(reading, field).stack() for field in FIELDS.values())

    state, _ = sensor.init(drawn(begin, jnp.uint32(0), sensor.first_normals), **inputs)
    return jax.lax.scan(tick, state, jnp.arange(1, count + 1, dtype=jnp.uint32))[1]


def chips_of(preset: str, chips: int, **change: float) -> dict[str, Chips]:
    """Simulate chips of an IMU preset at rest for a minute, without vibration and with no gravity effect but bias."""
    given = {**PRESETS[preset], "preset": preset, "period": PERIOD, "vibration": "none", **NOT_OF_BIAS, **change}
    zero = jnp.zeros(chips, jnp.float32)
    inputs = {
        "rates_body": Vec3(zero, zero, zero),
        "specific_force": Vec3(zero, zero, zero - GRAVITY),
        "load": Load(zero + 1.0, zero + 1.0),
    }
    key, ids = Key.root(SEED), jnp.arange(chips, dtype=jnp.uint32)
    streams = key.stream("imu start", ids), key.stream("imu", ids)
    taken = _simulate_readings(cast(Imu(**given), np.float32), inputs, *streams, round(SECONDS / PERIOD))
    still = {"gyroscope": np.zeros(3), "accelerometer": np.array([0.0, 0.0, -GRAVITY])}
    found = {}
    for (kind, right), values in zip(still.items(), taken, strict=True):
        errors = np.asarray(values, np.float64) - right
        found[kind] = Chips(errors, overlapping_allan_deviation(errors, PERIOD, WINDOWS)[1])
    return found


def measured(of: Chips) -> dict[str, Floats]:
    """Return white noise N^2 [unit^2 s] and squared bias [unit^2] of each IMU chip (n,), both means over its axes."""
    at = int(np.flatnonzero(WINDOWS == NOISE_WINDOW)[0])
    noise = np.square(of.deviation[at]).mean(axis=1) * NOISE_WINDOW * PERIOD
    return {"noise": noise, "turn_on_bias": np.square(of.readings.mean(axis=0)).mean(axis=1)}


def _sheet_checks(found: Mapping[str, Mapping[str, Chips]]) -> list[Check]:
    """Return the checks of simulated IMUs' noise and turn-on bias against data sheets."""
    rows = [
        (preset, kind, what, value)
        for preset, sheet in DATA_SHEETS.items()
        if preset in found
        for (kind, what), value in sheet.numbers.items()
    ]
    z, checks = widest_z(len(rows)), []
    for preset, kind, what, stated in rows:
        squares = measured(found[preset][kind])[what]
        mean, error = mean_and_error(squares)
        value = math.sqrt(float(mean))
        unit = "rad/s" if kind == "gyroscope" else "m/s^2"
        checks.append(
            Check(
                f"{preset}: {kind}, {what.replace('_', ' ')}",
                value,
                stated,
                z * float(error) / (2.0 * stated),
                unit + (" s^0.5" if what == "noise" else ""),
                f"{DATA_SHEETS[preset].source}; {z:.1f} standard errors of the mean of {len(squares)} chips,"
                f" {100 * CONFIDENCE:g} % for all {len(rows)} together",
            )
        )
    return checks


def _run_part(paths: Mapping[str, Path], full: bool) -> Outcome:
    """Simulate all IMU presets that have data sheets, in full or quickly; return the outcome for the report."""
    found = {preset: chips_of(preset, CHIPS if full else FEW_CHIPS) for preset in DATA_SHEETS}
    checks = _sheet_checks(found)
    return Outcome(
        method=f"Chips of the presets with available data sheets are at rest for {SECONDS:g} s. White noise is the"
        f" Allan deviation over {NOISE_WINDOW * PERIOD:g} s times the root of that; a data sheet's one-sided density"
        " is the root of 2 times that. Turn-on bias is the mean over the minute, from chip to chip.",
        reading="Noise and turn-on bias are those of the data sheets, if these state them.",
        checks=checks,
        findings=[],
        pictures=[_draw_allan(found)],
        numbers={
            preset: {
                kind: {
                    "windows_s": (WINDOWS * PERIOD).tolist(),
                    "deviation": np.sqrt(np.square(of.deviation).mean(axis=(1, 2))).tolist(),
                }
                for kind, of in kinds.items()
            }
            for preset, kinds in found.items()
        },
    )


def _draw_allan(found: Mapping[str, Mapping[str, Chips]]) -> Picture:
    """Draw Allan deviations of simulated IMU chips, with the white noise of their data sheets."""
    from qrsim.runs.picture import new_figure
    from qrsim.studies.validate.pictures import picture

    figure = new_figure(11.0, 4.4)
    panels = figure.subplots(1, 2)
    for axes, kind in zip(panels, FIELDS, strict=True):
        for (preset, kinds), colour in zip(found.items(), ("tab:red", "tab:blue", "tab:green"), strict=True):
            windows = WINDOWS * PERIOD
            axes.loglog(
                windows, np.sqrt(np.square(kinds[kind].deviation).mean(axis=(1, 2))), ".", color=colour, label=preset
            )
            noise = DATA_SHEETS[preset].numbers.get((kind, "noise"))
            if noise is not None:
                axes.loglog(windows, noise / np.sqrt(windows), "--", color=colour, lw=1.0)
        axes.set(title=kind, xlabel="averaging time [s]")
        axes.set_ylabel(f"Allan deviation [{'rad/s' if kind == 'gyroscope' else 'm/s²'}]")
        axes.grid(alpha=0.3, which="both")
        axes.legend(fontsize=9)
    return picture(figure, "Allan deviations of chips at rest; dashed, white noise as the data sheet has it.")


PART = Part("imu", "Gyroscope and accelerometer", "no figure of the paper: data sheets of chips", (), _run_part)
