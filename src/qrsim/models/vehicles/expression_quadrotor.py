"""A quadrotor with expressions as laws, as ``qrsim discover`` finds them; the rest is the identified quadrotor."""

from __future__ import annotations

import ast
import functools
import math
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.core.tree import record, replace, setting
from qrsim.core.vectors import Vec3
from qrsim.errors import UsageError, did_you_mean
from qrsim.models.vehicles.contracts import Handling, smaller
from qrsim.models.vehicles.quadrotor import IDLE_BATTERY, Command, Quadrotor, QuadrotorState

_SIGNS: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: lambda a, b: a + b,
    ast.Sub: lambda a, b: a - b,
    ast.Mult: lambda a, b: a * b,
    ast.Div: lambda a, b: a / b,
}
LONGEST_LAW = 2000


@record
class ExpressionQuadrotor(Quadrotor):
    """The quadrotor with laws given as text: numbers, names, + - * / ** (whole powers) and brackets."""

    thrust_law: str = setting(default="", doc="wanted thrust [N] by throttle; empty: the published polynomial")
    tilt_law: str = setting(
        default="", doc="d(rate)/dt of roll and pitch [rad/s^2] by command, angle, rate; empty: the published law"
    )
    yaw_law: str = setting(default="", doc="d(rate)/dt of yaw [rad/s^2] by command, rate; empty: the published law")
    adds_position: ClassVar[bool] = True

    def __post_init__(self) -> None:
        """Refuse a law that cannot be read."""
        for name, leaves in (
            ("thrust_law", ("throttle",)),
            ("tilt_law", ("command", "angle", "rate")),
            ("yaw_law", ("command", "rate")),
        ):
            if law := getattr(self, name):
                checked(name, law, leaves)

    def wanted_thrust(self, throttle: Array) -> Array:
        """Return the steady thrust (n,) [N] at a throttle (n,) [0, 1], by the user's law if there is one."""
        if not self.thrust_law:
            return Quadrotor.wanted_thrust(self, throttle)
        return evaluated(self.thrust_law, {"throttle": throttle})

    def handling(self) -> Handling | None:
        """Return the handling from the user's laws linearised at rest; None if one does not follow its command."""
        found = Quadrotor.handling(self)
        assert found is not None
        if self.thrust_law:
            curve = _quadratic(self.thrust_law)
            if curve is None:
                return None
            most = value_at(self.thrust_law, {"throttle": 1.0})
            found = replace(found, throttle_curve=curve, thrust_max=smaller(most, self.cvb0 + self.cvb1 * IDLE_BATTERY))
        for law, leaves, field in (
            (self.tilt_law, ("command", "angle", "rate"), "tilt_gain"),
            (self.yaw_law, ("command", "rate"), "yaw_rate_gain"),
        ):
            if law:
                gain = _settled(law, leaves)
                if gain is None:
                    return None
                found = replace(found, **{field: gain})
        return found

    def angular_acceleration(self, state: QuadrotorState, command: Command) -> Vec3:
        """Return the angular acceleration (n,) [rad/s^2] of the stabilised quadrotor, by the user's laws."""
        found = Quadrotor.angular_acceleration(self, state, command)
        rates, attitude = state.rates_body, state.attitude
        roll, pitch, yaw = found.x, found.y, found.z
        if self.tilt_law:
            leaves = {"command": command.roll, "angle": attitude.roll, "rate": rates.x}
            roll = self._rate_limited(evaluated(self.tilt_law, leaves), rates.x)
            leaves = {"command": command.pitch, "angle": attitude.pitch, "rate": rates.y}
            pitch = self._rate_limited(evaluated(self.tilt_law, leaves), rates.y)
        if self.yaw_law:
            yaw = evaluated(self.yaw_law, {"command": command.yaw_rate, "rate": rates.z})
        return Vec3(roll, pitch, yaw)


@functools.cache
def checked(name: str, law: str, leaves: tuple[str, ...]) -> ast.expr:
    """Return a user's law (a formula as text) parsed to a syntax tree; ``leaves`` are the names it may use.

    Raises:
        UsageError: it is no expression of the allowed kind; says what is wrong.
    """
    if len(law) > LONGEST_LAW:
        raise UsageError(f"{name}: {len(law)} characters; allowed: at most {LONGEST_LAW}")
    try:
        tree = ast.parse(law, mode="eval").body
    except SyntaxError as error:
        raise UsageError(f"{name}: '{law}' is no expression: {error.msg}") from None
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and node.id not in leaves:
            raise UsageError(f"{name}: '{node.id}' is none of its inputs{did_you_mean(node.id, leaves)}")
        number = isinstance(node, ast.Constant) and type(node.value) in (int, float)
        power = isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow) and _whole(node.right)
        sign = isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd)
        operation = isinstance(node, ast.BinOp) and type(node.op) in _SIGNS
        part = isinstance(node, ast.Name | ast.Load | ast.operator | ast.unaryop)
        if not (number or power or sign or operation or part):
            allowed = "numbers, names, + - * / ** and brackets"
            raise UsageError(f"{name}: '{ast.unparse(node)}' is not allowed; allowed: {allowed}")
    return tree


def _quadratic(law: str) -> tuple[Array, Array, Array] | None:
    """Return c0, c1, c2 fitting c0 + c1 u + c2 u^2 to a law of throttle u; None if undefined or not increasing."""
    throttle = np.linspace(0.0, 1.0, 41)
    thrust = np.array([value_at(law, {"throttle": float(u)}) for u in throttle])
    if not np.isfinite(thrust).all():
        return None
    c2, c1, c0 = np.polyfit(throttle, thrust, 2)
    rises = min(c1, c1 + 2.0 * c2) > 0.0
    return (c0, c1, c2) if rises else None


def _settled(law: str, leaves: tuple[str, ...]) -> float | None:
    """Return the steady gain from command to angle (or rate) of a user's law at rest, None unless positive."""
    slope, step = {}, 1e-4
    for leaf in ("command", leaves[1]):
        ends = [value_at(law, dict.fromkeys(leaves, 0.0) | {leaf: x}) for x in (-step, step)]
        slope[leaf] = (ends[1] - ends[0]) / (2.0 * step)
    gain = -slope["command"] / slope[leaves[1]] if slope[leaves[1]] else math.nan
    return gain if math.isfinite(gain) and gain > 0.0 else None


def _whole(node: ast.expr) -> bool:
    """Return whether a syntax node is an integer constant from 0 to 9, as exponents must be."""
    return isinstance(node, ast.Constant) and isinstance(node.value, int) and 0 <= node.value <= 9


def evaluated(law: str, leaves: Mapping[str, Array]) -> Array:
    """Return the value (n,) of a user's law for arrays (n,) given by its names."""
    like = next(iter(leaves.values()))
    return jnp.broadcast_to(jnp.asarray(_value(checked("law", law, tuple(leaves)), leaves), like.dtype), like.shape)


def value_at(law: str, leaves: dict[str, Any]) -> float:
    """Return the value of a user's law for numbers given by its names; NaN if undefined, such as 1/0."""
    try:
        return float(_value(checked("law", law, tuple(leaves)), leaves))
    except (OverflowError, ZeroDivisionError):
        return math.nan


def _value(node: ast.expr, leaves: Mapping[str, Array]) -> Any:
    """Return the value of a syntax node of a user's law, with ``leaves`` as the values of its names."""
    if isinstance(node, ast.Constant):
        return float(node.value)  # type: ignore[arg-type]
    if isinstance(node, ast.Name):
        return leaves[node.id]
    if isinstance(node, ast.UnaryOp):
        value = _value(node.operand, leaves)
        return -value if isinstance(node.op, ast.USub) else value
    assert isinstance(node, ast.BinOp)
    if isinstance(node.op, ast.Pow):
        base = _value(node.left, leaves)
        return functools.reduce(lambda a, b: a * b, [base] * node.right.value, 1.0)  # type: ignore[attr-defined]
    return _SIGNS[type(node.op)](_value(node.left, leaves), _value(node.right, leaves))
