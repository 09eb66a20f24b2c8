"""Fleets at their start: vehicles, air and the first readings of all sensors."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from qrsim.control import Estimate
from qrsim.core.clock import split_time
from qrsim.core.noise import Drawn, Noise, StreamKeys
from qrsim.core.tree import replace, select
from qrsim.core.vectors import Vec3, rotation
from qrsim.models.atmosphere.wind import mean_wind_at
from qrsim.models.gnss.receivers import SkyState
from qrsim.models.scene.area import Violation
from qrsim.models.scene.contents import Surroundings
from qrsim.models.sensors.faults import FaultMemory
from qrsim.models.vehicles.contracts import VehicleState
from qrsim.world.air import around_of, gust_at, gust_rates_at
from qrsim.world.draws import draw_fleet
from qrsim.world.failing import first_failsafe
from qrsim.world.sensing import airspeed_of, faulted, first_belief, inputs_of, scene_of, starting_fitted
from qrsim.world.standing import lying_force, started
from qrsim.world.state import TURBULENCE, Fleet, FleetState, Start, World, period_ticks


def start_fleet(
    world: World,
    fleet: Fleet,
    vehicle: VehicleState,
    keys: StreamKeys,
    tick: Array,
    sky: SkyState,
    view: Surroundings,
    field: object = None,
    before: FleetState | None = None,
    low: Vec3 | None = None,
) -> FleetState:
    """Return a fleet's state at its start: vehicles, air, controllers, stationary noise and first sensor readings.

    Args:
        world, fleet: parameters.
        vehicle: true states (n,).
        keys: of what is drawn.
        tick: () int32, now.
        sky, view: what sensors may look at.
        field: what the gusts of the episode share.
        before: where the fleet has flown before, of which sensors may keep what is theirs, as the number of a picture.
        low: what single precision leaves out of the positions (n,), if anything.
    """
    like = vehicle.position_ned.x
    if like.dtype == jnp.float32:
        low = low or Vec3.zeros(like.shape, like.dtype)
    vehicle, low, parked = started(world, fleet, vehicle, low)
    pose = fleet.vehicle.pose(vehicle)
    draws = draw_fleet(world, fleet, keys, tick, first=True)
    height = world.height_agl(pose.position_ned)
    time = split_time(tick, world.time_step, height.dtype)
    mean_wind = mean_wind_at(world.wind, height, pose.position_ned, time)
    turbulence = world.turbulence.init(draws[TURBULENCE])
    at = (height, pose.position_ned, time)
    gust, rates = gust_at(world, field, turbulence, *at), gust_rates_at(world, field, turbulence, *at)
    zero = jnp.zeros_like(like)
    command = fleet.controller.idle_command(fleet.vehicle.idle_command(like))
    noiseless = fleet.vehicle.draw_noise(Drawn((zero,) * fleet.vehicle.normals), 1.0)
    air = mean_wind + gust
    more = (around_of(world, pose, rates),) if fleet.vehicle.reads else ()
    force = fleet.vehicle.specific_force(
        vehicle, command, lambda trig: trig.rotation().to_body(air), noiseless, world.time_step, *more
    )
    if parked is not None:
        force = select(parked, lying_force(rotation(pose.attitude)), force)
    violation = Violation(jnp.zeros(like.shape, jnp.int32), zero)
    guidance = fleet.guidance.init(fleet.route)
    # Until a sensor speaks, the controller believes what was true at the start.
    estimate = Estimate(pose.position_ned, rotation(pose.attitude).to_ned(pose.velocity_body), pose.attitude)
    if fleet.controller.reads_airspeed:
        estimate = replace(estimate, airspeed=airspeed_of(pose, air))
    controller = fleet.controller.init(estimate)
    setpoint = fleet.controller.shown(fleet.guidance.setpoint(guidance, fleet.route))
    state = FleetState(
        vehicle=vehicle,
        specific_force=force,
        turbulence=turbulence,
        mean_wind_ned=mean_wind,
        gust_ned=gust,
        gust_rates_ned=rates,
        estimate=estimate,
        controller=controller,
        guidance=guidance,
        setpoint=setpoint,
        command=command,
        command_clipped=jnp.zeros(like.shape, bool),
        violation=violation,
        sensors=(),
        battery=fleet.battery.init(like),
        readings=(),
        true_readings=(),
        passed_on=(),
        position_low_ned=low if like.dtype == jnp.float32 else None,
        parked=parked,
        turns=None if fleet.limits.yaw is None else zero,
        failsafe=first_failsafe(world, fleet, pose),
    )
    scene = scene_of(fleet, state, sky, view)
    return _sensed(world, fleet, state, scene, draws, tick, before)


def _sensed(
    world: World,
    fleet: Fleet,
    state: FleetState,
    scene: dict[str, object],
    draws: dict[str, Noise],
    tick: Array,
    before: FleetState | None,
) -> FleetState:
    """Return a fleet's start state with first sensor readings, faults applied, and its estimator's first estimate."""
    like, firsts = state.vehicle.position_ned.x, []
    for i, (name, sensor) in enumerate(zip(fleet.sensor_names, fleet.sensors, strict=True)):
        inputs = inputs_of(sensor, fleet.fitting(i), scene, None, world.time_step)
        if before is not None:
            since = (tick % period_ticks(sensor.period, world.time_step)).astype(like.dtype) * world.time_step
            firsts.append(sensor.restart(before.sensors[i], draws[name], since, **inputs))
        else:
            firsts.append(sensor.init(draws[name], **inputs))
    faulty = {fault.sensor for fault in fleet.all_faults}
    readings = dict(zip(fleet.sensor_names, (reading for _, reading in firsts), strict=True))
    passed_on: tuple[FaultMemory | None, ...] = (None,) * len(fleet.all_faults)
    delivered = []
    for name, reading in readings.items():
        first, passed_on = faulted(fleet, name, reading, passed_on, tick, draws, first=True)
        delivered.append(first)
    known = dict(zip(fleet.sensor_names, delivered, strict=True))
    return replace(
        state,
        belief=first_belief(fleet, state, firsts, draws, known, replace(state.estimate, airspeed=None)),
        fitted=starting_fitted(fleet, scene, tuple(reading for _, reading in firsts), tick),
        sensors=tuple(memory for memory, _ in firsts),
        readings=tuple(delivered),
        true_readings=tuple(reading if name in faulty else None for name, reading in readings.items()),
        passed_on=passed_on,
    )


def vehicle_at(fleet: Fleet, start: Start) -> VehicleState:
    """Return the vehicle states (n,) at the start positions, yaw wrapped to [-pi, pi]."""
    state = fleet.vehicle.initial_state(start.position_ned, start.attitude, start.velocity_body, start.rates_body)
    return fleet.vehicle.with_wrapped_yaw(state)


def launched(world: World, fleet: Fleet, vehicle: VehicleState) -> VehicleState:
    """Return vehicles (n,) at the start; for those that start in flight, the mean wind changes their velocity."""
    if not fleet.vehicle.launches:
        return vehicle
    position_ned = fleet.vehicle.pose(vehicle).position_ned
    height = world.height_agl(position_ned)
    time = split_time(jnp.int32(0), world.time_step, height.dtype)
    return fleet.vehicle.launched(vehicle, mean_wind_at(world.wind, height, position_ned, time))
