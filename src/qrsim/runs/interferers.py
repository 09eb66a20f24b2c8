"""Jammers, spoofers and discs of a world as pictures show them, and what else keeps satellites from receivers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.files import Content
from qrsim.models.gnss.geometry import LOST
from qrsim.models.gnss.interference import strength
from qrsim.models.gnss.slots import SlottedSky
from qrsim.world.state import World

# What has no end ends here or later [s], and what is heard everywhere is heard within this or more [m].
_FOREVER, _EVERYWHERE = 1e8, 1e8
# Gain of an antenna that looks up, towards a jammer below it.
_FROM_BELOW = 10.0**-0.5


class Interferer(NamedTuple):
    """What interferes with receivers.

    Attributes:
        kind: as in a scenario: jammer, disc, spoofer, outage or iono_storm.
        place_ned: (3,) [m]; None where it has no place.
        radius: within which satellites are lost or a spoofer is heard [m]: of a jammer, by a receiver above it that had
            45 dB-Hz, with nothing between; infinite: everywhere.
        start, end: when it acts [s]; infinite: to the end of the run.
        text: what it is, in few words.
    """

    kind: str
    place_ned: Floats | None
    radius: float
    start: float
    end: float
    text: str

    @property
    def when(self) -> str:
        """Times at which the interferer is on, as text; "" if always."""
        if math.isfinite(self.end):
            return f"{self.start:g} to {self.end:g} s"
        return f"from {self.start:g} s" if self.start > 0.0 else ""

    @property
    def label(self) -> str:
        """Kind and times of the interferer as text."""
        return f"{self.text}, {self.when}" if self.when else self.text

    def acts(self, time: float) -> bool:
        """Return whether the interferer is on at a time [s]."""
        return self.start - 1e-6 <= time < self.end - 1e-6


def of_scenario(entries: Sequence[Content] | None) -> tuple[Interferer, ...]:
    """Return the interferers (jammers, spoofers, outages) under ``world.interference`` of a recorded scenario."""
    return tuple(_parsed_interferer(str(entry["kind"]), entry) for entry in entries or ())


def of_world(world: World) -> tuple[Interferer, ...]:
    """Return the interferers (jammers, spoofers, outages) of a World, those without a position last."""
    present = world.sky.interference if isinstance(world.sky, SlottedSky) else None
    if present is None:
        return ()
    parts = {
        "jammer": present.jammers,
        "disc": present.discs,
        "spoofer": present.spoofers,
        "outage": present.outages,
        "iono_storm": present.storms,
    }
    return tuple(_parsed_interferer(kind, vars(item)) for kind, items in parts.items() for item in items)


def _parsed_interferer(kind: str, values: Content) -> Interferer:
    """Return an interferer of a ``kind``, such as "jammer", from its values in a recorded scenario."""

    def number(name: str, instead: float) -> float:
        """Return the value of a key as a number; ``instead`` if it is missing or unlimited."""
        value = values.get(name)
        return instead if value is None or abs(float(value)) >= _EVERYWHERE else float(value)

    place = np.asarray(values["position_ned"], np.float64) if "position_ned" in values else None
    end = number("end", math.inf)
    radius, text = math.inf, kind.replace("_", " ")
    if kind == "jammer":
        power = number("power_w", 0.0)
        radius, text = lost_within(power, str(values.get("band", "wide"))), f"jammer {_format_power(power)}"
    elif kind in ("disc", "spoofer"):
        radius = number("radius", math.inf)
        # The place of a spoofer is the middle of where it is heard.
        place = place if math.isfinite(radius) else None
        text = {"disc": "no satellites", "spoofer": "spoofer"}[kind]
    elif kind == "outage":
        which = values.get("systems") or ", ".join(_names(values.get("satellites")))
        text = f"outage of {which}" if which else "outage"
    return Interferer(kind, place, radius, number("start", 0.0), end if end < _FOREVER else math.inf, text)


def _names(satellites: object) -> list[str]:
    """Return the texts in a recorded list of satellites; [] if they are given by number."""
    return [name for name in satellites if isinstance(name, str)] if isinstance(satellites, list | tuple) else []


def lost_within(power_w: float, band: str) -> float:
    """Return the distance [m] within which a receiver above a jammer loses satellites of 45 dB-Hz."""
    return math.sqrt(float(strength(power_w, band)) * _FROM_BELOW / (LOST - 1.0))


def _format_power(power: float) -> str:
    """Format a power [W] as text with a suitable prefix, such as mW."""
    return f"{power:g} W" if power >= 1.0 else f"{1e3 * power:g} mW" if power >= 1e-3 else f"{1e6 * power:g} uW"
