"""What the error-state Kalman filter errs by, beside what it says of itself.

Many vehicles sway, climb and turn; their readings have the noise that the filter is told of. Normalised squares of its
errors (NEES) are then chi-square distributed: with fixes on time, and with fixes that are 0.3 s late. With errors of
fixes that are as large but correlated in time, as those of GNSS are, it believes itself far better than it is.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy import stats
from scipy.spatial.transform import Rotation as Turn

from qrsim.control.ekf import SIZE, ErrorStateKalmanFilter, KalmanState
from qrsim.control.setpoints import Estimate
from qrsim.core.tree import record, replace
from qrsim.core.vectors import Euler, Vec3

DOC = "errors of the Kalman filter beside what it states, under white, late and coloured fixes"
SEED = 20261122
DT, SUBSTEPS, GRAVITY = 0.02, 5, 9.81
# Vehicles and ticks; ticks that late fixes are late by; correlation time of coloured ones [s].
FULL, SMALL = (200, 3000), (40, 60)
LATE, CORRELATION_S = 15, 30.0
CONFIDENCE = 0.95
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


def filtered(
    kalman: ErrorStateKalmanFilter, truth: Flown, seed: int, late: int = 0, **change: Any
) -> tuple[KalmanState, dict[str, Floats]]:
    """Return the filter's states (T, n) on readings with the noise that it is told of, and the true biases.

    ``change`` may replace readings: functions of the array of a reading (T, n, 3) or (T, n); fixes are so many ticks
    late.
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
    given = {name: change[name](array) if name in change else array for name, array in given.items()}
    # The first fix, with which the filter begins, is not the one that arrives late.
    first = {"fix": truth.position[:1] + random.standard_normal((1, count, 3)) * level}
    first["speed"] = truth.velocity[:1] + float(kalman.velocity_std) * random.standard_normal((1, count, 3))
    for name, array in first.items():
        given[name] = np.concatenate([array, given[name][np.maximum(np.arange(1, ticks + 1) - late, 0)]])

    def readings(k: Any) -> dict[str, Any]:
        part = {name: array[k] for name, array in packed.items()}
        zero = jnp.zeros(count, jnp.float32)
        return {
            "imu": Inertial(Vec3(*part["rates"].T), Vec3(*part["force"].T)),
            "gnss": Fix(Vec3(*part["fix"].T), Vec3(*part["speed"].T)),
            "barometer": Height(part["height"]),
            "compass": Heading(Euler(zero, zero, part["yaw"])),
        }

    packed = {name: jnp.asarray(array, jnp.float32) for name, array in given.items()}
    tilt = float(kalman.tilt_std) * random.standard_normal((count, 2))
    wrong = np.concatenate([tilt, np.zeros((count, 1))], axis=1)
    begun = (Turn.from_rotvec(wrong) * Turn.from_matrix(truth.turned[0])).as_euler("ZYX")[:, ::-1]
    angles = Euler(*(jnp.asarray(begun[:, axis], jnp.float32) for axis in range(3)))
    state, _ = kalman.init(readings(0), Estimate(vec(truth.position[0]), vec(truth.velocity[0]), angles))

    def tick(state: KalmanState, k: Any) -> tuple[KalmanState, KalmanState]:
        fresh = {"imu": jnp.array(True), "gnss": k % 10 == 0, "barometer": k % 2 == 0, "compass": k % 5 == 0}
        state, _ = kalman.step(state, readings(k), fresh, DT)
        return state, state

    _, states = jax.jit(lambda state: jax.lax.scan(tick, state, jnp.arange(1, ticks + 1)))(state)
    return states, biases


def errors(states: KalmanState, truth: Flown, biases: dict[str, Floats], k: int) -> tuple[Floats, Floats]:
    """Return the errors (n, 15) after tick k, from 1, and the covariances (n, 15, 15) that the filter states."""

    def of(vector: Vec3) -> Floats:
        return np.stack([np.asarray(axis[k - 1], float) for axis in (vector.x, vector.y, vector.z)], axis=-1)

    q = states.attitude
    estimated = Turn.from_quat(np.stack([np.asarray(axis[k - 1], float) for axis in (q.x, q.y, q.z, q.w)], axis=-1))
    parts = [
        truth.position[k] - of(states.position_ned) - of(states.position_low_ned),
        truth.velocity[k] - of(states.velocity_ned),
        (Turn.from_matrix(truth.turned[k]) * estimated.inv()).as_rotvec(),
        biases["gyroscope"] - of(states.gyroscope_bias),
        biases["accelerometer"] - of(states.accelerometer_bias),
    ]
    whole = np.moveaxis(np.asarray(states.covariance[k - 1], float), -1, 0)
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


def run(full: bool) -> dict[str, Any]:
    """Return the mean NEES of each case, its band, and how often the place is within the 95 % that are stated."""
    count, last = FULL if full else SMALL
    truth = flown(last, count, np.random.default_rng(SEED))
    ticks = np.unique(np.linspace(10, last, 60).astype(int)).tolist()
    kalman = ErrorStateKalmanFilter()
    cases = {"white": (0, False), "late": (LATE, False), "coloured": (0, True)}
    curves = {name: normalised(kalman, truth, ticks, *case) for name, case in cases.items()}
    low, high = stats.chi2.ppf([0.5 - CONFIDENCE / 2, 0.5 + CONFIDENCE / 2], SIZE * count) / count
    # From when the start is forgotten.
    later = np.array(ticks) > last // 3
    if full:
        _draw(np.array(ticks) * DT, curves, (low, high))
    return {
        "vehicles": count,
        "seconds": last * DT,
        "late_s": LATE * DT,
        "correlation_s": CORRELATION_S,
        "errors": SIZE,
        "band_low": round(float(low), 2),
        "band_high": round(float(high), 2),
        **{name: _summary(found, later, low, high) for name, found in curves.items()},
    }


def _summary(found: Floats, later: Floats, low: float, high: float) -> dict[str, float]:
    means = found[..., 0].mean(axis=1)
    bound = stats.chi2.ppf(CONFIDENCE, 3)
    return {
        "nees": round(float(means[later].mean()), 2),
        "inside_percent": round(100.0 * float(np.mean((means > low) & (means < high)))),
        "place_nees": round(float(found[later, :, 1].mean()), 2),
        "place_within_percent": round(100.0 * float((found[later, :, 1] < bound).mean()), 1),
    }


def _draw(times: Floats, curves: dict[str, Floats], band: tuple[float, float]) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 4.0), layout="constrained")
    axes = figure.subplots()
    for (name, found), colour in zip(curves.items(), ("#3b76f0", "#0b9e73", "#b35806"), strict=True):
        axes.semilogy(times, found[..., 0].mean(axis=1), color=colour, label=f"{name} errors of fixes")
    axes.axhspan(*band, color="gray", alpha=0.3, label="95 % of a filter that is right")
    axes.set_xlabel("time [s]")
    axes.set_ylabel(f"mean NEES of {SIZE} errors [1]")
    axes.grid(alpha=0.3, which="both")
    axes.legend(loc="center right")
    figure.savefig(PICTURE, dpi=110)
