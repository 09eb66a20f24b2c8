"""Checks whether a class conforms to a kind of component: a record with units and the required methods.

What a contract (``contracts.py`` in each room) has a default for may be left out, also by a class that does not name
the contract as its base class: it is then given the default.
"""

from __future__ import annotations

import dataclasses
import inspect
import math
import sys
from collections.abc import Callable, Iterator
from typing import Any, get_type_hints

from qrsim.control.contracts import Controller, Guidance
from qrsim.core.tree import INFO, FieldInfo, field_info
from qrsim.errors import nearest
from qrsim.models.atmosphere.contracts import (
    GUST_READS,
    TURBULENCE_READS,
    UPDRAFT_READS,
    WIND_READS,
    Gust,
    Turbulence,
    Updraft,
    Wind,
)
from qrsim.models.gnss.contracts import RangeErrors
from qrsim.models.gnss.orbits import Ephemeris
from qrsim.models.scene.contracts import Area, Ground, Placement
from qrsim.models.sensors.contracts import SCENE, Sensor
from qrsim.models.vehicles.contracts import AROUND, Battery, Vehicle
from qrsim.scenarios import catalogue
from qrsim.scenarios.class_attributes import attribute_type_problems, is_record
from qrsim.tasks.contracts import Task

CONTRACTS: dict[str, type] = {
    "sensor": Sensor,
    "vehicle": Vehicle,
    "wind": Wind,
    "turbulence": Turbulence,
    "gust": Gust,
    "updraft": Updraft,
    "sky": RangeErrors,
    "orbits": Ephemeris,
    "controller": Controller,
    "guidance": Guidance,
    "battery": Battery,
    "area": Area,
    "ground": Ground,
    "placement": Placement,
    "task": Task,
}
# What is called of kinds without a contract, with the arguments.
CALLS: dict[str, dict[str, tuple[str, ...]]] = {
    "estimator": {"init": ("reading",), "step": ("reading", "memory")},
    "metric": {
        "init": ("world", "state"),
        "update": ("memory", "world", "state", "tick"),
        "finish": ("memory", "world", "state"),
    },
}
# Of these an object is made without arguments, and what it is made of is its own affair.
PLAIN = ("estimator", "metric")
# What a method is handed by name, and what in its class asks for it.
_HANDED = {
    "wind": "sees_wind",
    "others_ned": "sees_others",
    "on_ground": "sees_ground",
    "velocity_ned": "sees_motion",
    "dt": "sees_motion",
}
# What may be named in ``reads``.
READABLE = {
    "sensor": SCENE,
    "vehicle": AROUND,
    "wind": WIND_READS,
    "turbulence": TURBULENCE_READS,
    "gust": GUST_READS,
    "updraft": UPDRAFT_READS,
}


def conformity_problem(kind: str, component: object) -> str | None:
    """Return a sentence for a class's first error as a component of a kind (such as "sensor"), None if it conforms."""
    if not isinstance(component, type):
        return f"expected a class, found {component!r:.100}"
    checks = [_method_problems] if kind in PLAIN else [_record_problems, _field_problems, _method_problems]
    for check in checks:
        for problem in check(kind, component):
            return f"{file_of_class(component)}: {problem}"
    _complete(kind, component)
    return None


def file_of_class(component: type) -> str:
    """Return the file that defines a class, or its module if there is no file."""
    return getattr(sys.modules.get(component.__module__), "__file__", None) or component.__module__


def _record_problems(kind: str, component: type) -> Iterator[str]:
    """Yield an error if a component's class is not a record (a frozen dataclass and PyTree)."""
    if not is_record(component):
        yield f"class {component.__name__} is no record; write @qrsim.record above it"


def _field_problems(kind: str, component: type, prefix: str = "") -> Iterator[str]:
    """Yield the errors in a component's fields: missing unit or doc, bad name or default; ``prefix``: of nested."""
    name = component.__name__
    try:
        hints = get_type_hints(component)
    except Exception as error:
        yield f"class {name}: its annotations cannot be read: {error}"
        return
    for field in dataclasses.fields(component):
        title, info = f"{name}.{prefix}{field.name}", field_info(field)
        if info.derived:
            continue
        if INFO not in field.metadata:
            yield f"{title} has no unit; expected {field.name}: ... = qrsim.parameter(default, unit=..., doc=...)"
        elif field.name == "type":
            yield f"{title}: 'type' is the key that names the component in a scenario; choose another name"
        elif dataclasses.is_dataclass(field.default) and not isinstance(field.default, type):
            yield from _field_problems(kind, type(field.default), f"{prefix}{field.name}.")
        elif not info.unit and (not info.static or hints[field.name] is float):
            yield f"{title} has no unit; expected one such as unit='m', or '1' for a plain number"
        elif not info.doc:
            yield f"{title} has no doc; expected one sentence that describes it"
        else:
            yield from _default_problems(title, field, info, hints[field.name])


def _default_problems(title: str, field: dataclasses.Field[Any], info: FieldInfo, hint: object) -> Iterator[str]:
    """Yield the errors in the default of a component's field: its type, and its own bounds."""
    default = field.default
    if field.default_factory is not dataclasses.MISSING:
        yield f"{title}: a default_factory has no place in a schema; give a number as its default"
    elif default is dataclasses.MISSING or (default is None and (info.inherits or info.nullable)):
        return
    elif not info.static and (isinstance(default, bool) or not isinstance(default, int | float)):
        yield f"{title}: its default is {default!r:.60}; expected a number"
    elif not info.static and not math.isfinite(default):
        yield f"{title}: its default is {default!r}; expected a finite number"
    elif not info.static:
        low, high, above = info.minimum, info.maximum, info.above
        if (low is not None and default < low) or (high is not None and default > high):
            yield f"{title}: its default {default:g} is outside its own bounds"
        if above is not None and default <= above:
            yield f"{title}: its default {default:g} is outside its own bounds"


def _method_problems(kind: str, component: type) -> Iterator[str]:
    """Yield the methods and attributes of its kind that a class lacks, and methods with a wrong signature."""
    yield from _attribute_problems(kind, component)
    for name, positional, named in _calls(kind, component):
        arguments = (*positional, *(f"{key}=..." for key in named))
        method = getattr(component, name, None)
        if not callable(method) or getattr(method, "__isabstractmethod__", False):
            yield (
                f"class {component.__name__} lacks the method {name}({', '.join(arguments)}) that {_a(kind)} "
                f"has{_meant(component, name, method=True)}"
            )
            continue
        # What belongs to the class is called without an object.
        free = isinstance(inspect.getattr_static(component, name), staticmethod | classmethod)
        owner = () if free else (None,)
        try:
            signature = inspect.signature(method)
        except (TypeError, ValueError):
            continue
        try:
            if positional != ["..."]:
                signature.bind(*owner, *positional, **dict.fromkeys(named))
        except TypeError:
            takes = f"({', '.join(map(_shown, list(signature.parameters.values())[len(owner) :]))})"
            yield (
                f"{component.__name__}.{name} takes {takes}; expected ({', '.join(arguments)}), with which "
                f"{_a(kind)} is called"
            )
    for name in sorted(getattr(component, "__abstractmethods__", ())):
        yield f"class {component.__name__} lacks '{name}', which is abstract in a class that it inherits from"


def _a(kind: str) -> str:
    """Return the name of a kind with its article: "a sensor", "an area"."""
    return f"{'an' if kind[0] in 'aeou' else 'a'} {kind}"


def _shown(part: inspect.Parameter) -> str:
    """Return a parameter of a signature as text for a message, with "=..." for a default."""
    stars = "*" if part.kind is part.VAR_POSITIONAL else "**" if part.kind is part.VAR_KEYWORD else ""
    return f"{stars}{part.name}" + ("" if part.default is part.empty else "=...")


def _attribute_problems(kind: str, component: type) -> Iterator[str]:
    """Yield the class attributes of its kind that a class lacks, wrong ones, and unknown names in ``reads``."""
    contract = CONTRACTS.get(kind)
    fields = getattr(component, "__dataclass_fields__", {})
    for name in getattr(contract, "__annotations__", {}):
        if not hasattr(contract, name) and name not in fields and not hasattr(component, name):
            yield (
                f"class {component.__name__} lacks '{name}' that {_a(kind)} has (see {contract.__module__})"
                f"{_meant(component, name)}"
            )
    yield from attribute_type_problems(kind, component, contract)
    reads = _reads(component)
    if not isinstance(reads, tuple | list):
        yield f'{component.__name__}.reads is {reads!r:.60}; expected a tuple of names, as ("position_ned",)'
        return
    for name in reads if kind in READABLE else ():
        if name not in READABLE[kind]:
            match = nearest(name, READABLE[kind])
            hint = f"did you mean '{match}'?" if match else f"allowed: {', '.join(READABLE[kind])}"
            yield f"{component.__name__}.reads names '{name}', which {_a(kind)} cannot read; {hint}"


def _calls(kind: str, component: type) -> Iterator[tuple[str, list[str], list[str]]]:
    """Yield (method, positional arguments, named arguments) of each method of a kind; "..." for unknown arguments."""
    contract = CONTRACTS.get(kind)
    if contract is None:
        for name, arguments in CALLS.get(kind, {}).items():
            yield name, list(arguments), []
        for name in () if kind in CALLS else _common(kind):
            yield name, ["..."], []
        return
    for name, function in vars(contract).items():
        if not inspect.isfunction(function) or name.startswith("_"):
            continue
        if not getattr(function, "__isabstractmethod__", False) and name not in vars(component):
            continue
        yield name, *_arguments(component, function)


def _arguments(component: object, function: Callable[..., object]) -> tuple[list[str], list[str]]:
    """Return the names of a method's positional and named arguments."""
    positional: list[str] = []
    named: list[str] = []
    for part in list(inspect.signature(function).parameters.values())[1:]:
        if part.kind is part.VAR_KEYWORD:
            named += _reads(component)
        elif part.kind is part.VAR_POSITIONAL:
            continue
        elif part.default is part.empty or (part.name == "around" and bool(_reads(component))):
            positional.append(part.name)
        elif getattr(component, _HANDED.get(part.name, ""), False):
            named.append(part.name)
    return positional, named


def _reads(component: object) -> tuple[str, ...]:
    """Return the class attribute ``reads`` (quantities that the component needs); () if it is a property."""
    reads = getattr(component, "reads", ())
    return () if isinstance(reads, property) else reads


def _common(kind: str) -> list[str]:
    """Return the sorted names of public methods that all built-in components of a kind share."""
    built_in = [known for known in catalogue.KINDS[kind].values() if known.__module__.startswith("qrsim.")]
    methods = [
        {name for name in dir(known) if not name.startswith("_") and callable(getattr(known, name))}
        for known in built_in
    ]
    return sorted(set.intersection(*methods)) if methods else []


def _meant(component: type, name: str, method: bool = False) -> str:
    """Return a "did you mean" hint: the class's own attribute (``method``: method) nearest to a missing name; or ""."""
    own = [
        known
        for known, value in vars(component).items()
        if not known.startswith("_") and (callable(value) or not method)
    ]
    match = nearest(name, own)
    return f"; did you mean that by '{match}'?" if match else ""


def _complete(kind: str, component: type) -> None:
    """Add to a component class, in place, default methods of its kind's contract that the class lacks."""
    contract = CONTRACTS.get(kind)
    if contract is None or contract in component.__mro__:
        return
    fields = getattr(component, "__dataclass_fields__", {})
    for name, value in vars(contract).items():
        required = getattr(value, "__isabstractmethod__", False)
        if not name.startswith("_") and not required and name not in fields and not hasattr(component, name):
            setattr(component, name, value)
