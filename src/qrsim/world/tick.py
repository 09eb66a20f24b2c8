"""A world from tick to tick: its start, and the order of one tick (world/state.py says what it is made of).

Read ``step`` from top to bottom: sky, then for each fleet wind, controller and dynamics, then all new
positions together, then the sensors that are due. Nothing here compiles; simulation.py does.
"""

from __future__ import annotations

import math
from typing import Any

import jax.numpy as jnp
from jax import Array

from qrsim.control import Estimate
from qrsim.core.clock import split_time
from qrsim.core.noise import Key, Noise
from qrsim.core.tree import replace, select
from qrsim.core.vectors import rotation
from qrsim.models.atmosphere.wind import mean_wind_at
from qrsim.models.gnss.receivers import SkyState
from qrsim.models.vehicles.contracts import VehicleState
from qrsim.models.vehicles.moving import move
from qrsim.world.air import around_of, gust_at, gust_rates_at, weather_at
from qrsim.world.checking import check
from qrsim.world.commanding import by_kind, command_fleet
from qrsim.world.draws import draw_fleet, draw_sky, keys_of
from qrsim.world.episode import (
    draw_field,
    draw_ranges,
    episode_draws,
    place,
    start_contents,
    step_contents,
    surroundings,
)
from qrsim.world.pushing import Moved, pushed
from qrsim.world.radio import exchange, split_messages, start_radio
from qrsim.world.sensing import sense, with_traffic
from qrsim.world.standing import lying_force, settled
from qrsim.world.starting import launched, start_fleet, vehicle_at
from qrsim.world.state import (
    PROCESS,
    TURBULENCE,
    Action,
    Fleet,
    FleetState,
    State,
    World,
    WorldKeys,
    period_ticks,
    when_due,
)
from qrsim.world.wakes import Wakes, wakes_of, wakes_on


def reset(world: World, key: Key | WorldKeys) -> State:
    """Return a world's state at tick 0: random processes in steady state, a first reading of every sensor.

    Args:
        world: its parameters.
        key: of all randomness, or the keys that ``keys_of`` derived from it.
    """
    keys = keys_of(world, key) if isinstance(key, Key) else key
    like = jnp.zeros((), world.fleets[0].start.position_ned.x.dtype)
    draws = episode_draws(world, keys, like)
    drawn = draw_ranges(world, draws)
    world = world.with_drawn(drawn)
    sky = world.sky.init(draw_sky(world, keys.sky_start, jnp.int32(0), like))
    contents = start_contents(world, draws)
    placed = [place(world, fleet, draws) for fleet in world.fleets]
    vehicles = [
        launched(world, fleet, vehicle_at(fleet, start)) for fleet, (start, _) in zip(world.fleets, placed, strict=True)
    ]
    view = with_traffic(world, surroundings(world, contents, jnp.int32(0)), vehicles, [None] * len(vehicles))
    field = draw_field(world, draws)
    fleets = tuple(
        start_fleet(world, fleet, vehicle, first, jnp.int32(0), sky, view, field)
        for fleet, vehicle, first in zip(world.fleets, vehicles, keys.fleets_start, strict=True)
    )
    found = tuple(found for _, found in placed if found is not None)
    return State(
        sky,
        fleets,
        keys.sky,
        keys.fleets,
        contents,
        keys.plume,
        drawn,
        found,
        field,
        start_radio(world, draws, keys, fleets),
    )


def step(
    world: World,
    state: State,
    tick: Array,
    actions: tuple[Action, ...],
    estimates: tuple[Estimate | None, ...] | None = None,
    before: Array | None = None,
) -> State:
    """Return a world's state at tick + 1 from its state at tick, with an action for each fleet.

    Args:
        world, state: of one world; vmap over worlds from outside.
        tick: () int32, the tick the step starts from; unbatched under vmap, so slow sensors are really skipped.
        actions: for each fleet a Command (flown directly, clipped to its range), a set-point (passed to the controller,
            which must take its kind) or None (the fleet's guidance returns the set-point); ``Saying`` has one of these
            and messages to send; ``Piloted`` is flown while the controller continues to run.
        estimates: for each fleet the input of its controller; None: by ``controller.feed``.
        before: () int32 ticks that the world had flown before ``tick`` began to count, a multiple of every period;
            it may differ from world to world of a batch, where ``tick`` may not. None: none.
    """
    world = world.with_drawn(state.drawn)
    due = after = tick + 1
    if before is not None:
        tick, after = tick + before, after + before
    world = weather_at(world, tick)
    actions, messages = split_messages(actions)
    state = replace(state, radio=exchange(world, state, messages, tick, due - 1))
    sky = _step_sky(world, state, due, after)
    noise = [draw_fleet(world, fleet, keys, after) for fleet, keys in zip(world.fleets, state.fleet_keys, strict=True)]
    wakes = wakes_of(world, state.fleets)
    flown = tuple(
        _fly(world, state, wakes, fleet, fleet_state, tick, drawn, action, estimate)
        for fleet, fleet_state, drawn, action, estimate in zip(
            world.fleets, state.fleets, noise, actions, estimates or (None,) * len(actions), strict=True
        )
    )
    checked = check(world, state.fleets, flown)
    contents = step_contents(world, state, checked, due, after)
    view = with_traffic(
        world,
        surroundings(world, contents, after),
        [fleet.vehicle for fleet in checked],
        [fleet.violation.code == 0 for fleet in checked],
    )
    sensed = tuple(
        sense(world, fleet, fleet_state, sky, view, drawn, due, after)
        for fleet, fleet_state, drawn in zip(world.fleets, checked, noise, strict=True)
    )
    return replace(state, sky=sky, fleets=sensed, contents=contents)


def _step_sky(world: World, state: State, due: Array, after: Array) -> SkyState:
    """Return the GNSS satellites' state after a tick, stepped only when due."""
    draw = draw_sky(world, state.sky_keys, after, state.sky.range_error[0])
    seconds, fraction = split_time(after, world.time_step, draw.like.dtype)
    ticks = period_ticks(world.sky.period, world.time_step)
    if after is due and world.sky.steps_by_parts:
        return world.sky.step_by_parts(state.sky, draw, due)
    return when_due(ticks, due, lambda: world.sky.step(state.sky, draw, seconds, fraction), state.sky)


def _fly(
    world: World,
    whole: State,
    wakes: Wakes,
    fleet: Fleet,
    state: FleetState,
    tick: Array,
    noise: dict[str, Noise],
    action: Action,
    believed: Estimate | None,
) -> FleetState:
    """Return a fleet's state after one tick of flight: wind, set-point, command, dynamics; limits are not checked."""
    dt, model = world.time_step, fleet.vehicle
    pose = model.pose(state.vehicle)
    direction = rotation(pose.attitude)
    height = world.height_agl(pose.position_ned)
    time = split_time(tick, dt, height.dtype)
    mean_wind = mean_wind_at(world.wind, height, pose.position_ned, time)
    turbulence = world.turbulence.step(
        state.turbulence, noise[TURBULENCE], height, direction.to_ned(pose.velocity_body), mean_wind, dt
    )
    at = (height, pose.position_ned, time)
    gust = gust_at(world, whole.field, turbulence, *at)
    gust_rates = gust_rates_at(world, whole.field, turbulence, *at)
    air = mean_wind + gust
    blown = wakes_on(world, wakes, fleet, pose, direction)
    if blown is not None:
        air = air + blown[0]

    flown = command_fleet(world, whole, fleet, state, tick, action, believed)
    load = model.load(state.vehicle)
    voltage = fleet.voltage(state.battery, load, tick)
    commands = [
        (which, *model.clip(model.powered(wanted, voltage), voltage is not None)) for which, wanted in flown.commands
    ]
    battery = fleet.battery.step(state.battery, load, dt)
    for fault in fleet.all_battery_faults:
        battery = fault.apply(state.battery, battery, tick)
    drawn = model.draw_noise(noise[PROCESS], dt)
    around = None
    if model.reads:
        faults = (*fleet.rotor_faults, *fleet.rotor_slots)
        around = around_of(world, pose, gust_rates, None if blown is None else blown[1], faults, tick)

    def moved(command: object, clipped: Array) -> tuple[Any, ...]:
        """Return vehicle state, position remainder, specific force and others after a tick with this command."""

        def step(vehicle: VehicleState) -> Moved:
            """Return the vehicle a step later, the remainder of its position [m] in float32, and the specific force."""
            to_body = lambda trig: trig.rotation().to_body(air)  # noqa: E731
            return move(model, vehicle, state.position_low_ned, command, to_body, drawn, dt, around)

        vehicle, low, force = pushed(fleet, state.vehicle, step, tick, dt)
        vehicle = model.with_wrapped_yaw(vehicle)
        parked = state.parked
        if parked is not None:
            vehicle, low, force, parked = settled(world, fleet, state, command, vehicle, low, force)
        return vehicle, low, force, parked, model.shown(command), clipped

    vehicle, low, force, parked, command, clipped = by_kind(commands, moved)
    # From the tick after the one that stopped it on, a vehicle feels its weight alone.
    force = select(state.violation.code == 0, force, lying_force(direction))
    if flown.shown is not None:
        command = model.shown(flown.shown)
    return replace(
        state,
        vehicle=vehicle,
        position_low_ned=low,
        specific_force=force,
        parked=parked,
        turbulence=turbulence,
        mean_wind_ned=mean_wind,
        gust_ned=gust,
        gust_rates_ned=gust_rates,
        estimate=flown.estimate,
        guidance=flown.guidance,
        setpoint=flown.setpoint,
        controller=flown.controller,
        failsafe=flown.failsafe,
        command=command,
        command_clipped=clipped,
        battery=battery,
        turns=_turned(fleet, state, vehicle),
    )


def _turned(fleet: Fleet, before: FleetState, after: VehicleState) -> Array | None:
    """Return the yaw's whole turns (n,) since the start, for the yaw limit; None if they are not counted."""
    if before.turns is None:
        return None
    old, new = (fleet.vehicle.pose(each).attitude.yaw for each in (before.vehicle, after))
    return before.turns + jnp.round((old - new) * (0.5 / math.pi))
