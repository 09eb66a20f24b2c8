"""The identified quadrotor: a second-order model that includes the platform's own stabilisation.

Symington, De Nardi, Julier, Hailes, "Simulating Quadrotor UAVs in Outdoor Scenarios", IROS 2014, eqs. 1-6;
the defaults are the constants identified there for an AscTec Pelican. Where the paper and its reference
implementation differ or err, docs/explanation/differences.md says what is built here and why.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import ClassVar, Literal

import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax import Array

from qrsim.core.arrays import NumpyArray
from qrsim.core.fastmath import sincos, wrap_angle
from qrsim.core.integrate import INTEGRATORS
from qrsim.core.noise import Noise
from qrsim.core.tree import parameter, quantity, record, setting
from qrsim.core.vectors import AttitudeTrig, Euler, Vec3, euler_rates
from qrsim.models.vehicles.commands import clipped, fields_of, limits_of
from qrsim.models.vehicles.contracts import Around, Handling, Load, Point, Pose, Vehicle, smaller
from qrsim.models.vehicles.process_noise import NORMALS, ProcessNoise, white_accelerations
from qrsim.models.vehicles.wake import Wake

PITCH_ROLL_RAD_PER_RAW = -math.radians(0.025)
THROTTLE_RAW_PER_UNIT = 4097.0
YAW_RATE_RAD_S_PER_RAW = -math.radians(254.760 / 2047.0)


@record
class Command:
    """Command to the autopilot; each of shape (n,)."""

    pitch: Array = quantity(unit="rad", doc="pitch angle, nose up positive", minimum=-0.9, maximum=0.9)
    roll: Array = quantity(unit="rad", doc="roll angle, right side down positive", minimum=-0.9, maximum=0.9)
    throttle: Array = quantity(unit="1", doc="collective throttle", minimum=0.0, maximum=1.0)
    yaw_rate: Array = quantity(
        unit="rad/s", doc="yaw rate, clockwise seen from above positive", minimum=-4.5, maximum=4.5
    )
    battery: Array = quantity(unit="V", doc="battery voltage, which limits the thrust", minimum=9.0, maximum=12.0)


COMMAND_FIELDS = fields_of(Command)
COMMAND_LIMITS = limits_of(Command)
# The published controllers' throttle that carries the weight, and the highest voltage.
IDLE_THROTTLE, IDLE_BATTERY = 0.59, 12.0
# Distance between opposite rotors of a Pelican [m].
SIZE = 0.42


@record
class QuadrotorState:
    """The 13 states; each array of shape (n,)."""

    position_ned: Vec3 = quantity(unit="m", doc="position in the local tangent plane")
    attitude: Euler = quantity(unit="rad", doc="ZYX Euler angles")
    velocity_body: Vec3 = quantity(unit="m/s", doc="velocity over ground in body axes (u, v, w)")
    rates_body: Vec3 = quantity(unit="rad/s", doc="body rates (p, q, r)")
    thrust: Array = quantity(unit="N", doc="collective thrust, positive up")


@record
class Quadrotor(Vehicle):
    """The identified AscTec Pelican with its stabilisation; each parameter is a number, or one per vehicle (n,)."""

    mass: Array = parameter(default=1.68, unit="kg", doc="take-off mass", above=0.0)
    gravity: Array = parameter(default=9.81, unit="m/s^2", doc="gravitational acceleration", minimum=0.0)
    kpq0: Array = parameter(default=-3.25060e-04, unit="rad/raw", doc="roll and pitch command scale (Kpq0)")
    kpq1: Array = parameter(default=1.79797e02, unit="1/s^2", doc="roll and pitch stiffness (Kpq1)")
    kpq2: Array = parameter(default=-24.3536, unit="1/s", doc="roll and pitch damping (Kpq2)")
    kr0: Array = parameter(default=-4.81783e-03, unit="rad/s^2/raw", doc="yaw-rate command scale (Kr0)")
    kr1: Array = parameter(default=-5.08944, unit="1/s", doc="yaw-rate damping (Kr1)")
    kuv: Array = parameter(default=-0.497391, unit="1/s", doc="drag along body x and y (Kuv)", maximum=0.0)
    kw: Array = parameter(default=-1.35341, unit="1/s", doc="drag along body z (Kw)", maximum=0.0)
    cth0: Array = parameter(default=6.63881e-01, unit="N", doc="throttle to thrust, constant (Cth0)")
    cth1: Array = parameter(default=7.44649e-04, unit="N/raw", doc="throttle to thrust, linear (Cth1)")
    cth2: Array = parameter(default=2.39855e-06, unit="N/raw^2", doc="throttle to thrust, quadratic (Cth2)")
    cvb0: Array = parameter(default=-18.0007, unit="N", doc="largest thrust at a battery voltage, constant (Cvb0)")
    cvb1: Array = parameter(default=4.23754, unit="N/V", doc="largest thrust at a battery voltage, linear (Cvb1)")
    tau0: Array = parameter(
        default=3.07321, unit="1/s", doc="thrust response below throttle_min_raw (tau0)", minimum=0.0
    )
    tau1: Array = parameter(default=46.8004, unit="N/s", doc="fastest change of thrust (tau1)", minimum=0.0)
    throttle_min_raw: Array = parameter(default=300.0, unit="raw", doc="throttle below which the rotors idle (u_min)")
    rate_max: Array = parameter(
        default=math.radians(150.0), unit="rad/s", doc="autopilot's roll and pitch rate limit", above=0
    )
    process_noise: Array = parameter(
        default=0.2, unit="m/s^2, rad/s^2", doc="std of the six white accelerations at a step of 0.02 s", minimum=0.0
    )
    integrator: Literal["heun", "rk4"] = setting(default="heun", doc="fixed-step rule")
    downwash: Literal["felt", "at_centre", "ignored"] = setting(
        default="felt",
        doc="wakes of other vehicles; felt: averaged over the vehicle's extent; at_centre: at its "
        "centre, by the law of the first edition; ignored: none",
    )
    command_type: ClassVar[type] = Command
    actions: ClassVar[tuple[type, ...]] = (Command,)
    normals: ClassVar[int] = NORMALS
    # The autopilot holds roll and pitch rates at rate_max, but its clamp acts one step late: a full reversal of the
    # tilt overshoots it to 4.8 rad/s in steps of 0.02 s, and to 13 rad/s in the longest ones of 0.1 s.
    default_limits: ClassVar[Mapping[str, float]] = MappingProxyType({"rate": 20.0})
    default_controller: ClassVar[str] = "cascade"
    pushable: ClassVar[tuple[str, ...]] = ("x", "y", "z")
    adds_position: ClassVar[bool] = True

    def initial_state(
        self, position_ned: Vec3, attitude: Euler, velocity_body: Vec3, rates_body: Vec3
    ) -> QuadrotorState:
        """Return the state at a pose, with a thrust that carries the weight."""
        weight = jnp.asarray(self.mass * self.gravity)
        thrust = jnp.broadcast_to(weight, position_ned.x.shape)
        return QuadrotorState(position_ned, attitude, velocity_body, rates_body, thrust)

    def with_wrapped_yaw(self, state: QuadrotorState) -> QuadrotorState:
        """Return the state with its yaw wrapped to [-pi, pi]."""
        return replace(state, attitude=replace(state.attitude, yaw=wrap_angle(state.attitude.yaw)))

    def with_thrust(self, state: QuadrotorState, thrust: Array) -> QuadrotorState:
        """Return the state with a thrust (n,) [N]; unchanged where that is NaN."""
        return replace(state, thrust=jnp.where(jnp.isfinite(thrust), thrust, state.thrust))

    def idle_command(self, like: Array) -> Command:
        """Return the command for level hover, at the published throttle and voltage; ``like``: any array (n,)."""
        zero = jnp.zeros_like(like)
        return Command(zero, zero, jnp.full_like(like, IDLE_THROTTLE), zero, jnp.full_like(like, IDLE_BATTERY))

    def clip(self, command: Command, powered: bool = False) -> tuple[Command, Array]:
        """Return a command clipped to its limits, but for a battery's voltage, and (n,) bool: it was changed."""
        return clipped(command, ("battery",) if powered else ())

    def powered(self, command: Command, voltage: Array | None) -> Command:
        """Return a command with a battery's voltage (n,) [V] put in; None keeps the commanded voltage."""
        return command if voltage is None else replace(command, battery=voltage)

    def handling(self) -> Handling | None:
        """Return mass, thrust and steady command responses, from the identified constants (eqs. 1-5 at rest)."""
        raw = THROTTLE_RAW_PER_UNIT
        curve = (self.cth0, self.cth1 * raw, self.cth2 * raw * raw)
        return Handling(
            mass=self.mass,
            gravity=self.gravity,
            thrust_max=smaller(curve[0] + curve[1] + curve[2], self.cvb0 + self.cvb1 * IDLE_BATTERY),
            throttle_curve=curve,
            tilt_gain=self.kpq0 * (1.0 / PITCH_ROLL_RAD_PER_RAW),
            yaw_rate_gain=-self.kr0 / self.kr1 * (1.0 / YAW_RATE_RAD_S_PER_RAW),
            tilt_max=COMMAND_LIMITS["pitch"][1],  # type: ignore[arg-type]
        )

    def tilt_command(self, pitch: Array, roll: Array, throttle: Array, yaw_rate: Array) -> Command:
        """Return the command (n,) for tilt [rad], throttle and yaw rate [rad/s], at the highest identified voltage."""
        return Command(pitch, roll, throttle, yaw_rate, jnp.full_like(pitch, IDLE_BATTERY))

    def leaning(self, tilt: NumpyArray) -> tuple[npt.ArrayLike, npt.ArrayLike]:
        """Return airspeed [m/s] and thrust [N] (n,) of steady flight at a tilt (n,) [rad] (eq. 6 in equilibrium).

        Drag across the body pushes it down as well: kw w is larger than kuv u.
        """
        drag = np.abs(np.asarray(self.kuv, np.float64))
        with np.errstate(divide="ignore"):
            airspeed = np.asarray(self.gravity) * np.tan(tilt) / drag
        # Without drag there is no airspeed that a lean holds.
        down = np.where(np.isfinite(airspeed), (np.abs(self.kw) - drag) * airspeed * np.sin(tilt) * np.cos(tilt), 0.0)
        return airspeed, self.mass * (self.gravity + down) / np.cos(tilt)

    def wake(self) -> Wake:
        """Return the wake parameters of the Pelican: 10-inch rotors, 0.42 m apart."""
        one = jnp.ones_like(jnp.asarray(self.mass))
        return Wake(SIZE * one, 4.0 * math.pi * 0.127**2 * one)

    def wake_points(self) -> tuple[Point, ...]:
        """Return the positions of the Pelican's rotor hubs, in body axes [m]."""
        arm = 0.5 * SIZE
        return ((arm, 0.0, 0.0), (0.0, arm, 0.0), (-arm, 0.0, 0.0), (0.0, -arm, 0.0))

    def upright_share(self, command: Command) -> Array:
        """Return the cosine of the tilt (n,) at which a command settles: the thrust's vertical share."""
        gain = self.kpq0 * (1.0 / PITCH_ROLL_RAD_PER_RAW)
        return sincos(gain * command.pitch)[1] * sincos(gain * command.roll)[1]

    def load(self, state: QuadrotorState) -> Load:
        """Return thrust and weight as battery load; this model has no power."""
        return Load(state.thrust, self.mass * self.gravity)

    def pose(self, state: QuadrotorState) -> Pose:
        """Return position, attitude, velocity and body rates (n,) of a state."""
        return Pose(state.position_ned, state.attitude, state.velocity_body, state.rates_body)

    def stopped(self, state: QuadrotorState) -> QuadrotorState:
        """Return the state with all motion set to zero; the thrust is kept."""
        rest = Vec3.zeros(state.thrust.shape, state.thrust.dtype)
        return replace(state, velocity_body=rest, rates_body=rest)

    def specific_force(
        self,
        state: QuadrotorState,
        command: Command,
        air_velocity: Callable[[AttitudeTrig], Vec3],
        noise: ProcessNoise,
        dt: float,
        around: Around | None = None,
    ) -> Vec3:
        """Return the specific force (n,) [m/s^2] in body axes at an instant; arguments as of ``step``."""
        return self.derivative(state, command, air_velocity, noise, dt)[1]

    def draw_noise(self, draw: Noise, dt: float) -> ProcessNoise:
        """Return a step's random accelerations, as white noise of a fixed spectral density: std sigma sqrt(0.02/dt)."""
        return white_accelerations(draw, self.process_noise, dt)

    def step(
        self,
        state: QuadrotorState,
        command: Command,
        air_velocity: Callable[[AttitudeTrig], Vec3],
        noise: ProcessNoise,
        dt: float,
        around: Around | None = None,
    ) -> tuple[QuadrotorState, Vec3]:
        """Return the state dt [s] later for a command (n,), and the mean specific force (n,) [m/s^2], body axes.

        Args:
            state: arrays of shape (n,).
            command: within COMMAND_LIMITS, applied during the whole step.
            air_velocity: attitude -> air velocity in body axes [m/s].
            noise: held during the whole step.
            dt: step [s].
            around: not read.

        Returns:
            The state after the step and the mean specific force [m/s^2] during it, in body axes.
        """

        def slope(current: QuadrotorState) -> tuple[QuadrotorState, Vec3]:
            """Return the time derivative of a state, and the specific force (n,) [m/s^2]."""
            return self.derivative(current, command, air_velocity, noise, dt)

        return INTEGRATORS[self.integrator](slope, state, dt)  # type: ignore[return-value]

    def derivative(
        self,
        state: QuadrotorState,
        command: Command,
        air_velocity: Callable[[AttitudeTrig], Vec3],
        noise: ProcessNoise,
        dt: float,
    ) -> tuple[QuadrotorState, Vec3]:
        """Return the state's time derivative, and the specific force (n,) [m/s^2] in body axes (eqs. 1-6)."""
        trig = AttitudeTrig.of(state.attitude)
        direction = trig.rotation()
        thrust_rate = self.thrust_rate(state.thrust, command.throttle, command.battery, dt)
        velocity, rates = state.velocity_body, state.rates_body
        relative = velocity - air_velocity(trig)
        lift = (state.thrust + dt * thrust_rate) * (1.0 / self.mass)
        aerodynamic = Vec3(self.kuv * relative.x, self.kuv * relative.y, self.kw * relative.z - lift)
        # Process noise is a real force, so an accelerometer feels it.
        force = aerodynamic + noise.linear
        weight = Vec3(direction.forward.z, direction.right.z, direction.down.z) * self.gravity
        acceleration = force + weight - rates.cross(velocity)
        slope = QuadrotorState(
            direction.to_ned(velocity),
            euler_rates(trig, rates),
            acceleration,
            self.angular_acceleration(state, command) + noise.angular,
            thrust_rate,
        )
        return slope, force

    def thrust_rate(self, thrust: Array, throttle: Array, battery: Array, dt: float) -> Array:
        """Return the thrust's rate dF/dt [N/s] from thrust [N], throttle [0, 1] and battery [V] (eqs. 1-3)."""
        raw = throttle * THROTTLE_RAW_PER_UNIT
        wanted = self.wanted_thrust(throttle)
        ceiling = self.cvb0 + self.cvb1 * battery
        missing = jnp.minimum(wanted, ceiling) - thrust
        limited = jnp.clip(missing * (1.0 / dt), -self.tau1, self.tau1)
        return jnp.where(raw < self.throttle_min_raw, self.tau0 * missing, limited)

    def wanted_thrust(self, throttle: Array) -> Array:
        """Return the steady thrust (n,) [N] at a throttle (n,) [0, 1]."""
        raw = throttle * THROTTLE_RAW_PER_UNIT
        return self.cth0 + raw * (self.cth1 + raw * self.cth2)

    def angular_acceleration(self, state: QuadrotorState, command: Command) -> Vec3:
        """Return the angular acceleration (n,) [rad/s^2] of the stabilised body for a command (eqs. 4-5)."""
        rates, attitude = state.rates_body, state.attitude
        roll_raw = command.roll * (1.0 / PITCH_ROLL_RAD_PER_RAW)
        pitch_raw = command.pitch * (1.0 / PITCH_ROLL_RAD_PER_RAW)
        yaw_raw = command.yaw_rate * (1.0 / YAW_RATE_RAD_S_PER_RAW)
        roll = self.kpq1 * (self.kpq0 * roll_raw - attitude.roll) + self.kpq2 * rates.x
        pitch = self.kpq1 * (self.kpq0 * pitch_raw - attitude.pitch) + self.kpq2 * rates.y
        return Vec3(
            self._rate_limited(roll, rates.x),
            self._rate_limited(pitch, rates.y),
            self.kr0 * yaw_raw + self.kr1 * rates.z,
        )

    def _rate_limited(self, acceleration: Array, rate: Array) -> Array:
        """Return the angular acceleration, set to 0 where it would increase a rate beyond ``rate_max``."""
        outward = (jnp.abs(rate) >= self.rate_max) & (acceleration * rate > 0.0)
        return jnp.where(outward, 0.0, acceleration)


def raw_to_command(pitch: Array, roll: Array, throttle: Array, yaw: Array, battery: Array) -> Command:
    """Return a command in SI units from the raw units of flight recordings (docs/howto/identify_from_logs.md)."""
    return Command(
        pitch * PITCH_ROLL_RAD_PER_RAW,
        roll * PITCH_ROLL_RAD_PER_RAW,
        throttle / THROTTLE_RAW_PER_UNIT,
        yaw * YAW_RATE_RAD_S_PER_RAW,
        battery,
    )
