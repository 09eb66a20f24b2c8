"""Reciprocal collision avoidance by velocity obstacles, in the plane (van den Berg et al. 2011: ORCA)."""

from __future__ import annotations

import itertools
from typing import Literal

import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.control.guidance import Route
from qrsim.control.teams.mates import KNOWS, Mates, TeamGuidance, last_waypoint, length_of, towards
from qrsim.core.tree import parameter, record, setting
from qrsim.core.vectors import Vec3

# Number of directions that are tried if no velocity satisfies all half-planes.
_TRIED = 16
# Time [s] within which vehicles that are too close must separate.
_PARTING_S = 1.0
# A velocity on the edge of a half-plane is in it, by this much [m/s].
_EDGE = 1e-4
# Edges that meet at a smaller angle [rad] have no crossing worth trying.
_PARALLEL = 1e-6


@record
class HalfPlanes:
    """Allowed velocities: (v - point) . normal >= 0 of each of K half-planes of n vehicles; horizontal, each (K, n)."""

    point_north: Array
    point_east: Array
    normal_north: Array
    normal_east: Array
    counts: Array

    def depth(self, north: Array, east: Array) -> Array:
        """Return how far [m/s] T velocities (T, n) are outside each of K half-planes, (T, K, n); negative inside."""
        point_north, point_east, normal_north, normal_east, counts = (
            value[None]
            for value in (self.point_north, self.point_east, self.normal_north, self.normal_east, self.counts)
        )
        out = (point_north - north[:, None]) * normal_north + (point_east - east[:, None]) * normal_east
        return jnp.where(counts, out, -jnp.inf)


def half_planes(
    position_ned: Vec3, velocity_ned: Vec3, mates: Mates, radius: Array, horizon: Array, dt: Array | float
) -> HalfPlanes:
    """Return half-planes of velocities that keep each vehicle (n,) clear of its neighbours for ``horizon`` [s] (ORCA).

    J. van den Berg, S. J. Guy, M. Lin, D. Manocha, Reciprocal n-body collision avoidance, ISRR 2009 (Springer 2011),
    section 4.

    Args:
        position_ned, velocity_ned: of the vehicles (n,) [m], [m/s].
        mates: who is known.
        radius: [m] of the disc around each; centres stay twice as far from each other.
        horizon: [s] for how long.
        dt: [s] within which who is too near already parts.
    """
    own_north, own_east = velocity_ned.x[None], velocity_ned.y[None]
    north, east = mates.position_ned.x - position_ned.x[None], mates.position_ned.y - position_ned.y[None]
    fast_north, fast_east = own_north - mates.velocity_ned.x, own_east - mates.velocity_ned.y
    both = jnp.broadcast_to(2.0 * radius, position_ned.x.shape)[None]
    horizon = jnp.broadcast_to(horizon, position_ned.x.shape)[None]
    squared = north * north + east * east
    apart = squared > both * both
    # A disc around the displacement within the horizon truncates the cone; overlapping vehicles separate within dt.
    within = jnp.where(apart, horizon, dt)
    from_north, from_east = fast_north - north / within, fast_east - east / within
    length = length_of(from_north, from_east)
    along = from_north * north + from_east * east
    on_disc = ~apart | ((along < 0.0) & (along * along > both * both * length * length))
    unit = _safe(length)
    disc_north, disc_east = from_north * unit, from_east * unit
    disc_push = both / within - length
    # Else the nearer of the two legs of the cone; its normal points out of it.
    leg = _root(squared - both * both, 0.0)
    left = north * from_east - east * from_north > 0.0
    side = jnp.where(left, 1.0, -1.0)
    scale = _safe(squared)
    leg_north = side * (north * leg - side * east * both) * scale
    leg_east = side * (side * north * both + east * leg) * scale
    normal_north, normal_east = -leg_east, leg_north
    leg_push = -(fast_north * normal_north + fast_east * normal_east)
    normal_north = jnp.where(on_disc, disc_north, normal_north)
    normal_east = jnp.where(on_disc, disc_east, normal_east)
    push = 0.5 * jnp.where(on_disc, disc_push, leg_push)
    counts = mates.known & jnp.isfinite(push) & (squared > 0.0)
    return HalfPlanes(own_north + push * normal_north, own_east + push * normal_east, normal_north, normal_east, counts)


def nearest_velocity(planes: HalfPlanes, north: Array, east: Array, speed: Array) -> tuple[Array, Array]:
    """Return the allowed velocity (n,) [m/s], north and east, nearest to the given one; else the least violating one.

    The nearest point of half-planes and a disc is the preferred velocity, its nearest point on one edge, or a crossing
    of two: all are tried. Where nothing is allowed, the one of those tried that is the least outside.
    """
    tried_north, tried_east = _candidates(planes, north, east, speed)
    speed = jnp.broadcast_to(speed, north.shape)[None]
    finite = jnp.isfinite(tried_north) & jnp.isfinite(tried_east)
    tried_north, tried_east = jnp.where(finite, tried_north, 0.0), jnp.where(finite, tried_east, 0.0)
    outside = jnp.max(planes.depth(tried_north, tried_east), axis=1)
    allowed = finite & (tried_north**2 + tried_east**2 <= (speed + _EDGE) ** 2)
    distance = (tried_north - north[None]) ** 2 + (tried_east - east[None]) ** 2
    inside = jnp.where(allowed & (outside <= _EDGE), distance, jnp.inf)
    # Whatever is allowed comes before what is not.
    nothing = jnp.min(inside, axis=0) == jnp.inf
    rank = jnp.where(nothing[None], jnp.where(allowed, jnp.maximum(outside, 0.0), jnp.inf), inside)
    best = jnp.min(rank, axis=0)
    count = tried_north.shape[0]
    number = jnp.arange(count, dtype=jnp.int32)[:, None]
    first = jnp.min(jnp.where(rank == best[None], number, jnp.int32(count)), axis=0)
    chosen = number == first[None]
    return jnp.sum(jnp.where(chosen, tried_north, 0.0), axis=0), jnp.sum(jnp.where(chosen, tried_east, 0.0), axis=0)


def _candidates(planes: HalfPlanes, north: Array, east: Array, speed: Array) -> tuple[Array, Array]:
    """Return T candidate velocities (T, n) [m/s], the nearest allowed one included; NaN, inf for missing crossings."""
    length = length_of(north, east)
    shrink = jnp.where(length > speed, speed * _safe(length), 1.0)
    normal_north, normal_east = planes.normal_north, planes.normal_east
    # How far each edge is from rest, along its normal.
    away = planes.point_north * normal_north + planes.point_east * normal_east
    out = away - north[None] * normal_north - east[None] * normal_east
    half = _root(jnp.broadcast_to(speed * speed, north.shape)[None] - away * away, jnp.nan)
    pairs = list(itertools.combinations(range(planes.counts.shape[0]), 2))
    crossing_north, crossing_east = [], []
    for i, j in pairs:
        cross = normal_north[i] * normal_east[j] - normal_east[i] * normal_north[j]
        cross = jnp.where(jnp.abs(cross) > _PARALLEL, cross, jnp.nan)
        crossing_north.append((away[i] * normal_east[j] - away[j] * normal_east[i]) / cross)
        crossing_east.append((away[j] * normal_north[i] - away[i] * normal_north[j]) / cross)
    each = jnp.broadcast_to(speed, north.shape)
    angle = 2.0 * np.pi * np.arange(_TRIED) / _TRIED
    around = [jnp.asarray(axis, north.dtype)[:, None] * each[None] for axis in (np.cos(angle), np.sin(angle))]
    crossings_north, crossings_east = [], []
    if pairs:
        crossings_north, crossings_east = [jnp.stack(crossing_north)], [jnp.stack(crossing_east)]
    return (
        jnp.concatenate(
            [
                (north * shrink)[None],
                0.0 * north[None],
                north[None] + out * normal_north,
                # Where each edge crosses the circle of the largest speed.
                away * normal_north - half * normal_east,
                away * normal_north + half * normal_east,
                *crossings_north,
                around[0],
            ]
        ),
        jnp.concatenate(
            [
                (east * shrink)[None],
                0.0 * east[None],
                east[None] + out * normal_east,
                away * normal_east + half * normal_north,
                away * normal_east - half * normal_north,
                *crossings_east,
                around[1],
            ]
        ),
    )


def _root(value: Array, otherwise: float) -> Array:
    """Return the square root of positive values, and ``otherwise`` for the others."""
    return jnp.where(value > 0.0, jnp.sqrt(jnp.where(value > 0.0, value, 1.0)), otherwise)


def _safe(value: Array) -> Array:
    """Return 1 / value for positive values, and 0 for the others."""
    return jnp.where(value > 0.0, 1.0 / jnp.where(value > 0.0, value, 1.0), 0.0)


@record
class AvoidanceGuidance(TeamGuidance):
    """Flies to the last waypoint, or holds the start without one, and does its half of every avoidance.

    Optimal reciprocal collision avoidance: as long as all do the same and know each other in time, none comes nearer
    than twice the radius. Where no velocity is allowed by all, the one that is the least outside is taken.
    """

    speed: Array = parameter(default=3.0, unit="m/s", doc="cruise speed", above=0.0, maximum=20.0)
    radius: Array = parameter(
        default=2.0, unit="m", doc="half of the smallest distance between centres", above=0.0, maximum=1e3
    )
    horizon: Array = parameter(default=8.0, unit="s", doc="time horizon of the avoidance", above=0.0, maximum=1e3)
    keep_right_rad: Array = parameter(
        default=0.1,
        unit="rad",
        doc="rotation of the preferred velocity to the right while other vehicles are known",
        minimum=-1.5,
        maximum=1.5,
    )
    gain: Array = parameter(default=0.5, unit="1/s", doc="velocity per metre to the waypoint", above=0.0)
    reach: Array = parameter(
        default=60.0, unit="m", doc="distance within which other vehicles are considered", above=0.0, maximum=1e5
    )
    mates: int = setting(default=6, unit="1", doc="number of nearest vehicles considered", minimum=1, maximum=16)
    knows: Literal["all", "heard"] = setting(default="all", doc=KNOWS)

    def velocity(self, route: Route, position_ned: Vec3, velocity_ned: Vec3, mates: Mates) -> tuple[Array, Array]:
        """Return the velocity (n,) [m/s], north and east, to the last waypoint that avoids the neighbours."""
        goal = last_waypoint(route)
        north, east = towards(goal, position_ned, self.speed, self.gain)
        # Vehicles that meet in one point would stop around it, so each keeps a little to the right.
        turn = jnp.where(jnp.any(mates.known, axis=0), self.keep_right_rad, 0.0)
        cosine, sine = jnp.cos(turn), jnp.sin(turn)
        north, east = cosine * north - sine * east, sine * north + cosine * east
        planes = half_planes(position_ned, velocity_ned, mates, self.radius, self.horizon, _PARTING_S)
        return nearest_velocity(planes, north, east, self.speed)
