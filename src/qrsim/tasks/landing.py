"""Landing on a pad (docs/explanation/task_design.md)."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from qrsim.core.tree import parameter, record
from qrsim.tasks.simple import ReachWaypoint, SimpleMemory
from qrsim.world.standing import on_ground
from qrsim.world.state import Fleet, FleetState, World


@record
class Land(ReachWaypoint):
    """Land at the last waypoint of the route, a pad on the ground, soon and with little effort.

    The cost is that of ``reach_waypoint``, and ``airborne`` for each second off the ground. It needs a fleet with
    ``ground: parked`` or a vehicle with a model of contact; for others every touch of the ground ends the flight.
    """

    airborne: Array = parameter(default=1.0, unit="1/s", doc="cost per second off the ground", minimum=0.0)

    def cost_rate(self, model: Fleet, fleet: FleetState) -> Array:
        """Return each vehicle's cost per second (n,): of its commands, and ``airborne`` while it is off the ground."""
        effort: Array = ReachWaypoint.cost_rate(self, model, fleet)
        stands = on_ground(model, fleet)
        return effort + (self.airborne if stands is None else jnp.where(stands, 0.0, self.airborne))

    def highest_cost(self, memory: SimpleMemory, world: World, duration: Array) -> Array:
        """Return the largest possible cost (n,) in ``duration`` [s]: as in ``reach_waypoint``, and never landed."""
        highest: Array = ReachWaypoint.highest_cost(self, memory, world, duration)
        return highest + self.airborne * duration
