"""The identified model of a stabiliser that nobody wrote a model of: Betaflight's firmware on a multirotor.

The firmware flies a Hummingbird by random sticks, its height held by the simulator's controller; from that log alone
`qrsim identify` finds the constants of the second-order model, which starts from the published Pelican. Both then fly
open loop by sticks that were not fitted, in calm air and in wind with gusts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tests.studies.discover.flown_logs import random_steps

from evidence import IMAGES
from evidence._pictures import picture
from qrsim.links.autopilot.firmware import binary, configured
from qrsim.links.autopilot.fleet import prepared
from qrsim.links.autopilot.flight import Flight
from qrsim.models.vehicles.quadrotor import Quadrotor
from qrsim.scenarios.scenario import load_scenario
from qrsim.simulation.simulation import Simulation
from qrsim.studies.flight_logs import FlightLog
from qrsim.studies.identify.constants import CONSTANTS, PITCH
from qrsim.studies.identify.fit import Question
from qrsim.studies.identify.identification import identify
from qrsim.studies.identify.problem import cut
from qrsim.studies.identify.scores import open_loop, score

DOC = "constants identified from flights of Betaflight's firmware, and their errors on other flights, also in wind"
SEED = 20261123
FULL_S, SMALL_S = 120.0, 40.0
RATE_HZ, DT = 400.0, 0.02
# Sticks: largest tilt [rad] and yaw rate [rad/s], and for how long each is held [s].
TILT, YAW_RATE, DWELL_S = 0.35, 1.0, (0.3, 1.5)
WIND_20FT, BATTERY_V = 5.0, 11.1
# Of the Hummingbird.
MASS = 0.5
SIGNALS = (
    "roll", "pitch", "yaw", "roll_rate", "pitch_rate", "yaw_rate", "velocity_north", "velocity_east", "velocity_down",
)  # fmt: skip
PICTURE = IMAGES / "betaflight_identified.png"
Floats = np.ndarray[Any, Any]


def flight(seconds: float, seed: int, wind: float, eeprom: bytes) -> FlightLog:
    """Return the log (50 Hz) of a flight by random sticks, in a wind [m/s] at 20 ft with its gusts."""
    air: dict[str, Any] = {"area": {"type": "box", **_wide()}}
    if wind:
        air |= {
            "wind": {"type": "log_shear", "speed_20ft": wind, "wind_from_deg": 225.0},
            "turbulence": {"type": "dryden_field"},
        }
    content = {
        "name": "sticks",
        "description": "A multirotor flown by random sticks.",
        "duration": seconds,
        "world": air,
        "fleets": {
            "quads": {
                "vehicle": {"type": "multirotor", "model": "hummingbird"},
                "controller": {"type": "cascade", "feed": "truth"},
                "limits": {"velocity": 100.0, "rate": 30.0},
                "vehicles": [{"position_ned": [0.0, 0.0, -100.0]}],
            }
        },
    }
    scenario, fleets = prepared(load_scenario(content, quiet=True), (), "hummingbird", RATE_HZ)
    simulation = Simulation(scenario.world(), seed=seed, name=scenario.name, site=scenario.site)
    simulation.reset()
    rows, every = round(seconds / DT), round(RATE_HZ * DT)
    rng = np.random.default_rng(seed)
    sticks = np.stack([random_steps(rows, size, DWELL_S, rng) for size in (TILT, TILT, YAW_RATE)], axis=1)
    throttle = np.zeros(rows)

    def override(time: float, asked: list[Sequence[float]]) -> list[Sequence[float]]:
        row = min(int(time / DT + 1e-6), rows - 1)
        # That of the row's first step, so that the log has what was flown.
        throttle[row] = throttle[row] or asked[0][2]
        return [(sticks[row, 0], sticks[row, 1], throttle[row], sticks[row, 2])]

    measured = np.empty((rows, len(SIGNALS)))
    with Flight(simulation, fleets, binary(), eeprom, override) as flown:
        for row in range(rows):
            truth = simulation.truth
            measured[row] = np.concatenate([truth.attitude[0], truth.rates_body[0], truth.velocity_ned[0]])
            flown.advance(every)
    if not simulation.valid.all():
        raise RuntimeError(f"the vehicle stopped: {simulation.reasons}")
    measured[:, 2] = np.unwrap(measured[:, 2])
    given = ("pitch_command", "roll_command", "yaw_rate_command")
    signals = dict(zip(SIGNALS, measured.T, strict=True)) | dict(zip(given, sticks.T, strict=True))
    signals |= {"throttle": throttle, "battery": np.full(rows, BATTERY_V)}
    return FlightLog("sticks", Path("sticks"), "simulated", DT, DT * np.arange(rows), signals)


def _wide() -> dict[str, float]:
    far = 20_000.0
    return {"x_min": -far, "x_max": far, "y_min": -far, "y_max": far, "z_min": -3000.0}


def run(full: bool) -> dict[str, Any]:
    """Return what is identified, and on two other flights what it and the published constants leave."""
    seconds = FULL_S if full else SMALL_S
    eeprom = configured(binary())
    fitted = flight(seconds, SEED, 0.0, eeprom)
    published = Quadrotor()
    start = {name: float(getattr(published, name)) for name in CONSTANTS if name not in PITCH} | {"mass": MASS}
    found = identify([fitted], Question((), start))
    others = {"calm": flight(seconds, SEED + 1, 0.0, eeprom), "wind": flight(seconds, SEED + 2, WIND_20FT, eeprom)}
    result: dict[str, Any] = {
        "seconds": seconds,
        "delay_s": found.answer.nuisances[0]["delay"],
        "constants": {name: entry["value"] for name, entry in found.constants().items()},
    }
    for name, log in others.items():
        scores = score(log, (0.0, 1.0), start, found.answer.values, found.answer.nuisances[0], False)
        result[name] = {channel: _left(scores, channel) for channel in ("roll", "pitch", "roll_rate", "pitch_rate")}
    if full:
        _draw(others, start, found)
    return result


def _left(scores: dict[str, Any], channel: str) -> dict[str, float]:
    """Return the rms error of both models, and the share of the variance that each leaves of the other's."""
    identified, published = scores["identified"][channel], scores["start"][channel]
    return {
        "identified_rms": math.sqrt(identified),
        "published_rms": math.sqrt(published),
        "identified_of_published": identified / published,
        "identified_of_variance": identified / scores["variance"][channel],
    }


def _draw(others: dict[str, FlightLog], start: dict[str, float], found: Any) -> None:
    """Draw ten seconds of roll in calm air and in wind."""
    with picture(PICTURE, (9.0, 5.0), 2, 1, sharex=True) as rows:
        for axes, (name, log) in zip(rows, others.items(), strict=True):
            piece = cut(log, math.inf, 0.0, 1.0)
            at = piece.channels.index("roll")
            part = slice(0, round(12.0 / DT))
            nuisances = found.answer.nuisances[0]
            runs = {
                "published Pelican": (open_loop(piece, start, {"delay": nuisances["delay"]}, False), "#b35806"),
                "identified from another flight": (open_loop(piece, found.answer.values, nuisances, False), "#2d7dd2"),
            }
            axes.plot(
                log.time[part], np.degrees(log.signals["roll_command"][part]), color="#bbbbbb", lw=1, label="stick"
            )
            axes.plot(log.time[part], np.degrees(log.signals["roll"][part]), color="black", lw=1.6, label="Betaflight")
            for label, (simulated, colour) in runs.items():
                values = np.degrees(simulated[:, 0, at] if simulated.shape[1] == 1 else simulated[0, :, at])
                axes.plot(log.time[part], values[part], color=colour, lw=1.2, label=label)
            axes.set_ylabel(f"roll, {name} [deg]")
        rows[0].legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4, fontsize=8, frameon=False)
        rows[-1].set_xlabel("time [s]")
