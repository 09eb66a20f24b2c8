"""From a collective thrust and three torques to the thrust of each rotor, within what rotors can give."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import combinations

import jax.numpy as jnp
from jax import Array

from qrsim.core.vectors import Vec3
from qrsim.models.vehicles.multirotor.geometry import Number, Rotor, allocation, effects, holds_yaw

# Torque of a rotor's share below which it has no say in how much of the yaw fits [N].
LEAST_YAW_N = 1e-12
# A typical torque over thrust over radius, by which is judged whether rotors can hold yaw.
TYPICAL_TORQUE_RATIO = 0.02


@dataclass(frozen=True)
class Mixer:
    """Allocation of thrust and torque to the rotors in one step.

    Attributes:
        rows: for each rotor its thrust [N] per N of thrust and N m of torque, four numbers or arrays (n,).
        effects: for each rotor the thrust and torques per N of its own thrust.
        most: largest thrust of a rotor [N], a number or (n,).
        holds_yaw: 1, or 0 where the rotors that are left cannot hold the heading; a number or (n,).
    """

    rows: Sequence[Sequence[Number]]
    effects: Sequence[Sequence[Number]]
    most: Array
    holds_yaw: Number

    def share(self, thrust: Array, torque: Vec3, yaw_share: Array) -> list[Array]:
        """Return each rotor's thrust (n,) [N] for a collective thrust [N] and a torque [N m], within limits (eq. V30).

        Roll and pitch come first, scaled together if they do not fit; the collective is shifted to keep them; yaw gets
        what is left, but at least ``yaw_share`` of itself.
        """
        most = self.most
        tilting = [_sum((row[1], torque.x), (row[2], torque.y)) for row in self.rows]
        span = _largest(tilting) - _least(tilting)
        scale = jnp.minimum(1.0, most / jnp.maximum(span, LEAST_YAW_N))
        found = [_sum((row[0], thrust)) + scale * tilt for row, tilt in zip(self.rows, tilting, strict=True)]
        lack = jnp.maximum(-_least(found), 0.0)
        shift = jnp.where(lack > 0.0, lack, -jnp.maximum(_largest(found) - most, 0.0))
        found = [each + shift for each in found]
        turning = [_sum((row[3], torque.z)) for row in self.rows]
        fits = jnp.clip(_least([_room(f, y, most) for f, y in zip(found, turning, strict=True)]), 0.0, 1.0)
        kept = jnp.maximum(fits, yaw_share)
        found = [f + kept * y for f, y in zip(found, turning, strict=True)]
        # Lower all rather than cut the largest, where the share of the yaw asks for more than fits.
        over = jnp.where(fits < yaw_share, jnp.maximum(_largest(found) - most, 0.0), 0.0)
        return [jnp.clip(f - over, 0.0, most) for f in found]

    def torque(self, thrusts: Sequence[Array]) -> Vec3:
        """Return the torque (n,) [N m] in body axes that rotor thrusts (n,) [N] produce."""
        axes = [
            reduce(
                jnp.add, [_sum((effect[axis], thrust)) for effect, thrust in zip(self.effects, thrusts, strict=True)]
            )
            for axis in (1, 2, 3)
        ]
        return Vec3(*axes)


def mixer_of(rotors: Sequence[Rotor], torque_ratio: Array, most: Array, lost: Sequence[tuple[int, Array]]) -> Mixer:
    """Return the mixer (control allocation) for a step, without rotors that are known to have failed.

    Args:
        rotors: geometry.
        torque_ratio: reaction torque for each newton of thrust [m].
        most: largest thrust of a rotor [N].
        lost: rotors that may be known to have failed, and for which vehicles (n,) bool that is so now.
    """
    columns = [effects(rotor, torque_ratio) for rotor in rotors]
    rows = allocation(rotors, torque_ratio)
    yaw: Number = 1.0
    for count in range(1, len(lost) + 1):
        for some in combinations(lost, count):
            without = [number for number, _ in some]
            now = reduce(jnp.logical_and, [known for _, known in some])
            keeps = holds_yaw(rotors, TYPICAL_TORQUE_RATIO, without)
            if len(rotors) - len(without) < 3:
                continue
            # A larger set of failed rotors comes later, and so has the last word.
            others = allocation(rotors, torque_ratio, without, keeps)
            rows = [
                [jnp.where(now, new, old) for new, old in zip(*both, strict=True)]
                for both in zip(others, rows, strict=True)
            ]
            yaw = jnp.where(now, 1.0 if keeps else 0.0, yaw)
    return Mixer(rows, columns, most, yaw)


def _room(thrust: Array, turning: Array, most: Array) -> Array:
    """Return the largest factor (n,) on a rotor's yaw thrust that keeps the rotor within 0 to ``most`` [N]."""
    gap = jnp.where(turning > 0.0, most - thrust, thrust)
    size = jnp.abs(turning)
    return jnp.where(size > LEAST_YAW_N, gap / jnp.maximum(size, LEAST_YAW_N), jnp.inf)


def _sum(*terms: tuple[Number, Array]) -> Array:
    """Return the sum of products factor times array; the plain factor 0.0 costs no operation."""
    found = [array * factor for factor, array in terms if not (isinstance(factor, float) and factor == 0.0)]
    return reduce(jnp.add, found) if found else jnp.zeros_like(terms[0][1])


def _least(values: Sequence[Array]) -> Array:
    """Return the elementwise minimum of several arrays."""
    return reduce(jnp.minimum, values)


def _largest(values: Sequence[Array]) -> Array:
    """Return the elementwise maximum of several arrays."""
    return reduce(jnp.maximum, values)
