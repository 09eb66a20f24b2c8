"""Steady flight of a fixed wing: exact trims and modes, and the formulas that its stabiliser starts from (W9, W10)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.core.arrays import Floats
from qrsim.core.fastmath import sincos
from qrsim.core.host import on_host
from qrsim.core.quaternions import Quaternion
from qrsim.core.tree import cast
from qrsim.core.vectors import Euler, Vec3, root
from qrsim.errors import UsageError
from qrsim.models.vehicles.fixed_wing.aerodynamics import lift_and_drag
from qrsim.models.vehicles.fixed_wing.parameters import Aeroplane
from qrsim.models.vehicles.fixed_wing.rigid_body import slope_of
from qrsim.models.vehicles.fixed_wing.state import Motion, Surfaces

STEPS, FOUND = 60, 1e-10


def cruise(model: Aeroplane, airspeed: Array) -> tuple[Array, Array, Array]:
    """Return angle of attack [rad], elevator [rad] and throttle (n,) of straight level flight, to about 1 % (eq. W9).

    The thrust carries nothing of the weight in it, and the flow is attached.
    """
    of = model.longitudinal
    pressed = 0.5 * model.air_density * (airspeed * airspeed) * model.area
    lift = model.mass * model.gravity / pressed - of.lift_0
    # Two lines: the lift carries the weight, the moment is none.
    both = of.lift_alpha * of.moment_elevator - of.lift_elevator * of.moment_alpha
    alpha = (lift * of.moment_elevator + of.lift_elevator * of.moment_0) / both
    elevator = -(of.lift_alpha * of.moment_0 + lift * of.moment_alpha) / both
    drag = lift_and_drag(of, model.span * model.span / model.area, alpha)[1] + of.drag_elevator * elevator
    return alpha, elevator, throttle_for(model, airspeed, pressed * drag / sincos(alpha)[1])


def throttle_for(model: Aeroplane, airspeed: Array, thrust: Array) -> Array:
    """Return the throttle (n,) for a thrust (n,) [N] at an airspeed [m/s]: equation W5 inverted."""
    own, rho = model.propeller, model.air_density
    d, constant = own.diameter, 60.0 / (2.0 * math.pi * own.speed_constant)
    v = airspeed / d
    linear, rest = own.thrust_1 * v, own.thrust_2 * (v * v) - thrust / (rho * d**4)
    n = (-linear + root(linear * linear - 4.0 * own.thrust_0 * rest)) / (2.0 * own.thrust_0)
    torque = rho * d**5 * (own.torque_0 * (n * n) + own.torque_1 * (n * v) + own.torque_2 * (v * v))
    current = torque / constant + own.idle_current
    return (own.resistance * current + constant * (2.0 * math.pi) * n) / own.voltage_max


@dataclass(frozen=True)
class Trim:
    """A steady flight of one aeroplane.

    Attributes:
        airspeed: [m/s]; climb_angle: [rad]; radius: of the turn [m], right positive, infinite: straight.
        alpha, theta, phi: angle of attack, pitch and roll [rad].
        elevator, aileron, rudder: [rad].
        throttle: 0 to 1; beyond, the propeller cannot.
    """

    airspeed: float
    climb_angle: float
    radius: float
    alpha: float
    theta: float
    phi: float
    elevator: float
    aileron: float
    rudder: float
    throttle: float


def trim(model: Aeroplane, airspeed: float, climb_angle: float = 0.0, radius: float = math.inf) -> Trim:
    """Return the coordinated trim at an airspeed [m/s], climb angle [rad] and turn radius [m], right positive.

    Raises:
        UsageError: there is none.
    """
    if not airspeed > 0.0 or radius == 0.0:
        raise UsageError(f"trim: an airspeed of {airspeed:g} m/s on a radius of {radius:g} m; expected above 0, not 0")
    turn = airspeed * math.cos(climb_angle) / radius
    with jax.enable_x64(True):
        model = jax.tree.map(jnp.asarray, cast(model, np.float64))
        alpha, elevator, throttle = cruise(model, jnp.asarray(airspeed))
        bank = math.atan(airspeed * turn / float(model.gravity))
        guess = [float(alpha), 0.0, bank, float(elevator), 0.0, 0.0, float(throttle), float(alpha) + climb_angle]

        flight = jnp.array([airspeed, turn, airspeed * math.sin(climb_angle)])
        y = np.array(guess)
        for _ in range(STEPS):
            off, slopes = (np.asarray(part) for part in _balance(model, y, flight))
            if np.max(np.abs(off)) < FOUND:
                found, _, phi, de, da, dr, power, theta = (float(part) for part in y)
                if not 0.0 <= power <= 1.0:
                    break
                return Trim(airspeed, climb_angle, radius, found, theta, phi, de, da, dr, power)
            step = np.linalg.solve(slopes, off)
            # A step of at most a tenth of a radian stays where the flow is attached.
            y = y - step * min(1.0, 0.1 / max(float(np.max(np.abs(step))), 1e-12))
            if not np.isfinite(y).all():
                break
    raise UsageError(
        f"trim: no steady flight at {airspeed:g} m/s, a climb angle of {climb_angle:g} rad and a radius of "
        f"{radius:g} m is there, with a throttle from 0 to 1"
    )


def _missing(y: Array, model: Aeroplane, flight: Array) -> Array:
    """Return the residual (8,) of steady flight for trim unknowns y: accelerations, climb error and sideslip."""
    airspeed, turn, climb = flight
    motion, surfaces = _steady(y, airspeed, turn)
    slope, _ = slope_of(model, motion, surfaces, y[6], _still(), _still())
    sinking = motion.quaternion.rotation().to_ned(motion.velocity).z
    return jnp.stack([*slope.velocity.axes, *slope.rates.axes, sinking + climb, y[1]])


@jax.jit
def _balance(model: Aeroplane, y: Array, flight: Array) -> tuple[Array, Array]:
    """Return the residual (8,) of steady flight for trim unknowns y, and its Jacobian (8, 8)."""
    return _missing(y, model, flight), jax.jacfwd(_missing)(y, model, flight)


def modes(model: Aeroplane, at: Trim) -> Floats:
    """Return the eigenvalues [1/s], complex, of small motions about a straight trim, with surfaces held.

    Those of place and heading, 0, are left out.
    """
    with jax.enable_x64(True):
        model = jax.tree.map(jnp.asarray, cast(model, np.float64))
        y = jnp.array([at.alpha, 0.0, at.phi, at.elevator, at.aileron, at.rudder, at.throttle, at.theta])
        motion, surfaces = _steady(y, at.airspeed, 0.0)

        def slope(x: Array) -> Array:
            """Return the time derivatives of roll, pitch, velocity and rates for a state x (8,) of these."""
            moved = Motion(_still(), Quaternion.of(Euler(x[0], x[1], jnp.zeros(()))), Vec3(*x[2:5]), Vec3(*x[5:8]))
            found, _ = slope_of(model, moved, surfaces, y[6], _still(), _still())
            p, q, r = x[5:8]
            lateral = q * jnp.sin(x[0]) + r * jnp.cos(x[0])
            angles = jnp.stack([p + lateral * jnp.tan(x[1]), q * jnp.cos(x[0]) - r * jnp.sin(x[0])])
            return jnp.concatenate([angles, jnp.stack([*found.velocity.axes, *found.rates.axes])])

        start = jnp.stack([y[2], y[7], *motion.velocity.axes, *motion.rates.axes])
        matrix = np.asarray(jax.jacfwd(slope)(start))
    found: Floats = np.linalg.eigvals(matrix)
    return found


_lift_and_drag = on_host(lift_and_drag)


def stall_speed(model: Aeroplane) -> float:
    """Return the lowest airspeed [m/s] at which the wing carries the weight, of the first aeroplane if several."""
    angles = np.linspace(0.0, 0.8, 401)
    first = jax.tree.map(lambda leaf: np.float64(np.ravel(leaf)[0]), cast(model, np.float64))
    with jax.enable_x64(True):
        lift, _ = _lift_and_drag(first.longitudinal, first.span**2 / first.area, angles)
    most = float(np.max(np.asarray(lift)))
    weight = float(first.mass * first.gravity)
    return math.sqrt(2.0 * weight / (float(first.air_density) * float(first.area) * most))


def _still() -> Vec3:
    """Return a zero vector of scalars ()."""
    zero = jnp.zeros(())
    return Vec3(zero, zero, zero)


def _steady(y: Array, airspeed: Array | float, turn: Array | float) -> tuple[Motion, Surfaces]:
    """Return motion and surfaces for trim unknowns y: alpha, beta, roll, elevator, aileron, rudder, throttle, pitch."""
    sa, ca = jnp.sin(y[0]), jnp.cos(y[0])
    sb, cb = jnp.sin(y[1]), jnp.cos(y[1])
    st, ct, sp, cp = jnp.sin(y[7]), jnp.cos(y[7]), jnp.sin(y[2]), jnp.cos(y[2])
    velocity = Vec3(airspeed * ca * cb, airspeed * sb, airspeed * sa * cb)
    rates = Vec3(-turn * st, turn * sp * ct, turn * cp * ct)
    attitude = Quaternion.of(Euler(y[2], y[7], jnp.zeros(())))
    return Motion(_still(), attitude, velocity, rates), Surfaces(y[3], y[4], y[5])
