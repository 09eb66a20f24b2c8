"""Protocols of controller, guidance and estimator, as worlds use them.

A component names its contract as its base class. Methods marked abstract are required; the others, and the class
variables, have the defaults that stand here.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, Literal, Protocol, runtime_checkable

from jax import Array

from qrsim.control.consistency import Consistency, Truth
from qrsim.control.setpoints import Estimate
from qrsim.core.tree import quantity, record
from qrsim.core.vectors import Vec3


@runtime_checkable
class Controller(Protocol):
    """Maps an estimate and a set-point to a command.

    Attributes:
        setpoints: kinds of set-points that it takes.
        gives: the command record that it returns, one of its vehicle's ``actions``; ``object``: what the vehicle's
            ``tilt_command`` returns.
        reads_airspeed: whether its estimate has an airspeed.
        feed: source of its estimate if the user passes none: the sensors, the truth, or its own ``estimator``.
    """

    setpoints: ClassVar[tuple[type, ...]]
    gives: ClassVar[type]
    reads_airspeed: ClassVar[bool] = False
    feed: Literal["measurements", "truth", "filter"] = "measurements"

    def fitted(self, vehicle: Any) -> Controller:
        """Return the controller fitted to a nominal vehicle model; the vehicle that it flies may differ."""
        return self

    def estimator(self) -> Estimator | None:
        """Return the estimator that the controller runs itself in flight; None if it runs none."""
        return None

    def idle_command(self, command: Any) -> object:
        """Return the command (n,) applied before the first ``step``, made from the vehicle's idle ``command``."""
        return command

    @abstractmethod
    def init(self, estimate: Estimate) -> object:
        """Return the controller's initial state, for vehicles (n,) with this first estimate."""

    @abstractmethod
    def step(self, state: Any, estimate: Estimate, setpoint: Any, dt: float) -> tuple[object, object]:
        """Return the state after a tick of dt [s], and the vehicle command (n,) that follows the set-point (n,)."""

    def shown(self, setpoint: Any) -> object:
        """Return a set-point of any kind as the one record type in which a world's state keeps set-points."""
        return setpoint


@runtime_checkable
class Guidance(Protocol):
    """Source of set-points for a fleet without a commander.

    Its state is a ``RouteState`` (guidance.py), or a record with more fields than that. ``route`` is the fleet's
    ``Route``.

    Attributes:
        gives: kind of its set-points.
        sees_others: whether ``step`` takes ``others_ned`` (m,) [m], the estimated positions of all vehicles of other
            fleets; NaN for stopped vehicles. The argument is left out if there is no other fleet.
        sees_ground: whether ``step`` takes ``on_ground`` (n,) bool: the vehicle is on the ground.
        sees_motion: whether ``step`` takes ``velocity_ned`` (n,) [m/s], as estimated, and ``dt`` [s].
        sees_mates: whether ``step`` takes ``mates``, the neighbour lists in its fleet (``teams/mates.py``); the
            component then has ``reach`` and ``mates``, the largest distance [m] and number of neighbours.
    """

    gives: ClassVar[type]
    sees_others: ClassVar[bool] = False
    sees_ground: ClassVar[bool] = False
    sees_motion: ClassVar[bool] = False
    sees_mates: ClassVar[bool] = False

    @abstractmethod
    def init(self, route: Any) -> Any:
        """Return the guidance's state of vehicles (n,) at the start of their routes."""

    @abstractmethod
    def step(self, state: Any, route: Any, position_ned: Vec3, others_ned: Vec3 | None = None) -> tuple[Any, object]:
        """Return the state after a tick, and the set-point (n,), for estimated positions ``position_ned`` (n,) [m]."""

    @abstractmethod
    def setpoint(self, state: Any, route: Any) -> object:
        """Return the set-point (n,) to fly to in a state of the guidance, without advancing the state."""


@record
class Preflight:
    """Conditions of vehicles (n,) before their start, for estimators that have ``first_normals``."""

    normals: tuple[Array, ...] = quantity(unit="1", doc="standard normals, as many as the estimator draws")
    at_rest: Array | None = quantity(default=None, doc="bool: starts on the ground; None: all start in flight")
    rates_bias: Vec3 | None = quantity(
        default=None, unit="rad/s", doc="error of the body rates of a level vehicle at rest; None if unknown"
    )


@runtime_checkable
class Estimator(Protocol):
    """Maps the readings of a fleet to the estimate for its controller.

    Attributes:
        reads: kinds of sensors that it needs, by their names in the catalogue.
        instead: of a kind that it needs, the kind that serves as well.
        first_normals: standard normals that a start draws for each vehicle; above 0, ``begin`` takes the place of
            ``init``.
    """

    reads: ClassVar[tuple[str, ...]] = ()
    instead: ClassVar[Mapping[str, str]] = {}
    first_normals: int = 0

    def fitted(self, ages: Mapping[str, int], earth_field_ned: Vec3 | None = None) -> Estimator:
        """Return the estimator for a fleet's sensors; ``ages`` gives each sensor's delay [ticks] by its name.

        ``earth_field_ned`` [uT] is the magnetic field of the site; None where no sensor knows it.
        """
        return self

    @abstractmethod
    def init(self, readings: Mapping[str, object], start: Estimate) -> tuple[Any, Estimate]:
        """Return the estimator's state and the estimate (n,) at the start of a flight.

        Args:
            readings: the first reading (n,) of each sensor, by its name in the fleet.
            start: what is known of the start of each vehicle (n,).
        """

    def begin(self, readings: Mapping[str, object], start: Estimate, preflight: Preflight) -> tuple[Any, Estimate]:
        """Return state and estimate (n,) at the start, for an estimator with random initial errors (``preflight``)."""
        return self.init(readings, start)

    @abstractmethod
    def step(
        self, state: Any, readings: Mapping[str, Any], fresh: Mapping[str, Array], dt: float
    ) -> tuple[Any, Estimate]:
        """Return the estimator's state after a tick of dt [s], and the estimate (n,).

        Args:
            state: before it.
            readings: the reading (n,) of each sensor, by its name in the fleet; held between its periods.
            fresh: () bool of each sensor, whether its reading is new.
        """

    def std(self, state: Any) -> Estimate | None:
        """Return the standard deviations (n,) of the estimate by the estimator's own covariance; None without one."""
        return None

    def inner(self, state: Any) -> tuple[object, object] | None:
        """Return other estimated quantities, such as biases, as a record of (n,), and their stds; None without any."""
        return None

    def consistency(self, state: Any, truth: Truth) -> Consistency | None:
        """Return the squared estimation errors (n,) over the reported covariance (NEES); None without a covariance."""
        return None

    def innovations(self, state: Any) -> object | None:
        """Return the innovations of the last readings, in standard deviations, as a record of (n,); None without."""
        return None
