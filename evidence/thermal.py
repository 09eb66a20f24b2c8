"""What a thermal does for a fixed wing with its motor off: the glides of examples/thermal.py."""

from __future__ import annotations

from typing import Any

import numpy as np
from examples import thermal

from evidence import IMAGES
from evidence._pictures import picture

DOC = "height gained or lost by a fixed wing with its motor off, in a thermal and out of it"
SEED = 1
PICTURE = IMAGES / "thermal.png"
GLIDES: dict[str, dict[str, Any]] = {"centred": {}, "circling": {"centres": False}, "still_air": {"updrafts": []}}
WORDS = {"centred": "centring", "circling": "circling, without centring", "still_air": "without a thermal"}
COLOURS = {"centred": "tab:blue", "circling": "tab:orange", "still_air": "0.5"}


def draw(glides: dict[str, Any]) -> None:
    """Write docs/images/thermal.png: the way of the centred glide, and the heights of all."""
    with picture(PICTURE, (11.0, 4.8), 1, 2, dpi=90) as (seen, heights):
        way = glides["centred"]["position"]
        points = seen.scatter(way[:, 1], way[:, 0], c=-way[:, 2], s=2.0, cmap="viridis")
        seen.plot(0.0, 0.0, "k+", markersize=10, label="thermal at the start")
        seen.set(xlabel="east [m]", ylabel="north [m]", aspect="equal", title="the way of the centring wing")
        seen.legend(loc="upper left")
        seen.figure.colorbar(points, ax=seen, label="height [m]")
        for name, glide in glides.items():
            heights.plot(glide["time"], -glide["position"][:, 2], color=COLOURS[name], label=WORDS[name])
        heights.set(xlabel="time [s]", ylabel="height [m]", ylim=(0.0, None), title="motor off, from 300 m")
        heights.legend(loc="upper left")


def run(full: bool) -> dict[str, Any]:
    """Return the mean climb of each glide until it ends [m/s], and how long it lasts; the small form is a minute."""
    glides = {name: thermal.glide(600.0 if full else 60.0, **parts) for name, parts in GLIDES.items()}
    if full:
        draw(glides)
    found = {}
    for name, glide in glides.items():
        height, time = -glide["position"][:, 2], glide["time"]
        found[name] = {
            "seconds": float(time[-1]),
            "climb_m_s": float((height[-1] - height[0]) / (time[-1] - time[0])),
            "height_m": float(height[-1]),
            "air_m_s": float(-np.mean(glide["wind"][:, 2])),
        }
    return found
