"""Plausibility limits: wide ranges of the quantities that constants imply together.

Multirotors from 30 g to 100 kg have attitude loops of 2 to 40 rad/s that are damped by 0.3 to 2, angles within 30 % of
what is asked for, and full throttle that lifts 1.3 to 8 times the weight.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from qrsim.models.vehicles.quadrotor import PITCH_ROLL_RAD_PER_RAW, THROTTLE_RAW_PER_UNIT, YAW_RATE_RAD_S_PER_RAW
from qrsim.studies.identify.constants import PITCH, ROLL

GRAVITY = 9.81
Values = Mapping[str, float]


@dataclass(frozen=True)
class Meaning:
    """A physical quantity that several constants imply together.

    Attributes:
        constants: that it depends on.
        words: what it is, with its unit.
        low, high: what is believed.
        of: the value.
    """

    constants: tuple[str, ...]
    words: str
    low: float
    high: float
    of: Callable[[Values], float]


def thrust(values: Values, throttle: float) -> float:
    """Return the steady thrust [N] of a vehicle with given constants at a throttle (0 to 1)."""
    raw = throttle * THROTTLE_RAW_PER_UNIT
    return values["cth0"] + raw * (values["cth1"] + raw * values["cth2"])


def _thrust_to_weight(values: Values, throttle: float) -> float:
    """Return the steady thrust divided by the weight at a throttle (0 to 1), from a vehicle's constants."""
    return thrust(values, throttle) / (GRAVITY * values["mass"])


def _tilt_meanings(axis: str, names: tuple[str, ...]) -> Iterator[Meaning]:
    """Yield the physical quantities that the constants of pitch or roll imply: gain, natural frequency, damping."""
    gain, stiffness, damping = names
    yield Meaning(
        (gain,), f"{axis} per angle asked for [rad/rad]", 0.3, 3.0, lambda v: v[gain] / PITCH_ROLL_RAD_PER_RAW
    )
    yield Meaning(
        (stiffness,), f"natural frequency of {axis} [rad/s]", 1.0, 60.0, lambda v: math.sqrt(max(v[stiffness], 0.0))
    )
    yield Meaning(
        (stiffness, damping),
        f"damping ratio of {axis} [1]",
        0.1,
        3.0,
        lambda v: -v[damping] / (2.0 * math.sqrt(max(v[stiffness], 1e-12))),
    )


MEANINGS: tuple[Meaning, ...] = (
    *_tilt_meanings("roll", ROLL),
    *_tilt_meanings("pitch", PITCH),
    Meaning(("kr1",), "time constant of the yaw rate [s]", 0.02, 5.0, lambda v: 1.0 / max(-v["kr1"], 1e-12)),
    Meaning(
        ("kr0", "kr1"),
        "yaw rate per rate asked for [1]",
        0.1,
        3.0,
        lambda v: v["kr0"] / YAW_RATE_RAD_S_PER_RAW / max(-v["kr1"], 1e-12),
    ),
    Meaning(("kuv",), "time constant of drag along x and y [s]", 0.2, 200.0, lambda v: 1.0 / max(-v["kuv"], 1e-12)),
    Meaning(("kw",), "time constant of drag along z [s]", 0.1, 200.0, lambda v: 1.0 / max(-v["kw"], 1e-12)),
    Meaning(("cth0",), "thrust without throttle over the weight [1]", -0.5, 0.5, lambda v: _thrust_to_weight(v, 0.0)),
    Meaning(
        ("cth0", "cth1", "cth2"),
        "thrust at full throttle over the weight [1]",
        1.05,
        15.0,
        lambda v: _thrust_to_weight(v, 1.0),
    ),
    Meaning(
        ("cth1", "cth2"),
        "thrust that the upper half of the throttle adds, over the weight [1]",
        0.1,
        15.0,
        lambda v: _thrust_to_weight(v, 1.0) - _thrust_to_weight(v, 0.5),
    ),
    Meaning(("tau0",), "response of thrust below the least throttle [1/s]", 0.05, 100.0, lambda v: v["tau0"]),
    Meaning(
        ("tau1",),
        "fastest change of thrust, in weights a second [1/s]",
        0.2,
        100.0,
        lambda v: v["tau1"] / (GRAVITY * v["mass"]),
    ),
)


def implausible(values: Values, fitted: tuple[str, ...]) -> dict[str, str]:
    """Return constant -> sentence, for fitted constants that imply a physical quantity out of plausible limits.

    Args:
        values: every constant by name; those of pitch only if it has its own.
        fitted: the constants that were, which alone are judged.
    """
    found: dict[str, str] = {}
    for meaning in MEANINGS:
        judged = [name for name in meaning.constants if name in fitted]
        if not judged or not set(meaning.constants) <= set(values):
            continue
        value = meaning.of(values)
        if not meaning.low <= value <= meaning.high:
            why = f"{meaning.words} would be {value:.3g}; {meaning.low:g} to {meaning.high:g} is believed"
            found |= {name: why for name in judged if name not in found}
    return found
