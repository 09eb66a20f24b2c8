"""The places that a task is about, for pictures: goals, sources of a plume, and where it is asked for."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.core.vectors import Vec3
from qrsim.models.scene.plume import Sources
from qrsim.tasks.plume_mapping import PlumeMemory
from qrsim.tasks.simple import KeepSpot
from qrsim.world.state import World


def _no_positions() -> Floats:
    """Return an empty array of positions, (0, 3)."""
    return np.zeros((0, 3))


@dataclass(frozen=True)
class Places:
    """Places of a task, NED (P, 3) [m] each.

    Attributes:
        goals: where vehicles are to be.
        sources: of a plume.
        locations: at which a task asks for the concentration.
    """

    goals: Floats = field(default_factory=_no_positions)
    sources: Floats = field(default_factory=_no_positions)
    locations: Floats = field(default_factory=_no_positions)

    def __bool__(self) -> bool:
        return bool(len(self.goals) or len(self.sources) or len(self.locations))


def places_of(task: Any, world: World, memory: Any, contents: Any) -> Places:
    """Return the goals, sources and other places of an episode's task, for display.

    Args:
        task, world: of the episode.
        memory: of the task; None: it is unknown, and with it are the locations and goals.
        contents: of the world's state, at its start.
    """
    goals, sources, locations = _no_positions(), _no_positions(), _no_positions()
    if isinstance(task, KeepSpot) and memory is not None:
        goals = goals_of(task, world, memory.start_ned)
    if isinstance(memory, PlumeMemory):
        locations = _position_rows(memory.locations_ned)
    plume = contents.plume
    if plume is not None:
        # A plume that moves keeps its sources beside what they have let out.
        found = plume if isinstance(plume, Sources) else plume.sources
        sources = _position_rows(found.position_ned)[np.asarray(found.strength) > 0]
    return Places(goals, sources, locations)


def goals_of(task: KeepSpot, world: World, start_ned: Vec3) -> Floats:
    """Return the goals (n, 3) NED [m] of vehicles that started at ``start_ned`` (n,)."""
    return _position_rows(task.goal(start_ned, world))


def _position_rows(places: Vec3) -> Floats:
    """Return a Vec3 of positions (N,) as an array (N, 3) [m]."""
    return np.stack([np.atleast_1d(np.asarray(axis, float)) for axis in places.axes], axis=-1)
