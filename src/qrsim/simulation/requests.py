"""Requests that change a flight: their effect on a world, their events, and their entries in a file."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

from qrsim.core.arrays import is_number
from qrsim.errors import UsageError
from qrsim.files import Content
from qrsim.models.sensors.faults import LAST_TICK
from qrsim.models.vehicles.fault_numbers import push_numbers
from qrsim.simulation.changing import GUSTS, JAM, WIND, changed
from qrsim.simulation.injections import BODY, OK, WORLD, Injection, injected, named_vehicles
from qrsim.world.state import World

# Longer times are none [s].
LONGEST_S = 1e9
# Kinds of the events of requests. Changes of the weather have an event for each number.
INJECTED, CLEARED = "injected", "cleared"
WEATHER_CHANGED = {WIND: "wind_changed", GUSTS: "gusts_changed", JAM: "jammer_changed"}
_WORDS = {
    "speed_20ft": "{:g} m/s at 20 ft",
    "wind_from_deg": "from {:g} degrees",
    "times": "{:g} times as strong as in the scenario",
    "power_w": "{:g} W",
}


def after_request(world: World, request: Injection) -> tuple[World, Injection]:
    """Apply an injection request to a world; return the new world, and the request with the names of all affected
    vehicles.

    A push has its accelerations as lists of three axes then.

    Raises:
        UsageError: it is not possible in this world.
    """
    if request.target == WORLD:
        return changed(world, request.kind, request.numbers, request.tick), request
    chosen = named_vehicles(world, request.vehicles or None)
    ticks = (request.start_tick, request.end_tick)
    world, concerned = injected(world, request.target, request.kind, chosen, ticks, request.numbers)
    if request.target == BODY and request.kind != OK:
        request = replace(request, numbers=push_numbers(request.kind, request.numbers))
    return world, replace(request, vehicles=concerned)


def first_tick(seconds: float | None, now: int, dt: float, soonest: int) -> int:
    """Convert the time [s] at which a request is to act to a tick, rounded up; None: ``soonest`` ticks after
    ``now``."""
    if seconds is None:
        return now + soonest
    if not is_number(seconds) or not abs(seconds) < LONGEST_S:
        raise UsageError(f"at: {seconds!r:.60}; allowed: a time [s], or None for now")
    tick = math.ceil(seconds / dt - 1e-6)
    if tick < now + soonest:
        raise UsageError(f"at: {seconds:g} s is past; it is {now * dt:g} s now")
    return min(tick, LAST_TICK - 1)


def last_tick(duration: float | None, start: int, dt: float) -> int:
    """Return the first tick after a fault of ``duration`` [s] that begins at tick ``start``; LAST_TICK for None (for
    ever)."""
    if duration is None:
        return LAST_TICK
    if not is_number(duration) or not 0.0 < duration < LONGEST_S:
        raise UsageError(f"duration: {duration!r:.60}; allowed: a time above 0 s, or None for good")
    return min(start + max(1, math.ceil(duration / dt - 1e-6)), LAST_TICK)


def of_sensor(world: World, target: str) -> bool:
    """Return whether a fault's target is a sensor, for which faults act from the next reading on."""
    return any(target in fleet.sensor_names for fleet in world.fleets)


def entry_of(request: Injection, time_step: float) -> Content:
    """Return an injection request as an entry of an injection file."""

    def seconds(tick: int) -> float:
        """Convert a tick to a time [s]."""
        return round(tick * time_step, 15)

    entry: Content = {"target": request.target, "kind": request.kind, "tick": request.tick}
    entry["at"] = seconds(request.start_tick)
    if request.end_tick < LAST_TICK and request.kind != OK and request.target != WORLD:
        entry["end"] = seconds(request.end_tick)
    if request.vehicles:
        entry["vehicles"] = list(request.vehicles)
    return entry | dict(request.numbers) | {"asked_by": request.asked_by}


def events_of(requests: Iterable[Injection], time_step: float) -> Iterator[Content]:
    """Yield injection requests as events of a run, one for each vehicle, or for each changed number of the weather.

    Args:
        requests: in the order in which they were made.
        time_step: of the simulation [s].
    """
    for request in requests:
        time = request.tick * time_step
        where = {"time": time, "tick": request.tick}
        if request.target == WORLD:
            yield from _of_world(request, where)
            continue
        what, by = f"{request.target} {request.kind}", f"asked by {request.asked_by}"
        part = request.numbers.get("field")
        # The value of a push is its size.
        values = [math.hypot(*value) if isinstance(value, list) else value for value in request.numbers.values()]
        values = [value for value in values if is_number(value)]
        kind = CLEARED if request.kind == OK else INJECTED
        words = f"{request.target} cleared at {time:.2f} s, {by}"
        if kind == INJECTED:
            words = f"{what} injected at {time:.2f} s{_span(request, time_step)}, {by}"
        for vehicle in request.vehicles:
            yield {
                **where,
                "vehicle": vehicle,
                "kind": kind,
                "field": request.target if part is None else f"{request.target}.{part}",
                "value": float(values[0]) if values else None,
                "message": f"{vehicle}: {words}",
            }


def _span(request: Injection, time_step: float) -> str:
    """Return the start and end of a fault as text; "" for one that acts at once and for ever."""
    # The first reading that a request can change is that of the next tick.
    later = f" from {request.start_tick * time_step:.2f} s" if request.start_tick > request.tick + 1 else ""
    return later + (f" until {request.end_tick * time_step:.2f} s" if request.end_tick < LAST_TICK else "")


def _of_world(request: Injection, where: Mapping[str, object]) -> Iterator[Content]:
    """Yield an event for each number that a change of the weather sets; ``where``: the event's time and tick."""
    over, numbers = request.numbers.get("over"), dict(request.numbers)
    slowly, jammer = f", over {over:g} s" if over else "", numbers.pop("jammer", None)
    what = request.kind if jammer is None else f"jammer {jammer}"
    part = request.kind if jammer is None else f"{request.kind}.{jammer}"
    for name, value in numbers.items():
        if name != "over":
            yield {
                **where,
                "vehicle": None,
                "kind": WEATHER_CHANGED[request.kind],
                "field": f"world.{part}.{name}",
                "value": float(value),
                "message": f"{what} changed at {where['time']:.2f} s{slowly}: {_WORDS[name].format(value)}",
            }
