"""The air at vehicles: what their turbulence looks at, its gusts, and what a vehicle may look at around it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from jax import Array

from qrsim.core.vectors import Vec3, rotation
from qrsim.models.atmosphere.contracts import Turbulence
from qrsim.models.atmosphere.wind import mean_wind_at
from qrsim.models.vehicles.contracts import Around, Pose
from qrsim.models.vehicles.wake import Wake, jet_velocity
from qrsim.world.state import Fleet, FleetState, World

Time = tuple[Array, Array]


def turbulence_inputs(turbulence: Turbulence, position_ned: Vec3, time: Time, field: object) -> dict[str, object]:
    """Return the arguments of a turbulence beside its state and the height, by name.

    Args:
        turbulence: whose ``reads`` say so.
        position_ned: of vehicles (n,) [m].
        time: since the start of the run, () int32 whole seconds and the rest.
        field: what the gusts of the episode share.
    """
    known: dict[str, object] = {"position_ned": position_ned, "seconds": time[0], "fraction": time[1], "field": field}
    return {name: known[name] for name in turbulence.reads}


def gust_at(world: World, field: object, memory: object, height_agl: Array, position_ned: Vec3, time: Time) -> Vec3:
    """Return the gust (n,) [m/s], random and discrete, and the updrafts at positions (n,) [m].

    ``memory`` is the turbulence's state.
    """
    shared, drawn = _parted(world, field)
    inputs = turbulence_inputs(world.turbulence, position_ned, time, shared)
    random = world.turbulence.gust_ned(memory, height_agl, **inputs)
    carried: dict[str, Any] = {name: world.turbulence.convection_velocity_ned(world.wind) for name in world.gust.reads}
    gust = random + world.gust.velocity_ned(position_ned, *time, **carried)
    if not world.updrafts:
        return gust
    mean = mean_wind_at(world.wind, height_agl, position_ned, time)
    for updraft, own in zip(world.updrafts, drawn, strict=True):
        known: dict[str, Any] = {"wind": world.wind, "ground": world.ground, "drawn": own}
        given = {name: known[name] for name in updraft.reads}
        gust = gust + updraft.velocity_ned(position_ned, height_agl, mean, *time, **given)
    return gust


def _parted(world: World, field: Any) -> tuple[object, tuple[object, ...]]:
    """Return what the turbulence of all vehicles shares, and what each updraft has drawn."""
    return (field.turbulence, field.updrafts) if world.updrafts else (field, ())


def gust_rates_at(
    world: World, field: object, memory: object, height_agl: Array, position_ned: Vec3, time: Time
) -> Vec3 | None:
    """Return the rotation of the air (n,) [rad/s] in NED, None where the turbulence gives none."""
    if not world.turbulence.rates:
        return None
    inputs = turbulence_inputs(world.turbulence, position_ned, time, _parted(world, field)[0])
    return world.turbulence.gust_rates_ned(memory, height_agl, **inputs)


def around_of(
    world: World,
    pose: Pose,
    rates_ned: Vec3 | None,
    downwash: Callable[[Vec3], Vec3] | None = None,
    failed: tuple[tuple[int, Array, Array], ...] = (),
) -> Around:
    """Return the part of the world that vehicles (n,) may read.

    Args:
        world: with its ground.
        pose: of the vehicles.
        rates_ned: rotation of the air (n,) [rad/s]; None: none.
        downwash: see ``wakes_at``; None: there are no wakes.
        failed: see ``Around``.
    """
    still = Vec3.zeros(pose.attitude.roll.shape, pose.attitude.roll.dtype)

    def ground(position_ned: Vec3) -> tuple[Array, Vec3]:
        return world.ground_down(position_ned), world.ground.normal(position_ned)

    rates = still if rates_ned is None else rotation(pose.attitude).to_body(rates_ned)
    return Around(ground, rates, downwash or (lambda position: still), failed, world.air.density(pose.position_ned))


def wakes_at(world: World, before: tuple[FleetState, ...], fleet: Fleet) -> Callable[[Vec3], Vec3] | None:
    """Return positions (n,) [m] of a fleet -> velocity (n,) [m/s] in NED of the wakes of all other vehicles there.

    Each of n vehicles looks at each of m: the cost grows with the square of a world's vehicles.

    Args:
        world: whose fleets.
        before: as they were at the end of the tick before.
        fleet: which one asks; its vehicles do not feel their own.
    """
    if "downwash" not in fleet.vehicle.reads or sum(each.size for each in world.fleets) == 1:
        return None

    def downwash(position_ned: Vec3) -> Vec3:
        total = position_ned * 0.0
        for other, state in zip(world.fleets, before, strict=True):
            wake = other.vehicle.wake()
            if wake is not None:
                total = total + _wake_of(other, state, wake, position_ned, other.name == fleet.name)
        return total

    return downwash


def _wake_of(fleet: Fleet, state: FleetState, wake: Wake, position_ned: Vec3, same: bool) -> Vec3:
    """Return the sum of the wakes of a fleet's vehicles (m,) at places (n,); ``same``: of the same vehicles."""

    def upper(values: Array) -> Array:
        return jnp.broadcast_to(values, (fleet.size,))[:, None]

    pose = fleet.vehicle.pose(state.vehicle)
    turned = rotation(pose.attitude)
    thrust = fleet.vehicle.load(state.vehicle).thrust
    flies = (state.violation.code == 0) & jnp.isfinite(thrust)
    wind = state.mean_wind_ned + state.gust_ned - turned.to_ned(pose.velocity_body)
    offset = position_ned.map(lambda axis: axis[None, :]) - pose.position_ned.map(upper)
    found = jet_velocity(
        Wake(upper(wake.size), upper(wake.disc_area)), upper(jnp.where(flies, thrust, 0.0)), turned.down.map(upper),
        wind.map(upper), offset,
    )  # fmt: skip
    if same:
        number = jnp.arange(fleet.size)
        others = number[:, None] != number[None, :]
        found = found.map(lambda axis: jnp.where(others, axis, 0.0))
    return found.map(lambda axis: jnp.sum(axis, axis=0))
