"""A task of two fleets: quadrotors that fly and a rover that drives are to be in one place at the end."""

import jax.numpy as jnp
import qrsim
from qrsim.models.vehicles.rover import SteeringCommand
from qrsim.tasks.agents import BELIEVED, Axis, believed, estimate_of, fleet_of


@qrsim.record
class Meeting:
    penalty: float = qrsim.parameter(-10.0, unit="1", doc="reward of the step in which a vehicle stops", maximum=-1.0)
    near: float = qrsim.parameter(10.0, unit="m", doc="distance from the rover that costs 1 in all", above=0.0)
    fleet: str = qrsim.setting("quadrotors", doc="name of the fleet that flies")
    rover: str = qrsim.setting("rover", doc="name of the fleet that drives")
    period: float = qrsim.setting(0.5, unit="s", doc="time between two actions, a multiple of the time step", above=0.0)

    @property
    def fleets(self):
        return self.fleet, self.rover

    def asks(self, fleet):
        return qrsim.VelocityHeightSetpoint if fleet == self.fleet else None  # the rover takes its own commands

    def acts(self, world):
        return {
            self.fleet: (Axis("velocity_north", "m/s", -3.0, 3.0), Axis("velocity_east", "m/s", -3.0, 3.0)),
            self.rover: (Axis("steering", "rad", -0.4, 0.4), Axis("speed", "m/s", 0.0, 2.0)),
        }

    def init(self, world, state, draw):
        return fleet_of(world, state, self.fleet)[1].vehicle.position_ned.z  # the heights, which are kept

    def commands(self, memory, world, action):
        north, east = action[self.fleet].T
        steering, speed = action[self.rover].T
        each = {
            self.fleet: qrsim.VelocityHeightSetpoint(north, east, memory, jnp.zeros_like(north)),
            self.rover: SteeringCommand(steering, speed),
        }
        return tuple(each.get(fleet.name) for fleet in world.fleets)

    def judge(self, memory, world, state, step, steps):
        flies, drives = (fleet_of(world, state, name)[1].vehicle.position_ned for name in self.fleets)
        cost = ((flies.x - drives.x[0]) ** 2 + (flies.y - drives.y[0]) ** 2) / self.near**2 / steps
        return memory, {self.fleet: -cost, self.rover: -jnp.mean(cost, keepdims=True)}

    def observe(self, memory, world, state):
        """Return what each quadrotor believes of itself (n, 9), and of the rover (1, 4) with the way to the first."""
        flies, drives = (fleet_of(world, state, name)[1] for name in self.fleets)
        way, own = estimate_of(flies).position_ned, estimate_of(drives)
        parts = (own.velocity_ned.x, own.velocity_ned.y, way.x[:1] - own.position_ned.x, way.y[:1] - own.position_ned.y)
        return {self.fleet: believed(flies), self.rover: jnp.stack(parts, axis=-1)}

    def sees(self, world):
        own = Axis("velocity_north", "m/s"), Axis("velocity_east", "m/s")
        return {self.fleet: BELIEVED, self.rover: (*own, Axis("way_north", "m"), Axis("way_east", "m"))}
