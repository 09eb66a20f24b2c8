"""The part of the reference that deals with symmetric matrices kept as halves (``qrsim.core.symmetric``).

Written from F P F' + Q, P H' and P - K K' number by number, each product and each sum with its own rounding.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from tests.engine.reference.bounds import Value, given
from tests.engine.reference.elements import elementwise


def _size(half: Value) -> int:
    """Return the rows of a matrix, of which a half has m (m + 1) / 2 numbers."""
    return next(m for m in range(1, 100) if m * (m + 1) // 2 == len(half.rounded))


def _entries(half: Value) -> dict[tuple[int, int], Value]:
    """Return each number (...) of the upper half by row and column, row after row."""
    size = _size(half)
    places = [(i, j) for i in range(size) for j in range(i, size)]
    return {place: half.each(lambda part, k=k: part[k]) for k, place in enumerate(places)}


def _whole(entries: dict[tuple[int, int], Value], i: int, j: int) -> Value:
    return entries[min(i, j), max(i, j)]


def _product(a: Value, b: Value) -> Value:
    return elementwise("mul", [a, b], {}, a.rounded.dtype)


def _sum(a: Value | None, b: Value) -> Value:
    return b if a is None else elementwise("add", [a, b], {}, b.rounded.dtype)


def _stacked(parts: list[Value]) -> Value:
    return Value(*(np.stack([part[i] for part in parts]) for i in range(3)))


def _times(inputs: list[Value], parameters: Any, out: Any) -> Value:
    half, *factors = inputs
    entries, found = _entries(half), []
    for i in range(_size(half)):
        total = None
        for row, factor in zip(parameters["rows"], factors, strict=True):
            total = _sum(total, _product(factor, _whole(entries, i, row)))
        assert total is not None
        found.append(total)
    return _stacked(found)


def _lowered(inputs: list[Value], parameters: Any, out: Any) -> Value:
    half, *columns = inputs
    entries = _entries(half)
    for place, value in entries.items():
        total = value
        for column in columns:
            first, second = (column.each(lambda part, k=k: part[k]) for k in place)
            total = _sum(total, _product(first.each(np.negative)._replace(error=first.error), second))
        entries[place] = total
    return _stacked(list(entries.values()))


def _transformed(inputs: list[Value], parameters: Any, out: Any) -> Value:
    half, rows = inputs[0], parameters["rows"]
    given_factors = inputs[1 : len(inputs) - len(rows)]
    added = dict(zip(rows, inputs[len(inputs) - len(rows) :], strict=True))
    entries, size = _entries(half), _size(half)
    into: dict[int, list[tuple[int, Value]]] = {i: [] for i in range(size)}
    for row, column, scale, factor in parameters["terms"]:
        number = given(np.full(half.rounded.shape[1:], scale, half.rounded.dtype))
        into[row].append((column, number if factor is None else _product(number, given_factors[factor])))
    found = []
    for i in range(size):
        line = {}
        for j in range(i, size):
            line[j] = entries[i, j]
            for k, factor in into[i]:
                line[j] = _sum(line[j], _product(factor, _whole(entries, k, j)))
        for j in range(i, size):
            for k, factor in into[j]:
                line[j] = _sum(line[j], _product(factor, line[k]))
        if i in added:
            line[i] = _sum(line[i], added[i])
        found += [line[j] for j in range(i, size)]
    return _stacked(found)


RULES: dict[str, Callable[..., Value]] = {
    "half_times": _times,
    "half_lowered": _lowered,
    "half_transformed": _transformed,
}
