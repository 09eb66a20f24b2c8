"""The plan view of a run: paths from above, in their surroundings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.patches import Circle, Patch, PathPatch, Polygon, Rectangle
from matplotlib.path import Path
from matplotlib.transforms import ScaledTranslation

from qrsim.core.arrays import Floats
from qrsim.models.scene.zone import Zone
from qrsim.runs.colours import FOUND, KEEP_OUT, MISSING, PLUME, share
from qrsim.runs.interferers import Interferer
from qrsim.runs.picture import MOST_NAMED, MOST_TICKS, path_rows
from qrsim.runs.surroundings import Surroundings
from qrsim.runs.terrain import Terrain

MOST_NUMBERED = 60
# Points of all paths together: more are more than a picture can show.
MOST_POINTS, MOST_OF_ONE = 200_000, 4_000
# Where the flight is a smaller part of its area, the area is not drawn whole.
SMALLEST_PART = 0.5
# Lines of equal height: points along each side, and the least difference [m] that is worth them.
CONTOUR_CELLS, LEAST_RELIEF_M = 120, 2.0
PLUMES = "PuRd"
# Of what interferes with receivers: colour, lines of its circles, signs.
INTERFERER = "0.2"
CIRCLES = {"jammer": "--", "disc": "-", "spoofer": ":"}
SIGNS: dict[str, dict[str, Any]] = {
    kind: {"marker": marker, "ms": 8, "c": INTERFERER, "mec": "white", "mew": 0.8}
    for kind, marker in {"jammer": "D", "disc": "X", "spoofer": "P"}.items()
}


@dataclass(frozen=True)
class Paths:
    """What flew: n vehicles at T ticks.

    Attributes:
        names: (n,).
        position: (T, n, 3) true [m], NED.
        setpoint: (T1, n, 3) waypoints [m], NED; NaN under other commands.
        places: of each vehicle, (K, 2) where its legs lead, north and east [m].
        reported: (T2, n, 3) [m], what GNSS says; None without a receiver.
        stopped: numbers of those that stopped.
        wind: (3,) mean over all ticks of vehicles in flight [m/s], NED.
        colours: (n, 4).
    """

    names: tuple[str, ...]
    position: Floats
    setpoint: Floats
    places: tuple[Floats, ...]
    reported: Floats | None
    stopped: Sequence[int]
    wind: Floats
    colours: Floats

    @property
    def few(self) -> bool:
        """Whether there are few enough vehicles to give each its own colour."""
        return len(self.names) <= MOST_NAMED

    @property
    def many(self) -> bool:
        """Whether there are so many vehicles that only their paths are drawn."""
        return len(self.names) > MOST_NUMBERED


def draw_plan(axes: Axes, paths: Paths, around: Surroundings, terrain: Terrain) -> None:
    """Draw vehicles' paths, set-points, terrain and surroundings in plan view, north up."""
    seen = [paths.position, paths.setpoint]
    seen += [paths.reported] if paths.few and paths.reported is not None else []
    flown = np.concatenate([part[..., :2].reshape(-1, 2) for part in seen])
    low, high = _limits(np.concatenate([flown, around.goals[:, :2]]))
    whole = _is_whole(around, low, high)
    if whole:
        low, high = (
            over([edge, corner], axis=0)
            for over, edge, corner in (
                (np.min, low, around.outline.min(axis=0)),
                (np.max, high, around.outline.max(axis=0)),
            )
        )
        low, high = low - 0.03 * (high - low), high + 0.03 * (high - low)
    low, high = _with_interferers(around, low, high)
    if not terrain.level:
        _contours(axes, terrain, low, high)
    draw_surroundings(axes, around)
    most = min(MOST_OF_ONE, max(40, MOST_POINTS // len(paths.names)))
    if paths.many:
        _swarm(axes, paths, most)
    else:
        _draw_vehicles(axes, paths, most)
    name_marks(axes, around)
    _wind_arrow(axes, paths.wind)
    axes.update_datalim([low[::-1], high[::-1]])
    axes.margins(0.0)
    axes.set(xlabel="east [m]", ylabel="north [m]", aspect="equal", adjustable="datalim")
    axes.set_title(_plan_title(paths, around, whole))
    axes.grid(alpha=0.3)


def _plan_title(paths: Paths, around: Surroundings, whole: bool) -> str:
    """Return the title of the plan view, which explains its lines; ``whole``: the whole area is shown."""
    path = "true path (thick), GNSS (thin)" if paths.few and paths.reported is not None else "true path"
    numbers = ", numbers: order" if not paths.few and not paths.many else ""
    size = np.ptp(around.outline, axis=0) if len(around.outline) else None
    within = "" if whole or size is None else f"\npart of the area of {size[1]:.4g} x {size[0]:.4g} m"
    return f"plan: {path}, start o, waypoints +{numbers}{within}"


def span(values: Floats, least: float) -> tuple[float, float]:
    """Return axis limits that hold all values, at least ``least`` apart."""
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    half = 0.55 * max(high - low, least)
    return (low + high) / 2 - half, (low + high) / 2 + half


def _limits(points: Floats) -> tuple[Floats, Floats]:
    """Return the lowest and the highest (north, east) of points (P, 2)."""
    limits = [span(points[:, axis], 4.0) for axis in (0, 1)]
    return np.array([limit[0] for limit in limits]), np.array([limit[1] for limit in limits])


def _is_whole(around: Surroundings, low: Floats, high: Floats) -> bool:
    """Return whether the plan view shows the whole area, because the flight fills much of it or it has contents."""
    if not len(around.outline):
        return False
    part = np.max(high - low) / np.max(np.ptp(around.outline, axis=0))
    return bool(around.drawn or part >= SMALLEST_PART)


def draw_surroundings(axes: Axes, around: Surroundings) -> None:
    """Draw area, obstacles, plume, persons and marked places in plan view."""
    if around.plume is not None and around.plume.values.max() > 0:
        # Over three decades: a plume falls off like a power of the distance.
        values = np.log10(np.maximum(around.plume.values / around.plume.values.max(), 1e-30))
        shown = np.ma.masked_less(values, -3.0)
        east, north = around.plume.east, around.plume.north
        axes.pcolormesh(east, north, shown, cmap=PLUMES, vmin=-3.5, vmax=0.5, alpha=0.75, zorder=0, rasterized=True)
    for obstacle in around.obstacles:
        axes.add_artist(_footprint(obstacle))
    # As artists, not as patches: what is cut off, such as a large area, does not make the limits.
    for zone in around.zones:
        for patch in zone_patches(zone):
            axes.add_artist(patch)
    if len(around.outline) and not any(zone.keep for zone in around.zones):
        axes.add_artist(Polygon(around.outline[:, ::-1], fill=False, ec="black", lw=1.3, label="area"))
    for item in around.interference:
        if item.place_ned is not None and math.isfinite(item.radius):
            circle = Circle(
                (item.place_ned[1], item.place_ned[0]),
                item.radius,
                ec=INTERFERER,
                fill=False,
                lw=1.0,
                ls=CIRCLES[item.kind],
                zorder=2,
            )
            axes.add_artist(circle)
    marks = _marks(around)
    for label, points, look in marks:
        axes.plot(points[:, 1], points[:, 0], ls="none", zorder=4, label=label, **look)
    if around.unknown:
        axes.text(
            0.0,
            -0.16,
            "not everything of the scenario is drawn: it cannot be built any more",
            transform=axes.transAxes,
            ha="left",
            fontsize=8,
        )


def zone_patches(zone: Zone) -> list[Patch]:
    """Return Matplotlib patches of a zone in plan view: its edges, and hatching where vehicles may not be."""
    outline, *holes = (np.array(ring)[:, ::-1] for ring in (zone.outline, *zone.rings[1:]))
    keep_out = {"fc": (*share(KEEP_OUT), 0.12), "ec": share(KEEP_OUT), "hatch": "///", "lw": 1.2, "zorder": 1}
    barred: dict[str, Any] = {**keep_out, "label": "stay out"}
    if zone.keep:
        edge = Polygon(outline, fill=False, ec="black", lw=1.3, label="stay in", zorder=1)
        return [edge, *(Polygon(hole, **barred) for hole in holes)]
    path = Path.make_compound_path(*(Path([*ring, ring[0]], closed=True) for ring in (outline, *holes)))
    return [PathPatch(path, **barred)]


def name_marks(axes: Any, around: Surroundings) -> None:
    """Add a legend of marked places (sources, goals, persons), placed over as little as possible."""
    labels = {label for label, _, _ in _marks(around)}
    handles = [line for line in axes.lines if line.get_label() in labels]
    zones = {patch.get_label(): patch for patch in axes.patches if patch.get_label() in ("stay in", "stay out")}
    handles += zones.values()
    if handles:
        axes.legend(handles=handles, loc="best", fontsize=8, framealpha=0.85)


def _marks(around: Surroundings) -> list[tuple[str, Floats, dict[str, Any]]]:
    """Return the marks of sources, goals, persons and interferers: label, points (P, 2 or 3) [m] and plot style."""
    found = np.isfinite(around.found)
    small = {"marker": "s", "ms": 3, "mfc": "none", "mec": "dimgray", "mew": 0.8}
    pin = {"marker": "v", "ms": 8}
    goal = {"marker": "o", "ms": 13, "mfc": "none", "mec": "black", "mew": 1.6}
    every = [
        ("source; its plume, mean", around.sources, {"marker": "*", "ms": 13, "c": share(PLUME), "mec": "k"}),
        ("asked for by the task", around.locations, small),
        ("goal of the task", around.goals, goal),
        ("person not found", around.persons[~found], {**pin, "mfc": share(MISSING), "mec": "k", "mew": 1.5}),
        ("person found", around.persons[found], {**pin, "c": share(FOUND)}),
    ]
    every += [
        (_said(item), item.place_ned[None], SIGNS[item.kind])
        for item in around.interference
        if item.place_ned is not None
    ]
    return [item for item in every if len(item[1])]


def _said(item: Interferer) -> str:
    """Return the legend text of an interferer (such as a jammer)."""
    if not math.isfinite(item.radius):
        return item.label
    return f"{item.label}: {'heard' if item.kind == 'spoofer' else 'lost'} within {item.radius:.3g} m"


def _with_interferers(around: Surroundings, low: Floats, high: Floats) -> tuple[Floats, Floats]:
    """Return plot limits, each (2,), widened to include interferers that are not too far away."""
    wide = float(np.max(high - low))
    places = [item.place_ned[:2] for item in around.interference if item.place_ned is not None]
    near = [place for place in places if np.all(place > low - wide) and np.all(place < high + wide)]
    corners = np.array([low, high, *(place - 0.05 * wide for place in near), *(place + 0.05 * wide for place in near)])
    return corners.min(axis=0), corners.max(axis=0)


def _footprint(obstacle: Any) -> Patch:
    """Return a Matplotlib patch of an obstacle's outline from above."""
    look: dict[str, Any] = {"fc": "0.75", "ec": "0.35", "lw": 1.0, "zorder": 1}
    if "radius" in obstacle:
        return Circle((obstacle["y"], obstacle["x"]), obstacle["radius"], **look)
    if "corners_ned" in obstacle:
        rings = [np.asarray(ring, float)[:, ::-1] for ring in (obstacle["corners_ned"], *obstacle.get("holes_ned", ()))]
        return PathPatch(Path.make_compound_path(*(Path([*ring, ring[0]], closed=True) for ring in rings)), **look)
    corner = obstacle["y_min"], obstacle["x_min"]
    return Rectangle(corner, obstacle["y_max"] - corner[0], obstacle["x_max"] - corner[1], **look)


def _draw_vehicles(axes: Any, paths: Paths, most: int) -> None:
    """Draw each vehicle's path (about ``most`` points), set-points and stop in plan view."""
    few = paths.few
    # Many laps over each other are told apart by thin lines only.
    width = 0.5 if len(paths.position) > 10 * MOST_TICKS else 1.8 if few else 1.0
    for i, name in enumerate(paths.names):
        colour = paths.colours[i]
        legs = _without_repeats(paths.setpoint[:, i, :2])
        axes.plot(legs[:, 1], legs[:, 0], "--", color=colour, lw=0.8, alpha=0.4)
        axes.plot(paths.places[i][:, 1], paths.places[i][:, 0], "+", color=colour, ms=10 if few else 5, zorder=3)
        if few and paths.reported is not None:
            reported = paths.reported[:, i, :2]
            reported = reported[path_rows(reported, most)]
            axes.plot(reported[:, 1], reported[:, 0], color=colour, lw=0.7, alpha=0.7)
        own = paths.position[:, i, :2]
        own = own[path_rows(own, most)]
        axes.plot(own[:, 1], own[:, 0], color=colour, lw=width, label=name)
        axes.plot(own[:1, 1], own[:1, 0], "o", color=colour, ms=7 if few else 4, mec="white", zorder=3)
        if not few:
            axes.annotate(str(i), own[0, ::-1], (4, 3), textcoords="offset points", fontsize=8, color="black", zorder=6)
        if i in paths.stopped:
            axes.plot(own[-1:, 1], own[-1:, 0], "X", color=colour, ms=11 if few else 7, mec="black", zorder=5)


def _swarm(axes: Axes, paths: Paths, most: int) -> None:
    """Draw many vehicles in plan view as thin paths of about ``most`` points and small dots."""
    own = [paths.position[:, i, :2] for i in range(len(paths.names))]
    lines = [path[path_rows(path, most)][:, ::-1] for path in own]
    axes.add_collection(LineCollection(lines, colors=paths.colours, linewidths=0.6, alpha=0.7, rasterized=True))
    targets = np.unique(np.concatenate(paths.places), axis=0)
    axes.plot(targets[:, 1], targets[:, 0], "+", color="0.6", ms=2, mew=0.5, zorder=0.5, rasterized=True)
    starts = paths.position[0, :, :2]
    axes.scatter(starts[:, 1], starts[:, 0], c=paths.colours, s=4, zorder=3, rasterized=True)
    ends = paths.position[-1, list(paths.stopped), :2]
    axes.plot(ends[:, 1], ends[:, 0], "X", color="black", ms=4, mec="white", mew=0.4, zorder=5)


def held_places(setpoint: Floats) -> Floats:
    """Return the places (K, 2), north and east, at which a set-point (T, 3) stayed constant."""
    points = setpoint[np.isfinite(setpoint).all(axis=1)]
    held = np.zeros(len(points), bool)
    held[1:] = np.all(points[1:] == points[:-1], axis=1)
    return np.asarray(_without_repeats(points[held][:, :2]))


def _without_repeats(points: Floats) -> Floats:
    """Return the finite points (L, 2) in the order flown, without a point that repeats the one before."""
    points = points[np.isfinite(points).all(axis=1)]
    fresh = np.ones(len(points), bool)
    fresh[1:] = np.any(points[1:] != points[:-1], axis=1)
    return np.asarray(points[fresh])


def _contours(axes: Axes, terrain: Terrain, low: Floats, high: Floats) -> None:
    """Draw height contours of the terrain between two corners (2,), north and east [m]."""
    north, east = (np.linspace(low[axis], high[axis], CONTOUR_CELLS) for axis in (0, 1))
    heights = -terrain.down(*np.meshgrid(north, east, indexing="ij"))
    if not np.isfinite(heights).all() or np.ptp(heights) < LEAST_RELIEF_M:
        return
    lines = axes.contour(east, north, heights, levels=8, colors="saddlebrown", linewidths=0.5, alpha=0.5, zorder=0)
    axes.clabel(lines, fontsize=6, fmt="%.4g m")


def _wind_arrow(axes: Any, mean: Floats) -> None:
    """Draw an arrow below the plan view that points downwind; ``mean`` is the mean wind (3,) NED [m/s]."""
    speed = float(np.hypot(mean[0], mean[1]))
    if speed == 0.0:
        return
    # In points below the lower right corner: in fractions of the axes, the arrow would turn with their shape.
    step = 9.0 * np.array([mean[1], mean[0]]) / speed
    middle = np.array([-10.0, -26.0])
    arrow = {"arrowstyle": "-|>", "lw": 1.5, "color": "dimgray", "shrinkA": 0, "shrinkB": 0}
    inches = axes.figure.dpi_scale_trans + ScaledTranslation(1.0, 0.0, axes.transAxes)
    drawn = axes.annotate(
        "",
        (middle + step) / 72.0,
        (middle - step) / 72.0,
        xycoords=inches,
        textcoords=inches,
        arrowprops=arrow,
        annotation_clip=False,
    )
    text = axes.text(
        -0.33, -26.0 / 72.0, f"mean wind {speed:.1f} m/s", transform=inches, ha="right", va="center", fontsize=9
    )
    for artist in (drawn, text):
        artist.set_in_layout(False)
