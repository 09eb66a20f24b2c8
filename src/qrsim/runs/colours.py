"""What each colour means, on the page, in figures and in exports: sRGB, 0 to 255.

Nothing else is red but what has stopped. The first ten are told apart by deuteranopes and protanopes too
(docs/reference/view_layers.md, evidence/colours.py).
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from qrsim.core.arrays import Floats

Colour = tuple[int, int, int]

# Vehicles, in their order, while they are few; else fleets.
VEHICLES = np.array(
    [
        (55, 114, 247),
        (231, 139, 1),
        (12, 146, 97),
        (91, 56, 178),
        (90, 168, 242),
        (136, 55, 57),
        (181, 102, 159),
        (127, 189, 125),
        (110, 172, 157),
        (65, 114, 114),
    ],
    np.uint8,
)
STOPPED: Colour = (197, 19, 12)
MISSING: Colour = (245, 208, 13)
FOUND: Colour = (12, 82, 87)
GUST: Colour = (188, 115, 43)
PLUME: Colour = (142, 4, 81)
# Zones to stay out of; in figures hatched, on the page with walls.
KEEP_OUT: Colour = (120, 72, 24)
# What has no meaning of its own: area, estimates, what is true in a plot.
GREY: Colour = (115, 115, 118)
# From calm to strong, each darker than the one before.
WIND = np.array([(165, 208, 216), (115, 166, 197), (86, 126, 178), (76, 86, 152), (75, 45, 116)], np.float64)
# From against a person to for one, over nothing known.
RATIO = np.array([(20, 50, 130), (120, 138, 175), (216, 216, 216), (232, 212, 110), MISSING], np.float64)


def share(colour: Iterable[float]) -> tuple[float, float, float]:
    """Return a colour of three bytes, 0 to 255, as fractions from 0 to 1."""
    red, green, blue = (float(part) / 255.0 for part in colour)
    return red, green, blue


def on_scale(scale: Floats, part: Floats) -> Floats:
    """Interpolate in a colour scale (K, 3) at positions (n,), clipped to 0 to 1; return colours (n, 3), uint8."""
    place = np.clip(part, 0.0, 1.0) * (len(scale) - 1)
    steps = np.arange(len(scale))
    return np.stack([np.interp(place, steps, scale[:, i]) for i in range(3)], axis=1).astype(np.uint8)
