"""What tests by hand give to models: values of several vehicles, and draws."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np


def many(*values: float) -> Any:
    """Return an array of values."""
    return jnp.asarray(values, float)


@dataclass(frozen=True)
class Given:
    """A draw and its stream of words (K, n) that are given by the number of the draw, at the ends those there."""

    table: Any
    other: Any = None
    tick: int = 0

    @property
    def like(self) -> Any:
        return np.zeros((), np.float32)

    @property
    def stream(self) -> Given:
        return self

    def words(self, tick: Any, index: Any) -> tuple[Any, Any]:
        place = jnp.clip(jnp.asarray(index, jnp.int32), 0, self.table.shape[0] - 1)
        return jnp.asarray(self.table)[place], jnp.asarray(self.table if self.other is None else self.other)[place]


def words(parts: Any) -> Any:
    """Return the words (32 bits) of parts of 1."""
    return (np.asarray(parts) * 2.0**32).astype(np.uint32)
