"""Protocol of sensors, as worlds use them.

A component names its contract as its base class. Methods marked abstract are required; the others, and the class
variables, have the defaults that stand here.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar, Protocol, runtime_checkable

from jax import Array

from qrsim.core.tree import Record, select

# What a sensor may declare in ``reads``; each is (n,) but the sky and what stands after it.
SCENE = (
    "position_ned",
    "position_low_ned",
    "velocity_ned",
    "attitude",
    "velocity_body",
    "rates_body",
    "specific_force",
    "wind_ned",
    "load",
    "sky",
    "surroundings",
    "ground",
    "skyline",
    "obstacles",
    "traffic",
)


class Explained:
    """Base of readings that can say what they lack."""

    def reason(self, vehicle: int) -> str:
        """Return as text why a vehicle's reading is incomplete, by the vehicle's number."""
        raise NotImplementedError


@runtime_checkable
class Sensor(Protocol):
    """A sensor on each of n vehicles.

    Its reading is a record of arrays (n,) whose fields carry unit and doc; these are the columns of the logs. A reading
    that does not exist, as a fix without satellites, is NaN. ``init``, ``step`` and ``restart`` are handed what
    ``reads`` names, by name, after a ``Noise`` (core/noise.py) that has ``normals`` normals for each vehicle.

    Attributes:
        period: interval between readings [s], a multiple of the time step.
        reads: what it looks at, of ``SCENE``.
        normals: standard normals that ``init`` and ``step`` draw for each vehicle.
        first_normals: those of ``init``, where it draws another number of them; 0: as many.
        draws_alone: whether it draws any number of normals, from a ``Draw`` of its own; ``normals`` does not count.
        delay: periods for which it holds back each reading itself. Where it has no such parameter, the ``delay`` of a
            scenario is the world's affair, which also mounts every sensor (fitting.py).
        takes_pictures: whether it has ``develop``, which makes a picture of a reading (camera.py).
    """

    period: float
    reads: ClassVar[tuple[str, ...]] = ()
    normals: ClassVar[int] = 0
    first_normals: ClassVar[int] = 0
    draws_alone: ClassVar[bool] = False
    delay: int = 0
    takes_pictures: ClassVar[bool] = False

    @property
    def wants_traffic(self) -> bool:
        """True if the sensor measures other vehicles; ``traffic`` is None if no sensor of a world does."""
        return True

    @abstractmethod
    def init(self, draw: Any, *args: Any, **reads: Any) -> tuple[object, Record]:
        """Return the sensor's first state and first reading (n,)."""

    @abstractmethod
    def step(self, state: Any, draw: Any, *args: Any, **reads: Any) -> tuple[object, Record]:
        """Return the sensor's state and reading (n,) one period later."""

    def restart(self, state: Any, draw: Any, since: Array, *args: Any, **reads: Any) -> tuple[object, Record]:
        """Return state and reading (n,) after ``set_state`` has moved vehicles, ``since`` () [s] after a reading."""
        return self.init(draw, *args, **reads)

    def biases(self, state: Any) -> dict[str, Any]:
        """Return the true slowly varying errors (n,) of the reading, {field or vector: error}; {} if unknown."""
        return {}

    def white_noise(self) -> dict[str, Array]:
        """Return the std of a reading's white noise, {field or vector: std}; only of fields with a constant std.

        The fault ``noisy`` can be a multiple of it.
        """
        return {}

    def overfull(self, state: Any) -> Array | None:
        """Return how many neighbour searches (n,) int32 have overflowed so far; None if they cannot.

        Room is what ``neighbours`` of core/neighbours.py has for those around a vehicle.
        """
        return None

    def placed(self, chosen: Array, fresh: Any, before: Any) -> Any:
        """Return the state ``before`` with the vehicles ``chosen`` (n,) bool taken from ``fresh``."""
        return select(chosen, fresh, before)

    def fresh(self, tick: Array, time_step: float) -> Array:
        """Return () bool: a new reading is delivered at this tick; at other ticks the last one is held."""
        return tick % max(1, round(self.period / time_step)) == 0

    def time_of_reading(self, tick: Array, time_step: float) -> Array:
        """Return the tick () at which the reading held at ``tick`` was taken; 0 before any has been delivered."""
        ticks = max(1, round(self.period / time_step))
        since = tick // ticks - self.delay
        return ticks * since * (since > 0)


class Memoryless(Sensor):
    """Base of sensors without a state: all readings are made as the first one is."""

    def step(self, state: object, draw: object, *args: Any, **reads: Any) -> tuple[object, Record]:
        """Return the state unchanged, None, and the present reading (n,), by ``init``."""
        return self.init(draw, *args, **reads)
