"""The sensors' part of a tick: their inputs, which are due, and the controllers' estimates."""

from __future__ import annotations

from typing import TypedDict, cast

import jax.numpy as jnp
from jax import Array

from qrsim.control import Estimate
from qrsim.core.noise import Noise
from qrsim.core.tree import Record, map_tree, replace
from qrsim.core.vectors import Euler, Vec3, rotation
from qrsim.models.gnss.receivers import SkyState
from qrsim.models.scene.contents import Surroundings
from qrsim.models.sensors.contracts import Sensor
from qrsim.world.state import Belief, Fleet, FleetState, World, period_ticks, when_due


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
    """Step the sensors that are due; the readings of invalid vehicles are NaN."""
    scene = scene_of(fleet, state, sky, view)
    valid = state.violation.code == 0
    states, delivered, undisturbed = [], [], []
    passed_on = state.passed_on
    for i, (name, sensor) in enumerate(zip(fleet.sensor_names, fleet.sensors, strict=True)):
        faulty = any(fault.sensor == name for fault in fleet.faults)
        held = state.true_readings[i] if faulty else state.readings[i]
        inputs = {item: scene[item] for item in sensor.reads}

        assert held is not None

        def fresh(
            sensor: Sensor = sensor,
            memory: object = state.sensors[i],
            name: str = name,
            inputs: dict[str, object] = inputs,
        ) -> tuple[object, Record]:
            return sensor.step(memory, noise[name], **inputs)

        ticks = period_ticks(sensor.period, world.time_step)
        memory, reading = when_due(ticks, due, fresh, (state.sensors[i], held))
        states.append(memory)
        undisturbed.append(reading if faulty else None)
        reading, passed_on = faulted(fleet, name, reading, passed_on, after)
        delivered.append(map_tree(lambda leaf: jnp.where(valid, leaf, jnp.nan), reading))
    return replace(
        state,
        belief=_believed(world, fleet, state.belief, tuple(delivered), due),
        sensors=tuple(states),
        readings=tuple(delivered),
        true_readings=tuple(undisturbed),
        passed_on=passed_on,
    )


def _believed(
    world: World, fleet: Fleet, belief: Belief | None, readings: tuple[Record, ...], due: Array
) -> Belief | None:
    """Return what the controller's own estimator makes of the readings of now; None without one."""
    estimator = fleet.controller.estimator()
    if estimator is None or belief is None:
        return None
    named = dict(zip(fleet.sensor_names, readings, strict=True))
    dt = world.time_step
    fresh = {name: sensor.fresh(due, dt) for name, sensor in zip(fleet.sensor_names, fleet.sensors, strict=True)}
    return Belief(*estimator.step(belief.memory, named, fresh, dt))


def faulted(
    fleet: Fleet, name: str, reading: Record, passed_on: tuple[Record | None, ...], tick: Array
) -> tuple[Record, tuple[Record | None, ...]]:
    """Apply a sensor's faults in turn; return the delivered reading and the faults' last outputs."""
    memories = list(passed_on)
    for i, fault in enumerate(fleet.faults):
        if fault.sensor == name:
            # At the start nothing was passed on before: what is frozen then is the first reading.
            before = memories[i]
            reading = fault.apply(reading, reading if before is None else before, tick)
            memories[i] = reading if fault.remembers else None
    return reading, tuple(memories)


def scene_of(fleet: Fleet, state: FleetState, sky: SkyState, view: Surroundings | None = None) -> dict[str, object]:
    """Everything a sensor may declare in ``reads``."""
    vehicle = fleet.vehicle.pose(state.vehicle)
    return {
        "position_ned": vehicle.position_ned,
        "position_low_ned": state.position_low_ned,
        "velocity_ned": rotation(vehicle.attitude).to_ned(vehicle.velocity_body),
        "attitude": vehicle.attitude,
        "velocity_body": vehicle.velocity_body,
        "rates_body": vehicle.rates_body,
        "specific_force": state.specific_force,
        "wind_ned": state.mean_wind_ned + state.gust_ned,
        "sky": sky,
        "surroundings": view,
        "ground": None if view is None else view.ground,
        "skyline": None if view is None else view.skyline,
    }


def estimate_of(fleet: Fleet, state: FleetState) -> Estimate:
    """Return the controller's estimate: its own, the truth, or from horizontal GNSS, barometer and attitude."""
    if state.belief is not None:
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


def measured_quantities(readings: tuple[Record, ...]) -> Measured:
    """Merge the fields of all readings by name; the first sensor with a field takes precedence.

    Fields of other names than those of ``Measured`` are there too.
    """
    merged: dict[str, object] = {}
    for reading in readings:
        for name in reading.__dataclass_fields__:
            merged.setdefault(name, getattr(reading, name))
    return cast(Measured, merged)
