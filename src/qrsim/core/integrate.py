"""Fixed-step integrators over PyTrees; the slope function also returns an output that is averaged alike."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import jax

S = TypeVar("S")
A = TypeVar("A")
Slope = Callable[[S], tuple[S, A]]


def _advance(state: S, slope: S, dt: float) -> S:
    """Return state + dt * slope, for trees of arrays; dt in [s]."""
    return jax.tree.map(lambda x, d: x + dt * d, state, slope)


def heun(slope: Slope[S, A], state: S, dt: float) -> tuple[S, A]:
    """Return the state dt [s] later by Heun's rule, and the mean output; ``slope``: state -> (derivative, output).

    Args:
        slope: state -> (time derivative of the state, output).
        state: tree of arrays.
        dt: step [s].

    Returns:
        The state after the step, and the mean of the two outputs.
    """
    first, output_first = slope(state)
    second, output_second = slope(_advance(state, first, dt))
    mean = jax.tree.map(lambda a, b: 0.5 * (a + b), first, second)
    output = jax.tree.map(lambda a, b: 0.5 * (a + b), output_first, output_second)
    return _advance(state, mean, dt), output


def rk4(slope: Slope[S, A], state: S, dt: float) -> tuple[S, A]:
    """Return the state dt [s] later by the classical Runge-Kutta rule, and the mean output; arguments as ``heun``."""
    first, output_1 = slope(state)
    second, output_2 = slope(_advance(state, first, 0.5 * dt))
    third, output_3 = slope(_advance(state, second, 0.5 * dt))
    fourth, output_4 = slope(_advance(state, third, dt))

    def mean(a: jax.Array, b: jax.Array, c: jax.Array, d: jax.Array) -> jax.Array:
        """Return the Runge-Kutta mean of four slopes, (a + 2 b + 2 c + d)/6."""
        return (a + 2.0 * (b + c) + d) / 6.0

    combined = jax.tree.map(mean, first, second, third, fourth)
    return _advance(state, combined, dt), jax.tree.map(mean, output_1, output_2, output_3, output_4)


INTEGRATORS: dict[str, Callable[..., tuple[object, object]]] = {"heun": heun, "rk4": rk4}
