"""The part of the reference that deals with whole arrays: reductions and places."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from tests.engine.reference import bounds
from tests.engine.reference.bounds import AmbiguousError, Array, Value, chosen, given, settled, whole
from tests.engine.reference.elements import elementwise, product


def _added(inputs: list[Value], parameters: Any, out: Any) -> Value:
    """Return a sum over axes, in any order."""
    (x,), axes = inputs, tuple(parameters["axes"])
    if x.rounded.dtype.kind != "f":
        return whole(np.add.reduce(x.rounded, axis=axes, dtype=x.rounded.dtype), *_any_of(x, axes))
    exact = x.exact.sum(axis=axes)
    sizes = np.where(np.isfinite(x.exact), np.abs(x.exact), 0.0).sum(axis=axes)
    error = x.error.sum(axis=axes)
    count = int(np.prod([x.rounded.shape[axis] for axis in axes]))
    own = np.where(bounds.exact_together(x, axes), 0.0, count * np.finfo(x.rounded.dtype).eps * sizes)
    # A sum that is too large on the way may not be in another order.
    own = np.where(sizes > 0.4 * np.finfo(x.rounded.dtype).max, np.inf, own)
    return settled(x.rounded.sum(axis=axes), exact, np.where(np.isfinite(exact), error + own, error).astype(float))


def _any_of(x: Value, axes: Any) -> list[Value]:
    """Return whether anything is unknown along axes, as a value to hand to ``whole``."""
    error = np.where(np.isfinite(x.error), 0.0, np.inf).sum(axis=tuple(axes))
    return [Value(error, error, error)]


def _multiplied(inputs: list[Value], parameters: Any, out: Any) -> Value:
    (x,), axes = inputs, tuple(parameters["axes"])
    if x.rounded.dtype.kind != "f":
        return whole(np.multiply.reduce(x.rounded, axis=axes, dtype=x.rounded.dtype), *_any_of(x, axes))
    parts = np.moveaxis(x.rounded, axes, range(len(axes))).reshape(-1, *np.shape(x.rounded.sum(axis=axes)))
    moved = x.each(lambda part: np.moveaxis(part, axes, range(len(axes))).reshape(parts.shape))
    total = given(np.ones(parts.shape[1:], x.rounded.dtype))
    for i in range(len(parts)):
        total = product([total, moved.each(lambda part, i=i: part[i])], None, None)
    # In another order it may be too large, or lose what is too small, on the way.
    sizes = np.where(np.isfinite(moved.exact) & (moved.exact != 0.0), np.abs(moved.exact), 1.0)
    risky = (np.maximum(sizes, 1.0).prod(axis=0) > 1e37) | (np.minimum(sizes, 1.0).prod(axis=0) < 1e-36)
    return total._replace(error=np.where(risky, np.inf, total.error))


def _extreme(name: str) -> Callable[..., Value]:
    function = getattr(np, name)

    def of(inputs: list[Value], parameters: Any, out: Any) -> Value:
        (x,), axes = inputs, tuple(parameters["axes"])
        if x.rounded.dtype.kind != "f":
            start = {} if x.rounded.size else {"initial": _first(name, x.rounded.dtype)}
            return whole(function.reduce(x.rounded, axis=axes, **start), *_any_of(x, axes))
        start = {"initial": -np.inf if name == "maximum" else np.inf}
        exact, error = _signed(name, x.exact, axes, **start), x.error.max(axis=axes, initial=0.0)
        error = np.where(np.isnan(exact) & np.isfinite(error), 0.0, error)
        return Value(_signed(name, x.rounded, axes, **start), exact, error)

    return of


def _signed(name: str, x: Any, axes: tuple[int, ...], **start: Any) -> Any:
    """Return the extreme along axes; as in JAX and unlike in NumPy -0 is less than +0, in whichever order they come."""
    found = getattr(np, name).reduce(x, axis=axes, **start)
    sign = -1.0 if name == "minimum" else 1.0
    # A sum of zeros is -0 where all of them are.
    zero = sign * np.add.reduce(np.where(x == 0.0, sign * x, -0.0), axis=axes, initial=-0.0)
    return np.where(found == 0.0, zero, found).astype(x.dtype)


def _first(name: str, dtype: Any) -> Any:
    if dtype.kind == "b":
        return name == "minimum"
    return np.iinfo(dtype).min if name == "maximum" else np.iinfo(dtype).max


def _logical(name: str) -> Callable[..., Value]:
    function = getattr(np, name)

    def of(inputs: list[Value], parameters: Any, out: Any) -> Value:
        (x,), axes = inputs, tuple(parameters["axes"])
        return whole(function.reduce(x.rounded, axis=axes), *_any_of(x, axes))

    return of


def _place_of(how: Callable[..., Any], sign: float) -> Callable[..., Value]:
    def of(inputs: list[Value], parameters: Any, out: Any) -> Value:
        (x,), (axis,) = inputs, parameters["axes"]
        numbers = x.rounded if x.rounded.dtype.kind != "b" else x.rounded.astype(np.int8)
        # Of NaNs NumPy takes the first too.
        exact = x.exact if x.rounded.dtype.kind == "f" else numbers
        place = how(exact, axis=axis)
        best = np.take_along_axis(x.error, np.expand_dims(place, axis), axis)
        sure = (x.error == 0.0).all(axis=axis)
        if x.rounded.dtype.kind == "f":
            top = np.take_along_axis(x.exact, np.expand_dims(place, axis), axis)
            other = np.arange(x.exact.shape[axis]).reshape([-1 if i == axis else 1 for i in range(x.exact.ndim)])
            ahead = (sign * (top - x.exact) > best + x.error) | (other == np.expand_dims(place, axis))
            sure = sure | (
                np.isfinite(x.error).all(axis=axis) & (ahead.all(axis=axis) | np.isnan(np.squeeze(top, axis)))
            )
        found = place.astype(out.dtype)
        return Value(found, found, np.where(sure, 0.0, np.inf))

    return of


def _running(step: Callable[..., Value]) -> Callable[..., Value]:
    def of(inputs: list[Value], parameters: Any, out: Any) -> Value:
        (x,), axis = inputs, parameters["axis"]
        order = range(x.rounded.shape[axis])
        now: Value | None = None
        parts = []
        for i in reversed(order) if parameters["reverse"] else order:
            one = x.each(lambda part, i=i: np.take(part, i, axis))
            now = one if now is None else step(now, one)
            parts.append(now)
        if parameters["reverse"]:
            parts = parts[::-1]
        return Value(*(np.stack([part[i] for part in parts], axis) for i in range(3)))

    return of


def _step_of(name: str) -> Callable[[Value, Value], Value]:
    def step(a: Value, b: Value) -> Value:
        return elementwise(name, [a, b], {}, a.rounded.dtype)

    return step


def _summed_so_far(inputs: list[Value], parameters: Any, out: Any) -> Value:
    """Return running sums, which may be taken in any order."""
    found = _running(_step_of("add"))(inputs, parameters, out)
    (x,), axis = inputs, parameters["axis"]
    if x.rounded.dtype.kind != "f":
        return found
    sizes = np.where(np.isfinite(x.exact), np.abs(x.exact), 0.0).sum(axis=axis, keepdims=True)
    own = x.rounded.shape[axis] * np.finfo(x.rounded.dtype).eps * sizes
    own = np.where(np.expand_dims(bounds.exact_together(x, (axis,)), axis), 0.0, own)
    return found._replace(error=np.where(np.isfinite(found.exact), found.error + own, found.error))


def _iota(inputs: list[Value], parameters: Any, out: Any) -> Value:
    shape, axis = tuple(out.shape), parameters["dimension"]
    line = np.arange(shape[axis]).astype(out.dtype).reshape([-1 if i == axis else 1 for i in range(len(shape))])
    return given(np.broadcast_to(line, shape))


def _joined(inputs: list[Value], parameters: Any, out: Any) -> Value:
    return Value(*(np.concatenate([value[i] for value in inputs], parameters["dimension"]) for i in range(3)))


def _stacked(inputs: list[Value], parameters: Any, out: Any) -> Value:
    return Value(*(np.stack([value[i] for value in inputs], parameters["axis"]) for i in range(3)))


def _unstacked(inputs: list[Value], parameters: Any, out: Any) -> list[Value]:
    (x,), axis = inputs, parameters["axis"]
    return [x.each(lambda part, i=i: np.take(part, i, axis)) for i in range(x.rounded.shape[axis])]


def _tiled(inputs: list[Value], parameters: Any, out: Any) -> Value:
    return inputs[0].each(lambda part: np.tile(part, parameters["reps"]))


def _parted(inputs: list[Value], parameters: Any, out: Any) -> list[Value]:
    ends = np.cumsum([int(size) for size in parameters["sizes"]])[:-1]
    parts = [np.split(part, ends, parameters["axis"]) for part in inputs[0]]
    return [Value(*each) for each in zip(*parts, strict=True)]


def _selected(inputs: list[Value], parameters: Any, out: Any) -> Value:
    return chosen(*inputs)


def _part(inputs: list[Value], parameters: Any, out: Any) -> Value:
    operand, starts, sizes = inputs[0], inputs[1:], parameters["slice_sizes"]
    if not all(start.known for start in starts):
        raise AmbiguousError("where a part begins")
    extents = zip(starts, sizes, operand.rounded.shape, strict=True)
    begins = [int(np.clip(int(start.rounded), 0, extent - size)) for start, size, extent in extents]
    cut = tuple(slice(begin, begin + size) for begin, size in zip(begins, sizes, strict=True))
    return operand.each(lambda part: part[cut])


def _gathered(inputs: list[Value], parameters: Any, out: Any) -> Value:
    """Return single elements, looked up one by one."""
    operand, places = inputs
    if not places.known:
        raise AmbiguousError("where to look")
    numbers, mode = parameters["dimension_numbers"], parameters["mode"].name
    shape, extents = tuple(out.shape), operand.rounded.shape
    found = [np.zeros(shape, part.dtype) for part in operand]
    fill = parameters["fill_value"]
    if fill is None:
        kind = np.dtype(out.dtype).kind
        fill = (
            np.nan
            if kind == "f"
            else True
            if kind == "b"
            else getattr(np.iinfo(out.dtype), "min" if kind == "i" else "max")
        )
    filling = given(np.asarray(fill, out.dtype))
    for at in np.ndindex(*shape):
        index, inside = _index(numbers.start_index_map, places.rounded[at], extents)
        for axis, follows in zip(numbers.operand_batching_dims, numbers.start_indices_batching_dims, strict=True):
            index[axis] = at[follows]
        for part, source, outside in zip(found, operand, filling, strict=True):
            part[at] = source[tuple(index)] if inside or mode != "FILL_OR_DROP" else outside
    return Value(*found)


def _index(axes: Any, place: Array, extents: tuple[int, ...]) -> tuple[list[int], bool]:
    """Return an index brought into range, and whether it was."""
    index, inside = [0] * len(extents), True
    for which, axis in enumerate(axes):
        wanted = int(place[which])
        inside = inside and 0 <= wanted < extents[axis]
        index[axis] = min(max(wanted, 0), extents[axis] - 1)
    return index, inside


def _scattered(how: str) -> Callable[..., Value]:
    def of(inputs: list[Value], parameters: Any, out: Any) -> Value:
        operand, places, updates = inputs
        if not places.known:
            raise AmbiguousError("where to put")
        numbers, mode = parameters["dimension_numbers"], parameters["mode"].name
        found = [np.array(part) for part in operand]
        for at in np.ndindex(*updates.rounded.shape):
            index, inside = _index(numbers.scatter_dims_to_operand_dims, places.rounded[at], operand.rounded.shape)
            batches = zip(numbers.operand_batching_dims, numbers.scatter_indices_batching_dims, strict=True)
            for axis, follows in batches:
                index[axis] = at[follows]
            if not inside and mode != "CLIP":
                continue
            one, there = updates.each(lambda part, at=at: part[at]), tuple(index)
            if how != "set":
                before = Value(*(np.asarray(part[there]) for part in found))
                one = elementwise(how, [before, one], {}, operand.rounded.dtype)
            for part, new in zip(found, one, strict=True):
                part[there] = new
        return Value(*found)

    return of


def _nearest(inputs: list[Value], parameters: Any, out: Any) -> Value:
    """Return the least squared distance to another point; NaN is far from all."""
    x, y, z = inputs[:3]
    with np.errstate(invalid="ignore"):
        apart = [axis.each(lambda part: part[:, None] - part[None, :]) for axis in (x, y, z)]
        errors = [axis.error[:, None] + axis.error[None, :] for axis in (x, y, z)]
        exact = sum(axis.exact**2 for axis in apart)
        rounded = sum(axis.rounded**2 for axis in apart)
    info = np.finfo(out.dtype)
    error = sum(
        2.0 * np.abs(axis.exact) * e + e * e + 3.0 * info.eps * axis.exact**2
        for axis, e in zip(apart, errors, strict=True)
    )
    own = np.eye(len(x.rounded), dtype=bool)
    far = own | ~(exact >= 0.0)
    exact, rounded = np.where(far, np.inf, exact), np.where(far, np.inf, rounded)
    error = np.where(far | ~np.isfinite(exact), 0.0, error)
    found = exact.min(axis=0)
    return settled(
        rounded.min(axis=0).astype(out.dtype), found, np.where(np.isfinite(found), error.max(axis=0), 0.0).astype(float)
    )


def _handed_on(inputs: list[Value], parameters: Any, out: Any) -> list[Value]:
    return inputs


RULES: dict[str, Callable[..., Any]] = {
    "reduce_sum": _added, "reduce_prod": _multiplied, "reduce_max": _extreme("maximum"),
    "reduce_min": _extreme("minimum"), "reduce_and": _logical("bitwise_and"), "reduce_or": _logical("bitwise_or"),
    "argmax": _place_of(np.argmax, 1.0), "argmin": _place_of(np.argmin, -1.0), "cumsum": _summed_so_far,
    "cumprod": _running(_step_of("mul")), "cummax": _running(_step_of("max")), "cummin": _running(_step_of("min")),
    "iota": _iota, "concatenate": _joined, "stack": _stacked, "split": _parted, "unstack": _unstacked, "tile": _tiled,
    "stop_gradient": _handed_on, "select_n": _selected,
    "dynamic_slice": _part, "gather": _gathered, "scatter": _scattered("set"), "scatter-add": _scattered("add"),
    "scatter-mul": _scattered("mul"), "scatter-min": _scattered("min"), "scatter-max": _scattered("max"),
    "nearest_squared": _nearest, "copy": _handed_on, "copy_p": _handed_on,
    "optimization_barrier": _handed_on,
}  # fmt: skip
