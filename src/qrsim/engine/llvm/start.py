"""A start, traced: a function from parameters and keys to a first state.

Its state is an input like the others, so that a start is a program like a tick, which fills it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import jax
import numpy as np

from qrsim.core.operators import make_jaxpr
from qrsim.engine.layout import Packer, struct
from qrsim.engine.llvm.program import Input
from qrsim.engine.llvm.refusal import refusing


def trace_of(function: Callable[..., object], inputs: Sequence[Input]) -> tuple[object, object]:
    """Trace ``function(*trees)``; return its closed jaxpr and the ShapeDtypeStructs of its result."""
    found: tuple[object, object] = make_jaxpr(function, return_shape=True)(*(each.layout.template() for each in inputs))
    return found


def state_of(shape: object) -> Packer:
    """Return the buffer layout of a state, from the result shapes that ``trace_of`` returned.

    Raises:
        UnsupportedError: it has numbers that no program has.
    """
    with refusing():
        # Shapes only: JAX says more of a leaf, such as its weak type, that is none of the layout.
        return Packer(jax.tree.map(lambda leaf: struct(leaf.shape, np.dtype(leaf.dtype)), shape))
