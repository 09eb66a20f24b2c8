"""Protocols of the flight area, of its ground, and of what it holds: plume, ground cover, persons.

A component names its contract as its base class. Methods marked abstract are required; the others, and the class
variables, have the defaults that stand here.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, Protocol, TypeVar, runtime_checkable

import jax.numpy as jnp
from jax import Array

from qrsim.core.host import on_host
from qrsim.core.noise import Draw
from qrsim.core.vectors import Euler, Vec3
from qrsim.errors import UsageError

# Samples of the ground along a ray, and bisections of the interval with the first crossing.
LOOKS, HALVINGS = 32, 6


@runtime_checkable
class Area(Protocol):
    """The flight area; what its ground is, is a ``Ground``.

    Attributes:
        is_box: whether it has the limits ``x_min`` to ``z_max`` [m], which plumes, ground cover and persons need.
    """

    is_box: ClassVar[bool] = False

    @abstractmethod
    def check(self, position_ned: Vec3) -> list[tuple[int, Array, Array]]:
        """Return the checks of positions (n,) [m] against the area, each (reason code, value (n,), broken (n,))."""

    def swept(self, before_ned: Vec3, position_ned: Vec3) -> list[tuple[int, Array, Array]]:
        """Return the checks of positions (n,) [m] and of the straight paths to them from ``before_ned`` (n,).

        By default the positions alone are checked: no way between two points of a convex area leaves it.
        """
        return self.check(position_ned)

    @abstractmethod
    def margin(self, position_ned: Vec3) -> Array:
        """Return the distance (n,) [m] of positions from the area's nearest limit; negative outside."""

    def clearances(self, position_ned: Vec3) -> tuple[Array, Array, Array]:
        """Return the distances (n,) [m] of positions from the area's sides, ceiling and floor; negative beyond.

        An area that does not tell them apart has ``margin`` for the sides, and neither ceiling nor floor.
        """
        far = jnp.full_like(position_ned.z, jnp.inf)
        return self.margin(position_ned), far, far

    def farthest_squared(self, position_ned: Vec3) -> Array:
        """Return the squared distance (n,) [m^2] of positions from the farthest point of the area.

        Raises:
            UsageError: the area cannot say.
        """
        raise UsageError(
            f"world.area: {type(self).__name__} has no farthest_squared, from which a task with crash: worst takes "
            "what a crash costs; give it one, or say crash: published"
        )

    def height_agl(self, position_ned: Vec3) -> Array:
        """Return the height (n,) [m] of positions above flat ground at z = 0; overridden for other grounds."""
        return -position_ned.z


@runtime_checkable
class Ground(Protocol):
    """The surface of the ground, with one height at every place.

    Attributes:
        at_zero: whether it is the plane z = 0, which areas take for their floor.
        hides: whether it hides satellites, see ``horizon_sine``.
        flat: whether it is a level plane, which is never between two who are above it.
    """

    at_zero: bool = False
    hides: ClassVar[bool] = False
    flat: ClassVar[bool] = False

    def at(self, site: object, box: object) -> Ground:
        """Return the ground for a site and for an area's bounds (south, north, west, east [m], or None)."""
        return self

    def horizon_sine(self, position_ned: Vec3, line_of_sight: Vec3) -> Array:
        """Return the sine (S, n) of the terrain horizon's elevation below lines of sight (S, n) from positions (n,)."""
        return jnp.full(line_of_sight.z.shape, -1.0, line_of_sight.z.dtype)

    def line_of_sight(self, position_ned: Vec3, point_ned: Vec3) -> Array:
        """Return (n,) bool: the terrain does not hide a point () [m] from positions (n,) [m]; here always True."""
        return jnp.ones(position_ned.x.shape, bool)

    @abstractmethod
    def down(self, position_ned: Vec3) -> Array:
        """Return the down coordinate [m] of the ground below (or above) positions of any shape [m]."""

    def ray_distance(self, origin_ned: Vec3, direction: Vec3, reach: Array) -> Array:
        """Return the distance [m] along rays (...) to the ground: 0 from below it, infinite beyond ``reach`` [m].

        By default the ground is sampled every ``reach``/32, and the first crossing found there is narrowed down. A
        ridge between two samples can be missed.

        Args:
            origin_ned: origin of the rays (...) [m].
            direction: unit vectors (...).
            reach: largest distance [m].
        """
        return crossing(self.down, origin_ned, direction, reach)

    def normal(self, position_ned: Vec3) -> Vec3:
        """Return the upward unit normal of the ground below positions of any shape [m].

        By default it is that of the slope between points 1 m apart.
        """
        half = Vec3(position_ned.x * 0.0 + 0.5, position_ned.y * 0.0, position_ned.z * 0.0)
        across = Vec3(half.y, half.x, half.z)
        north = self.down(position_ned + half) - self.down(position_ned - half)
        east = self.down(position_ned + across) - self.down(position_ned - across)
        return upward(north, east)


def crossing(down: Callable[[Vec3], Array], origin_ned: Vec3, direction: Vec3, reach: Array) -> Array:
    """Return the distance [m] along rays (...) to the surface z = ``down(position)``; see ``Ground.ray_distance``."""
    shape = jnp.broadcast_shapes(origin_ned.x.shape, direction.x.shape)
    origin, ray = (end.map(lambda axis: jnp.broadcast_to(axis, shape)) for end in (origin_ned, direction))

    def above(distance: Array) -> Array:
        """Return the height [m] above the surface, negative below, of points at distances [m] along the rays."""
        wide = (1,) * (distance.ndim - len(shape)) + shape
        place = origin.map(lambda axis: axis.reshape(wide)) + ray.map(lambda axis: axis.reshape(wide)) * distance
        return down(place) - place.z

    length = jnp.broadcast_to(jnp.asarray(reach, ray.x.dtype), shape)
    step = length * (1.0 / LOOKS)
    number = jnp.arange(1, LOOKS + 1).astype(ray.x.dtype).reshape(-1, *(1,) * len(shape))
    first = jnp.min(jnp.where(above(step[None] * number) <= 0.0, number, jnp.inf), axis=0)
    high = step * jnp.where(first <= LOOKS, first, 1.0)
    low = high - step
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        crossed = above(middle) <= 0.0
        low, high = jnp.where(crossed, low, middle), jnp.where(crossed, middle, high)
    before, after = above(low), above(high)
    part = before / jnp.where(before > after, before - after, 1.0)
    met = jnp.where(first <= LOOKS, low + (high - low) * jnp.clip(part, 0.0, 1.0), jnp.inf)
    return jnp.where(down(origin) <= origin.z, 0.0, met)


def upward(north: Array, east: Array) -> Vec3:
    """Return a surface's upward unit normal from the slopes [m/m] of its down coordinate to north and east."""
    scale = 1.0 / jnp.sqrt(1.0 + north * north + east * east)
    return Vec3(north * scale, east * scale, -scale)


@runtime_checkable
class Plume(Protocol):
    """A concentration field; ``wind`` is the mean wind that carries it, ``area`` a box.

    Attributes:
        needs_wind: whether it needs a wind that blows.
        random: whether ``init`` draws it again for each episode.
        changes: whether ``step`` advances it once a period.
        period: interval between steps [s]; 0 where it does not change.
        ids: numbers of what is drawn for.
    """

    needs_wind: ClassVar[bool] = False
    random: ClassVar[bool] = True
    changes: ClassVar[bool] = False
    period: float = 0.0

    @property
    @abstractmethod
    def ids(self) -> int:
        """Number of random ids for which ``init`` and ``step`` draw numbers."""

    def init(self, draw: Draw, area: object) -> object:
        """Return the plume's state at the start of an episode; ``draw`` has ``ids`` ids."""
        return None

    def step(self, state: Any, draw: Draw) -> object:
        """Return the plume's state one period later; ``draw`` has ``ids`` ids."""
        return state

    @abstractmethod
    def concentration(self, state: Any, position_ned: Vec3, wind: Any, area: Area, since: Array) -> Array:
        """Return the concentration (n,) at positions (n,) [m], ``since`` () [s] after the plume's last step."""


@runtime_checkable
class GroundCover(Protocol):
    """Ground cover of the area.

    Attributes:
        random: whether ``init`` draws it again for each episode.
    """

    random: ClassVar[bool] = True

    def init(self, draw: Draw) -> object:
        """Return an episode's land cover, drawn at random; ``draw`` has one id."""
        return None

    @abstractmethod
    def class_at(self, state: Any, position_ned: Vec3, area: Area) -> Array:
        """Return the land-cover class (int32, see terrain.py) of the ground below positions of any shape [m]."""

    @abstractmethod
    def cells(self, state: Any) -> Array:
        """Return the land-cover classes as a grid (C, C) int32, from the south-western corner north and east."""


@runtime_checkable
class People(Protocol):
    """Persons on the ground.

    Attributes:
        random: whether ``init`` draws them again for each episode; if false, there are none.
        period: interval between looks [s]; 0 where nobody is there.
        most: most persons of an episode (P).
        size: side of the square that a person is [m]; where nobody is, what pictures are cut into windows by.
    """

    random: ClassVar[bool] = True
    period: float = 0.0
    most: int = 0
    size: Any = 0.5

    def init(self, draw: Draw, cells: Array, area: object) -> object:
        """Return an episode's persons (P,), placed at random on land of their class in the grid ``cells``."""
        return None

    def step(self, state: Any, position_ned: Vec3, speed: Array, valid: Array, tick: Array) -> object:
        """Return the state with persons marked as found that vehicles (n,) find at a tick."""
        return state


class Placed(Protocol):
    """The part of a start that a placement changes."""

    @property
    def position_ned(self) -> Vec3:
        """Position (n,) [m] NED."""
        ...

    @property
    def attitude(self) -> Euler:
        """Attitude (n,) [rad], Euler angles."""
        ...


StartT = TypeVar("StartT", bound=Placed)


@runtime_checkable
class Placement(Protocol):
    """Start positions of the n vehicles of a fleet in an episode.

    Attributes:
        random: whether ``place`` draws them again for each episode; if false, each starts as in the scenario.
    """

    random: ClassVar[bool] = True

    @abstractmethod
    def place(self, draw: Draw, start: StartT, area: object) -> tuple[StartT, Array]:
        """Return the start of vehicles (n,) with positions chosen, and () bool: positions were found.

        Args:
            draw: for n ids.
            start: the ``Start`` (world/state.py) that the scenario gives, of which some fields are replaced.
            area: of the world.
        """

    def unplaced(self, size: int) -> str:
        """Return the error message for a fleet of ``size`` vehicles for which no positions were found."""
        return f"no place for {size} vehicles; take another seed or fewer vehicles"


# The down coordinate [m] of a ground below positions of any shape, by NumPy.
down_at = on_host(lambda ground, position_ned: ground.down(position_ned))
