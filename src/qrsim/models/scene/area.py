"""Limits of the area, and the conditions that end a vehicle's flight (docs/howto/write_a_scenario.md)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import ClassVar

import jax
import jax.numpy as jnp
from jax import Array

from qrsim.core.nearest import nearest_squared
from qrsim.core.tree import parameter, quantity, record
from qrsim.core.vectors import Euler, Vec3
from qrsim.models.scene.contracts import Area
from qrsim.models.scene.sweeping import closest_squared

# Every way to become invalid: (kind, field). The position in this tuple is the code carried in the state; 0 is valid.
REASONS: tuple[tuple[str, str], ...] = (
    ("valid", ""),
    ("not_finite", "state"),
    ("out_of_area", "position_ned.x"),
    ("out_of_area", "position_ned.y"),
    ("out_of_area", "position_ned.z"),
    ("state_limit", "attitude.roll"),
    ("state_limit", "attitude.pitch"),
    ("state_limit", "attitude.yaw"),
    ("state_limit", "velocity_body.x"),
    ("state_limit", "velocity_body.y"),
    ("state_limit", "velocity_body.z"),
    ("state_limit", "rates_body.x"),
    ("state_limit", "rates_body.y"),
    ("state_limit", "rates_body.z"),
    ("collision", "distance"),
    ("collision", "obstacle"),
    ("battery_empty", "charge"),
    ("out_of_area", "fence"),
    ("hit_ground", "speed"),
    ("hit_ground", "tilt"),
    ("hit_ground", "position_ned.z"),
    ("crashed", "impact_speed"),
    ("crashed", "hub_contact"),
    ("brown_out", "power"),
)

# Of the value of a reason, by its field; others have none.
UNITS = {
    "position_ned": "m",
    "attitude": "rad",
    "velocity_body": "m/s",
    "rates_body": "rad/s",
    "distance": "m",
    "fence": "m",
    "speed": "m/s",
    "tilt": "rad",
    "impact_speed": "m/s",
    "power": "W",
}


def reason_code(kind: str, field: str) -> int:
    """Return the integer code of a stop reason (kind and field, such as "collision"), its index in REASONS."""
    return REASONS.index((kind, field))


def reason_text(code: int, value: float) -> str:
    """Return a stop reason as text with kind, field, value and unit; "" for code 0."""
    if code == 0:
        return ""
    kind, field = REASONS[code]
    if field == "obstacle":
        return f"{kind}: obstacle {value:.0f}"
    if kind == "not_finite":
        return f"{kind}: {field}"
    return f"{kind}: {field} = {value:.4g} {UNITS.get(field.partition('.')[0], '')}".rstrip()


@record
class Violation:
    """The first limit each vehicle breaks, (n,)."""

    code: Array = quantity(doc="int32 index into REASONS, 0 where none")
    value: Array = quantity(doc="the value that broke the limit, in its own unit; 0 where none")

    @staticmethod
    def first(checks: Sequence[tuple[int, Array, Array]], like: Array) -> Violation:
        """Return the first broken check (code, value (n,), broken (n,)) for each vehicle, code 0 if none is."""
        code, value = jnp.zeros(like.shape, jnp.int32), jnp.zeros_like(like)
        for check_code, check_value, broken in reversed(checks):
            code = jnp.where(broken, check_code, code)
            value = jnp.where(broken, check_value, value)
        return Violation(code, value)

    def or_else(self, other: Violation) -> Violation:
        """Return this violation, or ``other`` for vehicles (n,) without one here (code 0)."""
        here = self.code != 0
        return Violation(jnp.where(here, self.code, other.code), jnp.where(here, self.value, other.value))


@record
class BoxArea(Area):
    """A box in NED; z = 0 is the ground, and z points down."""

    x_min: Array = parameter(default=-1000.0, unit="m", doc="southern limit")
    x_max: Array = parameter(default=1000.0, unit="m", doc="northern limit")
    y_min: Array = parameter(default=-1000.0, unit="m", doc="western limit")
    y_max: Array = parameter(default=1000.0, unit="m", doc="eastern limit")
    z_min: Array = parameter(default=-120.0, unit="m", doc="ceiling, negative", maximum=0.0)
    z_max: Array = parameter(default=0.0, unit="m", doc="floor; 0 is the ground", maximum=0.0)
    is_box: ClassVar[bool] = True

    def check(self, position_ned: Vec3) -> list[tuple[int, Array, Array]]:
        """Return the checks of positions (n,) against the area's walls, each (reason code, value, broken)."""
        axes = (
            ("x", position_ned.x, self.x_min, self.x_max),
            ("y", position_ned.y, self.y_min, self.y_max),
            ("z", position_ned.z, self.z_min, self.z_max),
        )
        return [
            (reason_code("out_of_area", f"position_ned.{axis}"), value, (value < low) | (value > high))
            for axis, value, low, high in axes
        ]

    def margin(self, position_ned: Vec3) -> Array:
        """Return the distance (n,) [m] of positions from the nearest wall, floor or ceiling; negative outside."""
        walls, ceiling, floor = self.clearances(position_ned)
        return jnp.minimum(walls, jnp.minimum(ceiling, floor))

    def clearances(self, position_ned: Vec3) -> tuple[Array, Array, Array]:
        """Return the distances (n,) [m] of positions from the nearest wall, the ceiling and the floor."""
        x, y, z = position_ned.x, position_ned.y, position_ned.z
        walls = jnp.minimum(jnp.minimum(x - self.x_min, self.x_max - x), jnp.minimum(y - self.y_min, self.y_max - y))
        return walls, z - self.z_min, self.z_max - z

    def farthest_squared(self, position_ned: Vec3) -> Array:
        """Return the squared distance (n,) [m^2] of positions from the area's farthest corner."""
        limits = ((self.x_min, self.x_max), (self.y_min, self.y_max), (self.z_min, self.z_max))
        far = Vec3(
            *(
                jnp.maximum(jnp.abs(value - low), jnp.abs(value - high))
                for value, (low, high) in zip(jax.tree.leaves(position_ned), limits, strict=True)
            )
        )
        return far.dot(far)

    def height_agl(self, position_ned: Vec3) -> Array:
        """Return the height (n,) [m] of positions above the ground at z = 0."""
        return -position_ned.z


@record
class StateLimits:
    """Limits of validity of a vehicle model. A vehicle class can replace these defaults (``default_limits``)."""

    pitch: Array = parameter(
        default=math.radians(89.0), unit="rad", doc="largest |pitch|", above=0.0, maximum=math.pi / 2
    )
    roll: Array = parameter(default=math.pi, unit="rad", doc="largest |roll|", above=0.0)
    yaw: Array | None = parameter(
        default=None, unit="rad", doc="largest |yaw|, whole turns counted; null: no limit", above=0.0, nullable=True
    )
    velocity: Array = parameter(default=15.0, unit="m/s", doc="largest component of the body velocity", above=0.0)
    rate: Array = parameter(default=3.0, unit="rad/s", doc="largest component of the body rates", above=0.0)

    def check(
        self, attitude: Euler, velocity_body: Vec3, rates_body: Vec3, turns: Array | None = None
    ) -> list[tuple[int, Array, Array]]:
        """Return the checks of attitude, velocity and rates (n,) against the limits, each (reason code, value, broken).

        Args:
            attitude: [rad], the yaw within -pi and pi.
            velocity_body: over ground [m/s].
            rates_body: [rad/s].
            turns: whole turns of the yaw since the start; None: not counted.
        """
        limited = [("attitude.roll", attitude.roll, self.roll), ("attitude.pitch", attitude.pitch, self.pitch)]
        if self.yaw is not None:
            whole = jnp.zeros_like(attitude.yaw) if turns is None else turns
            limited.append(("attitude.yaw", attitude.yaw + (2.0 * math.pi) * whole, self.yaw))
        for axis in "xyz":
            limited.append((f"velocity_body.{axis}", getattr(velocity_body, axis), self.velocity))
        for axis in "xyz":
            limited.append((f"rates_body.{axis}", getattr(rates_body, axis), self.rate))
        return [(reason_code("state_limit", field), value, jnp.abs(value) > limit) for field, value, limit in limited]


def collisions(
    position_ned: Vec3, collision_distance: Array, radius: Array | None = None, before_ned: Vec3 | None = None
) -> Violation:
    """Return the collisions of vehicles (n,) nearer than ``collision_distance`` [m] to another, with the distance.

    Compares all positions together, so the result does not depend on the order of the vehicles, and counts
    vehicles that have already stopped.

    Args:
        position_ned: of all vehicles (n,) [m].
        collision_distance: () [m].
        radius: (n,) [m], where they differ: two vehicles collide closer than the sum of theirs, whatever the distance.
        before_ned: positions (n,) [m] from which they came in a straight line; None: only where they are counts.
    """
    x, y, z = position_ned.x, position_ned.y, position_ned.z
    if radius is not None:
        return _overlaps(position_ned, radius, before_ned)
    least = jnp.asarray(collision_distance, x.dtype)
    if before_ned is None:
        nearest = nearest_squared(x, y, z, least)
    else:
        nearest = _nearest_on_the_way(position_ned, before_ned, least)
    distance = jnp.sqrt(nearest)
    return Violation.first([(reason_code("collision", "distance"), distance, distance < collision_distance)], x)


def _nearest_on_the_way(position_ned: Vec3, before_ned: Vec3, least: Array) -> Array:
    """Return the smallest squared distance (n,) [m^2] to another vehicle during a tick, on straight paths.

    Two that move less than half of ``least`` to each other are 3 % of it nearer in between, at most: of them the ends
    of the ways are looked at.
    """
    way = position_ned - before_ned
    fastest = jnp.sqrt(jnp.max(jnp.where(jnp.isfinite(way.dot(way)), way.dot(way), 0.0)))
    fast = (least > 0.0) & (4.0 * fastest > least)
    reach = jnp.where(fast, least + 2.0 * fastest, least)
    nearest = nearest_squared(position_ned.x, position_ned.y, position_ned.z, reach)

    def by_pairs() -> Array:
        """Return the smallest squared distances (n,) [m^2], computed from all pairs of vehicles."""
        start, end = (
            place.map(lambda axis: axis[:, None]) - place.map(lambda axis: axis[None, :])
            for place in (before_ned, position_ned)
        )
        moved = end - start
        squared = jnp.where(4.0 * moved.dot(moved) > least * least, closest_squared(start, end), end.dot(end))
        return jnp.min(jnp.where((squared >= 0.0) & ~_itself(squared), squared, math.inf), axis=0)

    result: Array = jax.lax.cond(fast & jnp.any(nearest < reach * reach), by_pairs, lambda: nearest)
    return result


def _overlaps(position_ned: Vec3, radius: Array, before_ned: Vec3 | None) -> Violation:
    """Return the collisions of vehicles' spheres (n,) that overlap, with the centre distance [m] of the worst."""
    start, end = (
        place.map(lambda axis: axis[:, None]) - place.map(lambda axis: axis[None, :])
        for place in (position_ned if before_ned is None else before_ned, position_ned)
    )
    squared = closest_squared(start, end)
    # A NaN position, which compares false, counts as far away.
    other = (squared >= 0.0) & ~_itself(squared)
    distance = jnp.sqrt(jnp.where(other, squared, 1.0))
    gap = jnp.where(other, distance - (radius[:, None] + radius[None, :]), math.inf)
    least = jnp.min(gap, axis=0)
    value = jnp.min(jnp.where(gap <= least[None, :], distance, math.inf), axis=0)
    return Violation.first([(reason_code("collision", "distance"), value, least < 0.0)], position_ned.x)


def _itself(pairs: Array) -> Array:
    """Return (n, n) bool: the pair is a vehicle and itself."""
    index = jnp.arange(pairs.shape[0])
    return index[:, None] == index[None, :]
