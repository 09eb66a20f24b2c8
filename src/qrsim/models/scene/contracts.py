"""What a world asks of the area where its vehicles may be.

A component names its contract as its base class. Methods marked abstract are required; the others, and the class
variables, have the defaults that stand here.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar, Protocol, runtime_checkable

from jax import Array

from qrsim.core.vectors import Vec3
from qrsim.errors import UsageError


@runtime_checkable
class Area(Protocol):
    """Where vehicles may be; a ground at z = 0 unless ``height_agl`` says otherwise.

    Attributes:
        is_box: whether it has the limits ``x_min`` to ``z_max`` [m], which plumes, ground cover and persons need.
    """

    is_box: ClassVar[bool] = False

    @abstractmethod
    def check(self, position_ned: Vec3) -> list[tuple[int, Array, Array]]:
        """Return the checks of positions (n,) [m]: code of a reason (area.py), value (n,), and whether it is broken."""

    @abstractmethod
    def margin(self, position_ned: Vec3) -> Array:
        """Return the distance (n,) [m] of positions from the nearest limit; negative outside."""

    def farthest_squared(self, position_ned: Vec3) -> Array:
        """Return the squared distance (n,) [m^2] of positions from the farthest place of the area.

        Raises:
            UsageError: the area cannot say.
        """
        raise UsageError(
            f"world.area: {type(self).__name__} has no farthest_squared, from which a task with crash: worst takes "
            "what a crash costs; give it one, or say crash: published"
        )

    def height_agl(self, position_ned: Vec3) -> Array:
        """Return the height above ground (n,) [m] of positions."""
        return -position_ned.z
