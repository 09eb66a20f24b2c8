"""Events at set times, and room for changes of the weather in flight: checked and built."""

from __future__ import annotations

import math
from collections.abc import Iterator

from qrsim.errors import UsageError
from qrsim.scenarios.event_schema import EventSpec
from qrsim.scenarios.pushes import push_event_problems
from qrsim.scenarios.schema import ScenarioSpec
from qrsim.scenarios.spans import moment_problems
from qrsim.scenarios.timing import is_multiple
from qrsim.simulation.changing import GUSTS, JAM, TAKES, WIND, changed, with_changes
from qrsim.world.state import World

EVENTS = (*TAKES, "push")


def _change(event: EventSpec) -> tuple[str, dict[str, object]]:
    """Return the kind of weather change of an event, and its parameters that are set."""
    (kind,) = (kind for kind in TAKES if getattr(event, kind) is not None)
    return kind, {name: value for name, value in getattr(event, kind).model_dump().items() if value is not None}


def event_problems(scenario: ScenarioSpec) -> Iterator[str]:
    """Yield the errors of each entry of ``world.events`` in a scenario."""
    for i, event in enumerate(scenario.world.events):
        path = f"world.events.{i}"
        given = [kind for kind in EVENTS if getattr(event, kind) is not None]
        if len(given) != 1:
            yield f"{path}: expected one of {', '.join(EVENTS)}, found {' and '.join(given) or 'none'}"
        if event.push is not None:
            yield from push_event_problems(f"{path}.push", event.push, scenario)
        if event.at and not is_multiple(event.at, scenario.time_step, math.inf):
            yield f"{path}.at: {event.at:g} s is not a multiple of the time step {scenario.time_step:g} s"
        yield from moment_problems(f"{path}.at", event.at, scenario.duration)


def with_events(world: World, scenario: ScenarioSpec) -> World:
    """Return a world with the weather changes of the scenario's events, and empty slots for changes made in flight.

    Args:
        world: of the scenario, in its precision.
        scenario: without other problems.

    Raises:
        UsageError: an event is not possible; names it.
    """
    spec = scenario.world
    changes = [(number, event) for number, event in enumerate(spec.events) if event.push is None]
    events = sorted(changes, key=lambda item: item[1].at)
    kinds = {*spec.injectable, *(_change(event)[0] for _, event in events)}
    if not kinds:
        return world
    world = with_changes(world, [kind for kind in (WIND, GUSTS, JAM) if kind in kinds], len(events))
    for number, event in events:
        kind, numbers = _change(event)
        # The first epoch that a jammer can change is that of the next tick.
        tick = max(0, round(event.at / scenario.time_step) - (kind == JAM))
        try:
            world = changed(world, kind, numbers, tick, now=-1)
        except UsageError as error:
            raise UsageError(f"world.events.{number}.{kind}: {error}") from None
    return world
