"""Protocols of vehicle and battery, as worlds use them.

A component names its contract as its base class. Methods marked abstract are required; the others, and the class
variables, have the defaults that stand here. An argument with a default may be left out of a component's own method.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar, Literal, Protocol, runtime_checkable

import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax import Array

from qrsim.core.arrays import NumpyArray
from qrsim.core.host import on_host
from qrsim.core.noise import Noise
from qrsim.core.tree import quantity, record, replace
from qrsim.core.vectors import AttitudeTrig, Euler, Vec3, rotation
from qrsim.models.atmosphere.standard import SiteAir
from qrsim.models.vehicles.commands import clipped
from qrsim.models.vehicles.wake import Wake

# A check of vehicles: the code of a reason (scene/area.py), the checked value (n,), and whether the limit is broken.
Check = tuple[int, Array, Array]
# What a vehicle may declare in ``reads``.
AROUND = ("ground", "air_rates", "air_density")
# A place in body axes [m]; numbers, or arrays (n,) where vehicles differ.
Point = tuple[Any, Any, Any]


@record
class Load:
    """Load on a battery; each (n,), or one number for all."""

    thrust: Array = quantity(unit="N", doc="collective thrust; NaN where the model has none")
    weight: Array = quantity(unit="N", doc="weight, which is the thrust in hover")
    power: Array | None = quantity(default=None, unit="W", doc="electrical power; None where the model has none")
    density_ratio: Array | None = quantity(
        default=None, unit="1", doc="density of the air over that at sea level; None where the model has none"
    )

    def per_weight(self, like: Array) -> Array:
        """Return thrust over weight (n,), 1 where either is unknown (NaN); ``like``: any array (n,), for the shape."""
        ratio = jnp.broadcast_to(jnp.asarray(self.thrust / self.weight, like.dtype), like.shape)
        return jnp.where(jnp.isfinite(ratio), ratio, 1.0)


@record
class Pose:
    """Position, attitude, velocity and rates of each vehicle (n,), for any vehicle model."""

    position_ned: Vec3 = quantity(unit="m", doc="position in the site's frame")
    attitude: Euler = quantity(unit="rad", doc="ZYX Euler angles")
    velocity_body: Vec3 = quantity(unit="m/s", doc="velocity over ground in body axes")
    rates_body: Vec3 = quantity(unit="rad/s", doc="body rates")


@record
class Handling:
    """Properties of a vehicle for controllers that command tilt and throttle; each a number or (n,)."""

    mass: Array = quantity(unit="kg", doc="take-off mass")
    gravity: Array = quantity(unit="m/s^2", doc="gravitational acceleration")
    thrust_max: Array = quantity(unit="N", doc="largest steady thrust at the nominal voltage")
    throttle_curve: tuple[Array, Array, Array] = quantity(
        unit="N", doc="c0, c1, c2: the steady thrust is c0 + c1 u + c2 u^2 at throttle u, 0 to 1; it grows with u"
    )
    tilt_gain: Array = quantity(unit="1", doc="settled tilt per commanded tilt")
    yaw_rate_gain: Array = quantity(unit="1", doc="settled yaw rate per commanded yaw rate")
    tilt_max: Array = quantity(unit="rad", doc="largest tilt command of each axis")
    pitch_gain: Array | None = quantity(
        default=None, unit="1", doc="settled pitch per commanded pitch, where it is not tilt_gain"
    )

    def throttle(self, thrust: Array) -> Array:
        """Return the throttle (n,), 0 to 1, for a steady thrust (n,) [N]: the inverse of the throttle curve."""
        c0, c1, c2 = self.throttle_curve
        missing = thrust - c0
        # Of the two forms of the root the one that also solves a straight line.
        root = jnp.sqrt(jnp.maximum(c1 * c1 + 4.0 * c2 * missing, 0.0))
        return jnp.clip(2.0 * missing / jnp.maximum(c1 + root, 1e-6), 0.0, 1.0)


def smaller(a: object, b: object) -> Any:
    """Return the elementwise minimum of two numbers or arrays, as JAX arrays if one of them is."""
    return (jnp if isinstance(a, Array) or isinstance(b, Array) else np).minimum(a, b)


def velocity_of(pose: Pose) -> Vec3:
    """Return the velocity over ground (n,) [m/s] NED of a pose, which has it in body axes."""
    return rotation(pose.attitude).to_ned(pose.velocity_body)


@dataclass(frozen=True)
class Outline:
    """The looks of a vehicle, for pictures, in body axes.

    Attributes:
        rotors: position of the hub of each rotor [m]; none: it is of another kind.
        rotor_radius: of all rotors [m].
        kind: what it is, where it has no rotors.
        size: its span or length [m], where it has no rotors; 0: unknown.
    """

    rotors: tuple[tuple[float, float, float], ...] = ()
    rotor_radius: float = 0.0
    kind: Literal["mast", "car", "plane"] = "mast"
    size: float = 0.0


class VehicleState(Protocol):
    """The part that the state of every vehicle model has: a position; all else is read through ``pose``."""

    @property
    def position_ned(self) -> Vec3:
        """Position (n,) [m] NED, in single precision without its remainder."""
        ...


@dataclass(frozen=True)
class Around:
    """The part of the world that a vehicle may read during a step.

    Attributes:
        ground: positions (n,) [m] -> the down coordinate (n,) [m] of the ground below, and its normal (n,), upwards.
        air_rates: rotation of the air (n,) [rad/s] in body axes, by gusts and by the wakes of other vehicles.
        failed_rotors: of each rotor that a fault may concern its number, how fast it still turns (n,), 1 where it is
            well, and whether that is known to the autopilot (n,) bool.
        stuck_rotors: of each rotor that may be stuck its number, and the part of its largest speed (n,) that
            is commanded instead; negative: it is not stuck.
        air_density: density of the air (n,) [kg/m^3]; None outside a world.
    """

    ground: Callable[[Vec3], tuple[Array, Vec3]]
    air_rates: Vec3
    failed_rotors: tuple[tuple[int, Array, Array], ...] = ()
    air_density: Array | None = None
    stuck_rotors: tuple[tuple[int, Array], ...] = ()


@runtime_checkable
class Vehicle(Protocol):
    """A model of n vehicles; its parameters are numbers or arrays (n,).

    Its state is a record of arrays (n,) with the field ``position_ned`` [m]; all else is read through ``pose``.

    Attributes:
        command_type: record of its own command; each field (n,) carries unit, minimum and maximum.
        actions: command records that it accepts from a user, ``command_type`` among them.
        normals: standard normals that ``draw_noise`` draws for each vehicle.
        reads: what it wants of ``Around``; where that is empty, ``step`` is called without ``around``.
        gives_power: whether its ``load`` has an electrical power.
        default_limits: state limits where a scenario gives none, by name; those that are left out are the published.
        default_controller: name in the catalogue of what flies it where a scenario names no controller.
        rides: whether it moves on the ground, where it is put at a start.
        launches: whether it starts in flight: the velocity of a start is one through the air (``launched``).
        adds_position: whether ``step`` does nothing with the position but add to it. Such a vehicle is given the second
            part of its position in place of the first (``moving.py``), so that short steps far from the origin are
            exact. Each class declares it for itself; a subclass does not inherit it.
        pushable: body axes along which a push changes its velocity (``pushed``); none: it cannot be pushed.
        downwash: whether the wakes of other vehicles are part of its air: ``felt``, ``at_centre`` or ``ignored``.
    """

    command_type: ClassVar[type]
    actions: ClassVar[tuple[type, ...]]
    normals: ClassVar[int] = 0
    reads: ClassVar[tuple[str, ...]] = ()
    gives_power: ClassVar[bool] = False
    default_limits: ClassVar[Mapping[str, float]] = MappingProxyType({})
    default_controller: ClassVar[str] = "waypoint"
    rides: ClassVar[bool] = False
    launches: ClassVar[bool] = False
    adds_position: ClassVar[bool] = False
    pushable: ClassVar[tuple[str, ...]] = ()
    downwash: Any = "felt"

    def prepared(self, duration: float) -> Vehicle:
        """Return the vehicle model for a run of ``duration`` [s], with the files that it names read.

        Raises:
            UsageError: a file cannot be used.
        """
        return self

    def in_air(self, air: SiteAir) -> Vehicle:
        """Return the vehicle model in the air of a site, changed if it depends on air density."""
        return self

    @abstractmethod
    def initial_state(self, position_ned: Vec3, attitude: Euler, velocity_body: Vec3, rates_body: Vec3) -> VehicleState:
        """Return the state of vehicles (n,) at a position [m], attitude [rad], velocity [m/s] and rates [rad/s]."""

    def with_wrapped_yaw(self, state: Any) -> VehicleState:
        """Return the state with its yaw wrapped to [-pi, pi]; quaternion states need no change."""
        found: VehicleState = state
        return found

    def with_thrust(self, state: Any, thrust: Array) -> VehicleState:
        """Return the state with a thrust (n,) [N]; unchanged where that is NaN, or if the model has no thrust state."""
        return state

    @abstractmethod
    def idle_command(self, like: Array) -> object:
        """Return the command (n,) before the first one: hover, trim or zero; ``like``: any array (n,)."""

    def clip(self, command: Any, powered: bool = False) -> tuple[object, Array]:
        """Return a command clipped to its fields' limits, and (n,) bool: it was changed.

        Args:
            command: one of ``actions``.
            powered: whether a battery has set a voltage in it (``powered``), which is no command's to limit.
        """
        return clipped(command)

    def powered(self, command: Any, voltage: Array | None) -> object:
        """Return a command with a battery's voltage (n,) [V] put in; None keeps the command's own voltage."""
        return command

    def shown(self, command: object) -> object:
        """Return a command of any type as the one record that a world's state keeps, NaN in fields that it lacks."""
        return command

    def handling(self) -> Handling | None:
        """Return mass, thrust and command responses for a tilt-and-throttle controller; None for other vehicles."""
        return None

    def tilt_command(self, pitch: Array, roll: Array, throttle: Array, yaw_rate: Array) -> object:
        """Return the vehicle's command (n,) for tilt [rad], throttle [0, 1] and yaw rate [rad/s].

        Raises:
            TypeError: it has none.
        """
        raise TypeError(f"{type(self).__name__} takes no tilt and throttle; it has no tilt_command")

    def leaning(self, tilt: NumpyArray) -> tuple[npt.ArrayLike, npt.ArrayLike] | None:
        """Return airspeed [m/s] and thrust [N] (n,) of steady flight at a tilt (n,) [rad]; None without a formula.

        None where no formula says so; then envelope.py looks for them. Arguments and results are NumPy's.
        """
        return None

    def wake(self) -> Wake | None:
        """Return the parameters of the vehicle's rotor wake, None without a wake; its thrust comes from ``load``."""
        return None

    def wake_points(self) -> tuple[Point, ...]:
        """Return the points in body axes [m] over which the wakes of other vehicles are averaged."""
        return ((0.0, 0.0, 0.0),)

    @abstractmethod
    def load(self, state: Any) -> Load:
        """Return the load on the vehicle's battery: thrust, weight and power, each (n,)."""

    @abstractmethod
    def pose(self, state: Any) -> Pose:
        """Return position, attitude, velocity and body rates (n,) of a state."""

    def draw_noise(self, draw: Noise, dt: float) -> object:
        """Return the random process noise of a step of dt [s], from the ``normals`` standard normals of ``draw``."""
        return None

    @abstractmethod
    def step(
        self,
        state: Any,
        command: Any,
        air_velocity: Callable[[AttitudeTrig], Vec3],
        noise: Any,
        dt: float,
        around: Around | None = None,
    ) -> tuple[VehicleState, Vec3]:
        """Return the state dt [s] later for a command (n,), and the mean specific force (n,) [m/s^2], body axes.

        Args:
            state: before it, arrays (n,).
            command: within its limits, applied during the whole step.
            air_velocity: attitude -> air velocity (n,) [m/s] in body axes.
            noise: what ``draw_noise`` returned.
            dt: step [s].
            around: only where ``reads`` names something.

        Returns:
            The state after it, and the mean specific force (n,) [m/s^2] during it, in body axes.
        """

    def specific_force(
        self,
        state: Any,
        command: Any,
        air_velocity: Callable[[AttitudeTrig], Vec3],
        noise: Any,
        dt: float,
        around: Around | None = None,
    ) -> Vec3:
        """Return the specific force (n,) [m/s^2] in body axes at an instant; arguments as of ``step``."""
        more = (around,) if self.reads else ()
        return self.step(state, command, air_velocity, noise, dt, *more)[1]

    @abstractmethod
    def stopped(self, state: Any) -> VehicleState:
        """Return the state with all motion set to zero, as for vehicles that have been stopped."""

    def upright_share(self, command: Any) -> Array | float:
        """Return the vertical share of the thrust, 0 to 1 (n,), at the tilt at which a command settles."""
        return 1.0

    def on_ground(self, state: Any) -> Array | None:
        """Return (n,) bool: the vehicle is on the ground by its contact model; None without a contact model."""
        return None

    def standing_height(self) -> Array | float:
        """Return the height [m], () or (n,), of the vehicle's origin above level ground when it is parked."""
        return 0.0

    def stood(self, state: Any, ground: Callable[[Vec3], tuple[Array, Vec3]]) -> VehicleState:
        """Return the start state with vehicles that have a contact model put on the ground, given by ``ground``."""
        found: VehicleState = state
        return found

    def launched(self, state: Any, air_ned: Vec3) -> VehicleState:
        """Return the start state in a mean wind ``air_ned`` (n,) [m/s], changed for vehicles that start in flight."""
        found: VehicleState = state
        return found

    def pushed(self, state: Any, change_body: Vec3) -> VehicleState:
        """Return the state after a velocity change (n,) [m/s] in body axes, which is 0 along axes not ``pushable``."""
        found: VehicleState = replace(state, velocity_body=state.velocity_body + change_body)
        return found

    def outline(self) -> Outline | None:
        """Return the vehicle's outline for pictures; None means a quadrotor with a rotor in front."""
        return None

    def own_checks(self, state: Any) -> list[Check]:
        """Return the model's own stop conditions (n,), each (reason code, value, broken)."""
        return []


class Charged(Protocol):
    """The part that the state of every battery that ``drains`` has."""

    @property
    def charge(self) -> Array:
        """State of charge (n,), 1 full, 0 empty."""
        ...


@runtime_checkable
class Battery(Protocol):
    """Source of the voltage of n vehicles; one whose state is None has a voltage.

    Attributes:
        drains: whether its state has a ``charge`` (n,), 1 full and 0 empty, which is logged and ends a flight at 0.
        needs_power: whether it needs vehicles with an electrical power in their ``load``.
        capacity: charge of the full pack [Ah]; None where the model has none.
    """

    drains: ClassVar[bool] = False
    needs_power: ClassVar[bool] = False
    capacity: Any = None

    @abstractmethod
    def init(self, like: Array) -> object:
        """Return the battery's state at the start; ``like``: any array (n,), for the shape."""

    @abstractmethod
    def step(self, state: Any, load: Load, dt: float) -> object:
        """Return the battery's state after dt [s] under a load (n,)."""

    @abstractmethod
    def voltage(self, state: Any, load: Load) -> Array | None:
        """Return the battery voltage (n,) [V] under load; None: each command gives the voltage itself."""

    def own_checks(self, state: Any) -> list[Check]:
        """Return the battery's stop conditions (n,), each (reason code, value, broken), without an empty battery's."""
        return []


# What a controller of tilt and throttle knows of vehicles, a Handling or None, by NumPy.
handling_of = on_host(lambda vehicle: vehicle.handling())


def has_contact(vehicle: object) -> bool:
    """Return whether a vehicle model, or its class, computes ground contact itself."""
    kind: type[Vehicle] = vehicle if isinstance(vehicle, type) else type(vehicle)
    return kind.on_ground is not Vehicle.on_ground
