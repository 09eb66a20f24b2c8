"""The sensors' part of a tick: their inputs, which are due, and the controllers' estimates."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, TypedDict, cast

import jax.numpy as jnp
from jax import Array

from qrsim.control import Estimate
from qrsim.control.contracts import Preflight
from qrsim.core.noise import Draw, Noise
from qrsim.core.tree import Record, concatenated, map_tree, replace, select
from qrsim.core.vectors import Euler, Vec3, root, rotation
from qrsim.models.gnss.receivers import SkyState
from qrsim.models.scene.contents import Surroundings
from qrsim.models.scene.traffic import Traffic
from qrsim.models.sensors.contracts import Sensor
from qrsim.models.sensors.faults import FaultMemory, Late
from qrsim.models.sensors.fitting import Fitted, Fitting, mounted, start_fitted
from qrsim.models.vehicles.contracts import Pose, VehicleState
from qrsim.world.standing import on_ground
from qrsim.world.state import DELIVERY, ESTIMATOR, FAULT, Belief, Fleet, FleetState, World, period_ticks, when_due

# A vehicle on the ground is at rest below this speed [m/s], and this rate [rad/s].
STILL = 0.01


def sense(
    world: World,
    fleet: Fleet,
    state: FleetState,
    sky: SkyState,
    view: Surroundings,
    noise: dict[str, Noise],
    due: Array,
    after: Array,
) -> FleetState:
    """Return a fleet's state with the sensors and estimator stepped that are due; NaN readings for stopped vehicles."""
    scene = scene_of(fleet, state, sky, view)
    valid = state.violation.code == 0
    states, delivered, undisturbed, fitted = [], [], [], []
    passed_on = state.passed_on
    for i, (name, sensor) in enumerate(zip(fleet.sensor_names, fleet.sensors, strict=True)):
        faulty = any(fault.sensor == name for fault in fleet.all_faults)
        held = state.true_readings[i] if faulty else state.readings[i]
        fitting, memory_of_fitting = fleet.fitting(i), _fitted(state, i)
        inputs = inputs_of(sensor, fitting, scene, memory_of_fitting, world.time_step)

        assert held is not None

        def fresh(
            sensor: Sensor = sensor,
            memory: object = state.sensors[i],
            name: str = name,
            inputs: dict[str, object] = inputs,
        ) -> tuple[object, Record]:
            """Return the sensor's state and reading after a step."""
            return sensor.step(memory, noise[name], **inputs)

        ticks, late = period_ticks(sensor.period, world.time_step), None
        if fitting is not None and memory_of_fitting is not None and memory_of_fitting.transit is not None:
            draw = noise.get(f"{name}{DELIVERY}", noise[name])
            sent = partial(_sent, fresh, fitting, memory_of_fitting, draw, sensor.period, world.time_step, after)
            memory, transit = when_due(ticks, due, sent, (state.sensors[i], memory_of_fitting.transit))
            memory_of_fitting = replace(memory_of_fitting, transit=transit)
            reading = transit.delivered(after)
            late = Late(transit.time_of_reading(after), transit.fresh(after))
        else:
            memory, reading = when_due(ticks, due, fresh, (state.sensors[i], held))
        states.append(memory)
        fitted.append(_moved_on(memory_of_fitting, scene))
        undisturbed.append(reading if faulty else None)
        reading, passed_on = faulted(fleet, name, reading, passed_on, after, noise, late=late)
        delivered.append(map_tree(lambda leaf: jnp.where(valid, leaf, jnp.nan), reading))
    return replace(
        state,
        belief=_believed(world, fleet, state.belief, valid, tuple(delivered), tuple(fitted), due, after),
        fitted=tuple(fitted) if state.fitted else (),
        sensors=tuple(states),
        readings=tuple(delivered),
        true_readings=tuple(undisturbed),
        passed_on=passed_on,
    )


def with_traffic(
    world: World, view: Surroundings, vehicles: Sequence[VehicleState], flies: Sequence[Array | None]
) -> Surroundings:
    """Return the surroundings with all vehicles' positions and velocities, if a sensor measures other vehicles.

    Args:
        world: its parameters.
        view: surroundings that sensors can read.
        vehicles: true states of each fleet.
        flies: of each fleet whether each vehicle (n,) is still valid; None: all are.
    """
    if not any(
        "traffic" in sensor.reads and sensor.wants_traffic for fleet in world.fleets for sensor in fleet.sensors
    ):
        return view
    parts = []
    for fleet, state, flying in zip(world.fleets, vehicles, flies, strict=True):
        pose = fleet.vehicle.pose(state)
        velocity = rotation(pose.attitude).to_ned(pose.velocity_body)
        like = pose.position_ned.x
        radius = jnp.broadcast_to(jnp.asarray(world.radius_of(fleet), like.dtype), like.shape)
        parts.append((pose.position_ned, velocity, jnp.ones(like.shape, bool) if flying is None else flying, radius))
    sizes = tuple(fleet.size for fleet in world.fleets)
    traffic = Traffic(*concatenated(parts), tuple(fleet.name for fleet in world.fleets), sizes)
    return replace(view, traffic=traffic)


def inputs_of(
    sensor: Sensor, fitting: Fitting | None, scene: dict[str, object], memory: Fitted | None, time_step: float
) -> dict[str, object]:
    """Return the true inputs of a sensor by name (its ``reads``), at its mounting position and in its axes."""
    if fitting is None or (fitting.position_body is None and fitting.attitude is None):
        return {item: scene[item] for item in sensor.reads}
    before = None if memory is None else memory.rates_body
    return cast(dict[str, object], mounted(fitting, scene, sensor.reads, before, time_step))


def starting_fitted(fleet: Fleet, scene: dict[str, object], readings: tuple[Record, ...], tick: Array) -> object:
    """Return the states of each sensor's mounting and latency (fitting) at the start; () without fittings."""
    if not fleet.fittings:
        return ()
    rates = cast(Vec3, scene["rates_body"])
    return tuple(
        None if fitting is None else start_fitted(fitting, sensor.reads, reading, sensor.period, tick, rates)
        for fitting, sensor, reading in zip(fleet.fittings, fleet.sensors, readings, strict=True)
    )


def _fitted(state: FleetState, number: int) -> Fitted | None:
    """Return the state of sensor ``number``'s mounting and latency (fitting), None if it has none."""
    return state.fitted[number] if state.fitted else None


def _moved_on(memory: Fitted | None, scene: dict[str, object]) -> Fitted | None:
    """Return a fitting's state with the present body rates stored, if the next tick needs them."""
    if memory is None or memory.rates_body is None:
        return memory
    return replace(memory, rates_body=cast(Vec3, scene["rates_body"]))


def _sent(
    step: Callable[[], tuple[object, Record]],
    fitting: Fitting,
    memory: Fitted,
    draw: object,
    period: float,
    dt: float,
    tick: Array,
) -> tuple[object, Any]:
    """Return a sensor's state after a step, and its delayed readings (in transit) with the new one added."""
    after, reading = step()
    assert memory.transit is not None
    late = fitting.ticks(period, dt, draw, memory.transit.due[0].shape)
    return after, memory.transit.sent(reading, tick, late)


def _believed(
    world: World,
    fleet: Fleet,
    belief: Belief | None,
    valid: Array,
    readings: tuple[Record, ...],
    fitted: tuple[Fitted | None, ...],
    due: Array,
    after: Array,
) -> Belief | None:
    """Return the fleet's estimator state and estimate after a step with these readings; None without an estimator.

    Vehicles that are not ``valid`` (n,) keep their last estimate, with zero velocity: without new readings, a filter
    would go on predicting their flight.
    """
    estimator = fleet.own_estimator
    if estimator is None or belief is None:
        return None
    named = dict(zip(fleet.sensor_names, readings, strict=True))
    dt = world.time_step
    fresh = {
        name: sensor.fresh(due, dt) if memory is None or memory.transit is None else memory.transit.fresh(after)
        for name, sensor, memory in zip(fleet.sensor_names, fleet.sensors, fitted, strict=True)
    }
    new = Belief.of(estimator, *estimator.step(belief.memory, named, fresh, dt))
    resting = at_rest(belief.estimate)
    return replace(new, estimate=select(valid, new.estimate, resting), std=select(valid, new.std, belief.std))


def first_belief(
    fleet: Fleet,
    state: FleetState,
    firsts: Sequence[tuple[object, Record]],
    draws: dict[str, Noise],
    readings: dict[str, Record],
    start: Estimate,
) -> Belief | None:
    """Return the state and estimate of the fleet's own estimator at the start; None without an estimator.

    Args:
        fleet, state: parameters and state of the fleet.
        firsts: state and first reading of each sensor.
        draws: random streams of the start, by name.
        readings: the first readings, by the name of the sensor.
        start: estimate of the fleet at the start, which filters begin with.
    """
    estimator = fleet.own_estimator
    if estimator is None:
        return None
    count = fleet.first_normals
    if not count:
        return Belief.of(estimator, *estimator.init(readings, start))
    standing = on_ground(fleet, state)
    bias: Any = None
    if standing is not None:
        rates = fleet.vehicle.pose(state.vehicle).rates_body
        standing = standing & (start.velocity_ned.norm() < STILL) & (rates.norm() < STILL)
    for sensor, (memory, reading) in zip(fleet.sensors, firsts, strict=True):
        if "rates_body" in reading.__dataclass_fields__:
            bias = sensor.biases(memory).get("rates_body")
            break
    if bias is not None and not isinstance(bias, Vec3):
        bias = Vec3(*(jnp.zeros_like(axis) + bias for axis in start.velocity_ned.axes))
    preflight = Preflight(tuple(draws[ESTIMATOR].normals(count)), standing, bias)
    return Belief.of(estimator, *estimator.begin(readings, start, preflight))


def at_rest(estimate: Estimate) -> Estimate:
    """Return an estimate with its velocity set to zero."""
    return replace(estimate, velocity_ned=estimate.velocity_ned.map(jnp.zeros_like))


def faulted(
    fleet: Fleet,
    name: str,
    reading: Record,
    passed_on: tuple[FaultMemory | None, ...],
    tick: Array,
    noise: dict[str, Noise],
    first: bool = False,
    late: Late | None = None,
) -> tuple[Record, tuple[FaultMemory | None, ...]]:
    """Return a sensor's reading with all of its faults applied in order, and the faults' new memories.

    Args:
        fleet, name: fleet and name of the sensor.
        reading: of the sensor, without faults.
        passed_on: states of the faults.
        tick: () int32 at which the reading is delivered or held.
        noise: random streams of the fleet, by name.
        first: whether it is the first reading, at which the states begin.
        late: of a sensor with a delay; None: it delivers at once.
    """
    memories = list(passed_on)
    for i, fault in enumerate(fleet.all_faults):
        if fault.sensor == name:
            memory = fault.begin(reading) if first else memories[i]
            draw = cast(Draw, noise[f"{name}{FAULT}"]) if fault.random else None
            reading, memories[i] = fault.apply(reading, memory, tick, draw, late)
    return reading, tuple(memories)


def scene_of(fleet: Fleet, state: FleetState, sky: SkyState, view: Surroundings | None = None) -> dict[str, object]:
    """Return all true quantities by name, those that a sensor may declare in ``reads``."""
    vehicle = fleet.vehicle.pose(state.vehicle)
    loads = any("load" in sensor.reads for sensor in fleet.sensors)
    return {
        "position_ned": vehicle.position_ned,
        "position_low_ned": state.position_low_ned,
        "velocity_ned": rotation(vehicle.attitude).to_ned(vehicle.velocity_body),
        "attitude": vehicle.attitude,
        "velocity_body": vehicle.velocity_body,
        "rates_body": vehicle.rates_body,
        "specific_force": state.specific_force,
        "wind_ned": state.mean_wind_ned + state.gust_ned,
        "load": fleet.vehicle.load(state.vehicle) if loads else None,
        "sky": sky,
        "surroundings": view,
        "ground": None if view is None else view.ground,
        "skyline": None if view is None else view.skyline,
        "obstacles": None if view is None else view.obstacles,
        "traffic": None if view is None or view.traffic is None else view.traffic.seen_by(fleet.name),
    }


def with_airspeed(fleet: Fleet, state: FleetState, estimate: Estimate) -> Estimate:
    """Return the estimate with an airspeed if the fleet's controller uses one, else without.

    An airspeed in the estimate is kept; else it is the measured one, or the true one without a sensor.
    """
    if not fleet.controller.reads_airspeed:
        return estimate if estimate.airspeed is None else replace(estimate, airspeed=None)
    if estimate.airspeed is not None:
        return estimate
    if fleet.controller.feed != "truth":
        measured = measured_quantities(state.readings).get("true_airspeed")
        if measured is not None:
            return replace(estimate, airspeed=measured)
    pose = fleet.vehicle.pose(state.vehicle)
    return replace(estimate, airspeed=airspeed_of(pose, state.mean_wind_ned + state.gust_ned))


def airspeed_of(pose: Pose, air_ned: Vec3) -> Array:
    """Return the airspeed (n,) [m/s] of vehicles with a pose, in air that moves at ``air_ned`` (n,) [m/s]."""
    through = pose.velocity_body - rotation(pose.attitude).to_body(air_ned)
    return root(through.dot(through))


def estimate_of(fleet: Fleet, state: FleetState) -> Estimate:
    """Return the controller's input: its estimator's estimate, the truth, or GNSS, barometer and attitude readings."""
    if state.belief is not None and fleet.controller.feed != "truth":
        return state.belief.estimate
    truth = fleet.vehicle.pose(state.vehicle)
    if fleet.controller.feed == "truth":
        velocity = rotation(truth.attitude).to_ned(truth.velocity_body)
        return Estimate(truth.position_ned, velocity, truth.attitude, state.position_low_ned)
    measured = measured_quantities(state.readings)
    position, velocity = measured["position_ned"], measured["velocity_ned"]
    return Estimate(
        Vec3(position.x, position.y, -measured["height"]),
        Vec3(velocity.x, velocity.y, -measured["height_rate"]),
        measured["attitude"],
    )


class Measured(TypedDict, total=False):
    """The fields of readings that an estimate is made of; each (n,)."""

    position_ned: Vec3
    velocity_ned: Vec3
    height: Array
    height_rate: Array
    attitude: Euler
    rates_body: Vec3
    true_airspeed: Array


def measured_quantities(readings: tuple[Record, ...]) -> Measured:
    """Return the fields of all readings by name; for a field in several readings, the first sensor's.

    Fields of other names than those of ``Measured`` are there too.
    """
    merged: dict[str, object] = {}
    for reading in readings:
        for name in reading.__dataclass_fields__:
            merged.setdefault(name, getattr(reading, name))
    return cast(Measured, merged)
