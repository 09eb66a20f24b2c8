"""Crowds: searches for neighbours that found more than they have room for, so that they may have missed the nearest.

Radios, sensors that see others, and teams search by cells (``qrsim.core.neighbours``). Collisions are found by a search
without this limit.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from qrsim.control import RouteState
from qrsim.core.neighbours import always_room
from qrsim.errors import NeighbourWarning, RadioWarning
from qrsim.world.state import State, World


@dataclass(frozen=True)
class Crowds:
    """Number of searches, since the start, by which a radio, sensor or guidance may have missed others.

    Attributes:
        path: of the radio, sensor or guidance in the scenario.
        remedy: advice for the user.
        first: number of the first of its n vehicles in the world.
        looks: (..., n) number of such searches by each vehicle.
    """

    path: str
    remedy: str
    first: int
    looks: npt.NDArray[np.int32]

    def text(self, looks: int) -> str:
        """Return the warning that ``looks`` searches for neighbours found more vehicles than they could check."""
        return (
            f"{self.path}: {looks} times a vehicle had more others around it than were looked at, so that it may have"
            f" missed the nearest; {self.remedy}"
        )


def crowds_of(world: World, state: State) -> list[Crowds]:
    """Return, for radio, guidance and sensors, how often each vehicle's search for neighbours overflowed, (n,) or (W,
    n)."""
    fleets = _of_fleets(world, state)
    # In a world this small, even a search for one neighbour has room for all.
    if world.radio is None or always_room(sum(fleet.size for fleet in world.fleets), 1):
        return fleets
    looks = world.radio.counted(state.radio)["overfull"]
    remedy = "give a larger world.radio.inbox.candidates, or a smaller reach"
    return [Crowds("world.radio", remedy, 0, np.asarray(looks)), *fleets]


def _of_fleets(world: World, state: State) -> list[Crowds]:
    """Return, for each fleet's guidance and sensors, how often each vehicle's search for neighbours overflowed."""
    crowds, first = [], 0
    for fleet, now in zip(world.fleets, state.fleets, strict=True):
        path = f"fleets.{fleet.name}"
        of_team = now.guidance.overfull if isinstance(now.guidance, RouteState) else None
        if of_team is not None:
            remedy = f"give a larger {path}.guidance.mates, or a smaller reach"
            crowds.append(Crowds(f"{path}.guidance", remedy, first, np.asarray(of_team)))
        for name, sensor, memory in zip(fleet.sensor_names, fleet.sensors, now.sensors, strict=True):
            seen = sensor.overfull(memory)
            if seen is not None:
                remedy = f"give a smaller {path}.sensors.{name}.range_max"
                crowds.append(Crowds(f"{path}.sensors.{name}", remedy, first, np.asarray(seen)))
        first += fleet.size
    return crowds


def overfull_of_fleets(world: World, state: State) -> npt.NDArray[np.int32] | None:
    """Return how often each vehicle's searches for neighbours overflowed, (..., N); None if none can overflow."""
    crowds = _of_fleets(world, state)
    if not crowds:
        return None
    total = np.zeros((*crowds[0].looks.shape[:-1], sum(fleet.size for fleet in world.fleets)), np.int32)
    for crowd in crowds:
        total[..., crowd.first : crowd.first + crowd.looks.shape[-1]] += crowd.looks
    return total


def warn_of_overfull(world: World, state: State) -> bool:
    """Warn once about each radio, sensor or guidance whose search for neighbours overflowed; return True if there are
    such searches and none did.

    Args:
        world: its parameters.
        state: at the end, on the host; of many worlds, leaves (W, ...).

    Returns:
        Whether a warning may be due later: searches can overflow, and none has yet.
    """
    crowds = crowds_of(world, state)
    full = [crowd for crowd in crowds if crowd.looks.any()]
    for crowd in full:
        kind = RadioWarning if crowd.path == "world.radio" else NeighbourWarning
        warnings.warn(crowd.text(int(crowd.looks.sum())), kind, stacklevel=2)
    return bool(crowds) and not full
