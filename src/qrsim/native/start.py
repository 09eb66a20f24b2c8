"""A compiled start: a function from parameters and keys to a first state."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from qrsim.core.pack import Packer, struct
from qrsim.native.program import Binary, Input, Mode, build


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


def build_start(function: Callable[..., Any], inputs: Sequence[Input], mode: Mode) -> Start:
    """Compile a start.

    Args:
        function: called as function(*trees) of one world; returns its first state.
        inputs: the trees.
        mode: how vectors are used.

    Raises:
        UnsupportedError: the function does what this code generator cannot do.
    """
    shapes = [given.layout.template() for given in inputs]
    template = jax.tree.map(lambda leaf: struct(leaf.shape, np.dtype(leaf.dtype)), jax.eval_shape(function, *shapes))
    every = [*inputs, Input(Packer(template), own=True)]
    return Start(build(lambda *trees: function(*trees[:-2]), every, mode), template)
