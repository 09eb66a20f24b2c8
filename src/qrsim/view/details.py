"""Further quantities of the vehicles at one time, which only some layers draw: read when a layer asks for them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast

import numpy as np

from qrsim.control.failsafes import ACTIONS
from qrsim.core.arrays import Floats
from qrsim.core.host import on_host
from qrsim.errors import QrsimError, warn_user
from qrsim.models.vehicles.contracts import Charged
from qrsim.runs import Run
from qrsim.runs.failsafe_events import ENDS, FAILSAFE, still_acting
from qrsim.runs.layout import EVENTS, Event
from qrsim.view.columns import Columns, vector
from qrsim.view.truth import ANGLES, AXES, turned_to_ned
from qrsim.world.state import FleetState, State, World

_load = on_host(lambda vehicle, states: vehicle.load(states))


@dataclass(frozen=True)
class Details:
    """Quantities of n vehicles at one time; NaN where unknown.

    Attributes:
        velocity_ned: (n, 3) [m/s].
        thrust: (n,) of the rotors together [N].
        believed_ned, std_ned: (n, 3) position by the estimator, and the standard deviations that it reports [m].
        charge: (n,) of the battery, 0 to 1.
        waypoint: (n,) index of the waypoint or leg.
        modes: vehicle -> failsafe that acts now, in words.
    """

    velocity_ned: Floats
    thrust: Floats
    believed_ned: Floats
    std_ned: Floats
    charge: Floats
    waypoint: Floats
    modes: dict[int, str]


def details_of_state(state: State, world: World) -> Details:
    """Return what the page shows about each vehicle (speeds, attitude, estimate ...) from a state of NumPy arrays."""
    parts = [_of_fleet(fleet, own) for fleet, own in zip(world.fleets, state.fleets, strict=True)]
    actions = np.concatenate([part.pop("action") for part in parts]).astype(int)
    together = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    return Details(**together, modes={int(i): f"failsafe: {ACTIONS[actions[i]]}" for i in np.flatnonzero(actions)})


def _of_fleet(fleet: Any, state: FleetState) -> dict[str, Floats]:
    """Return name -> values (n, 3) or (n,) of what the page shows about a fleet's vehicles in a state."""
    size = fleet.size

    def axes(value: object) -> Floats:
        """Return a Vec3 or None as an array (n, 3), NaN for None."""
        if value is None:
            return np.full((size, 3), np.nan)
        return np.stack([np.broadcast_to(np.asarray(axis), (size,)) for axis in vars(value).values()], axis=-1)

    def one(value: object) -> Floats:
        """Return a number as an array (n,), one element for each vehicle of the fleet."""
        return np.broadcast_to(np.asarray(value, np.float64), (size,))

    pose = fleet.vehicle.pose(state.vehicle)
    belief = state.belief
    load = _load(fleet.vehicle, state.vehicle) if fleet.vehicle.wake() is not None else None
    return {
        "velocity_ned": turned_to_ned(axes(pose.attitude), axes(pose.velocity_body)),
        "thrust": one(np.nan if load is None else load.thrust),
        "believed_ned": axes(None if belief is None else belief.estimate.position_ned),
        "std_ned": axes(None if belief is None or belief.std is None else belief.std.position_ned),
        "charge": one(cast(Charged, state.battery).charge if fleet.battery.drains else np.nan),
        "waypoint": one(state.guidance.index),
        "action": one(0 if state.failsafe is None else state.failsafe.action),
    }


class RecordedDetails:
    """The details of a recorded run; each stream is read when it is first asked for.

    Estimates that are damaged are left out, with a warning.

    Args:
        run: what was recorded.
        stops: events of vehicles that stopped, and the number of the vehicle.
    """

    def __init__(self, run: Run, stops: Sequence[tuple[Event, int]] = ()):
        self._run, self._stops = run, stops

    @cached_property
    def _truth(self) -> Columns:
        """Read the logged columns of the true state: velocity, attitude and scalar quantities."""
        truth = self._run["truth"]
        ones = {name: (column,) if column in truth else None for name, column in _OF_TRUTH.items()}
        parts = {"velocity": ("velocity_body", AXES), "attitude": ("attitude", ANGLES)}
        return Columns(self._run, "truth", ones | {name: vector(self._run, "truth", *of) for name, of in parts.items()})

    @cached_property
    def _left(self) -> list[tuple[float, int, Floats]]:
        """Return (time [s], vehicle number, charge) of each stop: logs drain the battery on, at the last thrust."""
        # The last tick before the stop.
        return [(stop.time, i, self._truth.at("charge", stop.time - 2e-6)[i, 0]) for stop, i in self._stops]

    @cached_property
    def _commands(self) -> Columns:
        """Read the logged columns of the estimate, and of the waypoint that each vehicle flies to."""
        parts = {"believed": "estimate.position_ned", "std": "estimate_std.position_ned"}
        try:
            columns = self._run["commands"].columns() if "commands" in self._run else ()
            found = {name: vector(self._run, "commands", of, AXES) for name, of in parts.items()}
            found |= {"waypoint": ("waypoint",) if "waypoint" in columns else None}
            return Columns(self._run, "commands", found)
        except QrsimError as error:  # vehicles are shown without their estimates
            warn_user(f"estimates are not shown: {error}")
            return Columns(self._run, "commands", {})

    @cached_property
    def modes(self) -> list[tuple[float, int, str]]:
        """Return (time [s], vehicle number, text) of each change of a failsafe's action, in order of time."""
        numbers = {name: i for i, name in enumerate(self._run.vehicles)}
        try:
            events = self._run.events if EVENTS in self._run else []
        except QrsimError:  # a damaged stream of events hides no vehicle
            events = []
        return [
            (event.time, numbers[event.vehicle], mode_of(event))
            for event in events
            if event.kind in (FAILSAFE, ENDS) and event.vehicle in numbers
        ]

    def at(self, time: float) -> Details:
        """Return what the page shows about each vehicle at a time [s] of a recorded run."""
        charge = self._truth.at("charge", time)[..., 0].copy()
        for since, vehicle, left in self._left:
            if since <= time + 1e-6:
                charge[vehicle] = left
        modes: dict[int, str] = {}
        for since, vehicle, words in self.modes:
            if since <= time + 1e-6:
                modes[vehicle] = words

        def one(columns: Columns, name: str) -> Floats:
            """Return the values (n,) of a logged column at this time."""
            return columns.at(name, time)[..., 0]

        return Details(
            turned_to_ned(self._truth.at("attitude", time), self._truth.at("velocity", time)),
            one(self._truth, "thrust"),
            self._commands.at("believed", time),
            self._commands.at("std", time),
            charge,
            one(self._commands, "waypoint"),
            {vehicle: words for vehicle, words in modes.items() if words},
        )


def mode_of(event: Event) -> str:
    """Return the failsafe that acts from an event on, such as "failsafe: fix lost, land"; "" if none does.

    A warning is no action, and the end of one failsafe leaves the milder action of another.
    """
    if event.kind == ENDS or not event.value:
        action = still_acting(event.value)
        return f"failsafe: {action}" if action else ""
    return re.sub(r",? at [\d.]+ s$", "", event.message or event.kind).removeprefix(f"{event.vehicle}: ")


_OF_TRUTH = {"thrust": "thrust", "charge": "battery.charge"}
