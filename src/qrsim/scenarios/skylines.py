"""What a scenario's obstacles do to signals of satellites: the table for its receivers, made once and kept."""

from __future__ import annotations

import contextlib
import hashlib
import math
import os
import zlib
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from qrsim.engine.folders import cache_folder, private, temporary, tidy
from qrsim.models.gnss.skyline import Skyline
from qrsim.models.gnss.skyline_table import Frame, Walls, frame_of, make_table, skyline_of, walls_of
from qrsim.models.scene.elevation import Bounds
from qrsim.scenarios.ground import bounds_of
from qrsim.scenarios.obstacle_specs import MaskSpec
from qrsim.scenarios.satellites import receivers
from qrsim.scenarios.schema import ScenarioSpec

# A cylinder of no larger radius [m] hides no satellite: signals bend around what is narrower than their Fresnel zone.
NARROWEST = 1.0
SIDES = 16
LARGEST = 256 * 2**20
# Sides of a cell [m] of which the first is taken whose table has no more bytes than that, else the last: 3 s to make.
PITCHES, SMALL = (1.0, 2.0, 4.0), 32 * 2**20
# Of the table's making: another one makes other files. Small tables are not worth one.
VERSION, LEAST_KEPT = 2, 2**20


class _Plan(NamedTuple):
    walls: Walls
    frame: Frame
    lowest: float


def _plan(scenario: ScenarioSpec) -> _Plan | None:
    """Plan the table of obstacle masks for GNSS: walls, grid, lowest mask angle; None if no table is needed.

    Of PITCHES it is the first whose table is SMALL, else the last.
    """
    masks = [sensor.elevation_mask_rad for sensor in receivers(scenario).values()]
    solids = [solid for solid in map(_solid, scenario.world.obstacles) if solid is not None] if masks else []
    if not solids:
        return None
    walls, lowest = walls_of(solids), min(masks)
    spec = MaskSpec.model_validate({}) if scenario.world.buildings is None else scenario.world.buildings.table
    bounds = bounds_of(scenario.world.area)
    for pitch in PITCHES if spec.pitch is None else (spec.pitch,):
        frame = frame_of(walls, bounds, lowest, pitch, spec.azimuths)
        if frame is None:
            return None
        plan = _Plan(walls, frame, lowest)
        if frame.size <= SMALL:
            break
    return plan


def _solid(spec: Any) -> tuple[list[Any], float, float] | None:
    """Return rings, top and bottom [m] above z = 0 of an obstacle; None for one that hides no satellites."""
    if spec.type == "cylinder":
        if spec.radius <= NARROWEST:
            return None
        # As wide on average as the circle.
        turns = 2.0 * math.pi * (np.arange(SIDES) + 0.5) / SIDES
        radius = spec.radius * math.sqrt(2.0 * math.pi / (SIDES * math.sin(2.0 * math.pi / SIDES)))
        rings = [np.stack([spec.x + radius * np.cos(turns), spec.y + radius * np.sin(turns)], axis=1)]
    elif spec.type == "box":
        south, north, west, east = spec.x_min, spec.x_max, spec.y_min, spec.y_max
        rings = [np.array([[south, west], [south, east], [north, east], [north, west]])]
    else:
        rings = [spec.corners_ned, *spec.holes_ned]
    return rings, -spec.z_min, -spec.z_max


def skyline_problems(scenario: ScenarioSpec) -> Iterator[str]:
    """Yield an error if the table of obstacle masks does not fit into memory, with a grid pitch that would."""
    plan = _plan(scenario)
    if plan is None or plan.frame.size <= LARGEST:
        return
    pitch, bounds = plan.frame.pitch, bounds_of(scenario.world.area)
    fits = math.ceil(2.0 * pitch * math.sqrt(plan.frame.size / LARGEST)) / 2.0
    while frame_size(plan, bounds, fits) > LARGEST:
        fits += 0.5
    yield (
        f"world.buildings.table.pitch: {pitch:g} m makes a table of {plan.frame.size / 2**20:.0f} MB of what obstacles "
        f"hide of the sky; allowed: at most {LARGEST // 2**20} MB; a pitch of {fits:g} m fits, or a smaller world.area"
    )


def frame_size(plan: _Plan, bounds: Bounds | None, pitch: float) -> int:
    """Return the bytes that a planned table of obstacle masks needs with another grid pitch [m]."""
    frame = frame_of(plan.walls, bounds, plan.lowest, pitch, plan.frame.azimuths)
    return 0 if frame is None else frame.size


def skyline(scenario: ScenarioSpec) -> Skyline | None:
    """Return the table by which obstacles shade and reflect satellites for GNSS receivers; None if not needed."""
    plan = _plan(scenario)
    if plan is None or plan.frame.size > LARGEST:
        return None
    digest = hashlib.sha256(repr((VERSION, plan.frame, plan.lowest, plan.walls.bottom)).encode())
    for part in (plan.walls.first, plan.walls.last, plan.walls.top, plan.walls.solid):
        digest.update(np.ascontiguousarray(part).tobytes())
    return _made(digest.hexdigest(), _Held(plan))


class _Held:
    """A plan that is equal to any other, because the digest beside it says what it is."""

    def __init__(self, plan: _Plan):
        self.plan = plan

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Held)

    def __hash__(self) -> int:
        return 0


@lru_cache(maxsize=2)
def _made(digest: str, held: _Held) -> Skyline:
    """Return the planned table of obstacle masks from the user's cache, or compute and store it;
    ``digest`` is its key."""
    plan = held.plan
    place = _folder() if plan.frame.size >= LEAST_KEPT else None
    found = None if place is None else _read(place / f"{digest}.bin", plan.frame)
    if found is not None:
        return found
    made = make_table(plan.walls, plan.frame, plan.lowest)
    if place is not None:
        _write(place / f"{digest}.bin", made)
    return made


def _folder() -> Path | None:
    """Return the cache folder for tables of obstacle masks; None if caching is off or the folder is not private."""
    if os.environ.get("QRSIM_COMPILATION_CACHE") == "off":
        return None
    place = cache_folder() / "skylines"
    return place if private(place) else None


def _read(path: Path, frame: Frame) -> Skyline | None:
    """Read a table of obstacle masks from the cache; None if it is missing or damaged."""
    try:
        data = zlib.decompressobj().decompress(path.read_bytes(), frame.size + 1)
    except (OSError, zlib.error):
        return None
    return skyline_of(np.frombuffer(data, np.int32), frame) if len(data) == frame.size else None


def _write(path: Path, made: Skyline) -> None:
    """Write a table of obstacle masks to the cache, compressed; errors of the file system are ignored."""
    # A cache that cannot be written costs time, nothing else.
    with contextlib.suppress(OSError):
        tidy(path.parent)
        kept = temporary(path)
        kept.write_bytes(zlib.compress(np.asarray(made.words).tobytes(), 1))
        os.replace(kept, path)
