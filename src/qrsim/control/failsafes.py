"""Decisions of failsafes: the action on a low battery, a lost link, a lost fix and a lost position, as in PX4.

Plain runs, sweeps and the flight stack of ``qrsim mavlink`` call the same functions. They take Python numbers and JAX
arrays, because they use operators only.

Source: PX4-Autopilot, src/modules/commander/failsafe/failsafe.cpp and framework.cpp.
"""

from __future__ import annotations

from typing import Any

import numpy as np

# Actions, the graver the later; of two the graver counts.
NOTHING, HOLD, RETURN, LAND, DESCEND, DISARM, TERMINATE = range(7)
ACTIONS = ("no action", "hold", "return", "land", "descend", "disarm", "terminate")
# Levels of a battery.
LEVELS = ("normal", "low", "critical", "emergency")
LOW, CRITICAL, EMERGENCY = 1, 2, 3
# Words of scenarios for PX4's numbers, by parameter.
WORDS: dict[str, dict[str, int]] = {
    "COM_LOW_BAT_ACT": {"warn": 0, "land": 2, "return_or_land": 3},
    "NAV_DLL_ACT": {"none": 0, "hold": 1, "return": 2, "land": 3},
    "COM_GNSSLOSS_ACT": {"warn": 0, "return": 1, "land": 2},
}
# Actions by the numbers of the parameters; of COM_LOW_BAT_ACT at a critical level, and at an emergency.
_ON_BATTERY = {2: (LAND, LAND), 3: (RETURN, LAND)}
_ON_LINK = {1: HOLD, 2: RETURN, 3: LAND, 5: TERMINATE, 6: DISARM}
_ON_FIX = {1: RETURN, 2: LAND}


def battery_level(charge: Any, low: Any, critical: Any, emergency: Any) -> Any:
    """Return a battery's level by its charge: 0 normal, 1 low, 2 critical, 3 emergency; 0 if the charge is NaN.

    Args:
        charge: charge of the battery, 0 to 1.
        low, critical, emergency: thresholds BAT_LOW_THR, BAT_CRIT_THR and BAT_EMERGEN_THR.
    """
    return _as_int(charge <= low) * (1 + _as_int(charge <= critical) + _as_int(charge <= emergency))


def battery_action(level: Any, low_bat_act: int) -> Any:
    """Return the failsafe action (an index of ``ACTIONS``) at a battery level, for a value of COM_LOW_BAT_ACT."""
    at_critical, at_emergency = _ON_BATTERY.get(low_bat_act, (NOTHING, NOTHING))
    return _as_int(level == CRITICAL) * at_critical + _as_int(level >= EMERGENCY) * at_emergency


def link_action(lost: object, dll_act: int) -> Any:
    """Return the failsafe action (an index of ``ACTIONS``) if a link is lost, for a NAV_DLL_ACT or NAV_RCL_ACT."""
    return _as_int(lost) * _ON_LINK.get(dll_act, NOTHING)


def fix_action(lost: object, gnssloss_act: int) -> Any:
    """Return the failsafe action (an index of ``ACTIONS``) if the GNSS fix is lost, for a value of COM_GNSSLOSS_ACT."""
    return _as_int(lost) * _ON_FIX.get(gnssloss_act, NOTHING)


def position_action(lost: object) -> Any:
    """Return the failsafe action (an index of ``ACTIONS``) if the position estimate is lost: descend, else 0."""
    return _as_int(lost) * DESCEND


def is_lost(silence: Any, after: Any) -> Any:
    """Return whether a source has been silent, for ``silence`` [s], longer than ``after`` [s]."""
    return silence > after


def graver(one: Any, other: Any) -> Any:
    """Return the more severe of two failsafe actions, the one with the larger number, elementwise."""
    return one + _as_int(other > one) * (other - one)


def _as_int(flag: Any) -> Any:
    """Return a bool or a bool array as an int 0 or 1, or an int32 array."""
    return int(flag) if isinstance(flag, bool) else flag.astype(np.int32)
