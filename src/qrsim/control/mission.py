"""Guidance along a mission: a path in time for each leg, which waits for a vehicle that falls behind."""

from __future__ import annotations

from typing import ClassVar, Literal, TypeVar

import jax.numpy as jnp
from jax import Array

from qrsim.control.contracts import Guidance
from qrsim.control.setpoints import PathSetpoint
from qrsim.core.fastmath import sincos, wrap_angle
from qrsim.core.pairs import two_sum
from qrsim.core.tree import map_tree, parameter, quantity, record, replace, setting
from qrsim.core.vectors import Vec3, root

T = TypeVar("T")
# A landing vehicle so far above the point that is due [m], and not faster than this [m/s], is held by the ground.
HELD, HELD_SPEED = 0.6, 0.25
# One so far above it [m], on a path that has been at touchdown speed for so long [s], may have a foot on the ground; it
# is kept level, because what leans into a wind turns over that foot. At 0.7 m/s this takes 0.29 s, as long as PX4's
# ``ground_contact`` (MulticopterLandDetector: LNDMC_TRIG_TIME/3 = 0.33 s, LNDMC_Z_VEL_MAX 0.25 m/s), on which its
# MulticopterPositionControl asks for no horizontal acceleration either. Gusts do so too, so idle motors wait for HELD.
TOUCHED, STEADY = 0.2, 3.0
# Until a vehicle has risen so far above where it stood [m] nothing moves it to the side.
LIFTED = 0.5


@record
class Orbits:
    """Circles among the legs, (L, n)."""

    flown: Array = quantity(doc="bool: the leg is a circle")
    arm_north: Array = quantity(unit="m", doc="from the centre to where the circle begins")
    arm_east: Array = quantity(unit="m", doc="from the centre to where the circle begins")
    curvature: Array = quantity(unit="1/m", doc="one by the radius, clockwise positive")
    along: Array = quantity(doc="bool: the heading is along the circle")


@record
class Facing:
    """Legs during which a vehicle's heading points at a place, (L, n)."""

    faced: Array = quantity(doc="bool: the leg has one")
    north: Array = quantity(unit="m", doc="of the place")
    east: Array = quantity(unit="m", doc="of the place")


@record
class Mission:
    """Legs of each vehicle as planned (paths.py), padded to the longest mission: L legs, n vehicles."""

    position_ned: Vec3 = quantity(unit="m", doc="(L, n) where each leg ends")
    yaw: Array = quantity(unit="rad", doc="(L, n) heading")
    count: Array = quantity(doc="(n,) int32 number of legs")
    following: Array = quantity(doc="(n,) int32 leg that follows the last; itself: none does")
    begin_ned: Vec3 = quantity(unit="m", doc="(L, n) where the straight line begins")
    direction: Vec3 = quantity(unit="1", doc="(L, n) of the line")
    onward: Vec3 = quantity(unit="1", doc="(L, n) direction after the turn at its end")
    enter: Array = quantity(unit="m/s", doc="(L, n) speed at the begin")
    peak: Array = quantity(unit="m/s", doc="(L, n) largest speed; of a polynomial the mean")
    leave: Array = quantity(unit="m/s", doc="(L, n) speed at the end")
    rise_s: Array = quantity(unit="s", doc="(L, n) time of the ramp to the largest speed")
    cruise_s: Array = quantity(unit="s", doc="(L, n) time at this speed")
    fall_s: Array = quantity(unit="s", doc="(L, n) time of the ramp from it")
    turn_s: Array = quantity(unit="s", doc="(L, n) time of the turn into the next leg")
    accept_radius: Array = quantity(unit="m", doc="(L, n) distance at which the end counts as reached")
    hold_s: Array = quantity(unit="s", doc="(L, n) time to stay there")
    limit_s: Array = quantity(unit="s", doc="(L, n) time after which a leg is reported as not reached")
    stops: Array = quantity(doc="(L, n) bool: the leg ends at rest")
    lands: Array = quantity(doc="(L, n) bool: the leg ends on the ground")
    number: Array = quantity(doc="(L, n) int32 number of the leg as its author counts")
    last: Array = quantity(doc="(L, n) bool: the last part of what its author wrote as one leg")
    polynomial: Array | None = quantity(
        default=None, doc="(L, n) bool: a polynomial of fifth degree, from rest to rest"
    )
    circle: Orbits | None = quantity(default=None, doc="circles, None without any")
    facing: Facing | None = quantity(default=None, doc="points that the heading follows, None without any")

    @property
    def rises(self) -> Array:
        """(L, n) bool: the leg of the mission goes straight up, as a take-off does."""
        return self.direction.z < -0.9999


@record
class MissionState:
    """Progress of each vehicle (n,)."""

    index: Array = quantity(doc="int32 leg that is flown")
    reached: Array = quantity(doc="int32 legs reached so far, as their author counts")
    time: Array = quantity(unit="s", doc="time on the path of the leg, which waits for the vehicle")
    time_low: Array = quantity(unit="s", doc="remainder of it beyond single precision")
    ticks: Array = quantity(doc="int32 ticks on the leg until its end was reached")
    waited: Array = quantity(doc="int32 ticks at its end; of a landing before that, held by the ground")
    near: Array = quantity(doc="bool: has been within the accept radius")
    arrived: Array = quantity(doc="bool: its end was reached, and the vehicle stays")
    late: Array = quantity(doc="int32 number of legs that took longer than allowed")
    behind: Array = quantity(unit="m", doc="distance from the scheduled point of the path")
    finished: Array = quantity(doc="bool: the last leg was reached, and nothing follows")
    shift_ned: Vec3 = quantity(
        unit="m", doc="offset of the flown path from the planned one, such as after a displaced start"
    )
    low: Array = quantity(doc="bool: on the ground, or has not risen by LIFTED since")


def _ramp(first: Array, last: Array, seconds: Array, time: Array) -> tuple[Array, Array, Array]:
    """Return distance [m], speed and acceleration at ``time`` [s] of a ramp between two speeds, constant outside it."""
    whole = jnp.maximum(seconds, 1e-6)
    x = jnp.clip(time / whole, 0.0, 1.0)
    change = last - first
    way = seconds * (first * x + change * (x * x * x * (1.0 - 0.5 * x)))
    return way, first + change * (x * x * (3.0 - 2.0 * x)), change * (6.0 * x * (1.0 - x)) / whole


@record
class MissionGuidance(Guidance):
    """Flies legs with speed, stop, hold and heading, take-offs, landings and circles, on a path in time."""

    stretch_from: Array = parameter(
        default=2.0, unit="m", doc="tracking error at which the path begins to slow down", minimum=0.0
    )
    stretch_over: Array = parameter(
        default=3.0, unit="m", doc="further tracking error at which the path stops", above=0.0
    )
    stop_speed: Array = parameter(default=0.5, unit="m/s", doc="speed below which a vehicle has stopped", above=0.0)
    path: Literal["jerk_limited", "quintic"] = setting(
        default="jerk_limited", doc="ramps and turns, or a fifth-degree polynomial from rest to rest for every leg"
    )
    speed: float = setting(default=5.0, unit="m/s", doc="speed of legs without one", above=0.0, maximum=50.0)
    accept_radius: float = setting(
        default=2.0, unit="m", doc="distance at which a leg counts as reached, for legs without one", above=0.0
    )
    acceleration: float = setting(default=3.0, unit="m/s^2", doc="largest acceleration of the path", above=0.0)
    jerk: float = setting(default=8.0, unit="m/s^3", doc="largest jerk of the path", above=0.0)
    climb_speed: float = setting(default=3.0, unit="m/s", doc="largest speed upwards", above=0.0)
    sink_speed: float = setting(default=1.5, unit="m/s", doc="largest speed downwards", above=0.0)
    take_off_speed: float = setting(default=1.5, unit="m/s", doc="speed of a take-off", above=0.0)
    touchdown_speed: float = setting(default=0.7, unit="m/s", doc="speed of a landing near the ground", above=0.0)
    slow_below: float = setting(default=10.0, unit="m", doc="height below which a landing is slow", minimum=0.0)
    settle: float = setting(default=1.0, unit="s", doc="time on the ground after which a vehicle has landed", above=0.0)
    join_speed: Array = parameter(
        default=1.0,
        unit="m/s",
        doc="speed at which a path that starts off the planned one returns to it",
        above=0.0,
    )
    leg_timeout: float = setting(
        default=30.0, unit="s", doc="time beyond the planned one after which a leg is reported as late", above=0.0
    )
    repeat: bool = setting(default=False, doc="repeat the mission after the last leg; if false, stay there")

    gives: ClassVar[type] = PathSetpoint
    sees_motion: ClassVar[bool] = True
    sees_ground: ClassVar[bool] = True

    def init(self, route: Mission) -> MissionState:
        """Return the state of vehicles (n,) at the start of their missions."""
        count, zero = jnp.zeros(route.count.shape, jnp.int32), jnp.zeros_like(route.enter[0])
        no = jnp.zeros(count.shape, bool)
        return MissionState(count, count, zero, zero, count, count, no, no, count, zero, no, Vec3(zero, zero, zero), no)

    def step(
        self,
        state: MissionState,
        route: Mission,
        position_ned: Vec3,
        others_ned: Vec3 | None = None,
        *,
        velocity_ned: Vec3 | None = None,
        dt: float = 0.0,
        on_ground: Array | None = None,
    ) -> tuple[MissionState, PathSetpoint]:
        """Return the mission's state after a tick of dt [s], and the set-point (n,) on the path.

        Args:
            state, route, position_ned, others_ned: as of every guidance.
            velocity_ned: as estimated (n,) [m/s].
            dt: step [s].
            on_ground: (n,) bool, whether a vehicle is on the ground; None: none is.
        """
        assert velocity_ned is not None
        standing = jnp.zeros(state.near.shape, bool) if on_ground is None else on_ground
        leg = _leg_of(route, state.index)
        planned, ends = self._due(state, leg)
        risen = leg.begin_ned.z + state.shift_ned.z - position_ned.z
        low = standing | (state.low & (risen < LIFTED))
        shift = self._shifted(state.shift_ned, leg, planned, position_ned, (standing, low), dt)
        due = replace(planned, position_ned=planned.position_ned + shift)
        behind = (due.position_ned - position_ned).norm()
        rate = jnp.clip(1.0 - (behind - self.stretch_from) / self.stretch_over, 0.0, 1.0)
        idle = leg.lands & (state.arrived | (_seconds(state.waited, state, dt) >= 0.5 * self.settle))
        above, sinking = due.position_ned.z - position_ned.z, velocity_ned.z
        touched = (above > TOUCHED) & (jnp.abs(sinking) < HELD_SPEED) & (state.time > ends + STEADY)
        level = leg.lands & (standing | touched)
        asked = _slowed_setpoint(due, rate, (idle, level), low)
        goal = leg.position_ned + shift.map(lambda axis: jnp.where(leg.rises, axis, 0.0))
        distance = (goal - position_ned).norm()
        near = state.near | (distance < leg.accept_radius)
        time, time_low = _ahead(state, leg, ends, near, rate * dt)
        stopped = (distance < leg.accept_radius) & (velocity_ned.norm() < self.stop_speed) & (time >= ends - 0.05 * dt)
        landed = standing & (_seconds(state.waited + 1, state, dt) >= self.settle)
        at_rest = jnp.where(leg.lands, landed, stopped)
        arrives = ~state.arrived & jnp.where(leg.stops, at_rest, near & (time >= ends))
        waits = leg.lands & (standing | held(above, sinking))
        waited = jnp.where(state.arrived | (waits & ~arrives), state.waited + 1, 0)
        now = replace(
            state, time=time, time_low=time_low, waited=waited, near=near, arrived=state.arrived | arrives,
            behind=behind, shift_ned=shift, low=low,
        )  # fmt: skip
        return _progress(now, route, leg, arrives, ends, dt), asked

    def _shifted(
        self,
        before: Vec3,
        leg: Mission,
        planned: PathSetpoint,
        position_ned: Vec3,
        where: tuple[Array, Array],
        dt: float,
    ) -> Vec3:
        """Return the offset (n,) NED [m] of the flown path from the planned one, reduced over time (eq. C22).

        Args:
            before: the step before.
            leg, planned: what is flown, and the point of it that is due.
            position_ned: as estimated.
            where: (n,) bool: vehicles on the ground, and low ones.
            dt: step [s].
        """
        standing, low = where
        length = root(before.dot(before))
        left = jnp.maximum(length - self.join_speed * dt, 0.0) / jnp.maximum(length, 1e-6)
        left = jnp.where(leg.rises, 1.0, left)
        beside = position_ned - planned.position_ned
        stood = jnp.where(leg.lands, 0.0, position_ned.z - leg.begin_ned.z)
        return Vec3(
            jnp.where(low, beside.x, before.x * left),
            jnp.where(low, beside.y, before.y * left),
            jnp.where(standing, stood, jnp.where(low, before.z, before.z * left)),
        )

    def setpoint(self, state: MissionState, route: Mission) -> PathSetpoint:
        """Return the set-point (n,) of the path at the mission's present time."""
        leg = _leg_of(route, state.index)
        due = self._due(state, leg)[0]
        return PathSetpoint(
            due.position_ned + state.shift_ned, due.velocity_ned, due.acceleration_ned, due.yaw,
            state.arrived & leg.lands, state.arrived & leg.lands,
        )  # fmt: skip

    def _due(self, state: MissionState, leg: Mission) -> tuple[PathSetpoint, Array]:
        """Return the planned set-point (n,) at the leg's present time, and the time (n,) [s] at which the leg ends."""
        time = state.time
        rises, falls = leg.rise_s, leg.rise_s + leg.cruise_s
        turns = falls + leg.fall_s
        up, speed, rising = _ramp(leg.enter, leg.peak, leg.rise_s, time)
        down, slower, falling = _ramp(leg.peak, leg.leave, leg.fall_s, time - falls)
        way = up + leg.peak * jnp.clip(time - rises, 0.0, leg.cruise_s) + down
        speed, along = speed + (slower - leg.peak), rising + falling
        if leg.polynomial is not None:
            way, speed, along = _quintic(leg, time, (way, speed, along))
        # Beyond its time a turn goes straight on, as the next leg does, and a landing goes down.
        beyond = jnp.maximum(time - turns, 0.0)
        turned, share, swing = _ramp(jnp.zeros_like(time), jnp.ones_like(time), leg.turn_s, beyond)
        side = turned + jnp.maximum(beyond - leg.turn_s, 0.0)
        bend = leg.onward - leg.direction
        position = leg.begin_ned + leg.direction * (way + leg.leave * beyond) + bend * (leg.leave * side)
        velocity = leg.direction * speed + bend * (leg.leave * share)
        acceleration = leg.direction * along + bend * (leg.leave * swing)
        due = PathSetpoint(position, velocity, acceleration, leg.yaw)
        if leg.circle is not None:
            due = _round(leg, leg.circle, way, speed, along, due)
        if leg.facing is not None:
            place = due.position_ned
            ahead = jnp.where(leg.facing.faced, leg.facing.north - place.x, 1.0)
            looks = jnp.arctan2(leg.facing.east - place.y, ahead)
            due = PathSetpoint(
                place, due.velocity_ned, due.acceleration_ned, jnp.where(leg.facing.faced, looks, due.yaw)
            )
        return due, turns + leg.turn_s


def _seconds(ticks: Array, state: MissionState, dt: float) -> Array:
    """Return tick counts as times [s], in the dtype of the state."""
    return ticks.astype(state.time.dtype) * dt


def _slowed_setpoint(due: PathSetpoint, rate: Array, grounded: tuple[Array, Array], low: Array) -> PathSetpoint:
    """Return the set-point (n,) with velocity scaled by ``rate`` 0 to 1; without horizontal motion where ``low``."""
    velocity, acceleration = due.velocity_ned * rate, due.acceleration_ned * (rate * rate)

    def upright(vector: Vec3) -> Vec3:
        """Return a vector (n,) with its horizontal components set to 0 where ``low`` is True."""
        return replace(vector, x=jnp.where(low, 0.0, vector.x), y=jnp.where(low, 0.0, vector.y))

    return PathSetpoint(due.position_ned, upright(velocity), upright(acceleration), due.yaw, *grounded)


def _ahead(state: MissionState, leg: Mission, ends: Array, near: Array, by: Array) -> tuple[Array, Array]:
    """Return the leg's time (n,) [s] ``by`` later, as (sum, remainder); held at stops, and at corners until near."""
    # At a waypoint without a stop the path waits in the middle of the corner until the vehicle is near.
    corner = jnp.where(near, jnp.inf, ends - 0.5 * leg.turn_s)
    most = jnp.where(leg.stops, jnp.where(leg.lands, jnp.inf, ends), corner)
    ahead = jnp.maximum(jnp.minimum(state.time + by, most) - state.time, 0.0)
    return two_sum(state.time, state.time_low + ahead)


def held(above: Array, sinking: Array) -> Array:
    """Return (n,) bool: the vehicle is commanded to descend but does not move, so it rests on the ground.

    Its motors then idle, so that the feet carry its weight.

    Args:
        above: height above the point that is due (n,) [m].
        sinking: vertical velocity (n,) [m/s].
    """
    # At twice the height, more speed is allowed: the vehicle may bounce on its feet.
    calm = jnp.where(above > 2.0 * HELD, 4.0 * HELD_SPEED, HELD_SPEED)
    return (above > HELD) & (jnp.abs(sinking) < calm)


def _progress(now: MissionState, route: Mission, leg: Mission, arrives: Array, ends: Array, dt: float) -> MissionState:
    """Return the state (n,) with counters updated; after the hold time at its end, the next leg begins.

    Args:
        now: state at the end of the step.
        route, leg: the mission, and the leg that was flown.
        arrives: (n,) bool: the vehicle has reached the end of the leg in this step.
        ends: time at which the path of the leg ends (n,) [s].
    """
    over = now.index + 1 >= route.count
    final = over & (route.following == now.index)
    done = now.arrived & (_seconds(now.waited, now, dt) >= leg.hold_s)
    moves = done & ~final
    ticks = now.ticks + (~now.arrived).astype(jnp.int32)
    late = (_seconds(ticks, now, dt) > leg.limit_s) & (_seconds(now.ticks, now, dt) <= leg.limit_s)
    rest = jnp.where(leg.stops, 0.0, now.time - ends)
    return replace(
        now,
        index=jnp.where(moves, jnp.where(over, route.following, now.index + 1), now.index),
        reached=now.reached + (arrives & leg.last).astype(jnp.int32),
        time=jnp.where(moves, rest, now.time),
        time_low=jnp.where(moves, 0.0, now.time_low),
        ticks=jnp.where(moves, 0, ticks),
        waited=jnp.where(moves, 0, now.waited),
        near=now.near & ~moves,
        arrived=now.arrived & ~moves,
        late=now.late + late.astype(jnp.int32),
        finished=done & final,
    )


def _leg_of(route: Mission, index: Array) -> Mission:
    """Return the leg that each vehicle (n,) flies, from legs (L, n), by its index."""
    own = jnp.arange(index.shape[0], dtype=jnp.int32)

    def pick(values: Array) -> Array:
        """Return each vehicle's entry (n,) of values (L, n) for its present leg."""
        return values if values.ndim == 1 else jnp.asarray(values).at[index, own].get(mode="promise_in_bounds")

    return map_tree(pick, route)


def _quintic(leg: Mission, time: Array, ramped: tuple[Array, Array, Array]) -> tuple[Array, ...]:
    """Return distance, speed and acceleration of a rest-to-rest quintic at a time [s]; ``ramped`` for other legs."""
    assert leg.polynomial is not None
    seconds = jnp.maximum(leg.cruise_s, 1e-6)
    x = jnp.clip(time / seconds, 0.0, 1.0)
    rest = 1.0 - x
    own = (
        leg.peak * seconds * (x * x * x * (10.0 + x * (6.0 * x - 15.0))),
        leg.peak * (30.0 * x * x * rest * rest),
        leg.peak * (60.0 * x * rest * (1.0 - 2.0 * x)) / seconds,
    )
    return tuple(jnp.where(leg.polynomial, a, b) for a, b in zip(own, ramped, strict=True))


def _round(leg: Mission, circle: Orbits, way: Array, speed: Array, along: Array, due: PathSetpoint) -> PathSetpoint:
    """Return the set-point on the circle at a distance ``way`` [m] along it for circular legs, else ``due``."""
    angle = wrap_angle(way * circle.curvature)
    sine, cosine = sincos(angle)
    north = circle.arm_north * cosine - circle.arm_east * sine
    east = circle.arm_north * sine + circle.arm_east * cosine
    # Forward is across the arm; inwards is against it.
    ahead_north, ahead_east = -east * circle.curvature, north * circle.curvature
    # Of a leg without an arm the angle has no slope.
    heading = jnp.arctan2(ahead_east, jnp.where(circle.flown, ahead_north, 1.0))
    inward = circle.curvature * circle.curvature * speed * speed
    zero = jnp.zeros_like(north)
    begin = leg.begin_ned
    place = Vec3(begin.x + north - circle.arm_north, begin.y + east - circle.arm_east, begin.z)
    own = PathSetpoint(
        place,
        Vec3(speed * ahead_north, speed * ahead_east, zero),
        Vec3(along * ahead_north - inward * north, along * ahead_east - inward * east, zero),
        jnp.where(circle.along, heading, leg.yaw),
    )
    chosen: PathSetpoint = map_tree(lambda a, b: jnp.where(circle.flown, a, b), own, due)
    return chosen
