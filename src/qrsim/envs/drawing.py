"""An episode seen from above, as pictures: what ``render_mode="rgb_array"`` gives."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from qrsim.core.arrays import Floats
from qrsim.core.vectors import Vec3
from qrsim.envs.batch import Batch
from qrsim.errors import UsageError
from qrsim.models.scene.area import BoxArea
from qrsim.models.scene.plume import Sources
from qrsim.runs.colours import FOUND, GREY, MISSING, PLUME, STOPPED, VEHICLES, share
from qrsim.runs.picture import new_figure
from qrsim.tasks.places import places_of
from qrsim.tasks.play import Episode
from qrsim.world.episode import surroundings

RENDER_MODES = ("rgb_array",)
# Of a picture, 640 x 480 pixels.
WIDTH_IN, HEIGHT_IN, DPI = 6.4, 4.8, 100
# Cells of a plume along north and east, and heights.
CELLS, HEIGHTS = 80, 10
# Left, bottom, width and height of its parts.
PLAN, HEIGHT = (0.12, 0.1, 0.72, 0.82), (0.9, 0.1, 0.08, 0.82)
# So far around every start is shown at least [m].
LEAST_M = 5.0


def checked_mode(render_mode: str | None) -> str | None:
    """Return a render mode unchanged; raise UsageError unless it is None or a known one.

    Raises:
        UsageError: it is none.
    """
    if render_mode is not None and render_mode not in RENDER_MODES:
        raise UsageError(f"render_mode: {render_mode!r}; allowed: None, {', '.join(map(repr, RENDER_MODES))}")
    return render_mode


class Drawing:
    """Pictures of one episode of a batch, north up: ways, area, goals, persons, plume and its sources, heights.

    Args:
        batch: whose episode.
        row: which.
    """

    def __init__(self, batch: Batch, row: int = 0):
        self._batch, self._row = batch, row
        self._ways: list[Floats] = []
        self._scene: _Scene | None = None

    def __getstate__(self) -> dict[str, object]:
        # Of another process or copy: figures are drawn anew.
        return self.__dict__ | {"_scene": None}

    def begin(self) -> None:
        """Discard the drawn paths of the last episode."""
        self._ways, self._scene = [self._places(self._episode())], None

    def moved(self) -> None:
        """Append the vehicles' positions after a step to their paths."""
        self._ways.append(self._places(self._episode()))

    def frame(self) -> Floats:
        """Draw the episode from above, as it is now; return the picture, (480, 640, 3) uint8.

        Raises:
            UsageError: nothing has begun.
        """
        if not self._ways:
            raise UsageError("nothing has begun: call reset() before render()")
        episode = self._episode()
        if self._scene is None:
            self._scene = _Scene(self._batch, episode, self._ways[0])
        return self._scene.frame(episode, np.stack(self._ways))

    def _episode(self) -> Episode:
        """Return the state of the episode that is drawn."""
        return self._batch.episodes.episode(self._row)

    def _places(self, episode: Episode) -> Floats:
        """Return the true positions of all vehicles, NED (n, 3) [m]."""
        fleets = zip(self._batch.functional.play.world.fleets, episode.state.fleets, strict=True)
        poses = [model.vehicle.pose(fleet.vehicle) for model, fleet in fleets]
        return np.concatenate([np.asarray(pose.position_ned.stack(), float) for pose in poses])


class _Scene:
    """A figure with what stands in an episode, in which vehicles move."""

    def __init__(self, batch: Batch, episode: Episode, start: Floats):
        self._play, self._name, self._dtype = batch.functional.play, batch.functional.name, batch.dtype
        self._figure = new_figure(WIDTH_IN, HEIGHT_IN)
        self._figure.set_dpi(DPI)
        # Laid out by hand, so that a picture depends on the flight alone and not on the pictures before.
        self._figure.set_layout_engine("none")
        self._plan, self._heights = self._figure.add_axes(PLAN), self._figure.add_axes(HEIGHT)
        self._plan.set(xlabel="east [m]", ylabel="north [m]")
        self._plan.grid(alpha=0.3)
        self._heights.set(xticks=[])
        self._heights.set_title("height [m]", fontsize=9)
        for axes in (self._plan, self._heights):
            axes.tick_params(labelsize=8)
        self._heights.grid(alpha=0.3)
        self._set_area(start)
        self._plume(episode)
        self._goals(episode)
        self._add_vehicles()
        self._people = self._add_persons(episode)
        if len(start) <= len(VEHICLES):
            self._plan.legend(loc="upper left", fontsize=7, framealpha=0.8)

    def frame(self, episode: Episode, ways: Floats) -> Floats:
        """Draw an episode with the paths (T, n, 3) [m] of its vehicles, and return the picture."""
        stopped = np.concatenate([np.asarray(fleet.violation.code) != 0 for fleet in episode.state.fleets])
        for i, (way, now, height) in enumerate(zip(self._lines, self._now, self._levels, strict=True)):
            way.set_data(ways[:, i, 1], ways[:, i, 0])
            now.set_data(ways[-1:, i, 1], ways[-1:, i, 0])
            height.set_data([i], [-ways[-1, i, 2]])
            if stopped[i]:
                now.set(marker="X", markersize=11, color=share(STOPPED))
        for marks, (east, north) in zip(self._people, _people(episode), strict=True):
            marks.set_data(east, north)
        self._limits(ways)
        period = self._play.task.period
        time = int(np.asarray(episode.step)) * period
        self._figure.suptitle(f"{self._name}: {time:.1f} of {self._play.steps * period:g} s", fontsize=10)
        canvas: Any = self._figure.canvas
        canvas.draw()
        return np.asarray(canvas.buffer_rgba())[..., :3].copy()

    def _limits(self, ways: Floats) -> None:
        """Set the plot's limits so that all paths (T, n, 3) and the area are visible."""
        flown = ways.reshape(-1, 3)
        flown = flown[np.isfinite(flown).all(axis=1)]
        seen = np.concatenate([self._shown, flown[:, 1::-1]])
        middle, wide = 0.5 * (seen.max(axis=0) + seen.min(axis=0)), np.ptp(seen, axis=0)
        size = np.array([PLAN[2] * WIDTH_IN, PLAN[3] * HEIGHT_IN])
        half = 0.53 * size * float(np.max(wide / size))
        self._plan.set_xlim(middle[0] - half[0], middle[0] + half[0])
        self._plan.set_ylim(middle[1] - half[1], middle[1] + half[1])
        low, high = min(self._low, float(-flown[:, 2].max())), max(self._high, float(-flown[:, 2].min()))
        self._heights.set_ylim(low - 0.03 * (high - low), high + 0.03 * (high - low))

    def _set_area(self, start: Floats) -> None:
        """Draw the outline of the area, and set the smallest plotted extent from it and the starts (n, 3) [m]."""
        area: Any = self._play.world.area
        self._low, self._high = -float(area.z_max), -float(area.z_min)
        self._shown = np.concatenate([start[:, 1::-1] - LEAST_M, start[:, 1::-1] + LEAST_M])
        if isinstance(area, BoxArea):
            south, north, west, east = (float(getattr(area, edge)) for edge in ("x_min", "x_max", "y_min", "y_max"))
            outline = np.array([[west, south], [east, south], [east, north], [west, north], [west, south]])
            self._plan.plot(*outline.T, color="black", lw=1.2)
            self._shown = np.concatenate([self._shown, outline])

    def _plume(self, episode: Episode) -> None:
        """Draw the plume from above: its mean concentration, highest over all heights, and its sources."""
        field, area = episode.state.contents.plume, self._play.world.area
        if field is None:
            return
        sources = field if isinstance(field, Sources) else field.sources
        there = np.asarray(sources.strength) > 0
        east, north = (np.asarray(axis)[there] for axis in (sources.position_ned.y, sources.position_ned.x))
        if isinstance(area, BoxArea):
            self._draw_concentration(episode, area)
        look: dict[str, Any] = {"ms": 13, "color": share(PLUME), "mec": "black", "ls": "none", "label": "source"}
        self._plan.plot(east, north, "*", **look)

    def _draw_concentration(self, episode: Episode, area: BoxArea) -> None:
        """Draw the mean concentration, highest over all heights, as the background of the plot."""
        world = self._play.world.with_drawn(episode.state.drawn)
        wind = surroundings(world, episode.state.contents, jnp.int32(0)).carrying_wind(self._dtype)
        edges = [(float(getattr(area, f"{axis}_min")), float(getattr(area, f"{axis}_max"))) for axis in "xy"]
        norths, easts = (np.linspace(low, high, CELLS) for low, high in edges)
        downs = np.linspace(float(area.z_min), float(area.z_max), HEIGHTS)
        axes = [axis.ravel() for axis in np.meshgrid(norths, easts, downs, indexing="ij")]
        places = Vec3(*(jnp.asarray(axis, self._dtype) for axis in axes))
        found = world.contents.plume.mean(episode.state.contents.plume, places, wind)
        values = np.asarray(found).reshape(CELLS, CELLS, HEIGHTS).max(axis=2)
        if values.max() > 0:
            # Over three decades: a plume falls off like a power of the distance.
            shown = np.ma.masked_less(np.log10(np.maximum(values / values.max(), 1e-30)), -3.0)
            self._plan.pcolormesh(easts, norths, shown, cmap="PuRd", vmin=-3.5, vmax=0.5, zorder=0)

    def _goals(self, episode: Episode) -> None:
        """Draw the goals of the vehicles, and the locations of a plume task."""
        places = places_of(self._play.task, self._play.world, episode.memory, episode.state.contents)
        if len(places.goals):
            look: dict[str, Any] = {"ms": 14, "mew": 2, "color": share(GREY), "ls": "none", "label": "goal"}
            self._plan.plot(places.goals[:, 1], places.goals[:, 0], "+", **look)
        if len(places.locations):
            look = {"ms": 2.5, "mfc": "none", "mec": "dimgray", "mew": 0.7, "ls": "none", "label": "asked for"}
            self._plan.plot(places.locations[:, 1], places.locations[:, 0], "s", **look)

    def _add_vehicles(self) -> None:
        """Add markers of the vehicles to the plot."""
        names = [name for fleet in self._play.world.fleets for name in fleet.vehicle_names]
        self._lines, self._now, self._levels = [], [], []
        for i, name in enumerate(names):
            colour = share(VEHICLES[i % len(VEHICLES)])
            self._lines += self._plan.plot([], [], "-", color=colour, lw=1.2)
            self._now += self._plan.plot([], [], "o", color=colour, ms=7, mec="white", zorder=5, label=name)
            self._levels += self._heights.plot([], [], "o", color=colour, ms=7, mec="white")
        self._heights.set_xlim(-0.7, len(names) - 0.3)

    def _add_persons(self, episode: Episode) -> list[Any]:
        """Add markers of the persons to the plot, and return them."""
        kinds = (("person not found", MISSING), ("person found", FOUND))
        look: dict[str, Any] = {"ms": 8, "mec": "black", "ls": "none"}
        return [
            self._plan.plot([], [], "v", color=share(colour), label=label, **look)[0]
            for (label, colour), _ in zip(kinds, _people(episode), strict=False)
        ]


def _people(episode: Episode) -> list[tuple[Floats, Floats]]:
    """Return (east, north) of the persons not yet found, and of those found; [] if the world has none."""
    persons = episode.state.contents.persons
    if persons is None:
        return []
    there, found = np.asarray(persons.there) > 0, np.asarray(persons.found_tick) >= 0
    return [(np.asarray(persons.east)[who], np.asarray(persons.north)[who]) for who in (there & ~found, there & found)]
