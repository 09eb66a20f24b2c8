"""What stands in a run's world, as Foxglove's scene entities: area, obstacles, waypoints, persons, sources, places."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from qrsim.files import Content
from qrsim.models.scene.zone import Zone
from qrsim.runs import Run
from qrsim.runs.colours import FOUND, GREY, KEEP_OUT, MISSING, PLUME, Colour, share
from qrsim.runs.export import foxglove
from qrsim.runs.export.mcap_messages import Message, topics_of
from qrsim.runs.export.place import Floats, Place
from qrsim.runs.surroundings import Surroundings

SCENE, WAYPOINTS = "/scene", "waypoints"
# A loop of lines, and lines from point to point [Foxglove's numbers].
STRIP, LOOP = 0, 1
STILL = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}


def scene(run: Run, place: Place, around: Surroundings, frame: str) -> Iterator[Message]:
    """Yield Foxglove scene messages: surroundings and waypoints at the start, and each person again when found."""
    begin = int(place.nanoseconds(0.0))
    routes = waypoints(run)
    entities = [*_area_entities(around), *_obstacle_entities(around), *_place_entities(around), *_persons(around, -1.0)]
    entities += [
        _scene_entity(
            f"waypoints {name}",
            lines=[_line_primitive(route, STRIP, GREY)],
            spheres=[_sphere_primitive(p, 0.8, GREY) for p in route],
        )
        for name, route in zip(run.vehicles, routes, strict=True)
        if len(route)
    ]
    if entities:
        yield Message(begin, SCENE, foxglove.SCENE, _scene_update(entities, frame, begin))
    for topic, route in zip(topics_of(run, WAYPOINTS), routes, strict=True):
        if len(route):
            poses = [{"position": _enu_point(point), "orientation": STILL} for point in route]
            yield Message(begin, topic, foxglove.POSES, {"frame_id": frame, "poses": poses})
    for time in sorted(set(around.found[np.isfinite(around.found)].tolist())):
        now = int(place.nanoseconds(time))
        yield Message(now, SCENE, foxglove.SCENE, _scene_update(_persons(around, time), frame, now))


def waypoints(run: Run) -> list[Floats]:
    """Return each vehicle's planned route (P, 3) NED [m]; (0, 3) for a vehicle with no or an unknown route."""
    content = run.scenario if isinstance(run.scenario, dict) else {}
    try:
        vehicles = [own for fleet in content["fleets"].values() for own in fleet["vehicles"]]
        routes = [np.asarray(own.get("waypoints_ned") or np.zeros((0, 3)), float).reshape(-1, 3) for own in vehicles]
    except (KeyError, TypeError, ValueError, AttributeError):
        routes = []
    return routes if len(routes) == len(run.vehicles) else [np.zeros((0, 3))] * len(run.vehicles)


def _scene_update(entities: Sequence[Content], frame: str, now: int) -> Content:
    """Return a Foxglove SceneUpdate message with scene entities at a time [ns]."""
    seconds, rest = divmod(now, 1_000_000_000)
    about = {"timestamp": {"sec": seconds, "nsec": rest}, "frame_id": frame, "lifetime": {"sec": 0, "nsec": 0}}
    return {"deletions": [], "entities": [{**about, **entity} for entity in entities]}


def _scene_entity(name: str, **parts: object) -> Content:
    """Return a Foxglove scene entity; ``parts`` are its lists of primitives by kind, other kinds are empty."""
    kinds = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
    return {"id": name, "frame_locked": False, "metadata": [], **{kind: parts.get(kind, []) for kind in kinds}}


def _enu_point(ned: Any) -> Content:
    """Convert a position NED [m] to a Foxglove point with x, y, z in ENU [m]."""
    north, east, down = (float(value) for value in ned)
    return {"x": east, "y": north, "z": -down}


def _rgba(colour: Colour, opacity: float = 1.0) -> Content:
    """Convert a colour and an opacity to a Foxglove colour: r, g, b, a from 0 to 1."""
    return {**dict(zip("rgb", share(colour), strict=True)), "a": opacity}


def _line_primitive(points: Any, kind: int, colour: Colour) -> Content:
    """Return a Foxglove line primitive through points NED (N, 3) [m]; ``kind`` is its type: strip, loop or list."""
    return {
        "type": kind,
        "pose": {"position": {"x": 0.0, "y": 0.0, "z": 0.0}, "orientation": STILL},
        "thickness": 2.0,
        "scale_invariant": True,
        "points": [_enu_point(point) for point in points],
        "color": _rgba(colour),
        "colors": [],
        "indices": [],
    }


def _solid(middle: object, size: tuple[float, float, float], colour: Colour, **more: object) -> Content:
    """Return a Foxglove box or cylinder primitive with a centre NED [m] and a size along east, north and up [m]."""
    extent = dict(zip("xyz", size, strict=True))
    return {
        "pose": {"position": _enu_point(middle), "orientation": STILL},
        "size": extent,
        "color": _rgba(colour, 0.8),
        **more,
    }


def _sphere_primitive(middle: object, size: float, colour: Colour) -> Content:
    """Return a Foxglove sphere primitive with a diameter ``size`` [m] at a position NED [m]."""
    return _solid(middle, (size, size, size), colour)


def _area_entities(around: Surroundings) -> list[Content]:
    """Return scene entities for the area: its zones, or its outline as lines at its bottom and top."""
    if around.zones:
        return [_zone_entity(zone, *around.down) for zone in around.zones]
    if not len(around.outline):
        return []
    top, bottom = around.down
    levels = [np.column_stack([around.outline, np.full(len(around.outline), down)]) for down in (bottom, top)]
    lines = [_line_primitive(level, LOOP, GREY) for level in levels]
    lines += [_line_primitive(pair, STRIP, GREY) for pair in zip(*levels, strict=True)]
    return [_scene_entity("area", lines=lines)]


def _zone_entity(zone: Zone, top: float, bottom: float) -> Content:
    """Return a scene entity with the edges of a zone, from ``bottom`` or its floor to at most ``top`` [m, down];
    heights above terrain are drawn above z = 0."""
    levels = (bottom if zone.floor <= 0.0 else -zone.floor, max(top, -zone.ceiling))
    colour, lines = (GREY if zone.keep else KEEP_OUT), []
    for ring in zone.rings or (zone.outline,):
        low, high = (np.column_stack([ring, np.full(len(ring), down)]) for down in levels)
        lines += [_line_primitive(level, LOOP, colour) for level in (low, high)]
        lines += [_line_primitive(pair, STRIP, colour) for pair in zip(low, high, strict=True)] if zone.rings else []
    return _scene_entity(f"{'stay in' if zone.keep else 'stay out'} {zone.name}", lines=lines)


def _obstacle_entities(around: Surroundings) -> list[Content]:
    """Return scene entities for all obstacles."""
    found = []
    for number, item in enumerate(around.obstacles):
        middle, tall = 0.5 * (item["z_min"] + item["z_max"]), item["z_max"] - item["z_min"]
        if "corners_ned" in item:
            found.append(_scene_entity(f"obstacle {number}", lines=_prism(item)))
            continue
        if "radius" in item:
            wide = 2.0 * item["radius"]
            body = _solid((item["x"], item["y"], middle), (wide, wide, tall), GREY, bottom_scale=1.0, top_scale=1.0)
            found.append(_scene_entity(f"obstacle {number}", cylinders=[body]))
            continue
        north, east = (0.5 * (item[f"{axis}_min"] + item[f"{axis}_max"]) for axis in "xy")
        deep, wide = (item[f"{axis}_max"] - item[f"{axis}_min"] for axis in "xy")
        found.append(
            _scene_entity(f"obstacle {number}", cubes=[_solid((north, east, middle), (wide, deep, tall), GREY)])
        )
    return found


def _prism(item: Any) -> list[Content]:
    """Return the edges of a prism obstacle as Foxglove line primitives."""
    lines = []
    for ring in (item["corners_ned"], *item.get("holes_ned", ())):
        corners = np.asarray(ring, float)
        levels = [np.column_stack([corners, np.full(len(corners), item[end])]) for end in ("z_max", "z_min")]
        lines += [_line_primitive(level, LOOP, GREY) for level in levels]
        lines += [_line_primitive(pair, STRIP, GREY) for pair in zip(*levels, strict=True)]
    return lines


def _place_entities(around: Surroundings) -> list[Content]:
    """Return scene entities for plume sources and for the locations at which a task asks for concentrations."""
    found = [
        _scene_entity(f"source {i}", spheres=[_sphere_primitive(place, 4.0, PLUME)])
        for i, place in enumerate(around.sources)
    ]
    if len(around.locations):
        found.append(
            _scene_entity("asked for", cubes=[_sphere_primitive(place, 1.0, GREY) for place in around.locations])
        )
    return found


def _persons(around: Surroundings, time: float) -> list[Content]:
    """Return scene entities of persons: all for a ``time`` below 0, else those found at that time [s]."""
    return [
        _scene_entity(
            f"person {i}", spheres=[_sphere_primitive((*place, 0.0), 2.0, FOUND if found <= time else MISSING)]
        )
        for i, (place, found) in enumerate(zip(around.persons, around.found, strict=True))
        if time < 0.0 or found == time
    ]
