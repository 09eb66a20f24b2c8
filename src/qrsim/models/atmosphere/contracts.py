"""Protocols of mean wind, turbulence, discrete gusts and updrafts, as worlds use them.

A component names its contract as its base class. Methods marked abstract are required; the others, and the class
variables, have the defaults that stand here. An argument with a default may be left out of a component's own method.
Time is ``seconds`` () int32 and ``fraction`` () in [0, 1) since the start of the run, so that single precision is
enough for runs of any length.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple, Protocol, runtime_checkable

import jax.numpy as jnp
from jax import Array

from qrsim.core.arrays import NumpyArray
from qrsim.core.noise import Draw, Noise
from qrsim.core.vectors import Vec3

# South, north, west and east [m].
Bounds = tuple[float, float, float, float]
# Height whose mean wind carries gusts, unless a turbulence says otherwise [m].
CONVECTION_HEIGHT = 20.0
# What a wind, and what a turbulence may declare in ``reads``.
WIND_READS = ("position_ned",)
TURBULENCE_READS = ("position_ned", "seconds", "fraction", "field")
# What a discrete gust may.
GUST_READS = ("convection_ned",)
# What an updraft may.
UPDRAFT_READS = ("wind", "ground", "drawn")


@runtime_checkable
class Wind(Protocol):
    """The mean wind.

    Attributes:
        reads: ("position_ned",) where it differs from place to place: ``velocity_ned`` is handed positions (n,) [m].
    """

    reads: ClassVar[tuple[str, ...]] = ()

    def at(self, duration: float) -> Wind:
        """Return the wind model for a run of ``duration`` [s]: itself, or the content of the file that it names.

        Raises:
            UsageError: it does not last that long.
        """
        return self

    def within(self, bounds: Bounds | None, top: float | None) -> Wind:
        """Return the wind model cut to the data that an area and a height ``top`` [m] need; by default itself.

        Args:
            bounds: of the area, None where it has none.
            top: greatest height [m] over the origin that the area allows, None where it allows any.

        Raises:
            UsageError: the data lie entirely outside the area.
        """
        return self

    def beyond(self, bounds: Bounds | None, top: float | None) -> list[str]:
        """Return a sentence for each side on which the area extends beyond the wind's data; arguments as ``within``."""
        return []

    @abstractmethod
    def velocity_ned(self, height_agl: Array, seconds: Array, fraction: Array, *args: Any, **reads: Any) -> Vec3:
        """Return the mean wind velocity (n,) [m/s] NED at heights (n,) [m] above ground and a time."""

    def mean_velocity_ned(self, height_agl: Array) -> Vec3:
        """Return the wind velocity (n,) [m/s] NED at heights (n,) [m] above ground, averaged over time and place.

        By default that of time 0 at the origin.
        """
        origin = Vec3.zeros(height_agl.shape, height_agl.dtype)
        inputs: dict[str, object] = {"position_ned": origin} if "position_ned" in self.reads else {}
        return self.velocity_ned(height_agl, jnp.int32(0), jnp.zeros((), height_agl.dtype), **inputs)


def horizontal_mean(wind: Wind, height_agl: Array) -> Vec3:
    """Return the horizontal wind () [m/s] NED at a height () [m] above ground, averaged over time and place."""
    mean = wind.mean_velocity_ned(jnp.reshape(height_agl, (1,))).map(lambda axis: axis[0])
    return Vec3(mean.x, mean.y, jnp.zeros_like(mean.z))


@runtime_checkable
class Turbulence(Protocol):
    """Random gusts at n vehicles.

    Attributes:
        normals: standard normals that ``init`` and ``step`` draw for each vehicle.
        rates: whether it gives the rotation of the air.
        reads: of "position_ned" (n,) [m], "seconds", "fraction" and "field", what ``gust_ned`` and ``gust_rates_ned``
            are passed by these names, in addition to the state and the height.
        field_ids: numbers of what ``draw_field`` draws for, once an episode for the whole world; 0: nothing is drawn.
        sees_wind: whether ``draw_field`` is handed the mean wind.
    """

    normals: ClassVar[int] = 0
    rates: ClassVar[bool] = False
    reads: ClassVar[tuple[str, ...]] = ()
    field_ids: int = 0
    sees_wind: ClassVar[bool] = False

    def draw_field(self, draw: Draw, wind: object = None) -> object:
        """Return the random gust field of an episode, shared by all vehicles; None for a turbulence without one.

        Args:
            draw: for ``field_ids`` ids.
            wind: the mean wind, a ``Wind``, where ``sees_wind`` asks for it.
        """
        return None

    def convection_velocity_ned(self, wind: Wind) -> Vec3:
        """Return the horizontal velocity () [m/s] NED at which the mean wind carries gusts over the ground."""
        return horizontal_mean(wind, jnp.asarray(CONVECTION_HEIGHT))

    @abstractmethod
    def init(self, draw: Noise) -> object:
        """Return the random initial gust states of vehicles (n,), in the statistical steady state."""

    @abstractmethod
    def step(
        self, state: Any, draw: Noise, height_agl: Array, velocity_ned: Vec3, mean_wind_ned: Vec3, dt: float
    ) -> object:
        """Return the gust state dt [s] later, for heights (n,) [m] and ground velocities (n,) [m/s]."""

    @abstractmethod
    def gust_ned(self, state: Any, height_agl: Array, *args: Any, **reads: Any) -> Vec3:
        """Return the gust velocity (n,) [m/s] NED at heights (n,) [m] above ground, added to the mean wind."""

    def gust_rates_ned(self, state: Any, height_agl: Array, *args: Any, **reads: Any) -> Vec3:
        """Return the air's rotation (n,) [rad/s] NED at heights (n,) [m]; only for turbulence with ``rates`` true."""
        return Vec3.zeros(height_agl.shape, height_agl.dtype)


@runtime_checkable
class Gust(Protocol):
    """A gust of known shape: a function of place and time.

    Attributes:
        reads: "convection_ned" or nothing: whether ``velocity_ned`` is handed, by this name, the horizontal velocity ()
            [m/s] that carries the turbulence.
    """

    reads: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def velocity_ned(self, position_ned: Vec3, seconds: Array, fraction: Array, *args: Any, **reads: Any) -> Vec3:
        """Return the velocity (n,) [m/s] NED that a discrete gust adds to the wind at positions (n,) [m]."""


class Footprint(NamedTuple):
    """An upright obstacle: the corners (V, 2) of its footprint, north and east [m], or the middle of a cylinder.

    Attributes:
        corners: in order.
        radius: of a cylinder, else 0 [m].
        top, bottom: down coordinates [m].
    """

    corners: NumpyArray
    radius: float
    top: float
    bottom: float


@runtime_checkable
class Updraft(Protocol):
    """A part of the air's motion that belongs to places: rising air, or what terrain and buildings do to the wind.

    Attributes:
        reads: of "wind" (the mean ``Wind``), "ground" (a ``Ground``) and "drawn" (what ``draw`` returned), what
            ``velocity_ned`` is handed by these names.
        drawn_ids: numbers of what ``draw`` draws for, once an episode for the whole world; 0: nothing is drawn.
    """

    reads: ClassVar[tuple[str, ...]] = ()
    drawn_ids: int = 0

    def built(self, bounds: Bounds | None, solids: Sequence[Footprint]) -> Updraft:
        """Return the updraft fitted to an area and its obstacles, before the run; by default itself.

        Args:
            bounds: of the area, None where it has none.
            solids: the obstacles, upright.

        Raises:
            UsageError: it cannot be in this world; the message begins with the parameter.
        """
        return self

    def draw(self, draw: Draw) -> object:
        """Return the random numbers of an episode's updraft; None if it has none."""
        return None

    @abstractmethod
    def velocity_ned(
        self,
        position_ned: Vec3,
        height_agl: Array,
        wind_ned: Vec3,
        seconds: Array,
        fraction: Array,
        *args: Any,
        **reads: Any,
    ) -> Vec3:
        """Return the velocity (n,) [m/s] NED that the updraft adds to the mean wind.

        Args:
            position_ned: places (n,) [m].
            height_agl: their heights above ground (n,) [m].
            wind_ned: mean wind (n,) [m/s] there.
            seconds: () whole seconds since the start of the run.
            fraction: () the rest of the time since the start [s].
        """
