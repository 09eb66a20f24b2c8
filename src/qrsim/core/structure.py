"""Structures of trees as plain data, for files: JSON values only, and reading runs no code."""

from __future__ import annotations

import dataclasses
import importlib
import sys
from collections.abc import Iterator
from typing import Any

from qrsim.core.tree import field_info

_PLAIN = (str, int, float, bool, type(None))


def kinds(structure: Any) -> Iterator[type]:
    """Yield the Python type of every node of a tree structure (a ``jax.tree_util.PyTreeDef``)."""
    node = structure.node_data()
    if node is not None:
        yield node[0]
        for child in structure.children():
            yield from kinds(child)


def name_of(kind: type) -> str:
    """Return a type's full name, module included."""
    return f"{kind.__module__}:{kind.__qualname__}"


def to_plain(structure: Any) -> Any:
    """Return a tree structure (PyTreeDef) as lists, dicts and plain values that JSON can store.

    Raises:
        TypeError: it has a part that another process could not find by name.
    """
    node = structure.node_data()
    if node is None:
        return "*"
    kind, settings = node
    children = [to_plain(child) for child in structure.children()]
    if kind in (tuple, list, type(None)):
        return [kind.__name__, *children]
    if kind is dict and all(isinstance(key, str) for key in settings):
        return {"dict": dict(zip(settings, children, strict=True))}
    if not _is_record(kind) or "<" in kind.__qualname__:
        raise TypeError(f"{name_of(kind)} has no place in a file")
    data, static = _fields(kind)
    return {
        "record": name_of(kind),
        "parts": dict(zip(data, children, strict=True)),
        "settings": dict(zip(static, map(_plain, settings), strict=True)),
    }


def from_plain(plain: object, leaves: Iterator[object]) -> Any:
    """Return the tree rebuilt from the result of ``to_plain``, with ``leaves`` in their order.

    Raises:
        ValueError: it is nothing that ``to_plain`` returns here, or there are too few leaves.
    """
    if plain == "*":
        try:
            return next(leaves)
        except StopIteration:
            raise ValueError("too few leaves") from None
    if isinstance(plain, list) and plain:
        children = [from_plain(child, leaves) for child in plain[1:]]
        containers = {"tuple": tuple(children), "list": children, "NoneType": None}
        if plain[0] in containers:
            return containers[plain[0]]
    if isinstance(plain, dict) and plain.keys() == {"dict"}:
        return {key: from_plain(child, leaves) for key, child in plain["dict"].items()}
    if isinstance(plain, dict) and plain.keys() == {"record", "parts", "settings"}:
        kind = _record_named(plain["record"])
        data, static = _fields(kind)
        if list(plain["parts"]) == data and list(plain["settings"]) == static:
            parts = {name: from_plain(child, leaves) for name, child in plain["parts"].items()}
            return kind(**parts, **{name: _unplain(value) for name, value in plain["settings"].items()})
    raise ValueError("no structure")


def _is_record(kind: object) -> bool:
    """Return whether an object is a dataclass type."""
    return isinstance(kind, type) and dataclasses.is_dataclass(kind)


def _fields(kind: type) -> tuple[list[str], list[str]]:
    """Return the field names of a record class: its data fields, then its settings."""
    fields = dataclasses.fields(kind)
    static = [field.name for field in fields if field_info(field).static]
    return [field.name for field in fields if field.name not in static], static


def _plain(value: object) -> Any:
    """Return a record's setting in a form that JSON can store, tuples marked; raise TypeError for other types."""
    if type(value) is tuple:
        return {"tuple": [_plain(part) for part in value]}
    if type(value) not in _PLAIN:
        raise TypeError(f"{value!r} has no place in a file")
    return value


def _unplain(value: object) -> Any:
    """Return a record's setting rebuilt from the form of ``_plain``."""
    if isinstance(value, dict):
        return tuple(_unplain(part) for part in value["tuple"])
    return value


def _record_named(name: object) -> Any:
    """Return the record class with a full name; import only this package's modules; raise ValueError for others."""
    if not isinstance(name, str):
        raise ValueError("no name")
    module, _, path = name.partition(":")
    value: Any = sys.modules.get(module)
    if value is None and module.startswith("qrsim."):
        try:
            value = importlib.import_module(module)
        except ImportError:
            raise ValueError(f"no module {module}") from None
    for part in path.split("."):
        value = getattr(value, part, None)
    if not _is_record(value) or name_of(value) != name:
        raise ValueError(f"no record {name}")
    return value
