"""Checks of the class attributes of a component against those that its contract names."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable, Iterator

import jax

from qrsim.core.tree import INFO
from qrsim.models.vehicles.contracts import Vehicle
from qrsim.tasks.agents import Axis


def is_record(value: object) -> bool:
    """Return whether a value is a record class: a frozen dataclass that is registered as a JAX PyTree."""
    if not isinstance(value, type) or not dataclasses.is_dataclass(value):
        return False
    own = vars(value).get("__dataclass_params__")
    if own is None or not own.frozen:
        return False
    if inspect.isabstract(value):
        return True  # no object can be made of it; what it lacks is a fault of its own
    item = object.__new__(value)
    for field in dataclasses.fields(value):
        object.__setattr__(item, field.name, 0)
    return not jax.tree_util.all_leaves([item])


def _whole(value: object) -> bool:
    """Return whether a value is an integer of at least 0; a bool is not."""
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def _tuple_of(kind: type) -> Callable[[object], bool]:
    """Return a function that tests whether a value is a tuple of instances of ``kind``."""
    return lambda value: isinstance(value, tuple) and all(isinstance(part, kind) for part in value)


def _feed(value: object) -> bool:
    """Return whether a value names a state source of a controller: "measurements", "truth" or "filter"."""
    return value in ("measurements", "truth", "filter")


# What an attribute is that a contract declares in these words: whether a value is one, and how that is said.
_DECLARED: dict[str, tuple[Callable[[object], bool], str]] = {
    "ClassVar[int]": (_whole, "a whole number, 0 or more"),
    "int": (_whole, "a whole number, 0 or more"),
    "ClassVar[bool]": (lambda value: isinstance(value, bool), "True or False"),
    "bool": (lambda value: isinstance(value, bool), "True or False"),
    "ClassVar[str]": (lambda value: isinstance(value, str), "a text"),
    "ClassVar[type]": (lambda value: isinstance(value, type), "a class"),
    "ClassVar[type | None]": (lambda value: value is None or isinstance(value, type), "a class or None"),
    "ClassVar[tuple[type, ...]]": (_tuple_of(type), "a tuple of classes, as (qrsim.WaypointSetpoint,)"),
    "ClassVar[tuple[Axis, ...]]": (_tuple_of(Axis), "a tuple of Axis (qrsim.tasks.agents)"),
    "Literal['measurements', 'truth', 'filter']": (_feed, "'measurements', 'truth' or 'filter'"),
}


def attribute_type_problems(kind: str, component: type, contract: type | None) -> Iterator[str]:
    """Yield an error for each class attribute of a component with a type that its kind's contract does not allow."""
    fields = getattr(component, "__dataclass_fields__", {})
    for name, declared in getattr(contract, "__annotations__", {}).items():
        fits, words = _DECLARED.get(str(declared).replace('"', "'"), (None, ""))
        value = inspect.getattr_static(component, name, inspect.Parameter.empty)
        own = name not in fields and value is not inspect.Parameter.empty and not isinstance(value, property)
        if fits is not None and own and not fits(value):
            yield _wrong(component, name, value, words)
    if kind == "vehicle":
        yield from _command_problems(component)
    policy = getattr(component, "baseline", None) if kind == "task" else None
    if policy is not None and not callable(getattr(policy, "act", None)):
        yield _wrong(component, "baseline", policy, "a class with act(seen), made with (play, seed)")


def _command_problems(component: type[Vehicle]) -> Iterator[str]:
    """Yield the errors in the class attributes ``command_type`` and ``actions`` of a vehicle class."""
    # Of the actions one may be a base class of records.
    own, actions = component.command_type, component.actions
    if not is_record(own):
        yield _wrong(component, "command_type", own, "a record (@qrsim.record) of arrays (n,), as qrsim.Command")
    elif any(INFO not in field.metadata for field in dataclasses.fields(own)):
        yield _wrong(component, "command_type", own, "fields made by qrsim.quantity(unit=..., doc=...)")
    if own not in actions:
        yield _wrong(component, "actions", actions, f"{own.__name__}, its command_type, among them")


def _wrong(component: type, name: str, value: object, words: str) -> str:
    """Return the error for a wrong class attribute: its value, and the expected one in ``words``."""
    return f"{component.__name__}.{name} is {value!r:.80}; expected {words}"
