"""What is compiled: functions of one world, by what they are known, and for how many worlds."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from qrsim.core.arrays import DType
from qrsim.engine.settings import FEW_VEHICLES

if TYPE_CHECKING:
    from jax.sharding import Mesh


@dataclass(frozen=True)
class Function:
    """A pure function of one world.

    Attributes:
        name: what it is, for messages.
        call: ``call(shared, own)`` returns a first state, or ``call(shared, own, state, tick)`` the next one.
        of: what it depends on beside the structure of its arguments; two functions of the same name are one where
            this is equal.
        text: the same as text, for the user's cache; None where another process could not tell it by text.
    """

    name: str
    # Two equal functions may be two objects, such as a partial that is made for each rollout.
    call: Callable[..., object] = field(compare=False)
    of: Hashable = ()
    text: tuple[str | tuple[bool, ...], ...] | None = field(default=(), compare=False)


@dataclass(frozen=True)
class Extent:
    """How many worlds a program is for.

    Attributes:
        vehicles: of one world.
        dtype: of its floating-point numbers.
        worlds: B, whose leaves are (B, ...); None: one, whose leaves have no such axis.
        devices: that share the worlds.
        mesh: these devices, where they are several of JAX.
    """

    vehicles: int
    dtype: DType
    worlds: int | None = None
    devices: int = 1
    mesh: Mesh | None = None

    @property
    def few(self) -> bool:
        """Whether vehicles are so few that XLA's quicker compilation pays."""
        return self.vehicles * (self.worlds or 1) <= FEW_VEHICLES * self.devices
