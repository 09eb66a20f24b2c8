"""The page of log columns: every quantity of a run folder, with its unit and where it is present."""

from __future__ import annotations

import copy
import dataclasses
import re
from collections.abc import Mapping
from typing import Any

import qrsim
from qrsim.core.tree import field_info
from qrsim.runs.layout import EVENT_COLUMNS, INDEX, Column
from qrsim.runs.streams import STREAMS, columns
from tools.reference.schema import kinds
from tools.reference.tables import code, page, sentence, table

ABOUT = {
    "truth": "The true state of every vehicle after the tick.",
    "measurements": "The readings of every sensor, as `SENSOR.QUANTITY`; the scenario names the sensor.",
    "commands": "Commands, set-points and, with an estimator, its estimate.",
    "wind": "Mean wind and gust at every vehicle.",
}
# Vectors that no record declares.
VECTORS = {
    "specific_force": "specific force, in body axes",
    "mean_ned": "mean wind",
    "gust_ned": "gust, added to the mean wind",
    "estimate.position_ned": "estimated position", "estimate.velocity_ned": "estimated velocity",
    "estimate.attitude": "estimated attitude",
    "estimate_std.position_ned": "standard deviation of the estimated position",
    "estimate_std.velocity_ned": "standard deviation of the estimated velocity",
    "estimate_std.attitude": "standard deviation of the estimated attitude",
    "gust_rates_ned": "rotation of the gusts",
}  # fmt: skip
AXES = (".x", ".y", ".z"), (".roll", ".pitch", ".yaw")
# Columns of a filter, which every vehicle can have.
ESTIMATED, FILTERED = ("estimate.", "estimate_std.", "innovation."), "fleets with an `estimator`, if it computes them"
# One fleet for each kind of vehicle; its columns also depend on its sensors, battery and estimator.
VEHICLES: dict[str, dict[str, Any]] = {
    "pelican": {"controller": {"type": "cascade", "feed": "truth"}},
    "multirotor": {
        "vehicle": {"type": "multirotor"},
        "battery": {"type": "lithium_polymer"},
        "estimator": {"type": "ekf"},
    },
    "fixed_wing": {"vehicle": {"type": "fixed_wing"}, "controller": {"type": "fixed_wing", "feed": "truth"}},
    "rover": {"vehicle": {"type": "rover"}, "controller": {"type": "rover", "feed": "truth"}},
}


def pages() -> Mapping[str, str]:
    """Return the page."""
    introduction = """A run folder has a folder of Parquet files for each stream. A row is one vehicle at one
        tick. Units and meanings are in the metadata of the columns as well:
        `qrsim.open_run(FOLDER).describe("truth")`. A quantity that a fleet lacks is NaN in its rows. N is a number
        from 0. [Runs](run_folder.md) explains the folder.

        The last column, "present for", lists the vehicles of one example that have the quantity. There the multirotor
        alone has a battery, all sensors and an `estimator`. Without an entry all vehicles have it."""
    simulation = _flown()
    history = simulation.history
    found: dict[str, dict[str, Column]] = {stream: {} for stream in STREAMS}
    present: dict[str, list[str]] = {}
    docs = dict(VECTORS)
    for i, fleet in enumerate(simulation.world.fleets):
        state = history.state.fleets[i]
        alone = dataclasses.replace(simulation.world, fleets=(fleet,))
        part = copy.copy(history)
        part.state = dataclasses.replace(history.state, fleets=(state,))
        own = columns(alone, part)
        for record in (state.vehicle, state.command, fleet.vehicle.pose(state.vehicle)):
            docs |= _vectors(record, "")
        docs |= _vectors(state.setpoint, "setpoint.")
        for name, reading in zip(fleet.sensor_names, state.readings, strict=True):
            docs |= _vectors(reading, f"{name}.")
        for stream, those in own.items():
            for column in those:
                found[stream].setdefault(column.name, column)
                present.setdefault(f"{stream}.{column.name}", []).append(fleet.name)
    index = "## every stream\n\n" + table(
        HEAD[:3], ((code(each.name), each.unit, sentence(each.doc)) for each in INDEX)
    )
    parts = [f"## {stream}\n\n{ABOUT[stream]}\n\n{_stream(stream, found[stream], present, docs)}" for stream in STREAMS]
    rows = ((code(each.name), each.unit, sentence(each.doc)) for each in EVENT_COLUMNS[len(INDEX) :])
    events = "## events\n\nA row is something that happened once.\n\n" + table(HEAD[:3], rows)
    return {"log_columns.md": page("Columns of the logs", introduction, index, *parts, events)}


HEAD = ("column", "unit", "meaning", "present for")


def _flown() -> Any:
    """Return a simulation of a fleet of each kind of vehicle, one of them with every sensor."""
    (sensors,) = (kind for kind in kinds() if kind.name == "sensors")
    every = {name: {"type": name} for name in sensors.types if not name.startswith("ideal_")}
    fleets = {name: dict(fleet) for name, fleet in VEHICLES.items()}
    for number, (name, fleet) in enumerate(fleets.items()):
        fleet["vehicles"] = [{"position_ned": [30.0 * number, 0.0, 0.0 if name == "rover" else -60.0]}]
    fleets["multirotor"]["sensors"] = every
    world = {
        "area": {"type": "box", "x_min": -500.0, "x_max": 500.0, "y_min": -500.0, "y_max": 500.0, "z_min": -200.0},
        "beacons": [{"name": "beacon", "position_ned": [0.0, 0.0, 0.0]}],
        "turbulence": {"type": "dryden_field", "speed_20ft": 5.0},
    }  # fmt: skip
    simulation = qrsim.load({"name": "columns", "duration": 1.0, "world": world, "fleets": fleets})
    simulation.reset()
    return simulation


def _vectors(item: Any, prefix: str) -> dict[str, str]:
    """Return the meaning of each vector and set of angles in a record, by its name."""
    found = {}
    for field in dataclasses.fields(item) if dataclasses.is_dataclass(item) else ():
        value, name = getattr(item, field.name), prefix + field.name
        if isinstance(value, tuple) and value:
            value, name = value[0], f"{name}.N"
        if dataclasses.is_dataclass(value):
            found[name] = field_info(field).doc
            found |= _vectors(value, f"{name}.")
    return found


def _stream(stream: str, found: dict[str, Column], present: dict[str, list[str]], docs: dict[str, str]) -> str:
    """Return the table of a stream; the axes of a vector share a row, and so do numbered parts."""
    rows = []
    found = {re.sub(r"\.\d+", ".N", name): column for name, column in reversed(found.items())}
    for name, column in reversed(found.items()):
        where = present[f"{stream}.{column.name}"]
        base = re.sub(r"\.(x|y|z|roll|pitch|yaw)$", "", name)
        axes = next((axes for axes in AXES if all(base + axis in found for axis in axes)), None)
        if base != name and axes:
            if not name.endswith(axes[0]):
                continue
            shown = code(base + axes[0]) + "".join(f" {code(axis)}" for axis in axes[1:])
            meaning = docs.get(base, "")
        else:
            shown, meaning = code(name), column.doc
        everyone = len(where) == len(VEHICLES) or (stream == "measurements")
        shown_for = FILTERED if name.startswith(ESTIMATED) else "" if everyone else ", ".join(where)
        rows.append((shown, "" if column.unit == "1" else column.unit, sentence(meaning), shown_for))
    return table(HEAD, rows)
