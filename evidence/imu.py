"""The sensor ``imu`` at rest against the theory of its noise, and its vibration against the recording.

At rest: chips of every preset for hours; the overlapping Allan deviation by allantools, averaged over chips and axes,
against the closed form of the discretised processes, and a fit of the usual three terms. In flight: the spectrum of the
recorded rates in bands of 2.5 Hz, and of what ``vibration: measured`` adds in hover.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
import scipy

from evidence import IMAGES
from evidence._at_rest import compared, readings_at_rest
from evidence._pictures import picture
from qrsim.core.tree import cast, replace
from qrsim.core.vectors import Vec3
from qrsim.files.recordings import data_file
from qrsim.models.sensors.imu import Imu
from qrsim.models.sensors.imu_presets import PRESETS
from qrsim.models.vehicles.contracts import Load

DOC = "noise of the imu presets against its theory, and vibration against the recording"
SEED = 20261122
CONFIDENCE = 0.9
# Windows [s] from which on the random walk shows.
LONG = 100.0
# What the page about the models says of the slow errors: correlation times [s], variance of each process per B^2, and
# readings for which an axis holds them.
TIMES, SHARE, HELD = (5.0, 50.0, 500.0), math.log(10.0) / math.pi, 6
KINDS = ("gyroscope", "accelerometer")
GRAVITY = 9.80665
RATE, BANDS = 50.0, tuple((2.5 * i, 2.5 * (i + 1)) for i in range(4, 10))
Floats = npt.NDArray[np.float64]


def preset(name: str, period: float) -> Imu:
    """Return a chip at rest, float32: no vibration, and what does not show at rest left out."""
    return cast(Imu(**{**PRESETS[name], "preset": name, "period": period, "vibration": "none"}), np.float32)


def readings(sensor: Imu, count: int, chips: int, seed: int = SEED) -> dict[str, npt.NDArray[np.float32]]:
    """Return readings (count, chips, 3) of gyroscopes [rad/s] and accelerometers [m/s^2] at rest in hover."""
    zero = jnp.zeros(chips, jnp.float32)
    inputs = {
        "rates_body": Vec3(zero, zero, zero),
        "specific_force": Vec3(zero, zero, zero - GRAVITY),
        "load": Load(zero + 1.0, zero + 1.0),
    }
    found = readings_at_rest(sensor, "imu", inputs, ("rates_body", "specific_force"), count, seed)
    return dict(zip(KINDS, found, strict=True))


def expected_variance(sensor: Imu, kind: str, lengths: npt.NDArray[np.int64]) -> Floats:
    """Return the Allan variance of readings over windows of so many readings (K,), exactly for what is discretised.

    White noise of N^2/T a reading; Gauss-Markov processes and a random walk that are held for six readings each, whose
    windows begin at any of the six with equal probability.
    """
    white, instability, walk = (
        float(getattr(sensor, f"{kind}_{name}")) for name in ("noise", "bias_instability", "random_walk")
    )
    span = HELD * sensor.period
    found = []
    for length in lengths:
        total = white**2 / (length * sensor.period)
        for phase in range(HELD):
            weights = np.zeros(2 * (length // HELD) + 4)
            place = (np.arange(2 * length) + phase) // HELD
            sign = np.where(np.arange(2 * length) < length, -1.0, 1.0) / length
            np.add.at(weights, place, sign)
            together = scipy.signal.correlate(weights, weights, method="fft")[len(weights) - 1 :]
            lags = np.arange(len(weights))
            doubled = np.where(lags == 0, 1.0, 2.0) * together
            flicker = sum(float(np.sum(doubled * np.exp(-lags * span / time))) for time in TIMES)
            tails = np.cumsum(weights[::-1])[::-1]
            walked = span * float(np.sum(tails[1:] ** 2))
            total += 0.5 * (SHARE * instability**2 * flicker + walk**2 * walked) / HELD
        found.append(total)
    return np.array(found)


def fitted(windows: Floats, variance: Floats) -> dict[str, float]:
    """Return N, B and K of a fit to an Allan variance, as calibration tools make it.

    N by the slope of the first decade of windows, N^2/t; B and K by (2 ln 2/pi) B^2 + K^2 t/3 to the windows from 100 s
    on, none negative, each window by its relative error.
    """
    short, long = windows <= 10.0 * windows[0], windows >= LONG
    noise = math.exp(0.5 * float(np.mean(np.log(variance[short] * windows[short]))))
    weight = 1.0 / variance[long]
    terms = np.stack([np.full(long.sum(), 2.0 * math.log(2.0) / math.pi), windows[long] / 3.0], axis=1)
    (b, k), _ = scipy.optimize.nnls(terms * weight[:, None], (variance[long] - noise**2 / windows[long]) * weight)
    return {"noise": noise, "bias_instability": float(np.sqrt(b)), "random_walk": float(np.sqrt(k))}


def at_rest(name: str, hours: float, chips: int, period: float, seed: int = SEED) -> dict[str, Any]:
    """Return how chips of a preset at rest compare with the theory."""
    sensor = preset(name, period)
    count = round(3600.0 * hours / period)
    taken = readings(sensor, count, chips, seed)
    found: dict[str, Any] = {}
    for kind in KINDS:
        row = compared(taken[kind], period, 25, partial(expected_variance, sensor, kind), CONFIDENCE)
        fit = fitted(row.windows, row.variance)
        true = {key: float(getattr(sensor, f"{kind}_{key}")) for key in fit}
        found[kind] = {
            **row.row(),
            "fitted_over_true": {key: fit[key] / true[key] for key in fit},
            "true": true,
        }
    return found


def spectrum_of_the_recording() -> dict[str, Any]:
    """Return rms of the recorded rates and of the measured vibration in each band, and what is fitted."""
    flight = np.loadtxt(data_file("outdoor_flight.csv"), delimiter=",")
    recorded = flight[:, 9:12] - flight[:, 9:12].mean(axis=0)
    quiet = {"gyroscope_noise": 0.0, "gyroscope_bias_instability": 0.0, "gyroscope_random_walk": 0.0}
    sensor = cast(replace(Imu(vibration="measured"), **quiet), np.float32)  # type: ignore[arg-type]
    shaken = readings(sensor, len(flight), 8)["gyroscope"].astype(np.float64)
    own = _band_rms(shaken - shaken.mean(axis=0))
    there = _band_rms(recorded[:, None, :])
    whole = np.sqrt(np.sum(there**2, axis=0))
    mine = np.sqrt(np.sum(own**2, axis=0))
    names = [f"{low:g}_hz".replace(".", "_") for low, _ in BANDS]
    axes = {
        axis: {
            "recorded": float(whole[i]),
            "simulated": float(mine[i]),
            # White noise up to 25 Hz has 15/25 of its variance there.
            "level": float(whole[i] * math.sqrt(25.0 / 15.0)),
            "bands": {name: float(own[b, i] / there[b, i]) for b, name in enumerate(names)},
        }
        for i, axis in enumerate("xyz")
    }
    return {**axes, "worst_band_ratio": float(np.exp(np.max(np.abs(np.log(own / there)))))}


def _band_rms(series: Floats) -> Floats:
    """Return the rms (bands, 3) of series (N, chips, 3), the mean square over chips."""
    frequency, density = scipy.signal.welch(series, RATE, nperseg=500, axis=0)
    step = frequency[1]
    rows = [np.sum(density[(frequency >= low) & (frequency < high)], axis=0) * step for low, high in BANDS[:-1]]
    rows.append(np.sum(density[frequency >= BANDS[-1][0]], axis=0) * step)
    return np.asarray(np.sqrt(np.mean(np.array(rows), axis=1)))


def draw(rest: dict[str, Any]) -> None:
    """Write docs/images/imu_allan.png: measured and expected Allan deviations of every preset."""
    units = {"gyroscope": (3600.0 * 180.0 / math.pi, "deg/h"), "accelerometer": (1e6 / GRAVITY, "ug")}
    with picture(IMAGES / "imu_allan.png", (8.0, 3.9), 1, 2) as panels:
        for axes, kind in zip(panels, KINDS, strict=True):
            scale, unit = units[kind]
            for number, (name, rows) in enumerate(rest.items()):
                row = rows[kind]
                axes.loglog(row["windows_s"], scale * np.array(row["expected"]), color=f"C{number}", linewidth=1.0)
                axes.loglog(
                    row["windows_s"],
                    scale * np.array(row["deviation"]),
                    ".",
                    color=f"C{number}",
                    markersize=4,
                    label=name,
                )
            axes.set(title=kind, xlabel="window [s]", ylabel=f"Allan deviation [{unit}]")


def run(full: bool) -> dict[str, Any]:
    """Return all comparisons; the full form has six hours of four chips of each preset at 50 Hz."""
    hours, chips, period = (6.0, 4, 0.02) if full else (1.0, 4, 0.2)
    names = list(PRESETS) if full else ["icm42688p"]
    rest = {name: at_rest(name, hours, chips, period) for name in names}
    if full:
        draw(rest)
    for rows in rest.values():
        for row in rows.values():
            for long in ("windows_s", "deviation", "expected"):
                del row[long]
    return {
        "confidence": CONFIDENCE,
        "hours": hours,
        "chips": chips,
        "period_s": period,
        "at_rest": rest,
        "recording": spectrum_of_the_recording(),
    }
