"""Logs of simulated flights by random commands."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from qrsim.models.vehicles.quadrotor import Quadrotor
from qrsim.simulation.openloop import hover_state, simulate_open_loop
from qrsim.studies.flight_logs import FlightLog

DT = 0.02
# Standard deviations of what the log adds to the truth.
NOISE = {"angle": 0.005, "rate": 0.01, "velocity": 0.05}
THRUST_NOISE_N = 0.1

Floats = np.ndarray[Any, Any]


def random_steps(rows: int, size: float, dwell_s: tuple[float, float], rng: np.random.Generator) -> Floats:
    """Return (rows,) a signal that jumps to values of (-size, size) and stays there for a random time."""
    values = np.empty(rows)
    at = 0
    while at < rows:
        length = round(rng.uniform(*dwell_s) / DT)
        values[at : at + length] = rng.uniform(-size, size)
        at += length
    return values


def pelican_log(seed: int, flight_s: float = 40.0) -> FlightLog:
    """Return a noisy log of a published Pelican that flies in calm air by random commands, thrust measured."""
    rng = np.random.default_rng(seed)
    rows = round(flight_s / DT)
    asked = np.stack(
        [
            random_steps(rows, 0.3, (0.3, 1.5), rng),
            random_steps(rows, 0.3, (0.3, 1.5), rng),
            # Below what the battery allows at 12 V, because its ceiling is none of the laws.
            0.50 + random_steps(rows, 0.34, (0.3, 1.2), rng),
            random_steps(rows, 1.0, (0.5, 2.0), rng),
            np.full(rows, 12.0),
        ],
        axis=1,
    )
    start = hover_state(Quadrotor())
    states = np.concatenate([start[None], simulate_open_loop(Quadrotor(), asked, start)[:-1, :13]])
    names = ("roll", "pitch", "yaw", "roll_rate", "pitch_rate", "yaw_rate", "thrust")
    sizes = np.array([NOISE["angle"]] * 3 + [NOISE["rate"]] * 3 + [THRUST_NOISE_N])
    measured = states[:, [3, 4, 5, 9, 10, 11, 12]]
    measured = measured + sizes * rng.standard_normal(measured.shape)
    given = ("pitch_command", "roll_command", "throttle", "yaw_rate_command")
    signals = dict(zip(names, measured.T, strict=True)) | dict(zip(given, asked.T[:4], strict=True))
    return FlightLog("pelican", Path("pelican"), "simulated", DT, DT * np.arange(rows), signals)
