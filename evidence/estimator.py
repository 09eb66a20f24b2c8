"""What the error-state Kalman filter errs by, beside what it says of itself.

Many vehicles sway, climb and turn; their readings have the noise that the filter is told of. Normalised squares of its
errors (NEES) are then chi-square distributed: with fixes on time, with fixes that are 0.3 s late, and with
magnetometer, airspeed and drifting barometer and all the 24 errors that these bring. With errors of fixes that are as
large but correlated in time, as those of GNSS are, it believes itself far better than it is.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy

from evidence._outdoors import outdoors
from qrsim.control.covariance import matrix
from qrsim.control.ekf import ErrorStateKalmanFilter
from qrsim.control.kalman_state import SIZE, KalmanState
from qrsim.control.setpoints import Estimate
from qrsim.core.tree import record, replace
from qrsim.core.vectors import Euler, Vec3
from qrsim.engine.settings import quick_jit

DOC = "errors of the Kalman filter compared with what it states: white, late and coloured fixes, and outdoors"
SEED = 20261122
DT, SUBSTEPS, GRAVITY = 0.02, 5, 9.81
# Vehicles and ticks; ticks that late fixes are late by; correlation time of coloured ones [s].
FULL, SMALL = (200, 3000), (40, 60)
LATE, CORRELATION_S = 15, 30.0
CONFIDENCE = 0.95
# Errors of a filter with all sensors.
MOST = 24
# The Earth's field of a place at middle latitudes: north, east, down [uT].
EARTH_FIELD = (20.0, 1.5, 44.0)
PICTURE = Path(__file__).resolve().parent.parent / "docs" / "images" / "estimator_nees.png"
Floats = np.ndarray


@record
class Fix:
    """Reading of a GNSS receiver."""

    position_ned: Vec3
    velocity_ned: Vec3


@record
class Height:
    """Reading of a barometer."""

    height: Any


@record
class Heading:
    """Reading of a compass: yaw alone counts."""

    attitude: Euler


@record
class Magnetic:
    """Reading of a magnetometer."""

    field_body: Vec3


@record
class Pitot:
    """Reading of an airspeed sensor."""

    true_airspeed: Any


@record
class Inertial:
    """Reading of gyroscope and accelerometer."""

    rates_body: Vec3
    specific_force: Vec3


class Flown(NamedTuple):
    """The truth at each tick: (T, n, 3) each, and the attitude as rotations to NED (T, n, 3, 3)."""

    position: Floats
    velocity: Floats
    turned: Floats
    rates: Floats
    force: Floats


def flown(ticks: int, count: int, random: np.random.Generator) -> Flown:
    """Return vehicles that sway, climb and turn, each by sines of its own, integrated in steps far below a tick."""
    h = DT / SUBSTEPS
    times = np.arange(ticks * SUBSTEPS + 1)[:, None, None] * h

    def sines(size: float, slowest: float, fastest: float) -> Floats:
        found = np.zeros((times.size, count, 3))
        for _ in range(3):
            speed = random.uniform(slowest, fastest, (count, 3)) * 2.0 * np.pi
            found += size * np.sin(speed * times + random.uniform(0.0, 2.0 * np.pi, (count, 3)))
        return found

    Turn = scipy.spatial.transform.Rotation
    acceleration = sines(0.8, 0.05, 0.5)
    angles = sines(0.12, 0.05, 0.6)
    angles[..., 2] = angles[..., 2] * 4.0 + random.uniform(-3.0, 3.0, count) + 0.1 * times[..., 0]
    turned = Turn.from_euler("ZYX", angles[..., ::-1].reshape(-1, 3))
    between = turned.as_matrix().reshape(*angles.shape[:2], 3, 3)
    after = Turn.from_matrix(np.swapaxes(between[:-1], -1, -2).reshape(-1, 3, 3)) * Turn.from_matrix(
        between[1:].reshape(-1, 3, 3)
    )
    rates = after.as_rotvec().reshape(-1, count, 3) / h
    middle = 0.5 * (acceleration[1:] + acceleration[:-1])
    velocity = np.concatenate([np.zeros((1, count, 3)), np.cumsum(middle * h, axis=0)])
    position = np.concatenate([np.zeros((1, count, 3)), np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) * h, axis=0)])
    force = np.einsum("tnij,tni->tnj", 0.5 * (between[1:] + between[:-1]), middle - [0.0, 0.0, GRAVITY])
    mean = force.reshape(ticks, SUBSTEPS, count, 3).mean(axis=1)
    ends = slice(None, None, SUBSTEPS)
    # The rate at the end of a tick: that between the substeps beside it.
    inner = 0.5 * (rates[SUBSTEPS - 1 : -1 : SUBSTEPS] + rates[SUBSTEPS::SUBSTEPS])
    at_ends = np.concatenate([rates[:1], inner, rates[-1:]])
    return Flown(position[ends], velocity[ends], between[ends], at_ends, mean)


def vec(array: Floats) -> Vec3:
    """Return (..., n, 3) as a vector of (..., n)."""
    return Vec3(*(jnp.asarray(array[..., axis], jnp.float32) for axis in range(3)))


def matched() -> ErrorStateKalmanFilter:
    """Return a filter of white errors alone: those that ``filtered`` draws."""
    return replace(ErrorStateKalmanFilter(), gnss_errors="white", sampling=jnp.float32(0.0))


def with_all() -> ErrorStateKalmanFilter:
    """Return the filter with all its 24 errors; every airspeed is believed, as the noise of one is the same at all."""
    earth = Vec3(*(jnp.float32(axis) for axis in EARTH_FIELD))
    return replace(matched(), earth_field_ned=earth, height_bias=True, airspeed_least=-1e3)


def walked(start_std: Any, walk: Any, shape: tuple[int, ...], random: np.random.Generator) -> Floats:
    """Return random walks (T, ...) from normal starts."""
    steps = float(walk) * DT**0.5 * random.standard_normal(shape)
    steps[0] = float(start_std) * random.standard_normal(shape[1:])
    return np.cumsum(steps, axis=0)


def filtered(
    kalman: ErrorStateKalmanFilter, truth: Flown, seed: int, late: int = 0, **change: Any
) -> tuple[KalmanState, dict[str, Floats]]:
    """Return the filter's states (T, n) on readings with the noise that it is told of, and the true biases.

    ``change`` may replace readings: functions of the array of a reading (T, n, 3) or (T, n); fixes are so many ticks
    late. A filter that knows the Earth's field has a magnetometer, an airspeed sensor and a barometer that drifts too,
    and no compass; the biases are then (T, n, ...).
    """
    random = np.random.default_rng(seed)
    ticks, count = truth.force.shape[:2]

    def noise(std: Any, *shape: int) -> Floats:
        return float(std) * random.standard_normal((ticks + 1, count, *shape))

    biases = {
        "gyroscope": float(kalman.gyroscope_bias_std) * random.standard_normal((count, 3)),
        "accelerometer": float(kalman.accelerometer_bias_std) * random.standard_normal((count, 3)),
    }
    rates = truth.rates + noise(float(kalman.gyroscope_noise) / DT**0.5, 3) + biases["gyroscope"]
    force = np.concatenate([truth.force[:1], truth.force]) + biases["accelerometer"]
    force = force + noise(float(kalman.accelerometer_noise) / DT**0.5, 3)
    level = np.array([kalman.position_std, kalman.position_std, kalman.vertical_std], float)
    fix = truth.position + noise(1.0, 3) * level
    speed = truth.velocity + noise(kalman.velocity_std, 3)
    height = -truth.position[..., 2] + noise(kalman.height_std)
    yaw = np.arctan2(truth.turned[..., 1, 0], truth.turned[..., 0, 0]) + noise(kalman.yaw_std)
    given = {"rates": rates, "force": force, "fix": fix, "speed": speed, "height": height, "yaw": yaw}
    if kalman.earth_field_ned is not None:
        given |= _others(kalman, truth, biases, given, random)
        del given["yaw"]
    given = {name: change[name](array) if name in change else array for name, array in given.items()}
    # The first fix, with which the filter begins, is not the one that arrives late.
    first = {"fix": truth.position[:1] + random.standard_normal((1, count, 3)) * level}
    first["speed"] = truth.velocity[:1] + float(kalman.velocity_std) * random.standard_normal((1, count, 3))
    for name, array in first.items():
        given[name] = np.concatenate([array, given[name][np.maximum(np.arange(1, ticks + 1) - late, 0)]])
    packed = {name: jnp.asarray(array, jnp.float32) for name, array in given.items()}

    wrong = np.zeros((count, 3))
    wrong[:, :2] = float(kalman.tilt_std) * random.standard_normal((count, 2))
    if "yaw" not in given:
        wrong[:, 2] = float(kalman.heading_std) * random.standard_normal(count)
    Turn = scipy.spatial.transform.Rotation
    begun = (Turn.from_rotvec(wrong) * Turn.from_matrix(truth.turned[0])).as_euler("ZYX")[:, ::-1]
    angles = Euler(*(jnp.asarray(begun[:, axis], jnp.float32) for axis in range(3)))
    state, _ = kalman.init(_readings(packed, 0), Estimate(vec(truth.position[0]), vec(truth.velocity[0]), angles))
    return _stepped(kalman, state, packed), biases


@quick_jit
def _stepped(kalman: ErrorStateKalmanFilter, state: KalmanState, packed: dict[str, Any]) -> KalmanState:
    """Return the states (T, n) after each of the readings but the first."""

    def tick(state: KalmanState, k: Any) -> tuple[KalmanState, KalmanState]:
        every = {"gnss": 10, "barometer": 2, "compass": 5, "magnetometer": 5, "pitot": 5, "imu": 1}
        new = {name: k % ticks == 0 for name, ticks in every.items()}
        state, _ = kalman.step(state, _readings(packed, k), new, DT)
        return state, state

    return jax.lax.scan(tick, state, jnp.arange(1, len(packed["fix"])))[1]


def _others(
    kalman: ErrorStateKalmanFilter, truth: Flown, biases: dict[str, Floats], given: dict[str, Floats],
    random: np.random.Generator,
) -> dict[str, Floats]:  # fmt: skip
    """Return the readings of magnetometer, airspeed sensor and drifting barometer; add what is true to ``biases``."""
    ticks, count = truth.position.shape[:2]
    walks = {
        "earth_field": (kalman.earth_field_std, kalman.field_walk, 3),
        "field": (kalman.field_bias_std, kalman.field_walk, 3),
        "wind": (kalman.wind_std, kalman.wind_walk, 2),
        "height": (kalman.height_bias_std, kalman.height_bias_walk, 1),
    }
    for name, (std, walk, axes) in walks.items():
        biases[name] = walked(std, walk, (ticks, count, axes), random)
    biases["earth_field"] = biases["earth_field"] + np.asarray(EARTH_FIELD)
    field = np.einsum("tnij,tni->tnj", truth.turned, biases["earth_field"]) + biases["field"]
    air = truth.velocity - np.concatenate([biases["wind"], np.zeros((ticks, count, 1))], axis=-1)
    ahead = np.einsum("tni,tni->tn", truth.turned[..., 0], air)
    return {
        "field": field + float(kalman.field_std) * random.standard_normal(field.shape),
        "airspeed": ahead + float(kalman.airspeed_std) * random.standard_normal(ahead.shape),
        "height": given["height"] + biases["height"][..., 0],
    }


def _readings(packed: dict[str, Any], k: Any) -> dict[str, Any]:
    """Return the readings of tick k, by the arrays (T, n) or (T, n, 3) that there are."""
    part = {name: array[k] for name, array in packed.items()}
    found: dict[str, Any] = {
        "imu": Inertial(Vec3(*part["rates"].T), Vec3(*part["force"].T)),
        "gnss": Fix(Vec3(*part["fix"].T), Vec3(*part["speed"].T)),
        "barometer": Height(part["height"]),
    }
    if "yaw" in part:
        zero = jnp.zeros_like(part["yaw"])
        found["compass"] = Heading(Euler(zero, zero, part["yaw"]))
    if "field" in part:
        found["magnetometer"] = Magnetic(Vec3(*part["field"].T))
        found["pitot"] = Pitot(part["airspeed"])
    return found


def errors(states: KalmanState, truth: Flown, biases: dict[str, Floats], k: int) -> tuple[Floats, Floats]:
    """Return the errors (n, m) after tick k, from 1, and the covariances (n, m, m) that the filter states."""

    def array(axis: Any) -> Floats:
        return np.asarray(axis[k - 1], float)

    def of(vector: Vec3) -> Floats:
        return np.stack([array(axis) for axis in vector.axes], axis=-1)

    Turn = scipy.spatial.transform.Rotation
    q, inner = states.attitude, states.inner
    estimated = Turn.from_quat(np.stack([array(axis) for axis in (q.x, q.y, q.z, q.w)], axis=-1))
    parts = [
        truth.position[k] - of(states.position_ned) - of(states.position_low_ned),
        truth.velocity[k] - of(states.velocity_ned),
        (Turn.from_matrix(truth.turned[k]) * estimated.inv()).as_rotvec(),
        biases["gyroscope"] - of(inner.gyroscope_bias),
        biases["accelerometer"] - of(inner.accelerometer_bias),
    ]
    if inner.earth_field_ned is not None:
        wind = np.stack([array(inner.wind_north), array(inner.wind_east)], axis=-1)
        parts += [
            biases["earth_field"][k] - of(inner.earth_field_ned),
            biases["field"][k] - of(inner.field_bias),
            biases["wind"][k] - wind,
            biases["height"][k] - array(inner.height_bias)[:, None],
        ]
    whole = np.moveaxis(np.array(matrix(states.covariance)[k - 1], float), -1, 0)
    if states.slow is not None:
        whole[:, range(3), range(3)] += of(states.slow)
    return np.concatenate(parts, axis=1), whole


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
    }


def _draw(times: Floats, curves: dict[str, Floats], band: tuple[float, float]) -> None:
    from matplotlib.figure import Figure

    labels = {
        "white": ("15 errors, white fixes", "#3b76f0"),
        "late": ("15 errors, late fixes", "#0b9e73"),
        "every": ("24 errors, white fixes", "#8a5fd0"),
        "every_late": ("24 errors, late fixes", "#7a7a7a"),
        "coloured": ("15 errors, coloured fixes taken for white", "#b35806"),
        "considered": ("15 errors, coloured fixes", "#d6a500"),
    }
    figure = Figure(figsize=(8.0, 4.0), layout="constrained")
    axes = figure.subplots()
    for name, found in curves.items():
        axes.semilogy(times, found, color=labels[name][1], label=labels[name][0], lw=1.3)
    axes.axhspan(*band, color="gray", alpha=0.3, label="95 % of a filter of 15 errors that is right")
    axes.set_xlabel("time [s]")
    axes.set_ylabel("mean NEES per error [1]")
    axes.grid(alpha=0.3, which="both")
    axes.legend(loc="center right")
    figure.savefig(PICTURE, dpi=110)
