"""Small problems for tests: a flight that the model itself makes out of commands, without a simulation."""

from __future__ import annotations

from typing import Any

import numpy as np

from qrsim.core.tree import cast
from qrsim.models.vehicles.quadrotor import Quadrotor
from qrsim.studies.slam.flight import Flight, dead_reckon
from qrsim.studies.slam.ranging import Ranging, draw_landmarks

TIME_STEP, TICKS, STATES = 0.02, 5, 300
HOVER, BATTERY = 0.59004353928, 12.0
LANDMARKS = 10


def commands(seed: int = 1) -> Any:
    """Commands (T, K, 5) of a flight that goes round and up and down over some 40 m."""
    generator = np.random.default_rng(seed)
    time = TIME_STEP * np.arange((STATES - 1) * TICKS)
    phases = generator.uniform(0.0, 2.0 * np.pi, 3)
    pitch = 0.12 * np.sin(0.35 * time + phases[0])
    roll = 0.12 * np.cos(0.35 * time + phases[0])
    throttle = HOVER + 0.006 * np.sin(0.5 * time + phases[1])
    yaw_rate = 0.1 * np.sin(0.2 * time + phases[2])
    rows = np.stack([pitch, roll, throttle, yaw_rate, np.full_like(time, BATTERY)], axis=1)
    return rows.reshape(STATES - 1, TICKS, 5)


def exact_flight(estimate_noise: float = 0.0, fixes: bool = False) -> Flight:
    """A flight that its own commands explain exactly; the estimate may have white noise in the horizontal [m]."""
    vehicle = cast(Quadrotor(), np.float64)
    flown, air = commands(), np.zeros((STATES - 1, TICKS, 3))
    start = np.array([0.0, 0.0, -20.0, 0.0, 0.0, 0.2, 1.0, 0.5, 0.0, 0.0, 0.0, 0.0, 1.68 * 9.81])
    truth = dead_reckon(vehicle, start, flown, air, TIME_STEP)
    estimate = truth.copy()
    estimate[:, :2] += estimate_noise * np.random.default_rng(2).standard_normal((STATES, 2))
    places = np.full((STATES, 2), np.nan)
    if fixes:
        places[::2] = estimate[::2, :2]
    return Flight("exact", TIME_STEP, TICKS, vehicle, flown, air, truth, estimate, places)


def exact_ranges(flight: Flight, landmarks: Any = None, limit: float = 30.0) -> Ranging:
    """Ranges without noise to landmarks around the flight, which are looked for elsewhere."""
    centre = flight.truth[:, :2].mean(axis=0)
    places = draw_landmarks(5, 1, LANDMARKS, centre, 30.0) if landmarks is None else np.asarray(landmarks)
    guess = draw_landmarks(5, 2, len(places), centre, 30.0)
    distance = np.linalg.norm(flight.truth[:, None, :3] - places[None], axis=-1)
    ranges = np.where(distance <= limit, distance, np.nan)
    return Ranging(ranges, np.isfinite(ranges).astype(np.float64), 5.0, guess, places)
