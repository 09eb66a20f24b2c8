"""Multirotors by a parameter set, ``vehicle: {type: multirotor, model: x500}``, or by six numbers, ``own: {...}``."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

from qrsim.core.presets import filled
from qrsim.core.tree import field_info
from qrsim.errors import ScenarioError, UsageError, did_you_mean
from qrsim.files import Content
from qrsim.models.vehicles.multirotor import Multirotor
from qrsim.models.vehicles.multirotor.geometry import Rotor
from qrsim.models.vehicles.multirotor.own import (
    GEOMETRIES,
    OF_TABLE,
    SIX,
    TABLE,
    known_numbers,
    own_multirotor,
    rotors_of,
)
from qrsim.models.vehicles.multirotor.sets import SETS


def numbers_of(part: Any) -> Content:
    """Return the parameters and settings of a component as scenario content, name -> value."""
    found: Content = {}
    for field in dataclasses.fields(part):
        if field_info(field).derived:
            continue
        value = getattr(part, field.name)
        if dataclasses.is_dataclass(value):
            found[field.name] = numbers_of(value)
        elif field_info(field).static and isinstance(value, tuple):
            found[field.name] = [_written(each) for each in value]
        else:
            found[field.name] = value
    return found


def _written(value: object) -> object:
    """Convert a number, point or rotor to scenario content."""
    if isinstance(value, int | float):
        return value
    if isinstance(value, tuple):
        return list(value)
    return {name: list(part) if isinstance(part, tuple) else part for name, part in vars(value).items()}


def insert_vehicle_models(content: Content, source: str) -> list[str]:
    """Replace models, own numbers and geometry of multirotors by all parameters, in place; return warnings.

    That is ``model`` (a set of parameters), ``own`` (six numbers) and ``geometry`` (where the rotors are).

    Returns:
        Warnings of numbers that are not plausible, one sentence each.

    Raises:
        ScenarioError: no model or arrangement has that name, or numbers are wrong.
    """
    fleets = content.get("fleets")
    problems: list[str] = []
    odd: list[str] = []
    for name, fleet in fleets.items() if isinstance(fleets, dict) else ():
        vehicle = fleet.get("vehicle") if isinstance(fleet, dict) else None
        if not isinstance(vehicle, dict) or vehicle.get("type") != "multirotor" or not SHORT & set(vehicle):
            continue
        try:
            fleet["vehicle"] = _written_out(vehicle, partial(_note, odd, name))
        except UsageError as error:
            problems.append(f"fleets.{name}.vehicle.{error}")
            continue
        if "own" in vehicle:
            _fill_gains(fleet, float(vehicle["own"]["attitude_bandwidth"]))
    if problems:
        raise ScenarioError(source, problems)
    return odd


def _note(odd: list[str], fleet: str, words: str) -> None:
    """Append a warning about a fleet's vehicle model to the list ``odd``."""
    odd.append(f"fleets.{fleet}.vehicle.own.{words}")


# Written in a scenario in place of parameters.
SHORT = {"model", "own", "geometry", "arm", "rotor_height"}


def _written_out(vehicle: Content, warn: Callable[[str], None]) -> Content:
    """Return a multirotor's content with all parameters that its model, preset or own numbers imply; ``warn`` is
    called.

    Raises:
        UsageError: its message begins with the path below the vehicle.
    """
    beside = {key: value for key, value in vehicle.items() if key not in SHORT}
    found: Content = {}
    if "own" in vehicle:
        if "model" in vehicle:
            raise UsageError("own: gives both 'own' and 'model'; give one")
        found = numbers_of(_own(vehicle["own"], vehicle.get("geometry"), beside, warn))
    elif "model" in vehicle:
        model = vehicle["model"]
        if not isinstance(model, str) or model not in SETS:
            raise UsageError(f"model: no multirotor is called '{model}'{did_you_mean(str(model), SETS)}")
        found = numbers_of(SETS[model]())
    if "own" not in vehicle and {"geometry", "arm", "rotor_height"} & set(vehicle):
        found["rotors"] = [_written(rotor) for rotor in _arranged(vehicle)]
    return filled(found, beside)


def _fill_gains(fleet: Content, attitude_bandwidth: float) -> None:
    """Set missing gains of a cascaded controller to suit the vehicle's attitude bandwidth [rad/s], in place."""
    controller = fleet.setdefault("controller", {"type": "cascade"})
    if isinstance(controller, dict) and controller.get("type") == "cascade":
        controller.setdefault("position_gain", min(1.2, attitude_bandwidth / 7.0))
        controller.setdefault("velocity_gain", min(2.2, attitude_bandwidth / 3.6))


def _own(own: object, geometry: object, beside: Content, warn: Callable[[str], None]) -> Multirotor:
    """Build a multirotor model from the six measured numbers under ``own`` of a scenario; ``warn`` takes doubts."""
    if not isinstance(own, dict):
        raise UsageError(f"own: expected {', '.join(SIX)}, found {own!r:.100}")
    for key in own:
        if key not in (*SIX, "geometry", TABLE):
            raise UsageError(f"own.{key}: no such number{did_you_mean(str(key), (*SIX, TABLE))}")
    needed = [key for key in SIX if key not in OF_TABLE] if TABLE in own else SIX
    missing = [key for key in needed if key not in own]
    if missing:
        raise UsageError(f"own: {' and '.join(missing)} missing; expected {', '.join(needed)}")
    if TABLE in own and (both := [key for key in OF_TABLE if key in own]):
        raise UsageError(f"own.{both[0]}: is in the {TABLE} too; give one")
    try:
        return own_multirotor(**{"geometry": geometry, **own, **known_numbers(beside)}, warn=warn)
    except UsageError as error:
        raise UsageError(f"own.{error}") from None


def _arranged(vehicle: Content) -> tuple[Rotor, ...]:
    """Return the rotors of a standard geometry, such as an X frame, from a vehicle's content."""
    if "geometry" not in vehicle:
        raise UsageError(f"arm: without geometry; give one of {', '.join(GEOMETRIES)}, or rotors")
    if "rotors" in vehicle:
        raise UsageError("geometry: gives both 'geometry' and 'rotors'; give one")
    numbers = {"arm": vehicle.get("arm"), "rotor_height": vehicle.get("rotor_height", 0.0)}
    for name, value in numbers.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 10.0:
            raise UsageError(f"{name}: expected a length [m], found {value!r}")
    if numbers["arm"] <= 0.0:
        raise UsageError(f"arm: {numbers['arm']:g} m; allowed: above 0")
    return rotors_of(vehicle["geometry"], float(numbers["arm"]), float(numbers["rotor_height"]))
