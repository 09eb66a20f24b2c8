"""Lines about the plans of a scenario: which item of a file each leg comes from, and what is skipped."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

from qrsim.scenarios.plans.commands import COMMANDS, SKIPPED
from qrsim.scenarios.plans.parts import lines_of
from qrsim.scenarios.plans.plan import Ignored, Plan

IDLE = frozenset(COMMANDS[number].name for number in SKIPPED)


@dataclass(frozen=True)
class PlannedVehicle:
    """The plan of a vehicle.

    Attributes:
        path: of its legs or waypoints in the scenario.
        label: of the plan in messages.
        file: of the plan.
        plan: its content.
        items: number of the item that each leg or waypoint comes from; None: the delay at the start.
        mission: whether it is flown as a mission.
        parameters: of the flight stack of ``qrsim mavlink``, by name.
    """

    path: str
    label: str
    file: str
    plan: Plan
    items: tuple[int | None, ...]
    mission: bool
    parameters: Mapping[str, float] = field(default_factory=dict)


def plan_lines(planned: Iterable[PlannedVehicle]) -> Iterator[str]:
    """Yield lines of text, for printing, about the plans that vehicles fly and the plan items that are ignored."""
    for vehicle in planned:
        home = vehicle.plan.home
        level = "" if math.isnan(home.altitude_amsl) else f", {home.altitude_amsl:g} m above the sea"
        yield f"{vehicle.path}, from {vehicle.label}:"
        yield f"  home: latitude {home.latitude_deg:.7g} deg, longitude {home.longitude_deg:.7g} deg{level}"
        places = {each.item: each for each in vehicle.plan.waypoints}
        at = lines_of(vehicle.file, [each.path for each in places.values()])
        first = 0
        for item, group in itertools.groupby(vehicle.items):
            last = first + len(list(group)) - 1
            numbers = str(first) if first == last else f"{first} to {last}"
            first = last + 1
            if item is None:
                yield f"  {numbers}: a delay at the start"
                continue
            path = places[item].path
            where = f", line {at[path]}" if path in at else f", {path}" if path.startswith("line ") else ""
            yield f"  {numbers}: {places[item].command} (item {item}{where})"
        idle = [note for note in vehicle.plan.ignored if note.name in IDLE]
        others = [note for note in vehicle.plan.ignored if note not in idle]
        texts = [note.text if vehicle.mission else note.route_text for note in others]
        kept = [text for note, text in zip(others, texts, strict=True) if note.what or not vehicle.mission]
        if idle:
            yield f"  skipped: {listed(idle)}"
        yield from (f"  skipped: {text}" for text in kept)


def listed(notes: list[Ignored]) -> str:
    """Return ignored plan items, grouped by kind, as text: "DO_GRIPPER (items 3, 5), DO_MOUNT_CONTROL (item 4)"."""
    numbers: dict[str, list[str]] = {}
    for note in notes:
        numbers.setdefault(note.name, []).append(str(note.item))
    return ", ".join(
        f"{name} ({'item' if len(own) == 1 else 'items'} {', '.join(own)})" for name, own in numbers.items()
    )
