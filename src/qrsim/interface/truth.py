"""The true state of a world as plain NumPy arrays, vehicles first."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import jax
import numpy as np

from qrsim.core.arrays import Floats
from qrsim.core.tables import Table, Tabled, cells_of, columns_of
from qrsim.interface.arrays import as_array
from qrsim.interface.seen import Seen
from qrsim.models.vehicles.contracts import Pose, velocity_of
from qrsim.world.standing import on_ground
from qrsim.world.state import State, World

# What a table shows, with its unit.
_UNITS = {
    "position_ned": "m",
    "attitude": "rad",
    "velocity_ned": "m/s",
    "velocity_body": "m/s",
    "rates_body": "rad/s",
    "thrust": "N",
    "specific_force": "m/s^2",
    "wind_ned": "m/s",
    "on_ground": "",
    "command": "",
}


class Truth(Tabled):
    """The true state of all n vehicles, fleets one after the other; every array is the user's own."""

    def __init__(self, world: World, seen: Seen):
        self._world, self._seen = world, seen
        self._state = cast(State, seen)

    def _of_vehicles(self, name: str, pick: Callable[[World, State, int], object]) -> Floats:
        """Return ``pick(world, state, fleet number)`` of every fleet as one array (n, ...); ``name``: key of its cached
        indices."""
        offsets = self._seen.offsets.of_vehicles(name, pick)
        if offsets is not None:
            return self._seen.at(offsets)
        return np.concatenate([as_array(pick(self._world, self._state, i)) for i in range(len(self._world.fleets))])

    def _table(self) -> Table:
        """Return the true state as a table for display: a row for each quantity, a column for each vehicle."""
        columns = columns_of([name for fleet in self._world.fleets for name in fleet.vehicle_names])
        rows = [(name, unit, *cells_of(getattr(self, name), len(columns))) for name, unit in _UNITS.items()]
        return Table("true state", ("field", "unit", *columns), rows)

    @property
    def position_ned(self) -> Floats:
        """Position NED (n, 3) [m], in double precision."""
        high = self._of_vehicles("position_ned", lambda world, state, i: state.fleets[i].vehicle.position_ned)
        if self._seen.offsets.in_two_parts:
            low = self._of_vehicles("position_low_ned", lambda world, state, i: state.fleets[i].position_low_ned)
            high = np.add(high, low, dtype=np.float64)
        return high

    @property
    def attitude(self) -> Floats:
        """Roll, pitch and yaw (n, 3) [rad]."""
        return self._of_vehicles("attitude", lambda world, state, i: _pose(world, state, i).attitude)

    @property
    def velocity_body(self) -> Floats:
        """Velocity over ground in body axes (n, 3) [m/s]."""
        return self._of_vehicles("velocity_body", lambda world, state, i: _pose(world, state, i).velocity_body)

    @property
    def velocity_ned(self) -> Floats:
        """Velocity over ground NED (n, 3) [m/s]."""
        # JAX would silently compute in single precision otherwise.
        with jax.enable_x64(True):
            return np.asarray(
                self._of_vehicles("velocity_ned", lambda world, state, i: velocity_of(_pose(world, state, i)))
            )

    @property
    def rates_body(self) -> Floats:
        """Body rates p, q, r (n, 3) [rad/s]."""
        return self._of_vehicles("rates_body", lambda world, state, i: _pose(world, state, i).rates_body)

    @property
    def thrust(self) -> Floats:
        """Collective thrust (n,) [N], NaN for vehicles without one."""

        def thrust(world: World, state: State, i: int) -> object:
            """Return the thrust (n,) [N] of fleet number ``i``."""
            vehicle = state.fleets[i].vehicle
            found = world.fleets[i].vehicle.load(vehicle).thrust
            # A load may be one number for all.
            return found if np.shape(found) else np.broadcast_to(found, np.shape(vehicle.position_ned.x))

        return self._of_vehicles("thrust", thrust)

    @property
    def on_ground(self) -> Floats:
        """Which vehicles are on the ground, (n,) bool; False where touching it ends a flight."""
        found = [on_ground(fleet, self._state.fleets[i]) for i, fleet in enumerate(self._world.fleets)]
        sizes = [fleet.size for fleet in self._world.fleets]
        return np.concatenate([np.zeros(n, bool) if now is None else now for n, now in zip(sizes, found, strict=True)])

    @property
    def specific_force(self) -> Floats:
        """Mean specific force of the last tick in body axes (n, 3) [m/s^2]."""
        return self._of_vehicles("specific_force", lambda world, state, i: state.fleets[i].specific_force)

    @property
    def wind_ned(self) -> Floats:
        """Air velocity NED (n, 3) [m/s] at each vehicle in the last tick, gusts included."""
        mean = self._of_vehicles("mean_wind_ned", lambda world, state, i: state.fleets[i].mean_wind_ned)
        return mean + self._of_vehicles("gust_ned", lambda world, state, i: state.fleets[i].gust_ned)

    @property
    def command(self) -> Floats:
        """Last command as flown (n, C), in each fleet's own fields (quadrotor: pitch, roll, throttle, yaw rate,
        battery); NaN where another fleet has more."""
        commands = [self._state.fleets[number].command for number in range(len(self._world.fleets))]
        sizes = [fleet.size for fleet in self._world.fleets]
        rows = [
            np.stack(list(vars(command).values()), axis=-1) if vars(command) else np.zeros((size, 0))
            for command, size in zip(commands, sizes, strict=True)
        ]
        widest = max(row.shape[1] for row in rows)
        wide = [np.pad(row, ((0, 0), (0, widest - row.shape[1])), constant_values=np.nan) for row in rows]
        return np.concatenate(wide)

    @property
    def state(self) -> Floats:
        """Position NED, Euler angles, body velocity, body rates and thrust (n, 13), in double precision."""
        parts = (self.position_ned, self.attitude, self.velocity_body, self.rates_body, self.thrust[:, None])
        return np.concatenate(parts, axis=1)


def _pose(world: World, state: State, fleet: int) -> Pose:
    """Return the poses of the vehicles of fleet number ``fleet``."""
    return world.fleets[fleet].vehicle.pose(state.fleets[fleet].vehicle)
