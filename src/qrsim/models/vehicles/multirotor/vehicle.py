"""The multirotor: its parameters, and the contract of a vehicle."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, ClassVar, Literal

import jax.numpy as jnp
from jax import Array

from qrsim.core.noise import Noise
from qrsim.core.quaternions import Quaternion
from qrsim.core.tree import parameter, quantity, record, replace, setting
from qrsim.core.vectors import AttitudeTrig, Euler, Vec3
from qrsim.models.scene.area import reason_code
from qrsim.models.vehicles.commands import clipped
from qrsim.models.vehicles.contracts import Around, Check, Handling, Load, Pose, Vehicle
from qrsim.models.vehicles.multirotor.commands import (
    TILT_MAX_RAD,
    AttitudeCommand,
    MotorCommand,
    Powered,
    RateCommand,
    shown,
)
from qrsim.models.vehicles.multirotor.contact import Contact
from qrsim.models.vehicles.multirotor.flight import Noises, at_an_instant, fly
from qrsim.models.vehicles.multirotor.geometry import Rotor, Triple
from qrsim.models.vehicles.multirotor.stabiliser import Stabiliser
from qrsim.models.vehicles.multirotor.state import Brush, MultirotorState

# The process noise is quoted per step of this length, as that of the identified quadrotor.
PROCESS_NOISE_STEP_S = 0.02
_X500 = (
    Rotor((0.174, 0.174, -0.06), -1), Rotor((-0.174, 0.174, -0.06), 1),
    Rotor((-0.174, -0.174, -0.06), -1), Rotor((0.174, -0.174, -0.06), 1),
)  # fmt: skip
_X500_FEET = ((0.15, 0.15, 0.2), (-0.15, 0.15, 0.2), (-0.15, -0.15, 0.2), (0.15, -0.15, 0.2))


class _Actions:
    """Which commands a vehicle accepts: of a class any number of rotors, of a vehicle its own."""

    def __get__(self, vehicle: Multirotor | None, owner: type) -> tuple[type[Any], ...]:
        motors = MotorCommand if vehicle is None else MotorCommand.of_count(len(vehicle.rotors))
        return (AttitudeCommand, RateCommand, motors)


@record
class Multirotor(Vehicle):
    """A rigid body under any number of rotors; the defaults are those of the X500 of PX4's Gazebo models.

    A number is one for all, or one per vehicle (n,). Where rotors and contact points are is part of the program.
    """

    mass: Array = parameter(default=2.0643, unit="kg", doc="take-off mass", above=0.0)
    gravity: Array = parameter(default=9.81, unit="m/s^2", doc="acceleration of free fall", above=0.0)
    inertia_x: Array = parameter(default=0.02166667, unit="kg m^2", doc="moment of inertia, roll", above=0.0)
    inertia_y: Array = parameter(default=0.02166667, unit="kg m^2", doc="moment of inertia, pitch", above=0.0)
    inertia_z: Array = parameter(default=0.04, unit="kg m^2", doc="moment of inertia, yaw", above=0.0)
    thrust_coefficient: Array = parameter(
        default=8.54858e-6, unit="N s^2", doc="thrust of a rotor over its speed squared (k_T)", above=0.0
    )
    torque_ratio: Array = parameter(
        default=0.016, unit="m", doc="reaction torque of a rotor over its thrust (k_Q/k_T)", above=0.0
    )
    speed_max: Array = parameter(
        default=1000.0, unit="rad/s", doc="largest rotor speed at the nominal voltage", above=0.0
    )
    spin_up: Array = parameter(default=0.0125, unit="s", doc="time constant of a rotor that speeds up", above=0.0)
    spin_down: Array = parameter(default=0.025, unit="s", doc="time constant of a rotor that slows down", above=0.0)
    rotor_radius: Array = parameter(default=0.128, unit="m", doc="radius of a rotor", above=0.0)
    rotor_inertia: Array = parameter(
        default=0.0, unit="kg m^2", doc="moment of inertia of a rotor about its axis", minimum=0.0
    )
    rotor_drag: Array = parameter(
        default=8.06428e-5, unit="N s^2/m", doc="drag of a rotor in its plane over its speed and airspeed (k_d)",
        minimum=0.0,
    )  # fmt: skip
    inflow_loss: Array = parameter(
        default=0.0, unit="N s^2/m", doc="thrust that a rotor loses over its speed and the inflow (k_z)", minimum=0.0
    )
    translational_lift: Array = parameter(
        default=0.0, unit="N s^2/m^2", doc="thrust that a rotor gains over its airspeed squared (k_h)", minimum=0.0
    )
    flapping: Array = parameter(
        default=0.0, unit="N s^2", doc="moment of flapping blades over rotor speed and airspeed (k_flap)", minimum=0.0
    )
    drag_x: Array = parameter(default=0.02, unit="N s^2/m^2", doc="drag of the body, forward", minimum=0.0)
    drag_y: Array = parameter(default=0.02, unit="N s^2/m^2", doc="drag of the body, sideways", minimum=0.0)
    drag_z: Array = parameter(default=0.03, unit="N s^2/m^2", doc="drag of the body, vertical", minimum=0.0)
    air_density: Array = parameter(default=1.225, unit="kg/m^3", doc="density of the air", above=0.0)
    throttle_curve: Array = parameter(
        default=1.0, unit="1", doc="a of thrust/largest thrust = a u^2 + (1 - a) u at throttle u",
        minimum=0.0, maximum=1.0,
    )  # fmt: skip
    nominal_voltage: Array = parameter(
        default=14.8, unit="V", doc="below it the largest rotor speed falls with the voltage of a battery", above=0.0
    )
    efficiency: Array = parameter(
        default=0.75, unit="1", doc="power at the rotors' shafts over that from the battery", above=0.0, maximum=1.0
    )
    avionics_power: Array = parameter(default=5.0, unit="W", doc="power of all but the motors", minimum=0.0)
    process_noise: Array = parameter(
        default=0.0, unit="m/s^2, rad/s^2", doc="std of the six white accelerations at a step of 0.02 s", minimum=0.0
    )
    crash_speed: Array = parameter(
        default=3.0, unit="m/s", doc="speed into the ground at which the vehicle breaks", above=0.0
    )
    stabiliser: Stabiliser = quantity(default=Stabiliser(), doc="the autopilot's inner loops")
    contact: Contact = quantity(default=Contact(), doc="how the vehicle meets the ground")
    rotors: tuple[Rotor, ...] = setting(default=_X500, doc="position [m], direction and axis of each rotor")
    feet: tuple[Triple, ...] = setting(default=_X500_FEET, doc="contact points that carry it, body axes [m]")
    top: Triple = setting(default=(0.0, 0.0, -0.1), doc="the highest point, which touches when it lies on its back [m]")
    longest_substep: float = setting(
        default=0.004, unit="s", doc="a time step is flown in equal parts of at most this length", above=0.0
    )
    on_failure: Literal["none", "reallocate"] = setting(
        default="none", doc="what the stabiliser does 0.1 s after a rotor has failed"
    )
    crash: Literal["stop", "none"] = setting(
        default="stop", doc="whether a rotor on the ground, or a touch above crash_speed, ends the flight"
    )
    command_type: ClassVar[type[Any]] = AttitudeCommand
    actions: ClassVar[tuple[type[Any], ...]] = _Actions()  # type: ignore[assignment]
    normals: ClassVar[int] = 6
    reads: ClassVar[tuple[str, ...]] = ("ground", "air_rates", "downwash")
    default_controller: ClassVar[str] = "cascade"

    @property
    def inertia(self) -> Vec3:
        """Moments of inertia [kg m^2]."""
        return Vec3(self.inertia_x, self.inertia_y, self.inertia_z)

    @property
    def drag(self) -> Vec3:
        """Drag coefficients of the body [N s^2/m^2]."""
        return Vec3(self.drag_x, self.drag_y, self.drag_z)

    @property
    def others(self) -> tuple[Triple, ...]:
        """Contact points that are no feet: the rotors' hubs and the top [m]."""
        return (*(rotor.position for rotor in self.rotors), self.top)

    @property
    def lift_share(self) -> float:
        """Collective thrust over the thrust of one rotor, if all turn alike."""
        return -sum(rotor.axis[2] for rotor in self.rotors)

    @property
    def thrust_max(self) -> Array:
        """Largest collective thrust at the nominal voltage [N]."""
        return self.thrust_coefficient * (self.speed_max * self.speed_max * self.lift_share)

    def thrust_of(self, throttle: Array) -> Array:
        """Return the collective thrust [N] at a throttle (n,), 0 to 1 (V44)."""
        a = self.throttle_curve
        return self.thrust_max * throttle * (a * throttle + (1.0 - a))

    def throttle_of(self, thrust: Array) -> Array:
        """Return the throttle at a collective thrust [N]."""
        a, share = self.throttle_curve, thrust / self.thrust_max
        return 2.0 * share / ((1.0 - a) + jnp.sqrt((1.0 - a) * (1.0 - a) + 4.0 * a * share))

    def initial_state(
        self, position_ned: Vec3, attitude: Euler, velocity_body: Vec3, rates_body: Vec3
    ) -> MultirotorState:
        """Return a state whose rotors carry the weight."""
        like = jnp.asarray(position_ned.x)
        zero = jnp.zeros_like(like)
        speed = jnp.sqrt(self.mass * self.gravity / (self.thrust_coefficient * self.lift_share))
        return MultirotorState(
            position_ned, Quaternion.of(attitude), velocity_body, rates_body,
            (jnp.broadcast_to(speed, like.shape),) * len(self.rotors),
            jnp.asarray(attitude.yaw), Vec3(zero, zero, zero),
            (Brush(zero, zero),) * (len(self.feet) + len(self.others)),
            zero, zero, zero,
        )  # fmt: skip

    def with_thrust(self, state: MultirotorState, thrust: Array) -> MultirotorState:
        """Return a state at a collective thrust (n,) [N]; a NaN leaves it as it is."""
        speed = jnp.sqrt(jnp.maximum(thrust, 0.0) / (self.thrust_coefficient * self.lift_share))
        given = jnp.isfinite(thrust)
        return replace(state, rotor_speed=tuple(jnp.where(given, speed, old) for old in state.rotor_speed))

    def idle_command(self, like: Array) -> AttitudeCommand:
        """Return level hover."""
        zero = jnp.zeros_like(like)
        throttle = self.throttle_of(jnp.asarray(self.mass * self.gravity))
        return AttitudeCommand(zero, zero, jnp.broadcast_to(throttle, like.shape), zero)

    def clip(self, command: Any, powered: bool = False) -> tuple[Any, Array]:
        """Bring a command into its limits."""
        if isinstance(command, Powered):
            inside, changed = clipped(command.command)
            return replace(command, command=inside), changed
        return clipped(command)

    def powered(self, command: Any, voltage: Array | None) -> Any:
        """Return a command together with a battery's voltage (n,) [V]; None: as at the nominal voltage."""
        return command if voltage is None else Powered(command, voltage)

    def shown(self, command: Any) -> AttitudeCommand:
        """Return a command as a world's state keeps it; NaN in the fields that it has not."""
        return shown(command)

    def handling(self) -> Handling:
        """Return what a controller of tilt and throttle knows of it."""
        a, most = self.throttle_curve, self.thrust_max
        one = jnp.ones_like(jnp.asarray(most))
        curve = (jnp.zeros_like(one), (1.0 - a) * most, a * most)
        return Handling(
            jnp.asarray(self.mass), jnp.asarray(self.gravity), jnp.asarray(most), curve, one, one, TILT_MAX_RAD * one
        )

    def tilt_command(self, pitch: Array, roll: Array, throttle: Array, yaw_rate: Array) -> AttitudeCommand:
        """Return its own command (n,) of tilt [rad], throttle [0, 1] and yaw rate [rad/s]."""
        return AttitudeCommand(pitch, roll, throttle, yaw_rate)

    def load(self, state: MultirotorState) -> Load:
        """Return thrust, weight and electrical power (V29)."""
        square = sum(rate * rate for rate in state.rotor_speed)
        cube = sum(rate * rate * rate for rate in state.rotor_speed)
        shafts = self.torque_ratio * self.thrust_coefficient * cube
        return Load(
            self.thrust_coefficient * square, self.mass * self.gravity, shafts / self.efficiency + self.avionics_power
        )

    def pose(self, state: MultirotorState) -> Pose:
        """Return position, attitude, velocity and rates (n,)."""
        return Pose(state.position_ned, state.quaternion.euler(), state.velocity_body, state.rates_body)

    def draw_noise(self, draw: Noise, dt: float) -> Noises:
        """Draw the process noise of one step: a white spectral density, sigma(T) = sigma sqrt(0.02/T)."""
        scale = self.process_noise * math.sqrt(PROCESS_NOISE_STEP_S / dt)
        drawn = [normal * scale for normal in draw.normals(6)]
        return Noises(Vec3(*drawn[:3]), Vec3(*drawn[3:]))

    def step(
        self,
        state: MultirotorState,
        command: Any,
        air_velocity: Callable[[AttitudeTrig], Vec3],
        noise: Noises,
        dt: float,
        around: Around | None = None,
    ) -> tuple[MultirotorState, Vec3]:
        """Advance one step in substeps; see ``Vehicle.step``. Without ``around`` the ground is at 0 m, level."""
        return fly(self, state, command, air_velocity, noise, dt, around)

    def specific_force(
        self,
        state: MultirotorState,
        command: Any,
        air_velocity: Callable[[AttitudeTrig], Vec3],
        noise: Noises,
        dt: float,
        around: Around | None = None,
    ) -> Vec3:
        """Return the specific force (n,) [m/s^2] in body axes at an instant, at the present rotor speeds."""
        return at_an_instant(self, state, air_velocity, noise, around)

    def stopped(self, state: MultirotorState) -> MultirotorState:
        """Return the state at rest, the rotors too."""
        rest = Vec3.zeros(state.standing.shape, state.standing.dtype)
        still = tuple(jnp.zeros_like(rate) for rate in state.rotor_speed)
        return replace(state, velocity_body=rest, rates_body=rest, rotor_speed=still)

    def own_checks(self, state: MultirotorState) -> list[Check]:
        """Return the checks of a hard touch, and of a rotor or the top on the ground."""
        if self.crash == "none":
            return []
        hard, hub = reason_code("crashed", "impact_speed"), reason_code("crashed", "hub_contact")
        return [
            (hard, state.impact_speed, state.impact_speed > self.crash_speed),
            (hub, state.hub_contact, state.hub_contact > 0.0),
        ]
