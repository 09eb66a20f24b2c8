"""A world from tick to tick: its start, and the order of one tick (world/state.py says what it is made of).

Read ``step`` from top to bottom: sky, then for each fleet wind, controller and dynamics, then all new
positions together, then the sensors that are due. Nothing here compiles; simulation.py does.
"""

from __future__ import annotations

import functools
import math
from typing import Any, cast

import jax
import jax.numpy as jnp
from jax import Array

from qrsim.control import Estimate
from qrsim.core.clock import split_time
from qrsim.core.noise import Drawn, Key, Noise, StreamKeys
from qrsim.core.tree import Record, concatenated, map_tree, replace, select
from qrsim.core.vectors import Vec3, rotation
from qrsim.models.atmosphere.wind import mean_wind_at
from qrsim.models.gnss.receivers import SkyState
from qrsim.models.scene.area import Violation, collisions, reason_code
from qrsim.models.scene.contents import Surroundings
from qrsim.models.scene.sweeping import obstacle_hit
from qrsim.models.vehicles.contracts import Charged, VehicleState
from qrsim.models.vehicles.faults import failed_rotors
from qrsim.models.vehicles.moving import move
from qrsim.world.air import around_of, gust_at, gust_rates_at
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
from qrsim.world.radio import exchange, parted, start_radio
from qrsim.world.sensing import (
    airspeed_of,
    at_rest,
    faulted,
    first_belief,
    inputs_of,
    scene_of,
    sense,
    starting_fitted,
    with_traffic,
)
from qrsim.world.standing import ground_checks, lying_force, over_the_floor, settled, started
from qrsim.world.state import (
    PROCESS,
    TURBULENCE,
    Action,
    Fleet,
    FleetState,
    Start,
    State,
    World,
    WorldKeys,
    period_ticks,
    when_due,
)
from qrsim.world.wakes import Wakes, wakes_of, wakes_on


def reset(world: World, key: Key | WorldKeys) -> State:
    """Return the state at tick 0: noise processes stationary, every sensor with a first reading.

    Args:
        world: its parameters.
        key: of all randomness, or what ``keys_of`` made of it.
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
        _launched(world, fleet, _vehicle_at(fleet, start))
        for fleet, (start, _) in zip(world.fleets, placed, strict=True)
    ]
    view = with_traffic(world, surroundings(world, contents, jnp.int32(0)), vehicles, [None] * len(vehicles))
    field = draw_field(world, draws)
    fleets = tuple(
        start_fleet(world, fleet, vehicle, first, jnp.int32(0), sky, view, field)
        for fleet, vehicle, first in zip(world.fleets, vehicles, keys.fleets_start, strict=True)
    )
    found = tuple(found for _, found in placed if found is not None)
    return State(
        sky, fleets, keys.sky, keys.fleets, contents, keys.plume, drawn, found, field,
        start_radio(world, draws, keys, fleets),
    )  # fmt: skip


def step(
    world: World,
    state: State,
    tick: Array,
    actions: tuple[Action, ...],
    estimates: tuple[Estimate | None, ...] | None = None,
    before: Array | None = None,
) -> State:
    """Advance a world from tick to tick + 1.

    Args:
        world, state: of one world; vmap over worlds from outside.
        tick: () int32, the tick the step starts from; unbatched under vmap, so slow sensors are really skipped.
        actions: for each fleet a Command (flown as it is, clipped to its range), a set-point (handed to the
            controller, which must take its kind) or None (the fleet's guidance hands out the set-point); ``Saying`` has
            one of these and what the vehicles have to say; ``Piloted`` is flown while the controller goes on.
        estimates: for each fleet what its controller is fed with; None: what ``controller.feed`` says.
        before: () int32 ticks that the world had flown before ``tick`` began to count, a multiple of every period;
            it may differ from world to world of a batch, where ``tick`` may not. None: none.
    """
    world = world.with_drawn(state.drawn)
    due = after = tick + 1
    if before is not None:
        tick, after = tick + before, after + before
    actions, said = parted(actions)
    state = replace(state, radio=exchange(world, state, said, tick, due - 1))
    sky = _step_sky(world, state, due, after)
    noise = [draw_fleet(world, fleet, keys, after) for fleet, keys in zip(world.fleets, state.fleet_keys, strict=True)]
    wakes = wakes_of(world, state.fleets)
    flown = tuple(
        _fly(world, state, wakes, fleet, fleet_state, tick, drawn, action, estimate)
        for fleet, fleet_state, drawn, action, estimate in zip(
            world.fleets, state.fleets, noise, actions, estimates or (None,) * len(actions), strict=True
        )
    )
    checked = _check(world, state.fleets, flown)
    contents = step_contents(world, state, checked, due, after)
    view = with_traffic(
        world, surroundings(world, contents, after), [fleet.vehicle for fleet in checked],
        [fleet.violation.code == 0 for fleet in checked],
    )  # fmt: skip
    sensed = tuple(
        sense(world, fleet, fleet_state, sky, view, drawn, due, after)
        for fleet, fleet_state, drawn in zip(world.fleets, checked, noise, strict=True)
    )
    return replace(state, sky=sky, fleets=sensed, contents=contents)


def _step_sky(world: World, state: State, due: Array, after: Array) -> SkyState:
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
    """Wind, set-point, command and dynamics of one fleet; invalid vehicles are put back by ``_check``."""
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
    voltage = fleet.battery.voltage(state.battery, load)
    commands = [
        (which, *model.clip(model.powered(wanted, voltage), voltage is not None)) for which, wanted in flown.commands
    ]
    battery = fleet.battery.step(state.battery, load, dt)
    drawn = model.draw_noise(noise[PROCESS], dt)
    around = None
    if model.reads:
        failed = failed_rotors(fleet.rotor_faults, tick)
        around = around_of(world, pose, gust_rates, None if blown is None else blown[1], failed)

    def moved(command: object, clipped: Array) -> tuple[Any, ...]:
        vehicle, low, force = move(
            model, state.vehicle, state.position_low_ned, command, lambda trig: trig.rotation().to_body(air), drawn, dt,
            around,
        )  # fmt: skip
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
        state, vehicle=vehicle, position_low_ned=low, specific_force=force, parked=parked,
        turbulence=turbulence, mean_wind_ned=mean_wind, gust_ned=gust,
        gust_rates_ned=gust_rates,
        estimate=flown.estimate, guidance=flown.guidance, setpoint=flown.setpoint, controller=flown.controller,
        command=command, command_clipped=clipped, battery=battery, turns=_turned(fleet, state, vehicle),
    )  # fmt: skip


def _turned(fleet: Fleet, before: FleetState, after: VehicleState) -> Array | None:
    """Return the whole turns (n,) of the yaw since the start; None where its limit counts none."""
    if before.turns is None:
        return None
    old, new = (fleet.vehicle.pose(each).attitude.yaw for each in (before.vehicle, after))
    return before.turns + jnp.round((old - new) * (0.5 / math.pi))


def _check(world: World, before: tuple[FleetState, ...], flown: tuple[FleetState, ...]) -> tuple[FleetState, ...]:
    """Look at all new positions together; a vehicle that breaks a limit stays where it was, at rest."""
    positions = []
    for old, new in zip(before, flown, strict=True):
        moving = old.violation.code == 0
        positions.append(select(moving, new.vehicle.position_ned, old.vehicle.position_ned))
    came_from = concatenated([old.vehicle.position_ned for old in before])
    collided = collisions(concatenated(positions), world.collision_distance, world.radii, came_from)
    checked, first = [], 0
    for fleet, old, new in zip(world.fleets, before, flown, strict=True):
        own = Violation.first(own_checks(world, fleet, new, old.vehicle.position_ned), new.vehicle.position_ned.x)
        in_collision = map_tree(lambda leaf: leaf[first : first + fleet.size], collided)  # noqa: B023
        first += fleet.size
        violation = old.violation.or_else(own.or_else(in_collision))
        stopped = fleet.vehicle.stopped(old.vehicle)
        valid = violation.code == 0
        # The vehicle itself is put back, and its estimate stays: what else a stopped vehicle computes goes nowhere.
        kept = select(valid, new.vehicle, stopped)
        low = select(valid, new.position_low_ned, old.position_low_ned)
        checked.append(
            replace(
                new, vehicle=kept, position_low_ned=low, violation=violation,
                estimate=select(valid, new.estimate, at_rest(old.estimate)),
                command_clipped=new.command_clipped & valid,
            )
        )  # fmt: skip
    return tuple(checked)


def own_checks(
    world: World, fleet: Fleet, state: FleetState, before_ned: Vec3 | None = None
) -> list[tuple[int, Array, Array]]:
    """Check each vehicle (n,) of a fleet alone, without the others; (code, value, broken).

    Args:
        world, fleet, state: of the fleet.
        before_ned: positions (n,) [m] from which it came in a straight line; None: it was put where it is.
    """
    pose = fleet.vehicle.pose(state.vehicle)
    over = over_the_floor(world, fleet, pose.position_ned)
    # One after the other: side by side in one array they would be written to memory first.
    finite = functools.reduce(jnp.logical_and, map(jnp.isfinite, jax.tree.leaves(state.vehicle)))
    return [
        # Who has hit the ground hard enough to overflow has crashed.
        *fleet.vehicle.own_checks(state.vehicle),
        (reason_code("not_finite", "state"), jnp.zeros_like(pose.position_ned.x), ~finite),
        *ground_checks(world, fleet, state),
        *(world.area.check(over) if before_ned is None else world.area.swept(before_ned, over)),
        _hits_obstacle(world, fleet, pose.position_ned if before_ned is None else before_ned, pose.position_ned),
        *_empty_battery(fleet, state),
        *fleet.battery.own_checks(state.battery),
        *fleet.limits.check(pose.attitude, pose.velocity_body, pose.rates_body, state.turns),
    ]


def _empty_battery(fleet: Fleet, state: FleetState) -> list[tuple[int, Array, Array]]:
    """Return the check (code, charge, empty) of vehicles (n,) with a battery that can run out."""
    if not fleet.battery.drains:
        return []
    charge = cast(Charged, state.battery).charge
    return [(reason_code("battery_empty", "charge"), charge, charge <= 0.0)]


def _hits_obstacle(world: World, fleet: Fleet, start_ned: Vec3, end_ned: Vec3) -> tuple[int, Array, Array]:
    """Return the check (code, number of the obstacle, hit) of ways (n,)."""
    number, hit = obstacle_hit(world.obstacles, start_ned, end_ned, world.radius_of(fleet))
    return reason_code("collision", "obstacle"), number, hit


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
    """Return a fleet at its start: noise processes stationary, every sensor with a first reading.

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
    )
    scene = scene_of(fleet, state, sky, view)
    firsts = []
    for i, (name, sensor) in enumerate(zip(fleet.sensor_names, fleet.sensors, strict=True)):
        inputs = inputs_of(sensor, fleet.fitting(i), scene, None, world.time_step)
        if before is not None:
            since = (tick % period_ticks(sensor.period, world.time_step)).astype(like.dtype) * world.time_step
            firsts.append(sensor.restart(before.sensors[i], draws[name], since, **inputs))
        else:
            firsts.append(sensor.init(draws[name], **inputs))
    faulty = {fault.sensor for fault in fleet.faults}
    readings = dict(zip(fleet.sensor_names, (reading for _, reading in firsts), strict=True))
    passed_on: tuple[Record | None, ...] = (None,) * len(fleet.faults)
    delivered = []
    for name, reading in readings.items():
        first, passed_on = faulted(fleet, name, reading, passed_on, tick)
        delivered.append(first)
    known = dict(zip(fleet.sensor_names, delivered, strict=True))
    return replace(
        state,
        belief=first_belief(fleet, state, firsts, draws, known, replace(estimate, airspeed=None)),
        fitted=starting_fitted(fleet, scene, tuple(reading for _, reading in firsts), tick),
        sensors=tuple(memory for memory, _ in firsts),
        readings=tuple(delivered),
        true_readings=tuple(reading if name in faulty else None for name, reading in readings.items()),
        passed_on=passed_on,
    )


def _vehicle_at(fleet: Fleet, start: Start) -> VehicleState:
    state = fleet.vehicle.initial_state(start.position_ned, start.attitude, start.velocity_body, start.rates_body)
    return fleet.vehicle.with_wrapped_yaw(state)


def _launched(world: World, fleet: Fleet, vehicle: VehicleState) -> VehicleState:
    """Return vehicles (n,) at their start; who starts in flight does so in the mean wind there."""
    if not fleet.vehicle.launches:
        return vehicle
    place = fleet.vehicle.pose(vehicle).position_ned
    height = world.height_agl(place)
    time = split_time(jnp.int32(0), world.time_step, height.dtype)
    return fleet.vehicle.launched(vehicle, mean_wind_at(world.wind, height, place, time))
