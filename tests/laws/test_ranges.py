"""What scenarios and programs may say: defaults and bounds of all parameters, as published in scenario_ranges.csv.

Files of users rely on them, and on what presets stand for (scenario_presets.csv; data sheets are named where presets
are defined). Who changes one changes the format: a row of the table, and a line of the changelog.
"""

from __future__ import annotations

import csv
import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from qrsim.control import paths
from qrsim.core.tree import field_info
from qrsim.models.gnss import interference
from qrsim.models.gnss.base_station import BaseStation
from qrsim.models.gnss.receivers import SharedSky
from qrsim.models.gnss.slots import Slots
from qrsim.models.radio.network import Network
from qrsim.models.radio.parameters import Delay, InboxSize, Mac, Packet, PathLoss
from qrsim.models.scene.area import StateLimits
from qrsim.models.scene.prisms import Prisms
from qrsim.models.scene.traffic import Traffic
from qrsim.models.sensors.fitting import Fitting
from qrsim.models.site import Site
from qrsim.models.vehicles import quadrotor
from qrsim.models.vehicles.carried_point import CarriedPoint
from qrsim.models.vehicles.contracts import Outline
from qrsim.models.vehicles.fixed_wing import commands as fixed_wing
from qrsim.models.vehicles.multirotor import commands as multirotor
from qrsim.models.vehicles.rover import commands as rover
from qrsim.scenarios import catalogue

TABLE = Path(__file__).with_name("scenario_ranges.csv")
# Records with numbers of users' that are parts of a scenario or arguments of calls, and no components of the catalogue.
PARTS = (
    *(BaseStation, SharedSky, Slots, Network, PathLoss, Packet, Mac, Delay, InboxSize, StateLimits, Prisms, Traffic),
    *(Fitting, Site, CarriedPoint, Outline, paths.Limits, paths.Leg, quadrotor.Command),
    *(fixed_wing.AttitudeCommand, fixed_wing.SurfaceCommand, multirotor.AttitudeCommand, multirotor.RateCommand),
    *(multirotor.MotorCommand.of_count(4), rover.SteeringCommand, rover.WheelCommand),
    *(getattr(interference, name) for name in ("Jammer", "Disc", "Spoofer", "Outage", "IonoStorm")),
)
PRESETS = Path(__file__).with_name("scenario_presets.csv")
COLUMNS = ("component", "parameter", "unit", "default", "minimum", "maximum", "above")


def _text(value: Any) -> str:
    return repr(value) if isinstance(value, int | float) and not isinstance(value, bool) else ""


def _rows(component: str, record: Any, prefix: str = "") -> Iterator[tuple[str, ...]]:
    """Yield a row for each number of a record, those of records in it by dotted names."""
    for field in dataclasses.fields(record):
        info, default = field_info(field), field.default
        if dataclasses.is_dataclass(default):
            yield from _rows(component, default, f"{prefix}{field.name}.")
            continue
        numbers = [_text(value) for value in (default, info.minimum, info.maximum, info.above)]
        if any(numbers):
            yield component, prefix + field.name, info.unit, *numbers


def found() -> list[tuple[str, ...]]:
    """Return the rows of all built-in components, and of the parts beside them."""
    rows = []
    for kind, group in sorted(vars(catalogue).items()):
        if kind.isupper() and isinstance(group, dict):
            for name, component in sorted(group.items()):
                # What other tests have taken in from files is not built in.
                if ":" not in name and dataclasses.is_dataclass(component):
                    rows += list(_rows(f"{kind.lower()}/{name}", component))
    for part in PARTS:
        rows += list(_rows(f"{part.__module__.removeprefix('qrsim.')}.{part.__name__}", part))
    return rows


def test_defaults_and_bounds_are_the_published_ones() -> None:
    with TABLE.open(encoding="utf-8", newline="") as file:
        header, *published = (tuple(row) for row in csv.reader(file))
    assert header == COLUMNS
    assert len(published) > 600
    now = found()
    assert sorted(set(now) - set(published)) == [], "no such row in scenario_ranges.csv"
    assert sorted(set(published) - set(now)) == [], "a row of scenario_ranges.csv that holds no longer"


def _numbers(name: str, value: Any) -> Iterator[tuple[str, str]]:
    """Yield the numbers of a preset's value, with a name each."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _numbers(f"{name}.{key}", item)
    elif isinstance(value, tuple | list):
        for place, item in enumerate(value):
            yield from _numbers(f"{name}[{place}]", item)
    elif _text(value):
        # Of a quotient, the last digits are the machine's.
        yield name, f"{value:.12g}"


def presets() -> list[tuple[str, ...]]:
    """Return component, preset, parameter and value of the numbers that presets of built-in components stand for."""
    rows = []
    for kind, group in sorted(vars(catalogue).items()):
        if kind.isupper() and isinstance(group, dict):
            for name, component in sorted(group.items()):
                for preset, values in getattr(component, "presets", {}).items() if ":" not in name else ():
                    for parameter, value in values.items():
                        rows += [(f"{kind.lower()}/{name}", preset, *item) for item in _numbers(parameter, value)]
    return rows


def test_presets_are_the_published_ones() -> None:
    with PRESETS.open(encoding="utf-8", newline="") as file:
        header, *published = (tuple(row) for row in csv.reader(file))
    assert header == ("component", "preset", "parameter", "value")
    assert len(published) > 300
    now = presets()
    assert sorted(set(now) - set(published)) == [], "no such row in scenario_presets.csv"
    assert sorted(set(published) - set(now)) == [], "a row of scenario_presets.csv that holds no longer"
