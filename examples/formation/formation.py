"""A task: followers keep their places behind a leader, of whom they know what its radio says."""

import jax.numpy as jnp
import numpy as np
import qrsim
from qrsim.tasks.agents import BELIEVED, Axis, believed, fleet_of, only


class Keeper:
    """The policy that comes with the task: fly as the leader does, and towards the own place."""

    GAIN = 0.5  # 1/s

    def __init__(self, play, seed):
        self.leader = play.world.rows_of(play.task.leader).start  # its number in the world, by which messages name it
        self.limit = play.axes[0].high
        self.period = play.task.period
        self.known = np.full((len(play.agents), 4), np.nan)  # of the leader: position and velocity, north and east

    def act(self, seen):
        """Return velocities (n, 2), as parts of the largest, from what all followers see and have heard."""
        self.known[:, :2] += self.period * self.known[:, 2:]
        for agent, slot in zip(*np.nonzero(seen["mask"] & (seen["sender"] == self.leader)), strict=True):
            position, velocity = seen["heard"][agent, slot, :2], seen["heard"][agent, slot, 3:5]
            self.known[agent] = [*(position + seen["age"][agent, slot] * velocity), *velocity]
        own, place = seen["see"][:, :2], seen["see"][:, 9:]
        wanted = self.known[:, 2:] + self.GAIN * (self.known[:, :2] + place - own)
        return np.clip(np.nan_to_num(wanted / self.limit), -1.0, 1.0)


@qrsim.record
class Formation:
    spacing: float = qrsim.parameter(
        8.0, unit="m", doc="from one row of the wedge to the next, and to the side", above=0.0
    )
    penalty: float = qrsim.parameter(-10.0, unit="1", doc="reward of the step in which a vehicle stops", maximum=-1.0)
    fleet: str = qrsim.setting("followers", doc="name of the fleet whose vehicles are the agents")
    leader: str = qrsim.setting("leader", doc="name of the fleet whose first vehicle leads")
    period: float = qrsim.setting(0.2, unit="s", doc="time between two actions, a multiple of the time step", above=0.0)
    axes = (Axis("velocity_north", "m/s", -5.0, 5.0), Axis("velocity_east", "m/s", -5.0, 5.0))
    asks_for = qrsim.VelocityHeightSetpoint
    baseline = Keeper

    def places(self, world):
        """Return each follower's place (n, 2) [m] north and east of the leader: a wedge, right, left, right, ..."""
        number = np.arange(next(fleet.size for fleet in world.fleets if fleet.name == self.fleet))
        row, side = number // 2 + 1, 1 - 2 * (number % 2)
        return self.spacing * jnp.asarray(np.stack([-row, side * row], axis=-1), jnp.result_type(self.spacing))

    def init(self, world, state, draw):
        return fleet_of(world, state, self.fleet)[1].vehicle.position_ned.z  # the heights, which are kept

    def commands(self, memory, world, action):
        north, east = action.T
        return only(world, self.fleet, qrsim.VelocityHeightSetpoint(north, east, memory, jnp.zeros_like(north)))

    def judge(self, memory, world, state, step, steps):
        place = self.places(world)
        followers, leader = (fleet_of(world, state, name)[1].vehicle.position_ned for name in (self.fleet, self.leader))
        north, east = followers.x - leader.x[0] - place[:, 0], followers.y - leader.y[0] - place[:, 1]
        return memory, -jnp.minimum((north**2 + east**2) / self.spacing**2, 1.0) / steps

    def observe(self, memory, world, state):
        return jnp.concatenate([believed(fleet_of(world, state, self.fleet)[1]), self.places(world)], axis=-1)

    def sees(self, world):
        return *BELIEVED, Axis("place_north", "m"), Axis("place_east", "m")
