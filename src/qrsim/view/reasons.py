"""Why vehicles have stopped, in words with units."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from qrsim.models.scene.area import REASONS, reason_text
from qrsim.runs.failsafe_events import ENDS, still_acting
from qrsim.runs.layout import Event

# Of an axis of NED: its name, and where it leads beyond the upper and the lower limit.
SIDES = {"x": ("north", "south"), "y": ("east", "west")}
# Kind of the event of a vehicle that stopped because it left its area; its log ends at the last place inside.
LEFT = "out_of_area"
WORDS: dict[tuple[str, str], Callable[[float], str]] = {
    ("not_finite", "state"): lambda value: "its state is no number any more",
    ("out_of_area", "fence"): lambda value: f"left the area by {abs(value):.2f} m",
    ("collision", "distance"): lambda value: f"came too close to another vehicle, {value:.2f} m",
    ("collision", "obstacle"): lambda value: f"flew into obstacle {value:.0f}",
    ("battery_empty", "charge"): lambda value: "its battery is empty",
    ("hit_ground", "speed"): lambda value: f"hit the ground, at {value:.1f} m/s",
    ("hit_ground", "tilt"): lambda value: f"hit the ground, tilted by {math.degrees(value):.0f}°",
    ("hit_ground", "position_ned.z"): lambda value: f"hit the ground, z = {value:.1f} m",
    ("crashed", "impact_speed"): lambda value: f"crashed, at {value:.1f} m/s",
    ("crashed", "hub_contact"): lambda value: "crashed, with a rotor or its top on the ground",
    ("brown_out", "power"): lambda value: f"its battery cannot give the {value:.0f} W that it is asked for",
}


def in_words(kind: str, field: str | None, value: float | None, area: object = None) -> str:
    """Return in words why a vehicle has stopped, from the kind, field and value of its event.

    Args:
        kind, field, value: as events have them, in SI units.
        area: that it has left; None where that is not known.
    """
    name, number = field or "", 0.0 if value is None else float(value)
    if (kind, name) in WORDS:
        return WORDS[kind, name](number)
    what, _, axis = name.partition(".")
    if kind == LEFT:
        far = outside_by(name, number, area)
        return f"left the area, {axis} = {number:.1f} m" if far is None else f"left the area {far[1]}"
    if kind == "state_limit" and what == "attitude":
        return f"turned beyond what its model holds for, {axis} = {math.degrees(number):.0f}°"
    if kind == "state_limit" and what == "velocity_body":
        return f"faster than its model holds for, {number:.1f} m/s along its {axis} axis"
    if kind == "state_limit" and what == "rates_body":
        return f"turned faster than its model holds for, {number:.1f} rad/s about its {axis} axis"
    return kind.replace("_", " ") + (f", {name} = {number:.4g}" if name else "")


def code_in_words(code: int, value: float, area: object) -> str:
    """Return in words why a vehicle has stopped, from its state's violation code and value."""
    kind, field = REASONS[code]
    return in_words(kind, field, value, area)


def event_in_words(event: Event, area: object = None) -> str:
    """Return in words why a vehicle has stopped, with the vehicle or zone that the event's message names.

    Args:
        event: of the stop.
        area: of its run; None where that is not known.
    """
    why, known = in_words(event.kind, event.field, event.value, area), (event.kind, event.field or "")
    if known not in REASONS:
        return why
    told = reason_text(REASONS.index(known), event.value or 0.0)
    rest = event.message.rpartition(told)[2] if told and told in event.message else ""
    if rest.startswith(" to "):
        return why.replace("another vehicle", rest.removeprefix(" to "))
    return why + rest


def as_shown(event: Event, area: object = None) -> Event:
    """Return an event with the message that pages show: stops in words, with the depth outside, and failsafes."""
    if (event.kind, event.field or "") in REASONS:
        far = outside_by(event.field, event.value, area) if event.kind == LEFT else None
        depth = "" if far is None or not far[1] else f" by {far[0]:.2f} m"
        words = f" stopped: {event_in_words(event, area)}{depth}"
    elif event.kind == ENDS and still_acting(event.value):
        words = f": failsafe continues: {still_acting(event.value)}"
    else:
        return event
    return replace(event, message=f"{event.vehicle}{words}, at {event.time:.2f} s")


def outside_by(field: str | None, value: float | None, area: object) -> tuple[float, str] | None:
    """Return how far [m] outside its area a vehicle stopped, and on which side; None if that is unknown.

    Args:
        field, value: of its event ``LEFT``: a coordinate such as "position_ned.x", or "fence" and a distance [m].
        area: that it has left; None where that is not known.

    Returns:
        The depth, and the side in words such as "to the north"; "" for a fence that is no box.
    """
    if value is None:
        return None
    if field == "fence":
        return abs(float(value)), ""
    axis = (field or "").rpartition(".")[2]
    known = {} if area is None else vars(area)
    low, high = (known.get(f"{axis}_{end}") for end in ("min", "max"))
    if low is None or high is None:
        return None
    above, below = float(value) - float(high), float(low) - float(value)
    return max(above, below), _side(axis, above > below)


def _side(axis: str, beyond: bool) -> str:
    """Return on which side of an area a place is, in words; ``beyond``: its coordinate is above the upper limit."""
    if axis == "z":
        return "through its floor" if beyond else "through its ceiling"
    above, below = SIDES[axis]
    return f"to the {above if beyond else below}"
