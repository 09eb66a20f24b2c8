"""A compiled start: a function from parameters and keys to a first state."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from qrsim.engine.layout import Packer, struct
from qrsim.engine.llvm.program import Binary, Input, Mode, build
from qrsim.engine.llvm.refusal import refusing


@dataclass(frozen=True)
class Start:
    """What a first state is made by, and how it looks.

    Attributes:
        binary: a program over the inputs and an empty state, which it fills.
        template: the state, its leaves jax.ShapeDtypeStruct.
    """

    binary: Binary
    template: Any

    @property
    def layout(self) -> Packer:
        """The layout of the state."""
        return Packer(self.template)


def trace_of(function: Callable[..., Any], inputs: Sequence[Input]) -> tuple[Any, Any]:
    """Return the closed jaxpr of a function of some trees, and the shapes (jax.ShapeDtypeStruct) of what it returns."""
    found: tuple[Any, Any] = jax.make_jaxpr(function, return_shape=True)(*(each.layout.template() for each in inputs))
    return found


def build_start(traced: tuple[Any, Any], inputs: Sequence[Input], mode: Mode, tier: str = "quick") -> Start:
    """Compile a start.

    Args:
        traced: by ``trace_of``: a function of the trees of one world that returns its first state.
        inputs: the trees.
        mode: how vectors are used.
        tier: of the code; a start runs once, so quick code is enough.

    Raises:
        UnsupportedError: the function does what this code generator cannot do.
    """
    closed, shape = traced
    with refusing():
        # Shapes only: JAX says more of a leaf, such as its weak type, that is none of the layout.
        template = jax.tree.map(lambda leaf: struct(leaf.shape, np.dtype(leaf.dtype)), shape)
        layout = Packer(template)
    # The state is an input like the others, so that a start is a program like a tick, which fills it.
    return Start(build(closed, [*inputs, Input(layout, own=True)], mode, tier), template)
