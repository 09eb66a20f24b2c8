"""Modes by PX4's custom_mode (main mode times 2^16, sub mode times 2^24), as mavros and as PX4's messages name them."""

from __future__ import annotations

# mavros, lib/uas_stringify.cpp.
_NAMES = {
    (1, 0): "MANUAL",
    (2, 0): "ALTCTL",
    (3, 0): "POSCTL",
    (5, 0): "ACRO",
    (6, 0): "OFFBOARD",
    (7, 0): "STABILIZED",
    (8, 0): "RATTITUDE",
    (4, 1): "AUTO.READY",
    (4, 2): "AUTO.TAKEOFF",
    (4, 3): "AUTO.LOITER",
    (4, 4): "AUTO.MISSION",
    (4, 5): "AUTO.RTL",
    (4, 6): "AUTO.LAND",
    (4, 7): "AUTO.RTGS",
    (4, 8): "AUTO.FOLLOW_TARGET",
    (4, 9): "AUTO.PRECLAND",
}
# px4_msgs, VehicleStatus.NAVIGATION_STATE_*.
_STATES = {
    (1, 0): 0,
    (2, 0): 1,
    (3, 0): 2,
    (4, 4): 3,
    (4, 3): 4,
    (4, 5): 5,
    (5, 0): 10,
    (6, 0): 14,
    (7, 0): 15,
    (4, 2): 17,
    (4, 6): 18,
    (4, 8): 19,
    (4, 9): 20,
    (3, 1): 21,
}
_NUMBERS = {name: main << 16 | sub << 24 for (main, sub), name in _NAMES.items()}
NAV_STATES = {state: numbers for numbers, state in _STATES.items()}
# NAVIGATION_STATE_AUTO_LOITER and TERMINATION.
LOITER, TERMINATED = 4, 13


def _mode_parts(custom_mode: int) -> tuple[int, int]:
    """Split PX4's custom_mode number into main mode and sub-mode."""
    return custom_mode >> 16 & 255, custom_mode >> 24 & 255


def name_of(custom_mode: int) -> str:
    """Return mavros's name for PX4's custom_mode number, such as "OFFBOARD"; "CMODE(number)" for an unknown one."""
    parts = _mode_parts(custom_mode)
    # A sub mode that it does not know counts for nothing.
    return _NAMES.get(parts) or _NAMES.get((parts[0], 0)) or f"CMODE({custom_mode})"


def number_of(name: str) -> int | None:
    """Return PX4's custom_mode for mavros's name of a mode, or for a number in text, as mavros parses it; None for
    other texts."""
    if name in _NUMBERS:
        return _NUMBERS[name]
    return int(name) if name.isascii() and name.isdigit() and len(name) < 11 else None


def nav_state(custom_mode: int) -> int:
    """Return PX4's NAVIGATION_STATE for a custom_mode number; that of loiter for an unknown one."""
    return _STATES.get(_mode_parts(custom_mode), LOITER)
