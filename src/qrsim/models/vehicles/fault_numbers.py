"""Numbers of faults of rotors, batteries, radios and links, and of pushes, of scenarios and injections."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from qrsim.core.arrays import is_number
from qrsim.errors import UsageError, did_you_mean

# Of each kind the number that it takes, from 0 to 1; None: it takes none.
ROTOR: dict[str, str | None] = {"off": None, "weak": "health", "stuck": "speed"}
BATTERY: dict[str, str | None] = {"drop": "charge", "weak": "health"}
RADIO: dict[str, str | None] = {"off": None, "weak": "share"}
LINK: dict[str, str | None] = {"off": None}
# Those of a push are accelerations, see ``push_numbers``.
BODY: dict[str, str | None] = {"push": "push"}
PARTS = {"rotor": ROTOR, "battery": BATTERY, "radio": RADIO, "link": LINK, "body": BODY}
# Numbers of a push: accelerations of three axes [m/s^2], at most so large.
PUSH = ("acceleration_ned", "acceleration_body")
MOST_PUSH = 1000.0
AXES = ("x", "y", "z")
# Smallest health of a weak battery.
WEAKEST_BATTERY = 0.05


def number_of(what: str, kind: object, numbers: Mapping[str, Any]) -> float:
    """Return the number that a kind of fault of a part such as "rotor" needs; 0 for kinds without a number.

    Args:
        what: "rotor", "battery", "radio" or "link".
        kind: what happens to it.
        numbers: by name.

    Raises:
        UsageError: the kind does not suit, or its number is missing, out of range, or not one that it takes.
    """
    kinds = PARTS[what]
    if not isinstance(kind, str) or kind not in kinds:
        raise UsageError(f"kind: '{str(kind)[:60]}' does not suit a {what}; allowed: {', '.join(kinds)}, ok")
    taken = kinds[kind]
    for name in numbers:
        if name != taken:
            raise UsageError(f"{name:.60}: kind '{kind}' does not take it" + (f"; it takes {taken}" if taken else ""))
    if taken is None:
        return 0.0
    low = WEAKEST_BATTERY if (what, kind) == ("battery", "weak") else 0.0
    value = numbers.get(taken)
    if value is None:
        raise UsageError(f"{taken}: missing; kind '{kind}' needs it, {low:g} to 1")
    if not is_number(value) or not low <= value <= 1.0:
        raise UsageError(f"{taken}: {value!r:.60}; allowed: {low:g} to 1")
    return float(value)


def push_numbers(kind: object, numbers: Mapping[str, Any]) -> dict[str, list[float]]:
    """Return the accelerations [m/s^2] of a push, each a list of 3 numbers, by the names in ``PUSH``.

    Args:
        kind: ``push``.
        numbers: ``acceleration_ned`` or ``acceleration_body``, each of three axes, or ``acceleration_ned.x`` and such
            of one axis, where the others are 0.

    Raises:
        UsageError: another kind, or a number that is missing, unknown or out of range.
    """
    if kind != "push":
        raise UsageError(f"kind: '{str(kind)[:60]}' does not suit a body; allowed: push, ok")
    found: dict[str, list[float]] = {}
    for name, value in numbers.items():
        base, dot, axis = str(name).partition(".")
        if base not in PUSH or (dot and axis not in AXES):
            known = (*PUSH, *(f"{each}.{letter}" for each in PUSH for letter in AXES))
            raise UsageError(f"{name!s:.60}: there is no such number{did_you_mean(str(name)[:60], known)}")
        if dot and base in numbers:
            raise UsageError(f"{name}: {base} is given too")
        row = [value] if dot else value.tolist() if isinstance(value, np.ndarray) else value
        if not isinstance(row, list | tuple) or len(row) != (1 if dot else 3):
            raise UsageError(f"{name}: {value!r:.60}; allowed: a list of 3 numbers [m/s^2]")
        for one in row:
            if not is_number(one) or not -MOST_PUSH <= one <= MOST_PUSH:
                raise UsageError(f"{name}: {one!r:.60}; allowed: {-MOST_PUSH:g} to {MOST_PUSH:g} m/s^2")
        axes = found.setdefault(base, [0.0, 0.0, 0.0])
        first = AXES.index(axis) if dot else 0
        axes[first : first + len(row)] = map(float, row)
    if not found:
        raise UsageError("acceleration_ned: missing; a push needs it, or acceleration_body [m/s^2]")
    return found
