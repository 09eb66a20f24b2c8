"""Components of a scenario's parts, with their inherited parameters."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from pydantic import BaseModel

from qrsim.core.tree import field_info
from qrsim.scenarios.schema import ScenarioSpec


def component(spec: BaseModel, choices: Mapping[str, Any] | type, scenario: ScenarioSpec) -> Any:
    """Build a component from its part of a scenario, inherited parameters filled in; ``choices``: type -> class."""
    cls = choices if isinstance(choices, type) else choices[spec.type]  # type: ignore[attr-defined]
    values: dict[str, object] = {}
    for field in dataclasses.fields(cls):
        if field_info(field).derived:
            continue
        value = getattr(spec, field.name)
        inherits = field_info(field).inherits
        if isinstance(value, BaseModel):
            value = component(value, type(field.default), scenario)
        elif isinstance(value, list) and value and isinstance(value[0], str):
            value = tuple(value)
        elif isinstance(value, list):
            value = np.array(value, np.float64)
        elif value is None and inherits:
            value = inherited(scenario, inherits)
        elif value is None and field_info(field).of_sensors:
            continue
        values[field.name] = value
    return cls(**values)


def inherited(scenario: ScenarioSpec, path: str) -> object:
    """Return the value at a dotted path of the scenario; None if it does not exist."""
    value: Any = scenario
    for part in path.split("."):
        value = getattr(value, part, None)
    return value
