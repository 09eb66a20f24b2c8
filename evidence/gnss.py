"""How good receivers of type gnss are, what they share, and the Allan deviation of one that was recorded.

The full form needs the public recording (``qrsim data fetch``, or QRSIM_DATA_DIR) and draws docs/images/gnss_allan.png,
gnss_day.png, gnss_fixes.png and gnss_jamming.png. Its data sheet numbers are u-blox's: NEO-M8N 2.5 m CEP, ZED-F9P
1.5 m CEP, 0.05 m/s (50 %).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from tests.models.gnss import flown_receivers as receivers

from evidence import IMAGES
from evidence._pictures import picture
from qrsim.core.allan import overlapping_allan_deviation
from qrsim.core.vectors import Vec3
from qrsim.models.gnss.constellations import NominalConstellations
from qrsim.models.gnss.geometry import FOUND, LOST
from qrsim.models.gnss.interference import Interference, Jammer, jammed
from qrsim.models.gnss.orbits import dilution_of_precision, elevation_azimuth
from qrsim.models.gnss.presets import PRESETS
from qrsim.models.site import Site
from qrsim.studies.validate.gnss import RECORDING, ROWS
from qrsim.studies.validate.receiver import recorded_receiver

DOC = "receivers of type gnss: accuracy, fix types, jammers, what vehicles share, and a recorded receiver"
SEED = 23
# Times of a day, worlds at each, hours and worlds of steps, runs beside the recording.
FULL, SMALL = (24, 200, 6.0, 5, 200), (4, 20, 0.2, 2, 20)
PARTS = ("presets", "steps", "day", "fixing", "jamming", "recording")
# Where receivers stand beside the first [m].
OFFSETS = {"1": (1.0, 0.0, 0.0), "100": (100.0, 0.0, 0.0), "1000": (1000.0, 0.0, 0.0), "10000": (10000.0, 0.0, 0.0)}
# Windows in rows of 0.4 s: to 20 s, and beyond.
WINDOWS = np.array([1, 2, 3, 5, 8, 12, 20, 30, 50, 75, 100, 125, 150, 175])
BAND = (0.01, 0.99)
# Baselines [m], seconds and worlds of fixing carrier phase; the base is silent for a while.
BASELINES = {"0": 0.0, "10": 10e3, "30": 30e3}
FIXING_S, SILENT = 240.0, (120.0, 135.0)
POWERS_W = (0.001, 0.01, 0.1, 1.0)
# What the recording is rounded to [m]: 1e-7 deg of latitude and of longitude, 1 mm of height.
RESOLUTION = np.array([0.0111, 0.0069, 0.001])
AXES = ("north", "east", "down")
# After a satellite has come or gone the filter takes so many fixes to follow.
AFTER_CHANGE = 25

Values = np.ndarray[Any, Any]


def accuracy(preset: str, starts: int, worlds: int) -> dict[str, Any]:
    """Return how good a receiver is over a day, what it reports, and what it shares with others."""
    places = ((0.0, 0.0, 0.0), *OFFSETS.values())
    sensor = receivers.receiver(preset, first_fix="fixed")
    base = receivers.base_at() if sensor.takes_base else None
    flown = receivers.over_a_day(sensor, starts, 20.0, worlds, seed=SEED, offsets=places, base=base)
    error = flown.error.reshape(-1, len(places), 3)
    horizontal, down = np.hypot(error[:, 0, 0], error[:, 0, 1]), error[:, 0, 2]
    reported = np.sqrt(np.mean(flown.accuracy[:, :, 0] ** 2, axis=(0, 1)))
    apart = error[:, 1:] - error[:, :1]
    return {
        "cep_m": float(np.median(horizontal)),
        "r95_m": float(np.quantile(horizontal, 0.95)),
        "height_50_m": float(np.median(np.abs(down))),
        "height_95_m": float(np.quantile(np.abs(down), 0.95)),
        "horizontal_rms_m": float(np.sqrt(np.mean(horizontal**2))),
        "vertical_rms_m": float(np.sqrt(np.mean(down**2))),
        "horizontal_accuracy_m": float(reported[0]),
        "vertical_accuracy_m": float(reported[1]),
        "satellites": float(flown.satellites.mean()),
        "heights_correlated": float(np.corrcoef(error[:, 0, 2], error[:, 1, 2])[0, 1]),
        "apart": {
            name: {"horizontal_m": float(np.sqrt(np.mean(pair[:, :2] ** 2))), "vertical_m": float(pair[:, 2].std())}
            for name, pair in zip(OFFSETS, np.moveaxis(apart, 1, 0), strict=True)
        },
    }


def steps(preset: str, hours: float, worlds: int) -> dict[str, Any]:
    """Return how far fixes step from one to the next, but for those near changes of the satellites."""
    flown = receivers.fly(receivers.receiver(preset), 3600.0 * hours, worlds, seed=SEED, start_s=3000.0)
    step = np.linalg.norm(np.diff(flown.error[:, :, 0], axis=0), axis=-1)
    changes = np.flatnonzero(np.diff(flown.satellites[:, 0, 0]) != 0)
    near = np.zeros(len(step), bool)
    for change in changes:
        near[change : change + AFTER_CHANGE] = True
    return {
        "changes": len(changes),
        "else_max_m": float(step[~near].max()),
        "velocity_max_m_s": float(np.abs(flown.velocity_error).max()),
    }


def fixing(worlds: int, draw: bool) -> dict[str, Any]:
    """Return how long carrier phase takes to be fixed, how good fixed positions are, and what silence does to them."""
    north = math.sqrt(0.5)
    places = tuple((north * baseline, north * baseline, -20.0) for baseline in BASELINES.values())
    base = receivers.base_at(silent=[SILENT])
    flown = receivers.fly(receivers.receiver("f9p_rtk"), FIXING_S, worlds, offsets=places, base=base, seed=SEED)
    fixed, time = flown.fix_type == 6.0, 0.2 * (1 + np.arange(len(flown.fix_type)))
    before, after = time < SILENT[0], time > SILENT[1]
    horizontal = np.hypot(flown.error[..., 0], flown.error[..., 1])
    if draw:
        _draw_fixes(time, flown, horizontal)
    found = {}
    for i, name in enumerate(BASELINES):
        first = np.where(fixed[before, :, i].any(axis=0), time[np.argmax(fixed[before, :, i], axis=0)], np.inf)
        again = np.argmax(fixed[after, :, i], axis=0) * 0.2
        chosen = fixed[:, :, i]
        found[name] = {
            "first_median_s": float(np.median(first)),
            "first_95_s": float(np.quantile(first, 0.95)),
            "again_median_s": float(np.median(again)),
            "cep_m": float(np.median(horizontal[:, :, i][chosen])),
            "height_50_m": float(np.median(np.abs(flown.error[:, :, i, 2][chosen]))),
            "float_rms_m": float(np.sqrt(np.mean(horizontal[:, :, i][flown.fix_type[:, :, i] == 5.0] ** 2))),
        }
    both = fixed[:, :, :2].all(axis=2)
    found["wrong_share"] = float(np.mean(horizontal[:, :, 0][fixed[:, :, 0]] > 0.1))
    found["both_fixed_share"] = float(both.mean())
    return found


def jamming(draw: bool = False) -> dict[str, dict[str, float]]:
    """Return, by power [mW], how far jammers end tracking from 45 dB-Hz, and keep it from being resumed."""
    distances = np.geomspace(1.0, 1e6, 60001)
    places = Vec3(*(jnp.asarray(part, jnp.float32) for part in (distances, 0.0 * distances, 0.0 * distances - 30.0)))
    found = {}
    for power in POWERS_W:
        jammer = Interference(jammers=(Jammer(np.zeros(3), power, 0.0, 1e9),))  # type: ignore[arg-type]
        present = jammer.at(jnp.zeros(1, jnp.int32), jnp.int32(1), jnp.float32(0.0))
        weakness = 1.0 + np.asarray(jammed(present, (), places, None))  # type: ignore[arg-type]
        radii = [float(distances[np.argmax(weakness < limit)]) for limit in (LOST, FOUND)]
        found[f"{1e3 * power:g}"] = {"power_w": power, "lost_m": radii[0], "not_found_m": radii[1]}
    if draw:
        _draw_jamming(list(found.values()))
    return found


def _draw_fixes(time: Values, flown: receivers.Flown, horizontal: Values) -> None:
    with picture(IMAGES / "gnss_fixes.png", (11.0, 3.8)) as panel:
        for i, name in enumerate(BASELINES):
            panel.plot(time, np.median(horizontal[:, :, i], axis=1), lw=1.1, label=f"{name} km from the base")
        panel.axvspan(*SILENT, color="0.9", label="the base is silent")
        panel.set(xlabel="time [s]", ylabel="horizontal error, median [m]", yscale="log")


def _draw_jamming(rows: list[dict[str, Any]]) -> None:
    with picture(IMAGES / "gnss_jamming.png", (6.5, 4.2)) as panel:
        power = [1e3 * row["power_w"] for row in rows]
        panel.fill_between(
            power, [row["lost_m"] for row in rows], 10.0, color="tab:red", alpha=0.25, lw=0, label="no fix"
        )
        panel.fill_between(
            power,
            [row["not_found_m"] for row in rows],
            [row["lost_m"] for row in rows],
            color="tab:orange",
            alpha=0.25,
            lw=0,
            label="a fix is kept, but not found again",
        )
        panel.set(
            xscale="log", yscale="log", xlabel="power of the jammer [mW]", ylabel="distance [m]", ylim=(50.0, 5e4)
        )


def recorded_deviation(path: Path) -> Values:
    """Return the Allan deviation (K, 3) [m] of the recorded receiver, of its first 350 rows."""
    return overlapping_allan_deviation(recorded_receiver(path).position_ned[:ROWS], 0.4, WINDOWS)[1]


def simulated_deviations(runs: int) -> Values:
    """Return the Allan deviations (K, runs, 3) [m] of receivers of the recording's kind, at four times of a day."""
    parts = []
    for i in range(4):
        sensor = receivers.receiver("gps_2011")
        flown = receivers.fly(sensor, 0.4 * ROWS, runs // 4, seed=SEED + i, start_s=21600.0 * i)
        reported = np.round(flown.error[:, :, 0] / RESOLUTION) * RESOLUTION
        parts.append(overlapping_allan_deviation(reported, 0.4, WINDOWS)[1])
    return np.concatenate(parts, axis=1)


def beside_the_recording(path: Path, runs: int, draw: bool) -> dict[str, Any]:
    """Return at how many windows and axes the recording is within the band of simulated receivers."""
    recorded, simulated = recorded_deviation(path), simulated_deviations(runs)
    low, middle, high = np.quantile(simulated, (BAND[0], 0.5, BAND[1]), axis=1)
    inside = (low <= recorded) & (recorded <= high)
    if draw:
        _draw_allan(recorded, low, middle, high, runs)
    return {
        "runs": runs,
        "points": int(inside.size),
        "inside": int(inside.sum()),
    }


def day(systems: str, draw: Any = None) -> dict[str, Any]:
    """Return satellites above 10 deg and dilutions over a day at the default site."""
    times = receivers.MIDNIGHT_GPS_S + np.arange(0.0, 86400.0, 300.0)
    site = Site()
    rays = (NominalConstellations(systems).positions_ecef(times) - site.origin_ecef()) @ site.ned_from_ecef_rotation().T
    seen = elevation_azimuth(rays)[0] > np.radians(10.0)
    unit = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    enough = seen.sum(axis=1) >= 4
    dops = np.array([dilution_of_precision(u[s])[:2] for u, s, good in zip(unit, seen, enough, strict=True) if good])
    count = seen.sum(axis=1)
    if draw is not None:
        draw(systems, (times - times[0]) / 3600.0, count, np.where(enough, 0.0, np.nan), dops, enough)
    return {
        "satellites_mean": float(count.mean()),
        "hdop_50": float(np.median(dops[:, 0])),
        "vdop_50": float(np.median(dops[:, 1])),
    }


def _draw_allan(recorded: Values, low: Values, middle: Values, high: Values, runs: int) -> None:
    with picture(IMAGES / "gnss_allan.png", (11.0, 4.2), 1, 3, sharey=True) as panels:
        windows = 0.4 * WINDOWS
        for i, (panel, axis) in enumerate(zip(panels, AXES, strict=True)):
            panel.fill_between(
                windows,
                low[:, i],
                high[:, i],
                color="tab:blue",
                alpha=0.2,
                lw=0,
                label=f"gps_2011: 98 % of {runs} runs",
            )
            panel.plot(windows, middle[:, i], color="tab:blue", lw=1.0, label="their median")
            panel.plot(windows, recorded[:, i], "o-", color="black", ms=3, lw=1.2, label="recorded")
            panel.set(xscale="log", yscale="log", xlabel="averaging time [s]", title=axis)
        panels[0].set_ylabel("overlapping Allan deviation [m]")


def _days(draw: bool) -> dict[str, Any]:
    """Return the days of some systems, and draw them."""
    systems = ("G", "GE", "GERC")
    if not draw:
        return {name: day(name) for name in systems}

    with picture(IMAGES / "gnss_day.png", (11.0, 4.2), 1, 2) as panels:

        def add(name: str, hours: Values, count: Values, gaps: Values, dops: Values, enough: Values) -> None:
            panels[0].step(hours, count, where="post", label=name, lw=1.1)
            hdop = gaps.copy()
            hdop[enough] = dops[:, 0]
            panels[1].plot(hours, hdop, label=name, lw=1.1)

        found = {name: day(name, add) for name in systems}
        panels[0].set(xlabel="time of day [h]", ylabel="satellites above 10°")
        panels[1].set(xlabel="time of day [h]", ylabel="HDOP", ylim=(0.0, 3.0))
    return found


def run(full: bool, parts: tuple[str, ...] = PARTS) -> dict[str, Any]:
    """Return some parts of it or all; the full form for every preset, and beside the recording."""
    starts, worlds, hours, few, runs = FULL if full else SMALL
    chosen = tuple(PRESETS) if full else ("f9p_single",)
    made: dict[str, Callable[[], Any]] = {
        "presets": lambda: {name: accuracy(name, starts, worlds) for name in chosen},
        "steps": lambda: {name: steps(name, hours, few) for name in chosen if name in ("m8n", "f9p_single")},
        "day": lambda: _days(draw=full),
        "fixing": lambda: fixing(worlds, draw=full),
        "jamming": lambda: jamming(draw=full),
    }
    found: dict[str, Any] = {"times_of_day": starts, "worlds": worlds, "hours": hours}
    found |= {name: make() for name, make in made.items() if name in parts}
    if full and "recording" in parts:
        from qrsim.files.recordings import data_file

        found["recording"] = beside_the_recording(Path(data_file(RECORDING)), runs, draw=True)
    return found
