"""Turns pydantic's findings into sentences: path in the file, value, what was allowed, nearest name."""

from __future__ import annotations

import math
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from qrsim.errors import did_you_mean


def describe(error: ValidationError, model: type[BaseModel], data: Any) -> list[str]:
    """Return one sentence per fault, in the order of the schema."""
    return [_Fault(details, model, data).sentence() for details in error.errors()]


class _Fault:
    """One fault, with its place found again in the data and in the schema."""

    def __init__(self, details: ErrorDetails, model: type[BaseModel], data: Any):
        self.details = details
        self.path: list[str] = []
        self.owner: type[BaseModel] | None = model
        self.owner_name = "scenario"
        self.field: FieldInfo | None = None
        self.in_degrees = False
        self._locate(model, data)

    def _locate(self, model: type[BaseModel], data: Any) -> None:
        annotation: Any = model
        for part in self.details["loc"]:
            if isinstance(data, dict) and part == data.get("type") and part not in self._names(annotation):
                annotation = self._choose(annotation, part)
                self.owner, self.owner_name = annotation, str(part)
                continue
            chosen = self._choose(annotation, data.get("type") if isinstance(data, dict) else None)
            if chosen is not None:
                self.owner = chosen
                self.owner_name = self.owner_name if chosen.__name__ == self.owner_name else self._label(chosen)
                self.field = chosen.model_fields.get(str(part))
                annotation = self.field.annotation if self.field else None
            else:
                self.owner, self.field = None, None
                annotation = (get_args(annotation) or (None,))[-1]
            data = self._descend(part, data)

    def _descend(self, part: Any, data: Any) -> Any:
        name = str(part)
        if isinstance(data, dict):
            twin = name.removesuffix("_rad") + "_deg"
            if name.endswith("_rad") and name not in data and twin in data:
                self.in_degrees, name = True, twin
            self.path.append(name)
            return data.get(name)
        self.path.append(name)
        return data[part] if isinstance(data, list) and isinstance(part, int) and part < len(data) else None

    @staticmethod
    def _models(annotation: Any) -> list[type[BaseModel]]:
        if isinstance(annotation, type) and issubclass(annotation, BaseModel):
            return [annotation]
        if getattr(annotation, "__origin__", None) in (dict, list):
            return []
        return [model for argument in get_args(annotation) for model in _Fault._models(argument)]

    @staticmethod
    def _choose(annotation: Any, tag: Any) -> type[BaseModel] | None:
        models = _Fault._models(annotation)
        if len(models) == 1:
            return models[0]
        return next((model for model in models if model.__name__ == tag), None)

    @staticmethod
    def _names(annotation: Any) -> set[str]:
        models = _Fault._models(annotation)
        return set(models[0].model_fields) if len(models) == 1 else set()

    @staticmethod
    def _label(model: type[BaseModel]) -> str:
        return model.__name__.removesuffix("Spec").lower() or "scenario"

    def sentence(self) -> str:
        """Return the fault in words."""
        kind, where = self.details["type"], ".".join(self.path) or "scenario"
        value = self.details["input"]
        context = self.details.get("ctx", {})
        if kind == "extra_forbidden":
            names = self._known_names()
            return f"{where}: no such parameter of '{self.owner_name}'{did_you_mean(self.path[-1], names)}"
        if kind == "missing":
            return f"{where}: missing{self._meaning()}"
        if kind == "union_tag_invalid":
            known = [name.strip(" '") for name in str(context["expected_tags"]).split(",")]
            return f"{where}.type: no such type '{context['tag']}'{did_you_mean(str(context['tag']), known)}"
        if kind == "union_tag_not_found":
            return f"{where}.type: missing; it names what this is"
        if kind == "literal_error":
            allowed = [name.strip(" '") for name in str(context["expected"]).replace(" or ", ",").split(",")]
            if len(allowed) == 1:
                return f"{where}: {value!r} is not allowed; allowed: {allowed[0]}"
            return f"{where}: {value!r} is not allowed; allowed: {', '.join(allowed)}{self._near(value, allowed)}"
        return f"{where}: {self._shown(value)} {self._fault(kind)}"

    @staticmethod
    def _near(value: Any, allowed: list[str]) -> str:
        hint = did_you_mean(str(value), allowed)
        return hint if "did you mean" in hint else ""

    def _known_names(self) -> list[str]:
        names = [name for name in (self.owner.model_fields if self.owner else {}) if name != "type"]
        twins = [name.removesuffix("_rad") + "_deg" for name in names if name.endswith("_rad")]
        return names + twins

    def _fault(self, kind: str) -> str:
        if kind in ("greater_than_equal", "less_than_equal", "greater_than", "less_than"):
            return f"is out of range; allowed: {self._range()}{self._meaning()}"
        if kind == "finite_number":
            return f"is not a finite number{self._meaning()}"
        if kind in ("float_type", "float_parsing"):
            return f"is not a number{self._meaning()}"
        if kind == "value_error":
            return str(self.details["ctx"]["error"])
        return f"is not right: {self.details['msg'].lower()}{self._meaning()}"

    def _shown(self, value: Any) -> str:
        if self.in_degrees and isinstance(value, float):
            return f"{math.degrees(value):g}"
        if isinstance(value, dict):
            return "this part"
        text = repr(value)
        return text if len(text) <= 60 else f"{text[:57]}..."

    def _range(self) -> str:
        low, high, open_low = -math.inf, math.inf, False
        for rule in self.field.metadata if self.field else []:
            low = getattr(rule, "ge", low)
            high = getattr(rule, "le", high)
            if getattr(rule, "gt", None) is not None:
                low, open_low = rule.gt, True
        if self.in_degrees:
            low, high = math.degrees(low), math.degrees(high)
        if high == math.inf:
            return f"{'above' if open_low else 'at least'} {low:g}"
        if low == -math.inf:
            return f"at most {high:g}"
        return f"{'above ' if open_low else ''}{low:g} to {high:g}"

    def _meaning(self) -> str:
        if self.field is None or not self.field.description:
            return ""
        extra = self.field.json_schema_extra
        unit = str(extra.get("unit", "")) if isinstance(extra, dict) else ""
        unit = unit.replace("rad", "deg") if self.in_degrees else unit
        return f" ({self.field.description}{f', {unit}' if unit and unit != '1' else ''})"
