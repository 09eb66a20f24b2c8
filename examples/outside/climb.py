"""A task: climb to a height and stay there, by vertical velocities; seen is the height that the sensors give."""

import jax.numpy as jnp
import qrsim
from qrsim.tasks.agents import Axis, estimate_of, fleet_of, only


@qrsim.record
class Climb:
    height: float = qrsim.parameter(20.0, unit="m", doc="where to be, over the site's origin", minimum=0.0)
    penalty: float = qrsim.parameter(-100.0, unit="1", doc="reward of the step in which a vehicle stops", maximum=0.0)
    fleet: str = qrsim.setting("pelicans", doc="name of the fleet whose vehicles are the agents")
    period: float = qrsim.setting(0.1, unit="s", doc="time between two actions, a multiple of the time step", above=0.0)
    axes = (Axis("climb_rate", "m/s", -2.0, 2.0),)
    asks_for = qrsim.VelocitySetpoint

    def init(self, world, state, draw):
        return None  # nothing is remembered

    def commands(self, memory, world, action):
        climb = action[:, 0]
        still = jnp.zeros_like(climb)
        return only(world, self.fleet, qrsim.VelocitySetpoint(qrsim.Vec3(still, still, -climb), still))

    def judge(self, memory, world, state, step, steps):
        position = fleet_of(world, state, self.fleet)[1].vehicle.position_ned
        return memory, -jnp.abs(self.height + position.z) * self.period

    def observe(self, memory, world, state):
        believed = estimate_of(fleet_of(world, state, self.fleet)[1])
        return jnp.stack([self.height + believed.position_ned.z, -believed.velocity_ned.z], axis=-1)

    def sees(self, world):
        return Axis("to_climb", "m"), Axis("climb_rate", "m/s")
