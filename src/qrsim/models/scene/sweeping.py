"""Collisions on the way of a time step, not at its end alone: a fast vehicle would pass through a thin wall."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array, lax

from qrsim.core.vectors import Vec3
from qrsim.models.scene.obstacles import Obstacles
from qrsim.models.scene.rays import any_of

# Number of looks; for each vehicle (n,) how far along its way it is, what it has met and whether it has, and whether it
# looks on.
_Walk = tuple[Array, Array, Array, Array, Array]
# Looks on a way at most: what is thinner than this part of it, and touched by nothing but a point, may be missed.
LOOKS = 64


def obstacle_hit(obstacles: Obstacles, start_ned: Vec3, end_ned: Vec3, radius: Array) -> tuple[Array, Array]:
    """Return the obstacle number (n,), nearest to the path's end or met on it, and (n,) bool: within ``radius``.

    Args:
        obstacles: of the world.
        start_ned, end_ned: ends of the way (n,) [m]; nothing is hit at its start.
        radius: distance [m] to be kept, () or (n,); whatever it is, no obstacle can be touched.
    """
    # A loop of an unknown length has no gradient backwards.
    start_ned, end_ned, radius = jax.tree.map(lax.stop_gradient, (start_ned, end_ned, radius))
    distance, number = obstacles.nearest(end_ned)
    hit = (distance < radius) | (distance <= 0.0)
    if not any_of(obstacles):
        return number, hit
    way = end_ned - start_ned
    length = jnp.sqrt(way.dot(way))
    # A prism beyond its reach may be overlooked, so that a distance is known up to there only.
    sight = jnp.inf if obstacles.prisms is None else obstacles.prisms.reach
    near = ~hit & (jnp.minimum(distance, sight) < radius + length)

    def walked() -> tuple[Array, Array]:
        """Return obstacle number and hit (n,), found by steps along the paths as long as the free distance."""

        def goes_on(walk: _Walk) -> Array:
            """Return whether another step along the paths is needed."""
            look, _, _, _, on = walk
            return (look < LOOKS) & jnp.any(on)

        def look_again(walk: _Walk) -> _Walk:
            """Return the search's state after one more step along the paths."""
            look, at, found, met, on = walk
            free, which = obstacles.nearest(start_ned + way * at)
            touches = on & ((free < radius) | (free <= 0.0))
            # No obstacle is nearer than the nearest one: so far the way is free.
            ahead = at + jnp.maximum((jnp.minimum(free, sight) - radius) / length, 1.0 / LOOKS)
            return look + 1, ahead, jnp.where(touches, which, found), met | touches, on & ~touches & (ahead < 1.0)

        begin = (jnp.int32(0), jnp.zeros_like(length), number, hit, near)
        _, _, found, met, _ = lax.while_loop(goes_on, look_again, begin)
        return found, met

    result: tuple[Array, Array] = lax.cond(jnp.any(near), walked, lambda: (number, hit))
    return result


def closest_squared(start: Vec3, end: Vec3) -> Array:
    """Return the squared distance (...) [m^2] of the origin from straight paths, their start excluded."""
    way = end - start
    square = way.dot(way)
    part = -start.dot(way) / jnp.where(square > 0.0, square, 1.0)
    between = start + way * part
    inside = (part > 0.0) & (part < 1.0)
    return jnp.where(inside, between.dot(between), end.dot(end))
