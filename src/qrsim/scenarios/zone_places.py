"""Zones of files, and in latitude and longitude, to NED."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from qrsim.errors import ScenarioError, UsageError
from qrsim.files import Content
from qrsim.models.site import Site
from qrsim.scenarios.plans.plan import Plan
from qrsim.scenarios.plans.reading import read_plan
from qrsim.scenarios.zone_files import corners_ned, in_ned, zones_of_file
from qrsim.scenarios.zone_schema import MOST_ZONES, ZoneSpec, zones_model


@dataclass
class PlacedZones:
    """An area of zones in NED.

    Attributes:
        area: the area.
        problems: faults, one sentence each.
        written: for each path that is new in the area, its name in messages.
        plans: file -> plan, of those with fences that are zones.
    """

    area: Any
    problems: list[str] = field(default_factory=list)
    written: dict[str, str] = field(default_factory=dict)
    plans: dict[str, Plan] = field(default_factory=dict)


def has_places(area: Any) -> bool:
    """Return whether an area names files, or geodetic positions, which must be converted to NED."""
    if area.type != "zones":
        return bool(area.type == "fence")
    return any(zone.polygon_ned is None and zone.circle_ned is None for zone in (*area.stay_in, *area.stay_out))


def fence_as_zones(area: Any) -> list[Any]:
    """Return [area], with a plan's fence as an area of zones if one polygon cannot express it.

    Raises:
        UsageError: the plan cannot be read.
    """
    if Path(area.file).suffix.lower() != ".plan" or area.name is not None:
        return [area]
    plan = read_plan(area.file)
    kinds = [fence.inclusion for fence in plan.polygons] + [fence.inclusion for fence in plan.circles]
    if kinds in ([], [True]):
        return [area]
    key = "stay_in" if any(kinds) else "stay_out"
    return [zones_model()(type="zones", z_min=area.z_min, z_max=area.z_max, **{key: [{"file": area.file}]})]


def zones_in_ned(area: Any, site: Site) -> PlacedZones:
    """Return the zones of a scenario's ``world.area`` in NED, including those read from files."""
    placed, found = PlacedZones(area), {"stay_in": list[ZoneSpec](), "stay_out": list[ZoneSpec]()}
    # Plans whose fences to stay out of are named there; those of all others are in the plan's entry of stay_in.
    barred = {zone.file for zone in area.stay_out}
    for key in found:
        for i, zone in enumerate(getattr(area, key)):
            path = f"world.area.{key}.{i}"
            try:
                parts = list(_placed(zone, key == "stay_in", site, barred, placed.plans))
            except ScenarioError as error:
                placed.problems += [f"{path}: {error.source}: {problem}" for problem in error.problems]
            except UsageError as error:
                placed.problems.append(f"{path}: {error}")
            else:
                for keep, each in parts:
                    own = found["stay_in" if keep else "stay_out"]
                    here = f"world.area.stay_{'in' if keep else 'out'}.{len(own)}"
                    _note(placed.written, here, path, zone, each)
                    own.append(each)
    count = sum(map(len, found.values()))
    if count > MOST_ZONES:
        placed.problems.append(f"world.area: has {count} zones; allowed: at most {MOST_ZONES}")
    placed.area = area.model_copy(update=found)
    return placed


def _note(written: dict[str, str], here: str, path: str, zone: ZoneSpec, each: ZoneSpec) -> None:
    """Record in ``written``, for messages, how the user wrote a zone that was converted to NED."""
    for part in ("polygon_ned", *(f"holes_ned.{number}" for number in range(len(each.holes_ned)))):
        if zone.file is not None:
            written[f"{here}.{part}"] = f"{path}: {zone.file}: '{each.name}'"
        else:
            written[f"{here}.{part}"] = f"{path}.{part.replace('_ned', '_geodetic') if each is not zone else part}"


def _placed(
    zone: ZoneSpec, keep: bool, site: Site, barred: set[str | None], plans: dict[str, Plan]
) -> Iterator[tuple[bool, ZoneSpec]]:
    """Yield (is inclusion, zone in NED) for each zone that one zone becomes (of a file several);
    ``keep``: it is one."""
    rest: Content = {"floor": zone.floor, "ceiling": zone.ceiling, "above": zone.above}
    if zone.polygon_geodetic is not None:
        outline, *holes = (corners_ned(ring, site) for ring in (zone.polygon_geodetic, *zone.holes_geodetic))
        yield keep, ZoneSpec(name=zone.name, polygon_ned=outline, holes_ned=holes, **rest)
    elif zone.circle_geodetic is not None:
        (centre,) = corners_ned([zone.circle_geodetic], site)
        yield keep, ZoneSpec(name=zone.name, circle_ned=centre, radius=zone.radius, **rest)
    elif zone.file is None:
        yield keep, zone
    else:
        found, plan = zones_of_file(zone.file, zone.name)
        if plan is not None:
            plans[zone.file] = plan
            if not any(each.inclusion is keep for each in found):
                raise UsageError(f"{zone.file}: geoFence has nothing to stay {'in' if keep else 'out of'}")
            both = keep and zone.file not in barred
            found = [each for each in found if both or each.inclusion is keep]
        for number, each in enumerate(found, 1):
            stem = Path(zone.file).stem
            name = each.name or (f"{stem} #{number}" if len(found) > 1 else stem)
            kept = keep if plan is None else each.inclusion
            try:
                shape = in_ned(each, site)
            except UsageError as error:
                raise UsageError(f"{zone.file}: {error}") from None
            # Heights of an entry to stay in are not those of the plan's fences to stay out of.
            yield kept, ZoneSpec(name=name[:100], **shape, **(rest if kept is keep else {}))
