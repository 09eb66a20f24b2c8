"""The numbers of sensor faults as scenarios and injections say them: what each kind takes, and what becomes of it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from qrsim.core.tree import map_tree, record_of
from qrsim.errors import did_you_mean
from qrsim.models.sensors.faults import LAST_TICK, OLD_NAMES, FaultNumbers, FaultSlot, Kind


class _Takes(NamedTuple):
    """The numbers of a kind of fault.

    Attributes:
        needed: numbers that must be given.
        optional: numbers that may be given.
        field: whether the fault is of one field of the reading.
    """

    needed: tuple[str, ...] = ()
    optional: tuple[str, ...] = ()
    field: bool = False


TAKES: dict[Kind, _Takes] = {
    "off": _Takes(),
    "stuck": _Takes(),
    "wrong": _Takes((), ("bias", "scale"), True),
    "drift": _Takes(("rate",), ("limit",), True),
    "noisy": _Takes((), ("std", "times"), True),
    "garbage": _Takes(("range",), (), True),
    "slow": _Takes(("every",)),
    "delayed": _Takes(("by",)),
    "intermittent": _Takes((), ("share", "on", "off")),
}
NAMES = ("bias", "scale", "rate", "limit", "std", "times", "range", "every", "by", "share", "on", "off")
# Those that each field of a reading can have one of.
OF_FIELDS = ("bias", "scale", "rate", "std", "times", "range")
# Smallest and largest value. What has no other is a number that single precision holds.
_ANY = 1e15
_BOUNDS = {
    "limit": (0.0, _ANY),
    "std": (0.0, _ANY),
    "times": (1.0, 1e6),
    "range": (0.0, _ANY),
    "every": (1, 1_000_000),
    "by": (0.0, 600.0),
    "share": (0.0, 1.0),
    "on": (0.0, 1e6),
    "off": (0.0, 1e6),
}


def kind_of(word: str) -> Kind:
    """Return the current name of a kind of sensor fault, for its current or former name."""
    return OLD_NAMES.get(word, word)  # type: ignore[arg-type]


def chosen_fields(field: str | None, fields: Sequence[str]) -> tuple[str, ...]:
    """Return the reading fields that a name selects (a vector's name selects all axes); () if unknown or None."""
    return tuple(name for name in fields if field is not None and (name == field or name.startswith(f"{field}.")))


def number_problems(
    word: str,
    field: str | None,
    given: Mapping[str, float | None],
    fields: Sequence[str],
    white: Mapping[str, object] | None = None,
) -> Iterator[tuple[str, str]]:
    """Yield (name, problem as text) for the field and each number, given or missing, that does not suit a fault.

    ``white`` is the white noise of the sensor, see ``Sensor.white_noise``.
    """
    takes = TAKES[kind_of(word)]
    said = {name: value for name, value in given.items() if value is not None}
    for name, value in said.items():
        low, high = _BOUNDS.get(name, (-_ANY, _ANY))
        if name not in takes.needed + takes.optional:
            kinds = [kind for kind, other in TAKES.items() if name in other.needed + other.optional]
            yield name, f"only for kind {' or '.join(repr(kind) for kind in kinds)}, not '{word}'"
        elif not math.isfinite(value) or not low <= value <= high:
            yield name, f"{value:g}; allowed: {low:g} to {high:g}"
        elif name == "every" and value != round(value):
            yield name, f"{value:g}; allowed: a whole number"
    for name in takes.needed:
        if name not in said:
            yield name, f"missing; kind '{word}' needs it"
    if word in ("wrong", "biased") and not {"bias", "scale"} & set(said):
        yield "bias", f"missing; kind '{word}' needs it" + (", or scale" if word == "wrong" else "")
    if word == "noisy" and len({"std", "times"} & set(said)) != 1:
        yield "std", "kind 'noisy' needs std or times, one of the two"
    if "times" in said and not all(_white(name, white or {}) for name in chosen_fields(field, fields)):
        known = ", ".join(name for name in white or {} if _white(name, white or {}))
        yield "times", f"the sensor states no white noise of '{field:.60}'{known and ', only of '}{known}; give std"
    if word == "intermittent" and set(said) not in ({"share"}, {"on", "off"}):
        yield "share", "kind 'intermittent' needs it alone, or on and off"
    if word == "intermittent" and said.get("on", 1.0) + said.get("off", 1.0) <= 0.0:
        yield "on", "on and off are both 0 s"
    if not takes.field:
        if field is not None:
            yield "field", f"only for kinds of one field, not '{word}'"
    elif field is None:
        yield "field", f"missing; kind '{word}' needs one of {', '.join(fields)}"
    elif not chosen_fields(field, fields):
        yield "field", f"the sensor does not report '{field:.60}'{did_you_mean(field, fields)}"


def fault_numbers(
    word: str,
    given: Mapping[str, float | None],
    chosen: Sequence[str],
    fields: Sequence[str],
    dt: float,
    ticks: int,
    white: Mapping[str, object] | None = None,
) -> FaultNumbers:
    """Return a sensor fault's numbers as the simulation uses them, defaults for missing ones.

    Args:
        word: its kind.
        given: by name; None or absent: not given.
        chosen: fields that they are of.
        fields: fields that amounts and scales are for.
        dt: time step [s].
        ticks: between two readings.
        white: white noise of the sensor, by field.
    """
    kind = kind_of(word)

    def number(name: str, default: float) -> float:
        """Return the fault's number ``name`` as given, or ``default``."""
        value = given.get(name)
        return default if value is None else float(value)

    amount = {"wrong": number("bias", 0.0), "drift": number("rate", 0.0), "noisy": number("std", 0.0)}
    amount["garbage"] = number("range", 0.0)
    scale = 0.0 if kind == "garbage" else number("scale", 1.0)
    spreads = {name: amount.get(kind, 0.0) for name in chosen}
    if given.get("times") is not None:
        # Independent noise adds by its squares.
        more = math.sqrt(number("times", 1.0) ** 2 - 1.0)
        spreads = {name: more * (_white(name, white or {}) or 0.0) for name in chosen}
    amounts = tuple(spreads.get(name, 0.0) for name in fields)
    scales = tuple(scale if name in chosen else 1.0 for name in fields)
    # Delays are rounded up to whole readings; the on and off times of intermittent faults to whole ticks.
    counts = (number("every", 1.0), number("by", 0.0) / dt / ticks, number("on", 0.0) / dt, number("off", 0.0) / dt)
    every, late, on, off = (np.array(min(math.ceil(count - 1e-6), 2**30 - 1), np.int32) for count in counts)
    parts = [amounts, scales, number("limit", math.inf), number("share", 0.0), every, late, on, off]
    return record_of(FaultNumbers, *parts)


def _white(name: str, white: Mapping[str, Any]) -> float | None:
    """Return the std of a field's white noise; None unless the sensor states one number for it."""
    found = next((value for part, value in white.items() if name == part or name.startswith(f"{part}.")), None)
    if found is None or np.ndim(found):
        return None
    # In six digits, so that it is the same before and after it was rounded to single precision.
    return float(f"{float(found):.6g}")


def empty_slot(count: int, sensor: str, fields: tuple[str, ...], ticks: int, dt: float, remembered: int) -> FaultSlot:
    """Return an empty slot for faults injected in flight into a sensor of ``count`` vehicles; see ``FaultSlot``."""
    never, nobody = np.full(count, LAST_TICK, np.int32), np.zeros(count, bool)
    numbers = map_tree(lambda leaf: np.full(count, leaf), fault_numbers("off", {}, (), fields, dt, ticks))  # type: ignore
    kinds = np.zeros(count, np.int32)
    return record_of(FaultSlot, never, never, nobody, numbers, sensor, fields, ticks, dt, remembered, kinds=kinds)
