"""The true states of multirotors for PX4's log, from the packed state at every frame."""

from __future__ import annotations

import math
from typing import cast

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.links.autopilot import px4_messages as messages
from qrsim.models.geoid import GeoidPlane
from qrsim.models.vehicles.multirotor import Multirotor
from qrsim.simulation.simulation import Simulation

# WGS-84: semi-axes [m].
_A, _B = 6378137.0, 6356752.314245179
_E2, _F2 = 1.0 - (_B / _A) ** 2, (_A / _B) ** 2 - 1.0
# Columns of the numbers read: vectors of three, but for the quaternion.
PLACE, QUATERNION, VELOCITY, RATES, FORCE, WIND, GUST = 0, 3, 7, 10, 13, 16, 19


def geodetic(point: tuple[float, float, float]) -> tuple[float, float, float]:
    """Convert an Earth-centred, Earth-fixed position [m] to latitude, longitude [deg] and height [m], by Bowring
    (1976)."""
    x, y, z = point
    away = math.hypot(x, y)
    theta = math.atan2(z * _A, away * _B)
    latitude = math.atan2(z + _F2 * _B * math.sin(theta) ** 3, away - _E2 * _A * math.cos(theta) ** 3)
    sine, cosine = math.sin(latitude), math.cos(latitude)
    height = away * cosine + z * sine - _A * math.sqrt(1.0 - _E2 * sine * sine)
    return math.degrees(latitude), math.degrees(math.atan2(y, x)), height


def above(place: tuple[float, float, float], undulation: float) -> tuple[float, float, float]:
    """Convert a height above the ellipsoid to one above the geoid [m]; latitude and longitude [deg] stay."""
    return place[0], place[1], place[2] - undulation


def turned(quaternion: NumpyArray, vectors: NumpyArray) -> NumpyArray:
    """Rotate body-frame vectors (n, 3) to NED by attitude quaternions (n, 4: w, x, y, z)."""
    w, x, y, z = quaternion.T
    a, b, c = vectors.T
    p, q, r = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    return np.stack((a + w * p + y * r - z * q, b + w * q + z * p - x * r, c + w * r + x * q - y * p), axis=1)


class TrueStates:
    """Messages with the true states of the vehicles (n,) of a fleet.

    Args:
        simulation: reset.
        number: of the fleet of multirotors in its world.
    """

    def __init__(self, simulation: Simulation, number: int):
        self._simulation = simulation
        layout, _ = simulation.packed
        state = layout.numbers.fleets[number]
        vehicle = state.vehicle
        place, turn = vehicle.position_ned, vehicle.quaternion
        leaves = [place.x, place.y, place.z, turn.w, turn.x, turn.y, turn.z]
        moving = (vehicle.velocity_body, vehicle.rates_body)
        for vector in (*moving, state.specific_force, state.mean_wind_ned, state.gust_ned):
            leaves += [vector.x, vector.y, vector.z]
        self._places = np.array([np.arange(layout.slices[at].start, layout.slices[at].stop) for at in leaves])
        fleet = simulation.world.fleets[number]
        vehicle_model = cast(Multirotor, fleet.vehicle)
        self._gravity = np.broadcast_to(np.asarray(vehicle_model.gravity, np.float64), (fleet.size,))
        site = simulation.site
        self._geoid = GeoidPlane.at(site)
        self._origin, self._to_ned = site.origin_ecef(), site.ned_from_ecef_rotation()

    def payloads(self, usec: int) -> list[bytes]:
        """Return each vehicle's HIL_STATE_QUATERNION payload, its true state at ``usec`` [us] of PX4's boot clock."""
        floats = np.asarray(self._simulation.packed[1][0])
        rows = floats[self._places].T.astype(np.float64)
        quaternion = rows[:, QUATERNION:VELOCITY]
        velocity = turned(quaternion, rows[:, VELOCITY:RATES])
        acceleration = turned(quaternion, rows[:, FORCE:WIND])
        acceleration[:, 2] += self._gravity
        air = velocity - rows[:, WIND:GUST] - rows[:, GUST:]
        undulations = self._geoid.undulation(rows[:, PLACE], rows[:, PLACE + 1])
        earth = self._origin + rows[:, PLACE:QUATERNION] @ self._to_ned
        return [
            messages.true_state(usec, row[QUATERNION:VELOCITY], row[RATES:FORCE], above(geodetic(point), sea), *moving)
            for row, point, sea, *moving in zip(
                rows.tolist(),
                earth.tolist(),
                undulations.tolist(),
                velocity.tolist(),
                np.sqrt((air * air).sum(axis=1)).tolist(),
                acceleration.tolist(),
                strict=True,
            )
        ]
