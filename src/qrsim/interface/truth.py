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
        """Return ``pick(world, state, fleet number)`` of all fleets as one array (n, ...)."""
        offsets = self._seen.offsets.of_vehicles(name, pick)
        if offsets is not None:
            return self._seen.at(offsets)
        return np.concatenate([as_array(pick(self._world, self._state, i)) for i in range(len(self._world.fleets))])

    def _table(self) -> Table:
        """Return the table of the true state that is shown: a row for each quantity, a column for each vehicle."""
        columns = columns_of([name for fleet in self._world.fleets for name in fleet.vehicle_names])
        rows = [(name, unit, *cells_of(getattr(self, name), len(columns))) for name, unit in _UNITS.items()]
        return Table("true state", ("field", "unit", *columns), rows)

    @property
    def position_ned(self) -> Floats:
        """(n, 3) position [m], in double precision."""
        high = self._of_vehicles("position_ned", lambda world, state, i: state.fleets[i].vehicle.position_ned)
        if self._seen.offsets.in_two_parts:
            low = self._of_vehicles("position_low_ned", lambda world, state, i: state.fleets[i].position_low_ned)
            high = np.add(high, low, dtype=np.float64)
        return high

    @property
    def attitude(self) -> Floats:
        """(n, 3) roll, pitch, yaw [rad]."""
        return self._of_vehicles("attitude", lambda world, state, i: _pose(world, state, i).attitude)

    @property
    def velocity_body(self) -> Floats:
        """(n, 3) velocity over ground in body axes [m/s]."""
        return self._of_vehicles("velocity_body", lambda world, state, i: _pose(world, state, i).velocity_body)

    @property
    def velocity_ned(self) -> Floats:
        """(n, 3) velocity over ground [m/s]."""
        # JAX would silently compute in single precision otherwise.
        with jax.enable_x64(True):
            return np.asarray(
                self._of_vehicles("velocity_ned", lambda world, state, i: velocity_of(_pose(world, state, i)))
            )

    @property
    def rates_body(self) -> Floats:
        """(n, 3) body rates [rad/s]."""
        return self._of_vehicles("rates_body", lambda world, state, i: _pose(world, state, i).rates_body)

    @property
    def thrust(self) -> Floats:
        """(n,) collective thrust [N], NaN where a vehicle has none."""

        def thrust(world: World, state: State, i: int) -> object:
            """Return the thrust (n,) [N] of the fleet number ``i``."""
            vehicle = state.fleets[i].vehicle
            found = world.fleets[i].vehicle.load(vehicle).thrust
            # A load may be one number for all.
            return found if np.shape(found) else np.broadcast_to(found, np.shape(vehicle.position_ned.x))

        return self._of_vehicles("thrust", thrust)

    @property
    def on_ground(self) -> Floats:
        """(n,) bool: on the ground; False where touching it ends a flight."""
        found = [on_ground(fleet, self._state.fleets[i]) for i, fleet in enumerate(self._world.fleets)]
        sizes = [fleet.size for fleet in self._world.fleets]
        return np.concatenate([np.zeros(n, bool) if now is None else now for n, now in zip(sizes, found, strict=True)])

    @property
    def specific_force(self) -> Floats:
        """(n, 3) mean specific force of the last step in body axes [m/s^2]."""
        return self._of_vehicles("specific_force", lambda world, state, i: state.fleets[i].specific_force)

    @property
    def wind_ned(self) -> Floats:
        """(n, 3) air velocity at the vehicle during the last step [m/s], gusts included."""
        mean = self._of_vehicles("mean_wind_ned", lambda world, state, i: state.fleets[i].mean_wind_ned)
        return mean + self._of_vehicles("gust_ned", lambda world, state, i: state.fleets[i].gust_ned)

    @property
    def command(self) -> Floats:
        """(n, C) the last command as flown, the fields of each fleet's own; those of the quadrotor are pitch, roll,
        throttle, yaw rate, battery. NaN where another fleet has more fields.
        """
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
        """(n, 13) position, Euler angles, body velocity, body rates, thrust, in double precision."""
        parts = (self.position_ned, self.attitude, self.velocity_body, self.rates_body, self.thrust[:, None])
        return np.concatenate(parts, axis=1)


def _pose(world: World, state: State, fleet: int) -> Pose:
    """Return the pose of a fleet's vehicles."""
    return world.fleets[fleet].vehicle.pose(state.fleets[fleet].vehicle)
