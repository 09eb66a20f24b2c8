"""Intersections of rays with obstacles, for radio, scans and cameras.

See docs/explanation/models/scene.md.

Rays have any shape. Every ray is compared with every obstacle; intersections are exact.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import jax.numpy as jnp
from jax import Array, lax

from qrsim.core.vectors import Vec3
from qrsim.models.scene.contracts import Ground
from qrsim.models.scene.obstacles import Obstacles

Span = tuple[Array, Array]
# A ray is parallel to a plane if its component across it is smaller than this.
_ALONG = 1e-12


def ray_distance(obstacles: Obstacles, origin_ned: Vec3, direction: Vec3) -> Array:
    """Return the distance along rays (...) to the first obstacle, in multiples of the length of ``direction``.

    It is 0 for a ray that begins inside an obstacle, and infinite for one that hits none.

    Args:
        obstacles: of the world, ``world.obstacles``.
        origin_ned: origin of the rays (...) [m].
        direction: vectors of any length (...).
    """
    distance = jnp.full(_shape(origin_ned, direction), jnp.inf, direction.x.dtype)
    for low, high, _ in _crossings(obstacles, origin_ned, direction):
        met = (low <= high) & (high >= 0.0)
        distance = jnp.minimum(distance, jnp.min(jnp.where(met, jnp.maximum(low, 0.0), jnp.inf), axis=0))
    return distance


def first_hit(obstacles: Obstacles, ground: Ground, origin_ned: Vec3, direction: Vec3, reach: Array) -> Array:
    """Return the distance [m] along rays (...) to the first obstacle or the ground; infinite beyond ``reach``.

    Args:
        obstacles, ground: of the world.
        origin_ned: origin of the rays (...) [m].
        direction: unit vectors (...).
        reach: largest distance [m].
    """
    solid = ray_distance(obstacles, origin_ned, direction)
    nearest = jnp.minimum(solid, ground.ray_distance(origin_ned, direction, reach))
    return jnp.where(nearest <= reach, nearest, jnp.inf)


def any_of(obstacles: Obstacles) -> bool:
    """Return whether a world has any obstacle, a Python bool known while a program is compiled."""
    kinds = (obstacles.boxes, obstacles.cylinders, None if obstacles.prisms is None else obstacles.prisms.pieces)
    return any(kind is not None and kind.z_min.shape[0] > 0 for kind in kinds)


def can_hide(obstacles: Obstacles, ground: Ground) -> bool:
    """Return whether obstacles or terrain can block a line of sight, a Python bool known at compile time."""
    return any_of(obstacles) or not ground.flat


def _shape(origin_ned: Vec3, direction: Vec3) -> tuple[int, ...]:
    """Return the broadcast shape of rays' origins and directions."""
    return jnp.broadcast_shapes(origin_ned.x.shape, direction.x.shape)


def _crossings(obstacles: Obstacles, origin_ned: Vec3, direction: Vec3) -> Iterator[tuple[Array, Array, Array | None]]:
    """Yield, for each kind of solid, the distances at which rays (...) enter and leave its T solids, and owners (T,).

    Distances are (T, ...), in lengths of the direction; a ray that misses a solid enters after it leaves. Owners are
    the numbers (T,) of the buildings that the solids belong to, None if each solid is a whole obstacle.
    """
    shape = _shape(origin_ned, direction)
    origin, ray = (end.map(lambda axis: jnp.broadcast_to(axis, shape)[None]) for end in (origin_ned, direction))
    pieces = None if obstacles.prisms is None else obstacles.prisms.pieces
    for solids, meets, owner in (
        (obstacles.boxes, _in_boxes, None),
        (obstacles.cylinders, _in_cylinders, None),
        (pieces, _in_pieces, None if pieces is None else pieces.number),
    ):
        if solids is None or not solids.z_min.shape[0]:
            continue
        column = (-1,) + (1,) * len(shape)
        yield *meets(_as_columns(solids, column), origin, ray), owner


def line_of_sight(obstacles: Obstacles, from_ned: Vec3, to_ned: Vec3) -> Array:
    """Return (...) bool: no obstacle is between two points (...) [m]; False if a point is inside one."""
    return ray_distance(obstacles, from_ned, to_ned - from_ned) > 1.0


def walls_between(obstacles: Obstacles, from_ned: Vec3, to_ned: Vec3) -> Array:
    """Return the number of obstacles (...) between two points (...) [m]; a building of several parts counts once."""
    direction = to_ned - from_ned
    count = jnp.zeros(_shape(from_ned, direction), jnp.int32)
    for low, high, owner in _crossings(obstacles, from_ned, direction):
        met = (low <= high) & (high >= 0.0) & (low <= 1.0)
        if owner is not None and met.shape[0] > 1:
            met = met & ~_met_before(met, jnp.asarray(owner))
        count = count + jnp.sum(met.astype(jnp.int32), axis=0, dtype=jnp.int32)
    return count


def _met_before(met: Array, owner: Array) -> Array:
    """Return (T, ...) bool: an earlier part of the same prism is hit; a prism's parts are consecutive rows."""
    place = jnp.arange(owner.shape[0], dtype=jnp.int32)
    begins = jnp.concatenate([jnp.ones(1, bool), owner[1:] != owner[:-1]])
    first = lax.cummax(jnp.where(begins, place, 0))
    before = jnp.cumsum(met.astype(jnp.int32), axis=0, dtype=jnp.int32) - met.astype(jnp.int32)
    row = jnp.broadcast_to(jnp.reshape(first, (-1,) + (1,) * (met.ndim - 1)), met.shape)
    return before > jnp.take_along_axis(before, row, axis=0, mode="promise_in_bounds")


def _as_columns(solids: object, column: tuple[int, ...]) -> object:
    """Return the arrays of solids reshaped to the shape ``column``, to broadcast against rays."""
    import jax

    return jax.tree.map(lambda leaf: jnp.reshape(jnp.asarray(leaf), column), solids)


def _between(start: Array, rate: Array, low: Array, high: Array) -> Span:
    """Return the first and last t for which low <= ``start`` + t ``rate`` <= high; first > last if no t has this."""
    still = jnp.abs(rate) <= _ALONG
    inverse = 1.0 / jnp.where(still, 1.0, rate)
    first, last = (low - start) * inverse, (high - start) * inverse
    inside = (start >= low) & (start <= high)
    never, always = (jnp.inf, -jnp.inf), (-jnp.inf, jnp.inf)
    begin = jnp.where(still, jnp.where(inside, always[0], never[0]), jnp.minimum(first, last))
    end = jnp.where(still, jnp.where(inside, always[1], never[1]), jnp.maximum(first, last))
    return begin, end


def _above(start: Array, rate: Array) -> Span:
    """Return the first and last t for which ``start`` + t ``rate`` >= 0, perhaps infinite; first > last if none."""
    still = jnp.abs(rate) <= _ALONG
    root = -start / jnp.where(still, 1.0, rate)
    begin = jnp.where(rate > 0.0, root, -jnp.inf)
    end = jnp.where(rate < 0.0, root, jnp.inf)
    outside = still & (start < 0.0)
    return jnp.where(outside, jnp.inf, jnp.where(still, -jnp.inf, begin)), jnp.where(
        outside, -jnp.inf, jnp.where(still, jnp.inf, end)
    )


def _all(*spans: Span) -> Span:
    """Return the intersection of intervals (low, high) along each ray; low > high if it is empty."""
    low, high = spans[0]
    for first, last in spans[1:]:
        low, high = jnp.maximum(low, first), jnp.minimum(high, last)
    return low, high


def _in_boxes(boxes: Any, origin: Vec3, ray: Vec3) -> Span:
    """Return the interval (low, high) of each ray that is inside each box; low > high if it misses."""
    return _all(
        _between(origin.x, ray.x, boxes.x_min, boxes.x_max),
        _between(origin.y, ray.y, boxes.y_min, boxes.y_max),
        _between(origin.z, ray.z, boxes.z_min, boxes.z_max),
    )


def _in_cylinders(cylinders: Any, origin: Vec3, ray: Vec3) -> Span:
    """Return the interval (low, high) of each ray inside each upright cylinder; low > high if it misses."""
    x, y = origin.x - cylinders.x, origin.y - cylinders.y
    square = ray.x * ray.x + ray.y * ray.y
    upright = square <= _ALONG
    middle = x * ray.x + y * ray.y
    outside = x * x + y * y - cylinders.radius * cylinders.radius
    under = middle * middle - square * outside
    root = jnp.sqrt(jnp.maximum(under, 0.0))
    inverse = 1.0 / jnp.where(upright, 1.0, square)
    misses = jnp.where(upright, outside > 0.0, under < 0.0)
    low = jnp.where(misses, jnp.inf, jnp.where(upright, -jnp.inf, (-middle - root) * inverse))
    high = jnp.where(misses, -jnp.inf, jnp.where(upright, jnp.inf, (-middle + root) * inverse))
    return _all((low, high), _between(origin.z, ray.z, cylinders.z_min, cylinders.z_max))


def _in_pieces(pieces: Any, origin: Vec3, ray: Vec3) -> Span:
    """Return the interval (low, high) of each ray inside each trapezoidal solid; low > high if it misses."""
    tall = pieces.north - pieces.south
    spans = [_between(origin.x, ray.x, pieces.south, pieces.north)]
    for (low, high), sign in ((pieces.west, 1.0), (pieces.east, -1.0)):
        slope = (high - low) / tall
        start = sign * (origin.y - low - slope * (origin.x - pieces.south))
        spans.append(_above(start, sign * (ray.y - slope * ray.x)))
    return _all(*spans, _between(origin.z, ray.z, pieces.z_min, pieces.z_max))
