"""The page of presets: named sets of parameters of components."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any

from qrsim.core.presets import presets_of
from qrsim.core.tree import field_info
from qrsim.models.radio.channel import Channel
from qrsim.models.vehicles.multirotor.sets import SETS
from qrsim.scenarios import catalogue, sensor_sets
from tools.reference.tables import code, number, page, table


def pages() -> Mapping[str, str]:
    """Return the page."""
    introduction = """A preset is a named set of parameters of one component: the numbers of a chip, a receiver, a
        radio or an airframe. `preset: NAME` chooses it, and each parameter that the scenario gives as well replaces
        that of the preset. Angles are in radians. [Sensors](../howto/choose_sensors.md),
        [GNSS receivers](../howto/choose_a_receiver.md) and [radio](../explanation/models/radio.md) compare them and
        name the data sheets."""
    return {
        "presets.md": page(
            "Presets", introduction, *(_part(*each) for each in _found()), _multirotors(), _sensor_sets()
        )
    }


def _found() -> Iterator[tuple[str, Any]]:
    for kind, group in catalogue.KINDS.items():
        for name, component in group.items():
            if presets_of(component):
                yield f"{kind}: {name}", component
    yield "radio", Channel


def _part(title: str, component: Any) -> str:
    presets = presets_of(component) or {}
    units = {field.name: field_info(field).unit for field in dataclasses.fields(component)}
    usual = {field.name: field.default for field in dataclasses.fields(component)}
    names = dict.fromkeys(name for values in presets.values() for name in _flat(values))
    rows = []
    for name in names:
        cells = []
        for values in presets.values():
            flat = _flat(values)
            own = flat[name] if name in flat else usual.get(name)
            cells.append(
                "" if own is None or dataclasses.is_dataclass(own) or own is dataclasses.MISSING else number(own)
            )
        unit = units.get(name, "")
        rows.append((code(name), "" if unit == "1" else unit, *cells))
    default = usual.get("preset")
    head = f"## {title}\n\nDefault: `{default}`."
    return f"{head}\n\n{table(('parameter', 'unit', *map(code, presets)), rows)}" if rows else head


def _flat(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in values.items():
        found |= _flat(value, f"{prefix}{name}.") if isinstance(value, Mapping) else {prefix + name: value}
    return found


def _multirotors() -> str:
    """Return the parameter sets of multirotors."""
    rows = []
    for name, make in SETS.items():
        made = make()
        rows.append((code(name), number(made.mass), str(len(made.rotors))))
    return (
        "## vehicle: multirotor\n\n"
        "`model: NAME` chooses one of these sets; `qrsim show SCENARIO` prints all parameters.\n\n"
        + table(("model", "mass [kg]", "rotors"), rows)
    )


def _sensor_sets() -> str:
    """Return the sets of sensors of a fleet."""
    rows = [
        (code(name), ", ".join(f"`{sensor}`: {code(number(values))}" for sensor, values in sensors.items()))
        for name, sensors in sensor_sets.SETS.items()
    ]
    return "## sets of sensors\n\n`sensors: NAME` gives a fleet all sensors of a set.\n\n" + table(
        ("set", "sensors"), rows
    )
