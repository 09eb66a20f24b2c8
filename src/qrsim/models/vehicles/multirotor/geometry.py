"""Positions of rotors and contact points of a vehicle; they are constants of the compiled program."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from jax import Array

from qrsim.core.vectors import Vec3

Triple = tuple[float, float, float]
# A number of Python, known while the program is compiled, or an array.
Number = Any


@dataclass(frozen=True)
class Rotor:
    """One rotor.

    Attributes:
        position: of its hub in body axes [m], from the centre of mass: forward, right, down.
        direction: +1 turns clockwise seen from above, so that its torque turns the vehicle the other way; or -1.
        axis: unit vector of its thrust in body axes.
    """

    position: Triple
    """hub in body axes [m], from the centre of mass: forward, right, down"""
    direction: int
    """+1 turns clockwise seen from above, -1 the other way"""
    axis: Triple = (0.0, 0.0, -1.0)
    """unit vector of the thrust in body axes"""

    # The schema of scenarios describes the fields by the texts below them.
    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid", "use_attribute_docstrings": True}


def ring(count: int, arm: float, first_rad: float, direction: int = 1, down: float = 0.0) -> tuple[Rotor, ...]:
    """Return ``count`` rotors on a circle of radius ``arm`` [m], clockwise from above, spinning alternately.

    Args:
        count: how many.
        arm: radius of the circle [m].
        first_rad: angle of the first one from the nose [rad].
        direction: of the first one.
        down: of all [m]; above the centre of mass it is negative.
    """
    angles = [first_rad + 2.0 * math.pi * i / count for i in range(count)]
    return tuple(
        Rotor((arm * math.cos(angle), arm * math.sin(angle), down), direction if i % 2 == 0 else -direction)
        for i, angle in enumerate(angles)
    )


def combined(*terms: tuple[float, Array]) -> Number:
    """Return the sum of factor times array; terms with factor 0.0 cost nothing, and none left gives 0.0.

    Products are taken by the size of the factor, so that mirrored points share them; the rounding is the same.
    """
    used = [(factor, array) for factor, array in terms if factor != 0.0]
    if len(used) > 1 and used[0][0] < 0.0 < used[1][0]:
        used[:2] = used[1], used[0]
    total: Number = 0.0
    for factor, array in used:
        term = array if factor == 1.0 else -array if factor == -1.0 else None
        if isinstance(total, float):
            total = factor * array if term is None else term
        elif term is None:
            total = total - (-factor) * array if factor < 0.0 else total + factor * array
        else:
            total = total + term
    return total


def cross_known(a: Vec3, r: Triple) -> tuple[Number, Number, Number]:
    """Return the cross product a x r of a vector of arrays and a constant vector r."""
    return (
        combined((r[2], a.y), (-r[1], a.z)),
        combined((r[0], a.z), (-r[2], a.x)),
        combined((r[1], a.x), (-r[0], a.y)),
    )


def known_cross(r: Triple, a: Vec3) -> tuple[Number, Number, Number]:
    """Return the cross product r x a of a constant vector r and a vector of arrays."""
    x, y, z = cross_known(a, r)
    return -x, -y, -z


def dot_known(a: Vec3, r: Triple) -> Number:
    """Return the scalar product a . r of a vector of arrays and a constant vector r."""
    return combined((r[0], a.x), (r[1], a.y), (r[2], a.z))


def reach(points: Sequence[Triple]) -> float:
    """Return the distance [m] of the farthest of some body points from the centre of mass, the origin."""
    return max(math.hypot(*point) for point in points)


def square_feet(side: float, down: float) -> tuple[Triple, ...]:
    """Return four feet at the corners of a square, in body axes [m]: (+/- side, +/- side, down)."""
    return ((side, side, down), (-side, side, down), (-side, -side, down), (side, -side, down))


def effects(rotor: Rotor, torque_ratio: Number) -> tuple[Number, Number, Number, Number]:
    """Return collective thrust and roll, pitch, yaw torque [N m], each per newton of one rotor's thrust."""
    (x, y, z), (a, b, c) = rotor.position, rotor.axis
    turning = [rotor.direction * component for component in rotor.axis]
    lever = (y * c - z * b, z * a - x * c, x * b - y * a)
    roll, pitch, yaw = (
        own if factor == 0.0 else own + factor * torque_ratio for own, factor in zip(lever, turning, strict=True)
    )
    return -c, roll, pitch, yaw


def allocation(
    rotors: Sequence[Rotor], torque_ratio: Array, without: Sequence[int] = (), yaw: bool = True
) -> list[list[Number]]:
    """Return the control allocation, a pseudo-inverse: N rows of 4, rotor thrust [N] per collective N and torque N m.

    Args:
        rotors: all of them.
        torque_ratio: reaction torque for each newton of thrust [m].
        without: rotors that are given nothing.
        yaw: whether the torque about body down is looked after; else its column is zero.
    """
    count = 4 if yaw else 3
    # Rows of one size, so that single precision is enough.
    sizes: list[Number] = [1.0, reach([rotor.position for rotor in rotors]) or 1.0]
    sizes += [sizes[1], torque_ratio]
    vertical = all(rotor.axis[:2] == (0.0, 0.0) and rotor.axis[2] == -1.0 for rotor in rotors)
    columns = []
    for i, rotor in enumerate(rotors):
        if i in without:
            columns.append([0.0] * count)
            continue
        column = list(effects(rotor, torque_ratio))
        # The reaction torques alone are a known multiple of the ratio.
        column[3] = -float(rotor.direction) if vertical else column[3] / torque_ratio
        columns.append([column[0], column[1] / sizes[1], column[2] / sizes[2], column[3]][:count])
    gram = [[_sum(c[i] * c[j] for c in columns) for j in range(count)] for i in range(count)]
    inverse = _inverse(gram)
    rows = []
    for column in columns:
        row = [_sum(column[j] * inverse[j][i] for j in range(count)) / sizes[i] for i in range(count)]
        rows.append(row if yaw else [*row, 0.0])
    return rows


def rank_of(rotors: Sequence[Rotor], torque_ratio: float) -> float:
    """Return how well rotors control thrust and torques: smallest over largest singular value; 0 if they cannot."""
    sizes = reach([rotor.position for rotor in rotors]) or 1.0
    table = np.array([effects(rotor, torque_ratio) for rotor in rotors], float).T
    with np.errstate(all="ignore"):
        scaled = table / np.array([[1.0], [sizes], [sizes], [torque_ratio]])
    # Numbers of 1e200 overflow.
    if not np.isfinite(scaled).all():
        return 0.0
    values = np.linalg.svd(scaled, compute_uv=False)
    return float(values[3] / values[0]) if len(values) > 3 else 0.0


def holds_yaw(rotors: Sequence[Rotor], torque_ratio: float, without: Sequence[int]) -> bool:
    """Return whether the vehicle can hover without yawing if rotors ``without`` fail, all others giving thrust."""
    left = [rotor for i, rotor in enumerate(rotors) if i not in without]
    if len(left) < 4 or rank_of(left, torque_ratio) < 0.02:
        return False
    thrusts = [float(row[0]) for row in allocation(left, torque_ratio)]  # type: ignore[arg-type]
    return min(thrusts) > 0.05 * max(thrusts)


def _sum(terms: Iterable[Number]) -> Number:
    """Return the sum of terms, leaving out those that are the plain number 0.0."""
    total: Number = 0.0
    for term in terms:
        if not (isinstance(term, float) and term == 0.0):
            total = term if isinstance(total, float) and total == 0.0 else total + term
    return total


def _inverse(matrix: list[list[Number]]) -> list[list[Number]]:
    """Return the inverse of a symmetric positive definite matrix of numbers or arrays (Gauss-Jordan)."""
    size = len(matrix)
    rows = [[*row, *(1.0 if i == j else 0.0 for j in range(size))] for i, row in enumerate(matrix)]
    for i in range(size):
        pivot = 1.0 / rows[i][i]
        rows[i] = [_times(value, pivot) for value in rows[i]]
        for j in range(size):
            if j != i:
                factor = rows[j][i]
                rows[j] = [_minus(value, _times(factor, own)) for value, own in zip(rows[j], rows[i], strict=True)]
    return [row[size:] for row in rows]


def _times(a: Number, b: Number) -> Number:
    """Return the product a b; the plain number 0.0 if a factor is the plain number 0.0."""
    return 0.0 if any(isinstance(each, float) and each == 0.0 for each in (a, b)) else a * b


def _minus(a: Number, b: Number) -> Number:
    """Return the difference a - b, leaving out a term that is the plain number 0.0."""
    return a if isinstance(b, float) and b == 0.0 else -b if isinstance(a, float) and a == 0.0 else a - b
