"""Events of missions: finished, a leg that takes too long, and what a run ends with."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jax import Array

from qrsim.control import Mission, MissionGuidance, MissionState
from qrsim.simulation.history import History
from qrsim.world.state import Fleet, FleetState, World

FINISHED, LATE, UNFINISHED = "mission_finished", "leg_timeout", "mission_unfinished"
# Row and vehicle in its fleet, kind, number of the leg, what is said of it.
Found = tuple[int, int, str, float, str]


class MissionWatch:
    """Watches the missions of a run."""

    def __init__(self, world: World, start: History):
        self.fleets = world.fleets
        self.before = [_progress(state, -1) for state in start.state.fleets]

    def events(self, history: History) -> Iterator[tuple[int, Found]]:
        """Yield (fleet number, event) for each mission leg that becomes late and each mission that ends."""
        for i, (fleet, state) in enumerate(zip(self.fleets, history.state.fleets, strict=True)):
            progress, before = _progress(state), self.before[i]
            if progress is None or before is None:
                continue
            self.before[i] = _progress(state, -1)
            for kind, now, old in zip((LATE, FINISHED), progress, before, strict=True):
                # The guidance of a vehicle that has stopped goes on, and tells nothing.
                flies = state.violation.code == 0
                for row, vehicle in np.argwhere((now > np.concatenate([old[None], now[:-1]])) & flies):
                    yield i, _mission_event(fleet, state, int(row), int(vehicle), kind)

    def ending(self, history: History) -> Iterator[tuple[int, Found]]:
        """Yield (fleet number, event) for missions unfinished at the end of a run."""
        for i, (fleet, state) in enumerate(zip(self.fleets, history.state.fleets, strict=True)):
            now, route = state.guidance, fleet.route
            if not isinstance(now, MissionState) or not isinstance(route, Mission):
                continue
            last = now.index[-1] >= route.count - 1
            flies = (state.violation.code[-1] == 0) & ((now.ticks[-1] > 0) | (now.index[-1] > 0))
            if state.failsafe is not None:
                # Its own event has told why.
                flies = flies & (state.failsafe.action[-1] == 0)
            ends = np.asarray(route.following) == np.asarray(route.count) - 1
            for vehicle in np.flatnonzero(flies & ends & ~(last & now.arrived[-1])):
                yield i, _mission_event(fleet, state, len(now.ticks) - 1, int(vehicle), UNFINISHED)


def _progress(state: FleetState, row: int | slice = slice(None)) -> tuple[Array, Array] | None:
    """Return each vehicle's count of late legs, and whether its mission is finished, (T, n) or, at one ``row``, (n,);
    None without a mission."""
    now = state.guidance
    return (now.late[row], now.finished[row]) if isinstance(now, MissionState) else None


def _mission_event(fleet: Fleet, state: FleetState, row: int, vehicle: int, kind: str) -> Found:
    """Return an event of a mission: (row of the history, vehicle, kind, value, message)."""
    now, route = state.guidance, fleet.route
    assert isinstance(now, MissionState)
    assert isinstance(route, Mission)
    name = fleet.vehicle_names[vehicle]
    if kind == FINISHED:
        return row, vehicle, kind, float(now.reached[row, vehicle]), f"{name} finished its mission"
    index = int(now.index[row, vehicle])
    number = int(route.number[index, vehicle])
    legs = int(np.max(np.asarray(route.number)[:, vehicle]))
    detail = f"leg {number} of {legs}, {_leg(route, index, vehicle)}: {_why(fleet, state, row, vehicle)}"
    words = "has not reached" if kind == LATE else "has not finished its mission, it is at"
    return row, vehicle, kind, float(number), f"{name} {words} {detail}"


def _leg(route: Mission, index: int, vehicle: int) -> str:
    """Return the text that names leg ``index`` of a vehicle's mission by its destination."""
    # To a millimetre: what is left of a conversion from degrees is no place.
    north, east, down = (round(float(getattr(route.position_ned, axis)[index, vehicle]), 3) for axis in "xyz")
    place = f"north {north:.4g} m, east {east:.4g} m"
    return f"a landing at {place}" if route.lands[index, vehicle] else f"to {place}, {0.0 - down:.4g} m up"


def _why(fleet: Fleet, state: FleetState, row: int, vehicle: int) -> str:
    """Return as text how far a vehicle is from the end of its leg, and what keeps it from reaching it."""
    guidance, now, route = fleet.guidance, state.guidance, fleet.route
    assert isinstance(guidance, MissionGuidance)
    assert isinstance(now, MissionState)
    assert isinstance(route, Mission)
    index = int(now.index[row, vehicle])
    axes = "xyz"
    place = np.array([getattr(state.estimate.position_ned, axis)[row, vehicle] for axis in axes], float)
    goal = np.array([getattr(route.position_ned, axis)[index, vehicle] for axis in axes], float)
    if route.rises[index, vehicle]:
        goal += [float(getattr(now.shift_ned, axis)[row, vehicle]) for axis in axes]
    speed = float(np.linalg.norm([getattr(state.estimate.velocity_ned, axis)[row, vehicle] for axis in axes]))
    away, behind = float(np.linalg.norm(goal - place)), float(now.behind[row, vehicle])
    radius = float(route.accept_radius[index, vehicle])
    waits, slow = (float(np.max(value)) for value in (guidance.stretch_from, guidance.stop_speed))
    if route.lands[index, vehicle]:
        return f"{goal[2] - place[2]:.3g} m above the ground and not standing on it, at {speed:.2g} m/s"
    if behind > waits:
        return f"{away:.3g} m to go, {behind:.3g} m from the path, which waits from {waits:g} m on"
    if away >= radius:
        return f"{away:.3g} m to go; reached within {radius:g} m"
    if route.stops[index, vehicle] and speed >= slow:
        return f"there, but at {speed:.2g} m/s; stopped below {slow:g} m/s"
    return f"{away:.3g} m to go"
