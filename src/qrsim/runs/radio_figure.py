"""The figure of a run's radio: the graph of who heard whom, delivery, and how connected the vehicles were."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from qrsim.core.arrays import Floats
from qrsim.errors import UsageError
from qrsim.runs.picture import colours_of, new_figure, time_limits, title_of
from qrsim.runs.radio_columns import LOGGED_LINKS
from qrsim.runs.radio_links import Connectivity, Packets, connectivity, packets_of, radios_of
from qrsim.runs.reader import Run
from qrsim.runs.summary import stops_of

RADIO = "radio"
# Bins of time, of which each has as many periods.
BINS = 60
# With more vehicles names would hide the graph.
MOST_NAMED = 20
STYLES = {"too weak": (0, (1, 1)), "by chance": "--", "to others": "-."}


def draw_radio(run: Run, vehicles: Sequence[str] = (), start: float | None = None, end: float | None = None) -> Figure:
    """Draw the graph of received radio packets in a span of time [s], and delivery and connectivity over time.

    Args:
        run: of a scenario with ``world.radio``.
        vehicles: none: a network is drawn as a whole.
        start, end: span of time [s], both included; None for the whole run.

    Raises:
        UsageError: no radio, vehicles were named, or no period in the span.
        RunError: nothing was recorded yet.
    """
    if vehicles:
        raise UsageError(f"--panel {RADIO} is of all vehicles together; leave out --vehicle")
    packets = packets_of(run, start, end)
    figure = new_figure(13, 6.5)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.25, 1))
    graph, delivery, parts = (figure.add_subplot(grid[place]) for place in (np.s_[:, 0], np.s_[0, 1], np.s_[1, 1]))
    _graph(figure, graph, run, packets)
    found = connectivity(packets, BINS, radios_of(run))
    _draw_delivery(delivery, found)
    _draw_groups(parts, found)
    for axes in (delivery, parts):
        time_limits(axes, float(packets.time[0]), float(packets.time[-1]))
    span = f"{packets.time[0]:g} to {packets.time[-1]:g} s"
    last = float(run["measurements"].time[-1])
    each = f"; packets of the {LOGGED_LINKS} nearest of each" if len(run.vehicles) > LOGGED_LINKS + 1 else ""
    title = title_of(run, run.vehicles, len(stops_of(run)), last)
    figure.suptitle(f"{title}\nradio {run.scenario['world']['radio']['preset']}, {span}{each}")
    return figure


def _graph(figure: Figure, axes: Axes, run: Run, packets: Packets) -> None:
    """Draw vehicles at their last positions, and each link's received packets as a half-line at the receiver's end."""
    truth = run["truth"]
    row = np.searchsorted(truth.time, packets.time[-1] - 1e-9).clip(max=len(truth.time) - 1)
    north, east = (truth[f"position_ned.{axis}"][row] for axis in "xy")
    sent, heard, strength = packets.counts()
    ratio = np.divide(heard, sent, out=np.zeros(sent.shape), where=sent > 0)
    sender, receiver = np.nonzero(sent > 0)
    ends = np.stack([east, north], axis=-1)
    middle = 0.5 * (ends[sender] + ends[receiver])
    lines = np.stack([middle, ends[receiver]], axis=1)
    worst_first = np.argsort(ratio[sender, receiver])
    width = _width(strength[sender, receiver])
    drawn = LineCollection(
        list(lines[worst_first]),
        array=ratio[sender, receiver][worst_first],
        cmap=mpl.colormaps["viridis"],
        norm=mpl.colors.Normalize(0.0, 1.0),
        linewidths=width[worst_first],
        zorder=1,
    )
    axes.add_collection(drawn)
    figure.colorbar(drawn, ax=axes, label="part of the packets that was heard", shrink=0.8)
    axes.scatter(east, north, c=colours_of(len(run.vehicles)), s=60, edgecolors="black", zorder=3)
    if len(run.vehicles) <= MOST_NAMED:
        for name, x, y in zip(run.vehicles, east, north, strict=True):
            axes.annotate(name, (x, y), (5, 5), textcoords="offset points", fontsize=8)
    axes.set(xlabel="east [m]", ylabel="north [m]")
    axes.set_title("received packets: the half of a link at the receiver; the thicker, the stronger", fontsize=10)
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.1)
    axes.grid(alpha=0.3)


def _width(strength: Floats) -> Floats:
    """Return line widths [points] for received signal strengths [dBm]; thin for NaN (nothing received)."""
    there = np.isfinite(strength)
    if not there.any():
        return np.full(strength.shape, 0.8)
    low, high = strength[there].min(), strength[there].max()
    return np.where(there, 1.2 + 3.0 * (np.nan_to_num(strength) - low) / max(high - low, 1e-6), 0.8)


def _draw_delivery(axes: Axes, found: Connectivity) -> None:
    """Draw the fractions of radio packets that were received, and lost by cause, over time."""
    axes.plot(found.time, found.delivery, color=colours_of(2)[0], lw=1.8, label="heard")
    for name, part in found.lost.items():
        axes.plot(found.time, part, color="0.35", ls=STYLES[name], lw=1.1, label=f"lost: {name}")
    axes.set(ylabel="part of the packets", ylim=(-0.03, 1.03), title="delivery: fate of the packets")
    axes.legend(fontsize=8, framealpha=0.8)
    axes.grid(alpha=0.3)


def _draw_groups(axes: Axes, found: Connectivity) -> None:
    """Draw the fraction of vehicles in the largest connected group, and the number of groups, over time."""
    first, second = colours_of(2)
    [part] = axes.plot(found.time, found.largest, color=first, lw=1.8)
    axes.set(xlabel="time [s]", ylabel="part in the largest group", ylim=(-0.03, 1.03))
    axes.set_title("groups that reach each other, hop by hop, both ways", fontsize=10)
    axes.grid(alpha=0.3)
    other = axes.twinx()
    [count] = other.plot(found.time, found.components, color=second, lw=1.2, ls="--", drawstyle="steps-pre")
    other.set_ylabel("groups")
    other.set_ylim(0.0, max(2.0, 1.15 * np.nanmax(found.components)))
    other.yaxis.set_major_locator(MaxNLocator(integer=True))
    axes.legend([part, count], ["part in the largest", "groups"], fontsize=8, framealpha=0.8)
