"""Concentration of a substance released into the air (docs/explanation/models/scene.md).

Three fields: a Gaussian in space that nothing moves, the plume of steady releases in a wind, and single puffs that the
wind carries away. The last two spread as in Symington et al. (IROS 2014): s = 2 a x'^b, with x' the distance downwind
of the source at which the concentration is asked for, and reflect at the ground.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar

import jax.numpy as jnp
from jax import Array

from qrsim.core.fastmath import exp, log, sincos
from qrsim.core.noise import Draw
from qrsim.core.tree import parameter, quantity, record, replace, setting
from qrsim.core.vectors import Vec3
from qrsim.models.scene.contracts import Plume
from qrsim.models.scene.uniform import uniform, whole

# Of the box that a world's vehicles may be in, sources lie in this part, in height too.
INNER = 0.8
# A puff has left the box when what trails behind its middle, down to this part of its peak, has.
NEGLIGIBLE = 0.01
# Releases of one source that a step can tell apart; any more count from the next step on, at their own age.
RELEASES_PER_STEP = 4


@record
class Sources:
    """Positions of releases, (S,)."""

    position_ned: Vec3 = quantity(unit="m", doc="position")
    strength: Array = quantity(doc="rate, amount or peak, 0 where this episode has fewer sources")


def inner_box(area: Any, part: Array | float) -> tuple[Vec3, Vec3]:
    """Return the lowest and highest corner [m] of an area scaled by the factor ``part`` about its centre."""

    def shrunk(low: Array, high: Array) -> tuple[Array, Array]:
        """Return the interval [low, high] scaled by the factor ``part`` about its middle."""
        middle, half = 0.5 * (low + high), 0.5 * part * (high - low)
        return middle - half, middle + half

    x, y, z = shrunk(area.x_min, area.x_max), shrunk(area.y_min, area.y_max), shrunk(area.z_min, area.z_max)
    return Vec3(x[0], y[0], z[0]), Vec3(x[1], y[1], z[1])


def _placed(draw: Draw, area: object, least: int, most: int) -> tuple[Vec3, Array]:
    """Return random source positions (S,) [m] in the inner area, and (S,) bool: the source exists."""
    low, high = inner_box(area, INNER)
    position = Vec3(*(uniform(draw, i, getattr(low, axis), getattr(high, axis)) for i, axis in enumerate("xyz")))
    count = whole(draw, 3, least, most)[0]
    return position, jnp.arange(most, dtype=jnp.int32) < count


@record
class Wind:
    """The mean wind that carries a plume, ()."""

    speed: Array = quantity(unit="m/s", doc="speed 6 m above the ground")
    north: Array = quantity(unit="1", doc="direction of the wind, unit vector downwind")
    east: Array = quantity(unit="1", doc="direction of the wind, unit vector downwind")

    @staticmethod
    def of(velocity_ned: Vec3) -> Wind:
        """Return speed [m/s] and direction of the horizontal part of a wind velocity () [m/s] NED."""
        speed = jnp.sqrt(velocity_ned.x * velocity_ned.x + velocity_ned.y * velocity_ned.y)
        return Wind(speed, velocity_ned.x / speed, velocity_ned.y / speed)

    def along_across(self, offset_ned: Vec3) -> tuple[Array, Array]:
        """Return downwind and crosswind components [m] of offsets NED [m]."""
        along = self.north * offset_ned.x + self.east * offset_ned.y
        return along, self.north * offset_ned.y - self.east * offset_ned.x


def _count(which: str) -> int:
    """Return the field declaration of a setting: a number of plume sources."""
    return setting(default=1, unit="1", doc=f"{which} sources of an episode", minimum=1, maximum=100)


def _spread_factor() -> Array:
    """Return the field declaration of the factor a in a plume's spread 2 a x'^b over the downwind distance x'."""
    return parameter(default=0.33, unit="m^(2-b)", doc="a of the spread s = 2 a x'^b", above=0.0)


def _spread_exponent() -> Array:
    """Return the field declaration of the exponent b in a plume's spread 2 a x'^b."""
    return parameter(default=0.86, unit="1", doc="b of the spread s = 2 a x'^b", above=0.0, maximum=2.0)


@record
class NoPlume(Plume):
    """Clean air."""

    random: ClassVar[bool] = False

    @property
    def ids(self) -> int:
        """Number of random ids that the plume draws for: 0."""
        return 0

    def concentration(self, state: None, position_ned: Vec3, wind: Wind, area: object, since: Array) -> Array:
        """Return zero concentration at every position (n,)."""
        return jnp.zeros_like(position_ned.x)


@record
class GaussianState:
    """Gaussian sources of an episode, (S,)."""

    sources: Sources = quantity(doc="middles and peaks")
    std: Vec3 = quantity(unit="m", doc="standard deviation along each of its axes")
    yaw: Array = quantity(unit="rad", doc="heading of its first axis")


@record
class GaussianPlume(Plume):
    """A three-dimensional Gaussian around each source, independent of the wind."""

    peak: Array = parameter(default=1.0, unit="1", doc="concentration in the middle", above=0.0)
    std_min: Array = parameter(default=3.0, unit="m", doc="smallest standard deviation along an axis", above=0.0)
    std_max: Array = parameter(default=20.0, unit="m", doc="largest standard deviation along an axis", above=0.0)
    fewest: int = _count("fewest")
    most: int = _count("most")
    needs_wind: ClassVar[bool] = False

    @property
    def ids(self) -> int:
        """Number of random ids that the plume draws for: one for each of at most ``most`` sources."""
        return self.most

    def init(self, draw: Draw, area: object) -> GaussianState:
        """Return an episode's random plume sources (S,)."""
        position, there = _placed(draw, area, self.fewest, self.most)
        std = Vec3(*(uniform(draw, 4 + axis, self.std_min, self.std_max) for axis in range(3)))
        strength = jnp.where(there, self.peak, 0.0).astype(position.x.dtype)
        return GaussianState(Sources(position, strength), std, uniform(draw, 7, 0.0, math.pi))

    def concentration(self, state: GaussianState, position_ned: Vec3, wind: Wind, area: object, since: Array) -> Array:
        """Return the concentration (n,) at positions (n,) [m], the sum over all sources."""
        offset = _offsets(position_ned, state.sources.position_ned)
        sine, cosine = (part[None] for part in sincos(state.yaw))
        first = (cosine * offset.x + sine * offset.y) / state.std.x[None]
        second = (cosine * offset.y - sine * offset.x) / state.std.y[None]
        third = offset.z / state.std.z[None]
        square = first * first + second * second + third * third
        return jnp.sum(state.sources.strength[None] * exp(-0.5 * square), axis=-1)

    def mean(self, state: GaussianState, position_ned: Vec3, wind: Wind) -> Array:
        """Return the time-averaged concentration (n,) at positions [m], here the concentration itself."""
        return self.concentration(state, position_ned, wind, None, jnp.zeros((), position_ned.x.dtype))

    def scale(self, state: GaussianState) -> Array:
        """Return the largest strength () of the episode's sources, to scale concentrations."""
        return jnp.max(state.sources.strength)


def _offsets(position_ned: Vec3, source_ned: Vec3) -> Vec3:
    """Return the offsets (n, S) [m] of positions (n,) from sources (S,)."""
    return Vec3(*(getattr(position_ned, axis)[:, None] - getattr(source_ned, axis)[None] for axis in "xyz"))


def _reflected(position_ned: Vec3, source_ned: Vec3, spread: Array) -> Array:
    """Return the vertical factor (n, S) of a Gaussian plume: the plume itself plus its reflection at the ground."""
    height, source = -position_ned.z[:, None], -source_ned.z[None]
    return exp(-((height - source) ** 2) / spread) + exp(-((height + source) ** 2) / spread)


def _spread_at(factor: Array, exponent: Array, along: Array) -> Array:
    """Return 2 a x'^b [m^2], twice a plume's squared width, at downwind distances x' [m] of at least 1 mm."""
    return 2.0 * factor * exp(exponent * log(jnp.maximum(along, 1e-3)))


@record
class DispersionPlume(Plume):
    """The plume of steady releases in a steady wind.

    c = Q/(pi u s) exp(-y'^2/s) [exp(-(z-H)^2/s) + exp(-(z+H)^2/s)], zero upwind.
    """

    rate_min: Array = parameter(default=0.1, unit="1/s", doc="smallest rate of a release", above=0.0)
    rate_max: Array = parameter(default=2.5, unit="1/s", doc="largest rate of a release", above=0.0)
    spread_factor: Array = _spread_factor()
    spread_exponent: Array = _spread_exponent()
    fewest: int = _count("fewest")
    most: int = _count("most")
    needs_wind: ClassVar[bool] = True

    @property
    def ids(self) -> int:
        """Number of random ids that the plume draws for: one for each of at most ``most`` sources."""
        return self.most

    def init(self, draw: Draw, area: object) -> Sources:
        """Return an episode's random plume sources (S,)."""
        position, there = _placed(draw, area, self.fewest, self.most)
        return Sources(position, jnp.where(there, uniform(draw, 4, self.rate_min, self.rate_max), 0.0))

    def concentration(self, state: Sources, position_ned: Vec3, wind: Wind, area: object, since: Array) -> Array:
        """Return the concentration (n,) at positions (n,) [m], summed over sources; 0 upwind of all of them."""
        along, across = wind.along_across(_offsets(position_ned, state.position_ned))
        spread = _spread_at(self.spread_factor, self.spread_exponent, along)
        vertical = _reflected(position_ned, state.position_ned, spread)
        field = state.strength[None] / (math.pi * wind.speed * spread) * exp(-across * across / spread) * vertical
        return jnp.sum(jnp.where(along > 0.0, field, 0.0), axis=-1)

    def mean(self, state: Sources, position_ned: Vec3, wind: Wind) -> Array:
        """Return the time-averaged concentration (n,) at positions [m], here the concentration itself."""
        return self.concentration(state, position_ned, wind, None, jnp.zeros((), position_ned.x.dtype))

    def scale(self, state: Sources) -> Array:
        """Return the smallest emission rate () of the episode's sources, to scale concentrations."""
        return jnp.min(jnp.where(state.strength > 0.0, state.strength, jnp.inf))


@record
class PuffState:
    """Puffs of an episode: S sources, the last K puffs of each."""

    sources: Sources = quantity(doc="positions; strength 1 where there is a source")
    wait: Array = quantity(unit="s", doc="(S,) time until the next release")
    released: Array = quantity(doc="(S,) int32 releases so far")
    age: Array = quantity(unit="s", doc="(S, K) time since the release")
    amount: Array = quantity(doc="(S, K) amount, 0 where no puff is")


@record
class PuffPlume(Plume):
    """Single puffs at random times, which the wind carries.

    c = q/(pi s)^1.5 exp(-((x' - u t)^2 + y'^2)/s) [exp(-(z-H)^2/s) + exp(-(z+H)^2/s)], t the age of the puff, zero
    upwind. The reference prints (2 pi s)^1.5, which loses 65 % of the mass; as it is here the time integral of puffs
    is the dispersion plume.
    """

    amount_min: Array = parameter(default=0.1, unit="1", doc="smallest amount of a puff", above=0.0)
    amount_max: Array = parameter(default=2.5, unit="1", doc="largest amount of a puff", above=0.0)
    gap: Array = parameter(default=5.0, unit="s", doc="mean time between two puffs of a source", above=0.0)
    spread_factor: Array = _spread_factor()
    spread_exponent: Array = _spread_exponent()
    fewest: int = _count("fewest")
    most: int = _count("most")
    puffs: int = setting(
        default=256, unit="1", doc="most puffs of a source in the air at once", minimum=1, maximum=100_000
    )
    period: float = setting(
        default=0.5, unit="s", doc="interval between checks for a release, a multiple of the time step", above=0.0
    )
    needs_wind: ClassVar[bool] = True
    changes: ClassVar[bool] = True

    @property
    def ids(self) -> int:
        """Number of random ids that the plume draws for: one for each of at most ``most`` sources."""
        return self.most

    def init(self, draw: Draw, area: object) -> PuffState:
        """Return an episode's random sources (S,), before any puff is released."""
        position, there = _placed(draw, area, self.fewest, self.most)
        sources = Sources(position, there.astype(position.x.dtype))
        nothing = jnp.zeros((self.most, self.puffs), position.x.dtype)
        wait = -self.gap * log(uniform(draw, 4))
        return PuffState(sources, wait, jnp.zeros(self.most, jnp.int32), nothing, nothing)

    def step(self, state: PuffState, draw: Draw) -> PuffState:
        """Return the plume's state one period later: puffs older, due ones released."""
        state = replace(state, wait=state.wait - self.period, age=state.age + self.period)
        place = jnp.arange(self.puffs, dtype=jnp.int32)[None]
        for number in range(RELEASES_PER_STEP):
            due = state.wait <= 0.0
            here = due[:, None] & (place == (state.released % self.puffs)[:, None])
            amount = uniform(draw, 2 * number, self.amount_min, self.amount_max) * state.sources.strength
            gap = -self.gap * log(uniform(draw, 2 * number + 1))
            state = replace(
                state,
                age=jnp.where(here, -state.wait[:, None], state.age),
                amount=jnp.where(here, amount[:, None], state.amount),
                released=state.released + due.astype(jnp.int32),
                wait=jnp.where(due, state.wait + gap, state.wait),
            )
        return state

    def concentration(self, state: PuffState, position_ned: Vec3, wind: Wind, area: object, since: Array) -> Array:
        """Return the concentration (n,) at positions (n,) [m], ``since`` [s] after the plume's last step."""
        source = state.sources.position_ned
        along, across = wind.along_across(_offsets(position_ned, source))
        spread = _spread_at(self.spread_factor, self.spread_exponent, along)
        vertical = _reflected(position_ned, source, spread)
        flown = wind.speed * (state.age + since)
        amount = jnp.where(self._in_box(source, flown, wind, area), state.amount, 0.0)
        behind = along[..., None] - flown[None]
        passing = jnp.sum(amount[None] * exp(-behind * behind / spread[..., None]), axis=-1)
        scale = math.pi * spread
        field = passing / (scale * jnp.sqrt(scale)) * exp(-across * across / spread) * vertical
        return jnp.sum(jnp.where(along > 0.0, field, 0.0), axis=-1)

    def mean(self, state: PuffState, position_ned: Vec3, wind: Wind) -> Array:
        """Return the time-averaged concentration (n,) at positions [m], as if all puffs were of the largest amount."""
        plume = DispersionPlume(spread_factor=self.spread_factor, spread_exponent=self.spread_exponent)
        rate = state.sources.strength * (self.amount_max / self.gap)
        return plume.mean(Sources(state.sources.position_ned, rate), position_ned, wind)

    def scale(self, state: PuffState) -> Array:
        """Return 1, the scale () of concentrations in a task: puffs have no emission rate to scale by."""
        return jnp.ones((), state.age.dtype)

    def _in_box(self, source_ned: Vec3, flown: Array, wind: Wind, area: Any) -> Array:
        """Return (S, K) bool: the puff of the source, after ``flown`` [m] of travel, still reaches into the area."""
        tail = flown - trail(self.spread_factor, self.spread_exponent, flown)
        north = source_ned.x[:, None] + wind.north * tail
        east = source_ned.y[:, None] + wind.east * tail
        inside = (north >= area.x_min) & (north <= area.x_max) & (east >= area.y_min) & (east <= area.y_max)
        return inside | (tail <= 0.0)


def trail(factor: Array | float, exponent: Array | float, flown: Array | float) -> Array:
    """Return the radius [m] of a puff, beyond which it is negligible, after ``flown`` [m] of travel."""
    return jnp.sqrt(-2.0 * math.log(NEGLIGIBLE) * factor * exp(exponent * log(jnp.maximum(flown, 1e-3))))
