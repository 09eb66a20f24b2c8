"""Receivers of type ``gnss``: geometry against the performance standard, accuracy against data sheets."""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qrsim.core.arrays import Floats
from qrsim.models.gnss.constellations import NominalConstellations
from qrsim.models.gnss.orbits import dilution_of_precision, elevation_azimuth
from qrsim.models.site import Site, gps_seconds_from_utc
from qrsim.scenarios.scenario import load_scenario
from qrsim.simulation.rollout import rollout
from qrsim.studies.validate.published import RECEIVER_CEP_M, SPS_MASK_DEG, SPS_PDOP, SPS_PDOP_SHARE
from qrsim.studies.validate.report import Check, Finding, Outcome, Part, Picture, Verdict
from qrsim.studies.validate.statistics import CONFIDENCE, widest_z

DAY = datetime.fromisoformat("2026-06-21T00:00:00+00:00")
# Of the geometry: rows of latitude and times of a day.
LATITUDES, LONGITUDES, TIMES = np.arange(-85.0, 90.0, 10.0), 12, 96
STARTS, FEW_STARTS, WORLDS, FEW_WORLDS = 8, 3, 100, 60
TICKS = 100


class Fixes(NamedTuple):
    """Last fixes of a receiver that hovers, in many worlds: errors (n, 3) [m], and what it reported of them (n, 2)."""

    error: Floats
    reported: Floats


def pdops(times: int = TIMES) -> Floats:
    """Return the PDOP of GPS over a day (sites, times), at sites all over the globe; infinite without a fix.

    Sites are even over the globe: fewer of them where parallels are short.
    """
    seconds = gps_seconds_from_utc(DAY) + np.linspace(0.0, 86400.0, times, endpoint=False)
    ecef = NominalConstellations("G").positions_ecef(seconds)
    rows = []
    for latitude in LATITUDES:
        count = max(round(LONGITUDES * math.cos(math.radians(latitude))), 1)
        for longitude in np.arange(count) * 360.0 / count - 180.0:
            site = Site(math.radians(latitude), math.radians(longitude), 0.0)
            rays = (ecef - site.origin_ecef()) @ site.ned_from_ecef_rotation().T
            seen = elevation_azimuth(rays)[0] > math.radians(SPS_MASK_DEG)
            unit = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
            rows.append([_pdop(of[which]) for of, which in zip(unit, seen, strict=True)])
    return np.array(rows)


def _pdop(rays: Floats) -> float:
    """Return the PDOP of satellite directions (S, 3); infinite for fewer than four."""
    return dilution_of_precision(rays)[2] if len(rays) >= 4 else math.inf


def fixes(preset: str, starts: int, worlds: int, **change: object) -> Fixes:
    """Simulate a hovering receiver of a preset at many start times in many worlds; return each last fix."""
    errors, reported = [], []
    for number in range(starts):
        start = DAY + timedelta(hours=24.0 * number / starts)
        fleet = {
            "controller": {"type": "cascade", "feed": "truth"},
            "sensors": {"gnss": {"type": "gnss", "preset": preset, **change}},
            "vehicles": [{"position_ned": [0.0, 0.0, -50.0]}],
        }
        content = {"name": "receiver", "duration": 10.0, "start_time": start.isoformat(), "fleets": {"one": fleet}}
        world = load_scenario(content, quiet=True).world()

        def last(state: Any) -> tuple[jax.Array, jax.Array]:
            """Return the error of the last fix (3,) [m] and its reported accuracies (2,) [m]."""
            reading, place = state.fleets[0].readings[0], state.fleets[0].vehicle.position_ned
            error = reading.position_ned.stack() - place.stack()
            return error[0], jnp.stack([reading.horizontal_accuracy[0], reading.vertical_accuracy[0]])

        seeds = range(worlds * number, worlds * (number + 1))
        found = rollout(world, ticks=TICKS, seeds=seeds, record=last, record_every=TICKS)
        errors.append(np.asarray(found.recorded[0], np.float64)[:, -1])
        reported.append(np.asarray(found.recorded[1], np.float64)[:, -1])
    return Fixes(np.concatenate(errors), np.concatenate(reported))


def cep(of: Fixes) -> float:
    """Return the circular error probable [m] of fixes: the horizontal radius that holds half of them."""
    return float(np.median(np.hypot(of.error[:, 0], of.error[:, 1])))


def honest(preset: str, of: Fixes, count: int) -> list[Check]:
    """Return the checks that mean squared errors of fixes agree with the accuracies that the receiver reports."""
    z, checks = widest_z(count), []
    squares = {"horizontal": np.sum(np.square(of.error[:, :2]), axis=1), "vertical": np.square(of.error[:, 2])}
    for (what, each), stated in zip(squares.items(), of.reported.T, strict=True):
        ratios = each / np.mean(np.square(stated))
        error = float(np.std(ratios, ddof=1)) / math.sqrt(len(ratios))
        checks.append(
            Check(
                f"{preset}: {what} errors over those reported, mean squares",
                float(np.mean(ratios)),
                1.0,
                z * error,
                "",
                f"a receiver that is right about itself; {z:.1f} standard errors of the mean of {len(ratios)} fixes,"
                f" {100 * CONFIDENCE:g} % for all {count} together",
            )
        )
    return checks


def _run_part(paths: Mapping[str, Path], full: bool) -> Outcome:
    """Simulate GNSS receivers of all presets, in full or quickly; return the outcome for the report."""
    starts, worlds = (STARTS, WORLDS) if full else (FEW_STARTS, FEW_WORLDS)
    found = {preset: fixes(preset, starts, worlds) for preset in RECEIVER_CEP_M}
    geometry = pdops(TIMES if full else 24)
    good = float(np.mean(geometry <= SPS_PDOP))
    checks = [
        Check(
            f"share of sites and times with a PDOP of {SPS_PDOP:g} or less, GPS over {SPS_MASK_DEG:g}°",
            good,
            1.0,
            1.0 - SPS_PDOP_SHARE,
            "",
            f"GPS SPS Performance Standard (2020), table 3.8-1: at least {100 * SPS_PDOP_SHARE:g} % on average",
        ),
        *(check for preset, of in found.items() for check in honest(preset, of, 2 * len(found))),
    ]
    return Outcome(
        method=f"Positions of the nominal GPS constellation over a day are seen from {len(geometry)} sites, even over"
        f" the globe. Receivers hover under their open sky at {starts} times of a day, in {worlds} worlds each.",
        reading=f"PDOP is {SPS_PDOP:g} or less at {100 * good:.1f} % of places and times; receivers know how good their"
        " fixes are, and these are better than their data sheets say.",
        checks=checks,
        findings=[_cep_finding(preset, cep(of)) for preset, of in found.items()],
        pictures=[_draw_receivers(found, geometry)],
        numbers={
            "pdop": {f"{100 * q:g}_percent": float(np.quantile(geometry, q)) for q in (0.5, 0.9, 0.95, 0.98)},
            "receivers": {
                preset: {
                    "cep_m": cep(of),
                    "r95_m": float(np.quantile(np.hypot(*of.error[:, :2].T), 0.95)),
                    "height_95_m": float(np.quantile(np.abs(of.error[:, 2]), 0.95)),
                }
                for preset, of in found.items()
            },
        },
    )


def _cep_finding(preset: str, found: float) -> Finding:
    """Return the finding that compares the simulated CEP [m] of a receiver preset with its data sheet."""
    stated, source = RECEIVER_CEP_M[preset]
    verdict: Verdict = "does not fit" if found > stated else "fits" if found > 0.5 * stated else "fits in part"
    return Finding(
        f"{preset}: circle that holds half of the fixes",
        f"{found:.2f} m, data sheet {stated:g} m",
        verdict,
        f"{source}; a data sheet promises what every receiver under an open sky keeps. Fits: half of it to all of it.",
    )


def _draw_receivers(found: Mapping[str, Fixes], geometry: Floats) -> Picture:
    """Draw the distributions of receivers' horizontal errors, and of the PDOP."""
    from qrsim.runs.picture import new_figure
    from qrsim.studies.validate.pictures import picture

    figure = new_figure(11.0, 4.4)
    left, right = figure.subplots(1, 2)
    colours = ("tab:red", "tab:blue", "tab:green")
    for (preset, of), colour in zip(found.items(), colours, strict=False):
        radius = np.sort(np.hypot(of.error[:, 0], of.error[:, 1]))
        left.plot(radius, np.arange(1, len(radius) + 1) / len(radius), color=colour, label=preset)
        left.axvline(RECEIVER_CEP_M[preset][0], color=colour, ls="--", lw=1.0)
    left.axhline(0.5, color="gray", lw=0.8)
    left.set(xlabel="horizontal error [m]", ylabel="share of fixes", title="receivers; dashed, CEP of data sheets")
    left.set_xlim(0.0)
    left.legend()
    values = np.sort(geometry.ravel())
    right.plot(values, np.arange(1, len(values) + 1) / len(values), color="black")
    right.axvline(SPS_PDOP, color="tab:red", ls="--", lw=1.0)
    right.axhline(SPS_PDOP_SHARE, color="tab:red", ls="--", lw=1.0)
    right.set(
        xlabel="PDOP", ylabel="share of sites and times", title="GPS alone; dashed, the standard", xlim=(1.0, 8.0)
    )
    for axes in (left, right):
        axes.grid(alpha=0.3)
    return picture(
        figure, "Horizontal errors of hovering receivers, and position dilution of precision over the globe."
    )


PART = Part(
    "receivers", "Receivers and geometry", "no figure of the paper: data sheets and the GPS standard", (), _run_part
)
