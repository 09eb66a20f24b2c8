"""A vehicle in a file of its own, as ``qrsim identify`` and ``qrsim discover`` write it: ``vehicle: {file: NAME}``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from qrsim.errors import ScenarioError, UsageError, did_you_mean_file
from qrsim.files import Content
from qrsim.files.user_files import read_text
from qrsim.files.yaml_text import parse_yaml


def read_vehicle_file(path: Path) -> Content:
    """Read a YAML file of one vehicle; return its content as in a scenario.

    Raises:
        UsageError: there is no such file, or no ``vehicle`` in it.
    """
    try:
        content = parse_yaml(read_text(path), str(path))
    except FileNotFoundError:
        raise UsageError(f"vehicle file {path}: no such file{did_you_mean_file(path)}") from None
    except OSError as error:
        raise UsageError(f"vehicle file {path}: cannot be read: {error.strerror}") from None
    vehicle = content.get("vehicle") if isinstance(content, dict) else None
    if not isinstance(vehicle, dict) or "type" not in vehicle:
        raise UsageError(
            f"vehicle file {path}: expected 'vehicle:' with a 'type:' and constants, as 'qrsim identify' writes"
        )
    return vehicle


def insert_vehicle_files(content: Mapping[str, object], source: str) -> None:
    """Replace, in place, each ``vehicle: {file: NAME}`` of a scenario by the vehicle of the file.

    Other constants beside ``file`` count over those of the file.

    Raises:
        ScenarioError: a file is missing or is none.
    """
    fleets = content.get("fleets")
    for name, fleet in fleets.items() if isinstance(fleets, dict) else ():
        vehicle = fleet.get("vehicle") if isinstance(fleet, dict) else None
        if not isinstance(vehicle, dict) or not isinstance(vehicle.get("file"), str):
            continue
        try:
            of_file = read_vehicle_file(Path(vehicle["file"]))
        except UsageError as error:
            raise ScenarioError(source, [f"fleets.{name}.vehicle.file: {error}"]) from None
        beside = {key: value for key, value in vehicle.items() if key not in ("file", "type")}
        fleet["vehicle"] = of_file | beside
