"""Endurance: how long a battery would last at the mean consumption of the time in the air."""

from __future__ import annotations

from typing import cast

import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.core.arrays import Floats
from qrsim.core.tree import concatenated, quantity, record, replace
from qrsim.models.vehicles.contracts import Charged
from qrsim.world.standing import on_ground
from qrsim.world.state import Fleet, FleetState, State, World

# Without a contact that reports it, a vehicle is in the air at this height [m], or under way at this speed [m/s].
AIRBORNE_M, AIRBORNE_M_S = 0.1, 0.1


@record
class Consumption:
    """Charge that n vehicles used in the air, each (n,); NaN without a battery that drains."""

    first: Array = quantity(unit="1", doc="charge at the start")
    last: Array = quantity(unit="1", doc="charge at the last tick")
    used: Array = quantity(unit="1", doc="charge used in the air")
    ticks: Array = quantity(doc="int32 ticks in the air")

    @staticmethod
    def none(world: World, state: State) -> Consumption | None:
        """Return the charge and counts at a flight's start; None if no fleet has a battery that drains."""
        if not any(fleet.battery.drains for fleet in world.fleets):
            return None
        charge = charges(world, state)
        return Consumption(charge, charge, jnp.zeros_like(charge), jnp.zeros(charge.shape, jnp.int32))

    def update(self, world: World, state: State, counts: Array) -> Consumption:
        """Return the charge used and time in the air updated by a tick, for the vehicles marked in ``counts`` (n,)
        bool."""
        now = charges(world, state)
        counts = counts & airborne(world, state)
        # A battery that was replaced has more than before.
        spent = jnp.maximum(self.last - now, 0.0)
        return replace(
            self, last=now, used=self.used + jnp.where(counts, spent, 0.0), ticks=self.ticks + counts.astype(jnp.int32)
        )


def charges(world: World, state: State) -> Array:
    """Return the charge of each vehicle's battery (n,), 0 to 1; NaN for batteries that do not drain."""
    return jnp.concatenate(
        [
            cast(Charged, now.battery).charge
            if fleet.battery.drains
            else jnp.full_like(now.vehicle.position_ned.x, jnp.nan)
            for fleet, now in zip(world.fleets, state.fleets, strict=True)
        ]
    )


def endurance_s(consumption: Consumption | None, like: Floats, dt: float) -> Floats:
    """Return the endurance (W, n) [s], extrapolated from the charge used; NaN for vehicles that used none in the
    air."""
    if consumption is None:
        return np.full(np.shape(like), np.nan)
    used = np.asarray(consumption.used, np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        time = np.asarray(consumption.first) * (np.asarray(consumption.ticks) * dt) / used
        return np.where(used > 0.0, time, np.nan)


def airborne(world: World, state: State) -> Array:
    """Return which vehicles are in the air, (n,) bool; for vehicles that drive, which are moving."""
    return concatenated([_of_fleet(world, *each) for each in zip(world.fleets, state.fleets, strict=True)])


def _of_fleet(world: World, fleet: Fleet, state: FleetState) -> Array:
    """Return which of a fleet's vehicles are in the air, (n,) bool; for vehicles that drive, which are moving."""
    standing = on_ground(fleet, state)
    if standing is not None:
        return ~standing
    pose = fleet.vehicle.pose(state.vehicle)
    moves = pose.velocity_body.norm() > AIRBORNE_M_S
    if fleet.vehicle.rides:
        return moves
    return moves | (world.ground_down(pose.position_ned) - pose.position_ned.z > AIRBORNE_M)
