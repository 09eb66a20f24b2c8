"""The steady airspeed that a vehicle holds: the balance of weight, drag and thrust while it leans into the wind."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax import Array

from qrsim.core.arrays import Floats
from qrsim.core.noise import Drawn
from qrsim.core.tree import map_tree
from qrsim.core.vectors import Euler, Vec3
from qrsim.models.vehicles.contracts import Around, Vehicle, handling_of

# Nothing of this kind is that fast [m/s].
FASTEST = 100.0
HALVINGS, SECANTS = 25, 4


@dataclass(frozen=True)
class Envelope:
    """Largest steady airspeed of vehicles (n,), without gusts.

    Attributes:
        airspeed: largest airspeed [m/s]; infinite without drag.
        tilt: tilt at this airspeed [rad].
        thrust: thrust at this airspeed [N].
        by_thrust: bool: the thrust limits the airspeed, else the tilt does.
    """

    airspeed: Floats
    tilt: Floats
    thrust: Floats
    by_thrust: Floats


def envelope(vehicle: Vehicle, tilt_limit: npt.ArrayLike, thrust_limit: npt.ArrayLike | None = None) -> Envelope | None:
    """Return the largest steady airspeed [m/s] of vehicles (n,) at tilts up to ``tilt_limit`` [rad], or None.

    Args:
        vehicle: with numbers, or arrays (n,).
        tilt_limit: of the vehicle itself, not of its commands.
        thrust_limit: (n,) [N]; None: the vehicle's own, at its nominal voltage.

    Returns:
        None where the vehicle takes no tilt and throttle.
    """
    known = handling_of(vehicle)
    if known is None:
        return None
    most = known.thrust_max if thrust_limit is None else thrust_limit
    tilt, most = (np.array(each, np.float64) for each in np.broadcast_arrays(np.atleast_1d(tilt_limit), most))
    balance = _Balance(vehicle, len(tilt))
    airspeed, thrust = balance(tilt)
    by_thrust = thrust > most
    if by_thrust.any():
        low, high = np.zeros_like(tilt), tilt
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            too_much = balance(middle)[1] > most
            low, high = np.where(too_much, low, middle), np.where(too_much, middle, high)
        tilt = np.where(by_thrust, low, tilt)
        airspeed, thrust = balance(tilt)
    # A vehicle whose weight exceeds the limit cannot hover, and so has an airspeed of zero.
    return Envelope(airspeed, tilt, np.minimum(thrust, most), by_thrust)


class _Balance:
    """Finds the airspeed and the thrust at which vehicles (n,) that lean stay where they are."""

    def __init__(self, vehicle: Vehicle, size: int):
        self.vehicle, self.size = vehicle, size
        self._force: Callable[..., tuple[Array, Array]] | None = None

    def __call__(self, tilt: Floats) -> tuple[Floats, Floats]:
        """Return airspeed [m/s] and thrust [N] for a tilt (n,) [rad]."""
        own = self.vehicle.leaning(tilt)
        if own is not None:
            airspeed, thrust = (np.broadcast_to(np.asarray(each, np.float64), tilt.shape) for each in own)
            return airspeed, thrust
        low, high = np.zeros_like(tilt), np.full_like(tilt, FASTEST)
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            # Too fast: more drag than the lean makes up for.
            blown = self._north(middle, tilt, self._lifting(middle, tilt)) < 0.0
            low, high = np.where(blown, low, middle), np.where(blown, middle, high)
        airspeed = np.where(high < FASTEST, low, np.inf)
        return airspeed, self._lifting(low, tilt)

    def _lifting(self, airspeed: Floats, tilt: Floats) -> Floats:
        """Return the thrust (n,) [N] with which the vertical forces balance at an airspeed [m/s] and a tilt [rad]."""
        known = handling_of(self.vehicle)
        assert known is not None
        weight = np.broadcast_to(np.asarray(known.mass * known.gravity, np.float64), tilt.shape)
        wanted = -np.asarray(known.gravity, np.float64)
        # All but linear in the thrust, so that a few secants find it.
        before, now = weight, 1.5 * weight
        at_before = self._at(airspeed, tilt, before)[1]
        for _ in range(SECANTS):
            at_now = self._at(airspeed, tilt, now)[1]
            slope = (at_now - at_before) / np.where(now == before, 1.0, now - before)
            step = np.where(slope == 0.0, 0.0, (wanted - at_now) / np.where(slope == 0.0, 1.0, slope))
            before, at_before, now = now, at_now, np.maximum(now + step, 0.0)
        return now

    def _north(self, airspeed: Floats, tilt: Floats, thrust: Floats) -> Floats:
        """Return the specific force (n,) [m/s^2] to the north at rest in a north wind; 0 in steady flight."""
        return self._at(airspeed, tilt, thrust)[0]

    def _at(self, airspeed: Floats, tilt: Floats, thrust: Floats) -> tuple[Floats, Floats]:
        """Return the specific force (n,) [m/s^2], north and down, at rest in a north wind of ``airspeed`` [m/s]."""
        if self._force is None:
            self._force = jax.jit(lambda *given: _specific_force(self.vehicle, *given))
        north, down = self._force(airspeed, tilt, thrust)
        return np.asarray(north, np.float64), np.asarray(down, np.float64)


def _specific_force(vehicle: Vehicle, airspeed: Array, tilt: Array, thrust: Array) -> tuple[Array, Array]:
    """Return the specific force (n,) [m/s^2], north and down, of a tilted vehicle at rest in a north wind."""
    zero = jnp.zeros_like(airspeed)
    none = Vec3(zero, zero, zero)
    vehicle = map_tree(jnp.asarray, vehicle)
    at = vehicle.initial_state(none, Euler(zero, -tilt, zero), none, none)
    state = vehicle.with_thrust(at, thrust)
    noise = vehicle.draw_noise(Drawn((zero,) * vehicle.normals), 1.0)
    around = Around(
        # So far below that it is not felt.
        ground=lambda place: (zero + 1000.0, Vec3(zero, zero, zero - 1.0)),
        air_rates=none,
    )
    more = (around,) if vehicle.reads else ()
    wind = Vec3(-airspeed, zero, zero)
    # A step so short that the thrust stays what it is.
    force = vehicle.specific_force(
        state, vehicle.idle_command(zero), lambda trig: trig.rotation().to_body(wind), noise, 1e-6, *more
    )
    sine, cosine = jnp.sin(-tilt), jnp.cos(tilt)
    return cosine * force.x + sine * force.z, -sine * force.x + cosine * force.z
