"""Why vehicles have stopped, in words with units."""

from __future__ import annotations

import math
from collections.abc import Callable

from qrsim.models.scene.area import REASONS

# Of an axis of NED: its name, and where it leads beyond the upper and the lower limit.
SIDES = {"x": ("north", "south"), "y": ("east", "west")}
WORDS: dict[tuple[str, str], Callable[[float], str]] = {
    ("not_finite", "state"): lambda value: "its state is no number any more",
    ("out_of_area", "fence"): lambda value: f"left the area, {abs(value):.1f} m beyond its edge",
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
    if kind == "out_of_area":
        return f"left the area{_where(axis, number, area)}, {axis} = {number:.1f} m"
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


def _where(axis: str, value: float, area: object) -> str:
    """Return on which side of the area a coordinate [m] lies, in words; "" if the area's shape is unknown."""
    known = {} if area is None else vars(area)
    low, high = (known.get(f"{axis}_{end}") for end in ("min", "max"))
    if low is None or high is None:
        return ""
    beyond = float(value) > 0.5 * (float(low) + float(high))
    if axis == "z":
        return " through its floor" if beyond else " through its ceiling"
    above, below = SIDES[axis]
    return f" to the {above if beyond else below}"
