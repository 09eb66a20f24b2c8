"""What a run had besides its vehicles: area, obstacles, persons, plume, and the places that its task asks about.

A log holds none of this. Area and obstacles are in the scenario; persons, sources and places follow from the seed alone
and are drawn again; who was found when, the events say.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.errors import QrsimError
from qrsim.files import Content
from qrsim.models.scene.zone import Zone
from qrsim.runs.interferers import Interferer, of_scenario
from qrsim.runs.layout import EVENTS, PERSON_FOUND
from qrsim.runs.reader import Run
from qrsim.runs.summary import vectors
from qrsim.world.state import World

if TYPE_CHECKING:
    from qrsim.tasks.places import Places

# Of the picture of a plume: cells along north and east, and heights of which the strongest counts.
CELLS, HEIGHTS = 100, 12
ABSENT = ("none", "clear")
# Types of tasks that want vehicles at places.
WITH_GOALS = ("keep_spot", "reach_waypoint", "land")


class Field(NamedTuple):
    """A plume from above: edges north and east (CELLS + 1,) [m], and values (CELLS, CELLS).

    A value is the mean over time of the concentration, at the height where that is largest.
    """

    north: Floats
    east: Floats
    values: Floats


@dataclass(frozen=True)
class Surroundings:
    """What there was.

    Attributes:
        outline: (V, 2) corners of the area, north and east [m]; of several zones, those of the box around them; none
            where it is unknown.
        zones: to stay in and to stay out of; none for an area of another type.
        down: top and bottom of the area [m], down; NaN where it is unknown.
        obstacles: as in the scenario.
        interference: with receivers, in the order of the scenario.
        persons: (P, 2) north and east [m].
        found: (P,) time at which each was found [s], infinite where it was not.
        sources: (S, 3) of the plume [m], NED.
        locations: (L, 3) at which the task asks for the concentration [m], NED.
        goals: (G, 3) where the task wants vehicles [m], NED.
        plume: from above; None without one.
        task: type of the task, "" without one.
        unknown: why persons, plume and places are not known although there are some, "" otherwise.
    """

    outline: Floats = field(default_factory=lambda: np.zeros((0, 2)))
    zones: tuple[Zone, ...] = ()
    down: tuple[float, float] = (np.nan, np.nan)
    obstacles: tuple[Content, ...] = ()
    interference: tuple[Interferer, ...] = ()
    persons: Floats = field(default_factory=lambda: np.zeros((0, 2)))
    found: Floats = field(default_factory=lambda: np.zeros(0))
    sources: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    locations: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    goals: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    plume: Field | None = None
    task: str = ""
    unknown: str = ""

    @property
    def places(self) -> Places:
        """The places of the task (goals, sources, locations), for pictures."""
        from qrsim.tasks.places import Places

        return Places(self.goals, self.sources, self.locations)

    @property
    def drawn(self) -> bool:
        """Whether persons, sources or task locations were drawn at random."""
        return bool(len(self.persons) or len(self.sources) or len(self.locations))


def surroundings_of(run: Run) -> Surroundings:
    """Return the surroundings of a run: area, obstacles, and the contents that its seed draws.

    Raises:
        RunError: the events are damaged, or the scenario is no YAML.
    """
    content = run.scenario if isinstance(run.scenario, dict) else {}
    world, task = content.get("world"), content.get("task")
    kind = str(task.get("type", "none")) if isinstance(task, dict) else "none"
    if not isinstance(world, dict):
        return Surroundings()
    try:
        known = fixed_parts(world)
    except (KeyError, TypeError, ValueError):  # of another version of qrsim
        known = {}
    known["task"] = "" if kind == "none" else kind
    try:
        known |= _goals(run) if kind in WITH_GOALS else {}
    except (QrsimError, OSError) as error:
        return Surroundings(**known, unknown=f"the recorded scenario cannot be built: {error}")
    parts = [world.get(name) for name in ("plume", "terrain", "persons")]
    if all(not isinstance(part, dict) or part.get("type") in ABSENT for part in parts):
        return Surroundings(**known)
    try:
        return Surroundings(**known, **_drawn_again(run))
    except (QrsimError, OSError) as error:
        return Surroundings(**known, unknown=f"the recorded scenario cannot be built: {error}")


def fixed_parts(world: Content) -> Content:
    """Return as a dict the attributes of ``Surroundings`` that follow from a scenario's ``world`` alone, in NED.

    Raises:
        KeyError, TypeError, ValueError: it is of another version of qrsim.
    """
    outline, down = _area(world.get("area"))
    return {
        "outline": outline,
        "down": down,
        "zones": _zones(world.get("area")),
        "obstacles": tuple(world.get("obstacles") or ()),
        "interference": of_scenario(world.get("interference")),
    }


def _area(area: Any) -> tuple[Floats, tuple[float, float]]:
    """Return corners (V, 2) [m] of a scenario's area, and its (top, bottom) [m, down]."""
    down = (float(area["z_min"]), float(area["z_max"]))
    if zones := _zones(area):
        kept = [zone.bounds for zone in zones if zone.keep] or [zone.bounds for zone in zones]
        south, _, west, _ = np.min(kept, axis=0)
        _, north, _, east = np.max(kept, axis=0)
        return np.array([[south, west], [north, west], [north, east], [south, east]]), down
    if "corners_ned" in area:
        return np.asarray(area["corners_ned"], float).reshape(-1, 2), down
    (south, north), (west, east) = ((float(area[f"{axis}_min"]), float(area[f"{axis}_max"])) for axis in "xy")
    return np.array([[south, west], [north, west], [north, east], [south, east]]), down


def _zones(area: Any) -> tuple[Zone, ...]:
    """Return the zones of a scenario's area, none for an area of another type."""
    if not (isinstance(area, dict) and area.get("type") == "zones"):
        return ()
    # Imported here, because most runs have none.
    from qrsim.scenarios.zone_schema import ZoneSpec, zone_of

    return tuple(
        zone_of(ZoneSpec.model_validate(entry), key == "stay_in", f"{key}.{i}")
        for key in ("stay_in", "stay_out")
        for i, entry in enumerate(area.get(key) or ())
    )


def _goals(run: Run) -> dict[str, Floats]:
    """Return {"goals": positions} of a task with goals for its vehicles; {} without logged truth or vehicles."""
    from qrsim.core.vectors import Vec3
    from qrsim.tasks.places import goals_of

    if "truth" not in run or not len(run["truth"].time):
        return {}
    scenario = run.built()
    world, task = scenario.world(run.info.precision), scenario.task(run.info.precision)
    start = vectors(run["truth"], "position_ned", slice(0, 1))[0]
    own = start[world.rows_of(task.fleet)].astype(run.info.precision)
    return {"goals": goals_of(task, world, Vec3(*own.T))} if len(own) else {}


def _drawn_again(run: Run) -> Content:
    """Return persons, plume sources, task locations and mean plume of a run, drawn again from its seed."""
    import jax

    from qrsim.core.noise import Key
    from qrsim.world.draws import keys_of

    scenario = run.built()
    precision = run.info.precision
    world, task = scenario.world(precision), scenario.task(precision)
    key = Key.root(run.info.seed, 0)
    with jax.enable_x64(precision == "float64"):
        places = _grid(world.area) if world.contents.plume.random else None
        found = jax.jit(_begin)(world, task, keys_of(world, key), _task_stream(task, key), places)
        contents, locations, values = jax.tree.map(lambda leaf: np.asarray(leaf, np.float64), found)
    result: dict[str, object] = {}
    if locations is not None:
        result["locations"] = np.stack([locations.x, locations.y, locations.z], axis=-1)
    if contents.persons is not None:
        there = contents.persons.there > 0
        result["persons"] = np.stack([contents.persons.north, contents.persons.east], axis=-1)[there]
        result["found"] = _found(run, len(there))[there]
    if contents.plume is not None:
        from qrsim.models.scene.plume import Sources

        # A plume that moves keeps its sources beside what they have let out.
        plume = contents.plume
        sources = plume if isinstance(plume, Sources) else plume.sources
        position = np.stack([getattr(sources.position_ned, axis) for axis in "xyz"], axis=-1)
        result["sources"] = position[sources.strength > 0]
        result["plume"] = Field(*_edges(world.area), values.reshape(HEIGHTS, CELLS, CELLS).max(axis=0))
    return result


def _task_stream(task: Any, key: Any) -> object:
    """Return the random number stream of a task from a key; None if the task draws no numbers."""
    import jax.numpy as jnp

    from qrsim.tasks.play import TASK

    return key.stream(TASK, jnp.arange(task.ids, dtype=jnp.uint32)) if task.ids else None


class _Beginning(NamedTuple):
    """The part of a state that a task may look at to draw its places."""

    drawn: Any
    contents: Any


def _begin(world: World, task: Any, keys: object, stream: Any, places: Any) -> tuple[Any, Any, Any]:
    """Return a world's drawn contents, a plume task's locations, and mean concentrations at ``places``;
    None if unused."""
    import jax.numpy as jnp

    from qrsim.core.noise import Draw
    from qrsim.tasks.plume_mapping import PlumeMemory
    from qrsim.world.episode import surroundings

    drawn, contents = drawn_contents(world, keys)
    like = jnp.zeros((), world.fleets[0].start.position_ned.x.dtype)
    locations = values = None
    if stream is not None:
        memory = task.init(world, _Beginning(drawn, contents), Draw(stream, jnp.int32(0), like))
        locations = memory.locations_ned if isinstance(memory, PlumeMemory) else None
    if places is not None:
        around = surroundings(world.with_drawn(drawn), contents, jnp.int32(0))
        values = world.contents.plume.mean(contents.plume, places, around.carrying_wind(like.dtype))
    return contents, locations, values


def drawn_contents(world: World, keys: Any) -> tuple[tuple[Any, ...], Any]:
    """Draw an episode's ranges and initial contents (plume, persons) from random keys; a pure JAX function."""
    import jax.numpy as jnp

    from qrsim.world.episode import draw_ranges, episode_draws, start_contents

    draws = episode_draws(world, keys, jnp.zeros((), world.fleets[0].start.position_ned.x.dtype))
    drawn = draw_ranges(world, draws)
    return drawn, start_contents(world.with_drawn(drawn), draws)


def _edges(area: object) -> tuple[Floats, Floats]:
    """Return north and east edges [m], each (CELLS + 1,), of the grid cells for the picture of a plume."""
    bounds = [(float(getattr(area, f"{axis}_min")), float(getattr(area, f"{axis}_max"))) for axis in "xy"]
    north, east = (np.linspace(low, high, CELLS + 1) for low, high in bounds)
    return north, east


def _grid(area: Any) -> object:
    """Return the centres NED [m] of the plume picture's grid cells at all heights, (HEIGHTS * CELLS * CELLS,)."""
    from qrsim.core.vectors import Vec3

    north, east = (0.5 * (edges[1:] + edges[:-1]) for edges in _edges(area))
    down = np.linspace(float(area.z_min), float(area.z_max), HEIGHTS)
    z, x, y = np.meshgrid(down, north, east, indexing="ij")
    dtype = np.asarray(area.z_min).dtype
    north_east_down: list[Any] = [axis.ravel().astype(dtype) for axis in (x, y, z)]
    return Vec3(*north_east_down)


def _found(run: Run, persons: int) -> Floats:
    """Return the time [s] at which each person (P,) was found, infinite if never."""
    found = np.full(persons, np.inf)
    for event in run.events if EVENTS in run else ():
        if event.kind == PERSON_FOUND and event.value is not None and 0 <= int(event.value) < persons:
            found[int(event.value)] = event.time
    return found
