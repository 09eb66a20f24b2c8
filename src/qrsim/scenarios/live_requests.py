"""Requests to change a running flight, as links and the page take them: faults, their end, and the weather."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from qrsim.errors import UsageError, did_you_mean
from qrsim.models.sensors.faults import LAST_TICK
from qrsim.simulation.changing import WIND
from qrsim.simulation.injections import OK, WORLD

if TYPE_CHECKING:
    from qrsim.simulation.simulation import Simulation

# Numbers of a change of the wind: m/s at 20 ft, and degrees that it comes from.
WIND_NUMBERS = ("speed_20ft", "wind_from_deg")
VERBS = ("inject", "clear", "wind")
LONGEST_WORD = 60
MOST_WORDS = 1000
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_CLAUSES = {"for": "duration", "at": "at"}


@dataclass(frozen=True)
class Request:
    """A request of a client or of the page.

    Attributes:
        target: sensor, ``rotor N``, ``battery``, ``radio``, ``body``, ``link``, ``world``; None: all, which can only be
            cleared.
        kind: of the fault; ``ok`` clears it; of the world ``wind``, ``gusts`` or ``jam``.
        vehicles: names; None: all that have the target.
        at: simulated time [s]; None: from the next tick on.
        duration: [s]; None: to the end of the flight.
        numbers: of the kind, and ``field``; of the wind ``speed_20ft`` [m/s] and ``wind_from_deg`` [degrees].
    """

    target: str | None
    kind: str
    vehicles: tuple[str, ...] | None = None
    at: float | None = None
    duration: float | None = None
    numbers: Mapping[str, Any] = field(default_factory=dict)

    @property
    def of_world(self) -> bool:
        """True if the request is for the whole world (weather), and so affects all vehicles."""
        return self.target == WORLD


def wind(speed: float, from_deg: float, over: float = 0.0) -> Request:
    """Return a request for a mean wind of ``speed`` [m/s] at 20 ft from ``from_deg``, reached after ``over`` [s]."""
    later = {"over": over} if over else {}
    return Request(WORLD, WIND, numbers=dict(zip(WIND_NUMBERS, (speed, from_deg), strict=True)) | later)


def apply(simulation: Simulation, request: Request, asked_by: str) -> str:
    """Apply a request to a running simulation from the next tick on; return a line that describes it.

    Args:
        simulation: reset, and not being advanced by another thread.
        request: not checked yet.
        asked_by: source of the request, for records.

    Raises:
        UsageError: the request is refused; nothing has changed.
    """
    vehicles, numbers = request.vehicles, dict(request.numbers)
    if request.of_world:
        return _weather(simulation, request, asked_by)
    whom = "" if vehicles is None else f" of {_listed(vehicles)}"
    if request.kind == OK:
        if request.at is not None or request.duration is not None or numbers:
            raise UsageError("clear: it takes a target and vehicles only, and acts at once")
        simulation.clear(request.target, vehicles, asked_by)
        return f"Cleared: {request.target or 'all'}{whom}"
    if request.target is None:
        raise UsageError("target: missing; a sensor, 'rotor N', 'battery', 'body' or 'world'")
    # These names would be taken for arguments of ``inject``.
    for name in numbers:
        if not isinstance(name, str) or name in ("target", "kind", "vehicles", "at", "duration", "asked_by"):
            raise UsageError(f"{str(name)[:LONGEST_WORD]}: there is no such number")
    times = {"at": request.at, "duration": request.duration}
    simulation.inject(request.target, request.kind, vehicles, asked_by=asked_by, **times, **numbers)
    begins = "" if request.at is None else f" at {request.at:g} s"
    lasts = "" if request.duration is None else f" for {request.duration:g} s"
    return f"Injected: {request.target} {request.kind}{whom}{begins}{lasts}"


def _weather(simulation: Simulation, request: Request, asked_by: str) -> str:
    """Change the weather of a running simulation as requested; return a line that describes it; raises UsageError."""
    if request.vehicles is not None:
        raise UsageError(f"vehicles: {request.kind[:LONGEST_WORD]} of the world is that of all")
    if request.at is not None or request.duration is not None:
        raise UsageError("at, duration: the world changes from the next tick on, and stays until it is changed again")
    for name in WIND_NUMBERS if request.kind == WIND else ():
        if name not in request.numbers:
            raise UsageError(f"{name}: missing; a wind needs {' and '.join(WIND_NUMBERS)}")
    simulation.change_weather(request.kind, request.numbers, asked_by)
    numbers = dict(request.numbers)
    over = numbers.pop("over", None)
    slowly = f" over {over:g} s" if over else ""
    if request.kind == WIND:
        speed, bearing = (numbers[name] for name in WIND_NUMBERS)
        return f"Wind: {speed:g} m/s at 20 ft from {bearing:g} degrees{slowly}"
    return f"Changed: {request.kind}, {', '.join(f'{name} {value:g}' for name, value in numbers.items())}{slowly}"


def _listed(names: Iterable[str]) -> str:
    """Return the first four names as text, and the number of the others."""
    found = list(names)
    return ", ".join(found[:4]) + (f" and {len(found) - 4} more" if len(found) > 4 else "")


# ---- as text ----


def parsed(text: str) -> Request:
    """Parse a line such as "gnss off uav1 at=5" to a request; raises UsageError for other text.

    ``inject TARGET KIND [VEHICLE ...] [NAME=VALUE ...] [at SECONDS] [for SECONDS]``, ``clear [TARGET] [VEHICLE ...]``,
    or ``wind SPEED FROM_DEG [over SECONDS]``.

    Raises:
        UsageError: the line is not a request.
    """
    words = text.split()
    if len(words) > MOST_WORDS:
        raise UsageError(f"request: {len(words)} words; allowed: at most {MOST_WORDS}")
    verb = words[0] if words else ""
    if verb not in VERBS:
        raise UsageError(
            f"'{verb[:LONGEST_WORD]}': expected {', '.join(VERBS)}{did_you_mean(verb[:LONGEST_WORD], VERBS)}"
        )
    rest = words[1:]
    if verb == "wind":
        over = {"over": _number("over", rest[3])} if len(rest) == 4 and rest[2] == "over" else {}
        rest = rest[:2] if over else rest
        if len(rest) != 2:
            raise UsageError(f"wind: {len(rest)} numbers; expected a speed [m/s] and a bearing it comes from [degrees]")
        return wind(*(_number(name, word) for name, word in zip(WIND_NUMBERS, rest, strict=True)), **over)
    target, rest = _target(rest)
    if verb == "clear":
        return Request(target, OK, tuple(rest) or None)
    if target is None or not rest:
        raise UsageError("inject: expected a target and a kind, such as 'inject gnss off'")
    names, numbers, times = _arguments(rest[1:])
    return Request(target, rest[0], tuple(names) or None, times.get("at"), times.get("duration"), numbers)


def numbers_of(text: str) -> dict[str, object]:
    """Parse a text of assignments such as ``field=height bias=2`` to a dict; raises UsageError."""
    names, numbers, times = _arguments(text.replace(",", " ").split())
    for word in [*names, *times]:
        raise UsageError(f"'{word[:LONGEST_WORD]}': expected NAME=VALUE, such as bias=2")
    return numbers


def _target(words: list[str]) -> tuple[str | None, list[str]]:
    """Split the words of a request: return the target (two words for a rotor), and the remaining words."""
    if len(words) > 1 and words[0] == "rotor" and words[1].isdecimal():
        return f"rotor {words[1]}", words[2:]
    return (words[0], words[1:]) if words else (None, [])


def _arguments(words: list[str]) -> tuple[list[str], dict[str, object], dict[str, float]]:
    """Parse words of a request to (vehicle names, fault parameters, times [s])."""
    names: list[str] = []
    numbers: dict[str, object] = {}
    times: dict[str, float] = {}
    left = iter(words)
    for word in left:
        name, equals, value = word.partition("=")
        if word in _CLAUSES:
            times[_CLAUSES[word]] = _number(word, next(left, ""))
        elif not equals:
            names.append(word)
        elif name in numbers:
            raise UsageError(f"{name[:LONGEST_WORD]}: given twice")
        else:
            numbers[name] = value if name == "field" else _number(name, value)
    return names, numbers, times


def _number(name: str, word: str) -> float:
    """Parse a word of a request to a finite number; raises UsageError that names the parameter for other words."""
    if not _NUMBER.fullmatch(word) or not math.isfinite(float(word)):
        raise UsageError(f"{name[:LONGEST_WORD]}: '{word[:LONGEST_WORD]}'; expected a number")
    return float(word)


# ---- as tables ----


def injected_rows(simulation: Simulation) -> list[dict[str, object]]:
    """Return present and future injected faults as dicts for JSON; ``end`` None means the end of the flight."""
    dt = simulation.world.time_step
    return [
        {
            "id": one.id,
            "target": one.target,
            "kind": one.kind,
            "vehicles": list(one.vehicles),
            "start": round(one.start_tick * dt, 9),
            "end": round(one.end_tick * dt, 9) if one.end_tick < LAST_TICK else None,
            "numbers": dict(one.numbers),
        }
        for one in simulation.injected
    ]
