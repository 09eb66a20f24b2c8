"""Metrics of missions: when each vehicle finished, the charge that was left, and the margins while it flew."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax import Array

from qrsim.control import Mission, MissionState
from qrsim.core.arrays import Floats
from qrsim.core.tree import quantity, record, replace, select
from qrsim.core.vectors import Vec3
from qrsim.interface.endurance import airborne, charges
from qrsim.interface.extremes import Extreme
from qrsim.interface.metrics import FLIGHT_METRICS, MOST_FOR_SEPARATION, Flight
from qrsim.models.vehicles.commands import fields_of
from qrsim.world.state import State, World

# A world ends when every vehicle has finished, or landed by a failsafe, and has stayed so for this time [s].
STANDS_S = 2.0
# Names of the margins: the smallest distance [m] in flight, each also with "_at_s" and "_leg".
MARGINS = ("ground_min", "obstacle_min", "fence_horizontal_min", "ceiling_min", "air_separation_min")


@record
class Margin:
    """The smallest distance of each vehicle (n,) in flight, with its moment and leg."""

    extreme: Extreme = quantity(doc="minus the distance [m]")
    leg: Array = quantity(doc="int32 number of the leg then, -1 before the first")

    @staticmethod
    def none(like: Array) -> Margin:
        """Return an empty record of n vehicles' smallest distances, shaped as ``like`` (n,)."""
        return Margin(Extreme.none(like), jnp.full(like.shape, -1, jnp.int32))

    def update(self, distance: Array, leg: Array, tick: Array, position_ned: Vec3, counts: Array) -> Margin:
        """Return the record with ``distance`` (n,) [m], leg, tick and position taken over where it is finite and
        smaller and ``counts`` is True."""
        found = self.extreme.update(-distance, tick, position_ned, counts & jnp.isfinite(distance))
        return Margin(found, jnp.where(found.tick == tick, leg, self.leg))


@record
class MissionFlight:
    """Accumulated metrics of n vehicles of a world, each (n,) where nothing else is said."""

    flight: Flight = quantity(doc="those of every rollout")
    ended: Array = quantity(doc="() bool: the world has ended, and nothing counts any more")
    home_ned: Vec3 = quantity(unit="m", doc="true position at the start")
    done: Array = quantity(doc="int32 ticks since it finished or was landed by a failsafe")
    finished: Array = quantity(doc="int32 tick at which the mission was finished, -1 before it")
    down: Array = quantity(doc="int32 tick at which it was done, -1 before it")
    charge: Array = quantity(unit="1", doc="charge of the battery when it was done, or at the last tick")
    flies: Array = quantity(doc="bool: it was in the air at the last tick")
    leg: Array = quantity(doc="int32 number of the last leg before it stopped, -1 before the first")
    margins: tuple[Margin, ...] = quantity(doc="in the order of MARGINS")


class MissionMetrics:
    """The metrics of ``FlightMetrics`` and those of missions, up to the end of a world.

    A world ends when every vehicle has stopped, has finished its mission, or has been landed by a failsafe. After two
    further seconds all metrics keep their values, so that they do not depend on the length of the run.
    """

    def init(self, world: World, state: State) -> MissionFlight:
        """Return the metrics' accumulators after the initial state."""
        flight = FLIGHT_METRICS.init(world, state)
        like = flight.position_ned.x
        count, never = jnp.zeros(like.shape, jnp.int32), jnp.full(like.shape, -1, jnp.int32)
        return MissionFlight(
            flight=flight,
            ended=jnp.zeros((), bool),
            home_ned=flight.position_ned,
            done=count,
            finished=never,
            down=never,
            charge=charges(world, state),
            flies=airborne(world, state),
            leg=never,
            margins=tuple(Margin.none(like) for _ in MARGINS),
        )

    def update(self, memory: MissionFlight, world: World, state: State, tick: Array) -> MissionFlight:
        """Return the metrics' accumulators updated by the state at a tick."""
        flight = FLIGHT_METRICS.update(memory.flight, world, state, tick)
        flying = flight.stopped < 0
        flies = airborne(world, state)
        finished, landed, leg, cruises = _progress(world, state, flies)
        done = jnp.where((finished | landed) & flying, memory.done + 1, 0)
        over = (done >= round(STANDS_S / world.time_step)) | ~flying | ~_moving(world)
        distances = _distances(world, flight.position_ned, flies & flying)
        counts = (cruises & flying, *[flies & flying] * (len(MARGINS) - 1))
        margins = tuple(
            margin.update(distance, leg, tick, flight.position_ned, counted)
            for margin, distance, counted in zip(memory.margins, distances, counts, strict=True)
        )
        now = replace(
            memory,
            flight=flight,
            ended=jnp.all(over),
            done=done,
            finished=jnp.where((memory.finished < 0) & finished & flying, tick, memory.finished),
            down=jnp.where((memory.down < 0) & (done > 0), tick, memory.down),
            charge=jnp.where((done > 0) | ~flying, memory.charge, charges(world, state)),
            flies=flies,
            leg=jnp.where(flying, leg, memory.leg),
            margins=margins,
        )
        return select(memory.ended, memory, now)

    def finish(self, memory: MissionFlight, world: World, state: State) -> dict[str, Floats]:
        """Return the metrics by name, each (W, n), from the accumulators of W worlds (NumPy arrays) and their last
        state."""
        dt = world.time_step

        def when(tick: npt.ArrayLike) -> Floats:
            """Convert a tick to a time [s], -1 (never) to NaN."""
            return np.where(np.asarray(tick) >= 0, np.asarray(tick) * dt, np.nan)

        found = FLIGHT_METRICS.finish(memory.flight, world, state)
        stopped = ~np.isnan(found["stopped_at_s"]) & (np.asarray(memory.leg) >= 0)
        ended = memory.flight.position_ned
        north, east = ended.x - memory.home_ned.x, ended.y - memory.home_ned.y
        found |= {
            "finished": np.where(_on_missions(world, state), np.asarray(memory.finished) >= 0, np.nan),
            "finished_s": when(memory.finished),
            "down_s": when(memory.down),
            "stopped_at_leg": np.where(stopped, np.asarray(memory.leg), np.nan),
            "charge_end": np.asarray(memory.charge),
            "home_m": np.hypot(north, east),
            "in_the_air": (np.asarray(memory.flies) & np.asarray(_moving(world))).astype(np.float64),
        }
        for name, margin in zip(MARGINS, memory.margins, strict=True):
            leg = np.asarray(margin.leg)
            found[f"{name}_m"] = -np.asarray(margin.extreme.value)
            found[f"{name}_at_s"] = when(margin.extreme.tick)
            found[f"{name}_leg"] = np.where(leg >= 0, leg, np.nan)
            found[f"{name}_position_ned"] = np.stack(jax.tree.leaves(margin.extreme.position_ned), axis=-1)
        return found

    def ended(self, memory: MissionFlight) -> Array:
        """Return whether all missions of the world have ended, () bool."""
        return memory.ended


def _on_missions(world: World, state: State) -> npt.NDArray[np.bool_]:
    """Return which vehicles fly a mission, (n,) bool."""
    each = [
        np.full(fleet.size, isinstance(now.guidance, MissionState) and bool(fields_of(fleet.vehicle.command_type)))
        for fleet, now in zip(world.fleets, state.fleets, strict=True)
    ]
    return np.concatenate(each)


def _moving(world: World) -> Array:
    """Return which vehicles fly by commands, (n,) bool; the end of a flight does not wait for others."""
    each = [np.full(fleet.size, bool(fields_of(fleet.vehicle.command_type))) for fleet in world.fleets]
    return jnp.asarray(np.concatenate(each))


def _progress(world: World, state: State, flies: Array) -> tuple[Array, Array, Array, Array]:
    """Return, each (n,): mission finished, landed by a failsafe, number of the present leg, leg is a cruise; ``flies``:
    in the air.

    A cruise is a leg between take-off and landing. Legs count from 1.
    """
    found: list[tuple[Array, Array, Array, Array]] = []
    row = 0
    for fleet, now in zip(world.fleets, state.fleets, strict=True):
        own = flies[row : row + fleet.size]
        row += fleet.size
        no, count = jnp.zeros_like(own), jnp.zeros(own.shape, jnp.int32)
        taken = no if now.failsafe is None else now.failsafe.action > 0
        landed = taken & ~own
        if not (isinstance(now.guidance, MissionState) and isinstance(fleet.route, Mission)):
            found.append((no, landed, count - 1, no))
            continue
        mission = now.guidance
        chosen = jnp.arange(fleet.route.lands.shape[0])[:, None] == mission.index[None, :]
        ends = fleet.route.lands | fleet.route.rises
        cruises = own & ~jnp.any(chosen & ends, axis=0) & ~mission.low & ~taken
        number = jnp.sum(jnp.where(chosen, fleet.route.number, 0), axis=0).astype(jnp.int32)
        found.append((mission.finished, landed, number, cruises))
    finished, landed, number, cruises = (jnp.concatenate(parts) for parts in zip(*found, strict=True))
    return finished, landed, number, cruises


def _distances(world: World, position_ned: Vec3, flying: Array) -> tuple[Array, ...]:
    """Return a tuple of distances (n,) [m], in the order of MARGINS; infinite or NaN where there is nothing to be
    near."""
    obstacle, _ = world.obstacles.nearest(position_ned)
    sides, ceiling, _ = world.area.clearances(position_ned)
    height = world.ground_down(position_ned) - position_ned.z
    return height, obstacle, sides, ceiling, _between(position_ned, flying)


def _between(position_ned: Vec3, flying: Array) -> Array:
    """Return each vehicle's distance (n,) [m] to the nearest other in the air; infinite without one, or in large
    fleets."""
    count = flying.shape[0]
    if not 2 <= count <= MOST_FOR_SEPARATION:
        return jnp.full_like(position_ned.x, jnp.inf)
    offsets = [axis[:, None] - axis[None, :] for axis in (position_ned.x, position_ned.y, position_ned.z)]
    square = sum(offset * offset for offset in offsets)
    counted = flying[None, :] & ~jnp.eye(count, dtype=bool)
    return jnp.sqrt(jnp.min(jnp.where(counted, square, jnp.inf), axis=1))


# One for all rollouts, so that they share their compiled programs.
MISSION_METRICS = MissionMetrics()
