"""Formations in gusts of each vehicle's own and of one field: common and relative motion, and who meets what when.

Twenty Pelicans of the shipped study ``formation_gusts`` hold a grid, from 1 to 50 m apart; five fly in a line along the
wind, over the ground at rest, upwind and downwind. Only the turbulence differs. Positions are taken about each flight's
own mean, correlations of gusts about zero; intervals are of 95 %, over the seeds.
"""

from __future__ import annotations

import copy
import math
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from tests.models.atmosphere import field_reference as of

import qrsim
from evidence import _intervals as interval
from qrsim.studies.sweep.study import load_study
from qrsim.studies.validate.wind_field import LIFETIME
from qrsim.studies.validate.wind_field import kept as remembered
from qrsim.world.state import State

DOC = "formations in gusts of each vehicle's own and of one field: separation, common motion, lags; 1 to 50 m, sweep"
SEED = 0
STUDY = "formation_gusts"
HEIGHT, SPEED_20FT = 15.0, 4.0
# Of the shipped study's grid, rows to the north of vehicles to the east [m].
ROWS, COLUMNS, GIVEN = 5, 4, 5.0
LEFT_OUT_S = 60.0
# Ticks between two looks at a grid, and at a line.
GRID_TICKS, LINE_TICKS = 10, 5
KINDS = ("dryden", "dryden_field")
SPACINGS = (1.0, 2.0, 3.0, 5.0, 7.0, 10.0, 15.0, 20.0, 30.0, 50.0)
SWEEPS = (0.0, 0.3, 1.0)
# Of the line [m], its flight over ground [m/s], the longest lag that is tried [s], and what the wind at 20 m has.
APART, ABREAST, FLIGHT, LONGEST_S = 10.0, 5, 8.0, 6.0
CARRIED = SPEED_20FT * math.log(20.0 / 0.3048 / 0.15) / math.log(20.0 / 0.15)
FLIGHTS = {"hover": 0.0, "upwind": -FLIGHT, "downwind": FLIGHT}
# Least separations [m] that are counted, by spacing.
NEAR = {3.0: 0.9, 5.0: 2.5}
# Seeds, seconds after those left out, spacings, flights and sweeps.
FULL = (40, 160.0, SPACINGS, tuple(FLIGHTS), SWEEPS)
SMALL = (8, 40.0, (3.0, 50.0), ("hover", "downwind"), (0.0, 1.0))

Values = np.ndarray[Any, Any]


class Flown(NamedTuple):
    """Positions [m] and gusts [m/s] of W worlds at T times, (W, T, n, 3), and the time between two of these [s]."""

    place: Values
    gust: Values
    step: float


def turbulence(kind: str, sweep: float = 0.0) -> dict[str, Any]:
    """Return the turbulence of a scenario."""
    return {"type": kind} | ({"sweep": sweep} if sweep else {})


def grid(kind: str, spacing: float, sweep: float = 0.0) -> dict[str, Any]:
    """Return the scenario of the shipped study with another spacing [m] and turbulence."""
    content = copy.deepcopy(load_study(STUDY).content)
    content["world"]["turbulence"] = turbulence(kind, sweep)
    for vehicle in content["fleets"]["formation"]["vehicles"]:
        north, east, down = vehicle["position_ned"]
        vehicle["position_ned"] = [north * spacing / GIVEN, east * spacing / GIVEN, down]
    return content


def line(kind: str, over_ground: float, seconds: float, sweep: float = 0.0) -> dict[str, Any]:
    """Return a line of vehicles along a wind to the north; they fly north at a speed over ground [m/s], or stay."""
    vehicles: list[dict[str, Any]] = [{"position_ned": [APART * i, 0.0, -HEIGHT]} for i in range(ABREAST)]
    fleet: dict[str, Any] = {
        # Upwind it meets 13 m/s.
        "controller": {"type": "cascade", "feed": "truth", "speed_limit": 14.0, "tilt_limit": 0.75},
        "vehicles": vehicles,
    }
    if over_ground:
        fleet["guidance"] = {"type": "mission", "speed": abs(over_ground)}
        for vehicle in vehicles:
            north, east, down = vehicle["position_ned"]
            vehicle["waypoints_ned"] = [[north + over_ground * (seconds + 20.0), east, down]]
    world = load_study(STUDY).content["world"]
    wind = {"type": "log_shear", "speed_20ft": SPEED_20FT, "wind_from_deg": 180.0}
    area = {"type": "box", "x_min": -4e3, "x_max": 4e3, "y_min": -1e3, "y_max": 1e3, "z_min": -200.0, "z_max": 0.0}
    parts = {"area": area, "wind": wind, "turbulence": turbulence(kind, sweep)}
    return {"name": "line", "duration": seconds, "world": {**world, **parts}, "fleets": {"line": fleet}}


def _looked(state: State) -> Any:
    fleet = state.fleets[0]
    return jnp.stack([fleet.vehicle.position_ned.stack(), fleet.gust_ned.stack()])  # type: ignore[attr-defined]


def fly(content: dict[str, Any], seeds: int, seconds: float, every: int = GRID_TICKS) -> Flown:
    """Fly a scenario with seeds from 0 on, and return what is after LEFT_OUT_S, at every so-many-th tick."""
    world = qrsim.load_scenario(content, quiet=True).world()
    ticks = round((LEFT_OUT_S + seconds) / world.time_step)
    flown = qrsim.rollout(world, ticks=ticks, seeds=range(seeds), record=_looked, record_every=every)
    assert not flown["reason"].any(), flown.reasons(0)
    late = flown.record_ticks * world.time_step > LEFT_OUT_S + 1e-6
    place, gust = np.moveaxis(np.asarray(flown.recorded, np.float64)[:, late], 2, 0)
    return Flown(place, gust, every * world.time_step)


# ---- of a grid ----


def neighbours(values: Values) -> tuple[tuple[Values, Values], tuple[Values, Values]]:
    """Return pairs of neighbours (..., P, 3) of the grid: one behind the other to the north, and to the east."""
    table = values.reshape(*values.shape[:-2], ROWS, COLUMNS, 3)

    def pairs(axis: int) -> tuple[Values, Values]:
        count = table.shape[axis]
        found = (np.take(table, range(first, first + count - 1), axis) for first in (0, 1))
        one, other = (part.reshape(*values.shape[:-2], -1, 3) for part in found)
        return one, other

    return pairs(-3), pairs(-2)


def correlations(gust: Values) -> dict[str, Any]:
    """Return correlations of neighbours' gusts along and across the way from one to the other, and of vertical ones."""
    products: dict[str, list[Values]] = {"along": [], "across": [], "vertical": []}
    squares = {name: list(each) for name, each in products.items()}
    for way, (one, other) in enumerate(neighbours(gust)):
        for name, axis in (("along", way), ("across", 1 - way), ("vertical", 2)):
            a, b = one[..., axis], other[..., axis]
            products[name].append((a * b).mean(axis=(1, 2)))
            squares[name].append(0.5 * (a * a + b * b).mean(axis=(1, 2)))
    every = {name: (np.mean(products[name], axis=0), np.mean(squares[name], axis=0)) for name in products}
    level = [np.mean([every[name][part] for name in ("along", "across")], axis=0) for part in (0, 1)]
    return {name: interval.ratio(*pair) for name, pair in every.items()} | {"horizontal": interval.ratio(*level)}


def closed(spacing: float) -> dict[str, float]:
    """Return the correlations that the continuation of the standard's spectra to two points has."""
    scales = of.mil(HEIGHT, SPEED_20FT)
    length = float(scales.length_h)
    along, across = float(of.along(spacing, length)), float(of.across(spacing, length))
    vertical = float(of.across(spacing, float(scales.length_w)))
    return {"along": along, "across": across, "vertical": vertical, "horizontal": 0.5 * (along + across)}


def axes(values: Values) -> dict[str, Any]:
    """Return the standard deviation of each axis over times and vehicles of (W, T, n, 3), about zero."""
    return {
        name: interval.root_mean((values[..., axis] ** 2).mean(axis=(1, 2)))
        for axis, name in enumerate(("north", "east", "down"))
    }


def least_separation(place: Values) -> Values:
    """Return the smallest distance (W,) [m] of any two vehicles at any time of (W, T, n, 3)."""
    first, second = np.triu_indices(place.shape[2], 1)
    found = [np.linalg.norm(world[:, first] - world[:, second], axis=-1).min() for world in place]
    return np.array(found)


def about_mean(place: Values) -> Values:
    """Return positions (W, T, n, 3) about the mean over time of each vehicle of each world."""
    return place - place.mean(axis=1, keepdims=True)


def formation(flown: Flown, spacing: float) -> dict[str, Any]:
    """Return what gusts do to a grid of a spacing [m]."""
    own, least = about_mean(flown.place), least_separation(flown.place)
    relative = np.concatenate([other - one for one, other in neighbours(own)], axis=2)
    found: dict[str, Any] = {
        "gust_std": axes(flown.gust),
        "correlation": correlations(flown.gust),
        "own_std": axes(own),
        "relative_std": axes(relative),
        "centre_std": axes(own.mean(axis=2, keepdims=True)),
        "least": {"mean": interval.mean(least), "quantile_5": interval.quantile(least, 0.05)},
    }
    if spacing in NEAR:
        found["nearer"] = interval.share(least < NEAR[spacing])
    return found


# ---- of a line ----


def lags(flown: Flown, over_ground: float) -> dict[str, Any]:
    """Return with which lag [s] a vehicle meets the gusts that the one before met, and how alike they are then."""
    gust = flown.gust[..., 0]
    # Upwind of the air's way through the formation is who meets them first.
    first, second = (gust[:, :, :-1], gust[:, :, 1:]) if over_ground < CARRIED else (gust[:, :, 1:], gust[:, :, :-1])
    longest, length = round(LONGEST_S / flown.step), gust.shape[1]
    met = first[:, : length - longest]
    pairs = [(met, second[:, n : n + length - longest]) for n in range(longest)]
    products = np.stack([(a * b).mean(axis=(1, 2)) for a, b in pairs])
    squares = np.stack([0.5 * (a * a + b * b).mean(axis=(1, 2)) for a, b in pairs])

    def peak(found: Values) -> Values:
        """Return where correlations (L, ...) are largest, between the steps by a parabola."""
        top = np.clip(np.argmax(found, axis=0), 1, longest - 2)[None]
        low, here, high = (np.take_along_axis(found, top + side, 0)[0] for side in (-1, 0, 1))
        return np.asarray(flown.step * (top[0] + 0.5 * (low - high) / (low - 2.0 * here + high)))

    chosen = interval.resampled(gust.shape[0])
    every = peak(products[:, chosen].mean(axis=-1) / squares[:, chosen].mean(axis=-1))
    expected = APART / abs(over_ground - CARRIED)
    there = round(expected / flown.step)
    return {
        "lag_s": {
            "value": float(peak(products.mean(axis=1) / squares.mean(axis=1))),
            "low": float(np.quantile(every, 0.025)),
            "high": float(np.quantile(every, 0.975)),
        },
        "expected_s": expected,
        "then": interval.ratio(products[there], squares[there]),
        "at_once": interval.ratio(products[0], squares[0]),
    }


def in_line(flown: Flown, over_ground: float) -> dict[str, Any]:
    """Return what gusts do to a line along the wind."""
    # The way over ground is the same for all: relative motion does not see it.
    apart = np.diff(flown.place, axis=2)
    least = least_separation(flown.place)
    return lags(flown, over_ground) | {
        "relative_std": axes(about_mean(apart)),
        "least": interval.mean(least),
        "speed": float(np.diff(flown.place[..., 0], axis=1).mean() / flown.step),
    }


def forgotten(sweep: float, seconds: float) -> float:
    """Return the correlation of horizontal gusts that is left after a time [s] in the frame that moves with a field.

    That of the sweep times that of the lifetime of the waves.
    """
    k, share = of.shells(float(of.mil(HEIGHT, SPEED_20FT).length_h), dilations=32)
    decay = np.exp(-0.5 * (k * sweep * seconds) ** 2)
    left = float(np.mean(np.sum(share * decay, axis=1) / share.sum(axis=1)))
    return left * float(remembered(seconds / LIFETIME))


def _key(number: float) -> str:
    return f"{number:g}".replace(".", "_")


def run(full: bool) -> dict[str, Any]:
    """Return grids, lines and sweeps; the full form draws the pictures of docs/explanation/formation_in_gusts.md."""
    seeds, seconds, spacings, flights, sweeps = FULL if full else SMALL
    whole = LEFT_OUT_S + seconds
    grids: dict[str, Any] = {
        _key(spacing): {kind: formation(fly(grid(kind, spacing), seeds, seconds), spacing) for kind in KINDS}
        | {"closed": closed(spacing)}
        for spacing in spacings
    }
    lines = {
        name: {
            kind: in_line(fly(line(kind, FLIGHTS[name], whole), seeds, seconds, LINE_TICKS), FLIGHTS[name])
            for kind in KINDS
        }
        for name in flights
    }
    swept: dict[str, Any] = {}
    for sweep in sweeps:
        held = formation(fly(grid("dryden_field", GIVEN, sweep), seeds, seconds), GIVEN)
        along = in_line(fly(line("dryden_field", 0.0, whole, sweep), seeds, seconds, LINE_TICKS), 0.0)
        swept[_key(sweep)] = {
            "grid": held,
            "line": along,
            "then_closed": forgotten(sweep, along["expected_s"]) * closed(0.01)["along"],
        }
    if full:
        from evidence import _formation_pictures as pictures

        pictures.draw_spacings(grids, closed)
        pictures.draw_gust()
    return {"seeds": seeds, "seconds": seconds, "left_out": LEFT_OUT_S, "grid": grids, "line": lines, "sweep": swept}
