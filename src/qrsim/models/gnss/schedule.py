"""Times at which events of a run begin and end."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array

# Half of the shortest time step: an event at a tick has begun at that tick.
_HALF_STEP = 5e-5


def since(start: object, seconds: Array, fraction: Array) -> Array:
    """Return the time [s] from ``start`` [s] until a time of whole ``seconds`` plus ``fraction`` [s]."""
    begin = jnp.asarray(start, fraction.dtype)
    whole = jnp.floor(begin)
    return (seconds - whole.astype(np.int32)).astype(fraction.dtype) + (fraction - (begin - whole))


def is_on(start: Array, end: Array, seconds: Array, fraction: Array) -> Array:
    """Return whether a time, of whole ``seconds`` plus ``fraction``, is in the interval [start, end) [s]."""
    passed = since(start, seconds, fraction)
    return (passed > -_HALF_STEP) & (passed < jnp.asarray(end, fraction.dtype) - start - _HALF_STEP)
