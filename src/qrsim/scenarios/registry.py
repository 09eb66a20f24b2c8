"""Components from outside: registered by a program, by an installed package, or named by a scenario as code.

A class that is taken in is in the catalogue like every other, under the text by which a scenario names it, and the
schema of scenarios is made anew. Nothing is looked for or loaded before a scenario names what is not built in.
"""

from __future__ import annotations

import inspect
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from qrsim.errors import UsageError, did_you_mean
from qrsim.files import code
from qrsim.scenarios import catalogue, schema
from qrsim.scenarios.conformity import conformity_problem

GROUP = "qrsim.components"
_LOCK = threading.RLock()


@dataclass(frozen=True)
class Origin:
    """Origin of a component from outside.

    Attributes:
        how: "registered", "package" or "scenario".
        place: file and line, or distribution, version and object, or file and digest.
        module: name of the module that holds the class.
        file: its file, "" where it has none.
        sha256: of the file when the class was taken in, "" where it has none.
    """

    how: str
    place: str
    module: str = ""
    file: str = ""
    sha256: str = ""


_BUILT_IN = {kind: dict(group) for kind, group in catalogue.KINDS.items()}
_ORIGINS: dict[tuple[str, str], Origin] = {}


def register(kind: str, name: str, component: type) -> type:
    """Register a component class of a kind (such as "sensor") under a name for scenarios; return the class.

    Args:
        kind: what it is: "sensor", "vehicle", "wind", ... (see docs/howto/own_component.md).
        name: what a scenario calls it.
        component: a record that has what its kind has.

    Raises:
        UsageError: no such kind, no name, another component has the name, or the class is no such component.

    Examples:
        >>> qrsim.register("sensor", "laser", Laser)
    """
    _check_kind(kind)
    if not isinstance(name, str) or not name or code.is_code(name) or name != name.strip():
        raise UsageError(f"register: {name!r} is no name of a component; expected for example 'laser'")
    _check_class(kind, component, f"register: {kind} '{name}'")
    origin = _origin("registered", component)
    with _LOCK:
        _refuse_second(kind, name, component, origin)
        _take_in(kind, name, component, origin)
    return component


def provide(kind: str, name: str) -> bool:
    """Load a component from a package or file if the catalogue lacks it; return whether the catalogue then has it.

    Args:
        kind: what is expected.
        name: a name, ``module:Class`` or ``file.py:Class`` with an absolute path.

    Raises:
        UsageError: it cannot be loaded, or is no such component.
    """
    group = catalogue.KINDS[kind]
    if name in _BUILT_IN[kind]:
        return True
    with _LOCK:
        if code.is_code(name):
            known = _ORIGINS.get((kind, name))
            # A file may have changed; a class that was given as an object has nothing to be loaded from.
            if known is None or (known.how == "scenario" and code.file_of(name)):
                _load(kind, name)
        elif name not in group:
            _load_entry_point(kind, name)
    return name in group


def outside_names(kind: str) -> list[str]:
    """Return the names of the registered components of a kind that are not built in."""
    return [name for name in catalogue.KINDS[kind] if name not in _BUILT_IN[kind]]


def made(kind: str, source: object) -> Any:
    """Return an estimator or metrics object: an instance of the class that a name or path gives, or ``source`` itself.

    Args:
        kind: estimator or metric.
        source: a registered name, the name of a package's entry point, ``module:name`` or ``file.py:name``; or the
            object itself. A class is called without arguments. An estimator may also be a function.

    Raises:
        UsageError: unknown name, one that cannot be loaded, or an object of another kind.
    """
    found = source if not isinstance(source, str) else None
    if found is None and isinstance(source, str) and not code.is_code(source) and provide(kind, source):
        found = catalogue.KINDS[kind][source]
    if found is None and isinstance(source, str):
        found = code.load_object(kind, source, outside_names(kind))
    if not isinstance(found, type):
        if kind == "metric" and found is not None:
            _check_class(kind, type(found), kind)
        return found
    _check_class(kind, found, kind)
    try:
        return found()
    except Exception as error:
        name = source if isinstance(source, str) else found.__name__
        raise UsageError(f"{kind} {name}: made without arguments it fails: {code.in_one_line(error)}") from error


def built_in_names(kind: str) -> list[str]:
    """Return the names of the built-in components of a kind."""
    return list(_BUILT_IN[kind])


def any_outside() -> bool:
    """Return whether any component that is not built in is registered."""
    return bool(_ORIGINS)


def is_outside(kind: str, name: str) -> bool:
    """Return whether a component of the catalogue is not built in."""
    return name not in _BUILT_IN[kind]


def origin_of(kind: str, name: str) -> Origin:
    """Return where a component of the catalogue comes from: built in, a package, a file or a call."""
    if not is_outside(kind, name):
        return Origin("built in", catalogue.KINDS[kind][name].__module__)
    return _ORIGINS[kind, name]


def name_of(kind: str, component: type) -> str:
    """Return a class's name in the catalogue; an unknown class is registered as "module:Class".

    Raises:
        UsageError: it is no component of this kind.
    """
    for name, known in catalogue.KINDS[kind].items():
        if known is component:
            return name
    name = f"{component.__module__}:{component.__qualname__}"
    _check_class(kind, component, name)
    with _LOCK:
        _take_in(kind, name, component, _origin("object", component))
    return name


def packaged() -> Iterator[tuple[str, str, metadata.EntryPoint]]:
    """Yield (kind, name, entry point) of all components that installed packages offer, without loading any.

    Raises:
        UsageError: a package offers a kind that does not exist, a built-in name, or two the same.
    """
    seen: dict[tuple[str, str], str] = {}
    for point in metadata.entry_points(group=GROUP):
        kind, dot, name = point.name.partition(".")
        place = _place_of(point)
        if not dot or not name:
            raise UsageError(
                f"entry point '{point.name}' of {place}: expected KIND.NAME, for example sensor.laser, in {GROUP}"
            )
        _check_kind(kind, f"entry point '{point.name}' of {place}")
        if name in _BUILT_IN[kind]:
            raise UsageError(f"entry point '{point.name}' of {place}: '{name}' is the name of a built-in {kind}")
        if seen.get((kind, name), place) != place:
            raise UsageError(f"{kind} '{name}' is registered twice: by {seen[kind, name]} and by {place}")
        seen[kind, name] = place
        yield kind, name, point


def components() -> list[dict[str, str]]:
    """Return a dict with kind, name, class and origin of every component: built in, registered, or in packages.

    Raises:
        UsageError: as ``packaged``.
    """
    rows = []
    offered = {(kind, name): point for kind, name, point in packaged()}
    for kind, group in catalogue.KINDS.items():
        for name, component in group.items():
            origin = origin_of(kind, name)
            title = f"{component.__module__}:{component.__qualname__}"
            rows.append({"kind": kind, "name": name, "class": title, "from": f"{origin.how}: {origin.place}"})
        for (other, name), point in offered.items():
            if other == kind and name not in group:
                rows.append({"kind": kind, "name": name, "class": point.value, "from": f"package: {_place_of(point)}"})
    return rows


def _check_kind(kind: object, what: str = "register") -> None:
    """Raise UsageError for a kind of component that does not exist; the message begins with ``what``."""
    if kind not in catalogue.KINDS:
        raise UsageError(f"{what}: no kind of component is called {kind!r}{did_you_mean(str(kind), catalogue.KINDS)}")


def _check_class(kind: str, component: object, what: str) -> None:
    """Raise UsageError, which begins with ``what``, if a class does not conform to its kind."""
    problem = conformity_problem(kind, component)
    if problem:
        raise UsageError(f"{what}: {problem}")


def _take_in(kind: str, name: str, component: type, origin: Origin) -> None:
    """Add a component class to catalogue and schema; raises UsageError, with no change, if it can have no schema."""
    if code.is_code(name):
        code.taken_in(component.__module__, provide, kind, name)
    group = catalogue.KINDS[kind]
    before = group.get(name)
    group[name] = component
    try:
        schema.refresh(kind, name)
    except Exception as error:
        # A class that has no schema must not spoil the scenarios that follow.
        group.pop(name) if before is None else group.update({name: before})
        schema.refresh(kind)
        said = code.in_one_line(error)
        raise UsageError(
            f"{origin.file or origin.module}: class {component.__name__} has no schema: {said}; expected numbers "
            "(qrsim.parameter), and settings that are numbers, texts, bools or a typing.Literal"
        ) from error
    _ORIGINS[kind, name] = origin


def _refuse_second(kind: str, name: str, component: type, origin: Origin) -> None:
    """Raise UsageError if a name is built in or is that of another class; a reloaded class may replace its old one."""
    if name in _BUILT_IN[kind]:
        built_in = _BUILT_IN[kind][name]
        raise UsageError(
            f"register: {kind} '{name}' is registered twice: it is the built-in {built_in.__module__}:"
            f"{built_in.__qualname__}, and {component.__qualname__} of {origin.place}; choose another name"
        )
    before = catalogue.KINDS[kind].get(name)
    # A cell of a notebook is run again, a module is loaded again: the newer class counts.
    if before is None or (before.__module__, before.__qualname__) == (component.__module__, component.__qualname__):
        return
    raise UsageError(
        f"register: {kind} '{name}' is registered twice: {before.__qualname__} of {_ORIGINS[kind, name].place}, and "
        f"{component.__qualname__} of {origin.place}"
    )


def _origin(how: str, component: type, place: str = "") -> Origin:
    """Return how a component class was found (``how``), its place, module, file, and digest of the file."""
    module = sys.modules.get(component.__module__)
    file = getattr(module, "__file__", None) or ""
    if not place:
        try:
            place = f"{inspect.getsourcefile(component)}, line {inspect.getsourcelines(component)[1]}"
        except (OSError, TypeError):
            place = component.__module__
    content = code.digest(Path(file)) if file and Path(file).is_file() else ""
    return Origin(how, place, component.__module__, file, content)


def _load(kind: str, name: str) -> None:
    """Load a component class from ``module:Class`` or ``file.py:Class`` and register it under this name."""
    component = code.load_object(kind, name, kind="Class")
    if catalogue.KINDS[kind].get(name) is component:
        return
    _check_class(kind, component, kind if isinstance(component, type) else f"{kind} {name}")
    _take_in(kind, name, component, _origin("scenario", component))


def _load_entry_point(kind: str, name: str) -> None:
    """Load and register the component that an installed package offers under a name, if any."""
    for other, offered, point in packaged():
        if (other, offered) == (kind, name):
            place = _place_of(point)
            try:
                component = point.load()
            except Exception as error:
                files = [getattr(sys.modules.get(point.module), "__file__", "") or ""]
                where = code.where_raised(error, files)
                raise UsageError(
                    f"{kind} '{name}' of {place}: importing it failed: {code.in_one_line(error)}"
                    + (f" ({where})" if where else "")
                ) from error
            _check_class(kind, component, f"{kind} '{name}' of {place}")
            _take_in(kind, name, component, _origin("package", component, place))


def _place_of(point: metadata.EntryPoint) -> str:
    """Return package, version and object of an entry point as text."""
    found = point.dist
    return f"{found.metadata['Name']} {found.version} ({point.value})" if found else point.value
