"""Presets of a component: named sets of its parameters, of which each that is given counts instead."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from typing import Any

from qrsim.errors import UsageError, did_you_mean

# Parameters by the name of a preset.
Presets = dict[str, dict[str, Any]]


def presets_of(cls: type) -> Mapping[str, Mapping[str, object]] | None:
    """Return a component class's presets, {name: {parameter: value}}; None for a class without presets."""
    return getattr(cls, "presets", None)


def with_presets(cls: Any) -> Any:
    """Return a dataclass, its constructor taking missing arguments from the preset ``preset`` if it has presets.

    Such a class has ``presets``, parameters by the preset's name, and a field ``preset``, which names one of them.

    For a part that is a record itself, a preset has a mapping with the parameters that differ. Such a part, if passed,
    is taken as it is. The schema of a scenario does the same (``scenarios/component_schema.py``), and fills such parts
    too.
    """
    presets = presets_of(cls)
    fields = {field.name: field for field in dataclasses.fields(cls) if field.init}
    if not presets or "preset" not in fields:
        return cls
    plain, usual = cls.__init__, fields["preset"].default

    @functools.wraps(plain)
    def completed(self: object, *args: Any, **given: Any) -> None:
        """Initialise the object from the given parameters, missing ones taken from its preset."""
        # JAX and dataclasses pass all fields when they rebuild a record; nothing is missing then.
        if len(args) + len(given) < len(fields):
            named = {*list(fields)[: len(args)], *given}
            chosen = dict(zip(fields, args, strict=False)).get("preset", given.get("preset", usual))
            if not isinstance(chosen, str) or chosen not in presets:
                raise UsageError(f"{cls.__name__}: no preset is called {chosen!r}{did_you_mean(str(chosen), presets)}")
            given |= {
                name: _preset_value(value, fields[name].default)
                for name, value in presets[chosen].items()
                if name not in named
            }
        plain(self, *args, **given)

    cls.__init__ = completed
    return cls


def filled(usual: Mapping[str, object], given: Mapping[str, Any]) -> dict[str, Any]:
    """Return ``given`` with missing entries taken from ``usual``, recursively in nested mappings."""
    both = {**usual, **given}
    for name, part in usual.items():
        if isinstance(part, Mapping) and isinstance(given.get(name), Mapping):
            both[name] = filled(part, given[name])
    return both


def _preset_value(value: Any, usual: Any) -> object:
    """Return a preset's parameter; a mapping is applied as changes to the record ``usual``."""
    return dataclasses.replace(usual, **value) if isinstance(value, Mapping) else value
