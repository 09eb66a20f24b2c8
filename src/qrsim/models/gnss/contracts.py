"""Protocols of the sky and of its range errors, as worlds and receivers use them (satellites: orbits.py).

A component names its contract as its base class. Methods marked abstract are required; the others, and the class
variables, have the defaults that stand here.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar, Protocol, runtime_checkable

from jax import Array

from qrsim.core.noise import Draw
from qrsim.models.gnss.sight import CommonErrors, Scales, Sight, plain_scales, without_ionosphere


@runtime_checkable
class RangeErrors(Protocol):
    """Errors of the pseudoranges to S satellites that all receivers of a world share.

    Attributes:
        needs_sight: whether they depend on how the satellites are seen. Such errors are stepped every few seconds.
        std: their standard deviation [m], as receivers weigh them that report their accuracy.
        common: "shared", or "per_vehicle" for an ``ErrorBudget`` of which each receiver of type gnss has one.
    """

    needs_sight: ClassVar[bool] = False
    std: Any = 1.0
    common: str = "shared"

    @abstractmethod
    def init(self, draw: Draw) -> Any:
        """Return random initial range errors, in the steady state; ``draw`` is for the S satellites."""

    @abstractmethod
    def step(self, state: Any, draw: Draw, dt: float) -> Any:
        """Return the range errors' state dt [s] later."""

    @abstractmethod
    def value(self, state: Any) -> Array:
        """Return the range errors (S,) [m] of S satellites for a state."""

    def seen(self, state: Any, sight: Sight, system: Array) -> CommonErrors:
        """Return the range errors [m], in parts, of S satellites at the elevations in ``sight``, by ``system`` (S,)."""
        return without_ionosphere(self.value(state))

    def scales(self, system: Array) -> Scales:
        """Return the standard deviations [m] of range errors of satellites, by system numbers ``system`` (S,)."""
        return plain_scales(self.std, system)


@runtime_checkable
class Sky(Protocol):
    """The space segment of a world: S satellites, stepped once a period.

    Its state is a ``SkyState`` (receivers.py), or a record with more fields than that.

    Attributes:
        period: interval between epochs [s], a multiple of the time step.
        ids: (S,) uint32 number of each satellite, which its randomness belongs to.
        steps_by_parts: whether it has ``step_by_parts``, which a world of one clock calls at every tick instead.
    """

    period: float
    ids: Array

    @property
    def steps_by_parts(self) -> bool:
        """True if ``step_by_parts`` is called at every tick, in place of ``step`` at every epoch."""
        return False

    def step_by_parts(self, state: Any, draw: Draw, tick: Array) -> Any:
        """Return the satellites' state at a tick () int32; called at every tick if ``steps_by_parts``."""
        return state

    @abstractmethod
    def init(self, draw: Draw) -> Any:
        """Return the satellites' state at the start; ``draw`` is for the S satellites."""

    @abstractmethod
    def step(self, state: Any, draw: Draw, seconds: Array, fraction: Array) -> Any:
        """Return the satellites' state one epoch later, at ``seconds`` () int32 plus ``fraction`` () [s] in the run."""
