"""Metrics of each vehicle's flight, accumulated in flight, so that no log is needed."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax import Array

from qrsim.control import Mission, MissionState, OffboardSetpoint, PathSetpoint, TrackSetpoint, WaypointSetpoint
from qrsim.core.arrays import Floats
from qrsim.core.pairs import joined, two_sum
from qrsim.core.tree import concatenated, quantity, record, replace, select
from qrsim.core.vectors import Vec3, root
from qrsim.interface.breaches import Breaches, breach_metrics
from qrsim.interface.consistency import Looks
from qrsim.interface.crowds import overfull_of_fleets, warn_of_overfull
from qrsim.interface.endurance import Consumption, charges, endurance_s
from qrsim.interface.extremes import Extreme
from qrsim.interface.fix_errors import FixErrors, differs
from qrsim.interface.takeovers import Takeovers, takeover_metrics
from qrsim.models.vehicles.commands import fields_of
from qrsim.world.state import FleetState, State, World

T = TypeVar("T")
# Beyond this number of vehicles the smallest distance between two is not looked for.
MOST_FOR_SEPARATION = 64
# A set-point so far below the ground [m] is one of a landing.
BELOW_M = 0.05
# A floor of the area that is less than this above the ground [m] is the ground.
GROUND_M = 0.01
# Of what estimators state: metrics "anees" of all errors, "anees_position" of a block.
CONSISTENCY = ("every", "position", "velocity", "attitude", "bias")


@record
class Flight:
    """Accumulated metrics of n vehicles of a world, each (n,)."""

    ticks: Array = quantity(doc="int32 ticks flown")
    distance: Array = quantity(unit="m", doc="length of the true path")
    position_ned: Vec3 = quantity(unit="m", doc="true position at the last tick")
    leg_start: Vec3 = quantity(unit="m", doc="where the leg being flown begins")
    leg_end: Vec3 = quantity(unit="m", doc="waypoint being flown to")
    tracked: Array = quantity(doc="int32 ticks flown along a leg")
    tracking_square: Array = quantity(unit="m^2", doc="sum of the squared distances from the leg being flown")
    tracking: Extreme = quantity(doc="distance from the leg being flown [m]")
    fixes: FixErrors = quantity(doc="errors of the fixes")
    wind: Extreme = quantity(doc="speed of the air [m/s], gusts included")
    closeness: Extreme = quantity(doc="minus the distance to the nearest other vehicle [m]")
    outwards: Extreme = quantity(doc="minus the distance to the nearest limit of the area but the ground [m]")
    sides: Array = quantity(unit="m", doc="smallest distance to the sides of the area")
    ceiling: Array = quantity(unit="m", doc="smallest distance to its ceiling")
    floor: Array = quantity(unit="m", doc="smallest distance to its floor, NaN where that is the ground")
    charge: Array = quantity(unit="1", doc="lowest charge of the battery, NaN without one")
    clipped: Array = quantity(doc="int32 ticks whose command was clipped")
    stopped: Array = quantity(doc="int32 tick at which it stopped, -1 while it flies")
    position_low_ned: Vec3 | None = quantity(
        default=None, unit="m", doc="what single precision leaves out of position_ned"
    )
    distance_low: Array | None = quantity(default=None, unit="m", doc="what single precision leaves out of distance")
    looks: Looks | None = quantity(default=None, doc="at what estimators state; None where none states anything")
    consumption: Consumption | None = quantity(default=None, doc="of batteries in the air; None where none drains")
    takeovers: Takeovers | None = quantity(default=None, doc="of failsafes; None where no fleet has any")
    breaches: Breaches | None = quantity(default=None, doc="of zones; None where the area does not report them")


class FlightMetrics:
    """The metrics of a rollout: distance, tracking error, GNSS error, wind, separation, and why a vehicle stopped.

    They are of the start and of every tick after it. The separation is NaN for a single vehicle and for more than
    MOST_FOR_SEPARATION.
    """

    def init(self, world: World, state: State) -> Flight:
        """Return the metrics' accumulators after the initial state, which counts as a tick."""
        position = _of_all_fleets(state, lambda fleet: fleet.vehicle.position_ned)
        goal = _goal(world, state)
        like = position.x
        zero, count, none = jnp.zeros_like(like), jnp.zeros(like.shape, jnp.int32), Extreme.none(like)
        nothing = Flight(
            ticks=count,
            distance=zero,
            position_ned=position,
            leg_start=position,
            leg_end=goal,
            tracked=count,
            tracking_square=zero,
            tracking=none,
            fixes=FixErrors.none(world, state, like),
            wind=none,
            closeness=none,
            outwards=none,
            sides=none.value,
            ceiling=none.value,
            floor=none.value,
            charge=none.value,
            clipped=count,
            stopped=jnp.full(like.shape, -1, jnp.int32),
            position_low_ned=_low(state),
            distance_low=None if _low(state) is None else zero,
            looks=Looks.none(world, state),
            consumption=Consumption.none(world, state),
            takeovers=Takeovers.none(state, like),
            breaches=Breaches.none(world, like),
        )
        return self.update(nothing, world, state, jnp.int32(0))

    def update(self, flight: Flight, world: World, state: State, tick: Array) -> Flight:
        """Return the metrics' accumulators updated by the state at a tick."""
        flying = _of_all_fleets(state, lambda fleet: fleet.violation.code) == 0
        position = _of_all_fleets(state, lambda fleet: fleet.vehicle.position_ned)
        low = _low(state)
        goal = _goal(world, state)
        start = select(differs(goal, flight.leg_end), _or_else(flight.leg_end, flight.position_ned), flight.leg_start)
        error = _distance_from_leg(_minus(position, low, start), start, goal)
        radius = _radius(state)
        if radius is not None:
            error = jnp.where(radius == 0.0, error, _distance_from_circle(_minus(position, low, goal), radius))
        counted = flying & jnp.isfinite(error)
        air = _of_all_fleets(state, lambda fleet: fleet.mean_wind_ned + fleet.gust_ned)
        clipped = _of_all_fleets(state, lambda fleet: fleet.command_clipped)
        distance, distance_low = _farther(flight, position, low, flying)
        inside = flying & _moves(world)
        sides, ceiling, floor = _clearances(world, position)
        nearest = jnp.fmin(jnp.minimum(sides, ceiling), floor)
        flight = replace(
            flight,
            distance=distance,
            distance_low=distance_low,
            ticks=flight.ticks + _as_int(flying & (tick > 0)),
            position_ned=position,
            position_low_ned=low,
            leg_start=start,
            leg_end=goal,
            tracked=flight.tracked + _as_int(counted),
            tracking_square=flight.tracking_square + jnp.where(counted, error * error, 0.0),
            tracking=flight.tracking.update(error, tick, position, counted),
            wind=flight.wind.update(air.norm(), tick, position, flying),
            outwards=flight.outwards.update(-nearest, tick, position, inside),
            sides=_smaller(flight.sides, sides, inside),
            ceiling=_smaller(flight.ceiling, ceiling, inside),
            floor=_smaller(flight.floor, floor, inside),
            charge=jnp.fmin(flight.charge, charges(world, state)),
            clipped=flight.clipped + _as_int(clipped & flying),
            stopped=jnp.where((flight.stopped < 0) & ~flying, tick, flight.stopped),
        )
        if flying.shape[0] <= MOST_FOR_SEPARATION:
            # As seen from the first of them, so that what is near is not rounded to what is far from the origin.
            closeness = -_nearest(_minus(position, low, position.map(lambda axis: axis[:1])))
            flight = replace(flight, closeness=flight.closeness.update(closeness, tick, position, flying))
        if flight.looks is not None:
            flight = replace(flight, looks=flight.looks.update(world, state, tick, flying))
        if flight.consumption is not None:
            in_time = flying & (tick > 0)
            flight = replace(flight, consumption=flight.consumption.update(world, state, in_time))
        if flight.takeovers is not None:
            flight = replace(flight, takeovers=flight.takeovers.update(state, tick, position, flying))
        if flight.breaches is not None:
            flight = replace(flight, breaches=flight.breaches.update(world, position, inside, tick))
        return replace(flight, fixes=flight.fixes.update(world, state, tick, flying))

    def finish(self, flight: Flight, world: World, state: State) -> dict[str, Floats]:
        """Return the metrics by name, each (W, n), from the accumulators of W worlds (NumPy arrays) and their last
        state."""
        dt = world.time_step

        def mean(total: npt.ArrayLike, count: npt.ArrayLike) -> Floats:
            """Return a sum divided by a count, NaN for a count of 0."""
            sums, counts = np.asarray(total), np.asarray(count)
            return np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)

        def root_mean(total: npt.ArrayLike, count: npt.ArrayLike) -> Floats:
            """Return the root mean square from a sum of squares and a count."""
            return np.sqrt(mean(total, count))

        def when(tick: Array) -> Floats:
            """Convert a tick to a time [s], -1 (never) to NaN."""
            return np.where(tick >= 0, tick * dt, np.nan)

        # The set-point of the start, which a policy replaces at once, is no leg that was flown.
        replaced = (np.asarray(flight.tracked) == 1) & (np.asarray(flight.ticks) > 0)
        found: dict[str, npt.ArrayLike] = {
            "flown_s": flight.ticks * dt,
            "distance_m": joined(flight.distance, flight.distance_low),
            "tracking_error_rms_m": np.where(replaced, np.nan, root_mean(flight.tracking_square, flight.tracked)),
            **flight.fixes.finish(dt),
            "clipped_s": flight.clipped * dt,
            "charge_min": flight.charge,
            "endurance_s": endurance_s(flight.consumption, np.asarray(flight.charge), dt),
            "fence_lateral_min_m": flight.sides,
            "fence_ceiling_min_m": flight.ceiling,
            "fence_floor_min_m": flight.floor,
            "unfinished": _unfinished(world, state),
            **takeover_metrics(flight.takeovers, np.asarray(flight.charge), dt),
            **breach_metrics(flight.breaches, dt),
            "stopped_at_s": when(flight.stopped),
            "reason": np.concatenate([fleet.violation.code for fleet in state.fleets], axis=-1),
            "reason_value": np.concatenate([fleet.violation.value for fleet in state.fleets], axis=-1),
        }
        extremes = {"tracking_error_max": flight.tracking, "wind_max": flight.wind, "fix_lost": flight.fixes.loss}
        smallest = {"separation_min": flight.closeness, "fence_distance_min": flight.outwards}
        for name, extreme in {**extremes, **smallest}.items():
            if name != "fix_lost":
                unit = "m_s" if name == "wind_max" else "m"
                found[f"{name}_{unit}"] = -extreme.value if name in smallest else extreme.value
            found[f"{name}_at_s"] = when(extreme.tick)
            found[f"{name}_position_ned"] = np.stack(jax.tree.leaves(extreme.position_ned), axis=-1)
        for name in ("tracking_error_max_m", "tracking_error_max_at_s", "tracking_error_max_position_ned"):
            found[name] = np.where(replaced[..., None] if name.endswith("ned") else replaced, np.nan, found[name])
        looks, nothing = flight.looks, np.full(np.shape(flight.charge), np.nan)
        for what in CONSISTENCY:
            name = "anees" if what == "every" else f"anees_{what}"
            found[name] = nothing if looks is None else mean(getattr(looks.total, what), looks.count)
        position = joined(flight.position_ned, flight.position_low_ned)
        found["position_ned"] = np.stack(jax.tree.leaves(position), axis=-1)
        warn_of_overfull(world, state)
        overfull = overfull_of_fleets(world, state)
        if overfull is not None:
            found["neighbours_overfull"] = overfull
        if world.radio is not None:
            found |= {f"radio_{name}": count for name, count in world.radio.counted(state.radio).items()}
        return {name: np.asarray(values) for name, values in found.items()}


def _of_all_fleets(state: State, pick: Callable[[FleetState], T]) -> T:
    """Return ``pick(state)`` of every fleet's state, concatenated over all fleets to arrays (n,)."""
    return concatenated([pick(fleet) for fleet in state.fleets])


def _low(state: State) -> Vec3 | None:
    """Return the rounding remainders of all vehicles' positions in single precision, None in double precision."""
    if state.fleets[0].position_low_ned is None:
        return None
    return _of_all_fleets(state, lambda fleet: fleet.position_low_ned)


def _minus(position: Vec3, low: Vec3 | None, place: Vec3) -> Vec3:
    """Return a position minus a place [m]; ``low``: the position's rounding remainder, or None."""
    offset = position - place
    return offset if low is None else offset + low


def _farther(flight: Flight, position: Vec3, low: Vec3 | None, flying: Array) -> tuple[Array, Array | None]:
    """Return the distance flown (n,) [m] updated by a tick, and its rounding remainder (None in double precision)."""
    if low is None:
        way = (position - flight.position_ned).norm()
        return flight.distance + jnp.where(flying, way, 0.0), None
    assert flight.position_low_ned is not None
    assert flight.distance_low is not None
    way = (position - flight.position_ned + (low - flight.position_low_ned)).norm()
    return two_sum(flight.distance, flight.distance_low + jnp.where(flying, way, 0.0))


def _as_int(counts: Array) -> Array:
    """Convert a bool or integer array to int32."""
    return counts.astype(jnp.int32)


def _moves(world: World) -> Array:
    """Return which vehicles fly by commands, (n,) bool, so that their clearance from all limits counts."""
    each = [
        np.full(fleet.size, bool(fields_of(fleet.vehicle.command_type)) and not fleet.vehicle.rides)
        for fleet in world.fleets
    ]
    return jnp.asarray(np.concatenate(each))


def _unfinished(world: World, state: State) -> Floats:
    """Return 1 for each vehicle, (W, n), that was still flying a mission which has an end, else 0."""
    each = []
    for fleet, now in zip(world.fleets, state.fleets, strict=True):
        flies = np.asarray(now.violation.code) == 0
        if now.failsafe is not None:
            # A failsafe ends the mission; its own metric counts it.
            flies = flies & (np.asarray(now.failsafe.action) == 0)
        if isinstance(now.guidance, MissionState) and isinstance(fleet.route, Mission):
            ends = np.asarray(fleet.route.following) == np.asarray(fleet.route.count) - 1
            last = np.asarray(now.guidance.index) >= np.asarray(fleet.route.count) - 1
            flies = flies & ends & ~(last & np.asarray(now.guidance.arrived))
        else:
            flies = np.zeros_like(flies)
        each.append(flies.astype(np.float64))
    return np.concatenate(each, axis=-1)


def _clearances(world: World, position_ned: Vec3) -> tuple[Array, Array, Array]:
    """Return the distances (n,) [m] from the flight area's sides, ceiling and floor; NaN for a floor that is the
    ground.

    So is a floor at z = 0 where the ground is lower: it ends no flight (``over_the_floor``), and vehicles stand below.
    """
    sides, ceiling, floor = world.area.clearances(position_ned)
    down = position_ned.z + floor
    counts = (down < world.ground_down(position_ned) - GROUND_M) & (down < -GROUND_M)
    return sides, ceiling, jnp.where(counts & jnp.isfinite(floor), floor, jnp.nan)


def _smaller(known: Array, new: Array, counts: Array) -> Array:
    """Return the smaller of ``known`` and ``new`` (n,), ignoring ``new`` where ``counts`` is False or it is not
    finite."""
    return jnp.fmin(known, jnp.where(counts & jnp.isfinite(new), new, jnp.nan))


def _goal(world: World, state: State) -> Vec3:
    """Return each vehicle's present waypoint NED (n,) [m]; NaN for other set-points and points below the ground."""
    goals = []
    for fleet in state.fleets:
        nowhere = fleet.vehicle.position_ned.map(lambda axis: jnp.full_like(axis, jnp.nan))
        setpoint = fleet.setpoint
        if isinstance(setpoint, WaypointSetpoint | OffboardSetpoint | PathSetpoint | TrackSetpoint):
            # A landing follows a point that continues below the ground.
            below = setpoint.position_ned.z > world.ground_down(setpoint.position_ned) + BELOW_M
            goals.append(select(below, nowhere, setpoint.position_ned))
        else:
            goals.append(nowhere)
    return concatenated(goals)


def _radius(state: State) -> Array | None:
    """Return the radius (n,) [m] of the circle that each vehicle follows, 0 on a line; None if no fleet follows
    circles."""
    if not any(isinstance(fleet.setpoint, TrackSetpoint) for fleet in state.fleets):
        return None
    return jnp.concatenate(
        [
            fleet.setpoint.radius
            if isinstance(fleet.setpoint, TrackSetpoint)
            else jnp.zeros_like(fleet.vehicle.position_ned.x)
            for fleet in state.fleets
        ]
    )


def _distance_from_circle(offset: Vec3, radius: Array) -> Array:
    """Return the distance (n,) [m] from a level circle of ``radius`` [m] at an offset (n,) [m] from its centre."""
    beside = root(offset.x * offset.x + offset.y * offset.y) - jnp.abs(radius)
    return root(beside * beside + offset.z * offset.z)


def _or_else(preferred: Vec3, other: Vec3) -> Vec3:
    """Return ``preferred``, with the vector of ``other`` where it is NaN."""
    return select(jnp.isfinite(preferred.x), preferred, other)


def _distance_from_leg(offset: Vec3, start: Vec3, end: Vec3) -> Array:
    """Return the distance (n,) [m] of a point from a leg, the segment ``start`` to ``end``, which may coincide;
    ``offset``: the point minus ``start``.

    Args:
        offset: position minus start.
        start, end: of the leg.
    """
    leg = end - start
    square = leg.dot(leg)
    along = jnp.clip(offset.dot(leg) / jnp.where(square > 0.0, square, 1.0), 0.0, 1.0)
    return (offset - leg * along).norm()


def _nearest(position: Vec3) -> Array:
    """Return each vehicle's distance (n,) [m] to its nearest other vehicle; infinite for a single vehicle."""
    offsets = [axis[:, None] - axis[None, :] for axis in (position.x, position.y, position.z)]
    square = sum(offset * offset for offset in offsets)
    itself = jnp.eye(position.x.shape[0], dtype=bool)
    return jnp.sqrt(jnp.min(jnp.where(itself, jnp.inf, square), axis=1))


# One for all rollouts, so that they share their compiled programs.
FLIGHT_METRICS = FlightMetrics()
