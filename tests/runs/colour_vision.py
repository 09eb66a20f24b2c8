"""Colours as they are seen with all cones, without the medium ones, and without the long ones; and how far apart.

CIEDE2000 by Sharma, Wu and Dalal, "The CIEDE2000 color-difference formula", Color Research & Application 30 (2005),
with their numbers of equations; what dichromats see by Machado, Oliveira and Fernandes, "A Physiologically-based Model
for Simulation of Color Vision Deficiency", IEEE TVCG 15 (2009), table 1, severity 1.
"""

from __future__ import annotations

from typing import Any

import numpy as np

Floats = np.ndarray[Any, Any]
# From linear sRGB to linear sRGB.
VISIONS = {
    "normal": np.eye(3),
    "deuteranope": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "protanope": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
}
# IEC 61966-2-1: from linear sRGB to CIE XYZ, and its white, D65.
_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
_WHITE = _XYZ.sum(axis=1)


def linear(colours: Floats) -> Floats:
    """Return linear sRGB (..., 3), 0 to 1, of colours (..., 3), 0 to 255."""
    share = np.asarray(colours, float) / 255.0
    return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)


def seen(colours: Floats, vision: str) -> Floats:
    """Return CIE L*a*b* (..., 3) of sRGB colours (..., 3), 0 to 255, as somebody with a vision sees them."""
    shown = np.clip(linear(colours) @ VISIONS[vision].T, 0.0, 1.0)
    share = shown @ _XYZ.T / _WHITE
    root = np.where(share > (6.0 / 29.0) ** 3, np.cbrt(share), share * (29.0 / 6.0) ** 2 / 3.0 + 4.0 / 29.0)
    x, y, z = np.moveaxis(root, -1, 0)
    return np.stack([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)], axis=-1)


def ciede2000(one: Floats, other: Floats) -> Floats:
    """Return the CIEDE2000 differences (...) of L*a*b* colours (..., 3)."""
    (l1, a1, b1), (l2, a2, b2) = (np.moveaxis(np.asarray(lab, float), -1, 0) for lab in (one, other))
    mean = 0.5 * (np.hypot(a1, b1) + np.hypot(a2, b2))
    stretch = 1.5 - 0.5 * np.sqrt(mean**7 / (mean**7 + 25.0**7))  # (4), 1 + G
    c1, c2 = np.hypot(stretch * a1, b1), np.hypot(stretch * a2, b2)  # (6)
    h1, h2 = (np.degrees(np.arctan2(b, stretch * a)) % 360.0 for a, b in ((a1, b1), (a2, b2)))  # (7)
    both = c1 * c2 != 0.0
    turn = np.where(both, (h2 - h1 + 180.0) % 360.0 - 180.0, 0.0)  # (10)
    d_l, d_c, d_h = l2 - l1, c2 - c1, 2.0 * np.sqrt(c1 * c2) * np.sin(np.radians(turn) / 2.0)  # (8), (9), (11)
    level, c = 0.5 * (l1 + l2), 0.5 * (c1 + c2)  # (12), (13)
    far = np.abs(h1 - h2) > 180.0
    h = np.where(both, 0.5 * (h1 + h2 + np.where(far, np.where(h1 + h2 < 360.0, 360.0, -360.0), 0.0)), h1 + h2)  # (14)
    t = (
        1.0 - 0.17 * _cos(h - 30.0) + 0.24 * _cos(2.0 * h) + 0.32 * _cos(3.0 * h + 6.0) - 0.20 * _cos(4.0 * h - 63.0)
    )  # (15)
    r_c = 2.0 * np.sqrt(c**7 / (c**7 + 25.0**7))  # (17)
    s_l = 1.0 + 0.015 * (level - 50.0) ** 2 / np.sqrt(20.0 + (level - 50.0) ** 2)  # (18)
    s_c, s_h = 1.0 + 0.045 * c, 1.0 + 0.015 * c * t  # (19), (20)
    r_t = -np.sin(np.radians(60.0 * np.exp(-(((h - 275.0) / 25.0) ** 2)))) * r_c  # (16), (21)
    x, y, z = d_l / s_l, d_c / s_c, d_h / s_h
    found: Floats = np.sqrt(x**2 + y**2 + z**2 + r_t * y * z)  # (22)
    return found


def _cos(degrees: Floats) -> Floats:
    return np.cos(np.radians(degrees))


def smallest(colours: Floats, vision: str) -> float:
    """Return the smallest difference of any two of n colours (n, 3), 0 to 255."""
    lab = seen(colours, vision)
    apart = ciede2000(lab[:, None], lab[None])
    return float(apart[~np.eye(len(lab), dtype=bool)].min())
