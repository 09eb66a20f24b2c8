"""Checks of values that components return: arrays of a shape, vectors, records, poses; each yields error texts."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from qrsim.core.vectors import Euler, Vec3


def shape_text(value: Any) -> str:
    """Return "shape (...)" of an array, or the name of a value's type."""
    try:
        return f"shape {tuple(np.shape(value))}"
    except (TypeError, ValueError):
        return f"{type(value).__name__}"


def array_problems(what: str, value: Any, shape: tuple[int, ...]) -> Iterator[str]:
    """Yield an error unless a value is a floating-point array of the given shape; ``what`` names it in the error."""
    if value is None or isinstance(value, str | bytes | type):
        yield f"{what} is {value!r:.60}; expected an array of shape {shape}"
        return
    try:
        found, kind = tuple(np.shape(value)), jnp.result_type(value)
    except (TypeError, ValueError):
        yield f"{what} is {type(value).__name__}; expected an array of shape {shape}"
        return
    if found != shape:
        yield f"{what} has shape {found}; expected {shape}, one number for each vehicle"
    elif not jnp.issubdtype(kind, jnp.floating):
        yield f"{what} has numbers of type {kind}; expected floating-point ones"


def number_problems(what: str, value: Any, shape: tuple[int, ...]) -> Iterator[str]:
    """Yield an error unless a value is an array of the given shape, or one number for all vehicles."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return
    try:
        one = value is not None and not isinstance(value, str) and np.shape(value) == ()
    except (TypeError, ValueError):
        one = False
    yield from array_problems(what, value, () if one else shape)


def vector_problems(what: str, value: object, shape: tuple[int, ...]) -> Iterator[str]:
    """Yield the errors of a value that should be a ``Vec3`` of three arrays of the given shape."""
    if not isinstance(value, Vec3):
        yield f"{what} is {value_text(value)}; expected a qrsim.Vec3 of arrays of shape {shape}"
        return
    for axis in "xyz":
        yield from array_problems(f"{what}.{axis}", getattr(value, axis), shape)


def value_text(value: object) -> str:
    """Return the type of a value in words, with the shape of an array and the length of a tuple."""
    if isinstance(value, tuple):
        return f"a tuple of {len(value)}"
    return f"an array of {shape_text(value)}" if hasattr(value, "shape") else type(value).__name__


def pair_problems(value: object, what: str) -> Iterator[str]:
    """Yield an error unless a method's result is a tuple of two; ``what`` says which two."""
    if not isinstance(value, tuple) or len(value) != 2:
        yield f"it returned {value_text(value)}; expected a pair, {what}"


def record_problems(what: str, value: object, shape: tuple[int, ...]) -> Iterator[str]:
    """Yield the errors of a value that should be a record with arrays of the given shape only."""
    if not dataclasses.is_dataclass(value) or isinstance(value, type) or jax.tree_util.all_leaves([value]):
        yield f"{what} is {value_text(value)}; expected a record (@qrsim.record) of arrays of shape {shape}"
        return
    # A None would be no leaf; what is logged has no place for it.
    for path, leaf in jax.tree_util.tree_flatten_with_path(value, is_leaf=lambda leaf: leaf is None)[0]:
        yield from array_problems(f"{what}{jax.tree_util.keystr(path)}", leaf, shape)


def pose_problems(what: str, value: Any, shape: tuple[int, ...]) -> Iterator[str]:
    """Yield the errors of a value that should be a ``Pose`` or a ``Start`` with arrays of the given shape."""
    for name in ("position_ned", "velocity_body", "rates_body"):
        yield from vector_problems(f"{what}.{name}", getattr(value, name), shape)
    if not isinstance(value.attitude, Euler):
        yield f"{what}.attitude is {value_text(value.attitude)}; expected a qrsim.Euler of arrays of shape {shape}"
    yield from record_problems(what, value, shape)


def unchanged(what: str, before: object, after: object) -> Iterator[str]:
    """Yield the differences in structure, type and shape of a component's state before and after a step."""
    old: Any = jax.tree.structure(before)
    new: Any = jax.tree.structure(after)
    if old != new:
        yield f"{what} was {tree_text(before)} and is now {tree_text(after)}; expected the same structure"
        return
    for (path, one), other in zip(jax.tree_util.tree_flatten_with_path(before)[0], jax.tree.leaves(after), strict=True):
        was, now = (f"{jnp.result_type(leaf)} of shape {tuple(np.shape(leaf))}" for leaf in (one, other))
        if was != now:
            yield f"{what}{jax.tree_util.keystr(path)} was {was} and is now {now}; expected no change"


def tree_text(value: object) -> str:
    """Return the type of a component's state in words; "nothing" for None."""
    return "nothing" if value is None else value_text(value)
