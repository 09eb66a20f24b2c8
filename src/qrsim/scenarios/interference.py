"""What a scenario says of jammers, spoofers, outages and storms: its schema, its checks, and what is built of it."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from functools import cache, partial
from typing import Any, Literal

import numpy as np
from pydantic import Field

from qrsim.core.arrays import NumpyArray
from qrsim.errors import UsageError, did_you_mean
from qrsim.models.gnss.constellations import check_systems
from qrsim.models.gnss.interference import Disc, Interference, IonoStorm, Jammer, Outage, Spoofer
from qrsim.models.gnss.orbits import Ephemeris
from qrsim.scenarios.component_schema import Strict, component_model
from qrsim.scenarios.event_schema import may_be_jammed
from qrsim.scenarios.legs import Position
from qrsim.scenarios.slots import slot
from qrsim.scenarios.spans import span_problems

# Where an Interference has what is of each kind.
PLACES = {"jammer": "jammers", "disc": "discs", "spoofer": "spoofers", "outage": "outages", "iono_storm": "storms"}
_CLASSES: dict[str, type] = {
    "jammer": Jammer,
    "disc": Disc,
    "spoofer": Spoofer,
    "outage": Outage,
    "iono_storm": IonoStorm,
}
KIND_OF = {cls: kind for kind, cls in _CLASSES.items()}
MOST = 100
# The end of what has none, and the radius of what is heard everywhere.
_NEVER, _EVERYWHERE = 1e9, 1e9
_WHERE = (Position, Field(description="where it is [m]: north, east, down"))
_ZERO = [0.0, 0.0, 0.0]
_GIVEN: dict[str, dict[str, tuple[object, object]]] = {
    "jammer": {"position_ned": _WHERE},
    "disc": {"position_ned": _WHERE},
    "spoofer": {
        "position_ned": (Position, Field(_ZERO, description="centre of where it is heard [m]: north, east, down")),
        "offset_ned": (Position, Field(_ZERO, description="offset of a fix at the start [m]")),
        "rate_ned": (Position, Field(_ZERO, description="by which it moves a fix on [m/s]")),
        "vehicles": (list[str] | None, Field(None, description="names; default: all within its range", min_length=1)),
    },
    "outage": {
        "systems": (str | None, Field(None, description="letters of the systems that fail, of G, E, R, C")),
        "satellites": (list[str] | None, Field(None, description="names of satellites that fail", min_length=1)),
    },
    "iono_storm": {},
}


@cache
def _model(kind: str) -> type[Strict]:
    """Return the pydantic model of a kind of GNSS interference (jammer, spoofer, outage)."""
    named = {"kind": (Literal[kind], Field(description="what it is"))}
    return component_model(kind, _CLASSES[kind], tagged=False, arrays={**named, **_GIVEN[kind]})


InterferenceSlot: Any = slot(lambda: {kind: partial(_model, kind) for kind in PLACES}, key="kind")


def interference(scenario: object, ephemeris: Ephemeris) -> Interference | None:
    """Build a world's GNSS interference, without jammers that have no power; None if nothing is left."""
    kept = _kept(scenario)
    if not kept:
        return None
    found: dict[str, list[Any]] = {place: [] for place in PLACES.values()}
    for _, spec in kept:
        found[PLACES[spec.kind]].append(_built(spec, ephemeris))
    return Interference(**{place: tuple(items) for place, items in found.items()})


def _kept(scenario: Any) -> list[tuple[int, Any]]:
    """Return (index, specification) of each interferer to build: all but jammers that can never have power."""
    drawn, jammed = {item.path for item in scenario.ranges}, may_be_jammed(scenario)
    return [
        (i, spec)
        for i, spec in enumerate(scenario.world.interference)
        if spec.kind != "jammer" or spec.power_w > 0.0 or jammed or f"world.interference.{i}.power_w" in drawn
    ]


def _built(spec: Any, ephemeris: Ephemeris) -> object:
    """Build an interferer from its specification; a missing time or radius is unlimited."""
    cls = _CLASSES[spec.kind]
    values: dict[str, object] = {}
    for field in dataclasses.fields(cls):
        if spec.kind == "outage" and field.name == "satellites":
            values[field.name] = _failing(spec, ephemeris)
            continue
        value = getattr(spec, field.name)
        if value is None:
            value = _EVERYWHERE if field.name == "radius" else _NEVER
        values[field.name] = np.array(value, np.float64) if isinstance(value, list) else value
    return cls(**values)


def _failing(spec: Any, ephemeris: Ephemeris) -> NumpyArray:
    """Return a bool array (S,) of the satellites that an outage silences."""
    names, systems = spec.satellites or (), spec.systems or ""
    pairs = zip(ephemeris.satellites, ephemeris.system_of, strict=True)
    return np.array([name in names or letter in systems for name, letter in pairs])


def world_path(scenario: object, path: str) -> tuple[str | int, ...] | None:
    """Return the World path of the scenario path ``world.interference.I.NAME``; None if the interferer is not built."""
    _, _, number, *rest = path.split(".")
    before: dict[str, int] = {}
    for i, spec in _kept(scenario):
        place = PLACES[spec.kind]
        if str(i) == number and len(rest) == 1 and getattr(spec, rest[0], None) is not None:
            return ("sky", "interference", place, before.get(place, 0), rest[0])
        before[place] = before.get(place, 0) + 1
    return None


def spoofed(scenario: object, names: Sequence[str]) -> tuple[NumpyArray, ...] | None:
    """Return a bool array over ``names`` for each spoofer: the vehicles that it affects; None without a spoofer."""
    specs = [spec for _, spec in _kept(scenario) if spec.kind == "spoofer"]
    chosen = tuple(np.array([spec.vehicles is None or name in spec.vehicles for name in names]) for spec in specs)
    return chosen or None


def interference_problems(scenario: Any, ephemeris: Ephemeris, names: Sequence[str], heard: bool) -> Iterator[str]:
    """Yield the errors in ``world.interference``; ``heard``: the scenario has a receiver of type gnss.

    Args:
        scenario: with ``world`` and ``duration``.
        ephemeris: orbits of the satellites that an outage may name.
        names: of all vehicles, which a spoofer may name.
        heard: the scenario has a sensor of type gnss.
    """
    if scenario.world.interference and not heard:
        yield "world.interference: there is no sensor of type gnss, which alone feels it"
    errors = scenario.world.sky.errors
    for i, spec in enumerate(scenario.world.interference):
        path = f"world.interference.{i}"
        yield from span_problems(path, spec.start, spec.end, scenario.duration)
        if spec.kind == "spoofer":
            for name in spec.vehicles or ():
                if name not in names:
                    yield f"{path}.vehicles: no vehicle is called '{name}'{did_you_mean(name, names)}"
        elif spec.kind == "outage":
            yield from _outage_problems(path, spec, ephemeris)
        elif spec.kind == "iono_storm" and (errors.type != "error_budget" or errors.common == "per_vehicle"):
            yield f"{path}: a storm is one of world.sky.errors of type error_budget with common: shared"


def _outage_problems(path: str, spec: Any, ephemeris: Ephemeris) -> Iterator[str]:
    """Yield the errors of an outage: systems or satellites that the orbits lack, or both kinds given."""
    if (spec.systems is None) == (spec.satellites is None):
        yield f"{path}: an outage is either of systems or of satellites; give one of the two"
    if spec.systems is not None:
        try:
            check_systems(spec.systems, f"{path}.systems")
        except UsageError as error:
            yield str(error)
            return
        there = set(ephemeris.system_of)
        for letter in spec.systems:
            if letter not in there:
                yield f"{path}.systems: world.sky.orbits has no satellite of '{letter}'"
    known = list(ephemeris.satellites)
    for name in spec.satellites or ():
        if name not in known:
            yield f"{path}.satellites: no satellite is called '{name}'{did_you_mean(name, known)}"
