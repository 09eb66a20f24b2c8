"""What the error-state Kalman filter errs by, beside what it says of itself.

Many vehicles sway, climb and turn; their readings have the noise that the filter is told of. Normalised squares of its
errors (NEES) are then chi-square distributed: with fixes on time, with fixes that are 0.3 s late, and with
magnetometer, airspeed and drifting barometer and all the 24 errors that these bring. With errors of fixes that are as
large but correlated in time, as those of GNSS are, it believes itself far better than it is.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy
from tests.control.kalman_rig import DT, Floats, Flown, errors, filtered, flown, matched, with_all

from evidence import IMAGES
from evidence._outdoors import outdoors
from evidence._pictures import picture
from qrsim.control.ekf import ErrorStateKalmanFilter
from qrsim.control.kalman_state import SIZE
from qrsim.core.tree import replace

DOC = "errors of the Kalman filter compared with what it states: white, late and coloured fixes, and outdoors"
SEED = 20261122
# Vehicles and ticks; ticks that late fixes are late by; correlation time of coloured ones [s].
FULL, SMALL = (200, 3000), (40, 60)
LATE, CORRELATION_S = 15, 30.0
CONFIDENCE = 0.95
# Errors of a filter with all sensors.
MOST = 24
PICTURE = IMAGES / "estimator_nees.png"


def coloured(array: Floats, random: np.random.Generator, truth: Floats, stds: Floats) -> Floats:
    """Return fixes (T, n, 3) with errors of the same std as an Ornstein-Uhlenbeck process in place of white ones."""
    keep = np.exp(-DT / CORRELATION_S)
    error = np.empty_like(array)
    error[0] = random.standard_normal(array.shape[1:]) * stds
    for k in range(1, len(array)):
        error[k] = keep * error[k - 1] + np.sqrt(1.0 - keep**2) * random.standard_normal(array.shape[1:]) * stds
    return truth + error


def normalised(kalman: ErrorStateKalmanFilter, truth: Flown, ticks: list[int], late: int, colour: bool) -> Floats:
    """Return the normalised squares (len(ticks), n, 2) of all errors, and of those of the place."""
    kalman = replace(kalman, ages=(("gnss", late),) if late else ())
    stds = np.array([kalman.position_std, kalman.position_std, kalman.vertical_std], float)
    random = np.random.default_rng(SEED + 1)
    change = {"fix": lambda array: coloured(array, random, truth.position, stds)} if colour else {}
    states, biases = filtered(kalman, truth, SEED, late, **change)
    found = []
    for k in ticks:
        wrong, stated = errors(states, truth, biases, k)
        whole = np.einsum("ni,nij,nj->n", wrong, np.linalg.inv(stated), wrong)
        place = np.einsum("ni,nij,nj->n", wrong[:, :3], np.linalg.inv(stated[:, :3, :3]), wrong[:, :3])
        found.append(np.stack([whole, place], axis=-1))
    return np.array(found)


def band(count: int, vehicles: int) -> tuple[float, float]:
    """Return the 95 % band of the mean over vehicles of so many squared errors, at one time."""
    low, high = scipy.stats.chi2.ppf([0.5 - CONFIDENCE / 2, 0.5 + CONFIDENCE / 2], count * vehicles) / vehicles
    return float(low), float(high)


def run(full: bool) -> dict[str, Any]:
    """Return the mean NEES of each case, its band, and how often the place is within the 95 % that are stated."""
    count, last = FULL if full else SMALL
    truth = flown(last, count, np.random.default_rng(SEED))
    ticks = np.unique(np.linspace(10, last, 60).astype(int)).tolist()
    plain, every = matched(), with_all()
    cases = {
        "white": (plain, SIZE, 0, False), "late": (plain, SIZE, LATE, False), "every": (every, MOST, 0, False),
        "every_late": (every, MOST, LATE, False), "coloured": (plain, SIZE, 0, True),
        "considered": (replace(plain, gnss_errors="coloured"), SIZE, 0, True),
    }  # fmt: skip
    # From when the start is forgotten.
    later = np.array(ticks) > last // 3
    curves, found = {}, {}
    for name, (kalman, size, late, colour) in cases.items():
        curves[name] = normalised(kalman, truth, ticks, late, colour)
        found[name] = _summary(curves[name], later, size)
        curves[name] = curves[name][..., 0].mean(axis=1) / size
    low, high = band(SIZE, count)
    if full:
        _draw(np.array(ticks) * DT, curves, (low / SIZE, high / SIZE))
    return {
        "vehicles": count,
        "seconds": last * DT,
        "late_s": LATE * DT,
        "correlation_s": CORRELATION_S,
        "errors": SIZE,
        "band_low": round(low, 2),
        "band_high": round(high, 2),
        **found,
        "outdoors": outdoors(full),
    }


def _summary(found: Floats, later: Floats, size: int) -> dict[str, Any]:
    means = found[..., 0].mean(axis=1)
    low, high = band(size, found.shape[1])
    # Of the mean over the flight of each vehicle, which are independent: errors of one flight last long.
    flights = found[later, :, 0].mean(axis=0)
    half = scipy.stats.t.ppf(0.5 + CONFIDENCE / 2, len(flights) - 1) * flights.std(ddof=1) / len(flights) ** 0.5
    return {
        "errors": size,
        "band_low": round(low, 1),
        "band_high": round(high, 1),
        "nees": round(float(means[later].mean()), 2),
        "low": round(float(flights.mean() - half), 1),
        "high": round(float(flights.mean() + half), 1),
        "inside_percent": round(100.0 * float(np.mean((means > low) & (means < high)))),
        "place_nees": round(float(found[later, :, 1].mean()), 2),
        "place_within_percent": round(
            100.0 * float((found[later, :, 1] < scipy.stats.chi2.ppf(CONFIDENCE, 3)).mean()), 1
        ),
    }  # fmt: skip


def _draw(times: Floats, curves: dict[str, Floats], band: tuple[float, float]) -> None:
    labels = {
        "white": ("15 errors, white fixes", "#3b76f0"), "late": ("15 errors, late fixes", "#0b9e73"),
        "every": ("24 errors, white fixes", "#8a5fd0"), "every_late": ("24 errors, late fixes", "#7a7a7a"),
        "coloured": ("15 errors, coloured fixes taken for white", "#b35806"),
        "considered": ("15 errors, coloured fixes", "#d6a500"),
    }  # fmt: skip
    with picture(PICTURE, (8.0, 4.0)) as axes:
        for name, found in curves.items():
            axes.semilogy(times, found, color=labels[name][1], label=labels[name][0], lw=1.3)
        axes.axhspan(*band, color="gray", alpha=0.3, label="95 % of a filter of 15 errors that is right")
        axes.set_xlabel("time [s]")
        axes.set_ylabel("mean NEES per error [1]")
        axes.legend(loc="center right")
