"""Fields of a command record, their limits, and clipping to them."""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import TypeVar

import jax.numpy as jnp
from jax import Array

from qrsim.core.tree import field_info, replace

C = TypeVar("C")


def fields_of(command_type: type) -> tuple[str, ...]:
    """Return the field names of a command record class, in order."""
    return tuple(field.name for field in dataclasses.fields(command_type))


def limits_of(command_type: type) -> dict[str, tuple[float, float]]:
    """Return {field: (lowest, highest value)} of a command record class; infinite for fields without limits."""
    found = {}
    for field in dataclasses.fields(command_type):
        info = field_info(field)
        low = -math.inf if info.minimum is None else info.minimum
        found[field.name] = (low, math.inf if info.maximum is None else info.maximum)
    return found


def clipped(command: C, without: tuple[str, ...] = ()) -> tuple[C, Array]:
    """Return a command clipped to its fields' limits, except fields ``without``, and (n,) bool: it was changed.

    Args:
        command: record of arrays (n,).
        without: fields that stay as they are.
    """
    limits = limits_of(type(command))
    fields = [name for name in limits if name not in without]
    found = replace(command, **{name: jnp.clip(getattr(command, name), *limits[name]) for name in fields})
    changed = [getattr(found, name) != getattr(command, name) for name in fields]
    return found, functools.reduce(jnp.logical_or, changed)
