"""The fixed wing: the contract of a vehicle."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.core.fastmath import sincos
from qrsim.core.quaternions import Quaternion
from qrsim.core.tree import record, replace
from qrsim.core.vectors import AttitudeTrig, Euler, Vec3, root
from qrsim.models.atmosphere.standard import SiteAir
from qrsim.models.vehicles.contracts import Around, Load, Outline, Point, Pose, Vehicle
from qrsim.models.vehicles.fixed_wing.aerodynamics import air_data, propeller
from qrsim.models.vehicles.fixed_wing.commands import AttitudeCommand, SurfaceCommand, shown
from qrsim.models.vehicles.fixed_wing.parameters import Aeroplane
from qrsim.models.vehicles.fixed_wing.rigid_body import slope_of, substep
from qrsim.models.vehicles.fixed_wing.stabiliser import moved, wanted_surfaces
from qrsim.models.vehicles.fixed_wing.state import FixedWingState, Motion, Stabiliser, Surfaces
from qrsim.models.vehicles.fixed_wing.trim import cruise


@record
class FixedWing(Aeroplane, Vehicle):
    """An aeroplane with a propeller at its nose or tail, and its stabiliser; the defaults are the Aerosonde's."""

    command_type: ClassVar[type] = AttitudeCommand
    actions: ClassVar[tuple[type, ...]] = (AttitudeCommand, SurfaceCommand)
    reads: ClassVar[tuple[str, ...]] = ("air_rates", "air_density")
    default_limits: ClassVar[Mapping[str, float]] = MappingProxyType(
        {"pitch": math.pi / 2.0, "velocity": 80.0, "rate": 30.0}
    )
    default_controller: ClassVar[str] = "fixed_wing"
    launches: ClassVar[bool] = True
    pushable: ClassVar[tuple[str, ...]] = ("x", "y", "z")
    adds_position: ClassVar[bool] = True

    def in_air(self, air: SiteAir) -> FixedWing:
        """Return the vehicle model in the air of a site."""
        return replace(self, site_air=air)

    def initial_state(
        self, position_ned: Vec3, attitude: Euler, velocity_body: Vec3, rates_body: Vec3
    ) -> FixedWingState:
        """Return the state at a pose, with the elevator for level flight at its velocity through still air."""
        zero = jnp.zeros_like(jnp.asarray(position_ned.x))
        air = air_data(velocity_body)
        here = self.in_density(self.site_air.density(position_ned))
        _, elevator, throttle = cruise(here, jnp.maximum(air.airspeed, 0.5 * self.cruise_airspeed))
        thrust, _ = propeller(here, air.airspeed, jnp.clip(throttle, 0.0, 1.0))
        return FixedWingState(
            position_ned,
            Quaternion.of(attitude),
            velocity_body,
            rates_body,
            Surfaces(jnp.clip(elevator, -0.44, 0.44) + zero, zero, zero),
            Stabiliser(zero, zero, zero),
            air.airspeed + zero,
            air.alpha + zero,
            air.beta + zero,
            thrust + zero,
        )

    def launched(self, state: FixedWingState, air_ned: Vec3) -> FixedWingState:
        """Return the state in level flight, the start speed taken as airspeed; 0 becomes the cruise airspeed."""
        speed = root(state.velocity_body.dot(state.velocity_body))
        speed = jnp.where(speed > 0.0, speed, self.cruise_airspeed)
        alpha = cruise(self.in_density(self.site_air.density(state.position_ned)), speed)[0]
        yaw = state.quaternion.euler().yaw
        zero = jnp.zeros_like(speed)
        sine, cosine = sincos(alpha)
        through = Vec3(speed * cosine, zero, speed * sine)
        level = self.initial_state(state.position_ned, Euler(zero, alpha, yaw), through, Vec3(zero, zero, zero))
        return replace(level, velocity_body=through + level.quaternion.rotation().to_body(air_ned))

    def idle_command(self, like: Array) -> AttitudeCommand:
        """Return the command for level flight at the cruise airspeed; ``like``: any array (n,), for the shape."""
        zero = jnp.zeros_like(like)
        alpha, _, throttle = cruise(self, jnp.asarray(self.cruise_airspeed))
        return AttitudeCommand(zero, zero + alpha, jnp.clip(zero + throttle, 0.0, 1.0))

    def shown(self, command: object) -> AttitudeCommand:
        """Return a command of any type as the record that a world's state keeps, NaN in fields that it lacks."""
        return shown(command)

    def wake_points(self) -> tuple[Point, ...]:
        """Return the midpoints of six equal parts of the wing span, in body axes [m]."""
        return tuple((0.0, self.span * (part / 12.0), 0.0) for part in (-5.0, -3.0, -1.0, 1.0, 3.0, 5.0))

    def load(self, state: FixedWingState) -> Load:
        """Return the propeller's thrust [N] as battery load; the weight is NaN because the wing carries it."""
        return Load(state.thrust, jnp.full_like(state.thrust, jnp.nan))

    def pose(self, state: FixedWingState) -> Pose:
        """Return position, attitude, velocity and body rates (n,) of a state."""
        return Pose(state.position_ned, state.quaternion.euler(), state.velocity_body, state.rates_body)

    def step(
        self,
        state: FixedWingState,
        command: Any,
        air_velocity: Callable[[AttitudeTrig], Vec3],
        noise: object,
        dt: float,
        around: Around | None = None,
    ) -> tuple[FixedWingState, Vec3]:
        """Return the state dt [s] later, in substeps, and the mean specific force (n,); see ``Vehicle.step``."""
        air, spins = _outside(state, air_velocity, around)
        here = self.in_density(None if around is None else around.air_density)
        count = max(1, math.ceil(dt / self.longest_substep - 1e-9))
        part = dt / count
        elevator = cruise(self, jnp.asarray(self.cruise_airspeed))[1]
        throttle = jnp.clip(command.throttle, 0.0, 1.0)
        zero = jnp.zeros_like(state.airspeed)

        def advance(_: Array, carried: Any) -> Any:
            """Return the loop's state after one substep of stabiliser, control surfaces and motion."""
            motion, surfaces, memory, force = carried
            through = air_data(motion.velocity - motion.quaternion.rotation().to_body(air))
            memory, wanted = wanted_surfaces(
                self, memory, command, motion.quaternion.euler(), motion.rates, through.airspeed, elevator, part
            )
            surfaces = moved(self, surfaces, wanted, part)
            motion, felt = substep(here, motion, surfaces, throttle, air, spins, part)
            return motion, surfaces, memory, force + felt * (1.0 / count)

        motion, surfaces, memory, force = jax.lax.fori_loop(
            0, count, advance, (_motion_of(state), state.surfaces, state.stabiliser, Vec3(zero, zero, zero))
        )
        found = air_data(motion.velocity - motion.quaternion.rotation().to_body(air))
        after = FixedWingState(
            state.position_ned + motion.displacement,
            motion.quaternion,
            motion.velocity,
            motion.rates,
            surfaces,
            memory,
            found.airspeed,
            found.alpha,
            found.beta,
            propeller(here, found.airspeed, throttle)[0],
        )
        return after, force

    def specific_force(
        self,
        state: FixedWingState,
        command: Any,
        air_velocity: Callable[[AttitudeTrig], Vec3],
        noise: object,
        dt: float,
        around: Around | None = None,
    ) -> Vec3:
        """Return the specific force (n,) [m/s^2] in body axes at an instant, with the present deflections."""
        air, spins = _outside(state, air_velocity, around)
        here = self.in_density(None if around is None else around.air_density)
        return slope_of(here, _motion_of(state), state.surfaces, command.throttle, air, spins)[1]

    def stopped(self, state: FixedWingState) -> FixedWingState:
        """Return the state with all motion set to zero, as for vehicles that have been stopped."""
        rest = Vec3.zeros(state.airspeed.shape, state.airspeed.dtype)
        zero = jnp.zeros_like(state.airspeed)
        return replace(state, velocity_body=rest, rates_body=rest, airspeed=zero, thrust=zero)

    def outline(self) -> Outline:
        """Return the outline, for pictures, of an aeroplane with this span."""
        return Outline(kind="plane", size=float(np.ravel(np.asarray(self.span))[0]))


def _motion_of(state: FixedWingState) -> Motion:
    """Return the parts of a state that the solver integrates, with the displacement in the step set to 0."""
    zero = jnp.zeros_like(state.airspeed)
    return Motion(Vec3(zero, zero, zero), state.quaternion, state.velocity_body, state.rates_body)


def _outside(
    state: FixedWingState, air_velocity: Callable[[AttitudeTrig], Vec3], around: Around | None
) -> tuple[Vec3, Vec3]:
    """Return the air's velocity (n,) [m/s] NED and rotation (n,) [rad/s], body axes, at the beginning of a step."""
    zero, one = jnp.zeros_like(state.airspeed), jnp.ones_like(state.airspeed)
    # At a level attitude, heading north, the air in body axes is that in NED.
    air = air_velocity(AttitudeTrig(zero, one, zero, one, zero, one))
    return air, Vec3(zero, zero, zero) if around is None else around.air_rates
