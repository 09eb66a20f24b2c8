"""Numbers of faults of rotors, batteries, radios and links, of scenarios and injections: what each kind takes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from qrsim.core.arrays import is_number
from qrsim.errors import UsageError

# Of each kind the number that it takes, from 0 to 1; None: it takes none.
ROTOR: dict[str, str | None] = {"off": None, "weak": "health", "stuck": "speed"}
BATTERY: dict[str, str | None] = {"drop": "charge", "weak": "health"}
RADIO: dict[str, str | None] = {"off": None, "weak": "share"}
LINK: dict[str, str | None] = {"off": None}
PARTS = {"rotor": ROTOR, "battery": BATTERY, "radio": RADIO, "link": LINK}
# Smallest health of a weak battery.
WEAKEST_BATTERY = 0.05


def number_of(what: str, kind: object, numbers: Mapping[str, Any]) -> float:
    """Return the number of a fault; 0 of a kind without one.

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
