"""The multirotor: its parameters, and the contract of a vehicle."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax import Array

from qrsim.core.arrays import NumpyArray
from qrsim.core.noise import Noise
from qrsim.core.quaternions import Quaternion
from qrsim.core.tree import record, replace
from qrsim.core.vectors import AttitudeTrig, Euler, Vec3
from qrsim.models.atmosphere.standard import DENSITY, SiteAir
from qrsim.models.scene.area import reason_code
from qrsim.models.vehicles.commands import clipped
from qrsim.models.vehicles.contracts import Around, Check, Handling, Load, Outline, Point, Pose, Vehicle
from qrsim.models.vehicles.multirotor.balance import leaning
from qrsim.models.vehicles.multirotor.commands import (
    TILT_MAX_RAD,
    AttitudeCommand,
    MotorCommand,
    Powered,
    RateCommand,
    shown,
)
from qrsim.models.vehicles.multirotor.contact import LANDED_S, START_M
from qrsim.models.vehicles.multirotor.flight import at_an_instant, fly
from qrsim.models.vehicles.multirotor.geometry import dot_known
from qrsim.models.vehicles.multirotor.parameters import Airframe
from qrsim.models.vehicles.multirotor.state import Brush, MultirotorState
from qrsim.models.vehicles.process_noise import NORMALS, ProcessNoise, white_accelerations
from qrsim.models.vehicles.wake import Wake


class _Actions:
    """Which commands a vehicle accepts: of a class any number of rotors, of a vehicle its own."""

    def __get__(self, vehicle: Multirotor | None, owner: type) -> tuple[type, ...]:
        motors = MotorCommand if vehicle is None else MotorCommand.of_count(len(vehicle.rotors))
        return (AttitudeCommand, RateCommand, motors)


@record
class Multirotor(Airframe, Vehicle):
    """A rigid body under any number of rotors, with its stabiliser; the defaults are those of the X500."""

    command_type: ClassVar[type] = AttitudeCommand
    actions: ClassVar[tuple[type, ...]] = _Actions()  # type: ignore[assignment]
    normals: ClassVar[int] = NORMALS
    reads: ClassVar[tuple[str, ...]] = ("ground", "air_rates")
    gives_power: ClassVar[bool] = True
    # Those of the published model are where it was identified; this one is limited by what it is made of.
    default_limits: ClassVar[Mapping[str, float]] = MappingProxyType(
        {"pitch": math.pi / 2.0, "velocity": 40.0, "rate": 30.0}
    )
    default_controller: ClassVar[str] = "cascade"
    pushable: ClassVar[tuple[str, ...]] = ("x", "y", "z")

    def in_air(self, air: SiteAir) -> Multirotor:
        """Return the vehicle in the air of a site; its autopilot's hover throttle is for this air."""
        return replace(self, site_air=air)

    def initial_state(
        self, position_ned: Vec3, attitude: Euler, velocity_body: Vec3, rates_body: Vec3
    ) -> MultirotorState:
        """Return the state at a pose, with rotors at the speed that carries the weight."""
        like = jnp.asarray(position_ned.x)
        zero = jnp.zeros_like(like)
        lift = self.thrust_coefficient * self.lift_share * self.share(position_ned)
        speed = jnp.sqrt(self.mass * self.gravity / lift)
        return MultirotorState(
            position_ned,
            Quaternion.of(attitude),
            velocity_body,
            rates_body,
            (jnp.broadcast_to(speed, like.shape),) * len(self.rotors),
            jnp.asarray(attitude.yaw),
            Vec3(zero, zero, zero),
            (Brush(zero, zero),) * (len(self.feet) + len(self.others)),
            zero,
            zero,
            zero,
        )

    def with_thrust(self, state: MultirotorState, thrust: Array) -> MultirotorState:
        """Return the state with a collective thrust (n,) [N]; unchanged where that is NaN."""
        lift = self.thrust_coefficient * self.lift_share * self.share(state.position_ned)
        speed = jnp.sqrt(jnp.maximum(thrust, 0.0) / lift)
        given = jnp.isfinite(thrust)
        return replace(state, rotor_speed=tuple(jnp.where(given, speed, old) for old in state.rotor_speed))

    def idle_command(self, like: Array) -> AttitudeCommand:
        """Return the command for level hover; ``like``: any array (n,), for the shape."""
        zero = jnp.zeros_like(like)
        throttle = self.throttle_of(jnp.asarray(self.mass * self.gravity / self.site_share))
        return AttitudeCommand(zero, zero, jnp.broadcast_to(throttle, like.shape), zero)

    def clip(self, command: object, powered: bool = False) -> tuple[object, Array]:
        """Return a command clipped to its fields' limits, and (n,) bool: it was changed."""
        if isinstance(command, Powered):
            inside, changed = clipped(command.command)
            return replace(command, command=inside), changed
        return clipped(command)

    def powered(self, command: object, voltage: Array | None) -> object:
        """Return a command with a battery's voltage (n,) [V] put in; None means the nominal voltage."""
        return command if voltage is None else Powered(command, voltage)

    def shown(self, command: object) -> AttitudeCommand:
        """Return a command of any type as the record that a world's state keeps, NaN in fields that it lacks."""
        return shown(command)

    def handling(self) -> Handling:
        """Return mass, thrust and command responses for a tilt-and-throttle controller, in the site's air."""
        a, most = self.throttle_curve, self.thrust_max * self.site_share
        one = jnp.ones_like(jnp.asarray(most))
        curve = (jnp.zeros_like(one), (1.0 - a) * most, a * most)
        return Handling(
            jnp.asarray(self.mass), jnp.asarray(self.gravity), jnp.asarray(most), curve, one, one, TILT_MAX_RAD * one
        )

    def tilt_command(self, pitch: Array, roll: Array, throttle: Array, yaw_rate: Array) -> AttitudeCommand:
        """Return the command (n,) for tilt [rad], throttle [0, 1] and yaw rate [rad/s]."""
        return AttitudeCommand(pitch, roll, throttle, yaw_rate)

    def wake(self) -> Wake:
        """Return the parameters of the vehicle's rotor wake."""
        hubs = [rotor.position for rotor in self.rotors]
        radius = jnp.asarray(self.rotor_radius)
        size = 2.0 * max(math.hypot(x, y) for x, y, _ in hubs)
        return Wake(size * jnp.ones_like(radius), (len(hubs) * math.pi) * (radius * radius))

    def wake_points(self) -> tuple[Point, ...]:
        """Return the positions of the rotor hubs, in body axes [m], at which other wakes act."""
        return tuple(rotor.position for rotor in self.rotors)

    def on_ground(self, state: MultirotorState) -> Array:
        """Return (n,) bool: all feet have carried load for half a second, at a speed below 0.1 m/s."""
        return state.standing >= LANDED_S

    def standing_height(self) -> float:
        """Return the height [m] of the vehicle's origin above level ground: its longest leg."""
        return max(foot[2] for foot in self.feet)

    def stood(self, state: MultirotorState, ground: Callable[[Vec3], tuple[Array, Vec3]]) -> MultirotorState:
        """Return the start state; vehicles at rest with all feet near the ground stand on it, rotors stopped."""
        down, normal = ground(state.position_ned)
        up, height = state.quaternion.rotation().to_body(normal), (state.position_ned.z - down) * normal.z
        depths = [-(height + dot_known(up, foot)) for foot in self.feet]
        near = functools.reduce(jnp.logical_and, [jnp.abs(depth) <= START_M for depth in depths])
        stands = near & (state.velocity_body.norm() + state.rates_body.norm() == 0.0)
        lower = jnp.where(stands, self.contact.sink - functools.reduce(jnp.add, depths) / len(depths), 0.0)
        place = replace(state.position_ned, z=state.position_ned.z + lower)
        return replace(
            state,
            position_ned=place,
            standing=jnp.where(stands, LANDED_S, state.standing),
            rotor_speed=tuple(jnp.where(stands, 0.0, speed) for speed in state.rotor_speed),
        )

    def load(self, state: MultirotorState) -> Load:
        """Return battery load: thrust [N], weight [N], electrical power [W] (eq. V25), air density over sea level's.

        Each is (n,) or one number for all; the density ratio is None if ``thin_air`` is ignored.
        """
        square = sum(rate * rate for rate in state.rotor_speed)
        cube = sum(rate * rate * rate for rate in state.rotor_speed)
        coefficient = self.thrust_coefficient * self.share(state.position_ned)
        power = self.torque_ratio * coefficient * cube / self.efficiency + self.avionics_power
        ratio = None if self.thin_air == "ignored" else self.site_air.density(state.position_ned) * (1.0 / DENSITY)
        return Load(coefficient * square, self.mass * self.gravity, power, ratio)

    def pose(self, state: MultirotorState) -> Pose:
        """Return position, attitude, velocity and body rates (n,) of a state."""
        return Pose(state.position_ned, state.quaternion.euler(), state.velocity_body, state.rates_body)

    def draw_noise(self, draw: Noise, dt: float) -> ProcessNoise:
        """Return a step's random accelerations, as white noise of a fixed spectral density: std sigma sqrt(0.02/dt)."""
        return white_accelerations(draw, self.process_noise, dt)

    def step(
        self,
        state: MultirotorState,
        command: object,
        air_velocity: Callable[[AttitudeTrig], Vec3],
        noise: ProcessNoise,
        dt: float,
        around: Around | None = None,
    ) -> tuple[MultirotorState, Vec3]:
        """Return the state dt [s] later, and the mean specific force (n,); without ``around`` level ground at 0 m."""
        return fly(self, state, command, air_velocity, noise, dt, around)

    def specific_force(
        self,
        state: MultirotorState,
        command: object,
        air_velocity: Callable[[AttitudeTrig], Vec3],
        noise: ProcessNoise,
        dt: float,
        around: Around | None = None,
    ) -> Vec3:
        """Return the specific force (n,) [m/s^2] in body axes at an instant, at the present rotor speeds."""
        return at_an_instant(self, state, air_velocity, noise, around)

    def stopped(self, state: MultirotorState) -> MultirotorState:
        """Return the state with all motion set to zero, the rotors included."""
        rest = Vec3.zeros(state.standing.shape, state.standing.dtype)
        still = tuple(jnp.zeros_like(rate) for rate in state.rotor_speed)
        return replace(state, velocity_body=rest, rates_body=rest, rotor_speed=still)

    def leaning(self, tilt: NumpyArray) -> tuple[npt.ArrayLike, npt.ArrayLike] | None:
        """Return airspeed [m/s] and thrust [N] (n,) of steady flight at a tilt (n,) [rad]; see ``Vehicle.leaning``."""
        return leaning(self, tilt)

    def outline(self) -> Outline:
        """Return the rotors' positions and radius as the outline for pictures."""
        radius = float(np.ravel(np.asarray(self.rotor_radius))[0])
        return Outline(tuple(rotor.position for rotor in self.rotors), radius)

    def own_checks(self, state: MultirotorState) -> list[Check]:
        """Return the stop conditions of a hard touch-down, and of a rotor or the top touching the ground."""
        if self.crash == "none":
            return []
        hard, hub = reason_code("crashed", "impact_speed"), reason_code("crashed", "hub_contact")
        return [
            (hard, state.impact_speed, state.impact_speed > self.crash_speed),
            (hub, state.hub_contact, state.hub_contact > 0.0),
        ]
