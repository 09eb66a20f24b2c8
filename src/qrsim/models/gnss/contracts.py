"""Protocols of the sky and of its range errors, as worlds and receivers use them (satellites: orbits.py).

A component names its contract as its base class. Methods marked abstract are required; the others, and the class
variables, have the defaults that stand here.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, Protocol, runtime_checkable

from jax import Array

from qrsim.core.noise import Draw


@runtime_checkable
class RangeErrors(Protocol):
    """Errors of the pseudoranges to S satellites that all receivers of a world share."""

    @abstractmethod
    def init(self, draw: Draw) -> Any:
        """Return a stationary first state; ``draw`` is for the S satellites."""

    @abstractmethod
    def step(self, state: Any, draw: Draw, dt: float) -> Any:
        """Advance by dt [s]."""

    @abstractmethod
    def value(self, state: Any) -> Array:
        """Return the range errors (S,) [m] of a state."""


@runtime_checkable
class Sky(Protocol):
    """The space segment of a world: S satellites, stepped once a period.

    Its state is a ``SkyState`` (receivers.py), or a record with more fields than that.

    Attributes:
        period: interval between epochs [s], a multiple of the time step.
        ids: (S,) uint32 number of each satellite, which its randomness belongs to.
    """

    period: float
    ids: Array

    @abstractmethod
    def init(self, draw: Draw) -> Any:
        """Return the sky at the start; ``draw`` is for the S satellites."""

    @abstractmethod
    def step(self, state: Any, draw: Draw, seconds: Array, fraction: Array) -> Any:
        """Advance one period to ``seconds`` () int32 plus ``fraction`` () [s] since the start of the run."""
