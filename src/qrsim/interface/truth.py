"""The true state of a world as plain NumPy arrays, vehicles first."""

from __future__ import annotations

from collections.abc import Callable

import jax
import numpy as np

from qrsim.interface.arrays import Floats, as_array
from qrsim.models.vehicles.contracts import Vehicle, VehicleState, velocity_of
from qrsim.world.standing import on_ground
from qrsim.world.state import FleetState, State, World, position_of


class Truth:
    """The true state of all n vehicles, fleets one after the other."""

    def __init__(self, world: World, state: State):
        self._world, self._state = world, state

    def _gather(self, pick: Callable[[FleetState], object]) -> Floats:
        fleets = self._state.fleets
        return np.concatenate([as_array(pick(fleets[number])) for number in range(len(fleets))])

    def _of_vehicles(self, pick: Callable[[Vehicle, VehicleState], object]) -> Floats:
        """Return something of the states of all vehicles, by their models."""
        fleets = self._state.fleets
        models = [fleet.vehicle for fleet in self._world.fleets]
        return np.concatenate([as_array(pick(model, fleets[i].vehicle)) for i, model in enumerate(models)])

    @property
    def position_ned(self) -> Floats:
        """(n, 3) position [m], in double precision."""
        return self._gather(position_of)

    @property
    def attitude(self) -> Floats:
        """(n, 3) roll, pitch, yaw [rad]."""
        return self._of_vehicles(lambda model, state: model.pose(state).attitude)

    @property
    def velocity_body(self) -> Floats:
        """(n, 3) velocity over ground in body axes [m/s]."""
        return self._of_vehicles(lambda model, state: model.pose(state).velocity_body)

    @property
    def velocity_ned(self) -> Floats:
        """(n, 3) velocity over ground [m/s]."""
        # JAX would silently compute in single precision otherwise.
        with jax.enable_x64(True):
            return np.asarray(self._of_vehicles(lambda model, state: velocity_of(model.pose(state))))

    @property
    def rates_body(self) -> Floats:
        """(n, 3) body rates [rad/s]."""
        return self._of_vehicles(lambda model, state: model.pose(state).rates_body)

    @property
    def thrust(self) -> Floats:
        """(n,) collective thrust [N], NaN where a vehicle has none."""

        def thrust(model: Vehicle, state: VehicleState) -> Floats:
            # A load may be one number for all.
            return np.broadcast_to(model.load(state).thrust, np.shape(state.position_ned.x))

        return self._of_vehicles(thrust)

    @property
    def on_ground(self) -> Floats:
        """(n,) bool: stands on the ground; False where touching it ends a flight."""
        found = [on_ground(fleet, self._state.fleets[i]) for i, fleet in enumerate(self._world.fleets)]
        sizes = [fleet.size for fleet in self._world.fleets]
        return np.concatenate([np.zeros(n, bool) if now is None else now for n, now in zip(sizes, found, strict=True)])

    @property
    def specific_force(self) -> Floats:
        """(n, 3) mean specific force of the last step in body axes [m/s^2]."""
        return self._gather(lambda fleet: fleet.specific_force)

    @property
    def wind_ned(self) -> Floats:
        """(n, 3) air velocity at the vehicle during the last step [m/s], gusts included."""
        return self._gather(lambda fleet: fleet.mean_wind_ned + fleet.gust_ned)

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
