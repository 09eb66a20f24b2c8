"""What a world asks of a controller, of a guidance and of an estimator.

A component names its contract as its base class. Methods marked abstract are required; the others, and the class
variables, have the defaults that stand here.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, Literal, Protocol, runtime_checkable

from jax import Array

from qrsim.control.setpoints import Estimate
from qrsim.core.vectors import Vec3


@runtime_checkable
class Controller(Protocol):
    """From an estimate and a set-point to a command.

    Attributes:
        setpoints: kinds of set-points that it takes.
        gives: the command record that it returns, one of its vehicle's ``actions``.
        feed: what it is fed with, where nobody hands in an estimate: the sensors, or the truth.
    """

    setpoints: ClassVar[tuple[type[Any], ...]]
    gives: ClassVar[type[Any]]
    feed: Literal["measurements", "truth"] = "measurements"

    def idle_command(self, command: Any) -> Any:
        """Return the command (n,) before the first one, of the vehicle's own ``idle_command``."""
        return command

    @abstractmethod
    def init(self, estimate: Estimate) -> Any:
        """Return the state of a controller of n vehicles that has not run."""

    @abstractmethod
    def step(self, state: Any, estimate: Estimate, setpoint: Any, dt: float) -> tuple[Any, Any]:
        """Return the new state and the command (n,), for a set-point (n,) of a kind that it takes; dt in [s]."""

    def shown(self, setpoint: Any) -> Any:
        """Return a set-point as the state of a world keeps it: of one structure, also where several kinds are taken."""
        return setpoint


@runtime_checkable
class Guidance(Protocol):
    """What hands out set-points to a fleet that nobody commands.

    Its state is a ``RouteState`` (guidance.py), or a record with more fields than that. ``route`` is the fleet's
    ``Route``.

    Attributes:
        gives: kind of its set-points.
        sees_others: whether ``step`` is handed ``others_ned`` (m,) [m], where the vehicles of all other fleets say they
            are; NaN where one does not fly any more, and left out where there is no other fleet.
    """

    gives: ClassVar[type[Any]]
    sees_others: ClassVar[bool] = False

    @abstractmethod
    def init(self, route: Any) -> Any:
        """Return the state at the start of each route (n,)."""

    @abstractmethod
    def step(self, state: Any, route: Any, position_ned: Vec3, others_ned: Vec3 | None = None) -> tuple[Any, Any]:
        """Return the new state and the set-point for vehicles that believe to be at position_ned (n,) [m]."""

    @abstractmethod
    def setpoint(self, state: Any, route: Any) -> Any:
        """Return the set-point (n,) of a state."""


@runtime_checkable
class Estimator(Protocol):
    """From the readings of a fleet to what its controller is fed with.

    Attributes:
        reads: kinds of sensors that it needs, by their names in the catalogue.
    """

    reads: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def init(self, readings: Mapping[str, Any], start: Estimate) -> Any:
        """Return the state at the start.

        Args:
            readings: the first reading (n,) of each sensor, by its name in the fleet.
            start: what is known of the start of each vehicle (n,).
        """

    @abstractmethod
    def step(
        self, state: Any, readings: Mapping[str, Any], fresh: Mapping[str, Array], dt: float
    ) -> tuple[Any, Estimate]:
        """Advance one tick of dt [s], and return the estimate (n,).

        Args:
            state: before it.
            readings: the reading (n,) of each sensor, by its name in the fleet; held between its periods.
            fresh: () bool of each sensor, whether its reading is new.
        """

    def std(self, state: Any) -> Estimate | None:
        """Return the standard deviations (n,) that it claims for its estimate; None: it claims none."""
        return None
