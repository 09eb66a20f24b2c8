"""Events of the changes of the weather that a scenario has at set times."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from qrsim.files import Content
from qrsim.models.sensors.faults import LAST_TICK
from qrsim.simulation.changing import GUSTS, JAM, WIND
from qrsim.simulation.history import History
from qrsim.simulation.injections import WORLD, Injection
from qrsim.simulation.requests import events_of
from qrsim.world.changes import Course
from qrsim.world.state import World


def weather_events(world: World, history: History) -> Iterator[tuple[int, Content]]:
    """Yield (row, event) for each weather parameter that begins to change in a history."""
    for request in scheduled(world):
        for row in np.flatnonzero(history.ticks == request.tick):
            for event in events_of([request], world.time_step):
                yield int(row), event


def scheduled(world: World) -> Iterator[Injection]:
    """Yield the weather changes that a world has at set times, as injections."""
    changes = world.changes
    if changes is None:
        return
    parts: list[tuple[str, str, Course | None, Content]] = [
        (WIND, "speed_20ft", changes.speed_20ft, {}),
        (WIND, "wind_from_deg", changes.wind_from_rad, {}),
        (GUSTS, "times", changes.gusts, {}),
    ]
    parts += [(JAM, "power_w", course, {"jammer": number}) for number, course in enumerate(changes.powers)]
    for kind, name, course, more in parts:
        for start, ticks, after in () if course is None else _course_legs(course):
            value = math.degrees(after) % 360.0 if name == "wind_from_deg" else after
            # As they were written, not as they are rounded to single precision.
            numbers = {**more, name: float(f"{value:.6g}"), "over": ticks * world.time_step}
            yield Injection(0, WORLD, kind, (), start, LAST_TICK, numbers, "scenario", start)


def _course_legs(course: Course) -> Iterator[tuple[int, int, float]]:
    """Yield (start tick, number of ticks, final value) of each change of a scheduled weather parameter."""
    columns = (np.asarray(part).tolist() for part in (course.start_tick, course.ticks, course.after))
    for start, ticks, after in zip(*columns, strict=True):
        if 0 <= start < LAST_TICK:
            yield start, ticks, after
