"""The air at vehicles: inputs of their turbulence, gusts, and the surroundings that a vehicle model can read."""

from __future__ import annotations

from typing import Any

from jax import Array

from qrsim.core.tree import replace
from qrsim.core.vectors import Vec3, rotation
from qrsim.models.atmosphere.contracts import Turbulence
from qrsim.models.atmosphere.wind import mean_wind_at
from qrsim.models.vehicles.contracts import Around, Pose
from qrsim.models.vehicles.faults import RotorFault, failed_rotors, stuck_rotors
from qrsim.world.state import World, replaced

Time = tuple[Array, Array]


def turbulence_inputs(turbulence: Turbulence, position_ned: Vec3, time: Time, field: object) -> dict[str, object]:
    """Return the inputs that a turbulence model declares in ``reads``, as keyword arguments of its methods.

    Args:
        turbulence: of the world.
        position_ned: positions of vehicles (n,) [m].
        time: since the start of the run, () int32 whole seconds and the rest.
        field: the part of the episode's gusts that all vehicles share.
    """
    known: dict[str, object] = {"position_ned": position_ned, "seconds": time[0], "fraction": time[1], "field": field}
    return {name: known[name] for name in turbulence.reads}


def gust_at(world: World, field: object, memory: object, height_agl: Array, position_ned: Vec3, time: Time) -> Vec3:
    """Return the gust velocity (n,) [m/s] NED at positions (n,) [m]: turbulence, discrete gust and updrafts.

    ``memory`` is the turbulence's state.
    """
    shared, drawn = _shared_and_own(world, field)
    inputs = turbulence_inputs(world.turbulence, position_ned, time, shared)
    random = _scaled(world, world.turbulence.gust_ned(memory, height_agl, **inputs))
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


def _shared_and_own(world: World, field: Any) -> tuple[object, tuple[object, ...]]:
    """Return the shared turbulence in ``field``, and each updraft's random numbers; () without updrafts."""
    return (field.turbulence, field.updrafts) if world.updrafts else (field, ())


def gust_rates_at(
    world: World, field: object, memory: object, height_agl: Array, position_ned: Vec3, time: Time
) -> Vec3 | None:
    """Return the air's rotation (n,) [rad/s] NED at positions (n,) [m]; None if the turbulence has no rotation."""
    if not world.turbulence.rates:
        return None
    inputs = turbulence_inputs(world.turbulence, position_ned, time, _shared_and_own(world, field)[0])
    return _scaled(world, world.turbulence.gust_rates_ned(memory, height_agl, **inputs))


def weather_at(world: World, tick: Array) -> World:
    """Return the world with wind, gusts and jammers as they are at a tick; unchanged if its weather is constant."""
    changes = world.changes
    if changes is None:
        return world
    for name in ("speed_20ft", "wind_from_rad"):
        course = getattr(changes, name)
        if course is not None:
            world = replace(world, wind=replace(world.wind, **{name: course.at(tick)}))
    if changes.gusts is not None:
        world = replace(world, gust_scale=changes.gusts.at(tick))
    for number, course in enumerate(changes.powers):
        world = replaced(world, ("sky", "interference", "jammers", number, "power_w"), course.at(tick))
    return world


def _scaled(world: World, gusts: Vec3) -> Vec3:
    """Return gust velocities or rotation rates times the world's present gust scale."""
    scale = world.gust_scale
    return gusts if scale is None else gusts.map(lambda axis: axis * scale)


def around_of(
    world: World,
    pose: Pose,
    rates_ned: Vec3 | None,
    wake_rates: Vec3 | None = None,
    faults: tuple[RotorFault, ...] = (),
    tick: Array | None = None,
) -> Around:
    """Return the surroundings that vehicle models (n,) read: ground, the air's rotation and density, rotor faults.

    Args:
        world: with its ground.
        pose: of the vehicles.
        rates_ned: rotation of the air (n,) [rad/s]; None: none.
        wake_rates: rotation (n,) [rad/s] in body axes that wakes add (wakes.py); None: there are no wakes.
        faults: of rotors.
        tick: () int32, where there are faults.
    """
    still = Vec3.zeros(pose.attitude.roll.shape, pose.attitude.roll.dtype)

    def ground(position_ned: Vec3) -> tuple[Array, Vec3]:
        """Return the down coordinate [m] and the unit normal of the ground at positions."""
        return world.ground_down(position_ned), world.ground.normal(position_ned)

    rates = still if rates_ned is None else rotation(pose.attitude).to_body(rates_ned)
    rates = rates if wake_rates is None else rates + wake_rates
    failed, stuck = ((), ()) if tick is None else (failed_rotors(faults, tick), stuck_rotors(faults, tick))
    return Around(ground, rates, failed, world.air.density(pose.position_ned), stuck)
