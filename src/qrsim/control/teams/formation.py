"""A formation by consensus: offsets to those one knows, and a leader (Olfati-Saber and Murray 2004; Ren 2007)."""

from __future__ import annotations

from typing import Literal

import jax.numpy as jnp
from jax import Array

from qrsim.control.guidance import Route
from qrsim.control.teams.mates import KNOWS, Mates, TeamGuidance, last_waypoint, limited, towards
from qrsim.core.tree import parameter, record, setting
from qrsim.core.vectors import Vec3

# Velocity of the leader for each metre to its waypoint [1/s], up to ``leader_speed``.
_LEADER_GAIN = 0.5


def disagreement(place_ned: Vec3, position_ned: Vec3, mates: Mates, weight: Array) -> tuple[Array, Array]:
    """Return each vehicle's weighted sum (n,) [m], north and east, of offset errors to its known neighbours.

    R. Olfati-Saber and R. M. Murray, Consensus problems in networks of agents, IEEE TAC 49 (2004), eq. 1, of positions
    less their places in the formation.

    Args:
        place_ned: places (n,) [m] in the formation, from any common point.
        position_ned: (n,) [m].
        mates: who is known, with their numbers.
        weight: (K, n) of each of them.
    """
    row = jnp.maximum(mates.number, 0)

    def sums(place: Array, position: Array, theirs: Array) -> Array:
        """Return the weighted sum (n,) [m] over neighbours of the offset errors along one axis."""
        wanted = jnp.asarray(place).at[row].get(mode="promise_in_bounds") - place[None]
        return jnp.sum(weight * jnp.where(mates.known, theirs - position[None] - wanted, 0.0), axis=0)

    return (
        sums(place_ned.x, position_ned.x, mates.position_ned.x),
        sums(place_ned.y, position_ned.y, mates.position_ned.y),
    )


@record
class FormationGuidance(TeamGuidance):
    """Holds the formation of the fleet's first waypoints, or of the starts without waypoints.

    With a leader, the first vehicle flies to its last waypoint, and the others follow: who knows it takes its velocity,
    and gives it ``leader_weight`` of the consensus, all others together the rest (W. Ren, Consensus strategies for
    cooperative control of vehicle formations, IET CTA 1 (2007)).
    """

    gain: Array = parameter(default=0.5, unit="1/s", doc="velocity per metre of mean disagreement", above=0.0)
    speed: Array = parameter(default=4.0, unit="m/s", doc="largest speed", above=0.0, maximum=20.0)
    leader_speed: Array = parameter(default=2.0, unit="m/s", doc="speed of the first vehicle", above=0.0, maximum=20.0)
    leader_weight: Array = parameter(
        default=0.5, unit="1", doc="weight of the leader in the consensus", minimum=0.0, maximum=1.0
    )
    leader: bool = setting(default=True, doc="the first vehicle leads; if false, all hold where they agree")
    reach: Array = parameter(
        default=200.0, unit="m", doc="distance within which other vehicles are considered", above=0.0, maximum=1e5
    )
    mates: int = setting(default=8, unit="1", doc="number of nearest vehicles considered", minimum=1, maximum=64)
    knows: Literal["all", "heard"] = setting(default="all", doc=KNOWS)

    def velocity(self, route: Route, position_ned: Vec3, velocity_ned: Vec3, mates: Mates) -> tuple[Array, Array]:
        """Return the velocity (n,) [m/s], north and east, that holds the formation and follows the leader."""
        leads = (mates.number == 0) if self.leader else jnp.zeros(mates.number.shape, bool)
        led = jnp.any(leads, axis=0)
        rest = jnp.sum(mates.known & ~leads, axis=0).astype(position_ned.x.dtype)
        # The weights sum to one whichever neighbours are known, so that the gain is a rate.
        for_leader = jnp.where(rest > 0.0, self.leader_weight, 1.0)
        for_each = jnp.where(led, 1.0 - for_leader, 1.0) / jnp.maximum(rest, 1.0)
        weight = jnp.where(leads, for_leader[None], for_each[None])
        places = route.position_ned.map(lambda axis: axis[0])
        lacks = disagreement(places, position_ned, mates, weight)
        shared = [jnp.sum(jnp.where(leads, axis, 0.0), axis=0) for axis in (mates.velocity_ned.x, mates.velocity_ned.y)]
        north, east = limited(shared[0] + self.gain * lacks[0], shared[1] + self.gain * lacks[1], self.speed)
        if not self.leader:
            return north, east
        first = jnp.arange(north.shape[0], dtype=jnp.int32) == 0
        lead_north, lead_east = towards(last_waypoint(route), position_ned, self.leader_speed, _LEADER_GAIN)
        return jnp.where(first, lead_north, north), jnp.where(first, lead_east, east)
