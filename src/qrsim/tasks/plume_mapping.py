"""Plume mapping (docs/explanation/task_design.md), as in the reference implementation."""

from __future__ import annotations

import math
from typing import ClassVar, cast

import jax
import jax.numpy as jnp
from jax import Array, lax

from qrsim.control import VelocitySetpoint
from qrsim.core.noise import Draw
from qrsim.core.tree import parameter, quantity, record, replace, setting
from qrsim.core.vectors import Vec3
from qrsim.models.scene.contracts import Area
from qrsim.models.scene.plume import PuffPlume, PuffState, Wind
from qrsim.models.scene.uniform import uniform
from qrsim.models.sensors.concentration import ConcentrationReading
from qrsim.tasks.agents import BELIEVED, Axis, action_period, believed, fleet_of, leaving, only, penalty, velocity_axes
from qrsim.tasks.contracts import Task
from qrsim.tasks.perceived import sensed, sensed_axes, senses
from qrsim.world.episode import surroundings
from qrsim.world.state import Action, State, World

# Places looked at for each location before it is taken where it is.
MOST_LOOKS = 100_000
# Distances between samples are taken to be at least this, so that equal samples have a logarithm.
SMALLEST_DISTANCE = 1e-12


@record
class PlumeMemory:
    """Memory of an episode."""

    locations_ned: Vec3 = quantity(unit="m", doc="(L,) locations of the concentration estimates")
    draw: Draw = quantity(doc="of what the score draws")


@record
class PlumeMapping(Task):
    """Estimate the concentration at given locations.

    Every step gives 0. What counts is the score of what an agent hands in at the end: for steady plumes the
    concentration at each of L locations, and minus the sum of its squared errors; for puffs K samples at each, (L, K),
    and minus the Kullback-Leibler divergence of their joint distribution from that of as many reference samples.
    """

    threshold: Array = parameter(
        default=1e-3,
        unit="1",
        doc="least concentration at a location in the plume, relative to the plume's scale",
        above=0.0,
    )
    sample_gap: Array = parameter(default=60.0, unit="s", doc="time between two reference samples of puffs", above=0.0)
    penalty: Array = penalty()
    leave: bool = leaving()
    locations: int = setting(default=100, unit="1", doc="number of locations", minimum=1, maximum=10_000)
    anywhere: int = setting(
        default=20, unit="1", doc="number of these placed anywhere in the area", minimum=0, maximum=10_000
    )
    samples: int = setting(
        default=500, unit="1", doc="reference samples per location, for puffs", minimum=2, maximum=100_000
    )
    fleet: str = setting(default="helicopters", doc="name of the fleet whose vehicles are the agents")
    sensor: str = setting(default="concentration", doc="name of their concentration sensor")
    period: float = action_period(1.0)
    senses: tuple[str, ...] = senses()

    axes: ClassVar[tuple[Axis, ...]] = velocity_axes(3.0, "ned")
    hands_in: ClassVar[bool] = True
    asks_for: ClassVar[type | None] = VelocitySetpoint

    @property
    def ids(self) -> int:
        """Number of random streams that ``init`` draws from: one per location or source."""
        return self.locations

    def init(self, world: World, state: State, draw: Draw) -> PlumeMemory:
        """Return the memory with random locations at which agents must state the concentration."""
        world = world.with_drawn(state.drawn)
        around = surroundings(world, state.contents, jnp.int32(0))
        wind, plume = around.carrying_wind(draw.like.dtype), world.contents.plume
        least = self.threshold * plume.scale(state.contents.plume)
        free = jnp.arange(self.locations) < self.anywhere

        def place(look: Array) -> Vec3:
            """Return random positions (L,) in the area; ``look``: number of the draw, from 0."""
            bounds = [(getattr(world.area, f"{axis}_min"), getattr(world.area, f"{axis}_max")) for axis in "xyz"]
            return Vec3(*(uniform(draw, 3 * look + i, low, high) for i, (low, high) in enumerate(bounds)))

        def again(now: tuple[Array, Vec3, Array]) -> tuple[Array, Vec3, Array]:
            """Draw positions again for locations that are not accepted; ``now``: (draw number, positions, accepted)."""
            look, kept, done = now
            tried = place(look)
            taken = Vec3(*(jnp.where(done, getattr(kept, axis), getattr(tried, axis)) for axis in "xyz"))
            return look + 1, taken, done | free | (plume.mean(state.contents.plume, tried, wind) > least)

        start = (jnp.int32(0), place(jnp.int32(0)), jnp.zeros(self.locations, bool))
        _, found, _ = lax.while_loop(lambda now: (now[0] < MOST_LOOKS) & ~jnp.all(now[2]), again, start)
        return PlumeMemory(found, replace(draw, tick=draw.tick + 1))

    def commands(self, memory: PlumeMemory, world: World, action: Array) -> tuple[Action, ...]:
        """Convert actions (n, 3), velocities [m/s], to velocity set-points with the heading north."""
        return only(world, self.fleet, VelocitySetpoint(Vec3.of(action), jnp.zeros_like(action[:, 0])))

    def judge(
        self, memory: PlumeMemory, world: World, state: State, step: Array, steps: Array
    ) -> tuple[PlumeMemory, Array]:
        """Return the memory and a reward of 0 (n,): only the answers at the end are rewarded, by ``score``."""
        _, fleet = fleet_of(world, state, self.fleet)
        return memory, jnp.zeros_like(fleet.vehicle.position_ned.x)

    def observe(self, memory: PlumeMemory, world: World, state: State) -> dict[str, Array]:
        """Return the vehicles' observations by name: estimated state, measured concentration, locations.

        ``vehicle`` (n, 10) is what it believes of itself and the last concentration it measured, ``locations``
        (n, L, 3) where the concentration is asked for [m]. ``sensed`` (n, S) is what the sensors of ``senses`` say.
        """
        fleet, fleet_state = fleet_of(world, state, self.fleet)
        reading = fleet_state.readings[fleet.sensor_names.index(self.sensor)]
        smelt = cast(ConcentrationReading, reading).concentration
        # Nothing is smelt any more by a vehicle that has stopped.
        last = jnp.where(jnp.isfinite(smelt), smelt, 0.0)
        locations = memory.locations_ned.stack()
        more = {"sensed": sensed(world, state, self.fleet, self.senses)} if self.senses else {}
        return more | {
            "vehicle": jnp.concatenate([believed(fleet_state), last[:, None]], axis=-1),
            "locations": jnp.broadcast_to(locations[None], (fleet.size, *locations.shape)),
        }

    def sees(self, world: World) -> dict[str, tuple[Axis, ...]]:
        """Describe the values of each named part of an observation by name, unit and range."""
        more = {"sensed": sensed_axes(world, self.fleet, self.senses)} if self.senses else {}
        # Locations are drawn within the area.
        area = world.area
        limits = [
            Axis(name, "m", float(getattr(area, f"{axis}_min")), float(getattr(area, f"{axis}_max")))
            for name, axis in (("north", "x"), ("east", "y"), ("down", "z"))
        ]
        asked = tuple(
            Axis(f"location_{i}_{limit.name}", limit.unit, limit.low, limit.high)
            for i in range(self.locations)
            for limit in limits
        )
        return more | {"vehicle": (*BELIEVED, Axis("concentration", "1")), "locations": asked}

    def answer_shape(self, world: World) -> tuple[int, ...]:
        """Return the shape of an agent's answer: concentrations (L,), or K samples of them (L, K) for puffs."""
        puffs = isinstance(world.contents.plume, PuffPlume)
        return (self.locations, self.samples) if puffs else (self.locations,)

    def score(self, memory: PlumeMemory, world: World, state: State, answer: Array) -> Array:
        """Return the score (n,) of the agents' answers, (n, L) or (n, L, K), against the true plume."""
        world = world.with_drawn(state.drawn)
        around = surroundings(world, state.contents, jnp.int32(0))
        plume, sources = world.contents.plume, state.contents.plume
        wind = around.carrying_wind(answer.dtype)
        if not isinstance(plume, PuffPlume):
            error = answer - plume.mean(sources, memory.locations_ned, wind)[None]
            return -jnp.sum(error * error, axis=-1)
        reference = self.reference(memory, plume, sources, wind, world.area)
        return -jax.vmap(lambda samples: divergence(reference, samples.T))(answer)

    def reference(self, memory: PlumeMemory, plume: PuffPlume, sources: PuffState, wind: Wind, area: Area) -> Array:
        """Simulate K samples of the concentration (K, L) of puffs at the L locations, ``sample_gap`` [s] apart.

        They are of a flight of puffs of its own that has gone on for long: of the same sources, other puffs.
        """
        draw = replace(memory.draw, stream=replace(memory.draw.stream, ids=jnp.arange(plume.most, dtype=jnp.uint32)))

        def advance(now: tuple[Array, PuffState]) -> tuple[Array, PuffState]:
            """Advance the puffs by one of their steps; ``now``: (step number, puffs)."""
            tick, puffs = now
            return tick + 1, plume.step(puffs, replace(draw, tick=draw.tick + tick))

        # The flight has gone on for long when every source has released as many puffs as can be in the air.
        start = lax.while_loop(lambda now: jnp.any(now[1].released < plume.puffs), advance, (jnp.int32(0), sources))
        steps = jnp.round(jnp.asarray(self.sample_gap) / plume.period).astype(jnp.int32)

        def sample(now: tuple[Array, PuffState], _: None) -> tuple[tuple[Array, PuffState], Array]:
            """Advance ``now``, (step number, puffs), by the gap between samples; return it and concentrations (L,)."""
            now = lax.fori_loop(0, steps, lambda _, before: advance(before), now)
            since = jnp.zeros((), now[1].age.dtype)
            return now, plume.concentration(now[1], memory.locations_ned, wind, area, since)

        _, found = lax.scan(sample, start, length=self.samples)
        return found


def divergence(one: Array, other: Array) -> Array:
    """Estimate the Kullback-Leibler divergence D(P | Q), (), from samples ``one`` of P (n, d), ``other`` of Q (m, d).

    By distances to nearest neighbours: (d/n) sum ln(nu/rho) + ln(m/(n-1)), with rho the distance of a sample of P to
    the next of P and nu that to the next of Q (Wang, Kulkarni, Verdu, IEEE Trans. Inf. Theory 55, 2009, eq. 5).
    """
    count, dimensions = one.shape

    def nearest(number: Array) -> tuple[Array, Array]:
        """Return the distances from a sample of P to the nearest other sample of P and to the nearest of Q."""
        own = jnp.sum((one - one[number][None]) ** 2, axis=1).at[number].set(jnp.inf)
        return jnp.sqrt(jnp.min(own)), jnp.sqrt(jnp.min(jnp.sum((other - one[number][None]) ** 2, axis=1)))

    rho, nu = (jnp.maximum(found, SMALLEST_DISTANCE) for found in lax.map(nearest, jnp.arange(count)))
    return dimensions * jnp.mean(jnp.log(nu / rho)) + math.log(other.shape[0] / (count - 1))
