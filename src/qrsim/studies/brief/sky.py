"""GNSS of the day, from the geometry alone: satellites above mask, obstacles and hills along the routes, and PDOP."""

from __future__ import annotations

import math
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.core.vectors import Vec3
from qrsim.models.scene.rays import can_hide, first_hit
from qrsim.models.site import gps_seconds_from_utc
from qrsim.scenarios import catalogue as known
from qrsim.scenarios.components import component
from qrsim.scenarios.satellites import for_receivers
from qrsim.scenarios.scenario import Scenario
from qrsim.studies.brief.judging import Row, Verdict
from qrsim.world.state import World

DAY_S, STEP_S, PLACES, REACH_M = 86_400.0, 300.0, 20, 5000.0
# Around the flights, what counts for the verdict [s].
WINDOW_S = 1800.0
# A go needs these, and a no-go has these, in shares of the window.
GOOD_PDOP, GOOD_COUNT, GOOD_SHARE = 4.0, 8, 0.95
BAD_PDOP, BAD_COUNT, BAD_SHARE = 6.0, 5, 0.2
# A geometry that gives no fix has this [1].
NONE_PDOP = 99.0


@dataclass(frozen=True)
class Sky:
    """Satellites and dilution of precision over a day.

    Attributes:
        seconds: (T,) time since the start of the flights [s].
        places_ned: (P, 3) places along the routes [m].
        count: (T, P) satellites.
        pdop, hdop: (T, P) dilutions of precision; 99 where there is no fix.
    """

    seconds: NumpyArray
    places_ned: NumpyArray
    count: NumpyArray
    pdop: NumpyArray
    hdop: NumpyArray

    def worst_place(self) -> int:
        """Index of the place along the routes with the largest mean PDOP."""
        return int(np.argmax(np.mean(self.pdop, axis=0)))


def places_along(scenario: Scenario, count: int = PLACES) -> NumpyArray:
    """Return places (P, 3) NED [m] along the legs of all vehicles, evenly spread over their lengths."""
    corners = []
    for fleet in scenario.spec.fleets.values():
        for vehicle in fleet.vehicles:
            corners.append(np.array([vehicle.position_ned, *vehicle.places_ned.values()], np.float64))
    found = []
    for line in corners:
        lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
        at = np.linspace(0.0, lengths[-1], max(2, count // len(corners)))
        found.append(np.stack([np.interp(at, lengths, line[:, axis]) for axis in range(3)], axis=-1))
    places = np.concatenate(found)
    # A receiver is not in the ground.
    places[:, 2] = np.minimum(places[:, 2], -0.5)
    return places


def sky_of(scenario: Scenario) -> Sky:
    """Compute the GNSS satellites and PDOP along the routes, every 5 minutes over a day from the start of the flights.

    The orbits are those of the scenario. A satellite counts if it is above the receiver's mask, belongs to one of its
    systems, and no obstacle or ground is in the way.
    """
    spec = scenario.spec
    receiver = next(
        sensor for fleet in spec.fleets.values() for sensor in fleet.sensors.values() if sensor.type == "gnss"
    )
    ephemeris = for_receivers(spec, component(spec.world.sky.orbits, known.ORBITS, spec))
    start = gps_seconds_from_utc(spec.start_time)
    first, last = ephemeris.span_gps_seconds
    times = start + np.arange(0.0, DAY_S + 1.0, STEP_S)
    times = times[(times >= first) & (times <= last)]
    heard = np.array([letter in receiver.systems for letter in ephemeris.system_of])
    satellites = scenario.site.ecef_to_ned(ephemeris.positions_ecef(times)[:, heard])
    places, world = places_along(scenario), scenario.world()
    count = np.zeros((len(times), len(places)), int)
    pdop, hdop = np.full(count.shape, NONE_PDOP), np.full(count.shape, NONE_PDOP)
    for i, place in enumerate(places):
        sight = satellites - place
        sight = sight / np.linalg.norm(sight, axis=-1, keepdims=True)
        used = -sight[..., 2] > math.sin(receiver.elevation_mask_rad)
        used &= ~_hidden(world, place, sight, used)
        count[:, i] = used.sum(axis=1)
        pdop[:, i], hdop[:, i] = _dilution(sight, used)
    return Sky(times - start, places, count, pdop, hdop)


def _hidden(world: World, place: NumpyArray, sight: NumpyArray, used: NumpyArray) -> NumpyArray:
    """Return a mask (T, S) of satellites hidden at a place by terrain or obstacles, in directions (T, S, 3)."""
    hidden = np.zeros(used.shape, bool)
    if not can_hide(world.obstacles, world.ground):
        return hidden
    rays = Vec3(*(jnp.asarray(sight[used][:, axis], jnp.float32) for axis in range(3)))
    origin = Vec3(*(jnp.full(rays.x.shape, float(axis), jnp.float32) for axis in place))
    hidden[used] = np.isfinite(np.asarray(first_hit(world.obstacles, world.ground, origin, rays, jnp.float32(REACH_M))))
    return hidden


def _dilution(sight: NumpyArray, used: NumpyArray) -> tuple[NumpyArray, NumpyArray]:
    """Return PDOP and HDOP, each (T,), of the satellites in mask ``used`` (T, S), in directions ``sight`` (T, S, 3)."""
    design = np.concatenate([-sight, np.ones((*used.shape, 1))], axis=-1) * used[..., None]
    normal = np.einsum("tsi,tsj->tij", design, design)
    fine = (used.sum(axis=1) >= 4) & (np.linalg.cond(normal) < 1e8)
    variance = np.full((len(used), 4), np.nan)
    variance[fine] = np.diagonal(np.linalg.inv(normal[fine]), axis1=1, axis2=2)
    pdop, hdop = (np.sqrt(variance[:, :axes].sum(axis=1)) for axes in (3, 2))
    return np.where(fine, np.minimum(pdop, NONE_PDOP), NONE_PDOP), np.where(
        fine, np.minimum(hdop, NONE_PDOP), NONE_PDOP
    )


def sky_row(sky: Sky, duration_s: float) -> Row:
    """Return the row with the verdict on satellites in view, from the start to half an hour after the last flight."""
    window = sky.seconds <= duration_s + WINDOW_S
    count, pdop = sky.count[window], sky.pdop[window]
    good = ((pdop < GOOD_PDOP) & (count >= GOOD_COUNT)).mean(axis=0)
    bad = ((pdop > BAD_PDOP) | (count < BAD_COUNT)).mean(axis=0)
    place = int(np.argmin(good))
    north, east, down = sky.places_ned[place]
    verdict: Verdict = "go" if good.min() >= GOOD_SHARE else "no-go" if bad.max() > BAD_SHARE else "marginal"
    told = (
        f"good ({GOOD_COUNT} satellites or more, PDOP below {GOOD_PDOP:g}) for {100 * good[place]:.0f} % of the time "
        f"at the worst of {len(sky.places_ned)} places of the routes (north {north:.0f}, east {east:.0f}, height "
        f"{-down:.0f} m); anywhere at least {count.min()} satellites, PDOP at most {pdop.max():.1f}"
    )
    return Row("gnss", verdict, float(good.min()), None, GOOD_SHARE, "1", told)
