"""Multirotors by the name of a parameter set: ``vehicle: {type: multirotor, model: x500}``."""

from __future__ import annotations

import dataclasses
from typing import Any

from qrsim.core.tree import field_info
from qrsim.errors import ScenarioError, did_you_mean
from qrsim.models.vehicles.multirotor.sets import SETS


def numbers_of(part: Any) -> dict[str, Any]:
    """Return the parameters and settings of a component as a scenario writes them."""
    found: dict[str, Any] = {}
    for field in dataclasses.fields(part):
        value = getattr(part, field.name)
        if dataclasses.is_dataclass(value):
            found[field.name] = numbers_of(value)
        elif field_info(field).static and isinstance(value, tuple):
            found[field.name] = [_written(each) for each in value]
        else:
            found[field.name] = value
    return found


def _written(value: Any) -> Any:
    """Return a number, a point or a rotor as a scenario writes it."""
    if isinstance(value, int | float):
        return value
    if isinstance(value, tuple):
        return list(value)
    return {name: list(part) if isinstance(part, tuple) else part for name, part in vars(value).items()}


def insert_vehicle_models(content: dict[str, Any], source: str) -> None:
    """Replace, in place, the ``model`` of each multirotor of a scenario by its parameters; others beside it count.

    Raises:
        ScenarioError: no model has that name.
    """
    fleets = content.get("fleets")
    for name, fleet in fleets.items() if isinstance(fleets, dict) else ():
        vehicle = fleet.get("vehicle") if isinstance(fleet, dict) else None
        if not isinstance(vehicle, dict) or vehicle.get("type") != "multirotor" or "model" not in vehicle:
            continue
        model = vehicle["model"]
        if not isinstance(model, str) or model not in SETS:
            hint = did_you_mean(str(model), SETS)
            raise ScenarioError(source, [f"fleets.{name}.vehicle.model: no multirotor is called '{model}'{hint}"])
        beside = {key: value for key, value in vehicle.items() if key != "model"}
        fleet["vehicle"] = _over(numbers_of(SETS[model]()), beside)


def _over(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    """Return a part with the numbers of another in place of its own, nested parts too."""
    found = dict(below)
    for key, value in above.items():
        nested = isinstance(value, dict) and isinstance(below.get(key), dict)
        found[key] = _over(below[key], value) if nested else value
    return found
