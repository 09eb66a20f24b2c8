"""Turns pydantic's findings into sentences: path in the file, value, what was allowed, nearest name."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from datetime import date
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel, Tag, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from qrsim.errors import MOST_PROBLEMS, did_you_mean
from qrsim.models.vehicles.multirotor.sets import SETS
from qrsim.scenarios.local import swapped_hint
from qrsim.scenarios.slots import Slot

_RANGES = ("greater_than_equal", "less_than_equal", "greater_than", "less_than")
_LENGTHS = ("too_short", "too_long")
_PARTS = ("model_type", "model_attributes_type", "dict_type")
# What other languages, and YAML before 1.2, have for true and false.
_OTHER_WORDS = dict.fromkeys(("yes", "y", "on", "1"), "true") | dict.fromkeys(("no", "n", "off", "0"), "false")
# A number with something behind it, as "7 m/s" and "6S".
_WITH_UNIT = re.compile(r"\s*[+-]?\d+(\.\d*)?\s*[^\d\s.,:_-]", re.ASCII)
_TIME = "write for example 2026-06-21T10:00:00Z"
# What is said after the value of a fault that needs nothing else to explain it.
_PLAIN = {
    "finite_number": "is not a finite number",
    "float_type": "is not a number",
    "int_type": "is not a whole number",
    "int_from_float": "is not a whole number",
    "int_parsing": "is not a whole number",
    "bool_type": "is neither true nor false",
    "string_type": "is not a text",
    "string_too_short": "is empty",
    "timezone_aware": f"has no offset from UTC; {_TIME}",
    "datetime_type": f"is not a date and time; {_TIME}",
    "datetime_parsing": f"is not a date and time; {_TIME}",
    "datetime_from_date_parsing": f"is not a date and time; {_TIME}",
    "datetime_object_invalid": f"is not a date and time; {_TIME}",
}


def describe(error: ValidationError, model: type[BaseModel], data: object) -> list[str]:
    """Return a sentence for each error of ``data`` validated by ``model``; past MOST_PROBLEMS in pydantic's words."""
    found = error.errors(include_url=False)
    told = [_Fault(details, model, data).sentence() for details in found[:MOST_PROBLEMS]]
    # To find the place and the nearest name of a hundred thousand takes many seconds, and nobody reads them.
    return told + [f"{'.'.join(map(str, rest['loc']))}: {rest['msg']}" for rest in found[MOST_PROBLEMS:]]


def component_types(model: type[BaseModel], path: list[str]) -> list[str]:
    """Return the types of component allowed at a path of a scenario; [] if no component belongs there."""
    annotation: Any = model
    for part in path:
        makers = _makers(annotation)
        if makers:
            # Of several components none is made, because each takes milliseconds.
            field = makers[0]().model_fields.get(part) if len(makers) == 1 else None
            annotation = field.annotation if field else None
        else:
            annotation = _entry(annotation)
    slot = _slot(annotation)
    if slot is not None:
        return slot.names() if slot.key == "type" else []
    return [part.__name__ for part in _models(annotation) if "type" in part.model_fields]


class _Fault:
    """One fault, with its place found again in the data and in the schema."""

    def __init__(self, details: ErrorDetails, model: type[BaseModel], data: object):
        self.details = details
        self.path: list[str] = []
        self.owner: type[BaseModel] | None = None
        self.owner_name = ""
        self.field: FieldInfo | None = None
        self.annotation: Any = model
        self.in_degrees = False
        # What the value is a part of.
        self.beside: Any = None
        self._locate(data)

    def _locate(self, data: object) -> None:
        """Follow the error's location through data and schema; set the path, owner, field and value for the message."""
        for part in self.details["loc"]:
            if part == "[key]":
                continue
            branch = _tagged(self.annotation, part)
            if branch is not None:
                # pydantic puts into the path whether one number is given or one for each vehicle; the file does not.
                self.annotation = branch
                continue
            models = _models(self.annotation)
            if len(models) > 1:
                # Likewise the type of a component.
                self.annotation = next(model for model in models if model.__name__ == part)
                continue
            if models:
                self.owner, self.owner_name = models[0], self._name_of(models[0])
                self.field = models[0].model_fields.get(str(part))
                self.annotation = self.field.annotation if self.field else None
            else:
                # An entry of a list or a mapping: what is said about the whole holds for it too.
                self.owner = None
                self.annotation = _entry(self.annotation)
            data = self._descend(part, data)

    def _name_of(self, model: type[BaseModel]) -> str:
        """Return the name of a pydantic model's part in scenarios: its type, its kind, or its field."""
        if model.__name__.endswith("Spec"):
            return re.sub(r"(?<!^)(?=[A-Z])", " ", model.__name__.removesuffix("Spec")).lower()
        if {"type", "kind"} & set(model.model_fields):
            return model.__name__
        return self.path[-1]

    def _descend(self, part: object, data: object) -> object:
        """Append the key ``part`` to the error's path; return the data there, None if it does not exist."""
        name, self.beside = str(part), data
        if isinstance(data, dict):
            twin = name.removesuffix("_rad") + "_deg"
            if name.endswith("_rad") and name not in data and twin in data:
                self.in_degrees, name = True, twin
            self.path.append(name)
            return data.get(name)
        self.path.append(name)
        return data[part] if isinstance(data, list) and isinstance(part, int) and part < len(data) else None

    def sentence(self) -> str:
        """Return the error as one sentence: path, what is wrong, allowed values and hints."""
        kind, where = self.details["type"], ".".join(self.path) or "scenario"
        value = self.details["input"]
        context = self.details.get("ctx", {})
        if kind == "extra_forbidden":
            hint = _as_model(value) if self.path[-1] == "model" else ""
            hint = hint or did_you_mean(self.path[-1], self._known())
            return f"{where}: no such parameter of '{self.owner_name}'{hint}"
        if kind == "missing":
            return f"{where}: missing{self._types() if self.path[-1] == 'type' else self._meaning() + self._twin()}"
        # Components are told apart by their types, what interferes with receivers by its kind.
        key = "kind" if context.get("discriminator") == "'kind'" else "type"
        if kind == "union_tag_not_found":
            return f"{where}.{key}: missing{self._types()}"
        if kind == "union_tag_invalid":
            known = [tag.strip().strip("'") for tag in context["expected_tags"].split(",")]
            tag = str(context["tag"])
            hint = (_as_model(tag) if "multirotor" in known else "") or did_you_mean(tag, known)
            return f"{where}.{key}: no such {key} '{tag}'{hint}"
        if kind == "literal_error":
            allowed = self._choices()
            if self.path[-1] == "type":
                return f"{where}: no such type {value!r}{did_you_mean(str(value), allowed)}"
            hint = did_you_mean(str(value), allowed)
            return f"{where}: {value!r} is not allowed; allowed: {', '.join(allowed)}{hint if 'mean' in hint else ''}"
        if kind == "value_error":
            return f"{where}: {context['error']}"
        if kind == "invalid_key" or self.details["loc"][-1:] == ("[key]",):
            return f"{where}: the key {value!r} is not a text"
        if kind in _PARTS:
            return (
                f"{where}: expected keys and values{self._example(value)}, found {self._shown(value)}{self._meaning()}"
            )
        if kind == "list_type":
            expected = self._length() if self._holds_numbers() else "a list"
            # "At most 3 numbers, found 2" would be no fault.
            expected = f"a list of {expected}" if expected.startswith("at most") else expected
            return f"{where}: expected {expected}, found {self._shown(value)}{self._meaning()}"
        if kind in _LENGTHS:
            return f"{where}: expected {self._length()}, found {len(value) or 'none'}{self._meaning()}"
        if value is None:
            return f"{where}: has no value{self._meaning()}"
        meant = _OTHER_WORDS.get(str(value).lower()) if kind == "bool_type" else None
        hint = f"; did you mean {meant}?" if meant else ""
        if kind in ("float_type", "int_type") and isinstance(value, str) and _WITH_UNIT.match(value):
            hint = "; write the number alone, without a unit"
        return f"{where}: {self._shown(value)} {self._fault(kind, context)}{self._meaning()}{hint}"

    def _fault(self, kind: str, context: Mapping[str, object]) -> str:
        """Return as text what is wrong with the value; ``kind`` and ``context`` are pydantic's error type and details.

        Args:
            kind: pydantic's type of error.
            context: numbers and words of that error, as pydantic has them.
        """
        if kind in _RANGES:
            return f"is out of range; allowed: {self._range()}{self._swapped()}"
        if kind == "string_pattern_mismatch":
            return f"is no name; allowed: {_characters(str(context['pattern']))}"
        if kind == "string_too_long":
            return f"is too long; allowed: at most {context['max_length']} characters"
        return _PLAIN.get(kind, f"is not right: {self.details['msg']}")

    def _swapped(self) -> str:
        """Return a hint that latitude and longitude are swapped; "" if they are not."""
        if self.path[-1] != "latitude_deg" or not isinstance(self.beside, dict):
            return ""
        return swapped_hint(self.details["input"], self.beside.get("longitude_deg"))

    def _known(self) -> list[str]:
        """Return the field names allowed in the mapping with the error, with those of angles in degrees."""
        names = [name for name in (self.owner.model_fields if self.owner else {}) if name != "type"]
        twins = [name.removesuffix("_rad") + "_deg" for name in names if name.endswith("_rad")]
        return names + twins

    def _choices(self) -> list[str]:
        """Return the values allowed where the error is: types of components, or options."""
        models = _models(self.annotation)
        return [model.__name__ for model in models] or [str(option) for option in get_args(_bare(self.annotation))]

    def _types(self) -> str:
        """Return a hint with the types of component allowed where the error is."""
        return f"; it names what this is: {', '.join(self._choices())}"

    def _twin(self) -> str:
        """Return a hint that the angle in radians may be given in degrees instead; "" for other fields."""
        name = self.path[-1]
        return f"; or give {name.removesuffix('_rad')}_deg in degrees" if name.endswith("_rad") else ""

    def _example(self, value: object) -> str:
        """Return a text that shows how to write a component, for one given by its type alone."""
        models = [model for model in _models(self.annotation) if "type" in model.model_fields]
        if not models or not isinstance(value, str):
            return ""
        names = [model.__name__ for model in models]
        return f" such as {{type: {value if value in names else names[0]}}}"

    def _shown(self, value: object) -> str:
        """Format the value for the message: at most 60 characters, an angle in degrees if given so."""
        if self.in_degrees and isinstance(value, float):
            return f"{math.degrees(value):g}"
        if value is None:
            return "nothing"
        if isinstance(value, dict):
            return "keys and values"
        text = str(value) if isinstance(value, date) else repr(value)
        return text if len(text) <= 60 else f"{text[:57]}..."

    def _rule(self, name: str) -> Any:
        """Return a bound (such as ``ge``) of the field, or of its list's entries; None without one."""
        rules = [*(self.field.metadata if self.field else []), *_rules(self.annotation)]
        found = [getattr(rule, name) for rule in rules if getattr(rule, name, None) is not None]
        return found[-1] if found else None

    def _holds_numbers(self) -> bool:
        """Return whether the entries of the field's list or mapping are numbers."""
        return _bare(_entry(self.annotation)) is float

    def _length(self) -> str:
        """Return the allowed number of entries of the field's list, in words."""
        low, high = self._rule("min_length"), self._rule("max_length")
        what = "numbers" if self._holds_numbers() else "entries"
        if low == high:
            return f"{low} {what}"
        if low is None or self.details["type"] == "too_long":
            return f"at most {high} {what}"
        return f"at least {low}"

    def _range(self) -> str:
        """Return the allowed range of the field's number, in words, in degrees if it was given so."""
        low, high, above = self._rule("ge"), self._rule("le"), self._rule("gt")
        if self.in_degrees:
            low, high, above = (None if bound is None else math.degrees(bound) for bound in (low, high, above))
        if above is not None:
            return f"above {_number(above)}{'' if high is None else f', at most {_number(high)}'}"
        if low is not None and high is not None:
            return f"{_number(low)} to {_number(high)}"
        return f"at least {_number(low)}" if low is not None else f"at most {_number(high)}"

    def _meaning(self) -> str:
        """Return the field's description and unit in brackets; "" without a description."""
        if self.field is None or not self.field.description:
            return ""
        extra = self.field.json_schema_extra
        unit = str(extra.get("unit", "")) if isinstance(extra, dict) else ""
        text = f"{self.field.description}{f', {unit}' if unit and unit != '1' else ''}"
        if self.in_degrees:
            text = text.removesuffix("rad") + "deg" if unit == "rad" else text.replace("[rad]", "[deg]")
        return f" ({text})"


def _as_model(name: object) -> str:
    """Return a hint how to choose a named parameter set of a multirotor; "" for other names."""
    return f"; write {{type: multirotor, model: {name}}}" if isinstance(name, str) and name in SETS else ""


def _number(value: float) -> str:
    """Format a bound as short text: 0.5, 1.5708, 10 000 000."""
    return f"{value:,.0f}".replace(",", " ") if 1e4 <= abs(value) < 1e12 else f"{value:g}"


def _characters(pattern: str) -> str:
    """Return in words which characters a regular expression such as ^[A-Za-z0-9][A-Za-z0-9_-]*$ allows."""
    match = re.fullmatch(r"\^\[A-Za-z0-9\]\[A-Za-z0-9(.*)\]\*\$", pattern)
    return f"letters, digits and any of {' '.join(match[1])}, a letter or digit first" if match else pattern


def _given(annotation: object) -> Any:
    """Return the type T of an annotation "T | None"; other annotations unchanged."""
    others = [part for part in get_args(annotation) if part is not type(None)]
    return others[0] if get_origin(annotation) in (Union, UnionType) and len(others) == 1 else annotation


def _bare(annotation: object) -> object:
    """Return a type annotation without its Annotated metadata and without None."""
    annotation = _given(annotation)
    return get_args(annotation)[0] if get_origin(annotation) is Annotated else annotation


def _tagged(annotation: object, tag: object) -> object:
    """Return the alternative of a union annotation that carries a tag; None without one."""
    for branch in get_args(_bare(annotation)):
        if any(isinstance(note, Tag) and note.tag == tag for note in get_args(branch)[1:]):
            return branch
    return None


def _entry(annotation: object) -> object:
    """Return the type of the entries of a list or mapping annotation; None for other annotations."""
    return (get_args(_bare(annotation)) or (None,))[-1]


def _rules(annotation: object) -> list[object]:
    """Return the constraints in the metadata of an Annotated type."""
    annotation = _given(annotation)
    if get_origin(annotation) is not Annotated:
        return []
    inner, *infos = get_args(annotation)
    own = [rule for info in infos for rule in (info.metadata if isinstance(info, FieldInfo) else [info])]
    return [*_rules(inner), *own]


def _slot(annotation: object) -> type[Slot] | None:
    """Return the ``Slot`` (place for a component) in an annotation; None without one."""
    bare = _bare(annotation)
    return bare if isinstance(bare, type) and issubclass(bare, Slot) else None


def _models(annotation: object) -> list[type[BaseModel]]:
    """Return the pydantic models that an annotation allows; [] for a number, a list or a mapping."""
    return [make() for make in _makers(annotation)]


def _makers(annotation: object) -> list[Callable[[], type[BaseModel]]]:
    """Return a function for each pydantic model that an annotation allows, which makes it, as in ``_models``."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [lambda: annotation]
    if slot := _slot(annotation):
        return list(slot.makers().values())
    if get_origin(annotation) in (dict, list):
        return []
    return [make for argument in get_args(annotation) for make in _makers(argument)]
