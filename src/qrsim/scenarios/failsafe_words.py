"""Words for the numbers of PX4's parameters in a scenario."""

from __future__ import annotations

from typing import Any

from qrsim.control.failsafes import WORDS


def words_for_numbers(value: object) -> Any:
    """Return the failsafes of a fleet with words in place of PX4's numbers; other values are left to the schema."""
    if not isinstance(value, dict):
        return value
    found = dict(value)
    for name, words in WORDS.items():
        given = found.get(name)
        if isinstance(given, int | float) and not isinstance(given, bool):
            found[name] = next((word for word, number in words.items() if number == given), given)
    return found
