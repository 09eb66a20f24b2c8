"""A JAX function evaluated by NumPy: what it computes, without a compilation.

The function is traced as ``jax.jit`` traces it, so laws about structure, slopes and batches hold or fail as they would
in a compiled program.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax

from qrsim.core.host import evaluate
from qrsim.core.operators import make_jaxpr


def by_numpy(function: Callable[..., Any], each: Sequence[Sequence[Any]]) -> list[Any]:
    """Return the results of a function for several lists of arguments of the same shapes; it is traced once."""
    closed, shape = make_jaxpr(function, return_shape=True)(*each[0])
    results = [evaluate(closed, jax.tree.leaves(arguments)) for arguments in each]
    return [jax.tree.unflatten(jax.tree.structure(shape), leaves) for leaves in results]


def uncompiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that computes the same by NumPy; its arguments may be of any kind."""
    return lambda *arguments, **named: by_numpy(lambda: function(*arguments, **named), [()])[0]
