"""A Kalman filter of your own in NumPy, fed with nothing but readings, beside the built-in one on the same flights.

``python examples/ekf.py [SEEDS [SECONDS]]`` flies 200 seeds for 60 s in wind and prints what both err by, and ANEES:
the squares of errors over those stated, per error; 1 is right. Its 15 errors are those of (F1),
docs/explanation/models/estimators.md.
"""

import sys

import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

import qrsim
from qrsim.control.covariance import matrix

OVERRIDES = [
    "fleets.pelicans.vehicles=[{position_ned: [0, 0, -20], waypoints_ned: [[20, 0, -20], [0, 20, -20], [0, 0, -20]]}]",
    "fleets.pelicans.sensors={gnss: {type: gnss_receiver}, barometer: {type: barometer, white_std: 0.1}, "
    "imu: {type: imu}, compass: {type: magnetometer}}",
    "fleets.pelicans.estimator={type: ekf}",
]
DT, GRAVITY, LATE = 0.02, np.array([0.0, 0.0, 9.81]), 10
GYROSCOPE, ACCELEROMETER, FIX, SPEED, HEIGHT, HEADING = 1e-3, 0.02, 1.5, 0.2, 0.3, 0.05
START = np.repeat([FIX, SPEED, 0.03, 0.01, 0.2], 3)  # std of each error: place, speed, turn, biases
WALK = np.repeat([0.0, ACCELEROMETER, GYROSCOPE, 2e-5, 3e-4], 3)


class Filter:
    """Place, velocity and attitude (body to NED) of S vehicles, biases, and the covariance of their errors."""

    def __init__(self, place, attitude, declination):
        self.p, self.v, self.R, self.declination = place, np.zeros_like(place), attitude, declination
        self.biases, self.P = np.zeros((2, *place.shape)), np.tile(np.diag(START**2), (len(place), 1, 1))
        self.past, self.last = [(self.p, self.v)] * LATE, None

    def step(self, now):
        """Predict by the inertial sensor and correct by what is new, which is what has changed."""
        last = self.last or now
        new = {name: self.last is None or not np.array_equal(z, last[name]) for name, z in now.items()}
        rates = 0.5 * (now["rates"] + last["rates"]) - self.biases[0]
        before, self.R = self.R, self.R @ Rotation.from_rotvec(rates * DT).as_matrix()
        force = np.einsum("sij,sj->si", 0.5 * (before + self.R), now["force"] - self.biases[1])
        self.past = [*self.past[1:], (self.p, self.v)]
        change = (force + GRAVITY) * DT
        self.p, self.v, self.last = self.p + (self.v + change / 2) * DT, self.v + change, now
        F = np.tile(np.eye(15) + DT * np.eye(15, k=3) * (np.arange(15) < 6), (len(self.p), 1, 1))
        F[:, 3:6, 6:9] = DT * np.cross(np.eye(3), force[:, None]).swapaxes(1, 2)
        F[:, 6:9, 9:12] = F[:, 3:6, 12:15] = -DT * self.R
        self.P = F @ self.P @ F.transpose(0, 2, 1) + np.diag(WALK**2 * DT)
        if new["place"]:  # of 0.2 s ago
            place, speed = now["place"] - self.past[0][0], now["speed"] - self.past[0][1]
            rows = [({k: 1.0, 3 + k: -LATE * DT}, place[:, k], FIX) for k in range(2)]
            back = [{j: -LATE * F[:, 3 + k, j] for j in range(6, 15)} for k in range(3)]
            self.correct(rows + [({3 + k: 1.0, **back[k]}, speed[:, k], SPEED) for k in range(3)])
        if new["height"]:
            self.correct([({2: 1.0}, -now["height"] - self.p[:, 2], HEIGHT)])
        if new["field"]:
            north, east, down = np.einsum("sij,sj->is", self.R, now["field"])
            slope, miss = down / np.hypot(north, east), self.declination - np.arctan2(east, north)
            # By the true direction of the field: that of the reading has the noise that is in ``miss``, too.
            row = {6: -np.cos(self.declination) * slope, 7: -np.sin(self.declination) * slope, 8: 1.0}
            self.correct([(row, np.remainder(miss + np.pi, 2 * np.pi) - np.pi, HEADING)])

    def correct(self, rows):
        """Correct by numbers (S,), each with its factors of the errors, how far off it is, and its std."""
        x = np.zeros(self.P.shape[:2])
        for row, miss, std in rows:
            H = np.stack([np.broadcast_to(row.get(k, 0.0), len(x)) for k in range(15)], axis=-1)
            PH = np.einsum("sij,sj->si", self.P, H)
            gain = PH / (np.einsum("si,si->s", PH, H) + std**2)[:, None]
            x = x + gain * (miss - np.einsum("si,si->s", H, x))[:, None]
            self.P = self.P - gain[:, :, None] * PH[:, None]
        self.p, self.v = self.p + x[:, :3], self.v + x[:, 3:6]
        self.R = Rotation.from_rotvec(x[:, 6:9]).as_matrix() @ self.R
        self.past = [(p + x[:, :3] - (LATE - i) * DT * x[:, 3:6], v + x[:, 3:6]) for i, (p, v) in enumerate(self.past)]
        self.biases = self.biases + x[:, 9:].reshape(-1, 2, 3).swapaxes(0, 1)


def look(state):
    """Return what is kept of a tick of the one vehicle: readings, the truth, and what the built-in filter says."""
    fleet = state.fleets[0]
    (gnss, barometer, imu, compass), true, own = fleet.readings, fleet.vehicle, fleet.belief.estimate
    angles = [jnp.stack([a.yaw[0], a.pitch[0], a.roll[0]]) for a in (true.attitude, own.attitude)]
    vectors = (
        gnss.position_ned,
        gnss.velocity_ned,
        imu.rates_body,
        imu.specific_force,
        compass.field_body,
        true.position_ned,
        true.velocity_body,
        own.position_ned,
        own.velocity_ned,
    )
    said = matrix(fleet.belief.memory.covariance)[:9, :9, 0]
    return [jnp.stack(vector.axes, axis=-1)[0] for vector in vectors], angles, barometer.height[0], said


def compared(seeds, seconds):
    """Return of each filter: rms errors of place [m], velocity [m/s], tilt and yaw [deg], and ANEES, from 10 s on."""
    scenario = qrsim.load_scenario("patrol_plain", [*OVERRIDES, f"duration={seconds}"], quiet=True)
    flown = qrsim.rollout(scenario, seeds=range(seeds), record=look, record_every=1)
    vectors, angles, height, said = flown.recorded
    given = dict(zip(("place", "speed", "rates", "force", "field"), vectors, strict=False), height=height)
    true, own = (Rotation.from_euler("ZYX", a.reshape(-1, 3)).as_matrix().reshape(*a.shape, 3) for a in angles)
    place, speed = vectors[5], np.einsum("skij,skj->ski", true, vectors[6])
    mine = Filter(place[:, 0].astype(float), true[:, 0], np.arctan2(*scenario.earth_field_ned[1::-1]))
    found = {"your own": [], "built-in": []}
    for k in range(1, place.shape[1]):
        mine.step({name: np.asarray(array[:, k], float) for name, array in given.items()})
        says = [(mine.p, mine.v, mine.R, mine.P[:, :9, :9]), (*(x[:, k] for x in (*vectors[7:], own, said)),)]
        for name, (p, v, R, P) in zip(found, says, strict=True):
            angle = Rotation.from_matrix(true[:, k] @ R.swapaxes(1, 2)).as_rotvec()
            e = np.concatenate([place[:, k] - p, speed[:, k] - v, angle], axis=1)
            anees = np.einsum("si,sij,sj->s", e, np.linalg.inv(np.asarray(P, float)), e) / 9
            squares = [np.sum(e[:, a:b] ** 2, axis=1) for a, b in ((0, 3), (3, 6), (6, 8), (8, 9))]
            found[name] += [np.mean([*squares, anees], axis=1)] if k * DT >= 10.0 else []
    means = {name: np.mean(rows, axis=0) for name, rows in found.items()}
    return {name: [*np.sqrt(mean[:2]), *np.degrees(np.sqrt(mean[2:4])), mean[4]] for name, mean in means.items()}


if __name__ == "__main__":
    seeds, seconds = [*map(int, sys.argv[1:]), *(200, 60)[len(sys.argv) - 1 :]]
    print(f"{'filter':<12} {'place [m]':>10} {'speed [m/s]':>12} {'tilt [deg]':>11} {'yaw [deg]':>10} {'ANEES':>7}")
    for name, row in compared(seeds, seconds).items():
        print(f"{name:<12} {row[0]:10.2f} {row[1]:12.3f} {row[2]:11.2f} {row[3]:10.2f} {row[4]:7.2f}")
