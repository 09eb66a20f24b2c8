"""Pydantic schemas of components, generated from the fields of their records."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal, get_type_hints

from pydantic import (
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    create_model,
    model_validator,
)
from pydantic_core import core_schema

from qrsim.core.presets import filled, presets_of
from qrsim.core.tree import FieldInfo, field_info
from qrsim.files import Content

Finite = Annotated[float, Field(allow_inf_nan=False, strict=True)]
# Types that stand for nothing: who gives a parameter means another one.
WITHOUT_PARAMETERS = ("calm", "still", "none", "clear", "given")


def _add_degrees(schema: Content) -> None:
    """Extend a JSON schema, in place, so that every angle ``x_rad`` may be given in degrees as ``x_deg``."""
    properties = schema.get("properties", {})
    for name in [name for name in properties if name.endswith("_rad")]:
        twin = name.removesuffix("_rad") + "_deg"
        properties[twin] = {"type": "number", "description": f"{name} in degrees; give one of the two"}
        if name in schema.get("required", []):
            schema["required"].remove(name)


def _radians(degrees: object) -> object:
    """Convert degrees to radians, also in lists; values of other types are returned unchanged."""
    if isinstance(degrees, list):
        return [_radians(entry) for entry in degrees]
    if isinstance(degrees, bool) or not isinstance(degrees, int | float):
        return degrees
    try:
        return math.radians(degrees)
    except OverflowError:
        return math.inf


def with_default_types(model: type[BaseModel], data: Mapping[str, object]) -> Content:
    """Return a copy of scenario data; components without a type get the field's default type, if it has parameters."""
    found = dict(data)
    for name, field in model.model_fields.items():
        given, default = found.get(name), field.default
        if isinstance(given, dict) and "type" not in given and isinstance(default, dict):
            kind = default.get("type", "none")
            if kind not in WITHOUT_PARAMETERS:
                found[name] = {"type": kind, **given}
    return found


class Strict(BaseModel):
    """Base of every part of a scenario: unknown keys are refused, nothing is coerced, angles may be in degrees."""

    model_config = ConfigDict(extra="forbid", frozen=True, json_schema_extra=_add_degrees)

    @model_validator(mode="before")
    @classmethod
    def _degrees_to_radians(cls, data: object) -> object:
        """Convert each ``x_deg`` in the data to ``x_rad``; refuse data that give both."""
        if not isinstance(data, dict):
            return data
        converted = with_default_types(cls, data)
        for name in cls.model_fields:
            twin = name.removesuffix("_rad") + "_deg"
            if name.endswith("_rad") and twin in converted:
                if name in converted:
                    raise ValueError(f"gives both '{name}' and '{twin}'; give one")
                converted[name] = _radians(converted.pop(twin))
        return converted


def _bounds(info: FieldInfo) -> Content:
    """Return a parameter's bounds as pydantic's keyword arguments ge, le, gt."""
    bounds = {"ge": info.minimum, "le": info.maximum, "gt": info.above}
    return {name: bound for name, bound in bounds.items() if bound is not None}


def _described(info: FieldInfo) -> Content:
    """Return a parameter's description and unit as pydantic's keyword arguments."""
    inherited = f" (default: that of {info.inherits})" if info.inherits else ""
    inherited = " (default: that of the sensors)" if info.of_sensors else inherited
    return {"description": info.doc + inherited, "json_schema_extra": {"unit": info.unit}}


def _optional(info: FieldInfo) -> bool:
    """Return whether a parameter may be null in a scenario, to be filled in from another part of it."""
    return bool(info.inherits) or info.nullable or info.of_sensors


def _one_or_each(value: object) -> str:
    """Return the union tag of a parameter's value: "each" for a list with one number per vehicle, else "one"."""
    return "each" if isinstance(value, list) else "one"


# A name, or a list of names.
_Name = Annotated[str, Field(min_length=1)]
_ONE_OR_SEVERAL = Annotated[
    Annotated[_Name, Tag("one")] | Annotated[list[_Name], Field(min_length=1, max_length=400), Tag("each")],
    Discriminator(_one_or_each),
]


def _for_each(info: FieldInfo) -> object:
    """Return the pydantic annotation of a fleet's parameter: a number for all vehicles, or a list with one for each."""
    number = Annotated[float, Field(allow_inf_nan=False, strict=True, **_bounds(info))]
    entry = number | None if _optional(info) else number
    return Annotated[
        Annotated[entry, Tag("one")] | Annotated[list[number], Tag("each")],
        Discriminator(_one_or_each),
        _Numbers(info),
    ]


@dataclasses.dataclass(frozen=True)
class _Numbers:
    """What pydantic makes of ``_for_each``, at once: there are hundreds, and every command waits for them."""

    info: FieldInfo

    def __get_pydantic_core_schema__(self, source: object, handler: object) -> core_schema.CoreSchema:
        number = core_schema.float_schema(strict=True, allow_inf_nan=False, **_bounds(self.info))
        one = core_schema.nullable_schema(number) if _optional(self.info) else number
        return core_schema.tagged_union_schema(
            {"one": one, "each": core_schema.list_schema(number)}, discriminator=_one_or_each
        )


def _field(name: str, hint: object, field: dataclasses.Field[object], each: bool) -> tuple[object, object]:
    """Return pydantic annotation and field of a component's dataclass field; ``each``: one number per vehicle too."""
    info = field_info(field)
    annotation: Any
    required = field.default is dataclasses.MISSING
    usual = None if info.of_sensors else field.default
    if dataclasses.is_dataclass(field.default):
        nested = component_model(type(field.default).__name__, type(field.default), tagged=False, each=each)
        return nested, Field(default_factory=nested, **_described(info))
    if each and not info.static:
        return _for_each(info), Field(... if required else usual, **_described(info))
    if hint == str | tuple[str, ...]:
        annotation = _ONE_OR_SEVERAL
    elif info.static:
        constraints = Field(strict=True, allow_inf_nan=False) if hint is float else Field(strict=True)
        annotation = Annotated[hint, constraints] if hint in (float, int, bool) else hint
    elif info.length:
        entry = Annotated[float, Field(allow_inf_nan=False, strict=True, **_bounds(info))]
        vector = Annotated[list[entry], Field(min_length=info.length, max_length=info.length)]
        default = ... if required else field.default
        return vector | None if info.nullable else vector, Field(default, **_described(info))
    else:
        annotation = Finite
    if _optional(info):
        annotation = annotation | None
    return annotation, Field(... if required else usual, **_bounds(info), **_described(info))


def component_model(
    name: str,
    component: type,
    *,
    tagged: bool = True,
    each: bool = False,
    arrays: Mapping[str, object] | None = None,
    base: type[Strict] = Strict,
    more: Mapping[str, object] | None = None,
) -> type[Strict]:
    """Make the pydantic model of a component class; ``each``: numbers may be lists with one for each vehicle.

    Args:
        name: its name in the catalogue.
        component: a record class whose fields carry metadata.
        tagged: whether a scenario names it by a ``type`` key.
        each: whether it belongs to a fleet, so that a number may be a list with one entry for each vehicle.
        arrays: what a scenario writes in place of the component's arrays, which are its fields without a default.
        base: class of the schema.
        more: what a scenario says of every component of this kind, as it does of none of its own fields.
    """
    hints = get_type_hints(component)
    fields: dict[str, Any] = {}
    if tagged:
        fields["type"] = (Literal[name], Field(description="what it is"))
    fields |= arrays or {}
    for field in dataclasses.fields(component):
        if field_info(field).derived:
            continue
        if arrays is None or field.default is not dataclasses.MISSING:
            fields[field.name] = _field(field.name, hints[field.name], field, each)
    fields |= {key: field for key, field in (more or {}).items() if key not in fields}
    presets = presets_of(component)
    if presets:
        base = _preset_base(base, presets)
    doc = (component.__doc__ or "").split("\n\n")[0].strip()
    return create_model(name, __base__=base, __doc__=doc, **fields)


def _preset_base(base: type[Strict], presets: Mapping[str, Mapping[str, object]]) -> type[Strict]:
    """Return a pydantic base class that fills in missing parameters from the preset that ``preset`` names."""

    class Preset(base):  # type: ignore[misc, valid-type]
        @model_validator(mode="before")
        @classmethod
        def _of_the_preset(cls, data: Any) -> object:
            """Return the data with missing parameters filled in from the preset that they name."""
            name = data.get("preset", cls.model_fields["preset"].default) if isinstance(data, dict) else None
            if not isinstance(name, str) or name not in presets:
                return data
            twins = {key.removesuffix("_deg") + "_rad" for key in data if key.endswith("_deg")}
            return filled({key: value for key, value in presets[name].items() if key not in twins}, data)

    return Preset
