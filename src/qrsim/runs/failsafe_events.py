"""Events of failsafes: a low battery, a lost link or position, and what a vehicle does about it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from qrsim.control.failsafe_flight import Failsafes
from qrsim.control.failsafes import ACTIONS, LEVELS
from qrsim.files import Content
from qrsim.simulation.history import History
from qrsim.world.state import FleetState, World

FAILSAFE, ENDS = "failsafe", "failsafe_ends"
# Row, vehicle in the world, kind, field, value and words.
Found = tuple[int, int, str, str, float, str]


def still_acting(value: float | None) -> str:
    """Return the action that goes on after an event ``ENDS`` with this value; "" for none."""
    return next((name for number, name in enumerate(ACTIONS) if number and number == value), "")


class FailsafeWatch:
    """Watches the failsafes of a run."""

    def __init__(self, world: World, start: History):
        self._fleets = world.fleets
        self._before = [self._rows(state, -1) for state in start.state.fleets]

    @staticmethod
    def _rows(state: FleetState, row: int | slice) -> Content | None:
        """Return failsafe state by name at some rows (ticks), (n,) or (T, n); None for a fleet without failsafes."""
        own = state.failsafe
        if own is None:
            return None
        names = ("level", "link_lost", "position_lost", "unfixed", "action")
        return {name: getattr(own, name)[row] for name in names}

    def events(self, history: History) -> Iterator[Found]:
        """Yield events of flying vehicles: each failsafe that began, with its action, and each that ended."""
        first = 0
        for number, (fleet, state) in enumerate(zip(self._fleets, history.state.fleets, strict=True)):
            now, before = self._rows(state, slice(None)), self._before[number]
            if now is not None and before is not None and fleet.failsafes is not None:
                self._before[number] = self._rows(state, -1)
                yield from self._fleet_events(fleet.failsafes, state, now, before, first)
            first += fleet.size

    @staticmethod
    def _fleet_events(
        failsafes: Failsafes, state: FleetState, now: Content, before: Content, first: int
    ) -> Iterator[Found]:
        """Yield a fleet's failsafe changes from ``before`` (n,) to ``now`` (T, n); ``first`` is its first vehicle's
        number."""
        old = {name: np.concatenate([before[name][None], values[:-1]]) for name, values in now.items()}
        flies = state.violation.code == 0
        acts = failsafes.COM_GNSSLOSS_ACT != "warn"
        changes = (
            ("battery", now["level"] > old["level"]),
            ("link", now["link_lost"] & ~old["link_lost"]),
            ("fix", (now["unfixed"] == 1) & acts),
            ("position", now["position_lost"] & ~old["position_lost"]),
        )
        noticed = np.zeros(flies.shape, bool)
        for name, changed in changes:
            for row, vehicle in np.argwhere(changed & flies):
                noticed[row, vehicle] = True
                action = int(now["action"][row, vehicle])
                word = f"battery {LEVELS[int(now['level'][row, vehicle])]}" if name == "battery" else f"{name} lost"
                done = f"failsafe: {word}, {ACTIONS[action]},"
                yield int(row), first + int(vehicle), FAILSAFE, name, float(action), done
        for row, vehicle in np.argwhere((now["action"] < old["action"]) & ~noticed & flies):
            action = int(now["action"][row, vehicle])
            what = f"failsafe continues: {ACTIONS[action]}," if action else "failsafe ends"
            yield int(row), first + int(vehicle), ENDS, "action", float(action), what
