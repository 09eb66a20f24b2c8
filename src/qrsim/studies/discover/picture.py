"""The figure: Pareto fronts, and the held-out part flown by the laws."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from qrsim.runs.picture import new_figure
from qrsim.studies.discover.discovery import Discovery
from qrsim.studies.flight_logs import SIGNALS


def draw(found: Discovery) -> Figure:
    """Draw recorded and predicted channels over the held-out part of a log."""
    rows = len(found.names)
    figure = new_figure(12.0, 1.8 * rows + 1.0)
    halves: Any = figure.subfigures(1, 2, width_ratios=(1, 2))
    left, right = halves
    fronts = np.atleast_1d(left.subplots(len(found.laws), 1))
    for panel, law in zip(fronts, found.laws.values(), strict=True):
        nodes, errors = zip(*law.front, strict=True)
        panel.semilogy(nodes, errors, "o-", color="tab:blue")
        panel.semilogy(law.chosen.size, law.chosen.error, "o", color="tab:red", ms=9, label="chosen")
        panel.set_title(law.name)
        panel.set_ylabel("error")
        panel.grid(alpha=0.3)
    fronts[0].legend(fontsize=9)
    fronts[-1].set_xlabel("nodes")
    panels = np.atleast_1d(right.subplots(rows, 1, sharex=True))
    time = found.dt * np.arange(found.flights["recorded"].shape[1])
    colours = {"recorded": "black", "published": "tab:blue", "discovered": "tab:red"}
    for c, (panel, name) in enumerate(zip(panels, found.names, strict=True)):
        for which, colour in colours.items():
            panel.plot(time, found.flights[which][c], color=colour, lw=0.9, label=which)
        panel.set_ylabel(f"{name.replace('_', chr(10))}\n[{SIGNALS[name].unit}]")
        panel.grid(alpha=0.3)
    panels[0].legend(loc="upper right", ncols=3, fontsize=8)
    panels[-1].set_xlabel("time in the held-out part [s], open loop")
    return figure
