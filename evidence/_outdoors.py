"""Errors of the Kalman filter in flights of the default scenario, compared with the std that it states."""

from __future__ import annotations

from typing import Any, cast

import jax.numpy as jnp
import numpy as np

import qrsim
from qrsim.control.contracts import Estimator
from qrsim.control.kalman_state import Inner
from qrsim.core.fastmath import wrap_angle
from qrsim.interface.consistency import truth_of

# Worlds and seconds.
FULL, SMALL = (50, 120), (2, 4)
IMU, ESTIMATOR = "fleets.pelicans.sensors.imu", "fleets.pelicans.estimator"
# A filter that takes all errors for white and starts on the truth.
WHITE = (
    "{type: ekf, gnss_errors: white, start: truth, calibration_time: 0, sampling: 0, height_drift_std: 0, "
    "height_std: 0.3, field_scale: 0, field_std: 0.5, field_bias_std: 2, gyroscope_scale: 0, gyroscope_noise: 0.001, "
    "gyroscope_bias_std: 0.01, accelerometer_scale: 0, accelerometer_noise: 0.02, accelerometer_bias_std: 0.25}"
)
CASES: dict[str, list[str]] = {
    "default": [],
    "hover": ["fleets.pelicans.vehicles=[{position_ned: [0, 0, -20]}]"],
    "mpu6000": [f"{IMU}.preset=mpu6000"],
    "white": [f"{ESTIMATOR}={WHITE}"],
}
# Rows of a record that belong together.
BLOCKS = {
    "position": (0, 1, 2),
    "velocity": (3, 4, 5),
    "tilt": (6, 7),
    "yaw": (8,),
    "gyroscope": (9, 10, 11),
    "accelerometer": (12, 13, 14),
}
_ANGLES = ("roll", "pitch", "yaw")
# 95 % of errors are within this multiple of their std.
_WITHIN = 1.96


def outdoors(full: bool) -> dict[str, Any]:
    """Return, for each case and block, rms error, rms of the stated std, NEES per axis and coverage."""
    seeds, seconds = FULL if full else SMALL
    found: dict[str, Any] = {"seeds": seeds, "seconds": seconds}
    for name, overrides in CASES.items():
        errors, stds = _flown(overrides, seeds, seconds)
        found[name] = {}
        for block, rows in BLOCKS.items():
            error, std = errors[list(rows)], stds[list(rows)]
            over = error / std
            found[name][block] = {
                "rms": float(f"{np.sqrt(np.mean(error**2)):.3g}"),
                "stated": float(f"{np.sqrt(np.mean(std**2)):.3g}"),
                "nees": float(f"{np.mean(over**2):.3g}"),
                "within_percent": round(100.0 * float(np.mean(np.abs(over) < _WITHIN)), 1),
            }
    return found


def _flown(overrides: list[str], seeds: int, seconds: int) -> tuple[Any, Any]:
    """Return errors and stated stds (15, N) at every second of flights, of the motion and of both biases."""
    scenario = qrsim.load_scenario("outdoor_patrol", [f"duration={seconds}", *overrides], quiet=True)
    fleet = scenario.world().fleets[0]
    estimator = cast(Estimator, fleet.own_estimator)

    def look(state: Any) -> Any:
        fleet_state = state.fleets[0]
        truth, belief = truth_of(fleet, fleet_state), fleet_state.belief
        place = belief.estimate.offset_from(truth.position_ned) - truth.position_low_ned
        speed = belief.estimate.velocity_ned - truth.velocity_ned
        turn = [wrap_angle(getattr(belief.estimate.attitude, a) - getattr(truth.attitude, a)) for a in _ANGLES]
        stated = [*belief.std.position_ned.axes, *belief.std.velocity_ned.axes]
        stated += [getattr(belief.std.attitude, angle) for angle in _ANGLES]
        own, own_std = cast(tuple[Inner, Inner], estimator.inner(belief.memory))
        biases = []
        for name in ("gyroscope_bias", "accelerometer_bias"):
            biases += (getattr(own, name) - getattr(truth, name)).axes
            stated += getattr(own_std, name).axes
        return jnp.stack([*place.axes, *speed.axes, *turn, *biases, *stated])

    recorded = np.asarray(qrsim.rollout(scenario, seeds=range(seeds), record=look).recorded, float)
    flat = np.moveaxis(recorded, 2, 0).reshape(30, -1)
    return flat[:15], flat[15:]
