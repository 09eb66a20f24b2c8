"""Start positions of a fleet in an episode."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import ClassVar

import jax.numpy as jnp
from jax import Array, lax

from qrsim.core.fastmath import sincos
from qrsim.core.noise import Draw
from qrsim.core.tree import parameter, record, replace, setting
from qrsim.core.vectors import Vec3
from qrsim.models.scene.contracts import Placement, StartT
from qrsim.models.scene.plume import inner_box
from qrsim.models.scene.uniform import uniform


@record
class GivenPlaces(Placement):
    """Every vehicle starts at its position in the scenario."""

    random: ClassVar[bool] = False

    def place(self, draw: Draw, start: StartT, area: object) -> tuple[StartT, Array]:
        """Return the given start positions unchanged, and True: positions were found."""
        return start, jnp.ones((), bool)


@record
class UniformPlaces(Placement):
    """Uniform in the inner part of the area, at the height and attitude given, with a random heading."""

    inner: Array = parameter(default=0.9, unit="1", doc="part of the area along each axis", minimum=0.0, maximum=1.0)
    yaw_min_rad: Array = parameter(default=0.0, unit="rad", doc="smallest heading", minimum=-6.3, maximum=6.3)
    yaw_max_rad: Array = parameter(default=0.0, unit="rad", doc="largest heading", minimum=-6.3, maximum=6.3)
    apart: Array = parameter(default=5.0, unit="m", doc="smallest distance between two vehicles", minimum=0.0)
    tries: int = setting(default=100, unit="1", doc="places tried before giving up", minimum=1, maximum=100_000)
    random: ClassVar[bool] = True

    def place(self, draw: Draw, start: StartT, area: object) -> tuple[StartT, Array]:
        """Return the start of vehicles (n,) at random positions, and () bool: these are far enough apart."""
        low, high = inner_box(area, self.inner)

        def candidate(number: Array) -> tuple[Array, Array]:
            """Return random positions (n,) north and east [m] for try number ``number``."""
            return (
                uniform(draw, 2 * number, low.x, high.x),
                uniform(draw, 2 * number + 1, low.y, high.y),
            )

        north, east, found = _first_apart(candidate, self.apart, self.tries)
        # Beyond all that tries can take.
        yaw = uniform(draw, 2 * self.tries, self.yaw_min_rad, self.yaw_max_rad)
        attitude = replace(start.attitude, yaw=yaw)
        return replace(start, position_ned=Vec3(north, east, start.position_ned.z), attitude=attitude), found

    def unplaced(self, size: int) -> str:
        """Return the error message for a fleet of ``size`` vehicles for which no positions were found."""
        return _unplaced(size, self.apart, self.tries)


@record
class RingPlaces(Placement):
    """Uniform in angle and distance around a point, at the height and attitude given, some distance apart."""

    north: Array = parameter(default=0.0, unit="m", doc="north coordinate of the point")
    east: Array = parameter(default=0.0, unit="m", doc="east coordinate of the point")
    nearest: Array = parameter(default=14.0, unit="m", doc="smallest distance from the point", minimum=0.0)
    farthest: Array = parameter(default=20.0, unit="m", doc="largest distance from the point", above=0.0)
    apart: Array = parameter(default=22.0, unit="m", doc="smallest distance between two vehicles", minimum=0.0)
    tries: int = setting(default=1000, unit="1", doc="places tried before giving up", minimum=1, maximum=100_000)
    random: ClassVar[bool] = True

    def place(self, draw: Draw, start: StartT, area: object) -> tuple[StartT, Array]:
        """Return the start of vehicles (n,) at random positions in a ring, and () bool: these are far enough apart."""

        def candidate(number: Array) -> tuple[Array, Array]:
            """Return random positions (n,) north and east [m] for try number ``number``."""
            sine, cosine = sincos(uniform(draw, 2 * number, -math.pi, math.pi))
            distance = uniform(draw, 2 * number + 1, self.nearest, self.farthest)
            return self.north + distance * cosine, self.east + distance * sine

        north, east, found = _first_apart(candidate, self.apart, self.tries)
        return replace(start, position_ned=Vec3(north, east, start.position_ned.z)), found

    def unplaced(self, size: int) -> str:
        """Return the error message for a fleet of ``size`` vehicles for which no positions were found."""
        return _unplaced(size, self.apart, self.tries)

    def most_vehicles(self) -> int:
        """Return the number of vehicles that fit on the ring's outer circle, an upper bound for random placement."""
        # At distances near zero any number fits, and the angle would be too small to divide by.
        if self.apart <= 1e-9 * self.farthest:
            return 10**9
        half = float(self.apart) / (2.0 * max(float(self.farthest), 1e-300))
        return 1 if half > 1.0 else int(math.pi / math.asin(half) + 1e-9)


def _unplaced(size: int, apart: Array, tries: int) -> str:
    """Return the error message for vehicles without positions at least ``apart`` [m] apart after ``tries``."""
    return (
        f"no place for {size} vehicles at least {float(apart):g} m apart in {tries} tries; take another seed, fewer "
        "vehicles, more tries or less distance"
    )


def _first_apart(
    candidate: Callable[[Array], tuple[Array, Array]], apart: Array, tries: int
) -> tuple[Array, Array, Array]:
    """Return north, east (n,) [m] of the first random placement at least ``apart`` [m] apart, and bool: found.

    Args:
        candidate: from the number of a try to north and east (n,).
        apart: smallest distance between two [m].
        tries: places tried.

    Returns:
        north, east, and whether it was found; where not, north and east are NaN, and nobody flies.
    """

    def far_enough(north: Array, east: Array) -> Array:
        """Return () bool: all vehicles (n,) are at least ``apart`` [m] from each other."""
        square = (north[:, None] - north[None]) ** 2 + (east[:, None] - east[None]) ** 2
        itself = jnp.eye(north.shape[0], dtype=bool)
        return jnp.all(itself | (square >= apart * apart))

    def again(now: tuple[Array, Array]) -> tuple[Array, Array]:
        """Return the next try's number, and whether its positions are far enough apart."""
        number = now[0] + 1
        return number, far_enough(*(lax.stop_gradient(axis) for axis in candidate(number)))

    # The place is made after the search, because a search has no slope.
    number, found = lax.while_loop(
        lambda now: (now[0] < tries - 1) & ~now[1], again, (jnp.int32(-1), jnp.zeros((), bool))
    )
    north, east = candidate(number)
    return jnp.where(found, north, jnp.nan), jnp.where(found, east, jnp.nan), found
