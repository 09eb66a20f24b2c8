"""The headline numbers of a run of any number of vehicles, to read two runs side by side."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.runs.reader import Run
from qrsim.runs.separation import smallest_separation
from qrsim.runs.summary import common_rows, stops_of, summarise, vectors

# What a log must have, by stream; those of others may have less.
NEEDED = {
    "truth": (*(f"position_ned.{axis}" for axis in "xyz"), "valid"),
    "measurements": (),
    "commands": (),
    "wind": tuple(f"{kind}_ned.{axis}" for kind in ("mean", "gust") for axis in "xyz"),
}
ESTIMATE, POWER = "estimate.position_ned", "power"


class Headline(NamedTuple):
    """A number or a word of a run; NaN where it was not recorded."""

    name: str
    unit: str
    value: float | str


def headlines(run: Run) -> list[Headline]:
    """Return a run's headline numbers in fixed order, NaN for those not logged; [] if the log lacks columns in NEEDED.

    RMS values are the root of the mean square over the vehicles.
    """
    if not all(stream in run and set(columns) <= set(run[stream].columns()) for stream, columns in NEEDED.items()):
        return []
    rows, nearest, score = summarise(run), smallest_separation(run), run.info.score

    def each(name: str) -> Floats:
        """Return one number of every vehicle's summary by its name, (n,)."""
        return np.array([getattr(row, name) for row in rows], np.float64)

    return [
        Headline("ended", "", run.info.state),
        Headline("simulated time", "s", round(run.info.ticks * run.info.time_step, 9)),
        Headline("vehicles", "", float(len(run.vehicles))),
        Headline("vehicles stopped", "", float(len(stops_of(run)))),
        Headline("waypoints reached", "", float(each("waypoints").sum())),
        Headline("distance flown", "m", float(each("distance_m").sum())),
        Headline("tracking error, RMS", "m", _root_mean_square(each("tracking_error_rms_m"))),
        Headline("height error, RMS", "m", _root_mean_square(each("height_error_rms_m"))),
        Headline("estimate error, RMS", "m", _root_mean_square(_estimate_errors(run))),
        Headline("GNSS error horizontal, RMS", "m", _root_mean_square(each("gnss_horizontal_rms_m"))),
        Headline("GNSS error vertical, RMS", "m", _root_mean_square(each("gnss_vertical_rms_m"))),
        Headline("wind, largest", "m/s", float(np.fmax.reduce(each("worst_wind_m_s"), initial=math.nan))),
        Headline("separation, smallest", "m", math.nan if nearest is None else nearest.distance_m),
        Headline("energy", "Wh", _energy(run)),
        Headline("battery left, least", "%", 100.0 * float(np.fmin.reduce(each("charge_least"), initial=math.nan))),
        Headline("score", "", math.nan if score is None or score["return"] is None else float(score["return"])),
    ]


def _root_mean_square(values: Floats) -> float:
    """Return the root mean square of the finite values, NaN without any."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(np.square(known)))) if known.size else math.nan


def _estimate_errors(run: Run) -> Floats:
    """Return the distances (N,) [m] between estimated and true positions in flight, without NaN."""
    if f"{ESTIMATE}.x" not in run["commands"]:
        return np.zeros(0)
    rows, commanded = common_rows(run, "truth", "commands")
    error = vectors(run["commands"], ESTIMATE, commanded) - vectors(run["truth"], "position_ned", rows)
    distance: Floats = np.linalg.norm(error, axis=-1)[run["truth"]["valid"].astype(bool)[rows]]
    return distance


def _energy(run: Run) -> float:
    """Return the electrical energy [Wh] that all vehicles used together; NaN if no power was recorded."""
    truth = run["truth"]
    if POWER not in truth:
        return math.nan
    power = np.asarray(truth[POWER], np.float64)[:-1]
    joule = np.where(truth["valid"].astype(bool)[:-1], power, 0.0) * np.diff(truth.time)[:, None]
    return float(np.nansum(joule)) / 3600.0
