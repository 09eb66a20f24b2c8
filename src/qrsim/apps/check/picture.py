"""Figure of the failures of a check, in plan view and over time."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from qrsim.apps.check.outcomes import ANY, KINDS, LOST, UNFINISHED, Outcome
from qrsim.models.scene.area import REASONS
from qrsim.runs.picture import new_figure
from qrsim.runs.picture import save_picture as save
from qrsim.runs.plan import zone_patches
from qrsim.scenarios.scenario import Scenario
from qrsim.scenarios.zone_schema import zones_of
from qrsim.simulation.rollout import Rollout

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = dict(
    zip(
        (*KINDS, LOST, UNFINISHED),
        (
            "tab:red",
            "tab:purple",
            "tab:pink",
            "tab:olive",
            "tab:brown",
            "tab:cyan",
            "tab:orange",
            "black",
            "tab:blue",
            "tab:gray",
        ),
        strict=True,
    )
)


def save_picture(scenario: Scenario, flown: Rollout, found: list[Outcome], path: Path) -> None:
    """Draw the picture of a check and save it to ``path``, in the format of its ending.

    Raises:
        RunError: it cannot be written.
    """
    save(lambda: _drawn(scenario, flown, found), path)


def _drawn(scenario: Scenario, flown: Rollout, found: list[Outcome]) -> Figure:
    """Return the figure of a check: a map of failures and bars of their numbers."""
    figure = new_figure(12, 5.5)
    axes = figure.subplots(1, 2, width_ratios=(3, 2))
    _plan(axes[0], scenario, flown)
    _bars(axes[1], found)
    figure.suptitle(f"{scenario.name}: {len(flown.seeds)} runs of {scenario.duration:g} s")
    return figure


def _plan(axes: Axes, scenario: Scenario, flown: Rollout) -> None:
    """Draw the area, the routes and the places of failures on ``axes``, seen from above [m]."""
    area = scenario.spec.world.area
    if area.type == "zones":
        for zone in zones_of(area):
            for patch in zone_patches(zone):
                axes.add_patch(patch)
    else:
        corners = np.array(outline(area))
        closed = np.vstack([corners, corners[:1]])
        axes.plot(closed[:, 1], closed[:, 0], color="gray", lw=1.5, label="area")
    for fleet in scenario.spec.fleets.values():
        for vehicle in fleet.vehicles:
            route = np.array([vehicle.position_ned, *vehicle.places_ned.values()])
            axes.plot(route[:, 1], route[:, 0], "--", color="tab:green", lw=0.9, alpha=0.6)
            axes.plot(route[:1, 1], route[:1, 0], "o", color="tab:green", ms=5)
    kinds = np.array([kind for kind, _ in REASONS])[flown["reason"]]
    where = {name: flown["position_ned"][kinds == kind] for name, kind in KINDS.items()}
    where[UNFINISHED] = flown["position_ned"][flown["unfinished"] > 0.0]
    where[LOST] = flown["fix_lost_position_ned"][np.isfinite(flown["fix_lost_at_s"])]
    for name, places in where.items():
        if len(places):
            axes.plot(places[:, 1], places[:, 0], "X", color=COLOURS[name], mec="white", ms=9, label=name, alpha=0.8)
    told = "where runs went wrong" if any(map(len, where.values())) else "no run went wrong"
    axes.set(xlabel="east [m]", ylabel="north [m]", aspect="equal", title=f"{told}; routes dashed, starts o")
    axes.grid(alpha=0.3)
    # Each zone has the same label as others of its kind.
    named = dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    axes.legend(named.values(), named, fontsize=9, loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=4)


def outline(area: Any) -> list[list[float]]:
    """Return the corners (north, east) [m] of a scenario's flight area."""
    if "corners_ned" in vars(area):
        return [list(corner) for corner in area.corners_ned]
    return [[area.x_min, area.y_min], [area.x_max, area.y_min], [area.x_max, area.y_max], [area.x_min, area.y_max]]


def _bars(axes: Axes, found: list[Outcome]) -> None:
    """Draw the percentage of runs with each outcome, and its 95 % interval, as bars on ``axes``."""
    names = [outcome.name for outcome in found]
    rows = np.arange(len(found))[::-1]
    fractions = np.array([100 * outcome.fraction for outcome in found])
    reach = np.array([[100 * (o.fraction - o.low), 100 * (o.high - o.fraction)] for o in found]).T
    colours = [COLOURS.get(name, "gray") for name in names]
    axes.barh(rows, fractions, color=colours, alpha=0.7)
    axes.errorbar(fractions, rows, xerr=np.maximum(reach, 0.0), fmt="none", color="black", capsize=4)
    axes.set(yticks=rows, yticklabels=[name if name != ANY else "any" for name in names], xlabel="runs [%]")
    axes.set_title("fraction of the runs, 95 % interval")
    axes.set_xlim(0.0, min(105.0, max(5.0, 1.1 * float((fractions + reach[1]).max()))))
    axes.grid(alpha=0.3, axis="x")
