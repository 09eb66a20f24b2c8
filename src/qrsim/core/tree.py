"""Frozen records that are JAX PyTrees and carry the unit, bounds and meaning of their fields.

A component (a wind, a sensor, a vehicle) is a record whose fields are its parameters; a state or a
reading is a record whose fields are quantities. The scenario schema and the logs are generated from
this metadata, so that no parameter is declared twice.
"""

from __future__ import annotations

import dataclasses
import operator
from collections.abc import Callable, Iterator, Sequence
from dataclasses import MISSING
from functools import cache
from typing import Any, ClassVar, Protocol, TypedDict, TypeVar, dataclass_transform, overload

import jax
import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.core.presets import with_presets

T = TypeVar("T")
INFO = "qrsim"


class Record(Protocol):
    """Any record."""

    __dataclass_fields__: ClassVar[dict[str, dataclasses.Field[Any]]]


@dataclasses.dataclass(frozen=True)
class FieldInfo:
    """Metadata of one field of a record.

    Attributes:
        unit: SI unit, "" where there is none.
        doc: one sentence.
        minimum, maximum: inclusive bounds, None where open.
        above: exclusive lower bound, None where open.
        static: part of the program's structure (a new value compiles again) rather than a number in it.
        inherits: path of the parameter that supplies the value where the scenario leaves it out.
        derived: set while a world is built; no scenario can give it.
        length: of a parameter that is an array, which a scenario gives as a list; 0: it is a number.
        nullable: whether it may be null, which is then its default and has a meaning of its own.
        of_sensors: whether a scenario that leaves it out takes it from the sensors; the default applies where no
            sensor states it.
    """

    unit: str = ""
    doc: str = ""
    minimum: float | None = None
    maximum: float | None = None
    above: float | None = None
    static: bool = False
    inherits: str | None = None
    derived: bool = False
    length: int = 0
    nullable: bool = False
    of_sensors: bool = False


def parameter(
    default: object = MISSING,
    *,
    unit: str = "",
    doc: str = "",
    minimum: float | None = None,
    maximum: float | None = None,
    above: float | None = None,
    inherits: str | None = None,
    length: int = 0,
    nullable: bool = False,
    of_sensors: bool = False,
) -> Any:
    """Return the field declaration of a component's numeric parameter, an array leaf: new values need no recompilation.

    Each has a unit and a doc; one without is refused when its class becomes a component. With a
    ``length`` it is a list of as many; one that is ``nullable`` may be null, where the default is None. One that is
    ``of_sensors`` is null in a scenario until the world is built, and then that of the sensors.
    """
    info = FieldInfo(
        unit, doc, minimum, maximum, above, False, inherits, length=length, nullable=nullable, of_sensors=of_sensors
    )
    return dataclasses.field(default=default, metadata={INFO: info})


def setting(
    default: object = MISSING,
    *,
    unit: str = "",
    doc: str = "",
    minimum: float | None = None,
    maximum: float | None = None,
    above: float | None = None,
) -> Any:
    """Return the field declaration of a component's structural choice (a period, an option), static under jit."""
    info = FieldInfo(unit, doc, minimum, maximum, above, True)
    return dataclasses.field(default=default, metadata={INFO: info})


def quantity(
    default: object = MISSING,
    *,
    unit: str = "",
    doc: str = "",
    minimum: float | None = None,
    maximum: float | None = None,
) -> Any:
    """Return the field declaration of an array, or record of arrays, in a state, reading or command."""
    return dataclasses.field(default=default, metadata={INFO: FieldInfo(unit, doc, minimum, maximum)})


def derived(default: object = None, *, doc: str, static: bool = False) -> Any:
    """Return the field declaration of a value computed while a world is built, not set by scenarios; None before."""
    return dataclasses.field(default=default, metadata={INFO: FieldInfo(doc=doc, derived=True, static=static)})


@dataclass_transform(frozen_default=True, field_specifiers=(parameter, setting, quantity, derived))
def record(cls: type[T]) -> type[T]:
    """Return a class made a frozen dataclass and a JAX PyTree; fields declared by ``setting`` are static.

    What is not given to a component with ``presets`` is that of its ``preset``.
    """
    component = with_presets(dataclasses.dataclass(frozen=True)(cls))
    static = [f.name for f in dataclasses.fields(component) if field_info(f).static]
    data = [f.name for f in dataclasses.fields(component) if f.name not in static]
    _register(component, data, static)
    return component


def _register(cls: Any, data: list[str], static: list[str]) -> None:
    """Register a record class with JAX as a PyTree node, with these data fields and static fields.

    Not by ``jax.tree_util.register_dataclass``: structures of two dataclasses that differ only in their type are equal
    to JAX (0.10 for one), so that ``jax.jit`` at times runs the program of one for the other.
    """
    of_data, of_static = _getter(data), _getter(static)
    keys = [jax.tree_util.GetAttrKey(name) for name in data]

    def flatten(item: object) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
        """Return the values of a record's data fields and of its static fields, as JAX requires."""
        return of_data(item), of_static(item)

    def flatten_with_keys(item: object) -> tuple[list[tuple[object, object]], tuple[object, ...]]:
        """Return a record's data fields with their keys, and its static fields, as JAX requires."""
        return list(zip(keys, of_data(item), strict=True)), of_static(item)

    # By place, which is quicker, where a constructor takes parts and settings in this order.
    by_place = [field.name for field in dataclasses.fields(cls) if field.init and not field.kw_only] == data + static

    def unflatten(settings: tuple[object, ...], parts: Any) -> object:
        """Return a record from the values of its static fields (settings) and data fields (parts)."""
        if by_place:
            return cls(*parts, *settings)
        return cls(**dict(zip(data, parts, strict=True)), **dict(zip(static, settings, strict=True)))

    jax.tree_util.register_pytree_with_keys(cls, flatten_with_keys, unflatten, flatten)


def _getter(names: list[str]) -> Callable[[Any], tuple[Any, ...]]:
    """Return a function that returns an object's attributes ``names`` as a tuple."""
    if len(names) > 1:
        return operator.attrgetter(*names)
    if not names:
        return lambda item: ()
    (name,) = names
    return lambda item: (getattr(item, name),)


def field_info(field: dataclasses.Field[Any]) -> FieldInfo:
    """Return a dataclass field's metadata (unit, text, bounds), empty if none was given."""
    return field.metadata.get(INFO, FieldInfo())


class Bounds(TypedDict, total=False):
    """Bounds of a parameter, as ``parameter`` takes them."""

    minimum: float | None
    maximum: float | None
    above: float | None


def computed(function: Callable[[Any], T]) -> T:
    """Return a method as a property, typed as the class attribute that it computes."""
    attribute: Any = property(function)
    return attribute


def record_of(kind: Callable[..., T], *parts: object, **named: object) -> T:
    """Return ``kind(*parts, **named)``, typed to accept NumPy arrays or numbers for fields declared as JAX arrays."""
    return kind(*parts, **named)


def replace(item: T, **changes: object) -> T:
    """Return a copy of a record with some fields changed."""
    original: Any = item
    return dataclasses.replace(original, **changes)


def cast(item: T, dtype: Any) -> T:
    """Return a tree with every floating-point leaf, Python floats included, as an array of ``dtype``."""

    def convert(leaf: object) -> NumpyArray:
        """Return a leaf as an array, converted to ``dtype`` if it is floating-point."""
        array = np.asarray(leaf)
        return np.asarray(array, dtype) if np.issubdtype(array.dtype, np.floating) else array

    return jax.tree.map(convert, item)


def select(condition: jax.Array, yes: T, no: T) -> T:
    """Return ``yes`` where ``condition`` (n,) is True, else ``no``, leaf by leaf, for trees of one structure."""
    return jax.tree.map(lambda a, b: jax.numpy.where(condition, a, b), yes, no)


@overload
def map_tree(function: Callable[[jax.Array], jax.Array], tree: T, /) -> T:
    """Return one tree with ``function`` applied to each array."""


@overload
def map_tree(function: Callable[[jax.Array, jax.Array], jax.Array], tree: T, other: T, /) -> T:
    """Return one tree with ``function`` applied to each pair of corresponding arrays of two trees."""


def map_tree(function: Callable[..., jax.Array], tree: T, *others: T) -> T:
    """Return a tree with ``function`` applied to each leaf together with the matching leaves of the other trees."""
    return jax.tree.map(function, tree, *others)


def concatenated(trees: Sequence[T]) -> T:
    """Return trees of one structure joined: each leaf concatenated along its first axis."""
    return jax.tree.map(lambda *parts: jax.numpy.concatenate(parts), *trees)


def walk(item: Any, prefix: str = "") -> Iterator[tuple[str, Any, FieldInfo]]:
    """Yield (dotted name, array, metadata) for each array in a tree of records; ``prefix`` starts each name.

    The axes of a Vec3 inherit its unit; the parts of a tuple are numbered from 0; a field that is None has none.
    """
    for name, info in _parts(item.__class__):
        value = getattr(item, name)
        if value is not None:
            yield from _walked(value, f"{prefix}{name}", info)


@cache
def _parts(kind: type) -> tuple[tuple[str, FieldInfo], ...]:
    """Return name and metadata of each data field (not a setting) of a record class."""
    found = ((field.name, field_info(field)) for field in dataclasses.fields(kind))
    return tuple((name, info) for name, info in found if not info.static)


@cache
def _with_unit(info: FieldInfo, unit: str) -> FieldInfo:
    """Return a field's metadata with ``unit`` in place of its unit."""
    return dataclasses.replace(info, unit=unit)


def _walked(value: object, name: str, info: FieldInfo) -> Iterator[tuple[str, object, FieldInfo]]:
    """Yield (dotted name, array, metadata) for each array in one field's value."""
    if isinstance(value, tuple):
        for number, part in enumerate(value):
            yield from _walked(part, f"{name}.{number}", info)
    elif dataclasses.is_dataclass(value):
        for sub_name, leaf, sub in walk(value, f"{name}."):
            yield sub_name, leaf, sub if sub.unit else _with_unit(sub, info.unit)
    else:
        yield name, value, info
